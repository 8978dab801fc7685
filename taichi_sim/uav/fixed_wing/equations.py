"""A fixed-wing aircraft's equations (fixed_wing.py) as NumPy functions over many states at once.

In an f32 run the kernels use f32's constants and polynomials whatever the arrays are, so that what is found here is
true of the model that is flown.
"""

import numpy as np
import taichi as ti

from taichi_sim.conventions import STATE_SIZE
from taichi_sim.uav.fixed_wing import airframe as fixed_wing
from taichi_sim.uav.fixed_wing.airframe import FixedWingParams

STALL_GRID = 2001  # angles of attack at which the lift curve is looked through


@ti.kernel
def _rhs(
    p: ti.template(),
    state: ti.types.ndarray(ndim=2),
    controls: ti.types.ndarray(ndim=2),
    wind: ti.types.ndarray(ndim=2),
    out: ti.types.ndarray(ndim=2),
):
    for n in range(state.shape[0]):
        y = ti.Vector([state[n, k] for k in ti.static(range(STATE_SIZE))])
        delta = ti.Vector([controls[n, k] for k in ti.static(range(4))])
        d = fixed_wing.derivative(p, y, ti.Vector([wind[n, 0], wind[n, 1], wind[n, 2]]), delta)
        for k in ti.static(range(STATE_SIZE)):
            out[n, k] = d[k]


def rhs(p: FixedWingParams, state, controls, wind=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Derivative [n, 13] of states [n, 13] (packed as in conventions.py), with elevator, aileron, rudder (rad) and
    throttle at controls [n, 4], in air that moves with wind [n, 3] (NED, m/s); in the dtype of `state`.
    """
    state = np.ascontiguousarray(state)
    controls, wind = (
        np.ascontiguousarray(np.broadcast_to(np.asarray(x, state.dtype), (len(state), size)))
        for x, size in ((controls, 4), (wind, 3))
    )
    out = np.empty_like(state)
    _rhs(p, state, controls, wind, out)
    return out


@ti.kernel
def _loads(
    p: ti.template(),
    v_r: ti.types.ndarray(ndim=2),
    omega: ti.types.ndarray(ndim=2),
    controls: ti.types.ndarray(ndim=2),
    out: ti.types.ndarray(ndim=2),
):
    for n in range(v_r.shape[0]):
        air = fixed_wing.air_data(ti.Vector([v_r[n, 0], v_r[n, 1], v_r[n, 2]]))
        rates = ti.Vector([omega[n, 0], omega[n, 1], omega[n, 2]])
        delta = ti.Vector([controls[n, k] for k in ti.static(range(4))])
        force, moment = fixed_wing.loads(p, air, rates, delta)
        T, Q = fixed_wing.thrust_torque(p.propeller, p.physical.rho, air[0], delta[3])
        for k in ti.static(range(3)):
            out[n, k], out[n, 3 + k] = force[k], moment[k]
        out[n, 6], out[n, 7] = T, Q


def loads(p: FixedWingParams, v_r, omega, controls) -> np.ndarray:
    """Force (N) and moment (N m) in b of air and propeller [n, :6], of these thrust (N) and the propeller's torque
    (N m) [n, 6:], at velocities relative to the air v_r [n, 3] (m/s), rates omega [n, 3], controls [n, 4].
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
def _lift_curve(p: ti.template(), alpha: ti.types.ndarray(ndim=1), out: ti.types.ndarray(ndim=1)):
    for n in range(alpha.shape[0]):
        out[n] = fixed_wing.lift_coefficient(p.longitudinal, alpha[n], ti.cos(alpha[n]), ti.sin(alpha[n]))


def lift_curve(p: FixedWingParams, alpha) -> np.ndarray:
    """C_L [n] at angles of attack alpha [n] (rad), elevator at zero."""
    alpha = np.ascontiguousarray(alpha, dtype=np.float64)
    out = np.empty_like(alpha)
    _lift_curve(p, alpha, out)
    return out


def stall_angles(p: FixedWingParams) -> tuple[float, float]:
    """Angles of attack (rad) of the least and of the largest lift: inverted and upright stall."""
    alpha = np.linspace(-p.longitudinal.alpha0, p.longitudinal.alpha0, STALL_GRID)
    C_L = lift_curve(p, alpha)
    return float(alpha[C_L.argmin()]), float(alpha[C_L.argmax()])
