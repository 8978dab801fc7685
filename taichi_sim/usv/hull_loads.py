"""Loads on a `hull_6dof` as Taichi functions on values, each a six-vector about CO in b (N, N m).

Damping and cross-flow act on the velocity relative to the water. Cross-flow drag is the strip integral

    Y = -1/2 rho T C_d sum |v + x r| (v + x r) dx,   N = -1/2 rho T C_d sum x |v + x r| (v + x r) dx

with Hoerner's (1965) section coefficient (Faltinsen 1990; Fossen 2021, eqs. 6.91-6.92). Pressure on panels is
hydrostatics.py's: averages of a clipped linear pressure on strips times constant unit wrenches.
"""

import taichi as ti

from taichi_sim.conventions import GRAVITY, RHO_SEA
from taichi_sim.rigid_body import cross, six

RHO_AIR = 1.225  # kg/m^3, standard atmosphere at sea level
STILL = 1e-9  # m^2/s^2, keeps the direction of no wind finite

# Rows of the panel table [row, panel]: middle of the panel (m, b); half of the way between its two strips; half a
# strip's length, mean of the two and half their difference; how far to starboard and ahead of its wave point it lies;
# then the unit wrenches of either strip that are not zero (hydrostatics.Strips).
STRIPS = 2
CENTRE, ALONG, UP, TWIST, ACROSS, AHEAD, WRENCH = 0, 3, 6, 9, 12, 13, 14
# moment (m0, m1, m2) and component (X Y Z K M N) of the wrench rows of a strip
WRENCH_ROWS = tuple((m, j) for m in range(3) for j in range(6) if m < 2 or j > 2)
PANEL_ROWS = WRENCH + STRIPS * len(WRENCH_ROWS)


@ti.func
def diagonal_damping(linear: ti.template(), quadratic: ti.template(), nu_r):
    """-D nu_r with diagonal linear and quadratic coefficients."""
    load = nu_r * 0.0
    for i in ti.static(range(6)):
        load[i] = -(linear[i] + quadratic[i] * ti.abs(nu_r[i])) * nu_r[i]
    return load


@ti.func
def cross_flow(h: ti.template(), v, r):
    """Sway force and yaw moment (Y, N) of the strip integral; `h` is a Hydrodynamics section."""
    Y, N = v * 0.0, v * 0.0
    strips = ti.static(h.cross_flow_strips)
    dx = ti.static(h.cross_flow_length / (h.cross_flow_strips - 1))
    for i in range(strips):
        x = i * dx - ti.static(0.5 * h.cross_flow_length)
        w = v + x * r
        drag = ti.abs(w) * w
        Y -= drag
        N -= x * drag
    scale = ti.static(0.5 * h.cross_flow_density * h.cross_flow_draft * h.cross_flow_coefficient) * dx
    return ti.Vector([Y * scale, N * scale])


@ti.func
def windage(w: ti.template(), length: ti.template(), air_b):
    """Wind load of the air's velocity relative to the hull, air_b (m/s, b)."""
    u, v = air_b[0], air_b[1]
    speed = ti.sqrt(u * u + v * v + STILL)
    X = ti.static(0.5 * RHO_AIR * w.c_x * w.frontal_area) * speed * u
    Y = ti.static(0.5 * RHO_AIR * w.c_y * w.lateral_area) * speed * v
    # sin(2 gamma) V^2 = -2 u v: the force acts towards the end that the wind meets first
    N = -ti.static(RHO_AIR * w.c_n * w.lateral_area * length) * u * v
    return ti.Vector([X, Y, 0.0, w.height * Y, -w.height * X, N])


@ti.func
def thrust(t: ti.template(), n):
    """Thrust (N) of one propeller at shaft speed n (rad/s), limited to its range."""
    n = ti.max(ti.min(n, t.n_max), t.n_min)
    k = ti.select(n > 0, t.k_positive, t.k_negative)
    return k * ti.abs(n) * n


@ti.func
def thruster_load(t: ti.template(), n_left, n_right):
    """Load of both propellers, which push along the hull."""
    left, right = thrust(t, n_left), thrust(t, n_right)
    total = left + right
    pitch = left * t.left[2] + right * t.right[2]
    yaw = -(left * t.left[1] + right * t.right[1])
    return ti.Vector([total, 0.0, 0.0, 0.0, pitch, yaw])


