"""Water at a hull: its mean surface plane, its motion averaged over the hull, its pressure, the current, the freeboard.

Waves are summed at the label of the hull's centre: the position in still water of the particle that waves have
displaced to the centre (sea/gerstner.py). Means are over the hull's waterplane (`Gauge`): elevation and slopes of the
plane with the best fit and, at the depth of the draft, the orbital motion nu_o of the water. In finite depth,
horizontal motion decays by exp(-omega^2/g d), vertical motion by exp(-g k^2/omega^2 d). Both equal exp(-k d) in deep
water, and the exact factors to first order in k d.

The load of the pressure on the hull's panels is hydrostatic plus Froude-Krylov (the undisturbed wave).
The pressure head at a point, p / (rho g) in m, is its depth below mean sea level plus, for every component of the sea,

    a exp(-k d) cos(k . x + phase - omega t).

d is the depth below the hull's mean surface plane. (Wheeler's stretching (1970, J. Petrol. Technol. 22, 359) counts
from the elevation at the point. Counting from the plane lets one exponential serve a whole line.) In finite depth the
decay is exp(-omega^2/g d), because hulls lie near the surface. Waves are summed at the points of lines (`WaveLines`)
and carried from there to the panels. On a panel the pressure is linear, and clipped at zero out of the water. The load
is the sum of its averages over strips times constant unit wrenches (hydrostatic_stability.py).

Still water pushes a closed hull along the normal of its surface only, through the centroid of the wet volume. Where
keels or decks cross the surface, strips miss that by their errors. The load of still water below the mean surface plane
is then computed as well, and what it has along the plane, and about its normal, is taken back. A wave's own force stays
as it is: only errors at the pose of the hull relative to the plane go.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.kernels import fast_maths
from taichi_sim.kernels.abreast import taken2
from taichi_sim.kernels.conventions import AMPLITUDE, BELOW, BX, BY, GRAVITY, KX, KY, OMEGA, RHO_SEA, K
from taichi_sim.kernels.lanes import blocks, filled, laned, laned_totals, taken_lanes, total, totals, variables, width
from taichi_sim.kernels.rigid_body import cross, six
from taichi_sim.models.usv.hull.geometry import HullGeometry, averages, device_table
from taichi_sim.models.usv.hull.hydrostatic_stability import Strips
from taichi_sim.surroundings.sea.gerstner import component

SUMS = 18  # numbers that `at_centre` returns:
D_N, D_E, J_XX, J_XY, J_YY, ELEVATION, SLOPE_ALONG, SLOPE_ACROSS, *_motion = range(SUMS)
V_N, V_E, V_D, A_N, A_E, A_D, P, Q, P_DOT, Q_DOT = _motion
LABEL_STEPS = 4  # of Newton's method, from zero displacement
HALF_TURN = 3.14159265  # rad; waves shorter than a line's step cancel over it

# Rows of the panel table [row, panel] (m, b): middle of the panel; half the vector between its two strips; half a
# strip's vector, mean of the two and half their difference; position of the panel to starboard and ahead of its wave
# point; then the unit wrenches of both strips that are not zero (hydrostatics.Strips). Kernels have them as
# [vector of panels * PANEL_ROWS + row].
STRIPS = 2
CENTRE, ALONG, UP, TWIST, ACROSS, AHEAD, WRENCH = 0, 3, 6, 9, 12, 13, 14
# Moment (m0, m1, m2) and component (X Y Z K M N) of the wrench rows of a strip
WRENCH_ROWS = tuple((m, j) for m in range(3) for j in range(6) if m < 2 or j > 2)
SECOND = len(WRENCH_ROWS)  # first wrench row of the second strip, counted from WRENCH
PANEL_ROWS = WRENCH + STRIPS * SECOND
SIDE, CORNER_ROWS = 3, 4  # row of the corner table, behind the position; rows


CORNER_DIGITS = 9  # m, decimals to which corners of neighbours are the same


class Pressure(NamedTuple):
    """Compile-time sizes of the pressure kernels."""

    panels: int  # number of panels
    corners: int  # number of their corners (`corner_table`)
    abreast: int  # wave lines that share a step: a group
    points: int  # points per wave line
    groups: int
    first: int  # first column in the auxiliary state; the columns of a group are whole vectors (lanes.py)
    node: tuple[int, ...]  # point of all lines at which each panel reads the head

    @classmethod
    def of(cls, geometry: HullGeometry, used: int) -> "Pressure":
        """Sizes for the panels and lines of a hull, behind `used` columns."""
        lines = geometry.lines
        groups, node = len(lines.start) // lines.abreast, tuple(lines.node.tolist())
        corners = corner_table(geometry).shape[1]
        return cls(len(geometry.panels), corners, lines.abreast, lines.points, groups, filled(used), node)

    @property
    def size(self) -> int:
        """Number of a group's heads (m); their changes to starboard (m/m) follow."""
        return self.abreast * self.points

    @property
    def stride(self) -> int:
        """Number of columns of a group."""
        return filled(2 * self.size)

    @property
    def heads(self) -> int:
        """First column of the panels' heads (m)."""
        return self.first + self.groups * self.stride

    @property
    def end(self) -> int:
        """First column behind those of the pressure."""
        return self.heads + filled(self.panels)

    def column(self, node: ArrayLike) -> NDArray:
        """Columns of the heads at `node`, numbers of points of all lines."""
        group, place = np.divmod(node, self.size)
        return self.first + group * self.stride + place

    def read(self, block: int) -> tuple[list[int], list[int]]:
        """Columns of the heads, and of their changes to starboard, that the panels in a vector read."""
        heads = self.column(self.node[block * width() : (block + 1) * width()])
        return heads.tolist(), (heads + self.size).tolist()


