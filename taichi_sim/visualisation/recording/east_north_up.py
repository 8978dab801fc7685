"""Conversion from n (north-east-down) to the (east, north, up) = (y, x, -z) of recordings. No other module does it.

In rerun, bodies keep their own frame b (forward-right-down), so the logged attitude is R_enu,b = P R_nb, where P is the
half turn about (1, 1, 0) that swaps the two worlds. In bags (ros/) bodies are forward-left-up: b after a half turn
about its forward axis, R_enu,flu = P R_nb F, F = diag(1, -1, -1).

Latitude and longitude are of positions in east-north-up on the plane that touches the WGS-84 ellipsoid at an origin, as
in GeographicLib's LocalCartesian and ROS's navsat tools. A position in Earth-centred coordinates is

    x = ((N + h) cos phi cos lambda, (N + h) cos phi sin lambda, (N (1 - e^2) + h) sin phi),
    N = a / sqrt(1 - e^2 sin^2 phi).

That of the origin is moved by east, north and up. The result is made geodetic again by Bowring's iteration (Survey
Review 23, 1976) of the reduced latitude beta; three steps leave less than 1e-8 m:

    tan phi = (z + e'^2 b sin^3 beta) / (p - e^2 a cos^3 beta),   tan beta = (1 - f) tan phi.

The simulated sea is that plane. Far from the origin its level therefore rises above the ellipsoid by d^2 / 2R: 8 cm at
1 km. Heights are above the ellipsoid, not above the geoid.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from taichi_sim.kernels.conventions import DOWN, EAST, NORTH

Array = NDArray[np.floating]
EARTH_A = 6378137.0  # m, semi-major axis of WGS-84
EARTH_F = 1 / 298.257223563  # flattening of WGS-84
EARTH_B = EARTH_A * (1 - EARTH_F)
EARTH_E2 = EARTH_F * (2 - EARTH_F)  # first eccentricity, squared
BOWRING_STEPS = 3


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
    """Quaternions [..., 4] (w, x, y, z) b to NED, as (x, y, z, w) forward-left-up to ENU, float64: -P q EARTH_F."""
    x, y, z, w = np.moveaxis(enu_quaternion(quaternion_nb, np.float64), -1, 0)
    return np.stack([-w, -z, y, x], -1)


def into_body(orientation: Array, vector: Array) -> Array:
    """World vectors [..., 3] in the body with orientation [..., 4] (x, y, z, w): v - 2w (q x v) + 2 q x (q x v)."""
    q, w = orientation[..., :3], orientation[..., 3:]
    across = 2 * np.cross(q, vector)
    return vector - w * across + np.cross(q, across)


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


class Origin(NamedTuple):
    """Geodetic position of the world's origin, at mean sea level."""

    latitude: float  # deg, north
    longitude: float  # deg, east


FJORD = Origin(63.48, 10.40)  # in the Trondheimsfjord, off Munkholmen


def ecef(latitude: Array, longitude: Array, height: Array) -> Array:
    """Earth-centred, Earth-fixed coordinates (m) [..., 3] of geodetic coordinates (rad, rad, m)."""
    normal = EARTH_A / np.sqrt(1 - EARTH_E2 * np.sin(latitude) ** 2)
    level = (normal + height) * np.cos(latitude)
    up = (normal * (1 - EARTH_E2) + height) * np.sin(latitude)
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), up], axis=-1)


def _tangent(origin: Origin) -> tuple[Array, Array]:
    """Earth-centred place [3] (m) of an origin, and its axes east, north, up, as rows [3, 3]."""
    phi, lam = np.radians(origin)
    sin, cos, sin_l, cos_l = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
    axes = np.array([[-sin_l, cos_l, 0.0], [-sin * cos_l, -sin * sin_l, cos], [cos * cos_l, cos * sin_l, sin]])
    return ecef(phi, lam, np.zeros(())), axes


def from_geodetic(place: Array, origin: Origin) -> Array:
    """Positions [..., 3] (east, north, up, m) of latitude, longitude (deg), height (m) [..., 3]."""
    latitude, longitude, height = np.moveaxis(np.asarray(place, dtype=np.float64), -1, 0)
    there, axes = _tangent(origin)
    return (ecef(np.radians(latitude), np.radians(longitude), height) - there) @ axes.T


def geodetic(enu_m: Array, origin: Origin) -> Array:
    """Latitude, longitude (deg, -180 to 180), height (m) [..., 3] of positions [..., 3] (east, north, up, m)."""
    place, axes = _tangent(origin)
    x, y, z = np.moveaxis(place + np.asarray(enu_m, dtype=np.float64) @ axes, -1, 0)
    p = np.hypot(x, y)
    beta = np.arctan2(z, (1 - EARTH_F) * p)
    latitude = beta
    for _ in range(BOWRING_STEPS):
        latitude = np.arctan2(
            z + EARTH_E2 / (1 - EARTH_E2) * EARTH_B * np.sin(beta) ** 3, p - EARTH_E2 * EARTH_A * np.cos(beta) ** 3
        )
        beta = np.arctan2((1 - EARTH_F) * np.sin(latitude), np.cos(latitude))
    level = EARTH_A * np.sqrt(1 - EARTH_E2 * np.sin(latitude) ** 2)
    height = p * np.cos(latitude) + z * np.sin(latitude) - level
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), height], axis=-1)
