"""Control surfaces and throttle follow their commands with a first-order lag, a rate limit and saturation.

Deflections are packed as delta = (elevator, aileron, rudder, throttle): three in rad, the throttle from 0 to 1.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Annotated

import taichi as ti
import torch
from pydantic import Field

from taichi_sim.config import NonNegative, Strict
from taichi_sim.vehicle import Number

DEG = math.pi / 180.0
Limit = Annotated[float, Field(gt=0, le=90)]


class Actuators(Strict):
    """Parameters of the servos and of the motor's response."""

    time_constant: NonNegative  # of the servos, s; 0: they follow at once
    rate_limit_deg: Annotated[float, Field(gt=0)]  # of the servos, deg/s; inf is no limit
    elevator_limit_deg: Limit  # largest deflection to either side, deg
    aileron_limit_deg: Limit
    rudder_limit_deg: Limit
    throttle_time_constant: NonNegative  # s; 0: thrust follows at once

    @property
    def lower(self) -> tuple[float, float, float, float]:
        """Smallest delta (rad, rad, rad, 1)."""
        return -self.elevator_limit_deg * DEG, -self.aileron_limit_deg * DEG, -self.rudder_limit_deg * DEG, 0.0

    @property
    def upper(self) -> tuple[float, float, float, float]:
        """Largest delta (rad, rad, rad, 1)."""
        return self.elevator_limit_deg * DEG, self.aileron_limit_deg * DEG, self.rudder_limit_deg * DEG, 1.0

    def max_change(self, k: int, dt: float) -> float:
        """Largest change of actuator k in a step dt (s); inf for the throttle."""
        return math.inf if k == 3 else self.rate_limit_deg * DEG * dt


def lag(tau: Number, dt: float) -> tuple[Number, Number]:
    """Response of a first-order actuator with time constant tau (s; 0 is ideal) over a step dt (s).

    Returns:
        gone: fraction of the change to the command that is made by the end of the step, 1 - exp(-dt / tau).
        kept: fraction of that change by which the mean over the step falls short of the end.

    Both are floats, or tensors of the shape of tau.
    """
    t = torch.as_tensor(tau, dtype=torch.float64)
    gone = -torch.expm1(-dt / t)
    kept = t / dt - (1.0 - gone) / gone
    return (gone, kept) if isinstance(tau, torch.Tensor) else (float(gone), float(kept))


@ti.func
def advance(servos: ti.template(), p: ti.template(), dt: ti.template(), delta, command):
    """Deflections after a step dt (s) toward `command`, and their means over the step.

    The mean is exact for a lag whose command is held, so forces in the step are second order in dt. The limits are
    those of `servos` (Actuators), the lags those of p (FixedWingNumbers).
    """
    new, mean = delta, delta
    gone = ti.Vector([p.servo_gone, p.servo_gone, p.servo_gone, p.motor_gone])
    kept = ti.Vector([p.servo_kept, p.servo_kept, p.servo_kept, p.motor_kept])
    for k in ti.static(range(4)):
        wanted = ti.max(ti.min(command[k], ti.static(servos.upper[k])), ti.static(servos.lower[k]))
        change = (wanted - delta[k]) * gone[k]
        if ti.static(math.isfinite(servos.max_change(k, dt))):
            change = ti.max(ti.min(change, ti.static(servos.max_change(k, dt))), ti.static(-servos.max_change(k, dt)))
        new[k] = delta[k] + change
        mean[k] = new[k] - kept[k] * change
    return new, mean
