"""From the world frame n (north-east-down) to rerun's (east, north, up) = (y, x, -z). Nowhere else.

Bodies keep their own frame b (forward-right-down), so the attitude logged is R_enu,b = P R_nb, with P the
half turn about (1, 1, 0) that swaps the two worlds.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


def enu(vector_n: Array) -> NDArray[np.float32]:
    """[..., 3] of n (north, east, down) as (east, north, up)."""
    return np.ascontiguousarray(np.stack([vector_n[..., 1], vector_n[..., 0], -vector_n[..., 2]], -1), np.float32)


def enu_quaternion(quaternion_nb: Array) -> NDArray[np.float32]:
    """[..., 4] (w, x, y, z) body to NED as (x, y, z, w) body to ENU: P q, P = (0, 1, 1, 0) / sqrt 2."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion_nb, dtype=np.float64), -1, 0)
    return np.ascontiguousarray(np.stack([w + z, w - z, y - x, -x - y], -1) * np.sqrt(0.5), np.float32)


def level_quaternion(course: Array) -> NDArray[np.float32]:
    """[..., 4] (x, y, z, w) of a level body that points along a course (rad), to ENU."""
    half = 0.5 * np.asarray(course, dtype=np.float64)
    return enu_quaternion(np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1))


def map_point(vector_n: Array) -> NDArray[np.float32]:
    """[..., 2 or 3] of n as (east, south), for a map whose second axis points down the screen."""
    return np.ascontiguousarray(np.stack([vector_n[..., 1], -vector_n[..., 0]], -1), np.float32)


def euler(quaternion_nb: Array) -> tuple[Array, Array, Array]:
    """Roll, pitch and heading, rad, of [..., 4] (w, x, y, z)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion_nb, dtype=np.float64), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, heading
