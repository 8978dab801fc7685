"""Control surfaces and throttle follow their commands with a first-order lag, a rate limit and saturation.

Deflections are packed as delta = (elevator, aileron, rudder, throttle): three in rad, the throttle from 0 to 1.

Thrust and torque of the fixed-pitch propeller follow one of two published laws:

- `electric`: propeller and direct-current motor in balance. Thrust and torque coefficients are quadratic in the
  advance ratio J = 2 pi Va / (Omega D); the motor's torque is K_Q ((V_in - K_V Omega) / R - i0) with
  V_in = V_max delta_t. Equal torques give a quadratic equation for the speed Omega (Beard & McLain, Small Unmanned
  Aircraft, addendum on the propeller model, eqs 4.17-4.21; numbers of mavsim_public).
- `disc`: Bernoulli's law for air leaving the disc at k_motor delta_t,
  T = 0.5 rho S_prop C_prop ((k_motor delta_t)^2 - Va^2), Q = k_T_p (k_Omega delta_t)^2 (Beard & McLain 2012,
  sec. 4.3).

Q is the torque that turns the propeller, N m: the airframe feels -Q about its nose. T and Q of either law are
multiplied by `gain`, which is below 1 for a worn propeller or a low battery.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Annotated, Literal

import taichi as ti
import torch
from pydantic import Field

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.kernels.runtime import array2
from taichi_sim.vehicle import Number

DEG = math.pi / 180.0
Limit = Annotated[float, Field(gt=0, le=90)]
TURN = 2.0 * math.pi  # rad
SECONDS_PER_MINUTE = 60.0


class Actuators(Strict):
    """Parameters of the servos and of the motor's response."""

    time_constant: Annotated[NonNegative, Plausible(2e-3, 2.0, "s")]  # of the servos, s; 0: they follow at once
    # of the servos, deg/s; inf is no limit
    rate_limit_deg: Annotated[float, Field(gt=0), Plausible(10.0, math.inf, "deg/s")]
    elevator_limit_deg: Annotated[Limit, Plausible(5.0, 90.0, "deg")]  # largest deflection to either side
    aileron_limit_deg: Annotated[Limit, Plausible(5.0, 90.0, "deg")]
    rudder_limit_deg: Annotated[Limit, Plausible(5.0, 90.0, "deg")]
    throttle_time_constant: Annotated[NonNegative, Plausible(5e-3, 10.0, "s")]  # s; 0: thrust follows at once

    @property
    def lower(self) -> tuple[float, float, float, float]:
        """Smallest delta (rad, rad, rad, 1)."""
        return -self.elevator_limit_deg * DEG, -self.aileron_limit_deg * DEG, -self.rudder_limit_deg * DEG, 0.0

    @property
    def upper(self) -> tuple[float, float, float, float]:
        """Largest delta (rad, rad, rad, 1)."""
        return self.elevator_limit_deg * DEG, self.aileron_limit_deg * DEG, self.rudder_limit_deg * DEG, 1.0

    def rate_limit(self, k: int) -> float:
        """Largest rate of actuator k, rad/s; inf for the throttle."""
        return math.inf if k == 3 else self.rate_limit_deg * DEG


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
def advance(servos: ti.template(), p: ti.template(), delta, command):
    """Deflections after a step toward `command`, and their means over the step.

    The mean is exact for a lag whose command is held, so forces in the step are second order in its length. The
    limits are those of `servos` (Actuators), the lags and the step those of p (FixedWingNumbers).
    """
    new, mean = delta, delta
    gone = ti.Vector([p.servo_gone, p.servo_gone, p.servo_gone, p.motor_gone])
    kept = ti.Vector([p.servo_kept, p.servo_kept, p.servo_kept, p.motor_kept])
    for k in ti.static(range(4)):
        wanted = ti.max(ti.min(command[k], ti.static(servos.upper[k])), ti.static(servos.lower[k]))
        change = (wanted - delta[k]) * gone[k]
        if ti.static(math.isfinite(servos.rate_limit(k))):
            most = ti.static(servos.rate_limit(k)) * p.dt
            change = ti.max(ti.min(change, most), 0.0 - most)
        new[k] = delta[k] + change
        mean[k] = new[k] - kept[k] * change
    return new, mean


