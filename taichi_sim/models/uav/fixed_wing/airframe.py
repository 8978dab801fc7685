"""A fixed-wing aircraft's aerodynamics, its equations of motion, and one step of them.

The model is that of R. Beard and T. McLain, Small Unmanned Aircraft, Princeton University Press 2012, chapters 3 and 4.
Lift blends into that of a flat plate beyond the stall; the polar is parabolic; other coefficients are linear. NED
world, forward-right-down body, quaternion body to world. Positive elevator is trailing edge down (C_m_delta_e < 0),
positive aileron rolls right, positive rudder yaws left (C_n_delta_r < 0). delta = (elevator, aileron, rudder,
throttle). A step is by the classical Runge-Kutta method, in the frame of the air.

Angles of the airflow and the blend of the stall call no libm in f32; in f64 they call the library. The arctangent is a
polynomial in t^2 on [0, 1]: least-squares fit at Chebyshev nodes, error below 3e-7 of the value and of 1 rad
(test_fixed_wing_loads.py measures it).

`craft` is a FixedWingParams: the kernels read the parameters that never vary from it, and these are compiled in. `p` is
a FixedWingNumbers, either compiled in or loaded for each environment.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math

import taichi as ti

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import some
from taichi_sim.kernels.conventions import GRAVITY, SURGE
from taichi_sim.kernels.rigid_body import cross
from taichi_sim.kernels.rotation import attitude_of, rates_of, velocity_of
from taichi_sim.models.uav.fixed_wing.actuators import thrust_torque

HALF_PI = math.pi / 2
TINY = 1e-30  # keeps 0 / 0 out of atan2(0, 0)
ATTACHED, STALLED = -17.0, 17.0  # exponents beyond which the blend rounds to 0 and to 1 in f32
LARGEST = 300.0  # exp(300)^2 is still finite in f64
SQUARINGS = 6  # exp(x) = exp(x / 64)^64
STILL = 1e-6  # m/s: below this speed the angle of attack is undefined, and forces are negligible


@ti.func
def atan_unit(t):
    """atan(t) for t in [0, 1]; Estrin's scheme."""
    s = t * t
    s2 = s * s
    low = (9.9999982133e-01 - 3.3331495914e-01 * s) + (1.9963134872e-01 - 1.3984092215e-01 * s) * s2
    high = (9.8206141158e-02 - 5.8187920381e-02 * s) + (2.3348513941e-02 - 4.4439168300e-03 * s) * s2
    return t * (low + high * (s2 * s2))


@ti.func
def atan2(y, x):
    """Angle (rad, in [-pi, pi]) of the vector (x, y); 0 for (0, 0)."""
    angle = y
    if ti.static(runtime.is_f64()):
        angle = ti.atan2(y, x)
    else:
        ax, ay = ti.abs(x), ti.abs(y)
        small, large = ti.min(ax, ay), ti.max(ax, ay)
        angle = atan_unit(small / ti.max(large, TINY))
        angle = ti.select(ay > ax, HALF_PI - angle, angle)
        angle = ti.select(x < 0.0, math.pi - angle, angle)
        angle = ti.select(y < 0.0, -angle, angle)
    return angle


@ti.func
def exp_clamped(x):
    """exp(x) of x clamped to [ATTACHED, STALLED] (in f64: to LARGEST)."""
    result = x
    if ti.static(runtime.is_f64()):
        result = ti.exp(ti.min(x, LARGEST))
    else:
        z = ti.max(ti.min(x, STALLED), ATTACHED) * ti.static(0.5**SQUARINGS)
        series = 1.0 / 6.0 + z * (1.0 / 24.0 + z * (1.0 / 120.0 + z * (1.0 / 720.0 + z * (1.0 / 5040.0))))
        result = 1.0 + z * (1.0 + z * (0.5 + z * series))
        for _ in ti.static(range(SQUARINGS)):
            result *= result
    return result


