"""Gerstner (trochoidal) waves, and the water below them, as Taichi functions on values.

A surface particle with label (X, Y) has the position, with theta_c = kx X + ky Y - omega t + phase,

    x = X - sum bx sin theta,   y = Y - sum by sin theta,   zeta = sum a cos theta

(Gerstner 1802; Lamb 1932, art. 251), where (bx, by) = a coth(k depth) (kx, ky) / k. A query at a point (x, y) needs the
label first: `invert_label` solves x = X - sum b sin theta.

`sea` is the table [sea, 8, component] of conventions.py, and `s` the index of the realisation. `phase[row, component]`
is phase - omega t of each component, reduced in f64 (`Sea.phases`), so that angles and times stay small in f32. `tau`
(s) is the time since then. `count`, the number of components, is a constant of the compiled kernel: only a loop of
known length is unrolled into whole vectors, which halves its time at 16 components.

Water between the surface and the bottom: linear theory holds below still water. Extended into a crest, its pressure is
not zero at the surface, and exp(k z) grows without bound for short waves on long ones. The water is therefore stretched
(Wheeler 1970, J. Petroleum Technology 22, 359): the decay counts from the instantaneous surface,

    z' = (z - zeta) / (1 + zeta / depth),

which is z - zeta in deep water, 0 at the surface and -depth at the bottom. theta_c is that of the surface particle
straight above (label X, Y), so that zeta = sum a cos theta exactly. Then

    p / (rho g) = -z + sum a cosh k(z' + depth) / cosh k depth  cos theta         (0 at z = zeta, exactly)
    u_n = sum b_n omega cosh k(z' + depth) / cosh k depth  cos theta              (b = a coth k depth)
    w   = sum a omega sinh k(z' + depth) / sinh k depth  sin theta                (up; 0 at the bottom)

The acceleration is the rate of u and w at a fixed label and z'. At the surface the motion is that of the Gerstner
particle; far below, it decays as in linear theory. In deep water the pressure grows with depth everywhere, because
sum k a < 1.

The pressure differs from Gerstner's exact one by second order in k a. Each component makes it higher by rho g k a^2 (1
- exp k z')^2 / 2, because it counts from still water, and the mean of Gerstner's surface is lower (`Sea.mean_level`).
For one wave of k a = 0.16 the difference is at most 0.6 % at any depth (test_waves.py).

The exponentials of -2k(depth + z') and -2k depth give deep and finite water one form without overflow; depth < 0 means
deep water.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels import fast_maths
from taichi_sim.kernels.conventions import AMPLITUDE, BX, BY, KX, KY, OMEGA, SEA_ROWS, K
from taichi_sim.kernels.lanes import WIDTH, blocks, is_laned, lane_of, row_of, totals, variables

SMALLEST_DETERMINANT = 1e-4  # lower limit of the Jacobian in Newton's method, to keep a step finite at a cusp


@ti.func
def displacement(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, X, Y, tau):
    """Horizontal displacement (m) of the particle with label (X, Y): (sum bx sin, sum by sin) = X - x."""
    dx, dy = X * 0.0, X * 0.0
    for c in range(count):
        theta = sea[s, KX, c] * X + sea[s, KY, c] * Y + phase[row, c] - sea[s, OMEGA, c] * tau
        sine = fast_maths.sin(theta)
        dx += sea[s, BX, c] * sine
        dy += sea[s, BY, c] * sine
    return ti.Vector([dx, dy])


@ti.func
def elevation_at_label(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, X, Y, tau):
    """Elevation zeta (m, up) of the particle with label (X, Y)."""
    zeta = X * 0.0
    for c in range(count):
        theta = sea[s, KX, c] * X + sea[s, KY, c] * Y + phase[row, c] - sea[s, OMEGA, c] * tau
        zeta += sea[s, AMPLITUDE, c] * fast_maths.cos(theta)
    return zeta


@ti.func
def displacement_and_four_elevations(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, X, Y, tau):
    """Displacement (north, east, m) at label 0 and elevations (m, up) at labels 1-4 of X, Y (5-vectors), in one pass.

    Separate sums would each wait for their own chain of additions; in one pass the chains overlap.
    """
    dx, dy = X[0] * 0.0, X[0] * 0.0
    z1, z2, z3, z4 = X[0] * 0.0, X[0] * 0.0, X[0] * 0.0, X[0] * 0.0
    for c in range(count):
        a, kx, ky = sea[s, AMPLITUDE, c], sea[s, KX, c], sea[s, KY, c]
        p = phase[row, c] - sea[s, OMEGA, c] * tau
        sine = fast_maths.sin(kx * X[0] + ky * Y[0] + p)
        dx += sea[s, BX, c] * sine
        dy += sea[s, BY, c] * sine
        z1 += a * fast_maths.cos(kx * X[1] + ky * Y[1] + p)
        z2 += a * fast_maths.cos(kx * X[2] + ky * Y[2] + p)
        z3 += a * fast_maths.cos(kx * X[3] + ky * Y[3] + p)
        z4 += a * fast_maths.cos(kx * X[4] + ky * Y[4] + p)
    return ti.Vector([dx, dy, z1, z2, z3, z4])


@ti.func
def displacement_and_corners(around: ti.template(), count: ti.template(), e, X, Y, ahead, right, tau):
    """Displacement (north, east, m) at the label (X, Y), and elevations (m, up) at four labels around it.

    The labels are the corners of a rectangle about (X, Y), bow port, bow starboard, stern port, stern starboard, with
    the half length `ahead` and the half beam `right` (vectors, m). `e` is the environment; the vehicles of a group
    (abreast.py) are taken one by one, with their components in lanes.
    """
    turns = fast_maths.INV_TWO_PI  # of angles, per radian
    x, y, f, g = turns * X, turns * Y, turns * ahead, turns * right
    if ti.static(is_laned(e)):
        found = [X * 0.0 for _ in ti.static(range(6))]
        for lane in range(WIDTH):
            one = _corner_sums(
                around, count, e[lane], x[lane], y[lane], f[0][lane], f[1][lane], g[0][lane], g[1][lane],
                lane_of(tau, lane),
            )  # fmt: skip
            for k in ti.static(range(6)):
                found[k][lane] = one[k]
        return ti.Vector([found[0], found[1]]), ti.Vector([found[2], found[3], found[4], found[5]])
    else:
        one = _corner_sums(around, count, e, x, y, f[0], f[1], g[0], g[1], tau)
        return ti.Vector([one[0], one[1]]), ti.Vector([one[2], one[3], one[4], one[5]])


@ti.func
def component(waves: ti.template(), count: ti.template(), s, c, rows: ti.template()):
    """Rows (conventions.py) of vector c of the `count` components of sea s; `waves` is the table in lanes, flat."""
    size = ti.static(blocks(count))
    first = row_of(s, ti.static(SEA_ROWS * size)) + c
    return [waves[first + row * size] for row in ti.static(rows)]


@ti.func
def _corner_sums(around: ti.template(), count: ti.template(), e, x, y, fx, fy, gx, gy, tau):
    """`displacement_and_corners` of one vehicle: (D north, D east, four elevations), of lengths over 2 pi."""
    s = around.env_sea[e]
    r = ti.static(variables(6, around.waves[0] * 0.0))
    for c in range(ti.static(blocks(count))):
        a, kx, ky, omega, bx, by = component(around.waves, count, s, c, (AMPLITUDE, KX, KY, OMEGA, BX, BY))
        middle = kx * x + ky * y + fast_maths.INV_TWO_PI * (around.turns[e, c] - omega * tau)
        ahead, right = kx * fx + ky * fy, kx * gx + ky * gy
        bow, stern = middle + ahead, middle - ahead
        sine = fast_maths.sin_turns(middle)
        r[0] += bx * sine
        r[1] += by * sine
        r[2] += a * fast_maths.cos_turns(bow - right)
        r[3] += a * fast_maths.cos_turns(bow + right)
        r[4] += a * fast_maths.cos_turns(stern - right)
        r[5] += a * fast_maths.cos_turns(stern + right)
    return totals(r)


@ti.func
def jacobian(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, X, Y, tau):
    """(dx/dX, dx/dY = dy/dX, dy/dY) at the label (X, Y); it is symmetric because b is parallel to k."""
    jxx, jxy, jyy = X * 0.0 + 1.0, X * 0.0, X * 0.0 + 1.0
    for c in range(count):
        kx, ky = sea[s, KX, c], sea[s, KY, c]
        cosine = fast_maths.cos(kx * X + ky * Y + phase[row, c] - sea[s, OMEGA, c] * tau)
        jxx -= sea[s, BX, c] * kx * cosine
        jxy -= sea[s, BX, c] * ky * cosine
        jyy -= sea[s, BY, c] * ky * cosine
    return ti.Vector([jxx, jxy, jyy])


@ti.func
def invert_label(
    sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, x, y, tau, iterations: ti.template()
):
    """Label (X, Y) of the particle at (x, y), by Newton's method with step halving.

    While the surface does not loop (sum k b < 1), the map from labels to points is the gradient of a convex function. A
    step that is short enough then always comes closer, so a step that does not is undone and halved. Seas converge to
    rounding in 5 iterations; a single wave of k a = 0.99, nearly a cusp, needs all of them. A step that rounding
    swallows ends the search.
    """
    label, trial = ti.Vector([x, y]), ti.Vector([x, y])
    step = label * 0.0
    residual = x * 0.0 - 1.0  # squared distance (m^2) of the best label's point from (x, y); -1: none yet
    for _ in range(iterations):
        d = displacement(sea, phase, count, s, row, trial[0], trial[1], tau)
        rx, ry = x - trial[0] + d[0], y - trial[1] + d[1]
        square = rx * rx + ry * ry
        if residual < 0.0 or square < residual:
            label, residual = trial, square
            j = jacobian(sea, phase, count, s, row, label[0], label[1], tau)
            det = ti.max(j[0] * j[2] - j[1] * j[1], SMALLEST_DETERMINANT)
            step = ti.Vector([(j[2] * rx - j[1] * ry) / det, (j[0] * ry - j[1] * rx) / det])
        else:
            step *= 0.5
        trial = label + step
        if trial[0] == label[0] and trial[1] == label[1]:
            break
    return label


@ti.func
def slope_at_label(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, X, Y, tau):
    """Slope (d zeta/dx, d zeta/dy) of the surface in space at the label (X, Y)."""
    zx, zy = X * 0.0, X * 0.0
    for c in range(count):
        a, kx, ky = sea[s, AMPLITUDE, c], sea[s, KX, c], sea[s, KY, c]
        sine = fast_maths.sin(kx * X + ky * Y + phase[row, c] - sea[s, OMEGA, c] * tau)
        zx -= a * kx * sine
        zy -= a * ky * sine
    j = jacobian(sea, phase, count, s, row, X, Y, tau)
    det = j[0] * j[2] - j[1] * j[1]
    return ti.Vector([(zx * j[2] - zy * j[1]) / det, (zy * j[0] - zx * j[1]) / det])


@ti.func
def surface_motion(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, X, Y, tau):
    """Velocity (NED, m/s) and acceleration (NED, m/s^2) of the surface particle with label (X, Y)."""
    v = ti.Vector([X * 0.0, X * 0.0, X * 0.0])
    a = v
    for c in range(count):
        omega = sea[s, OMEGA, c]
        sine, cosine = fast_maths.sincos(sea[s, KX, c] * X + sea[s, KY, c] * Y + phase[row, c] - omega * tau)
        bx, by, height = omega * sea[s, BX, c], omega * sea[s, BY, c], omega * sea[s, AMPLITUDE, c]
        v += ti.Vector([bx * cosine, by * cosine, -height * sine])
        a += omega * ti.Vector([bx * sine, by * sine, height * cosine])
    return v, a


@ti.func
def airy_at(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, x, y, z, depth, g, tau):
    """Linear (Airy) orbital velocity (north, east, up; m/s) and p_dyn / rho (m^2/s^2) at height z <= 0 (up, m).

    See the module's docstring for finite depth.
    """
    vx, vy, vz, p = x * 0.0, x * 0.0, x * 0.0, x * 0.0
    for c in range(count):
        k, omega = sea[s, K, c], sea[s, OMEGA, c]
        theta = sea[s, KX, c] * x + sea[s, KY, c] * y + phase[row, c] - omega * tau
        sine, cosine = fast_maths.sincos(theta)
        decay = ti.exp(k * z)
        up, down = x * 0.0, x * 0.0
        if depth > 0:
            up, down = ti.exp(-2 * k * (depth + z)), ti.exp(-2 * k * depth)
        a = sea[s, AMPLITUDE, c] * decay
        horizontal = a * omega * (1 + up) / (1 - down) * cosine / k
        vx += horizontal * sea[s, KX, c]
        vy += horizontal * sea[s, KY, c]
        vz += a * omega * (1 - up) / (1 - down) * sine
        p += g * a * (1 + up) / (1 + down) * cosine
    return ti.Vector([vx, vy, vz, p])


@ti.func
def stretched(z, zeta, depth):
    """Height z' <= 0 (m) below the instantaneous surface zeta at which linear theory is evaluated, for the height z (m,
    up).

    It is 0 above the surface and -depth below the bottom.
    """
    below = ti.min(z - zeta, 0.0)
    if depth > 0:
        below = ti.max(below / (1 + zeta / depth), -depth)
    return below


@ti.func
def column_at_label(sea: ti.template(), phase: ti.template(), count: ti.template(), s, row, X, Y, below, depth, tau):
    """(eta, velocity 3, acceleration 3) at the stretched height `below` (m, <= 0) under the surface particle (X, Y).

    eta (m) is the dynamic pressure over rho g. Velocity (m/s) and acceleration (m/s^2) are north, east, up.
    """
    eta = X * 0.0
    vx, vy, vz = eta, eta, eta
    ax, ay, az = eta, eta, eta
    for c in range(count):
        k, omega = sea[s, K, c], sea[s, OMEGA, c]
        sine, cosine = fast_maths.sincos(sea[s, KX, c] * X + sea[s, KY, c] * Y + phase[row, c] - omega * tau)
        level = ti.exp(k * below)  # cosh k(z' + depth) / cosh k depth
        upright = level  # sinh k(z' + depth) / sinh k depth
        if depth > 0:
            up, down = ti.exp(-2 * k * (depth + below)), ti.exp(-2 * k * depth)
            upright = level * (1 - up) / (1 - down)
            level = level * (1 + up) / (1 + down)
        a, bx, by = sea[s, AMPLITUDE, c] * upright, sea[s, BX, c] * level, sea[s, BY, c] * level
        eta += sea[s, AMPLITUDE, c] * level * cosine
        vx += bx * omega * cosine
        vy += by * omega * cosine
        vz += a * omega * sine
        ax += bx * omega * omega * sine
        ay += by * omega * omega * sine
        az -= a * omega * omega * cosine
    return ti.Vector([eta, vx, vy, vz, ax, ay, az])
