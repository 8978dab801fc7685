"""Power of a multirotor's rotors, and momentum theory's air through them."""

import math

import numpy as np

from taichi_sim.uav.multirotor.allocation import allocation
from taichi_sim.uav.multirotor.params import MultirotorParams


def shaft_power(p: MultirotorParams, omega: np.ndarray) -> float:
    """What rotors at speeds omega [rotor] (rad/s) take from their shafts, W."""
    return float(sum(mount.gain * p.rotor.k_m * w**3 for mount, w in zip(p.rotors, omega, strict=True)))


def induced_velocity(p: MultirotorParams) -> float:
    """Of the air through the rotors' discs in hover, by momentum theory, m/s."""
    area = math.pi * p.rotor.radius**2 * len(p.rotors)
    weight = allocation(p).weight  # pyright: ignore[reportArgumentType]
    return math.sqrt(weight / (2 * p.physical.rho * area))