@ti.func
def stall_blend(M: ti.template(), alpha0: ti.template(), alpha):
    """sigma(alpha) of Beard & McLain 2012, eq. 4.10: 0 in attached flow, 1 far beyond +-alpha0, sharpness M (1/rad).

    With c = exp(-M alpha0) their quotient of exponentials is x / (1 + x), x = c^2 + 2 c cosh(M alpha). This form needs
    one exponential and loses no digits to cancellation.
    """
    sigma = alpha * 0.0
    exponent = M * ti.abs(alpha) - ti.static(M * alpha0)
    # this branch is nearly always predicted; it keeps the exponential out of the longest chain of operations
    near = exponent > ti.static(-LARGEST if runtime.is_f64() else ATTACHED)
    if some(near):
        c2 = ti.static(math.exp(-2.0 * M * alpha0))
        growing = exp_clamped(exponent)
        x = growing * (growing + c2) + c2  # scaled by `growing`, which saves a division
        sigma = ti.select(near, x / (growing + x), 0.0)
    return sigma


@ti.func
def air_data(v_r):
    """(Va, alpha, beta, cos alpha, sin alpha) of the velocity v_r relative to the air, in b (m/s; rad)."""
    h2 = v_r[0] * v_r[0] + v_r[2] * v_r[2]
    h, Va = ti.sqrt(h2), ti.sqrt(h2 + v_r[1] * v_r[1])  # in parallel: the longest chain sets a step's cost
    inv = 1.0 / ti.max(h, STILL)
    alpha, beta = atan2(v_r[2], v_r[0]), atan2(v_r[1], h)
    return ti.Vector([Va, alpha, beta, v_r[0] * inv, v_r[2] * inv])


@ti.func
def lift_coefficient(craft: ti.template(), p: ti.template(), alpha, cos_alpha, sin_alpha):
    """C_L(alpha): linear below the stall, that of a flat plate beyond it, blended by sigma (eqs 4.9, 4.10)."""
    sigma = stall_blend(craft.longitudinal.M_blend, craft.longitudinal.alpha0, alpha)
    plate = 2.0 * sin_alpha * ti.abs(sin_alpha) * cos_alpha
    return (1.0 - sigma) * (p.C_L_0 + p.C_L_alpha * alpha) + sigma * plate


@ti.func
def aerodynamic_force(craft: ti.template(), p: ti.template(), air, omega, delta):
    """Force (N) in b of the air on the airframe, with air = air_data(..); eqs 4.18, 4.19."""
    Va, alpha, beta, cos_alpha, sin_alpha = air[0], air[1], air[2], air[3], air[4]
    scale = p.half_rho_S * Va
    pitch = ti.static(0.5 * craft.physical.c) * omega[1]
    roll, yaw = ti.static(0.5 * craft.physical.b) * omega[0], ti.static(0.5 * craft.physical.b) * omega[2]
    C_L = lift_coefficient(craft, p, alpha, cos_alpha, sin_alpha) + p.C_L_delta_e * delta[0]
    linear = p.C_L_0 + p.C_L_alpha * alpha
    C_D = p.C_D_p + linear * linear * ti.static(craft.physical.induced_drag) + p.C_D_delta_e * delta[0]
    C_Y = p.C_Y_0 + p.C_Y_beta * beta + p.C_Y_delta_a * delta[1] + p.C_Y_delta_r * delta[2]
    lift = scale * (Va * C_L + p.C_L_q * pitch)
    drag = scale * (Va * C_D + p.C_D_q * pitch)
    side = scale * (Va * C_Y + p.C_Y_p * roll + p.C_Y_r * yaw)
    return ti.Vector([lift * sin_alpha - drag * cos_alpha, side, -drag * sin_alpha - lift * cos_alpha])


@ti.func
def aerodynamic_moment(craft: ti.template(), p: ti.template(), air, omega, delta):
    """Moment (N m) in b of the air on the airframe, about the centre of mass; eqs 4.20, 4.21."""
    Va, alpha, beta = air[0], air[1], air[2]
    b, c = ti.static(craft.physical.b, craft.physical.c)
    scale = p.half_rho_S * Va
    pitch = ti.static(0.5 * c) * omega[1]
    roll, yaw = ti.static(0.5 * b) * omega[0], ti.static(0.5 * b) * omega[2]
    C_ell = p.C_ell_0 + p.C_ell_beta * beta + p.C_ell_delta_a * delta[1] + p.C_ell_delta_r * delta[2]
    C_m = p.C_m_0 + p.C_m_alpha * alpha + p.C_m_delta_e * delta[0]
    C_n = p.C_n_0 + p.C_n_beta * beta + p.C_n_delta_a * delta[1] + p.C_n_delta_r * delta[2]
    return scale * ti.Vector(
        [
            b * (Va * C_ell + p.C_ell_p * roll + p.C_ell_r * yaw),
            c * (Va * C_m + p.C_m_q * pitch),
            b * (Va * C_n + p.C_n_p * roll + p.C_n_r * yaw),
        ]
    )


