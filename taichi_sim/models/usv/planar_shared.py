"""Shared parts of models that move in the plane and ride on the surface of the water.

The planar motion s = [x, y, psi, u_r, v_r, r] is relative to water that moves by V_c (m/s, n); x and y count from the
place where the control step began, so that no increment is lost (kernels/position.py). Heave, roll and
pitch follow the plane through the elevations under the four corners of the waterplane.
"""

# Kernels are another language inside Python syntax.
# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false, reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels import fast_maths
from taichi_sim.kernels.abreast import put
from taichi_sim.kernels.conventions import EAST, ELEVATION, GRAVITY, NORTH, PITCH_RATE, QW, SURGE, SWAY, YAW_RATE
from taichi_sim.kernels.position import move
from taichi_sim.kernels.rotation import (
    attitude_of,
    quaternion_of,
    quaternion_product,
    rotation_matrix,
    store,
    velocity_of,
)
from taichi_sim.surroundings.sea import gerstner

LABEL_STEPS = 4  # fixed-point steps for the displacement, from zero
AT_ONCE = 1e-300  # s; added to an actuator's time constant, so that one without lag follows at once


@ti.func
def water_plane(length, beam, heights):
    """Mean elevation (m), slopes ahead and to starboard, and the change of the latter per metre ahead (1/m).

    `heights` (m, up) are the elevations under the corners of a waterplane of `length` and `beam` (m): bow port, bow
    starboard, stern port, stern starboard.
    """
    bow, stern = heights[1] - heights[0], heights[3] - heights[2]
    ahead = (heights[0] + heights[1] - heights[2] - heights[3]) / (2.0 * length)
    right = (bow + stern) / (2.0 * beam)
    twist = (bow - stern) / (beam * length)
    return ti.Vector([0.25 * heights.sum(), ahead, right, twist])


@ti.func
def heading(R):
    """Cosine and sine of the heading of R = R_nb."""
    inv = 1.0 / ti.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0])
    return R[0, 0] * inv, R[1, 0] * inv


@ti.func
def in_plane(tau):
    """X, Y (N) and N (N m) of a load [6]."""
    return ti.Vector([tau[0], tau[1], tau[5]])


@ti.func
def planar(y, V_c):
    """Planar motion s = [x, y, psi, u_r, v_r, r] and water plane (see `water_plane`; without its twist) of a state."""
    R = attitude_of(y)
    v = R @ velocity_of(y)
    c, sine = heading(R)
    north, east = v[0] - V_c[0], v[1] - V_c[1]
    r = (R[2, 1] * y[PITCH_RATE] + R[2, 2] * y[YAW_RATE]) / (R[2, 1] * R[2, 1] + R[2, 2] * R[2, 2])
    u_r, v_r = c * north + sine * east, c * east - sine * north
    slope_n, slope_e = R[0, 2] / R[2, 2], R[1, 2] / R[2, 2]
    ahead, right = c * slope_n + sine * slope_e, c * slope_e - sine * slope_n
    s = ti.Vector([u_r * 0.0, u_r * 0.0, ti.atan2(R[1, 0], R[0, 0]), u_r, v_r, r])
    return s, ti.Vector([-y[2], ahead, right, ahead * 0.0])


@ti.func
def elevations(
    around: ti.template(), build: ti.template(), e, tau, start, s, D, length: ti.template(), beam: ti.template()
):  # fmt: skip
    """Displacement (m) of the water at the centre, from its prediction D, and elevations (m, up) under the four
    corners.

    The waterplane has `length` and `beam` (m); the control step began at `start` (m, n), `tau` (s) ago.
    """
    sine, cosine = fast_maths.sincos(s[2])
    x, y = start[0] + s[0] + D[0], start[1] + s[1] + D[1]
    fx, fy = 0.5 * length * cosine, 0.5 * length * sine
    gx, gy = -0.5 * beam * sine, 0.5 * beam * cosine
    X = ti.Vector([x, x + fx - gx, x + fx + gx, x - fx - gx, x - fx + gx])
    Y = ti.Vector([y, y + fy - gy, y + fy + gy, y - fy - gy, y - fy + gy])
    sea_index = around.env_sea[e]
    h = gerstner.displacement_and_four_elevations(around.sea, around.phase, build.components, sea_index, e, X, Y, tau)
    return ti.Vector([h[0], h[1]]), ti.Vector([h[2], h[3], h[4], h[5]])


@ti.func
def first_plane(around: ti.template(), build: ti.template(), e, start, s, length: ti.template(), beam: ti.template()):
    """Displacement (m) of the water at the centre, and water plane, at the beginning of a control step, without a
    prediction.
    """
    now = s[0] * 0.0
    D, heights = ti.Vector([now, now]), ti.Vector([now, now, now, now])
    for _ in range(LABEL_STEPS):
        D, heights = elevations(around, build, e, now, start, s, D, length, beam)
    return D, water_plane(length, beam, heights)