class ElectricPropeller(Strict):
    """Parameters of a propeller on an electric motor."""

    law: Literal["electric"]
    D: Annotated[Positive, Plausible(0.03, 0.8, "m", of="physical.b")]  # diameter
    KV_rpm_per_volt: Annotated[Positive, Plausible(20.0, 1e4, "rpm/V")]  # rpm/V: K_V = K_Q = 60 / (2 pi KV), V s/rad
    R_motor: Annotated[Positive, Plausible(5e-4, 5.0, "ohm")]
    i0: Annotated[NonNegative, Plausible(0.02, 50.0, "A")]  # current without load
    V_max: Annotated[Positive, Plausible(1.0, 800.0, "V")]  # voltage at full throttle
    C_T0: Annotated[Finite, Plausible(0.01, 0.5)]
    C_T1: Annotated[Finite, Plausible(-1.0, -3e-3)]
    C_T2: Annotated[Finite, Plausible(-1.0, -3e-3)]
    C_Q0: Annotated[Positive, Plausible(5e-4, 0.05)]
    C_Q1: Annotated[Finite, Plausible(2e-4, 0.2, either=True)]
    C_Q2: Annotated[Finite, Plausible(-0.2, -5e-4)]
    gain: Annotated[NonNegative, Plausible(0.05, 2.0)] = 1.0  # of thrust and torque

    @property
    def K(self) -> float:  # noqa: N802
        """K_V = K_Q, V s/rad or N m/A."""
        return SECONDS_PER_MINUTE / (TURN * self.KV_rpm_per_volt)

    @property
    def thrust_polynomial(self) -> tuple[float, float, float]:
        """Coefficients of Omega^2, Omega Va, Va^2 in the thrust over the air density (N m^3/kg)."""
        D = self.D
        return self.C_T0 * D**4 / TURN**2, self.C_T1 * D**3 / TURN, self.C_T2 * D**2

    @property
    def torque_polynomial(self) -> tuple[float, float, float]:
        """Coefficients of Omega^2, Omega Va, Va^2 in the torque over the air density (N m m^3/kg)."""
        D = self.D
        return self.C_Q0 * D**5 / TURN**2, self.C_Q1 * D**4 / TURN, self.C_Q2 * D**3


class DiscPropeller(Strict):
    """Parameters of a propeller by Bernoulli's law."""

    law: Literal["disc"]
    S_prop: Annotated[Positive, Plausible(1e-3, 0.3, "m^2", of="physical.b^2")]
    C_prop: Annotated[Positive, Plausible(0.1, 2.0)]
    # speed of the air behind the disc at full throttle
    k_motor: Annotated[Positive, Plausible(0.8, 8.0, "m/s", of="envelope.airspeed")]
    k_T_p: Annotated[NonNegative, Plausible(1e-9, 1e-3, "N m s^2")]  # N m s^2  # noqa: N815
    k_Omega: Annotated[NonNegative, Plausible(20.0, 5000.0, "rad/s")]  # rad/s  # noqa: N815
    gain: Annotated[NonNegative, Plausible(0.05, 2.0)] = 1.0  # of thrust and torque


@ti.func
def electric_thrust_torque(propeller: ti.template(), rho, Va, delta_t):
    """(T, N; Q, N m) of an ElectricPropeller in air of density rho (kg/m^3) at airspeed Va (m/s), throttle delta_t."""
    t0, t1, t2 = ti.static(propeller.thrust_polynomial)
    q0, q1, q2 = ti.static(propeller.torque_polynomial)
    K, R = ti.static(propeller.K, propeller.R_motor)
    a, Va2 = rho * q0, Va * Va
    b = rho * q1 * Va + ti.static(K**2 / R)
    c = rho * q2 * Va2 + ti.static(K * propeller.i0) - ti.static(K * propeller.V_max / R) * delta_t
    # the root (-b + sqrt(b^2 - 4 a c)) / (2 a), in the form that loses no digits where b > 0; the no-load current
    # cannot drive the motor backward
    root = ti.sqrt(ti.max(b * b - 4.0 * a * c, 0.0))
    Omega = ti.max(-2.0 * c / (b + root), 0.0)
    return rho * ((t0 * Omega + t1 * Va) * Omega + t2 * Va2), rho * ((q0 * Omega + q1 * Va) * Omega + q2 * Va2)


@ti.func
def disc_thrust_torque(propeller: ti.template(), rho, Va, delta_t):
    """(T, N; Q, N m) of a DiscPropeller in air of density rho (kg/m^3) at airspeed Va (m/s) and throttle delta_t."""
    jet = propeller.k_motor * delta_t
    thrust = ti.static(0.5 * propeller.S_prop * propeller.C_prop) * rho * (jet * jet - Va * Va)
    return thrust, ti.static(propeller.k_T_p * propeller.k_Omega**2) * delta_t * delta_t


@ti.func
def thrust_torque(propeller: ti.template(), p: ti.template(), Va, delta_t):
    """(T, N; Q, N m) of a propeller at airspeed Va (m/s) and throttle delta_t, in the air of p (FixedWingNumbers)."""
    T, Q = Va, Va
    if ti.static(propeller.law == "electric"):
        T, Q = electric_thrust_torque(propeller, p.rho, Va, delta_t)
    else:
        T, Q = disc_thrust_torque(propeller, p.rho, Va, delta_t)
    return p.gain * T, p.gain * Q


@ti.kernel
def propeller_power(out: array2, airspeed: array2, throttle: array2, propeller: ti.template(), rho: float):
    """Write thrust times airspeed (W) of propellers with a gain of 1, in air of density `rho` (kg/m^3)."""
    for e, i in ti.ndrange(out.shape[0], out.shape[1]):
        T, Q = airspeed[e, i], airspeed[e, i]
        if ti.static(propeller.law == "electric"):
            T, Q = electric_thrust_torque(propeller, rho, airspeed[e, i], throttle[e, i])
        else:
            T, Q = disc_thrust_torque(propeller, rho, airspeed[e, i], throttle[e, i])
        out[e, i] = T * airspeed[e, i]
