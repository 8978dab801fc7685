"""What waves do at a hull, as Taichi functions on values: its mean surface, the water's motion, the pressure.

Components of waves.py are summed at the label of the hull's centre and, for the pressure, along lines of points
(wave_lines.py). Means over the hull are those over its waterplane (gauge.py).

Decay with depth counts from the hull's mean surface plane (Wheeler 1970, J. Petrol. Technol. 22, 359, whose stretching
counts from the elevation at the point: here that of the plane, so that one exponential serves a line). Hulls lie near
the surface, so in finite depth the decay of the pressure is exp(-omega^2/g d), that of vertical motion
exp(-g k^2/omega^2 d): equal to exp(-k d) in deep water, and equal to the exact factors to first order in k d.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.conventions import AMPLITUDE, BX, BY, GRAVITY, KX, KY, OMEGA, K
from taichi_sim.maths import fast
from taichi_sim.usv.hull.gauge import averages

CENTRE_SIZE = 18
D_N, D_E, J_XX, J_XY, J_YY, ELEVATION, ALONG, ACROSS, *_motion = range(CENTRE_SIZE)  # what `at_centre` returns
V_N, V_E, V_D, A_N, A_E, A_D, P, Q, P_DOT, Q_DOT = _motion
HALF_TURN = 3.14159265  # waves shorter than a line's step cancel over it


@ti.func
def at_centre(
    sea: ti.template(), phase: ti.template(), count: ti.template(), gauge: ti.template(), finite: ti.template(),
    s, row, X, Y, tau, cos_h, sin_h
):  # fmt: skip
    """Sums at the label (X, Y) of the hull's centre; (cos_h, sin_h) is its heading.

    Returns 18 numbers: displacement (D_N, D_E) and Jacobian (J_XX, J_XY, J_YY) of the label; elevation (ELEVATION, m,
    up) and slopes along and across the heading (ALONG, ACROSS) of the mean plane; the water's motion averaged over the
    hull at gauge.depth: velocity (V_N, V_E, V_D, m/s, n) and acceleration (A_N, A_E, A_D), roll and pitch rate about
    the heading axes (P, Q, rad/s) and their accelerations (P_DOT, Q_DOT).
    """
    r = ti.Vector([X * 0.0 for _ in range(CENTRE_SIZE)])
    cos_u, sin_u = cos_h * gauge.along.scale, sin_h * gauge.along.scale
    cos_v, sin_v = cos_h * gauge.across.scale, sin_h * gauge.across.scale
    for c in range(count):
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
        # all terms before the first sum: many live values keep LLVM from interleaving iterations, which would spill
        a_sine, bx_cosine, by_cosine = a * sine, bx * cosine, by * cosine
        bx_sine, by_sine = bx * sine, by * sine
        up_sine, up_cosine = speed * sine, speed * cosine
        r[D_N] += bx_sine
        r[D_E] += by_sine
        r[J_XX] += kx * bx_cosine
        r[J_XY] += ky * bx_cosine
        r[J_YY] += ky * by_cosine
        r[ELEVATION] += mean * (a * cosine)
        r[ALONG] -= slope_u * a_sine
        r[ACROSS] -= slope_v * a_sine
        r[V_N] += speed_h * bx_cosine
        r[V_E] += speed_h * by_cosine
        r[V_D] -= mean * up_sine
        r[A_N] += speed_h * omega * bx_sine
        r[A_E] += speed_h * omega * by_sine
        r[A_D] += mean * omega * up_cosine
        r[P] -= slope_v * up_cosine
        r[Q] += slope_u * up_cosine
        r[P_DOT] -= slope_v * omega * up_sine
        r[Q_DOT] += slope_u * omega * up_sine
    r[J_XX], r[J_XY], r[J_YY] = 1 - r[J_XX], -r[J_XY], 1 - r[J_YY]
    return r


@ti.func
def along_pair(
    sea: ti.template(), phase: ti.template(), count: ti.template(), points: ti.template(), finite: ti.template(),
    s, row, a, b, step, across, tau
):  # fmt: skip
    """Dynamic pressure head p / (rho g) (m) at `points` points on each of two parallel lines.

    `a` and `b` give the label and the depth (m, below the mean plane) of either line's first point, and the change of
    depth from one to the next; `step` is the change of label, shared. Returns the heads on a and on b, and their
    changes (m/m) in the direction `across` of labels.

    Each is a mean over one step's length around the point, so that a row of panels adds up to the integral along it.
    Two lines share what depends on their direction, and hide each other's latency.
    """
    head_a, slope_a = ti.Vector([tau * 0.0 for _ in range(points)]), ti.Vector([tau * 0.0 for _ in range(points)])
    head_b, slope_b = ti.Vector([tau * 0.0 for _ in range(points)]), ti.Vector([tau * 0.0 for _ in range(points)])
    for c in range(count):
        kx, ky, k, omega = sea[s, KX, c], sea[s, KY, c], sea[s, K, c], sea[s, OMEGA, c]
        rate = k
        if ti.static(finite):
            rate = omega * omega * ti.static(1 / GRAVITY)
        # of half a turn, so that the mean over a step's length, its sinc, comes along; waves shorter than that cancel
        turn, k_across = kx * step[0] + ky * step[1], kx * across[0] + ky * across[1]
        half = fast.at_most(ti.abs(0.5 * turn), HALF_TURN)
        sinc, half_cosine = fast.sinc_short(half), fast.cos_short(half)
        half_sine = half * sinc
        cosine_step, sine_step = 1 - 2 * half_sine * half_sine, 2 * half_sine * half_cosine
        sine_step = ti.select(turn < 0, -sine_step, sine_step)
        amplitude, start = sea[s, AMPLITUDE, c] * sinc, phase[row, c] - omega * tau
        sine_a, cosine_a = fast.sincos_short(kx * a[0] + ky * a[1] + start)
        sine_b, cosine_b = fast.sincos_short(kx * b[0] + ky * b[1] + start)
        decayed_a, decayed_b = amplitude * fast.exp_decay(rate * a[2]), amplitude * fast.exp_decay(rate * b[2])
        m_a, m_b = fast.exp_near_one(rate * a[3]), fast.exp_near_one(rate * b[3])
        re_a, im_a, re_b, im_b = decayed_a * cosine_a, decayed_a * sine_a, decayed_b * cosine_b, decayed_b * sine_b
        step_re_a, step_im_a, step_re_b, step_im_b = (
            m_a * cosine_step,
            m_a * sine_step,
            m_b * cosine_step,
            m_b * sine_step,
        )
        for i in ti.static(range(points)):
            head_a[i] += re_a
            head_b[i] += re_b
            slope_a[i] -= k_across * im_a
            slope_b[i] -= k_across * im_b
            if ti.static(i < points - 1):
                t_a, t_b = re_a * step_re_a - im_a * step_im_a, re_b * step_re_b - im_b * step_im_b
                im_a, im_b = re_a * step_im_a + im_a * step_re_a, re_b * step_im_b + im_b * step_re_b
                re_a, re_b = t_a, t_b
    return head_a, head_b, slope_a, slope_b
