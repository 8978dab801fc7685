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
- `restoring = "linear"`: -G eta of the source, relative to the hull's mean surface plane, and the component of the
  weight down its slope. Steps are classical Runge-Kutta of fourth order: for comparison with published codes.

Propellers have a first-order lag, exact for a held command.
"""

import numpy as np
import taichi as ti
import torch

from taichi_sim import runtime
from taichi_sim.conventions import ELEVATION, FREEBOARD
from taichi_sim.kinematics import store
from taichi_sim.maths.rotation import quaternion_advance, rotation_matrix
from taichi_sim.rigid_body import angular, linear, six
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.hull import loads
from taichi_sim.usv.hull import waves as hull_waves
from taichi_sim.usv.hull.model import DRAG, NU_DOT, PRESSURE, THRUST, WIND
from taichi_sim.usv.hull.motion import pack
from taichi_sim.usv.hull.params import Hull6DofParams
from taichi_sim.usv.hull.start import LABEL_STEPS, HullStart

__all__ = ["Hull6Dof", "Hull6DofParams"]


@ti.func
def six_of(table: ti.template(), e, i, first: ti.template()):
    """Six numbers in a row of a table."""
    return ti.Vector([table[e, i, first + c] for c in range(6)])


@ti.data_oriented
class Hull6Dof(HullStart):
    """Steps a team of hulls in place; see the module.

    model.py holds its numbers, water.py, motion.py and start.py the functions that the kernels here inline.
    """

    def step(self, team, action: torch.Tensor, around: Surroundings) -> None:
        """Advance one control step. `action` [env, vehicle, 2] in [-1, 1]: by `actions`,

        - "surge_yaw" (acceleration, yaw): surge force from 0 to full thrust, as in the paper; yaw moment to either
          side by differential thrust, which changes the surge force where a propeller is at its limit;
        - "left_right": shaft speed of each propeller, from n_min to n_max.
        """
        self._step(
            team.state, team.derived, team.aux, team.surface, action, around.sea, around.env_sea, around.phase,
            around.current, around.wind, *self.tables(team.state.device, team.state.dtype),
            around.sea.shape[2], around.depth > 0,
        )  # fmt: skip

    def reset_aux(self, aux: torch.Tensor, state: torch.Tensor) -> None:
        """Auxiliary state [.., n] of vehicles put at `state` [.., 13]: propellers at rest."""
        aux.zero_()

    @ti.kernel
    def _step(
        self,
        state: ti.types.ndarray(ndim=3),
        derived: ti.types.ndarray(ndim=3),
        aux: ti.types.ndarray(ndim=3),
        surface: ti.types.ndarray(ndim=3),
        action: ti.types.ndarray(ndim=3),
        sea: ti.types.ndarray(ndim=3),
        env_sea: ti.types.ndarray(dtype=ti.i32, ndim=1),
        phase: ti.types.ndarray(ndim=2),
        current: ti.types.ndarray(ndim=2),
        wind: ti.types.ndarray(ndim=2),
        panels: ti.types.ndarray(ndim=1),
        node: ti.types.ndarray(dtype=ti.i32, ndim=1),
        lines: ti.types.ndarray(ndim=2),
        deck: ti.types.ndarray(ndim=2),
        count: ti.template(),
        finite: ti.template(),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            pos = ti.Vector([state[e, i, 0], state[e, i, 1], state[e, i, 2]])
            q = ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]])
            nu, nu_dot = six_of(state, e, i, 7), six_of(aux, e, i, NU_DOT)
            R = rotation_matrix(q)
            shaft = ti.Vector([aux[e, i, 0], aux[e, i, 1]])
            D, change = ti.Vector([aux[e, i, 2], aux[e, i, 3]]), ti.Vector([aux[e, i, 4], aux[e, i, 5]])
            command = self.command(action[e, i, 0], action[e, i, 1])
            V_c = ti.Vector([current[e, 0], current[e, 1], 0.0])
            air = ti.Vector([wind[e, 0], wind[e, 1], wind[e, 2]])
            plane = ti.Vector(
                [pos[0] * 0.0, 0.0, 0.0]
            )  # elevation, slopes north and east of the surface under the hull
            water = ti.Vector([pos[0] * 0.0 for _ in range(hull_waves.CENTRE_SIZE)])
            up, wind_load = six(linear(water), linear(water)), six(linear(water), linear(water))
            for n in range(self.substeps):
                tau = (n + 0.5) * ti.static(self.dt)
                if ti.static(self.by_panels):  # two halves of a turn, of this step and the last one, make one
                    pos, q, R = self.drift(pos, q, nu, ti.select(n == 0, ti.static(0.5 * self.dt), ti.static(self.dt)))
                water, L, J = self.water(sea, phase, count, finite, env_sea[e], e, tau, pos, R, D + change)
                D_next = L - ti.Vector([pos[0], pos[1]])
                fresh = D.norm_sqr() + change.norm_sqr() == 0.0  # no last step to tell a change from
                change = ti.select(fresh, change, D_next - D)
                D = D_next
                plane = self.plane_n(water, R)
                wind_load = self.wind_load(R, nu, air)
                if ti.static(self.by_panels):
                    self.pressure_heads(
                        sea, phase, count, finite, env_sea[e], e, i, tau, pos, R, L, J, plane, lines, aux
                    )
                    k = ti.Vector([R[2, 0], R[2, 1], R[2, 2]])
                    g = R.transpose() @ ti.Vector([plane[1], plane[2], 0.0])
                    up = loads.panel_load(
                        panels, node, aux, self.nodes, ti.static(len(self.geometry.panels)), e, i, pos[2], k, g
                    )
                    up += loads.weight_load(self.weight, self.p.rigid_body.cg, k)
                    load = up + self.thrust_load(self.lagged(shaft, command, ti.static(self.keep[0]))) + wind_load
                    pos, nu, nu_dot = self.kick(pos, nu, nu_dot, R, load, V_c, water)
                else:
                    pos, q, nu = self.runge_kutta(pack(pos, q, nu), shaft, command, wind_load, V_c, water)
                    R = rotation_matrix(q)
                shaft = self.lagged(shaft, command, ti.static(self.keep[1]))
            if ti.static(self.by_panels):
                q = quaternion_advance(q, angular(nu), ti.static(0.5 * self.dt))
                R = rotation_matrix(q)
            store(derived, e, i, R, R @ linear(nu))
            y = pack(pos, q, nu)
            for c in ti.static(range(13)):
                state[e, i, c] = y[c]
            for c in ti.static(range(2)):
                aux[e, i, c], aux[e, i, 2 + c], aux[e, i, 4 + c] = shaft[c], D[c], change[c]
            for c in ti.static(range(6)):
                aux[e, i, NU_DOT + c] = nu_dot[c]
            self.note(aux, e, i, linear(up), linear(wind_load), shaft, self.drag_force(nu, R, V_c, water))
            surface[e, i, ELEVATION] = plane[0]
            surface[e, i, FREEBOARD] = self.freeboard(deck, R, pos[2], plane)

    @ti.kernel
    def _acceleration(
        self,
        out: ti.types.ndarray(ndim=2),
        state: ti.types.ndarray(ndim=2),
        shaft: ti.types.ndarray(ndim=2),
        current: ti.types.ndarray(ndim=2),
    ):
        for row in range(state.shape[0]):
            y = ti.Vector([state[row, c] for c in range(13)])
            V_c = ti.Vector([current[row, 0], current[row, 1], 0.0])
            n = ti.Vector([shaft[row, 0], shaft[row, 1]])
            still = ti.Vector([y[0] * 0.0 for _ in range(hull_waves.CENTRE_SIZE)])
            dy = self.derivative(y, n, six(linear(still), linear(still)), V_c, still)
            for c in ti.static(range(6)):
                out[row, c] = dy[7 + c]

    def acceleration(self, state, shaft, current=(0.0, 0.0)) -> np.ndarray:
        """nu_dot [n, 6] of the linear hull in calm water (`restoring = "linear"`).

        Args:
            state: [n, 13]. shaft: [n, 2] shaft speeds, rad/s. current: [2] or [n, 2] north, east, m/s.
        """
        run = runtime.current()
        state = np.asarray(state, dtype=np.float64)
        flow = np.broadcast_to(np.asarray(current, dtype=np.float64), (len(state), 2)).copy()
        y, n, V_c = (
            torch.as_tensor(np.ascontiguousarray(v), dtype=run.torch_dtype, device=run.device)
            for v in (state, shaft, flow)
        )
        out = y.new_empty((len(state), 6))
        self._acceleration(out, y, n, V_c)
        return out.double().cpu().numpy()

    @ti.kernel
    def _pressure_load(
        self,
        out: ti.types.ndarray(ndim=3),
        state: ti.types.ndarray(ndim=3),
        aux: ti.types.ndarray(ndim=3),
        sea: ti.types.ndarray(ndim=3),
        env_sea: ti.types.ndarray(dtype=ti.i32, ndim=1),
        phase: ti.types.ndarray(ndim=2),
        panels: ti.types.ndarray(ndim=1),
        node: ti.types.ndarray(dtype=ti.i32, ndim=1),
        lines: ti.types.ndarray(ndim=2),
        count: ti.template(),
        finite: ti.template(),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            pos = ti.Vector([state[e, i, 0], state[e, i, 1], state[e, i, 2]])
            R = rotation_matrix(ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]]))
            s, zero = env_sea[e], pos[0] * 0.0
            D = ti.Vector([zero, zero])
            for _ in range(LABEL_STEPS):
                _water, L, _J = self.water(sea, phase, count, finite, s, e, zero, pos, R, D)
                D = L - ti.Vector([pos[0], pos[1]])
            water, L, J = self.water(sea, phase, count, finite, s, e, zero, pos, R, D)
            plane = self.plane_n(water, R)
            self.pressure_heads(sea, phase, count, finite, s, e, i, zero, pos, R, L, J, plane, lines, aux)
            k = ti.Vector([R[2, 0], R[2, 1], R[2, 2]])
            g = R.transpose() @ ti.Vector([plane[1], plane[2], 0.0])
            load = loads.panel_load(
                panels, node, aux, self.nodes, ti.static(len(self.geometry.panels)), e, i, pos[2], k, g
            )
            for c in ti.static(range(6)):
                out[e, i, c] = load[c]

    def pressure_load(self, state: torch.Tensor, around: Surroundings) -> torch.Tensor:
        """Hydrostatic and Froude-Krylov load [env, vehicle, 6] (N, N m, about CO, b) of hulls held at `state`.

        `state` [env, vehicle, 13]; waves are those of `around` at the beginning of a step.
        """
        state = state.contiguous()
        out = state.new_empty((*state.shape[:2], 6))
        aux = state.new_zeros((*state.shape[:2], self.aux_size))
        panels, node, lines, _ = self.tables(state.device, state.dtype)
        self._pressure_load(
            out, state, aux, around.sea, around.env_sea, around.phase, panels, node, lines, around.sea.shape[2],
            around.depth > 0,
        )  # fmt: skip
        return out

    @ti.func
    def note(self, aux: ti.template(), e, i, up, wind, shaft, drag):
        """Write the forces (N, b) at the end of the step to aux: pressure and weight, drag, thrust, wind."""
        for c in ti.static(range(3)):
            aux[e, i, PRESSURE + c], aux[e, i, DRAG + c], aux[e, i, WIND + c] = up[c], drag[c], wind[c]
        if ti.static(self.propelled):
            aux[e, i, THRUST] = loads.thrust(self.thrusters, shaft[0])
            aux[e, i, THRUST + 1] = loads.thrust(self.thrusters, shaft[1])
