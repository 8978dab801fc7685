"""Names, types and stamps of a bag. Topics and frames are listed in docs/ros.md."""

import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from taichi_sim.recording.frames import Array

if TYPE_CHECKING:
    from rosbags.typesys.store import Msg

NS = 1_000_000_000
EPOCH_S = 1_000_000_000  # s, stamp of time 0 (2001-09-09 01:46:40 UTC), because a stamp of 0 means "no time" to ROS
MAP, BODY = "map", "base_link"


class Topic(NamedTuple):
    """A topic of a bag."""

    name: str
    type: str
    latched: bool = False  # late subscribers receive the last message


class Sent(NamedTuple):
    """One message of a topic."""

    topic: Topic
    stamp_ns: int
    message: "Msg"


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
