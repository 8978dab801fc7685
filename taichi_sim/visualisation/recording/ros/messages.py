"""An episode as messages in the order of time. All values are true ones: covariances are zero, "unknown" to ROS.

Topics and frames are listed in docs/ros.md. Motion is by ROS's conventions (REP 103, REP 145), float64: world
east-north-up, bodies forward-left-up, with

    specific force  f = R^T (dv/dt - g),   g = (0, 0, -9.81) m/s^2 in east-north-up

so that an accelerometer at rest reads +9.81 upwards. dv/dt is the central difference of the recorded velocity: a mean
over two intervals, which filters out faster vibration.
"""

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.visualisation.recording.east_north_up import (
    Array,
    Origin,
    enu,
    enu_flu_quaternion,
    flu,
    geodetic,
    into_body,
)
from taichi_sim.visualisation.recording.episode import Episode, TeamTrack

if TYPE_CHECKING:
    from rosbags.typesys.store import Msg, Msgarg, Typestore
NS = 1_000_000_000
EPOCH_S = 1_000_000_000  # s, stamp of time 0 (2001-09-09 01:46:40 UTC), because a stamp of 0 means "no time" to ROS
MAP, BODY = "map", "base_link"
XYZ = Sequence[float]
LEVEL = (0.0, 0.0, 0.0, 1.0)
NO_TORQUE = (0.0, 0.0, 0.0)
NO_COVARIANCE_3, NO_COVARIANCE_6 = np.zeros(9), np.zeros(36)
STATUS_FIX, SERVICE_GPS, COVARIANCE_UNKNOWN = 0, 1, 0  # constants of NavSatStatus and NavSatFix


def _level(course: Array) -> Array:
    """Quaternions [..., 4] of a level body that points along a course (rad, clockwise from north)."""
    half = 0.5 * (0.5 * np.pi - np.asarray(course, dtype=np.float64))
    return np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=-1)


def _continuous(orientation: Array) -> Array:
    """The same orientations [T, ..., 4], each with the sign closer to the quaternion before."""
    along = (orientation[1:] * orientation[:-1]).sum(-1, keepdims=True)
    sign = np.cumprod(np.where(along < 0, -1.0, 1.0), axis=0)
    return np.concatenate([orientation[:1], sign * orientation[1:]])


def _rate(values: Array, time_s: Array) -> Array:
    """Rate of change (1/s) of values [T, ...]; zero for a single frame."""
    return np.zeros_like(values) if len(values) < 2 else np.gradient(values, time_s, axis=0)


def _turning(orientation: Array, time_s: Array) -> Array:
    """Angular velocity [..., 3] (rad/s, body) of orientations [T, ..., 4]: 2 q* dq/dt."""
    q, w = orientation[..., :3], orientation[..., 3:]
    rate = _rate(orientation, time_s)
    return 2 * (w * rate[..., :3] - rate[..., 3:] * q - np.cross(q, rate[..., :3]))


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    type: str
    latched: bool = False  # late subscribers receive the last message


CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock")
TF = Topic("/tf", "tf2_msgs/msg/TFMessage")
TF_STATIC = Topic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)


def ros_name(name: str) -> str:
    """`name` made valid for topics and frames: letters, digits and underscores, no digit first."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return f"_{plain}" if plain[:1].isdigit() else plain


def stamps_ns(time_s: Array) -> list[int]:
    """Stamps (ns) of times (s), rounded to whole ns."""
    return (np.rint(np.asarray(time_s, dtype=np.float64) * NS).astype(np.int64) + EPOCH_S * NS).tolist()


class Builder:
    """Builds messages; quaternions are (x, y, z, w)."""

    def __init__(self, typestore: "Typestore"):
        """Use the types of `typestore` (rosbags.typesys)."""
        self._types = typestore.types

    def make(self, kind: str, *fields: "Msgarg") -> "Msg":
        """A message of a type, its fields in their order."""
        return self._types[kind](*fields)

    def header(self, time: "Msg", frame: str) -> "Msg":
        """A Header."""
        return self.make("std_msgs/msg/Header", time, frame)

    def vector(self, xyz: XYZ) -> "Msg":
        """A Vector3."""
        return self.make("geometry_msgs/msg/Vector3", *xyz)

    def quaternion(self, xyzw: XYZ) -> "Msg":
        """A Quaternion."""
        return self.make("geometry_msgs/msg/Quaternion", *xyzw)

    def pose(self, xyz: XYZ, xyzw: XYZ) -> "Msg":
        """A Pose."""
        return self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", *xyz), self.quaternion(xyzw))

    def pose_stamped(self, header: "Msg", xyz: XYZ, xyzw: XYZ) -> "Msg":
        """A PoseStamped."""
        return self.make("geometry_msgs/msg/PoseStamped", header, self.pose(xyz, xyzw))

    def transform(self, header: "Msg", child: str, xyz: XYZ, xyzw: XYZ) -> "Msg":
        """A TransformStamped: the pose of the frame `child` in the header's."""
        turn = self.make("geometry_msgs/msg/Transform", self.vector(xyz), self.quaternion(xyzw))
        return self.make("geometry_msgs/msg/TransformStamped", header, child, turn)


