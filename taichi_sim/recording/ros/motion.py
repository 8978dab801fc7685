"""One team's motion by ROS's conventions (REP 103, REP 145), float64: world east-north-up, bodies forward-left-up.

    specific force  f = R^T (dv/dt - g),   g = (0, 0, -9.81) m/s^2 in east-north-up

so that an accelerometer at rest reads +9.81 upwards. dv/dt is the central difference of the recorded velocity: a mean
over two intervals, which filters out faster vibration.
"""

from typing import NamedTuple

import numpy as np

from taichi_sim.conventions import GRAVITY
from taichi_sim.recording.episode import TeamTrack
from taichi_sim.recording.frames import Array, enu, enu_flu_quaternion, flu


class RosMotion(NamedTuple):
    """Motion [T, V, ...] of a team's vehicles, and their slots and target if these are known."""

    position: Array  # [T, V, 3] m, map
    orientation: Array  # [T, V, 4] (x, y, z, w), base_link to map
    velocity: Array  # [T, V, 3] m/s, base_link
    angular_velocity: Array  # [T, V, 3] rad/s, base_link
    specific_force: Array  # [T, V, 3] m/s^2, base_link
    slot: Array | None  # [T, V, 3] m, map
    target: Array | None  # [T, 3] m, map
    course: Array  # [T, 4] (x, y, z, w), a level body that points along the team's course


def motion_of(team: TeamTrack, time_s: Array) -> RosMotion:
    """Motion of a team at times `time_s` [T]."""
    orientation = _continuous(enu_flu_quaternion(team.quaternion_nb))
    velocity = enu(team.velocity_n, np.float64)
    acceleration = _rate(velocity, time_s) + (0.0, 0.0, GRAVITY)
    angular = team.angular_velocity_b
    return RosMotion(
        position=enu(team.position_n, np.float64),
        orientation=orientation,
        velocity=into_body(orientation, velocity),
        angular_velocity=_turning(orientation, time_s) if angular is None else flu(angular),
        specific_force=into_body(orientation, acceleration),
        slot=None if team.slot_n is None else enu(team.slot_n, np.float64),
        target=None if team.target_n is None else enu(team.target_n, np.float64),
        course=_level(team.course),
    )


def _level(course: Array) -> Array:
    """Quaternions [..., 4] of a level body that points along a course (rad, clockwise from north)."""
    half = 0.5 * (0.5 * np.pi - np.asarray(course, dtype=np.float64))
    return np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], axis=-1)


def into_body(orientation: Array, vector: Array) -> Array:
    """World vectors [..., 3] in the body with orientation [..., 4] (x, y, z, w): v - 2w (q x v) + 2 q x (q x v)."""
    q, w = orientation[..., :3], orientation[..., 3:]
    across = 2 * np.cross(q, vector)
    return vector - w * across + np.cross(q, across)


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
