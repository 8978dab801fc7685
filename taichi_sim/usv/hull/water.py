"""Water at a hull: its mean surface plane, its motion averaged over the hull, the current, the freeboard.

Waves are summed at the label of the hull's centre: the position in still water of the particle that waves have
displaced to the centre (sea/waves.py). Means are over the hull's waterplane (`Gauge`): elevation and slopes of the
plane with the best fit and, at the depth of the draft, the orbital motion nu_o of the water. In finite depth,
horizontal motion decays by exp(-omega^2/g d), vertical motion by exp(-g k^2/omega^2 d). Both equal exp(-k d) in deep
water, and the exact factors to first order in k d.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.conventions import AMPLITUDE, BX, BY, GRAVITY, KX, KY, OMEGA, K
from taichi_sim.kernels import fast
from taichi_sim.kernels.abreast import taken2
from taichi_sim.kernels.lanes import blocks, totals, variables
from taichi_sim.kernels.rigid_body import cross, six
from taichi_sim.usv.hull.geometry import averages

SUMS = 18  # numbers that `at_centre` returns:
D_N, D_E, J_XX, J_XY, J_YY, ELEVATION, ALONG, ACROSS, *_motion = range(SUMS)
V_N, V_E, V_D, A_N, A_E, A_D, P, Q, P_DOT, Q_DOT = _motion
LABEL_STEPS = 4  # of Newton's method, from zero displacement


@ti.func
def heading(R):
    """Cosine and sine of the heading of R = R_nb."""
    inverse = 1.0 / ti.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0] + 1e-12)
    return R[0, 0] * inverse, R[1, 0] * inverse


@ti.func
def at_centre(
    sea: ti.template(), phase: ti.template(), count: ti.template(), gauge: ti.template(), finite: ti.template(),
    s, row, X, Y, tau, cos_h, sin_h
):  # fmt: skip
    """Sums over the waves at the label (X, Y) of the hull's centre; (cos_h, sin_h) is its heading.

    `sea` and `phase`, with `count` components, are in lanes. The 18 numbers returned are displacement (D_N, D_E) and
    Jacobian (J_XX, J_XY, J_YY) of the label; elevation (ELEVATION, m, up) and slopes along and across the heading
    (ALONG, ACROSS) of the mean plane; and the water's motion averaged over the hull at gauge.depth: velocity (V_N, V_E,
    V_D, m/s, n), acceleration (A_N, A_E, A_D), roll and pitch rate about the heading axes (P, Q, rad/s) and their rates
    (P_DOT, Q_DOT).
    """
    r = ti.static(variables(SUMS, sea[s, AMPLITUDE, 0] * 0.0))
    cos_u, sin_u = cos_h * gauge.along.scale, sin_h * gauge.along.scale
    cos_v, sin_v = cos_h * gauge.across.scale, sin_h * gauge.across.scale
    for c in range(ti.static(blocks(count))):
        a, kx, ky, k, omega = sea[s, AMPLITUDE, c], sea[s, KX, c], sea[s, KY, c], sea[s, K, c], sea[s, OMEGA, c]
        bx, by = sea[s, BX, c], sea[s, BY, c]
        sine, cosine = fast.sincos_short(kx * X + ky * Y + phase[row, c] - omega * tau)
        mean_u, slope_u = averages(gauge.along, kx * cos_u + ky * sin_u)
        mean_v, slope_v = averages(gauge.across, ky * cos_v - kx * sin_v)
        slope_u *= mean_v
        slope_v *= mean_u
        mean = mean_u * mean_v
        decay = fast.exp_decay(k * gauge.depth)
        decay_h = decay
        if ti.static(finite):
            decay_h = fast.exp_decay(omega * omega * ti.static(gauge.depth / GRAVITY))
            decay = fast.exp_decay(k * k * ti.static(gauge.depth * GRAVITY) / (omega * omega))
        speed_h, speed = mean * decay_h * omega, a * decay * omega
        # All terms are computed before the first sum: many live values keep LLVM from interleaving iterations, which
        # would spill registers.
        a_sine, bx_cosine, by_cosine = a * sine, bx * cosine, by * cosine
        bx_sine, by_sine = bx * sine, by * sine
        up_sine, up_cosine = speed * sine, speed * cosine
        r[D_N] += bx_sine
        r[D_E] += by_sine
        r[J_XX] += kx * bx_cosine
        r[J_XY] += ky * bx_cosine
        r[J_YY] += ky * by_cosine
        r[ELEVATION] += mean * (a * cosine)
        r[ALONG] = r[ALONG] - slope_u * a_sine
        r[ACROSS] = r[ACROSS] - slope_v * a_sine
        r[V_N] += speed_h * bx_cosine
        r[V_E] += speed_h * by_cosine
        r[V_D] = r[V_D] - mean * up_sine
        r[A_N] += speed_h * omega * bx_sine
        r[A_E] += speed_h * omega * by_sine
        r[A_D] += mean * omega * up_cosine
        r[P] = r[P] - slope_v * up_cosine
        r[Q] += slope_u * up_cosine
        r[P_DOT] = r[P_DOT] - slope_v * omega * up_sine
        r[Q_DOT] += slope_u * omega * up_sine
    sums = totals(r)
    sums[J_XX], sums[J_XY], sums[J_YY] = 1 - sums[J_XX], -sums[J_XY], 1 - sums[J_YY]
    return sums


@ti.func
def at(gauge: ti.template(), build: ti.template(), around: ti.template(), e, tau, pos, R, D):
    """The water at a hull's centre in environment e: sums (`at_centre`), label, inverse Jacobian (xx, xy, yy).

    D (m) predicts the displacement of the label; one step of Newton's method makes it exact to second order.
    """
    cos_h, sin_h = heading(R)
    X, Y = pos[0] + D[0], pos[1] + D[1]
    r = at_centre(
        around.waves, around.turns, build.components, gauge, build.finite, around.env_sea[e], e, X, Y, tau, cos_h, sin_h
    )
    xx, xy, yy = r[J_XX], r[J_XY], r[J_YY]
    inverse = 1.0 / ti.max(xx * yy - xy * xy, 0.01)
    J = ti.Vector([yy * inverse, -xy * inverse, xx * inverse])
    gap = ti.Vector([r[D_N] - D[0], r[D_E] - D[1]])
    L = ti.Vector([X + J[0] * gap[0] + J[1] * gap[1], Y + J[1] * gap[0] + J[2] * gap[1]])
    return r, L, J


@ti.func
def displacement(gauge: ti.template(), build: ti.template(), around: ti.template(), e, pos, R):
    """Displacement (m) of the label under the hull at the beginning of a step, without a prediction."""
    now = pos[0] * 0.0
    D = ti.Vector([now, now])
    for _ in range(LABEL_STEPS):
        _sums, L, _J = at(gauge, build, around, e, now, pos, R, D)
        D = L - ti.Vector([pos[0], pos[1]])
    return D


@ti.func
def mean_plane(sums, R):
    """Elevation (m, up) of the mean surface plane, and its slopes towards north and east."""
    cos_h, sin_h = heading(R)
    along, across = sums[ALONG], sums[ACROSS]
    return ti.Vector([sums[ELEVATION], along * cos_h - across * sin_h, along * sin_h + across * cos_h])


@ti.func
def flow(frame: ti.template(), R, omega, V_c, sums):
    """nu_c, nu_c_dot, nu_o and nu_o_dot in b, from the current V_c (m/s, n) and the waves; `frame` is current_frame."""
    v_c, v_c_dot = R.transpose() @ V_c, V_c * 0.0
    if ti.static(frame == "heading"):
        cos_h, sin_h = heading(R)
        v_c = ti.Vector([cos_h * V_c[0] + sin_h * V_c[1], cos_h * V_c[1] - sin_h * V_c[0], 0.0])
        v_c_dot = ti.Vector([omega[2] * v_c[1], -omega[2] * v_c[0], 0.0])
    else:
        v_c_dot = cross(v_c, omega)
    zero = v_c * 0.0
    cos_h, sin_h = heading(R)
    v_o = R.transpose() @ ti.Vector([sums[V_N], sums[V_E], sums[V_D]])
    a_o = R.transpose() @ ti.Vector([sums[A_N], sums[A_E], sums[A_D]])
    p, q = sums[P], sums[Q]
    w_o = R.transpose() @ ti.Vector([p * cos_h - q * sin_h, p * sin_h + q * cos_h, 0.0])
    p, q = sums[P_DOT], sums[Q_DOT]
    alpha_o = R.transpose() @ ti.Vector([p * cos_h - q * sin_h, p * sin_h + q * cos_h, 0.0])
    nu_o, nu_o_dot = six(v_o, w_o), six(a_o - cross(omega, v_o), alpha_o - cross(omega, w_o))
    return six(v_c, zero), six(v_c_dot, zero), nu_o, nu_o_dot


@ti.func
def freeboard(deck: ti.template(), R, z, plane):
    """Height (m) of the lowest corner of the deck above the surface plane."""
    lowest = z * 0.0 + 1e3
    for c in range(deck.shape[0]):
        r = R @ taken2(deck, c, 3)
        lowest = ti.min(lowest, -(z + r[2]) - plane[0] - plane[1] * r[0] - plane[2] * r[1])
    return lowest