class Messages:
    """The messages of an episode, frame by frame."""

    def __init__(self, episode: Episode, origin: Origin, build: Builder):
        """Take `episode`, whose world has its origin at `origin`."""
        self.build, self.stamps = build, stamps_ns(episode.time_s)
        self.teams = [_Team(team, episode, origin, build) for team in episode.teams.values()]
        names = [topic.name for topic in self.topics]
        if twice := {name for name in names if names.count(name) > 1}:
            raise ValueError(f"episode {episode.name}: two teams would share the topic {min(twice)}")

    @property
    def topics(self) -> list[Topic]:
        """All topics, in the order in which they are first sent."""
        fixed = [TF_STATIC] if any(team.arrows for team in self.teams) else []
        return [CLOCK, *fixed, TF, *(topic for team in self.teams for topic in team.topics)]

    def frame(self, step: int) -> Iterator[tuple[Topic, "Msg"]]:
        """Messages of one frame."""
        make = self.build.make
        time = make("builtin_interfaces/msg/Time", *divmod(self.stamps[step], NS))
        yield CLOCK, make(CLOCK.type, time)
        if step == 0 and (fixed := [one for team in self.teams for one in team.fixed(time)]):
            yield TF_STATIC, make(TF_STATIC.type, fixed)
        yield TF, make(TF.type, [one for team in self.teams for one in team.moving(step, time)])
        for team in self.teams:
            yield from team.messages(step, time)


