"""Bags of ROS 2 as logs, by `rosbags`: a folder of rosbag2, or an .mcap file. Topics and frames: docs/ros.md.

Pose and yaw rate come from `/NAME/odom` (nav_msgs/Odometry in ENU, body forward-left-up), the commands from
`/NAME/actions` (sensor_msgs/JointState: an action's name, and its value from -1 to 1 as `position`). Where columns are
given, `odom` names another topic of odometry, and an action a topic whose messages have a number as `data` (std_msgs
Float32, Float64). Each command holds from its time on; taken is its mean until the next message of odometry.

What a message has is not always a value:

| in the message | means |
|---|---|
| header.stamp 0, or the same one all the time | no time: times of recording hold for all topics, as without headers |
| orientation (0, 0, 0, 0), not of length 1, or upside down; a yaw variance of -1 or above a turn | no orientation |
| pose.covariance[0] of -1 | no position |
| frame ids that name NED or FRD, as MAVROS has them | other axes than these |

The last three are refused. An orientation that never changes is found by the course (log.py). A warning names parts of
a bag that its metadata leaves out.
"""

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_sim.applications.fit.log_table import CHANNELS, Array, LogError, Source, Table, held_means
from taichi_sim.config.columns import judge
from taichi_sim.errors import needs, refuse

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

ODOMETRY, COMMANDS = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
NS = 1e-9
ONE_CLOCK = 1.0  # s; assumed, delays of recording differ by less between topics whose stamps are of one clock
UNIT = 0.01  # assumed, error of a unit quaternion's length
FULL_TURN = 2 * np.pi  # rad; a yaw of a larger standard deviation is not known
PARTS = {".db3", ".mcap"}  # endings of a bag's parts; compressed ones have one more
MAGIC = b"\x89MCAP0\r\n"  # with which an .mcap file begins and ends
OTHER_AXES = {"ned", "frd", "nwu", "esd"}  # parts of a frame's name


