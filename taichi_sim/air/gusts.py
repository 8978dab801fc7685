"""Discrete gusts of the one-minus-cosine form. U is the amplitude (a vector), H the length from zero to the peak.

    pulse (14 CFR 25.341(a)(2)):     U/2 (1 - cos(pi s / H)) for 0 <= s <= 2H, else 0
    ramp (MIL-F-8785C, 3.7.1.3):     U/2 (1 - cos(pi s / H)) for 0 <= s <= H, then U

s is how far the aircraft has penetrated the gust: a distance (m) or a time (s). H has the same unit.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Literal, NamedTuple

import taichi as ti

from taichi_sim.config import GustConfig
from taichi_sim.kernels import fast

Shape = Literal["pulse", "ramp"]


class Gust(NamedTuple):
    """A gust reduced to numbers: s = rate t + north x + east y - offset, in units of H; the peak is at s = 1.

    Attributes:
        amplitude: NED, m/s.
        rate: 1/s.
        north, east: 1/m.
    """

    amplitude: tuple[float, float, float]
    shape: Shape
    rate: float
    north: float
    east: float
    offset: float

    @classmethod
    def of(cls, config: GustConfig) -> "Gust":
        """Convert the gust of a configuration."""
        if config.start_time is not None and config.rise_time is not None:
            rate, offset = 1 / config.rise_time, config.start_time / config.rise_time
            return cls(config.amplitude, config.shape, rate, 0.0, 0.0, offset)
        assert config.length is not None and config.direction_deg is not None  # GustConfig ensures it
        assert config.start_north is not None and config.start_east is not None
        direction = math.radians(config.direction_deg)
        north, east = math.cos(direction) / config.length, math.sin(direction) / config.length
        offset = north * config.start_north + east * config.start_east
        return cls(config.amplitude, config.shape, 0.0, north, east, offset)


@ti.func
def one_minus_cosine(shape: ti.template(), s):
    """Fraction of the amplitude, 0 to 1, at s (in units of H)."""
    end = ti.static(2.0 if shape == "pulse" else 1.0)
    half = ti.min(ti.max(s, 0.0), end) * ti.static(0.5 * math.pi)  # in [0, pi]; (1 - cos 2x) / 2 = sin^2 x
    sine = fast.sin(half)
    return sine * sine


@ti.func
def gust_velocity(gust: ti.template(), position, time):
    """Air velocity (NED, m/s) of a `Gust` at a position (NED, m) and a time (s)."""
    s = gust.rate * time + gust.north * position[0] + gust.east * position[1] - gust.offset
    factor = one_minus_cosine(gust.shape, s)
    a = ti.static(gust.amplitude)
    return ti.Vector([factor * a[0], factor * a[1], factor * a[2]])