def panel_table(geometry: HullGeometry) -> NDArray[np.float64]:
    """Panel table, [PANEL_ROWS, panel]."""
    strips = Strips.of(geometry.panels, STRIPS)
    (c1, c2), (u1, u2) = strips.centre, strips.up
    table = np.zeros((PANEL_ROWS, len(geometry.panels)))
    table[:ACROSS] = np.concatenate([c1 + c2, c2 - c1, u1 + u2, u2 - u1], axis=1).T / 2
    table[ACROSS], table[AHEAD] = geometry.lines.across, geometry.lines.ahead
    table[WRENCH:] = [strip[:, m, j] for strip in strips.wrench for m, j in WRENCH_ROWS]
    return table


def corner_table(geometry: HullGeometry) -> NDArray[np.float64]:
    """Corner table, [CORNER_ROWS, corner]: positions (m, b) times SIDE, and SIDE: 1 in the design water, -1 above it.

    While every corner stays on its side, water lines cross panels from side to side, and strips are nearly exact
    (hydrostatic_stability.py). A corner of a panel that the design waterline crosses otherwise is on both sides, so
    never stays.
    """
    corner = geometry.panels.corners.round(CORNER_DIGITS)
    side = np.sign(corner[..., BELOW])
    otherwise = (side[:, 0] * side[:, 1] < 0) | (side[:, 2] * side[:, 3] < 0)
    odd = corner[otherwise, 0]
    own = np.unique(corner.reshape(-1, 3), axis=0)
    at, side = np.concatenate([own, odd, odd]), np.concatenate([np.sign(own[:, BELOW]), *np.ones((2, len(odd)))])
    side[len(own) + len(odd) :] = -1
    return np.concatenate([side * at.T, side[None]])[:, side != 0]


def by_block(table: NDArray[np.float64]) -> Tensor:
    """Convert a table [row, n] for kernels, which have it as [vector of n * rows + row]."""
    return laned(device_table(table)).transpose(0, 1).flatten(0, 1).contiguous()


