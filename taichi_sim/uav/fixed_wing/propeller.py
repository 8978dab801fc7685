"""Thrust and torque of a fixed-pitch propeller, by one of two published laws.

- `electric`: propeller and direct-current motor in balance. Thrust and torque coefficients are quadratic in the
  advance ratio J = 2 pi Va / (Omega D); the motor's torque is K_Q ((V_in - K_V Omega) / R - i0) with
  V_in = V_max delta_t. Equal torques give a quadratic equation for the speed Omega (Beard & McLain, Small Unmanned
  Aircraft, addendum on the propeller model, eqs 4.17-4.21; numbers of mavsim_public).
- `disc`: Bernoulli's law for air leaving the disc at k_motor delta_t,
  T = 0.5 rho S_prop C_prop ((k_motor delta_t)^2 - Va^2), Q = k_T_p (k_Omega delta_t)^2 (Beard & McLain 2012,
  sec. 4.3).

Q is the torque that turns the propeller, N m: the airframe feels -Q about its nose.
"""

import math
from typing import Literal

import taichi as ti

from taichi_sim.config import Finite, NonNegative, Positive, Strict

TURN = 2.0 * math.pi  # rad
SECONDS_PER_MINUTE = 60.0


class ElectricPropeller(Strict):
    """Numbers of a propeller on an electric motor."""

    law: Literal["electric"]
    D: Positive  # diameter, m
    KV_rpm_per_volt: Positive  # rpm/V: K_V = K_Q = 60 / (2 pi KV), V s/rad
    R_motor: Positive  # ohm
    i0: NonNegative  # current without load, A
    V_max: Positive  # voltage at full throttle, V
    C_T0: Finite
    C_T1: Finite
    C_T2: Finite
    C_Q0: Positive
    C_Q1: Finite
    C_Q2: Finite

    @property
    def K(self) -> float:  # noqa: N802
        """K_V = K_Q, V s/rad or N m/A."""
        return SECONDS_PER_MINUTE / (TURN * self.KV_rpm_per_volt)

    def thrust_polynomial(self, rho: float) -> tuple[float, float, float]:
        """Factors of Omega^2, Omega Va, Va^2 in the thrust (N)."""
        D = self.D
        return self.C_T0 * rho * D**4 / TURN**2, self.C_T1 * rho * D**3 / TURN, self.C_T2 * rho * D**2

    def torque_polynomial(self, rho: float) -> tuple[float, float, float]:
        """Factors of Omega^2, Omega Va, Va^2 in the torque (N m)."""
        D = self.D
        return self.C_Q0 * rho * D**5 / TURN**2, self.C_Q1 * rho * D**4 / TURN, self.C_Q2 * rho * D**3


class DiscPropeller(Strict):
    """Numbers of Bernoulli's law."""

    law: Literal["disc"]
    S_prop: Positive  # m^2
    C_prop: Positive
    k_motor: Positive  # speed of the air behind the disc at full throttle, m/s
    k_T_p: NonNegative  # N m s^2  # noqa: N815
    k_Omega: NonNegative  # rad/s  # noqa: N815


@ti.func
def electric_thrust_torque(p: ti.template(), rho: ti.template(), Va, delta_t):
    """(T, N; Q, N m) of an ElectricPropeller p at airspeed Va (m/s) and throttle delta_t."""
    t0, t1, t2 = ti.static(p.thrust_polynomial(rho))
    q0, q1, q2 = ti.static(p.torque_polynomial(rho))
    Va2 = Va * Va
    b = q1 * Va + ti.static(p.K**2 / p.R_motor)
    c = q2 * Va2 + ti.static(p.K * p.i0) - ti.static(p.K * p.V_max / p.R_motor) * delta_t
    # the root (-b + sqrt(b^2 - 4 a c)) / (2 a), in the form that loses no digits where b > 0; no-load current
    # cannot drive the motor backward
    root = ti.sqrt(ti.max(b * b - ti.static(4.0 * q0) * c, 0.0))
    Omega = ti.max(-2.0 * c / (b + root), 0.0)
    return (t0 * Omega + t1 * Va) * Omega + t2 * Va2, (q0 * Omega + q1 * Va) * Omega + q2 * Va2


@ti.func
def disc_thrust_torque(p: ti.template(), rho: ti.template(), Va, delta_t):
    """(T, N; Q, N m) of a DiscPropeller p at airspeed Va (m/s) and throttle delta_t."""
    factor = ti.static(0.5 * rho * p.S_prop * p.C_prop)
    jet = p.k_motor * delta_t
    return factor * (jet * jet - Va * Va), ti.static(p.k_T_p * p.k_Omega**2) * delta_t * delta_t


@ti.func
def thrust_torque(p: ti.template(), rho: ti.template(), Va, delta_t):
    """(T, N; Q, N m) of propeller p in air of density rho (kg/m^3) at airspeed Va (m/s) and throttle delta_t."""
    T, Q = Va, Va
    if ti.static(p.law == "electric"):
        T, Q = electric_thrust_torque(p, rho, Va, delta_t)
    else:
        T, Q = disc_thrust_torque(p, rho, Va, delta_t)
    return T, Q
