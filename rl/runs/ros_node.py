"""An episode as a node of ROS 2: the topics of the bags (docs/ros.md) in real time, and commands of vehicles in.

It needs rclpy and the packages of the messages, of a sourced ROS 2 or from wheels.
"""

import contextlib
import sys
import time
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import torch

from rl.evaluation.episode_recording import EpisodeReel
from rl.mission import Mission, Policy, Step, Team, VehicleActions
from rl.runs.folder import RunError
from taichi_sim.errors import named
from taichi_sim.visualisation.recording import Event
from taichi_sim.visualisation.recording.ros import FJORD, Origin
from taichi_sim.visualisation.recording.ros.bag import check_messages, messages_of
from taichi_sim.visualisation.recording.ros.messages import Topic, ros_name

NODE, COMMAND = "taichi_sim", "command"
DEPTH = 10  # messages that wait for a slow subscriber
HOLDS = 1.0  # s of the episode, for which a command acts
WHEELS = "ros-rclpy ros-rmw-fastrtps-cpp ros-nav-msgs ros-sensor-msgs ros-geometry-msgs ros-rosgraph-msgs"
LATE = 0.5  # s behind, at which the simulation gives up catching up


class RosNode:
    """Publishes each decision of an episode, and takes commands; see the module."""

    def __init__(self, node: Any, origin: Origin = FJORD, speed: float = 1.0):
        """Publish by a node of rclpy, at `speed` times real time."""
        self.node, self.origin, self.speed = node, origin, speed
        self._reel: EpisodeReel | None = None
        self._publishers: dict[Topic, Any] = {}
        self._commands: dict[str, tuple[float, Mapping[str, float]]] = {}  # vehicle -> when it came, action -> value
        self._due, self._begins = 0.0, True
        self._told: set[str] = set()

    # -- in --------------------------------------------------------------------------------------------------------

    def listening(self, policies: Mapping[str, Policy]) -> dict[str, Policy]:
        """Policies whose vehicles obey commands, while those hold."""
        return {name: _Commanded(self, policy) for name, policy in policies.items()}

    def listen(self, team: Team) -> None:
        """Take the commands of a team's vehicles: JointState with some of their action names, values from -1 to 1."""
        joint, names = import_module("sensor_msgs.msg").JointState, team.fleet.model.action_names
        for vehicle in range(team.fleet.count):
            who = ros_name(f"{team.name}_{vehicle}")

            def take(message: Any, who: str = who) -> None:
                given = dict(zip(message.name, message.position, strict=False))
                if len(given) == len(message.position) and given.keys() <= set(names) and all(
                    abs(value) <= 1.0 for value in given.values()
                ):  # fmt: skip
                    self._commands[who] = self._now, given
                else:
                    self.tell(f"/{who}/{COMMAND}: {given}: allowed are {', '.join(names)} from -1 to 1")

            self.node.create_subscription(joint, f"/{who}/{COMMAND}", take, DEPTH)

    def command(self, team: Team, actions: torch.Tensor) -> torch.Tensor:
        """Vehicle actions [env, vehicle, a] with what is commanded now."""
        actions = actions.clone()
        for vehicle in range(team.fleet.count):
            came, given = self._commands.get(ros_name(f"{team.name}_{vehicle}"), (-HOLDS, {}))
            for name, value in given.items() if self._now - came < HOLDS else ():
                actions[:, vehicle, team.fleet.model.action_names.index(name)] = value
        return actions

    @property
    def _now(self) -> float:
        """Time of the episode, s."""
        return 0.0 if self._reel is None else self._reel.now

    # -- out -------------------------------------------------------------------------------------------------------

    def __call__(self, mission: Mission, env: int, step: Step, events: list[Event]) -> None:
        """Publish environment `env` after a step, when it is time."""
        dt = mission.config.decision_interval
        if self._reel is None:
            self._reel, self._due = EpisodeReel(mission, env, dt), time.monotonic()
        self._reel.add(step)
        self._due = max(self._due + dt / self.speed, time.monotonic() - LATE)
        rclpy = import_module("rclpy")
        while (left := self._due - time.monotonic()) > 0:
            rclpy.spin_once(self.node, timeout_sec=left)
        rclpy.spin_once(self.node, timeout_sec=0.0)
        if len(self._reel) > 1:  # the frame before tells the acceleration
            self._publish(self._reel)

    def _publish(self, reel: EpisodeReel) -> None:
        typestore, messages = messages_of(reel.part(keep=1), self.origin)
        if not self._publishers:
            self._publishers = {topic: self._publisher(topic) for topic in messages.topics}
        # actions that have led here began a decision ago
        sent = [one for one in messages.frame(0) if one[0].name.endswith("/actions") or one[0].latched and self._begins]
        self._begins = False
        for topic, message in (*sent, *messages.frame(1)):
            if (publisher := self._publishers[topic]) is not None:
                publisher.publish(bytes(typestore.serialize_cdr(message, topic.type)))

    def _publisher(self, topic: Topic) -> Any:
        package, _, kind = topic.type.split("/")
        try:
            of_type = getattr(import_module(f"{package}.msg"), kind)
        except ImportError:
            return self.tell(f"{topic.name} is not published: {package} is not installed")
        qos = import_module("rclpy.qos")
        kept = qos.DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else qos.DurabilityPolicy.VOLATILE
        return self.node.create_publisher(of_type, topic.name, qos.QoSProfile(depth=DEPTH, durability=kept))

    def tell(self, text: str) -> None:
        """Print a line, once."""
        if text not in self._told:
            self._told.add(text)
            print(f"ros: {text}", file=sys.stderr)


class _Commanded:
    """A policy whose vehicles obey commands."""

    def __init__(self, ros: RosNode, policy: Policy):
        """Ask `ros` for commands, else `policy`."""
        self.ros, self.policy = ros, policy
        self._listens = False

    def __call__(self, team: Team) -> VehicleActions:
        """Actions of the vehicles."""
        if not self._listens:
            self.ros.listen(team)
            self._listens = True
        return VehicleActions(self.ros.command(team, team.taken(team.checked(self.policy(team)))))


@contextlib.contextmanager
def ros_node(origin: Origin = FJORD, speed: float = 1.0) -> Iterator[RosNode]:
    """A node of this process."""
    check_messages("--ros", origin)
    with named(f"--ros needs a sourced ROS 2, or pip install {WHEELS}: ", RunError, ImportError):
        rclpy = import_module("rclpy")
        rclpy.init()
    node = rclpy.create_node(NODE)
    try:
        yield RosNode(node, origin, speed)
    finally:
        node.destroy_node()
        rclpy.shutdown()