def line_table(geometry: HullGeometry) -> NDArray[np.float64]:
    """Line table, [group, 3 abreast + 3]: first points of the lines that share a step, and the step, m, b."""
    lines = geometry.lines
    return np.concatenate([lines.start.reshape(-1, 3 * lines.abreast), lines.step[:: lines.abreast]], axis=1)


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
    (SLOPE_ALONG, SLOPE_ACROSS) of the mean plane; and the water's motion averaged over the hull at gauge.depth:
    velocity (V_N, V_E, V_D, m/s, n), acceleration (A_N, A_E, A_D), roll and pitch rate about the heading axes (P, Q,
    rad/s) and their rates (P_DOT, Q_DOT).
    """
    r = ti.static(variables(SUMS, sea[0] * 0.0))
    cos_u, sin_u = cos_h * gauge.along.scale, sin_h * gauge.along.scale
    cos_v, sin_v = cos_h * gauge.across.scale, sin_h * gauge.across.scale
    for c in range(ti.static(blocks(count))):
        a, kx, ky, k, omega, bx, by = component(sea, count, s, c, (AMPLITUDE, KX, KY, K, OMEGA, BX, BY))
        sine, cosine = fast_maths.sincos_short(phase[row, c] - omega * tau + kx * X + ky * Y)
        mean_u, slope_u = averages(gauge.along, kx * cos_u + ky * sin_u)
        mean_v, slope_v = averages(gauge.across, ky * cos_v - kx * sin_v)
        slope_u *= mean_v
        slope_v *= mean_u
        mean = mean_u * mean_v
        decay = fast_maths.exp_decay(k * gauge.depth)
        decay_h = decay
        if ti.static(finite):
            decay_h = fast_maths.exp_decay(omega * omega * ti.static(gauge.depth / GRAVITY))
            decay = fast_maths.exp_decay(k * k * ti.static(gauge.depth * GRAVITY) / (omega * omega))
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
        r[SLOPE_ALONG] = r[SLOPE_ALONG] - slope_u * a_sine
        r[SLOPE_ACROSS] = r[SLOPE_ACROSS] - slope_v * a_sine
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
    along, across = sums[SLOPE_ALONG], sums[SLOPE_ACROSS]
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


@ti.func
def pressure_load(
    sizes: ti.template(), build: ti.template(), around: ti.template(), tables: ti.template(), rows: ti.template(),
    e, i, tau, pos, R, L, J, plane
):  # fmt: skip
    """Load (N, N m, about CO, b) on vehicle i in environment e, tau s after the beginning of a step.

    The heads are written to the auxiliary state, whose vectors are `rows`. `sizes` is a Pressure; L and J come from
    `at`, `plane` from `mean_plane`.
    """
    write_heads(sizes, build, around, tables.lines, rows, e, i, tau, pos, R, L, J, plane)
    carry_heads(sizes, tables, rows, e, i)
    return panel_load(sizes, tables, rows, e, i, pos[2], R, plane)


@ti.func
def write_heads(
    sizes: ti.template(), build: ti.template(), around: ti.template(), lines: ti.template(), rows: ti.template(),
    e, i, tau, pos, R, L, J, plane
):  # fmt: skip
    """Write the wave's pressure head (m), and its change to starboard, at every point of the wave lines to `rows`."""
    s = around.env_sea[e]
    abreast, stride = ti.static(sizes.abreast, blocks(sizes.stride))
    for group in range(lines.shape[0]):
        h = R @ ti.Vector([lines[group, ti.static(3 * abreast) + c] for c in ti.static(range(3))])
        step = ti.Vector([J[0] * h[0] + J[1] * h[1], J[1] * h[0] + J[2] * h[1]])
        across = ti.Vector([J[0] * R[0, 1] + J[1] * R[1, 1], J[1] * R[0, 1] + J[2] * R[1, 1]])
        starts = [
            line_start(
                sizes.points, R @ ti.Vector([lines[group, 3 * n + c] for c in ti.static(range(3))]),
                h, pos, L, J, plane,
            )
            for n in ti.static(range(abreast))
        ]  # fmt: skip
        found = along_lines(build, around, sizes.points, s, e, starts, step, across, tau)
        for b in ti.static(range(blocks(2 * sizes.size))):
            rows[e, i, ti.static(blocks(sizes.first) + b) + group * stride] = found[b]


