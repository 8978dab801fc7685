"""Latitude, longitude and height of positions in the local frame, east-north-up on the plane that touches the WGS-84
ellipsoid at an origin, as in GeographicLib's LocalCartesian and ROS's navsat tools.

A position in Earth-centred coordinates is

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

from taichi_sim.recording.frames import Array

A = 6378137.0  # m, semi-major axis of WGS-84
F = 1 / 298.257223563  # flattening of WGS-84
B = A * (1 - F)
E2 = F * (2 - F)  # first eccentricity, squared
STEPS = 3


class Origin(NamedTuple):
    """Geodetic position of the world's origin, at mean sea level."""

    latitude: float  # deg, north
    longitude: float  # deg, east


FJORD = Origin(63.48, 10.40)  # in the Trondheimsfjord, off Munkholmen


def ecef(latitude: Array, longitude: Array, height: Array) -> Array:
    """Earth-centred, Earth-fixed coordinates (m) [..., 3] of geodetic coordinates (rad, rad, m)."""
    normal = A / np.sqrt(1 - E2 * np.sin(latitude) ** 2)
    level = (normal + height) * np.cos(latitude)
    up = (normal * (1 - E2) + height) * np.sin(latitude)
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), up], axis=-1)


def geodetic(enu_m: Array, origin: Origin) -> Array:
    """Latitude, longitude (deg, -180 to 180), height (m) [..., 3] of positions [..., 3] (east, north, up, m)."""
    phi, lam = np.radians(origin)
    sin, cos, sin_l, cos_l = np.sin(phi), np.cos(phi), np.sin(lam), np.cos(lam)
    axes = np.array([[-sin_l, cos_l, 0.0], [-sin * cos_l, -sin * sin_l, cos], [cos * cos_l, cos * sin_l, sin]])
    x, y, z = np.moveaxis(ecef(phi, lam, np.zeros(())) + np.asarray(enu_m, dtype=np.float64) @ axes, -1, 0)
    p = np.hypot(x, y)
    beta = np.arctan2(z, (1 - F) * p)
    latitude = beta
    for _ in range(STEPS):
        latitude = np.arctan2(z + E2 / (1 - E2) * B * np.sin(beta) ** 3, p - E2 * A * np.cos(beta) ** 3)
        beta = np.arctan2((1 - F) * np.sin(latitude), np.cos(latitude))
    height = p * np.cos(latitude) + z * np.sin(latitude) - A * np.sqrt(1 - E2 * np.sin(latitude) ** 2)
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), height], axis=-1)
