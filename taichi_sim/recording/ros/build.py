"""Builds the common parts of messages as classes of a `rosbags` typestore."""

from collections.abc import Sequence
from typing import Any

from taichi_sim.recording.ros.topics import NS

XYZ = Sequence[float]


class Builder:
    """Builds messages; quaternions are (x, y, z, w)."""

    def __init__(self, typestore: Any):
        """Use the types of `typestore` (rosbags.typesys)."""
        self._types = typestore.types

    def make(self, kind: str, *fields: Any) -> Any:
        """A message of a type, its fields in their order."""
        return self._types[kind](*fields)

    def time(self, stamp_ns: int) -> Any:
        """A Time."""
        return self.make("builtin_interfaces/msg/Time", *divmod(stamp_ns, NS))

    def header(self, time: Any, frame: str) -> Any:
        """A Header."""
        return self.make("std_msgs/msg/Header", time, frame)

    def vector(self, xyz: XYZ) -> Any:
        """A Vector3."""
        return self.make("geometry_msgs/msg/Vector3", *xyz)

    def quaternion(self, xyzw: XYZ) -> Any:
        """A Quaternion."""
        return self.make("geometry_msgs/msg/Quaternion", *xyzw)

    def pose(self, xyz: XYZ, xyzw: XYZ) -> Any:
        """A Pose."""
        return self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", *xyz), self.quaternion(xyzw))

    def twist(self, linear: XYZ, angular: XYZ) -> Any:
        """A Twist."""
        return self.make("geometry_msgs/msg/Twist", self.vector(linear), self.vector(angular))

    def pose_stamped(self, header: Any, xyz: XYZ, xyzw: XYZ) -> Any:
        """A PoseStamped."""
        return self.make("geometry_msgs/msg/PoseStamped", header, self.pose(xyz, xyzw))

    def transform(self, header: Any, child: str, xyz: XYZ, xyzw: XYZ) -> Any:
        """A TransformStamped: the pose of the frame `child` in the header's."""
        turn = self.make("geometry_msgs/msg/Transform", self.vector(xyz), self.quaternion(xyzw))
        return self.make("geometry_msgs/msg/TransformStamped", header, child, turn)
