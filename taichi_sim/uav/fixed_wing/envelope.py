"""Airspeeds and load factors within which a fixed-wing aircraft flies: its V-n diagram."""

import math
from typing import NamedTuple

import numpy as np

from taichi_sim.conventions import GRAVITY
from taichi_sim.uav.fixed_wing.equations import lift_curve, stall_angles
from taichi_sim.uav.fixed_wing.params import FixedWingParams


class FlightEnvelope(NamedTuple):
    """Airspeeds (m/s) and load factors (1) that bound the flight."""

    C_L_max: float
    C_L_min: float
    stall: float  # at n = 1
    corner: float  # where the wing first reaches n_max
    inverted_corner: float  # where it first reaches n_min
    top: float
    n_max: float
    n_min: float

    def largest(self, Va):
        """Largest load factor at Va."""
        return np.minimum(self.n_max * (np.asarray(Va) / self.corner) ** 2, self.n_max)

    def least(self, Va):
        """Least load factor at Va."""
        return np.maximum(self.n_min * (np.asarray(Va) / self.inverted_corner) ** 2, self.n_min)


def flight_envelope(p: FixedWingParams) -> FlightEnvelope:
    """The V-n diagram's bounds, elevator at zero: n = 0.5 rho Va^2 S C_L / (m g)."""
    C_L_min, C_L_max = (float(x) for x in lift_curve(p, stall_angles(p)))
    body, limits = p.physical, p.envelope

    def airspeed(n: float, C_L: float) -> float:
        return math.sqrt(2 * n * body.mass * GRAVITY / (body.rho * body.S * C_L))

    return FlightEnvelope(
        C_L_max,
        C_L_min,
        airspeed(1.0, C_L_max),
        airspeed(limits.n_max, C_L_max),
        airspeed(limits.n_min, C_L_min),
        limits.max_airspeed,
        limits.n_max,
        limits.n_min,
    )
