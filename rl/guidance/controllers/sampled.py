"""Gains and inverses for vehicles whose command is held over a decision interval, exact at the decisions.

PhysX integrates a rate x' under the acceleration a with `damping` (1/s) by n steps of dt,

    x' <- (x' + a dt) kappa,   x <- x + x' dt,   kappa = 1 - damping dt,

so that over a decision interval, with a held, x' <- keep x' + gain a and x <- x + reach x' + push a.
"""

import math
from typing import NamedTuple


class Held(NamedTuple):
    """One decision interval of x and its rate under a held acceleration."""

    keep: float  # of the rate
    gain: float  # rate per acceleration, s
    reach: float  # of x per rate, s
    push: float  # of x per acceleration, s^2


def held(dt: float, substeps: int, damping: float = 0.0) -> Held:
    """The decision interval of `substeps` PhysX steps of `dt` (s) each, with `damping` (1/s)."""
    keep, gain, reach, push = 1.0, 0.0, 0.0, 0.0
    for _ in range(substeps):
        keep, gain = keep * (1 - damping * dt), (gain + dt) * (1 - damping * dt)
        reach, push = reach + keep * dt, push + gain * dt
    return Held(keep, gain, reach, push)


def place_poles(plant: Held, bandwidth: float, interval: float) -> tuple[float, float]:
    """Gains (k_x 1/s^2, k_rate 1/s) of a = -k_x x - k_rate x' that put both poles at p = exp(-bandwidth interval).

    From trace 2p and determinant p^2 of the closed loop; `bandwidth` in rad/s, `interval` in s.
    """
    p = math.exp(-bandwidth * interval)
    k_x = (1 - p) ** 2 / (plant.push * (1 - plant.keep) + plant.reach * plant.gain)
    return k_x, (1 + plant.keep - 2 * p - plant.push * k_x) / plant.gain


def decaying(interval: float, damping: float) -> Held:
    """The exact interval (s) of a rate that decays with `damping` (1/s): x'' = a - damping x'."""
    if damping == 0.0:
        return Held(1.0, interval, interval, interval**2 / 2)
    keep = math.exp(-damping * interval)
    gain = (1 - keep) / damping
    return Held(keep, gain, gain, (interval - gain) / damping)
