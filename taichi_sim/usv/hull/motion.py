"""The motion of a hull, as methods that kernels inline: equations of motion, integrators and wind.

`p` is what the kernel works with (numbers.py): numbers compiled in, or those of one vehicle.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.maths.rotation import quaternion_advance, rotation_matrix
from taichi_sim.rigid_body import angular, coriolis, is_nothing, linear, quaternion_rate, six, times
from taichi_sim.usv.hull import pressure, thruster_set
from taichi_sim.usv.hull import waves as w
from taichi_sim.usv.hull.diffraction import diffracted
from taichi_sim.usv.hull.memory import radiate
from taichi_sim.usv.hull.numbers import diagonal, symmetric, vector
from taichi_sim.usv.hull.water import HullWater


@ti.func
def pack(pos, q, nu):
    """The 13 numbers of conventions.py."""
    return ti.Vector([pos[0], pos[1], pos[2], q[0], q[1], q[2], q[3], nu[0], nu[1], nu[2], nu[3], nu[4], nu[5]])


class HullMotion(HullWater):
    """How loads move the hull."""

    @ti.func
    def drag(self, p: ti.template(), nu_r):
        """Load of damping and cross-flow on the motion relative to the water."""
        load = pressure.diagonal_damping(ti.static(vector(p, "linear", 6)), ti.static(vector(p, "quadratic", 6)), nu_r)
        if ti.static(self.params.hydrodynamics.cross_flow_length > 0):
            YN = pressure.cross_flow(self.params.hydrodynamics, nu_r[1], nu_r[5])
            load[1] += YN[0]
            load[5] += YN[1]
        return load

    @ti.func
    def drag_force(self, p: ti.template(), nu, R, V_c, water):
        """Force (N, b) of damping and cross-flow."""
        nu_c, _, nu_o, _ = self.flow(R, angular(nu), V_c, water)
        return linear(self.drag(p, nu - nu_c - nu_o))

    @ti.func
    def nu_dot(self, p: ti.template(), nu, R, tau, V_c, water):
        """nu_dot under the load tau (N, N m) of all that does not depend on the velocity relative to the water."""
        M_rb, M_a, M_inverse = ti.static(symmetric(p, "M_rb"), diagonal(p, "added"), symmetric(p, "inverse"))
        nu_c, nu_c_dot, nu_o, nu_o_dot = self.flow(R, angular(nu), V_c, water)
        nu_r = nu - nu_c - nu_o
        load = tau + self.drag(p, nu_r)
        if ti.static(not self.remembers):  # else diffraction has come with tau
            load += times(M_a, nu_o_dot)
        load -= coriolis(M_rb, nu - nu_c) + coriolis(M_a, nu_r)
        return nu_c_dot + times(M_inverse, load)

    @ti.func
    def drift(self, pos, q, nu, turn):
        """Position, attitude and R_nb in the middle of a step: after turning for `turn` s and half a step's way."""
        q = quaternion_advance(q, angular(nu), turn)
        R = rotation_matrix(q)
        return pos + ti.static(0.5 * self.dt) * (R @ linear(nu)), q, R

    @ti.func
    def radiated(self, tables: ti.template(), aux: ti.template(), e, i, R, nu, nu_dot, V_c):
        """Load of the waves that the hull has made, in the middle of a step (as `kick` has it)."""
        load = nu * 0.0
        if ti.static(self.remembers):
            still = R.transpose() @ V_c
            middle = nu + ti.static(0.5 * self.dt) * nu_dot - six(still, still * 0.0)
            load = radiate(self.filters, tables.filters, aux, e, i, ti.static(self.head + 2 * self.nodes), middle)
        return load

    @ti.func
    def thrown_back(
        self, build: ti.template(), around: ti.template(), tables: ti.template(), e, tau, ahead, L, velocity, R
    ):  # fmt: skip
        """Load of diffraction and its rates of change `ahead` s after tau, where the label is L and has `velocity`."""
        label, psi = L + ahead * velocity, ti.atan2(R[1, 0], R[0, 0])
        return diffracted(
            around.sea, around.phase, build.components, tables.thrown,
            ti.static(self.params.hydrodynamics.drift), self.courses, around.env_sea[e], e, label, velocity,
            tau + ahead, psi,
        )  # fmt: skip

    @ti.func
    def kick(self, p: ti.template(), pos, nu, nu_dot, R, tau, V_c, water):
        """Position at the end of a step, nu there, and nu_dot, under the load tau in the middle of the step, whose
        velocity, for damping and Coriolis, the last step's nu_dot foretells.
        """
        nu_dot = self.nu_dot(p, nu + ti.static(0.5 * self.dt) * nu_dot, R, tau, V_c, water)
        nu = nu + ti.static(self.dt) * nu_dot
        return pos + ti.static(0.5 * self.dt) * (R @ linear(nu)), nu, nu_dot

    @ti.func
    def derivative(self, p: ti.template(), y, R, tau, V_c, water):
        """dy/dt at attitude R = R_nb under the load tau of all that does not depend on the velocity in the water."""
        q = ti.Vector([y[3], y[4], y[5], y[6]])
        nu = ti.Vector([y[7 + c] for c in range(6)])
        return pack(R @ linear(nu), quaternion_rate(q, angular(nu)), self.nu_dot(p, nu, R, tau, V_c, water))

    @ti.func
    def runge_kutta(self, p: ti.template(), y, controls, command, load, V_c, water):
        """Position, attitude and nu of the linear hull one step after y, the water and `load` held, which acts besides
        restoring and thrust.
        """
        total, slope = y * 0.0, y * 0.0
        for stage in range(4):
            ahead = 0.5 * ((stage + 1) // 2)  # 0, 1/2, 1/2, 1 of the step
            at = thruster_set.lagged(self.thrusters, p, controls, command, ahead)
            y_s = y + (ahead * ti.static(self.dt)) * slope
            R = rotation_matrix(ti.Vector([y_s[3], y_s[4], y_s[5], y_s[6]]))
            tau = load + self.linear_restoring(p, y_s[2], R, water) + thruster_set.load(self.thrusters, p, at)
            slope = self.derivative(p, y_s, R, tau, V_c, water)
            total += ti.select(stage % 3 == 0, 1.0, 2.0) * slope
        y = y + ti.static(self.dt / 6) * total
        q = ti.Vector([y[3], y[4], y[5], y[6]])
        return ti.Vector([y[0], y[1], y[2]]), q / q.norm(), ti.Vector([y[7 + c] for c in range(6)])

    @ti.func
    def weight_load(self, p: ti.template(), k):
        """Load of the hull's weight; k is the unit vector downwards in b."""
        return pressure.weight_load(p.weight, ti.static(vector(p, "cg", 3)), k)

    @ti.func
    def linear_restoring(self, p: ti.template(), z, R, water):
        """-G eta relative to the surface plane, the payload's weight, and the hull's own down the slope."""
        load = ti.Vector([z * 0.0 for _ in range(6)])
        if ti.static(self.has_linear):
            along, across = water[w.ALONG], water[w.ACROSS]
            heave = z + water[w.ELEVATION]
            roll = ti.atan2(R[2, 1], R[2, 2]) + across
            pitch = ti.asin(ti.max(ti.min(-R[2, 0], 1.0), -1.0)) - along
            Z = -self.source.G33 * heave - self.source.G35 * pitch
            M = -self.source.G55 * pitch - self.source.G35 * heave
            K = -self.source.G44 * roll
            load = ti.Vector([-p.weight * along, -p.weight * across, Z, K, M, 0.0])
            k = ti.Vector([R[2, 0], R[2, 1], R[2, 2]])
            load += pressure.weight_load(self.payload, self.source.payload_position, k)
        return load

    @ti.func
    def wind_load(self, p: ti.template(), R, nu, air):
        """Load of the wind `air` (m/s, n)."""
        load = nu * 0.0
        if ti.static(not (is_nothing(p.wind_x) and is_nothing(p.wind_y))):
            load = pressure.windage(p, self.params.windage.height, R.transpose() @ air - linear(nu))
        return load
