"""`hull_6dof`: a USV in six degrees of freedom by Fossen's vectorial model, on the water's instantaneous surface.

    M nu_dot = M nu_c_dot + M_a nu_o_dot + tau - C_rb (nu - nu_c) - C_a(nu_r) nu_r - D(nu_r) nu_r,   M = M_rb + M_a,

nu_r = nu - nu_c - nu_o, with the current nu_c (constant in n) and the orbital motion nu_o of the waves averaged over
the hull (waves.py): added mass and damping act on the motion relative to the water, which stands for radiation and
diffraction (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control, ch. 6, 8 and 10; Faltinsen 1990,
Sea Loads on Ships and Offshore Structures, ch. 3). tau is thrust, wind, and what holds the hull up:

- `restoring = "panels"`: weight, and pressure on panels of the hull under the instantaneous surface, hydrostatic and
  Froude-Krylov (hydrostatics.py). A step drifts by half, evaluates waves and pressure once, changes the velocity by
  the midpoint rule, whose middle velocity the last step's nu_dot foretells, and drifts by half again (Strang 1968:
  second order, and symmetric in time but for damping: still water makes no energy).
  With `hydrodynamics.radiation = "memory"` what the hull's own waves do is a boundary-element code's: radiation.py.
- `restoring = "linear"`: -G eta of the source, relative to the hull's mean surface plane, and the component of the
  weight down its slope. Steps are classical Runge-Kutta of fourth order: for comparison with published codes.

Thrusters (thrusters.py) have a first-order lag, exact for a held command, and turn at a limited rate.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false, reportOptionalCall=false

from typing import Any

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.conventions import ELEVATION, FREEBOARD
from taichi_sim.kinematics import store
from taichi_sim.maths.rotation import quaternion_advance, rotation_matrix
from taichi_sim.packs import AroundPack, FleetPack, load_at, numbers_at
from taichi_sim.rigid_body import angular, linear
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.hull import thruster_set
from taichi_sim.usv.hull.model import DRAG, LABEL, LABEL_CHANGE, NU_DOT, PRESSURE, WIND, TablesPack
from taichi_sim.usv.hull.motion import pack
from taichi_sim.usv.hull.params import Hull6DofParams
from taichi_sim.usv.hull.start import HullStart
from taichi_sim.usv.hull.waves import CENTRE_SIZE

__all__ = ["Hull6Dof", "Hull6DofParams"]


@ti.func
def six_of(table: ti.template(), e, i, first: ti.template()):
    """Six numbers in a row of a table."""
    return ti.Vector([table[e, i, first + c] for c in range(6)])


@ti.data_oriented
class Hull6Dof(HullStart):
    """Steps a team of hulls in place; see the module. Actions [env, vehicle, action] in [-1, 1] are, by `actions`,

    - "surge_yaw" (acceleration, yaw), of two propellers: surge force from 0 to full thrust, as in the paper; yaw moment
      to either side by differential thrust, which changes the surge force where a propeller is at its limit;
    - "left_right", of two propellers: shaft speed of each, from n_min to n_max;
    - "wrench" (surge, sway, yaw): force and moment as shares of the largest of each alone, shared out to the thrusters
      (allocation.py); more than they can make is less of the same direction;
    - "units": speed of each thruster, from n_min to n_max, then the angle of each that turns, from one end of its range
      to the other.

    Controls are the speeds of the thrusters, rad/s, then the angles of those that turn, rad.

    model.py holds what a hull is, numbers.py what its kernels work with; water.py, thruster_set.py and motion.py the
    functions that the kernels here inline; start.py how a hull begins.
    """

    def step(self, fleet: Any, around: Surroundings) -> None:
        """Advance one control step."""
        fleet.launch(self._step, fleet.pack, around.pack, self.tables(around), self.build(fleet, around))

    @ti.kernel
    def _step(self, fleet: FleetPack, around: AroundPack, tables: TablesPack, build: ti.template()):
        ti.loop_config(serialize=build.serial)
        for e, i in ti.ndrange(fleet.state.shape[0], fleet.state.shape[1]):
            if ti.static(build.varied):
                own = numbers_at(self.Own, fleet.numbers, e, i)
                self.advance(own, build, fleet, around, tables, e, i)
            else:
                self.advance(self.constants, build, fleet, around, tables, e, i)

    @ti.func
    def advance(
        self, p: ti.template(), build: ti.template(), fleet: ti.template(), around: ti.template(),
        tables: ti.template(), e, i,
    ):  # fmt: skip
        """Vehicle i of environment e one control step later; `p` is what it works with."""
        state, aux = ti.static(fleet.state, fleet.aux)
        pos = ti.Vector([state[e, i, 0], state[e, i, 1], state[e, i, 2]])
        q = ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]])
        nu, nu_dot, R = six_of(state, e, i, 7), six_of(aux, e, i, NU_DOT), rotation_matrix(q)
        controls = thruster_set.controls_at(self.thrusters, aux, e, i)
        D = ti.Vector([aux[e, i, LABEL], aux[e, i, LABEL + 1]])
        change = ti.Vector([aux[e, i, LABEL_CHANGE], aux[e, i, LABEL_CHANGE + 1]])
        command = thruster_set.commanded(self.thrusters, fleet.action, e, i, controls)
        V_c = ti.Vector([around.current[e, 0], around.current[e, 1], 0.0])
        air = ti.Vector([around.wind[e, 0], around.wind[e, 1], around.wind[e, 2]])
        outside = load_at(build, fleet.load, e, i)
        plane = ti.Vector([pos[0] * 0.0, 0.0, 0.0])  # elevation, slopes north and east of the surface under the hull
        water = ti.Vector([pos[0] * 0.0 for _ in range(CENTRE_SIZE)])
        up, wind = nu * 0.0, nu * 0.0
        thrown, thrown_rate, thrown_bend = nu * 0.0, nu * 0.0, nu * 0.0  # load of diffraction and its rates of change
        for n in range(self.substeps):
            tau = (n + 0.5) * ti.static(self.dt)
            if ti.static(self.by_panels):  # two halves of a turn, of this step and the last one, make one
                pos, q, R = self.drift(pos, q, nu, ti.select(n == 0, ti.static(0.5 * self.dt), ti.static(self.dt)))
            water, L, J = self.water_at(build, around, e, tau, pos, R, D + change)
            D_next = L - ti.Vector([pos[0], pos[1]])
            fresh = D.norm_sqr() + change.norm_sqr() == 0.0  # no last step to tell a change from
            change = ti.select(fresh, change, D_next - D)
            D = D_next
            plane = self.plane_n(water, R)
            wind = self.wind_load(p, R, nu, air)
            if ti.static(self.by_panels):
                up = self.pressure(build, around, tables, aux, e, i, tau, pos, R, L, J, plane)
                up += self.weight_load(p, ti.Vector([R[2, 0], R[2, 1], R[2, 2]]))
                at = thruster_set.lagged(self.thrusters, p, controls, command, 0.5)
                thrust = thruster_set.load(self.thrusters, p, at)
                if ti.static(self.remembers):
                    if n % ti.static(self.stretch) == 0:
                        ahead = ti.static(0.5 * (self.stretch - 1) * self.dt)
                        drift = (R @ linear(nu))[:2] + change * ti.static(1 / self.dt)
                        thrown, thrown_rate, thrown_bend = self.thrown_back(
                            build, around, tables, e, tau, ahead, L, drift, R
                        )
                    since = (n % ti.static(self.stretch) - ti.static(0.5 * (self.stretch - 1))) * ti.static(self.dt)
                    thrust += thrown + since * (thrown_rate + 0.5 * since * thrown_bend)
                    thrust += self.radiated(tables, aux, e, i, R, nu, nu_dot, V_c)
                pos, nu, nu_dot = self.kick(p, pos, nu, nu_dot, R, up + thrust + wind + outside, V_c, water)
            else:
                pos, q, nu = self.runge_kutta(p, pack(pos, q, nu), controls, command, wind + outside, V_c, water)
                R = rotation_matrix(q)
            controls = thruster_set.lagged(self.thrusters, p, controls, command, 1.0)
        if ti.static(self.by_panels):
            q = quaternion_advance(q, angular(nu), ti.static(0.5 * self.dt))
            R = rotation_matrix(q)
        store(fleet.derived, e, i, R, R @ linear(nu))
        y = pack(pos, q, nu)
        for c in ti.static(range(13)):
            state[e, i, c] = y[c]
        for c in ti.static(range(2)):
            aux[e, i, LABEL + c], aux[e, i, LABEL_CHANGE + c] = D[c], change[c]
        for c in ti.static(range(6)):
            aux[e, i, NU_DOT + c] = nu_dot[c]
        thruster_set.note(self.thrusters, p, aux, e, i, controls)
        self.note(aux, e, i, linear(up), linear(wind), self.drag_force(p, nu, R, V_c, water))
        fleet.surface[e, i, ELEVATION] = plane[0]
        fleet.surface[e, i, FREEBOARD] = self.freeboard(tables.deck, R, pos[2], plane)

    @ti.func
    def note(self, aux: ti.template(), e, i, up, wind, drag):
        """Write the forces (N, b) at the end of the step to aux: pressure and weight, drag, wind."""
        for c in ti.static(range(3)):
            aux[e, i, PRESSURE + c], aux[e, i, DRAG + c], aux[e, i, WIND + c] = up[c], drag[c], wind[c]

    # -- loads and accelerations without a step ----------------------------------------------------------------------

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13]; the wind is that at `wind_height`."""
        out = torch.empty_like(state)
        no_waves = state.new_zeros((len(state), 1, self.aux_size))
        self._rhs(out, state, controls, current, wind, load, no_waves, self.tables())
        return out

    @ti.kernel
    def _rhs(
        self,
        out: ti.types.ndarray(ndim=2),
        state: ti.types.ndarray(ndim=2),
        controls: ti.types.ndarray(ndim=2),
        current: ti.types.ndarray(ndim=2),
        wind: ti.types.ndarray(ndim=2),
        load: ti.types.ndarray(ndim=2),
        no_waves: ti.types.ndarray(ndim=3),
        tables: TablesPack,
    ):
        for n in range(state.shape[0]):
            y = ti.Vector([state[n, c] for c in range(13)])
            nu, R = ti.Vector([y[7 + c] for c in range(6)]), rotation_matrix(ti.Vector([y[3], y[4], y[5], y[6]]))
            V_c, air = ti.Vector([current[n, 0], current[n, 1], 0.0]), ti.Vector([wind[n, c] for c in range(3)])
            calm = ti.Vector([y[0] * 0.0 for _ in range(CENTRE_SIZE)])
            tau = ti.Vector([load[n, c] for c in range(6)]) + self.wind_load(self.constants, R, nu, air)
            at = ti.Vector([controls[n, c] for c in ti.static(range(len(self.control_names)))])
            tau += thruster_set.load(self.thrusters, self.constants, at)
            if ti.static(self.by_panels):
                tau += self.panel_load(tables, no_waves, n, 0, y[2], R, linear(calm))
                tau += self.weight_load(self.constants, ti.Vector([R[2, 0], R[2, 1], R[2, 2]]))
            else:
                tau += self.linear_restoring(self.constants, y[2], R, calm)
            dy = self.derivative(self.constants, y, R, tau, V_c, calm)
            for c in ti.static(range(13)):
                out[n, c] = dy[c]

    def pressure_load(self, state: Tensor, around: Surroundings) -> Tensor:
        """Hydrostatic and Froude-Krylov load [env, vehicle, 6] (N, N m, about CO, b) of hulls held at `state`.

        `state` [env, vehicle, 13]; waves are those of `around` at the beginning of a step.
        """
        state = state.contiguous()
        out = state.new_empty((*state.shape[:2], 6))
        aux = state.new_zeros((*state.shape[:2], self.aux_size))
        self._pressure_load(out, state, aux, around.pack, self.tables(), self.water_build(around))
        return out

    @ti.kernel
    def _pressure_load(
        self,
        out: ti.types.ndarray(ndim=3),
        state: ti.types.ndarray(ndim=3),
        aux: ti.types.ndarray(ndim=3),
        around: AroundPack,
        tables: TablesPack,
        build: ti.template(),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            pos = ti.Vector([state[e, i, 0], state[e, i, 1], state[e, i, 2]])
            R = rotation_matrix(ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]]))
            now = pos[0] * 0.0
            water, L, J = self.water_at(build, around, e, now, pos, R, self.label(build, around, e, pos, R))
            load = self.pressure(build, around, tables, aux, e, i, now, pos, R, L, J, self.plane_n(water, R))
            for c in ti.static(range(6)):
                out[e, i, c] = load[c]
