"""`manoeuvring_3dof`: a USV in surge, sway and yaw, eqs (1)-(4) of the seed paper, on waves and in a current.

    eta_dot = R(psi) nu,   M nu_dot = -C(nu) nu - D(nu) nu - g + tau,

with eta = [x, y, psi] in n and nu = [u, v, r] in b. M, C, D and the wave disturbance g are in manoeuvring_loads.py.

Current: the water moves with V_c, constant in n. In b, nu_c = R^T V_c turns: nu_c_dot = -S(r) nu_c. Rigid-body terms
act on nu, hydrodynamic ones on nu_r = nu - nu_c and its derivative. Because M_rb nu_c_dot + C_rb(nu) nu - C_rb(nu_r)
nu_r = 0, this is the same equation in nu_r (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control,
sec. 10.3). The model integrates that equation, with eta_dot = R nu_r + V_c.

Heave, roll and pitch follow the plane through the elevations under the four corners of the waterplane. X, Y and N of an
external load act as on a hull that floats upright; Z, K and M have no effect.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

from collections.abc import Mapping

import numpy as np
import taichi as ti
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import fast
from taichi_sim.kernels.abreast import taken, taken2
from taichi_sim.kernels.packs import AroundPack, FleetPack, load_at, own_numbers
from taichi_sim.kernels.runtime import array2
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.manoeuvring_loads import (
    VARYING,
    Manoeuvring3dofParams,
    ManoeuvringNumbers,
    acceleration,
    numbers_of,
    wave_load,
)
from taichi_sim.usv.plane import elevations, in_plane, planar, water_plane, write_rates, write_state
from taichi_sim.usv.vessel import Number, Vessel, steady_speed
from taichi_sim.vehicle import Limits

ACTION_NAMES = {"acceleration_yaw": ("acceleration", "yaw"), "surge_sway_yaw": ("surge", "sway", "yaw")}
AUX = (
    "displacement_north", "displacement_east", "displacement_change_north", "displacement_change_east",  # m
    "wave_X", "wave_Y", "wave_N", "X", "Y", "N",  # N, N m
)  # fmt: skip
LABEL, WAVE, CONTROLS = (AUX.index(name) for name in ("displacement_north", "wave_X", "X"))  # first column of each


@ti.data_oriented
class Manoeuvring3dof(Vessel):
    """Steps a team of vessels in place: RK4 in (x, y, psi, u_r, v_r, r), with waves and thrust constant over a substep.

    Actions are in [-1, 1]. Acceleration maps to X in [0, surge_force_max], yaw to N = yaw_moment_max yaw. With actions
    = "surge_sway_yaw" all three are symmetric. Controls are the forces X, Y (N) and the moment N (N m).

    The auxiliary state (`aux_names`) holds three parts. The first is the displacement of the surface particle at the
    hull's centre and its change in the last substep (found as in unity_boat.py). The second is the wave load of the
    surface at the end of the last substep, zero before the first. The third is the controls. The vessel follows the
    surface, so it cannot capsize or be swamped. The current at the surface acts on it; the wind does not.
    """

    Params = Manoeuvring3dofParams
    control_names = ("X", "Y", "N")
    aux_names = AUX
    aux_size = len(AUX)
    varying = VARYING

    def __init__(self, params: Manoeuvring3dofParams, dt: float, substeps: int):
        """Take `params`, the step dt (s) and the number of substeps in a control step.

        Raises:
            ConfigError: if dt is too large for a stable RK4.
        """
        super().__init__(params, dt, substeps)
        if not dt <= params.largest_dt:
            raise ConfigError(f"dt = {dt} s is unstable for this vehicle: allowed are up to {params.largest_dt:.4g} s")
        self.p = params
        self.action_names = ACTION_NAMES[params.actions]
        self.backs = params.actions == "surge_sway_yaw"

    @property
    def limits(self) -> Limits:
        """Limits of the vessel; the top speed is that at which damping equals the whole thrust."""
        p = self.params
        return Limits((0.0, 0.0, steady_speed(p.surge_force_max, -p.X_u, -p.X_uu, -p.X_uuu)))

    def steer(self, ahead: ArrayLike, helm: ArrayLike) -> NDArray[np.float64]:
        """Return the actions of a helmsman: `ahead` and `helm` are shares of surge_force_max and yaw_moment_max."""
        ahead, helm = np.broadcast_arrays(np.asarray(ahead, dtype=np.float64), helm)
        if self.backs:
            return np.stack((ahead, np.zeros_like(ahead), helm), axis=-1)
        return np.stack((2.0 * ahead - 1.0, helm), axis=-1)

    def own(self, values: Mapping[str, Number]) -> ManoeuvringNumbers:
        """Numbers that the kernel uses."""
        return numbers_of(values, self.p.length, self.dt)

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance by one control step."""
        fleet.launch(self._step, fleet.pack, around.pack, self.build(fleet, around))

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13] of the planar motion (position, heading, u, v, r); all other rates are zero.

        Heave, roll and pitch of `state`, and the wind, have no effect.
        """
        out = torch.zeros_like(state)
        self._rhs(out, state, controls, current, load)
        return out

    @ti.kernel
    def _rhs(self, out: array2, state: array2, controls: array2, current: array2, load: array2):
        for n in range(state.shape[0]):
            y, V_c = taken2(state, n, 13), taken2(current, n, 2)
            tau = ti.Vector([controls[n, 0] + load[n, 0], controls[n, 1] + load[n, 1], controls[n, 2] + load[n, 5]])
            s, _ = planar(y, V_c)
            rate = self.derivatives(self.constants, s, tau, V_c)
            write_rates(out, n, y, s, rate, V_c)

    @ti.kernel
    def _step(self, fleet: FleetPack, around: AroundPack, build: ti.template()):
        ti.loop_config(serialize=build.serial)
        for e, i in ti.ndrange(fleet.state.shape[0], fleet.state.shape[1]):
            y, memory = taken(fleet.state, e, i, 0, 13), taken(fleet.aux, e, i, 0, ti.static(len(AUX)))
            actions = taken(fleet.action, e, i, 0, ti.static(len(self.action_names)))
            V_c = taken2(around.current, e, 2)
            tau = load_at(build, fleet.load, e, i)
            s, plane = planar(y, V_c)
            before = plane
            s, plane, before, memory = self.advance(
                own_numbers(self, build, fleet.numbers, e, i), build, around, e, s, plane, memory, actions, tau, V_c
            )
            write_state(fleet, e, i, s, plane, before, memory, V_c, self.dt)

    @ti.func
    def advance(
        self, p: ti.template(), build: ti.template(), around: ti.template(), e, s, plane, memory, actions, tau, V_c
    ):
        """s, water plane now and one substep earlier, and auxiliary state, after one control step."""
        before = plane
        D = ti.Vector([memory[LABEL], memory[LABEL + 1]])
        change = ti.Vector([memory[LABEL + 2], memory[LABEL + 3]])
        wave = ti.Vector([memory[WAVE + k] for k in ti.static(range(3))])
        controls = ti.Vector([memory[CONTROLS + k] for k in ti.static(range(3))])
        command = self.commanded(p, actions)
        outside = in_plane(tau)
        for n in range(self.substeps):
            excess = controls - command
            s = self.runge_kutta(p, s, command + p.lag_mean * excess + wave + outside, V_c)
            controls = command + p.lag_end * excess
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
            memory[LABEL + k], memory[LABEL + 2 + k] = D[k], change[k]
        for k in ti.static(range(3)):
            memory[WAVE + k], memory[CONTROLS + k] = wave[k], controls[k]
        return s, plane, before, memory

    @ti.func
    def commanded(self, p: ti.template(), actions):
        """Forces X, Y (N) and moment N (N m) that the actions command."""
        X, Y, N = actions[0], actions[0] * 0.0, actions[1]
        if ti.static(self.p.actions == "surge_sway_yaw"):
            Y, N = actions[1], actions[2]
        else:
            X = 0.5 * (X + 1.0)
        return ti.Vector([p.X_max * X, p.Y_max * Y, p.N_max * N])

    @ti.func
    def derivatives(self, p: ti.template(), s, tau, V_c):
        """Rates of s = [x, y, psi, u_r, v_r, r] under tau = [X, Y, N], in water that moves by V_c."""
        sine, cosine = fast.sincos(s[2])
        a = acceleration(p, s[3], s[4], s[5], tau)
        x_dot, y_dot = cosine * s[3] - sine * s[4] + V_c[0], sine * s[3] + cosine * s[4] + V_c[1]
        return ti.Vector([x_dot, y_dot, s[5], a[0], a[1], a[2]])

    @ti.func
    def runge_kutta(self, p: ti.template(), s, tau, V_c):
        """s after one step of the classical fourth-order method."""
        h = ti.static(self.dt)
        k1 = self.derivatives(p, s, tau, V_c)
        k2 = self.derivatives(p, s + (0.5 * h) * k1, tau, V_c)
        k3 = self.derivatives(p, s + (0.5 * h) * k2, tau, V_c)
        k4 = self.derivatives(p, s + h * k3, tau, V_c)
        return s + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
