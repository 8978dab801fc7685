"""Bags of ROS 2 as logs, by `rosbags`: a folder of rosbag2, or an .mcap file. Topics and frames: docs/ros.md.

Pose and yaw rate come from `/NAME/odom` (nav_msgs/Odometry in ENU, body forward-left-up), the commands from
`/NAME/actions` (sensor_msgs/JointState: an action's name, and its value from -1 to 1 as `position`). Where columns are
given, `odom` names another topic of odometry, and an action a topic whose messages have a number as `data` (std_msgs
Float32, Float64). Each command holds from its time on; its mean over the interval after a
message of odometry is taken.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taichi_sim.config.base import MissingExtraError
from taichi_sim.fit.table import CHANNELS, Array, LogError, Source, Table, held_means

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader

ODOMETRY, COMMANDS = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
NS = 1e-9


def read_bag(path: Path, action_names: tuple[str, ...], source: Source) -> Table:
    """The table of one vehicle in a bag.

    Raises:
        LogError: for what is no bag, or lacks a topic.
        MissingExtraError: without `rosbags`.
    """
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise MissingExtraError("rosbags", "ros") from None
    if path.suffix == ".db3":
        raise LogError(f"{path}: name the folder of this bag, with its metadata.yaml")
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            return _table(path, bag, action_names, source)
    except (AnyReaderError, OSError) as error:
        raise LogError(f"{path}: this is no bag of ROS 2 that can be read: {error}") from None


def _table(path: Path, bag: "AnyReader", action_names: tuple[str, ...], source: Source) -> Table:
    kinds = {c.topic: c.msgtype for c in bag.connections}
    odom = _odometry(path, kinds, source)
    near = odom.removesuffix("/odom")
    given = {name: source.columns[name] for name in action_names if name in source.columns}
    wanted = {odom, *(column.source for column in given.values())}
    if len(given) < len(action_names):
        wanted.add(f"{near}/actions")
    if missing := sorted(wanted - set(kinds)):
        raise LogError(f"{path}: no topic {missing[0]}; it has {', '.join(sorted(kinds))}. Actions are read from "
                       f"{near}/actions ({COMMANDS}), or from topics that --columns names")  # fmt: skip
    read = {topic: _messages(bag, topic) for topic in wanted}
    stamped = all(hasattr(messages[0], "header") for _, messages in read.values() if messages)

    def times(topic: str) -> Array:
        """Stamps of the headers, if all have one: else when each message was recorded, by one clock. s"""
        received, messages = read[topic]
        if not stamped:
            return received
        return np.array([m.header.stamp.sec + NS * m.header.stamp.nanosec for m in messages])

    for topic, (_, messages) in read.items():
        if not messages:
            raise LogError(f"{path}: {topic} has no messages")
    t, poses = times(odom), read[odom][1]
    columns: dict[str, Array] = dict(zip(CHANNELS, _motion(poses), strict=True))
    begin = t[0]
    for name in action_names:
        topic = given[name].source if name in given else f"{near}/actions"
        at, messages = times(topic), read[topic][1]
        if name in given:
            if not hasattr(messages[0], "data"):
                raise LogError(f"{path}: {topic} is {kinds[topic]}: an action's topic has a number as data")
            values = given[name].factor * np.array([float(m.data) for m in messages])
        else:
            values = _named(path, topic, name, messages)
        columns[name], begin = held_means(at, values, t, np.r_[t[1:], t[-1] + 1.0]), max(begin, at[0])
    kept = np.flatnonzero(t >= begin - 1e-9)  # before the first command nobody knows what was commanded
    if len(kept) < 3:
        raise LogError(f"{path}: {len(kept)} messages of {odom} after the first command: at least 3 are wanted")
    columns = {"t": t - t[kept[0]], **columns}
    return Table({name: x[kept] for name, x in columns.items()}, lambda k: f"message {kept[k] + 1} of {odom}")


def _odometry(path: Path, kinds: Mapping[str, str | None], source: Source) -> str:
    """The topic of odometry; LogError if there is none, or if it is not clear which."""
    if "odom" in source.columns:
        return source.columns["odom"].source
    found = sorted(topic for topic, kind in kinds.items() if kind == ODOMETRY and topic.endswith("/odom"))
    if source.name:
        found = [topic for topic in found if topic == f"/{source.name}/odom"]
    if len(found) != 1:
        has = ", ".join(topic.removesuffix("/odom").removeprefix("/") for topic in found)
        told = f"it has {has}: choose by --name" if found else f"it has {', '.join(sorted(kinds))}"
        raise LogError(f"{path}: wanted is one topic /NAME/odom ({ODOMETRY}); {told}")
    return found[0]


def _messages(bag: "AnyReader", topic: str) -> tuple[Array, list[Any]]:
    """When the messages of a topic were recorded, s, and the messages."""
    found = [
        (NS * stamp, bag.deserialize(data, connection.msgtype))
        for connection, stamp, data in bag.messages([c for c in bag.connections if c.topic == topic])
    ]
    return np.array([stamp for stamp, _ in found]), [message for _, message in found]


def _motion(poses: list[Any]) -> tuple[Array, Array, Array, Array]:
    """North, east (m), heading (rad, clockwise from north), yaw rate (rad/s, bow to starboard) of odometry in ENU."""
    places, turns = [m.pose.pose.position for m in poses], [m.pose.pose.orientation for m in poses]
    x, y, z, w = np.array([(q.x, q.y, q.z, q.w) for q in turns]).T
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    east, north = np.array([(p.x, p.y) for p in places]).T
    return north, east, 0.5 * np.pi - yaw, -np.array([m.twist.twist.angular.z for m in poses])


def _named(path: Path, topic: str, name: str, messages: list[Any]) -> Array:
    """Values of action `name` in messages that hold all actions of a vehicle; LogError if a message lacks it."""
    values = np.empty(len(messages))
    for k, message in enumerate(messages):
        names = list(message.name)
        if name not in names or len(message.position) != len(names):
            raise LogError(f"{path}: message {k + 1} of {topic} has no position of {name}; it has {', '.join(names)}")
        values[k] = message.position[names.index(name)]
    return values
