"""Conversion from n (north-east-down) to the (east, north, up) = (y, x, -z) of recordings. No other module does it.

In rerun, bodies keep their own frame b (forward-right-down), so the logged attitude is R_enu,b = P R_nb, where P is the
half turn about (1, 1, 0) that swaps the two worlds. In bags (ros/) bodies are forward-left-up: b after a half turn
about its forward axis, R_enu,flu = P R_nb F, F = diag(1, -1, -1).
"""

import numpy as np
from numpy.typing import DTypeLike, NDArray

from taichi_sim.conventions import DOWN, EAST, NORTH

Array = NDArray[np.floating]


def enu(vector_n: Array, dtype: DTypeLike = np.float32) -> Array:
    """Vectors [..., 3] in n (north, east, down), as (east, north, up)."""
    return np.ascontiguousarray(np.stack([vector_n[..., EAST], vector_n[..., NORTH], -vector_n[..., DOWN]], -1), dtype)


def enu_quaternion(quaternion_nb: Array, dtype: DTypeLike = np.float32) -> Array:
    """Quaternions [..., 4] (w, x, y, z) body to NED, as (x, y, z, w) body to ENU: P q, P = (0, 1, 1, 0) / sqrt 2."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion_nb, dtype=np.float64), -1, 0)
    return np.ascontiguousarray(np.stack([w + z, w - z, y - x, -x - y], -1) * np.sqrt(0.5), dtype)


def flu(vector_b: Array) -> Array:
    """Vectors [..., 3] in b (forward, right, down), as (forward, left, up), float64."""
    return np.asarray(vector_b, dtype=np.float64) * (1.0, -1.0, -1.0)


def enu_flu_quaternion(quaternion_nb: Array) -> Array:
    """Quaternions [..., 4] (w, x, y, z) b to NED, as (x, y, z, w) forward-left-up to ENU, float64: -P q F."""
    x, y, z, w = np.moveaxis(enu_quaternion(quaternion_nb, np.float64), -1, 0)
    return np.stack([-w, -z, y, x], -1)


def level_quaternion(course: Array) -> Array:
    """Quaternions [..., 4] (x, y, z, w), to ENU, of a level body that points along `course` [...] (rad)."""
    half = 0.5 * np.asarray(course, dtype=np.float64)
    return enu_quaternion(np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1))


def map_point(vector_n: Array) -> NDArray[np.float32]:
    """Points [..., 2 or 3] in n, as (east, south), for a map whose second axis points down the screen."""
    return np.ascontiguousarray(np.stack([vector_n[..., EAST], -vector_n[..., NORTH]], -1), np.float32)


def euler(quaternion_nb: Array) -> tuple[Array, Array, Array]:
    """Roll, pitch and heading (rad) [...] of quaternions [..., 4] (w, x, y, z)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion_nb, dtype=np.float64), -1, 0)
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, heading
