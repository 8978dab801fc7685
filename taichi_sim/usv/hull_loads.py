"""Loads on a `hull_6dof` as Taichi functions on values, each a six-vector about CO in b (N, N m).

Damping and cross-flow act on the velocity relative to the water. Cross-flow drag is the strip integral

    Y = -1/2 rho T C_d sum |v + x r| (v + x r) dx,   N = -1/2 rho T C_d sum x |v + x r| (v + x r) dx

with Hoerner's (1965) section coefficient (Faltinsen 1990; Fossen 2021, eqs. 6.91-6.92). Pressure on panels is
hydrostatics.py's: averages of a clipped linear pressure times constant unit wrenches.
"""

import taichi as ti

from taichi_sim.conventions import GRAVITY, RHO_SEA
from taichi_sim.rigid_body import cross, six

RHO_AIR = 1.225  # kg/m^3, standard atmosphere at sea level
STILL = 1e-9  # m^2/s^2, keeps the direction of no wind finite

# Rows of the panel table [row, panel]: geometry, then the unit wrenches (hydrostatics.unit_wrenches).
CENTRE, ALONG, UP, TWIST, WRENCH = 0, 3, 6, 9, 12
# moment (m0, m1, ms, m2, mst) and component (X Y Z K M N) of the wrench rows that are not zero by construction
WRENCH_ROWS = tuple((m, j) for m in range(5) for j in range(6) if m < 3 or j > 2)
ACROSS = WRENCH + len(WRENCH_ROWS)  # how far to starboard of its wave point the panel looks, m
AHEAD = ACROSS + 1  # how far ahead of it, m
PANEL_ROWS = AHEAD + 1


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
def panel_load(
    panels: ti.template(), node: ti.template(), head: ti.template(), slope: ti.template(), count: ti.template(),
    e, i, z, k, g
):  # fmt: skip
    """Pressure load on `count` panels: hydrostatic, and the wave's pressure head[e, i, node] (m), whose change to
    starboard is head[e, i, node + slope].

    z (m, down) is CO's depth below mean sea level, k [3] the unit vector downwards in b, g [3] the slope of the mean
    surface plane in b: over a panel the wave's pressure changes by it. The formulas are
    hydrostatics.pressure_moments, in metres of water; sums over panels, contiguous, so that they vectorise.
    """
    X, Y, Z, K, M, N = z * 0.0, z * 0.0, z * 0.0, z * 0.0, z * 0.0, z * 0.0
    slope_b = k + g  # of the pressure head in space
    for p in range(count):
        centre = k[0] * panels[0, p] + k[1] * panels[1, p] + k[2] * panels[2, p]
        d1 = slope_b[0] * panels[3, p] + slope_b[1] * panels[4, p] + slope_b[2] * panels[5, p]
        d2 = slope_b[0] * panels[6, p] + slope_b[1] * panels[7, p] + slope_b[2] * panels[8, p]
        d3 = slope_b[0] * panels[9, p] + slope_b[1] * panels[10, p] + slope_b[2] * panels[11, p]
        p_c = z + centre + head[e, i, node[p]] + panels[36, p] * head[e, i, node[p] + slope] + panels[37, p] * g[0]
        size = ti.abs(d2)
        p_hi = ti.max(p_c + size, 0.0)
        wet = p_c >= size
        w = ti.select(wet, 1.0, p_hi / (2 * size + 1e-12))
        m0 = ti.select(wet, p_c, 0.5 * p_hi * w)
        sign = ti.select(d2 < 0, -1.0, 1.0)
        m1 = ti.select(wet, d2 * (1.0 / 3), m0 * sign * (1 - w * (2.0 / 3)))
        m2 = ti.select(wet, p_c * (1.0 / 3), m0 * (1 - w * (4.0 / 3 - w * (2.0 / 3))))
        ms = ti.max(ti.min(w * d1, m0), -m0) * (1.0 / 3)
        mst = ti.max(ti.min(w * d3, m0), -m0) * (1.0 / 9)
        X -= panels[12, p] * m0 + panels[18, p] * m1 + panels[24, p] * ms
        Y -= panels[13, p] * m0 + panels[19, p] * m1 + panels[25, p] * ms
        Z -= panels[14, p] * m0 + panels[20, p] * m1 + panels[26, p] * ms
        K -= panels[15, p] * m0 + panels[21, p] * m1 + panels[27, p] * ms + panels[30, p] * m2 + panels[33, p] * mst
        M -= panels[16, p] * m0 + panels[22, p] * m1 + panels[28, p] * ms + panels[31, p] * m2 + panels[34, p] * mst
        N -= panels[17, p] * m0 + panels[23, p] * m1 + panels[29, p] * ms + panels[32, p] * m2 + panels[35, p] * mst
    return ti.static(RHO_SEA * GRAVITY) * ti.Vector([X, Y, Z, K, M, N])
