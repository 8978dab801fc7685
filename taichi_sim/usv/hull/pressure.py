"""Loads on a `hull_6dof` as Taichi functions on values, each a six-vector about CO in b (N, N m).

Damping and cross-flow act on the velocity relative to the water. Cross-flow drag is the strip integral

    Y = -1/2 rho T C_d sum |v + x r| (v + x r) dx,   N = -1/2 rho T C_d sum x |v + x r| (v + x r) dx

with Hoerner's (1965) section coefficient (Faltinsen 1990; Fossen 2021, eqs. 6.91-6.92). Pressure on panels is
hydrostatics.py's: averages of a clipped linear pressure on strips times constant unit wrenches.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

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
SECOND = len(WRENCH_ROWS)  # first row of the second strip's, from WRENCH on
PANEL_ROWS = WRENCH + STRIPS * SECOND


@ti.func
def diagonal_damping(linear: ti.template(), quadratic: ti.template(), nu_r):
    """-D nu_r with diagonal linear and quadratic coefficients, six numbers each."""
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
def windage(p: ti.template(), height: ti.template(), air_b):
    """Wind load of the air's velocity relative to the hull, air_b (m/s, b), on areas whose centre is `height` (m) up.

    `p` has wind_x = rho c_x A_f / 2, wind_y = rho c_y A_l / 2 and wind_n = rho c_n A_l L (params.Windage).
    """
    u, v = air_b[0], air_b[1]
    speed = ti.sqrt(u * u + v * v + STILL)
    X = p.wind_x * speed * u
    Y = p.wind_y * speed * v
    # sin(2 gamma) V^2 = -2 u v: the force acts towards the end that the wind meets first
    N = -p.wind_n * u * v
    return ti.Vector([X, Y, 0.0, height * Y, -height * X, N])


@ti.func
def weight_load(weight: ti.template(), position: ti.template(), k):
    """Load of a weight (N) at `position` (three numbers, m, b); k is the unit vector downwards in b."""
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
def along(panels: ti.template(), row: ti.template(), count: ti.template(), p, v):
    """Dot product of v with the vector that begins at `row` of the panel table."""
    return v[0] * panels[row * count + p] + v[1] * panels[(row + 1) * count + p] + v[2] * panels[(row + 2) * count + p]


@ti.func
def wrench(panels: ti.template(), row: ti.template(), count: ti.template(), p):
    """One component of a unit wrench: `row` counts through WRENCH_ROWS, the second strip's from SECOND on."""
    return panels[(WRENCH + row) * count + p]


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
        p_c = z + along(panels, CENTRE, count, p, k)
        p_c += (
            head[e, i, node[p]]
            + panels[ACROSS * count + p] * head[e, i, node[p] + slope]
            + panels[AHEAD * count + p] * g[0]
        )
        d1 = along(panels, ALONG, count, p, slope_b)
        d2 = along(panels, UP, count, p, slope_b)
        d3 = along(panels, TWIST, count, p, slope_b)
        a0, a1, a2 = strip_moments(p_c - d1, d2 - d3)
        b0, b1, b2 = strip_moments(p_c + d1, d2 + d3)
        X -= (
            wrench(panels, 0, count, p) * a0
            + wrench(panels, 6, count, p) * a1
            + wrench(panels, SECOND + 0, count, p) * b0
            + wrench(panels, SECOND + 6, count, p) * b1
        )
        Y -= (
            wrench(panels, 1, count, p) * a0
            + wrench(panels, 7, count, p) * a1
            + wrench(panels, SECOND + 1, count, p) * b0
            + wrench(panels, SECOND + 7, count, p) * b1
        )
        Z -= (
            wrench(panels, 2, count, p) * a0
            + wrench(panels, 8, count, p) * a1
            + wrench(panels, SECOND + 2, count, p) * b0
            + wrench(panels, SECOND + 8, count, p) * b1
        )
        K -= wrench(panels, 3, count, p) * a0 + wrench(panels, 9, count, p) * a1 + wrench(panels, 12, count, p) * a2
        K -= (
            wrench(panels, SECOND + 3, count, p) * b0
            + wrench(panels, SECOND + 9, count, p) * b1
            + wrench(panels, SECOND + 12, count, p) * b2
        )
        M -= wrench(panels, 4, count, p) * a0 + wrench(panels, 10, count, p) * a1 + wrench(panels, 13, count, p) * a2
        M -= (
            wrench(panels, SECOND + 4, count, p) * b0
            + wrench(panels, SECOND + 10, count, p) * b1
            + wrench(panels, SECOND + 13, count, p) * b2
        )
        N -= wrench(panels, 5, count, p) * a0 + wrench(panels, 11, count, p) * a1 + wrench(panels, 14, count, p) * a2
        N -= (
            wrench(panels, SECOND + 5, count, p) * b0
            + wrench(panels, SECOND + 11, count, p) * b1
            + wrench(panels, SECOND + 14, count, p) * b2
        )
    return ti.static(RHO_SEA * GRAVITY) * ti.Vector([X, Y, Z, K, M, N])