@ti.func
def carry_heads(sizes: ti.template(), tables: ti.template(), rows: ti.template(), e, i):
    """Write the wave's pressure head (m) at every panel to `rows`, from those at the points of the wave lines."""
    first = ti.static(blocks(sizes.heads))
    if ti.static(width() > 1):
        for p in ti.static(range(blocks(sizes.panels))):
            heads, changes = ti.static(sizes.read(p))
            change = tables.panels[p * PANEL_ROWS + ACROSS] * taken_lanes(rows, e, i, changes)
            rows[e, i, first + p] = taken_lanes(rows, e, i, heads) + change
    else:
        for p in range(sizes.panels):
            at = tables.node[p]
            change = tables.panels[p * PANEL_ROWS + ACROSS] * rows[e, i, at + ti.static(sizes.size)]
            rows[e, i, first + p] = rows[e, i, at] + change


@ti.func
def line_start(points: ti.template(), r, h, pos, L, J, plane):
    """Label of a line's first point, at r from CO (m, n), its depth below the mean plane, and the change of depth per
    step.

    h (m, n) is the step. The end of a line that is in the air counts as on the surface.
    """
    last = ti.static(max(points - 1, 1))
    d = pos[2] + r[2] + plane[0] + plane[1] * r[0] + plane[2] * r[1]
    end = d + last * (h[2] + plane[1] * h[0] + plane[2] * h[1])
    d, end = ti.max(d, 0.0), ti.max(end, 0.0)
    X, Y = L[0] + J[0] * r[0] + J[1] * r[1], L[1] + J[1] * r[0] + J[2] * r[1]
    return ti.Vector([X, Y, d, (end - d) * ti.static(1.0 / last)])


@ti.func
def along_lines(
    build: ti.template(), around: ti.template(), points: ti.template(), s, e, starts: ti.template(), step, across, tau
):  # fmt: skip
    """Dynamic pressure head p / (rho g) (m) at `points` points on each of a few parallel lines.

    `starts` hold, for each line, the label and the depth (m, below the mean plane) of its first point, and the
    change of depth per step. `step` is the change of label per step, the same for all. Returns the heads on each
    line, and their changes (m/m) in the direction `across` of labels, in lanes.

    Each head is a mean over one step's length around the point, so that a row of panels adds up to the integral along
    it. The lines share the terms that depend on their direction.
    """
    count, size = ti.static(build.components, len(starts) * points)
    found = ti.static(variables(2 * size, around.waves[0] * 0.0))
    for c in range(ti.static(blocks(count))):
        a, kx, ky, k, omega = component(around.waves, count, s, c, (AMPLITUDE, KX, KY, K, OMEGA))
        rate = k
        if ti.static(build.finite):
            rate = omega * omega * ti.static(1 / GRAVITY)
        # Half a turn also gives the mean over a step's length, by its sinc. Waves shorter than a step cancel.
        turn, k_across = kx * step[0] + ky * step[1], kx * across[0] + ky * across[1]
        half = fast_maths.at_least(fast_maths.at_most(0.5 * turn, HALF_TURN), -HALF_TURN)
        sinc, half_cosine = fast_maths.sinc_short(half), fast_maths.cos_short(half)
        half_sine = half * sinc
        cosine_step, sine_step = 1 - 2 * half_sine * half_sine, 2 * half_sine * half_cosine
        amplitude, begin = a * sinc, around.turns[e, c] - omega * tau
        for n in ti.static(range(len(starts))):
            X, Y, depth, deeper = starts[n][0], starts[n][1], starts[n][2], starts[n][3]
            sine, cosine = fast_maths.sincos_short(begin + kx * X + ky * Y)
            decayed, m = amplitude * fast_maths.exp_decay(rate * depth), fast_maths.exp_near_one(rate * deeper)
            re, im, step_re, step_im = decayed * cosine, decayed * sine, m * cosine_step, m * sine_step
            for i in ti.static(range(points)):
                at = ti.static(n * points + i)
                found[at] += re
                found[size + at] = found[size + at] - k_across * im
                if ti.static(i < points - 1):
                    re, im = re * step_re - im * step_im, re * step_im + im * step_re
    return laned_totals(found)


