"""The water at a hull, as methods that kernels inline: surface, freeboard, pressure on the wave lines, its motion."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.packs import Build
from taichi_sim.rigid_body import cross, six
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.hull import pressure
from taichi_sim.usv.hull import waves as w
from taichi_sim.usv.hull.model import HullModel

LABEL_STEPS = 4  # of Newton's method from no displacement


@ti.func
def heading(R):
    """Cosine and sine of the heading of R = R_nb."""
    inverse = 1.0 / ti.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0] + 1e-12)
    return R[0, 0] * inverse, R[1, 0] * inverse


class HullWater(HullModel):
    """How waves and current reach the hull."""

    def water_build(self, around: Surroundings) -> Build:
        """What a kernel is compiled for that asks for the water alone."""
        return Build(around.sea.shape[2], around.depth > 0)

    @ti.func
    def water(
        self, sea: ti.template(), phase: ti.template(), count: ti.template(), finite: ti.template(),
        s, e, tau, pos, R, D
    ):  # fmt: skip
        """Sums at the hull's centre (w.at_centre), its label, and the inverse Jacobian (xx, xy, yy) there.

        D (m) is the predicted displacement of the label: one step of Newton's method makes it exact to second order.
        """
        cos_h, sin_h = heading(R)
        X, Y = pos[0] + D[0], pos[1] + D[1]
        r = w.at_centre(sea, phase, count, self.gauge, finite, s, e, X, Y, tau, cos_h, sin_h)
        xx, xy, yy = r[w.J_XX], r[w.J_XY], r[w.J_YY]
        inverse = 1.0 / ti.max(xx * yy - xy * xy, 0.01)
        J = ti.Vector([yy * inverse, -xy * inverse, xx * inverse])
        gap = ti.Vector([r[w.D_N] - D[0], r[w.D_E] - D[1]])
        L = ti.Vector([X + J[0] * gap[0] + J[1] * gap[1], Y + J[1] * gap[0] + J[2] * gap[1]])
        return r, L, J

    @ti.func
    def water_at(self, build: ti.template(), around: ti.template(), e, tau, pos, R, D):
        """`water` in the surroundings of environment e."""
        return self.water(
            around.sea, around.phase, build.components, build.finite, around.env_sea[e], e, tau, pos, R, D
        )

    @ti.func
    def label(self, build: ti.template(), around: ti.template(), e, pos, R):
        """Displacement (m) of the label under the hull at the beginning of a step, with none to predict it from."""
        now = pos[0] * 0.0
        D = ti.Vector([now, now])
        for _ in range(LABEL_STEPS):
            _water, L, _J = self.water_at(build, around, e, now, pos, R, D)
            D = L - ti.Vector([pos[0], pos[1]])
        return D

    @ti.func
    def plane_n(self, water, R):
        """Elevation (m) and slopes towards north and east of the mean surface plane."""
        cos_h, sin_h = heading(R)
        along, across = water[w.ALONG], water[w.ACROSS]
        return ti.Vector([water[w.ELEVATION], along * cos_h - across * sin_h, along * sin_h + across * cos_h])

    @ti.func
    def pressure(
        self, build: ti.template(), around: ti.template(), tables: ti.template(), aux: ti.template(), e, i, tau,
        pos, R, L, J, plane,
    ):  # fmt: skip
        """Load (N, N m, about CO, b) of the water's pressure; writes the wave's part of it to aux."""
        self.pressure_heads(
            around.sea, around.phase, build.components, build.finite, around.env_sea[e], e, i, tau, pos, R, L, J, plane,
            tables.lines, aux,
        )  # fmt: skip
        return self.panel_load(tables, aux, e, i, pos[2], R, plane)

    @ti.func
    def panel_load(self, tables: ti.template(), aux: ti.template(), e, i, z, R, plane):
        """Load (N, N m, about CO, b) of the pressure on the panels, whose wave's part is in aux."""
        k = ti.Vector([R[2, 0], R[2, 1], R[2, 2]])
        g = R.transpose() @ ti.Vector([plane[1], plane[2], 0.0])
        count = ti.static(len(self.geometry.panels))
        return pressure.panel_load(tables.panels, tables.node, aux, self.nodes, count, e, i, z, k, g)

    @ti.func
    def pressure_heads(
        self, sea: ti.template(), phase: ti.template(), count: ti.template(), finite: ti.template(), s, e, i, tau,
        pos, R, L, J, plane, lines: ti.template(), aux: ti.template()
    ):  # fmt: skip
        """Write the wave's pressure head (m), and its change to starboard, at every point of the wave lines to aux."""
        for pair in range(lines.shape[0]):
            h = R @ ti.Vector([lines[pair, 6], lines[pair, 7], lines[pair, 8]])
            step = ti.Vector([J[0] * h[0] + J[1] * h[1], J[1] * h[0] + J[2] * h[1]])
            across = ti.Vector([J[0] * R[0, 1] + J[1] * R[1, 1], J[1] * R[0, 1] + J[2] * R[1, 1]])
            a = self.line_start(R @ ti.Vector([lines[pair, 0], lines[pair, 1], lines[pair, 2]]), h, pos, L, J, plane)
            b = self.line_start(R @ ti.Vector([lines[pair, 3], lines[pair, 4], lines[pair, 5]]), h, pos, L, J, plane)
            head_a, head_b, slope_a, slope_b = w.along_pair(
                sea, phase, count, self.points, finite, s, e, a, b, step, across, tau
            )
            first = ti.static(self.head) + pair * ti.static(2 * self.points)
            for c in ti.static(range(self.points)):
                aux[e, i, first + c], aux[e, i, first + ti.static(self.points) + c] = head_a[c], head_b[c]
                aux[e, i, first + ti.static(self.nodes) + c] = slope_a[c]
                aux[e, i, first + ti.static(self.nodes + self.points) + c] = slope_b[c]

    @ti.func
    def line_start(self, r, h, pos, L, J, plane):
        """Label of a line's first point, at r from CO (m, n), its depth below the mean plane, and the change of depth
        with each step h (m, n). An end in the air counts as on the surface."""
        last = ti.static(max(self.points - 1, 1))
        d = pos[2] + r[2] + plane[0] + plane[1] * r[0] + plane[2] * r[1]
        end = d + last * (h[2] + plane[1] * h[0] + plane[2] * h[1])
        d, end = ti.max(d, 0.0), ti.max(end, 0.0)
        X, Y = L[0] + J[0] * r[0] + J[1] * r[1], L[1] + J[1] * r[0] + J[2] * r[1]
        return ti.Vector([X, Y, d, (end - d) * ti.static(1.0 / last)])

    @ti.func
    def flow(self, R, omega, V_c, water):
        """nu_c, nu_c_dot, nu_o and nu_o_dot in b; V_c (m/s, n) is the current."""
        v_c, v_c_dot = R.transpose() @ V_c, V_c * 0.0
        if ti.static(self.params.current_frame == "heading"):
            cos_h, sin_h = heading(R)
            v_c = ti.Vector([cos_h * V_c[0] + sin_h * V_c[1], cos_h * V_c[1] - sin_h * V_c[0], 0.0])
            v_c_dot = ti.Vector([omega[2] * v_c[1], -omega[2] * v_c[0], 0.0])
        else:
            v_c_dot = -cross(omega, v_c)
        zero = v_c * 0.0
        cos_h, sin_h = heading(R)
        v_o = R.transpose() @ ti.Vector([water[w.V_N], water[w.V_E], water[w.V_D]])
        a_o = R.transpose() @ ti.Vector([water[w.A_N], water[w.A_E], water[w.A_D]])
        p, q = water[w.P], water[w.Q]
        w_o = R.transpose() @ ti.Vector([p * cos_h - q * sin_h, p * sin_h + q * cos_h, 0.0])
        p, q = water[w.P_DOT], water[w.Q_DOT]
        alpha_o = R.transpose() @ ti.Vector([p * cos_h - q * sin_h, p * sin_h + q * cos_h, 0.0])
        nu_o, nu_o_dot = six(v_o, w_o), six(a_o - cross(omega, v_o), alpha_o - cross(omega, w_o))
        return six(v_c, zero), six(v_c_dot, zero), nu_o, nu_o_dot

    @ti.func
    def freeboard(self, deck: ti.template(), R, z, plane):
        """Height (m) of the lowest corner of the deck above the surface plane."""
        lowest = z * 0.0 + 1e3
        for c in range(deck.shape[0]):
            r = R @ ti.Vector([deck[c, 0], deck[c, 1], deck[c, 2]])
            lowest = ti.min(lowest, -(z + r[2]) - plane[0] - plane[1] * r[0] - plane[2] * r[1])
        return lowest
