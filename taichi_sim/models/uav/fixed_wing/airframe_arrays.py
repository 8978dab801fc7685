"""A fixed-wing aircraft's equations (airframe.py) over many states at once, from its vehicle file alone.

Trims, gains, modes and the V-n diagram are computed with them, before there is a model to step. In an f32 run the
kernels use f32's constants and polynomials whatever the arrays are, so the results hold for the model that flies.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false, reportGeneralTypeIssues=false

import math
from typing import NamedTuple

import numpy as np
import taichi as ti

from taichi_sim.kernels.abreast import taken2
from taichi_sim.kernels.conventions import GRAVITY, STATE_SIZE
from taichi_sim.kernels.runtime import array1, array2
from taichi_sim.models.uav.fixed_wing import airframe
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams, nominal_numbers

STALL_GRID = 2001  # angles of attack at which the lift curve is evaluated


@ti.kernel
def derivatives(craft: ti.template(), state: array2, controls: array2, wind: array2, load: array2, out: array2):
    """Write derivatives [n, 13] of states [n, 13] of `craft`: `Vehicle.rhs`, with the vehicle file's parameters."""
    for n in range(state.shape[0]):
        y = ti.Vector([state[n, k] for k in ti.static(range(STATE_SIZE))])
        delta = ti.Vector([controls[n, k] for k in ti.static(range(4))])
        air_n = ti.Vector([wind[n, k] for k in ti.static(range(3))])
        tau = ti.Vector([load[n, k] for k in ti.static(range(6))])
        d = airframe.derivative(craft, ti.static(nominal_numbers(craft)), y, air_n, delta, tau)
        for k in ti.static(range(STATE_SIZE)):
            out[n, k] = d[k]


def rhs(p: FixedWingParams, state, controls) -> np.ndarray:
    """Derivative [n, 13] float64 of states [n, 13] (packed as in conventions.py) in still air, with elevator, aileron,
    rudder (rad) and throttle at controls [n, 4].
    """
    state, controls = (np.ascontiguousarray(x, dtype=np.float64) for x in (state, controls))
    out, none = np.empty_like(state), np.zeros((len(state), 6))
    derivatives(p, state, controls, none, none, out)
    return out


@ti.kernel
def _loads(craft: ti.template(), v_r: array2, omega: array2, controls: array2, out: array2):
    for n in range(v_r.shape[0]):
        p = ti.static(nominal_numbers(craft))
        air = airframe.air_data(taken2(v_r, n, 3))
        rates, delta = taken2(omega, n, 3), taken2(controls, n, 4)
        force, moment = airframe.loads(craft, p, air, rates, delta)
        T, Q = airframe.thrust_torque(craft.propeller, p, air[0], delta[3])
        for k in ti.static(range(3)):
            out[n, k], out[n, 3 + k] = force[k], moment[k]
        out[n, 6], out[n, 7] = T, Q


def loads(p: FixedWingParams, v_r, omega, controls) -> np.ndarray:
    """Loads [n, 8] at velocities relative to the air v_r [n, 3] (m/s), rates omega [n, 3] (rad/s), controls [n, 4].

    Columns: force (N) and moment (N m) in b of air and propeller; then the thrust (N) and the propeller's torque (N m).
    """
    v_r = np.ascontiguousarray(np.atleast_2d(v_r), dtype=np.float64)
    omega, controls = (
        np.ascontiguousarray(np.broadcast_to(np.asarray(x, np.float64), (len(v_r), size)))
        for x, size in ((omega, 3), (controls, 4))
    )
    out = np.empty((len(v_r), 8))
    _loads(p, v_r, omega, controls, out)
    return out


@ti.kernel
def _lift_curve(craft: ti.template(), alpha: array1, out: array1):
    for n in range(alpha.shape[0]):
        p = ti.static(nominal_numbers(craft))
        out[n] = airframe.lift_coefficient(craft, p, alpha[n], ti.cos(alpha[n]), ti.sin(alpha[n]))


def lift_curve(p: FixedWingParams, alpha) -> np.ndarray:
    """C_L [n] at angles of attack alpha [n] (rad), elevator at zero."""
    alpha = np.ascontiguousarray(alpha, dtype=np.float64)
    out = np.empty_like(alpha)
    _lift_curve(p, alpha, out)
    return out


def stall_angles(p: FixedWingParams) -> tuple[float, float]:
    """Angles of attack (rad) with the least and the largest lift: inverted and upright stall."""
    alpha = np.linspace(-p.longitudinal.alpha0, p.longitudinal.alpha0, STALL_GRID)
    C_L = lift_curve(p, alpha)
    return float(alpha[C_L.argmin()]), float(alpha[C_L.argmax()])


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