class _Team:
    """Messages of one team."""

    def __init__(self, team: TeamTrack, episode: Episode, origin: Origin, build: Builder):
        self.build, self.names = build, [ros_name(f"{team.name}_{vehicle}") for vehicle in range(team.vehicles)]
        turn = _continuous(enu_flu_quaternion(team.quaternion_nb))
        place, velocity = enu(team.position_n, np.float64), enu(team.velocity_n, np.float64)
        acceleration = _rate(velocity, episode.time_s) + (0.0, 0.0, GRAVITY)
        rates = team.angular_velocity_b
        # [T, V, ...] m, map; (x, y, z, w), base_link to map; m/s, rad/s, m/s^2 in base_link; deg, deg, m
        self.place, self.turn, self.velocity = place.tolist(), turn.tolist(), into_body(turn, velocity).tolist()
        self.rates = (_turning(turn, episode.time_s) if rates is None else flu(rates)).tolist()
        self.felt, self.fix = into_body(turn, acceleration).tolist(), geodetic(place, origin).tolist()
        self.slot = None if team.slot_n is None else enu(team.slot_n, np.float64).tolist()
        self.target = None if team.target_n is None else enu(team.target_n, np.float64).tolist()
        self.course = _level(team.course).tolist()
        self.action, self.action_names = team.action, list(team.action_names)
        self.arrows = {  # point of attack (m) and values [T, V, 3] (N) of each force, in base_link
            ros_name(name): (flu(np.asarray(force.origin_b)).tolist(), flu(force.vector_b).tolist())
            for name, force in team.forces.items()
        }
        self.target_topic = Topic(f"/{ros_name(team.name)}/target", "geometry_msgs/msg/PoseStamped")
        self.of_vehicles = [self._topics(name) for name in self.names]

    def _topics(self, name: str) -> dict[str, Topic]:
        types = {"odom": "nav_msgs/msg/Odometry", "imu": "sensor_msgs/msg/Imu", "fix": "sensor_msgs/msg/NavSatFix"}
        if self.slot is not None:
            types["slot"] = "geometry_msgs/msg/PoseStamped"
        if self.action is not None:
            types["actions"] = "sensor_msgs/msg/JointState"
        types |= {f"wrench/{arrow}": "geometry_msgs/msg/WrenchStamped" for arrow in self.arrows}
        return {last: Topic(f"/{name}/{last}", kind) for last, kind in types.items()}

    @property
    def topics(self) -> list[Topic]:
        """Topics of all vehicles of the team and of its target."""
        own = [topic for topics in self.of_vehicles for topic in topics.values()]
        return own if self.target is None else [*own, self.target_topic]

    def fixed(self, time: "Msg") -> Iterator["Msg"]:
        """Static frames at the points of attack of the team's forces."""
        for name in self.names:
            for arrow, (place, _) in self.arrows.items():
                header = self.build.header(time, f"{name}/{BODY}")
                yield self.build.transform(header, f"{name}/wrench/{arrow}", place, LEVEL)

    def moving(self, step: int, time: "Msg") -> Iterator["Msg"]:
        """Transforms of the team's vehicles."""
        for vehicle, name in enumerate(self.names):
            header, child = self.build.header(time, MAP), f"{name}/{BODY}"
            yield self.build.transform(header, child, self.place[step][vehicle], self.turn[step][vehicle])

    def messages(self, step: int, time: "Msg") -> Iterator[tuple[Topic, "Msg"]]:
        """Messages of all vehicles of the team and of its target."""
        world = self.build.header(time, MAP)
        for vehicle, topics in enumerate(self.of_vehicles):
            frame = f"{self.names[vehicle]}/{BODY}"
            yield topics["odom"], self._odometry(step, vehicle, world, frame)
            own = self.build.header(time, frame)
            yield topics["imu"], self._imu(step, vehicle, own)
            yield topics["fix"], self._fix(step, vehicle, own)
            if self.slot is not None:
                yield topics["slot"], self.build.pose_stamped(world, self.slot[step][vehicle], self.course[step])
            if self.action is not None and step + 1 < len(self.action):
                taken = self.action[step + 1, vehicle]  # a frame has the action that led to it
                if np.isfinite(taken).all():
                    fields = self.action_names, np.asarray(taken, dtype=np.float64), np.zeros(0), np.zeros(0)
                    yield topics["actions"], self.build.make(topics["actions"].type, own, *fields)
            for arrow, (_, force) in self.arrows.items():
                topic = topics[f"wrench/{arrow}"]
                yield topic, self._wrench(time, topic.name.removeprefix("/"), force[step][vehicle])
        if self.target is not None:
            yield self.target_topic, self.build.pose_stamped(world, self.target[step], self.course[step])

    def _odometry(self, step: int, vehicle: int, header: "Msg", frame: str) -> "Msg":
        make = self.build.make
        pose = self.build.pose(self.place[step][vehicle], self.turn[step][vehicle])
        rates = (self.build.vector(of[step][vehicle]) for of in (self.velocity, self.rates))
        there = make("geometry_msgs/msg/PoseWithCovariance", pose, NO_COVARIANCE_6)
        twist = make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", *rates), NO_COVARIANCE_6)
        return make("nav_msgs/msg/Odometry", header, frame, there, twist)

    def _imu(self, step: int, vehicle: int, header: "Msg") -> "Msg":
        turn = self.build.quaternion(self.turn[step][vehicle])
        rates, felt = (self.build.vector(of[step][vehicle]) for of in (self.rates, self.felt))
        none = NO_COVARIANCE_3
        return self.build.make("sensor_msgs/msg/Imu", header, turn, none, rates, none, felt, none)

    def _fix(self, step: int, vehicle: int, header: "Msg") -> "Msg":
        status = self.build.make("sensor_msgs/msg/NavSatStatus", STATUS_FIX, SERVICE_GPS)
        place = self.fix[step][vehicle]
        return self.build.make("sensor_msgs/msg/NavSatFix", header, status, *place, NO_COVARIANCE_3, COVARIANCE_UNKNOWN)

    def _wrench(self, time: "Msg", frame: str, force: list[float]) -> "Msg":
        wrench = self.build.make("geometry_msgs/msg/Wrench", self.build.vector(force), self.build.vector(NO_TORQUE))
        return self.build.make("geometry_msgs/msg/WrenchStamped", self.build.header(time, frame), wrench)