@ti.func
def attitude(psi, r, plane, rate):
    """Quaternion of heading psi on the water plane, and body rates (rad/s) while the plane changes by `rate`.

    tan theta = slope ahead, tan phi = -(slope to starboard) cos theta. Half angles are by square roots.
    """
    cos_t = 1.0 / ti.sqrt(1.0 + plane[1] * plane[1])
    sin_t = plane[1] * cos_t
    tan_p = -plane[2] * cos_t
    cos_p = 1.0 / ti.sqrt(1.0 + tan_p * tan_p)
    sin_p = tan_p * cos_p
    half_ct, half_cp = ti.sqrt(0.5 * (1.0 + cos_t)), ti.sqrt(0.5 * (1.0 + cos_p))
    half_st, half_sp = 0.5 * sin_t / half_ct, 0.5 * sin_p / half_cp
    tilt = ti.Vector([half_ct * half_cp, half_ct * half_sp, half_st * half_cp, -half_st * half_sp])
    # libm is used here, because an error of the stored heading would grow from step to step.
    yaw = ti.Vector([ti.cos(0.5 * psi), psi * 0.0, psi * 0.0, ti.sin(0.5 * psi)])
    theta_dot = rate[1] * cos_t * cos_t
    phi_dot = -(rate[2] * cos_t - plane[2] * sin_t * theta_dot) * cos_p * cos_p
    p = phi_dot - r * sin_t
    omega = ti.Vector([p, theta_dot * cos_p + r * cos_t * sin_p, r * cos_t * cos_p - theta_dot * sin_p])
    return quaternion_product(yaw, tilt), omega


@ti.func
def write_state(fleet: ti.template(), e, i, start, s, plane, rate, memory, V_c):
    """Write all columns of vehicle i in environment e: planar motion s on the water plane, auxiliary state `memory`.

    The control step began at `start` (m, n). The water plane changes by `rate` a second.
    """
    q, omega = attitude(s[2], s[5], plane, rate)
    R_nb = rotation_matrix(q)
    c, sine = heading(R_nb)
    v_n = ti.Vector([c * s[3] - sine * s[4] + V_c[0], sine * s[3] + c * s[4] + V_c[1], 0.0])
    v_n[2] = -rate[0]
    store(fleet.derived, e, i, R_nb, v_n)
    v_b = R_nb.transpose() @ v_n
    move(fleet, e, i, start, ti.Vector([s[0], s[1]]), [-plane[0], q[0], q[1], q[2], q[3]])
    put(fleet.state, e, i, SURGE, [v_b[0], v_b[1], v_b[2], omega[0], omega[1], omega[2]])
    for k in ti.static(range(memory.n)):
        fleet.aux[e, i, k] = memory[k]
    fleet.surface[e, i, ELEVATION] = plane[0]


@ti.func
def write_rates(out: ti.template(), n, y, s, rate, V_c):
    """Write d(state)/dt of state y to row n of `out`, from its planar motion s and the rate of s.

    Rates of heave, roll and pitch stay as they are.
    """
    sine, cosine = fast_maths.sincos(s[2])
    u_c, v_c = cosine * V_c[0] + sine * V_c[1], cosine * V_c[1] - sine * V_c[0]
    turn = ti.Vector([y[QW] * 0.0, y[QW] * 0.0, y[QW] * 0.0, 0.5 * s[5]])  # about the vertical
    q_dot = quaternion_product(turn, quaternion_of(y))
    out[n, NORTH], out[n, EAST] = rate[0], rate[1]
    for k in ti.static(range(4)):
        out[n, QW + k] = q_dot[k]
    # rates of the velocity over ground; nu_c turns in b
    out[n, SURGE], out[n, SWAY], out[n, YAW_RATE] = rate[3] + s[5] * v_c, rate[4] - s[5] * u_c, rate[5]


@ti.func
def wave_load(p: ti.template(), plane):
    """Wave force X, Y (N) and moment N (N m) on the hull, from its water plane.

    A long wave accelerates the water by -g grad(zeta). The load on a body in accelerated water is (displaced mass +
    added mass) times that acceleration (Taylor 1928). The body is a wall-sided block of the hull's length and beam, and
    the slope is averaged over it. The yaw moment comes from the change of the transverse acceleration along the hull.
    """
    a_x, a_y, a_yx = -GRAVITY * plane[1], -GRAVITY * plane[2], -GRAVITY * plane[3]
    return ti.Vector([p.m11 * a_x, p.m22 * a_y + p.m23 * a_yx, p.m32 * a_y + p.block_yaw * a_yx])
