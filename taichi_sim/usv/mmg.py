"""`mmg_3dof`: a ship with propeller and rudder in surge, sway and yaw, by the MMG standard method.

H. Yasukawa, Y. Yoshimura (2015), Introduction of MMG standard method for ship maneuvering predictions, J. Mar. Sci.
Technol. 20, 37-52. About midships, with x and X ahead, y and Y to starboard, r and N bow to starboard (eq. 4):

    (m + m_x) u' - (m + m_y) v r - x_G m r^2 = X,
    (m + m_y) v' + (m + m_x) u r + x_G m r'  = Y,
    (I_zG + x_G^2 m + J_z) r' + x_G m (v' + u r) = N.

X, Y and N are the loads of hull, propeller and rudder (mmg_loads.py), of wind and waves, and external loads.

The water moves with the current V_c, and the equations hold for the velocity relative to it (see manoeuvring_3dof.py).
Heave, roll and pitch follow the surface under the hull (plane.py).

Propeller and rudder follow their commands with a lag T and a rate limit:

    x' = (command - x) / T, limited to `rate` in either direction.

With T = 0 they move at that rate until they reach the command.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import math
from collections.abc import Mapping

import numpy as np
import taichi as ti
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.conventions import AHEAD
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import fast
from taichi_sim.kernels.abreast import taken, taken2
from taichi_sim.kernels.packs import AroundPack, FleetPack, load_at, own_numbers
from taichi_sim.kernels.runtime import array2
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.mmg_loads import VARYING, MmgNumbers, acceleration, followed, loads, numbers_of, thrust
from taichi_sim.usv.mmg_params import MmgParams
from taichi_sim.usv.plane import elevations, in_plane, planar, water_plane, wave_load, write_rates, write_state
from taichi_sim.usv.vessel import Number, Vessel, wind_forces
from taichi_sim.vehicle import Limits

AUX = (
    "displacement_north", "displacement_east", "displacement_change_north", "displacement_change_east",  # m
    "wave_X", "wave_Y", "wave_N",  # N, N m
    "propeller", "rudder", "thrust",  # 1/s, rad, N
)  # fmt: skip
LABEL, WAVE, CONTROLS, THRUST = (AUX.index(name) for name in ("displacement_north", "wave_X", "propeller", "thrust"))


@ti.data_oriented
class Mmg3Dof(Vessel):
    """Steps a team of ships in place: RK4 in (x, y, psi, u_r, v_r, r), with waves constant over a substep.

    Actions are in [-1, 1]. `propeller` maps to revolutions from -n_astern to n_ahead; 0 is stopped. `rudder` maps to
    angles from -angle_max to angle_max; positive turns to starboard. Controls are the actual revolutions (1/s) and
    rudder angle (rad).

    The auxiliary state (`aux_names`) holds the displacement of the surface particle at the hull's centre and its change
    in the last substep (found as in unity_boat.py), the wave load of the surface at the end of the last substep, the
    controls, and the thrust of all propellers. The ship follows the surface, so it cannot capsize or be swamped. The
    current at the surface and the wind on its areas act on it.
    """

    Params = MmgParams
    action_names = ("propeller", "rudder")
    control_names = ("propeller", "rudder")
    aux_names = AUX
    aux_size = len(AUX)
    varying = VARYING

    def __init__(self, params: MmgParams, dt: float, substeps: int):
        """Take `params`, the step dt (s) and the number of substeps in a control step."""
        super().__init__(params, dt, substeps)
        self.p = params
        self.helm_max, self.backs = math.radians(params.rudder.angle_max_deg), params.propeller.n_astern > 0
        self.signals = {
            "revolutions": ("1/s", ("propeller",)),
            "rudder": ("rad", ("rudder",)),
            "thrust": ("N", ("thrust",)),
        }

    @property
    def limits(self) -> Limits:
        """Limits of the ship; the top speed is that at full revolutions ahead."""
        return Limits((0.0, 0.0, self.params.steady_speed(self.params.propeller.n_ahead)))

    @property
    def draft(self) -> float:
        """Depth of the keel, m."""
        return self.params.draft

    @property
    def wind_height(self) -> float:
        """Height above the sea of the wind that acts on the ship, m."""
        return self.params.windage.height

    @property
    def forces(self) -> Mapping[str, tuple[tuple[float, float, float], tuple[str | None, str | None, str | None]]]:
        """Load arrow of the thrust, at the propeller."""
        return {"thrust": ((self.params.propeller.x * self.params.length, 0.0, 0.0), ("thrust", None, None))}

    def power(self, fleet: Fleet) -> Tensor:
        """Thrust times the speed ahead [env, vehicle], W."""
        return fleet.aux[..., THRUST] * fleet.velocity_b[..., AHEAD]

    def steer(self, ahead: ArrayLike, helm: ArrayLike) -> NDArray[np.float64]:
        """Return the actions of a helmsman: `ahead` is a share of n_ahead or, below 0, of n_astern; `helm` is one
        of angle_max.
        """
        return np.stack(np.broadcast_arrays(np.asarray(ahead, dtype=np.float64), helm), axis=-1)

    def own(self, values: Mapping[str, Number]) -> MmgNumbers:
        """Numbers that the kernel uses."""
        return numbers_of(values, self.params, self.dt)

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance by one control step."""
        fleet.launch(self._step, fleet.pack, around.pack, self.build(fleet, around))

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13] of the planar motion (position, heading, u, v, r); all other rates are zero.

        Heave, roll and pitch of `state` have no effect.
        """
        out = torch.zeros_like(state)
        self._rhs(out, state, controls, current, wind, load)
        return out

    @ti.kernel
    def _rhs(self, out: array2, state: array2, controls: array2, current: array2, wind: array2, load: array2):
        for n in range(state.shape[0]):
            y = taken2(state, n, 13)
            V_c, V_w = taken2(current, n, 2), taken2(wind, n, 2)
            outside = in_plane(taken2(load, n, 6))
            s, _ = planar(y, V_c)
            rate = self.derivatives(self.constants, s, taken2(controls, n, 2), outside, V_c, V_w)
            write_rates(out, n, y, s, rate, V_c)

    @ti.kernel
    def _step(self, fleet: FleetPack, around: AroundPack, build: ti.template()):
        ti.loop_config(serialize=build.serial)
        for e, i in ti.ndrange(fleet.state.shape[0], fleet.state.shape[1]):
            y, memory = taken(fleet.state, e, i, 0, 13), taken(fleet.aux, e, i, 0, ti.static(len(AUX)))
            V_c, V_w = taken2(around.current, e, 2), taken2(around.wind, e, 2)
            asked, tau = taken(fleet.action, e, i, 0, 2), load_at(build, fleet.load, e, i)
            s, plane = planar(y, V_c)
            before = plane
            s, plane, before, memory = self.advance(
                own_numbers(self, build, fleet.numbers, e, i), build, around, e, s, plane, memory, asked, tau, V_c, V_w
            )
            write_state(fleet, e, i, s, plane, before, memory, V_c, self.dt)

    @ti.func
    def advance(
        self, p: ti.template(), build: ti.template(), around: ti.template(), e, s, plane, memory, action, tau, V_c, V_w
    ):
        """s, water plane now and one substep earlier, and auxiliary state, after one control step."""
        before = plane
        D = ti.Vector([memory[LABEL], memory[LABEL + 1]])
        change = ti.Vector([memory[LABEL + 2], memory[LABEL + 3]])
        wave = ti.Vector([memory[WAVE + k] for k in ti.static(range(3))])
        controls = ti.Vector([memory[CONTROLS], memory[CONTROLS + 1]])
        command = ti.Vector([action[0] * ti.select(action[0] > 0, p.n_ahead, p.n_astern), action[1] * p.angle_max])
        outside = in_plane(tau)
        for n in range(self.substeps):
            middle = followed(p, controls, command, p.lag_half_n, p.lag_half_delta, 0.5)
            end = followed(p, controls, command, p.lag_n, p.lag_delta, 1.0)
            s = self.runge_kutta(p, s, controls, middle, end, wave + outside, V_c, V_w)
            controls = end
            D_next, heights = elevations(
                around, build, e, (n + 1) * ti.static(self.dt), s, D + change, self.p.length, self.p.beam
            )
            change = D_next - D
            D = D_next
            before = plane
            plane = water_plane(ti.static(self.p.length), ti.static(self.p.beam), heights)
            if ti.static(self.p.wave_response):
                wave = wave_load(p, plane)
        for k in ti.static(range(2)):
            memory[LABEL + k], memory[LABEL + 2 + k], memory[CONTROLS + k] = D[k], change[k], controls[k]
        for k in ti.static(range(3)):
            memory[WAVE + k] = wave[k]
        memory[THRUST] = thrust(p, s[3], s[4], s[5], controls[0])
        return s, plane, before, memory

    @ti.func
    def derivatives(self, p: ti.template(), s, controls, outside, V_c, V_w):
        """Rates of s = [x, y, psi, u_r, v_r, r] at the given controls, under the external load [X Y N]."""
        sine, cosine = fast.sincos(s[2])
        tau = loads(p, s[3], s[4], s[5], controls[0], controls[1]) + outside
        met = V_w - V_c  # velocity of the air relative to the water
        u_w, v_w = cosine * met[0] + sine * met[1] - s[3], cosine * met[1] - sine * met[0] - s[4]
        tau += wind_forces(p, u_w, v_w)
        a = acceleration(p, s[3], s[4], s[5], tau)
        x_dot, y_dot = cosine * s[3] - sine * s[4] + V_c[0], sine * s[3] + cosine * s[4] + V_c[1]
        return ti.Vector([x_dot, y_dot, s[5], a[0], a[1], a[2]])

    @ti.func
    def runge_kutta(self, p: ti.template(), s, begin, middle, end, outside, V_c, V_w):
        """s after one step of the classical fourth-order method, with the controls at the time of each stage."""
        h = ti.static(self.dt)
        k1 = self.derivatives(p, s, begin, outside, V_c, V_w)
        k2 = self.derivatives(p, s + (0.5 * h) * k1, middle, outside, V_c, V_w)
        k3 = self.derivatives(p, s + (0.5 * h) * k2, middle, outside, V_c, V_w)
        k4 = self.derivatives(p, s + h * k3, end, outside, V_c, V_w)
        return s + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
