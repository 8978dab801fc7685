"""Control surfaces and throttle that follow their commands: first-order lag, rate limit, saturation.

Deflections are packed as delta = (elevator, aileron, rudder, throttle): rad, and a fraction of full throttle.
"""

import math
from typing import Annotated

import taichi as ti
from pydantic import Field

from taichi_sim.config import NonNegative, Strict

DEG = math.pi / 180.0
Limit = Annotated[float, Field(gt=0, le=90)]


class Actuators(Strict):
    """Numbers of the servos and of the motor's response."""

    time_constant: NonNegative  # of the servos, s; 0 is ideal
    rate_limit_deg: Annotated[float, Field(gt=0)]  # of the servos, deg/s; inf is no limit
    elevator_limit_deg: Limit  # either way, deg
    aileron_limit_deg: Limit
    rudder_limit_deg: Limit
    throttle_time_constant: NonNegative  # s; 0 is ideal

    @property
    def lower(self) -> tuple[float, float, float, float]:
        """Smallest delta (rad, rad, rad, 1)."""
        return -self.elevator_limit_deg * DEG, -self.aileron_limit_deg * DEG, -self.rudder_limit_deg * DEG, 0.0

    @property
    def upper(self) -> tuple[float, float, float, float]:
        """Largest delta (rad, rad, rad, 1)."""
        return self.elevator_limit_deg * DEG, self.aileron_limit_deg * DEG, self.rudder_limit_deg * DEG, 1.0

    def lag(self, k: int, dt: float) -> tuple[float, float]:
        """Of actuator k over a step dt (s): the part of the way to its command that it goes, 1 - exp(-dt/tau), and
        the weight of the old deflection in the mean over the step (0 for an ideal one).
        """
        tau = self.throttle_time_constant if k == 3 else self.time_constant
        if tau == 0:
            return 1.0, 0.0
        gone = -math.expm1(-dt / tau)
        return gone, tau / dt - (1.0 - gone) / gone

    def max_change(self, k: int, dt: float) -> float:
        """Largest change of actuator k in a step dt (s); inf for the throttle."""
        return math.inf if k == 3 else self.rate_limit_deg * DEG * dt


@ti.func
def advance(p: ti.template(), dt: ti.template(), delta, command):
    """Deflections after a step dt (s) toward `command`, and their means over the step: exact for a lag whose command
    is held, so that what the step feels is right to second order in dt.
    """
    new, mean = delta, delta
    for k in ti.static(range(4)):
        gone, old_part = ti.static(p.lag(k, dt))
        wanted = ti.max(ti.min(command[k], ti.static(p.upper[k])), ti.static(p.lower[k]))
        change = (wanted - delta[k]) * gone
        if ti.static(math.isfinite(p.max_change(k, dt))):
            change = ti.max(ti.min(change, ti.static(p.max_change(k, dt))), ti.static(-p.max_change(k, dt)))
        new[k] = delta[k] + change
        mean[k] = new[k] - old_part * change
    return new, mean