@ti.func
def strip_moments(p_c, d):
    """hydrostatics.pressure_moments, split into the head up to 2 |d| (a ramp that begins in the strip) and the rest."""
    size = fast_maths.at_least(d, 0.0 - d)
    wet = fast_maths.at_least(p_c + size, 0.0)
    ramp = fast_maths.at_most(wet, 2 * size)
    over = wet - ramp
    inverse = 1.0 / (2 * size + 1e-12)
    w = ramp * inverse
    m = 0.5 * ramp * w
    m1 = m * (1 - w * (2.0 / 3)) * (2 * d * inverse)
    return m + over, m1, m * (1 - w * (4.0 / 3 - w * (2.0 / 3))) + over * (1.0 / 3)


@ti.func
def along(panels: ti.template(), row, v):
    """Dot product of v with the vector that begins at `row` of the panel table."""
    return v[0] * panels[row] + v[1] * panels[row + 1] + v[2] * panels[row + 2]


@ti.func
def add_strips(sums: ti.template(), panels: ti.template(), at, p_c, slope_b):
    """Add to `sums` the wrench, per -rho g, of the head p_c (m) with the gradient `slope_b` on the panels whose table
    begins at the row `at`.
    """
    d1 = along(panels, at + ALONG, slope_b)
    d2 = along(panels, at + UP, slope_b)
    d3 = along(panels, at + TWIST, slope_b)
    first = strip_moments(p_c - d1, d2 - d3)
    second = strip_moments(p_c + d1, d2 + d3)
    for row in ti.static(range(SECOND)):
        m, j = ti.static(WRENCH_ROWS[row])
        sums[j] += panels[at + ti.static(WRENCH + row)] * first[m]
        sums[j] += panels[at + ti.static(WRENCH + SECOND + row)] * second[m]


@ti.func
def panel_load(sizes: ti.template(), tables: ti.template(), rows: ti.template(), e, i, z, R, plane):
    """Load (N, N m, about CO, b) of the panels' heads in `rows`, with CO at the depth z (m) below mean sea level.

    Over a panel, the wave's pressure changes with the mean surface plane.
    """
    k = ti.Vector([R[2, 0], R[2, 1], R[2, 2]])  # downwards in b
    g = R.transpose() @ ti.Vector([plane[1], plane[2], 0.0])  # slope of the surface plane in b
    panels, corners = ti.static(tables.panels, tables.corners)
    sums, crossed = ti.static(variables(6, panels[0] * 0.0)), corners[0] * 0.0
    slope_b, depth = k + g, z + plane[0]  # gradient of the pressure head, b; of CO below the plane, m
    for p in range(ti.static(blocks(sizes.panels))):
        at = p * PANEL_ROWS
        p_c = z + along(panels, at + CENTRE, k) + panels[at + AHEAD] * g[0]
        p_c += rows[e, i, ti.static(blocks(sizes.heads)) + p]
        add_strips(sums, panels, at, p_c, slope_b)
    for c in range(ti.static(blocks(sizes.corners))):
        at = c * CORNER_ROWS
        kept = along(corners, at, slope_b) + corners[at + SIDE] * depth
        crossed += fast_maths.at_least(0.0 - kept, 0.0)
    if total(crossed) > 0.0:
        rest = still_remainder(sizes, panels, depth, slope_b)
        for j in ti.static(range(6)):
            sums[j] = sums[j] - rest[j]
    return ti.static(-RHO_SEA * GRAVITY) * totals(sums)


@ti.func
def still_remainder(sizes: ti.template(), panels: ti.template(), depth, slope_b):
    """Load per rho g (m^3, m^4; in lanes) along the surface, and about its normal, that the strips' errors leave in
    still water: level with the mean surface plane, which is `depth` (m) above CO and has `slope_b` as normal.
    """
    sums = ti.static(variables(6, panels[0] * 0.0))
    for p in range(ti.static(blocks(sizes.panels))):
        at = p * PANEL_ROWS
        p_c = depth + along(panels, at + CENTRE, slope_b)
        add_strips(sums, panels, at, p_c, slope_b)
    n = slope_b / slope_b.norm()
    up = sums[0] * n[0] + sums[1] * n[1] + sums[2] * n[2]
    turn = sums[3] * n[0] + sums[4] * n[1] + sums[5] * n[2]
    for j in ti.static(range(3)):
        sums[j] = sums[j] - up * n[j]
        sums[3 + j] = turn * n[j]
    return sums