def read_bag(path: Path, action_names: tuple[str, ...], source: Source) -> Table:
    """The table of one vehicle in a bag."""
    with needs("rosbags", "ros"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            _tell_parts(path)
            return _table(bag, action_names, source)
    except LogError:
        raise
    except Exception as error:  # AnyReaderError and whatever a damaged file makes its storage raise
        cut = [file for file in _parts(path) if (held := file.read_bytes())[:8] == MAGIC and held[-8:] != MAGIC]
        told = f"this is no bag of ROS 2 that can be read, or it is damaged: {error}" if not cut else (
            f"{cut[0].name} has no end, its recorder was killed: `mcap recover {cut[0]} -o NEW.mcap` (MCAP's command "
            "line) saves what there is; name that"
        )  # fmt: skip
        raise LogError(told) from None


def _parts(path: Path) -> list[Path]:
    """Files of a bag that hold messages."""
    return [path] if path.is_file() else sorted(file for file in path.iterdir() if PARTS & set(file.suffixes))


def _tell_parts(path: Path) -> None:
    """Warn of parts in the folder of a bag that its metadata.yaml does not name: they are not read."""
    from ruamel.yaml import YAML  # comes with rosbags

    if path.is_dir():
        about = YAML(typ="safe").load(path / "metadata.yaml")["rosbag2_bagfile_information"]
        named = {Path(name).name for name in about["relative_file_paths"]}
        if left_out := [file.name for file in _parts(path) if file.name not in named]:
            warnings.warn(f"{path}: left out: {', '.join(left_out)}, which metadata.yaml does not name: `ros2 bag "
                          f"reindex {path}` makes one that does", stacklevel=2)  # fmt: skip


def _table(bag: "AnyReader", action_names: tuple[str, ...], source: Source) -> Table:
    kinds = {c.topic: c.msgtype for c in bag.connections}
    odom = _odometry(kinds, source)
    actions = f"{odom.removesuffix('/odom')}/actions"
    given = {name: source.columns[name] for name in action_names if name in source.columns}
    wanted = {odom, *(column.source for column in given.values())}
    if len(given) < len(action_names):
        wanted.add(actions)
    missing = min(wanted - set(kinds), default="")
    others = actions in wanted and kinds.get(actions) != COMMANDS
    refuse(
        LogError,
        (missing, f"no topic {missing}; it has {', '.join(sorted(kinds))}. Actions are read from {actions} "
         f"({COMMANDS}), or from topics that --columns names"),
        (kinds.get(odom) != ODOMETRY, f"{odom} is {kinds.get(odom)}: a pose is read from {ODOMETRY}"),
        (others, f"{actions} is {kinds.get(actions)}: actions are read from {COMMANDS}"),
    )  # fmt: skip
    read = {topic: _messages(bag, topic) for topic in sorted(wanted)}
    counts = {topic: sum(c.msgcount for c in bag.connections if c.topic == topic) for topic in read}
    for topic, (_, messages) in read.items():
        has = len(messages)
        refuse(
            LogError,
            (not has, f"{topic} has no messages"),
            (has != counts[topic], f"damaged or cut: it has {has} of {counts[topic]} messages of {topic}"),
        )
    clocks = _clocks(read, odom)
    t, poses = clocks[odom], read[odom][1]
    columns: dict[str, Array] = dict(zip(CHANNELS, _motion(odom, poses), strict=True))
    begin = t[0]
    for name in action_names:
        topic = given[name].source if name in given else actions
        at, messages = clocks[topic], read[topic][1]
        numbers = name not in given or isinstance(getattr(messages[0], "data", None), (int, float))
        refuse(LogError, (not numbers, f"{topic} is {kinds[topic]}: an action's topic has a number as data"))
        judge(
            LogError,
            lambda k, topic=topic: f"message {k + 1} of {topic}",
            (np.diff(at, prepend=-np.inf) < 0,
             lambda k, at=at: f"is stamped {at[k - 1] - at[k]:g} s before the one that was recorded before it"),
        )  # fmt: skip
        if name in given:
            values = given[name].factor * np.array([float(m.data) for m in messages])
        else:
            values = _named(topic, name, messages)
        columns[name], begin = held_means(at, values, t, np.r_[t[1:], t[-1] + 1.0]), max(begin, at[0])
    kept = np.flatnonzero(t >= begin - 1e-9)  # before the first command nobody knows what was commanded
    few = len(kept) < 3
    refuse(LogError, (few, f"{len(kept)} messages of {odom} after the first command: at least 3 are wanted"))
    columns = {"t": t - t[kept[0]], **columns}
    return Table({name: x[kept] for name, x in columns.items()}, lambda k: f"message {kept[k] + 1} of {odom}")


def _odometry(kinds: Mapping[str, str | None], source: Source) -> str:
    """The topic of odometry; LogError if there is none, or if it is not clear which."""
    if "odom" in source.columns:
        return source.columns["odom"].source
    found = sorted(topic for topic, kind in kinds.items() if kind == ODOMETRY and topic.endswith("/odom"))
    if source.name:
        found = [topic for topic in found if topic == f"/{source.name}/odom"]
    if len(found) != 1:
        has = ", ".join(topic.removesuffix("/odom").removeprefix("/") for topic in found)
        told = f"it has {has}: choose by --name" if found else f"it has {', '.join(sorted(kinds))}"
        raise LogError(f"wanted is one topic /NAME/odom ({ODOMETRY}); {told}")
    return found[0]


def _messages(bag: "AnyReader", topic: str) -> tuple[Array, list[Any]]:
    """When the messages of a topic were recorded, s, and the messages."""
    found = [
        (NS * stamp, bag.deserialize(data, connection.msgtype))
        for connection, stamp, data in bag.messages([c for c in bag.connections if c.topic == topic])
    ]
    return np.array([stamp for stamp, _ in found]), [message for _, message in found]


def _clocks(read: Mapping[str, tuple[Array, list[Any]]], odom: str) -> dict[str, Array]:
    """Times of each topic's messages, s: the headers' stamps, if all have one, else when they were recorded."""
    recorded = {topic: received for topic, (received, _) in read.items()}
    stamps = {
        topic: np.array([m.header.stamp.sec + NS * m.header.stamp.nanosec for m in messages])
        for topic, (_, messages) in read.items() if all(hasattr(m, "header") for m in messages)
    }  # fmt: skip
    frozen = [topic for topic, at in stamps.items() if np.ptp(at) == 0 and np.ptp(recorded[topic]) > ONE_CLOCK]
    if len(stamps) < len(read) or frozen or any((at == 0).any() for at in stamps.values()):
        return recorded
    for topic, at in stamps.items():
        then = np.interp(recorded[topic], recorded[odom], stamps[odom])  # stamps of odometry that is recorded with it
        if abs(apart := float(np.median(at - then))) > ONE_CLOCK:
            raise LogError(f"stamps of {topic} and {odom} are of two clocks: messages that were recorded at the same "
                           f"time are {apart:.1f} s apart (use_sim_time?)")  # fmt: skip
    return stamps


def _motion(topic: str, odometry: list[Any]) -> tuple[Array, Array, Array, Array]:
    """North, east (m), heading (rad, clockwise from north), yaw rate (rad/s, bow to starboard) of odometry in ENU."""
    frames = sorted({m.header.frame_id for m in odometry})
    axes = {frame: re.split(r"[^a-z]+", frame.lower().rpartition("/")[2])
            for frame in (*frames, *(m.child_frame_id for m in odometry))}  # fmt: skip
    odd = next((frame for frame, parts in axes.items() if OTHER_AXES & set(parts)), None)
    refuse(
        LogError,
        (odd is not None, f"{topic} is in the frame {odd!r}: wanted are east-north-up and forward-left-up (REP 103, "
         "docs/ros.md#frames)"),
        (len(frames) > 1, f"{topic} is in several frames: {', '.join(frames)}"),
    )  # fmt: skip
    spread = np.array([(m.pose.covariance[0], m.pose.covariance[35], m.twist.covariance[35]) for m in odometry])
    x, y, z, w = quaternion = np.array(
        [(q.x, q.y, q.z, q.w) for q in (m.pose.pose.orientation for m in odometry)], dtype=float
    ).T
    length = np.sqrt((quaternion**2).sum(axis=0))
    judge(LogError, lambda k: f"message {k + 1} of {topic}", *((bad, lambda k, told=told: (
        f"has {told.format(spread[k], length[k])}: give a topic that has one by --columns"
    )) for bad, told in (
        (spread[:, 0] < 0, "no position: its covariance begins with {0[0]:g}"),
        (length == 0, "no orientation: its quaternion is 0"),
        ((spread[:, 1] < 0) | (spread[:, 1] > FULL_TURN**2), "no orientation: its yaw has the variance {0[1]:g} rad^2"),
        ((spread[:, 2] < 0) | (spread[:, 2] > FULL_TURN**2), "no yaw rate: its variance is {0[2]:g} rad^2/s^2"),
        (~(np.abs(length - 1) < UNIT), "no orientation: its quaternion has the length {1:.3g} in place of 1"),
        (~(x * x + y * y < z * z + w * w), "no orientation (or w first): by its quaternion the vessel lies capsized"),
    )))  # fmt: skip
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    east, north = np.array([(m.pose.pose.position.x, m.pose.pose.position.y) for m in odometry]).T
    return north, east, 0.5 * np.pi - yaw, -np.array([m.twist.twist.angular.z for m in odometry])


def _named(topic: str, name: str, messages: list[Any]) -> Array:
    """Values of action `name` in messages that hold all actions of a vehicle; LogError if a message lacks it."""
    names = [list(message.name) for message in messages]
    lacks = [name not in own or len(m.position) != len(own) for own, m in zip(names, messages, strict=True)]
    told = f"has no position of {name}; it has"
    judge(LogError, lambda k: f"message {k + 1} of {topic}", (lacks, lambda k: f"{told} {', '.join(names[k])}"))
    return np.array([m.position[own.index(name)] for own, m in zip(names, messages, strict=True)], dtype=np.float64)