@ti.func
def loads(craft: ti.template(), p: ti.template(), air, omega, delta):
    """Force (N) and moment (N m) in b of air and propeller, without gravity."""
    T, Q = thrust_torque(craft.propeller, p, air[0], delta[3])
    force = aerodynamic_force(craft, p, air, omega, delta)
    moment = aerodynamic_moment(craft, p, air, omega, delta)
    return force + ti.Vector([T, 0.0, 0.0]), moment - ti.Vector([Q, 0.0, 0.0])


@ti.func
def rigid_body(p: ti.template(), y, R, force, moment):
    """Derivative [13] of state y (packed as in conventions.py) under gravity, force (N) and moment (N m) in b;
    R = R_nb of y. Newton and Euler in body axes: eqs 3.14-3.17.
    """
    v, omega = velocity_of(y), rates_of(y)
    v_n = R @ v
    down = ti.Vector([R[2, 0], R[2, 1], R[2, 2]])
    a = force * p.inverse_mass + GRAVITY * down - cross(omega, v)
    J_omega = ti.Vector([p.Jx * omega[0] - p.Jxz * omega[2], p.Jy * omega[1], p.Jz * omega[2] - p.Jxz * omega[0]])
    m = moment - cross(omega, J_omega)
    return ti.Vector(
        [
            v_n[0], v_n[1], v_n[2],
            0.5 * (-y[4] * omega[0] - y[5] * omega[1] - y[6] * omega[2]),
            0.5 * (y[3] * omega[0] + y[5] * omega[2] - y[6] * omega[1]),
            0.5 * (y[3] * omega[1] + y[6] * omega[0] - y[4] * omega[2]),
            0.5 * (y[3] * omega[2] + y[4] * omega[1] - y[5] * omega[0]),
            a[0], a[1], a[2],
            p.inverse_xx * m[0] + p.inverse_xz * m[2], p.inverse_yy * m[1], p.inverse_xz * m[0] + p.inverse_zz * m[2],
        ]
    )  # fmt: skip


@ti.func
def derivative(craft: ti.template(), p: ti.template(), y, air_n, delta, tau):
    """Derivative [13] of state y in air that moves with air_n (NED, m/s), with surfaces and throttle at delta.

    tau (6) is the load from outside (N, N m about the centre of mass, b).
    """
    R = attitude_of(y)
    return derivative_at(craft, p, y, R, velocity_of(y) - R.transpose() @ air_n, delta, tau)


@ti.func
def derivative_at(craft: ti.template(), p: ti.template(), y, R, v_r, delta, tau):
    """`derivative` at the attitude R and the velocity v_r (m/s, b) through the air."""
    force, moment = loads(craft, p, air_data(v_r), rates_of(y), delta)
    force += ti.Vector([tau[0], tau[1], tau[2]])
    moment += ti.Vector([tau[3], tau[4], tau[5]])
    return rigid_body(p, y, R, force, moment)


@ti.func
def rk4(craft: ti.template(), p: ti.template(), y, delta, tau, dt: ti.template()):
    """State in still air after a step dt (s); deflections delta and load tau are held."""
    k, new = 0.0 * y, y
    for stage in range(4):  # a loop, not four copies: as fast within 5 %, and compiled in a quarter of the time
        ahead = ti.select(stage == 0, 0.0, ti.select(stage == 3, dt, 0.5 * dt))
        weight = ti.select(stage == 0 or stage == 3, dt / 6.0, dt / 3.0)
        at = y + ahead * k
        k = derivative_at(craft, p, at, attitude_of(at), velocity_of(at), delta, tau)
        new += weight * k
    # one Newton step of 1/|q| suffices: |q| - 1 is as small as the method's error per step
    norm2 = new[3] * new[3] + new[4] * new[4] + new[5] * new[5] + new[6] * new[6]
    for k in ti.static(range(3, 7)):
        new[k] *= 1.5 - 0.5 * norm2
    return new


@ti.func
def with_velocity(y, v):
    """State y with its velocity replaced by v (m/s) in b."""
    new = y
    for k in ti.static(range(3)):
        new[SURGE + k] = v[k]
    return new