@ti.func
def shaft_speed(t: ti.template(), force):
    """Shaft speed (rad/s) whose thrust is `force` (N)."""
    k = ti.select(force > 0, t.k_positive, t.k_negative)
    n = ti.sqrt(ti.abs(force) / k)
    return ti.select(force > 0, n, -n)


@ti.func
def weight_load(weight: ti.template(), position: ti.template(), k):
    """Load of a weight (N) at `position` (m, b); k is the unit vector downwards in b."""
    force = weight * k
    return six(force, cross(ti.Vector([position[0], position[1], position[2]]), force))


@ti.func
def strip_moments(p_c, d):
    """hydrostatics.pressure_moments."""
    size = ti.abs(d)
    p_hi = ti.max(p_c + size, 0.0)
    wet = p_c >= size
    w = ti.select(wet, 1.0, p_hi / (2 * size + 1e-12))
    m0 = ti.select(wet, p_c, 0.5 * p_hi * w)
    sign = ti.select(d < 0, -1.0, 1.0)
    m1 = ti.select(wet, d * (1.0 / 3), m0 * sign * (1 - w * (2.0 / 3)))
    m2 = ti.select(wet, p_c * (1.0 / 3), m0 * (1 - w * (4.0 / 3 - w * (2.0 / 3))))
    return m0, m1, m2


@ti.func
def panel_load(
    panels: ti.template(), node: ti.template(), head: ti.template(), slope: ti.template(), count: ti.template(),
    e, i, z, k, g
):  # fmt: skip
    """Pressure load on `count` panels of two strips each: hydrostatic, and the wave's pressure head[e, i, node] (m),
    whose change to starboard is head[e, i, node + slope].

    z (m, down) is CO's depth below mean sea level, k [3] the unit vector downwards in b, g [3] the slope of the mean
    surface plane in b: over a panel the wave's pressure changes by it. Heads are in metres of water; sums over panels,
    contiguous, so that they vectorise.
    """
    X, Y, Z, K, M, N = z * 0.0, z * 0.0, z * 0.0, z * 0.0, z * 0.0, z * 0.0
    slope_b = k + g  # of the pressure head in space
    for p in range(count):
        p_c = z + k[0] * panels[0 * count + p] + k[1] * panels[1 * count + p] + k[2] * panels[2 * count + p]
        p_c += (
            head[e, i, node[p]] + panels[12 * count + p] * head[e, i, node[p] + slope] + panels[13 * count + p] * g[0]
        )
        d1 = (
            slope_b[0] * panels[3 * count + p] + slope_b[1] * panels[4 * count + p] + slope_b[2] * panels[5 * count + p]
        )
        d2 = (
            slope_b[0] * panels[6 * count + p] + slope_b[1] * panels[7 * count + p] + slope_b[2] * panels[8 * count + p]
        )
        d3 = (
            slope_b[0] * panels[9 * count + p]
            + slope_b[1] * panels[10 * count + p]
            + slope_b[2] * panels[11 * count + p]
        )
        a0, a1, a2 = strip_moments(p_c - d1, d2 - d3)
        b0, b1, b2 = strip_moments(p_c + d1, d2 + d3)
        X -= (
            panels[14 * count + p] * a0
            + panels[20 * count + p] * a1
            + panels[29 * count + p] * b0
            + panels[35 * count + p] * b1
        )
        Y -= (
            panels[15 * count + p] * a0
            + panels[21 * count + p] * a1
            + panels[30 * count + p] * b0
            + panels[36 * count + p] * b1
        )
        Z -= (
            panels[16 * count + p] * a0
            + panels[22 * count + p] * a1
            + panels[31 * count + p] * b0
            + panels[37 * count + p] * b1
        )
        K -= panels[17 * count + p] * a0 + panels[23 * count + p] * a1 + panels[26 * count + p] * a2
        K -= panels[32 * count + p] * b0 + panels[38 * count + p] * b1 + panels[41 * count + p] * b2
        M -= panels[18 * count + p] * a0 + panels[24 * count + p] * a1 + panels[27 * count + p] * a2
        M -= panels[33 * count + p] * b0 + panels[39 * count + p] * b1 + panels[42 * count + p] * b2
        N -= panels[19 * count + p] * a0 + panels[25 * count + p] * a1 + panels[28 * count + p] * a2
        N -= panels[34 * count + p] * b0 + panels[40 * count + p] * b1 + panels[43 * count + p] * b2
    return ti.static(RHO_SEA * GRAVITY) * ti.Vector([X, Y, Z, K, M, N])
