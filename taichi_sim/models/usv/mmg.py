"""`mmg_3dof`: a ship with propeller and rudder in surge, sway and yaw, by the MMG standard method.

H. Yasukawa, Y. Yoshimura (2015), Introduction of MMG standard method for ship maneuvering predictions, J. Mar. Sci.
Technol. 20, 37-52. About midships, with x and X ahead, y and Y to starboard, r and N bow to starboard (eq. 4):

    (m + m_x) u' - (m + m_y) v r - x_G m r^2 = X,
    (m + m_y) v' + (m + m_x) u r + x_G m r'  = Y,
    (I_zG + x_G^2 m + J_z) r' + x_G m (v' + u r) = N.

X, Y and N are the loads of hull, propeller and rudder, of wind and waves, and external loads. With U the speed through
the water, beta = atan(-v / u) the drift angle, v' = v / U, r' = r L / U, q = 0.5 rho L d U^2, they are

    X_H = q (-R_0 + X_vv v'^2 + X_vr v' r' + X_rr r'^2 + X_vvvv v'^4)                                     (eq. 7)
    Y_H = q (Y_v v' + Y_r r' + Y_vvv v'^3 + Y_vvr v'^2 r' + Y_vrr v' r'^2 + Y_rrr r'^3),   N_H likewise times L
    X_P = (1 - t_P) T,   T = rho n^2 D^4 K_T(J)                                                       (eqs. 9-11)
    F_N = 0.5 rho A_R U_R^2 f_alpha sin(alpha_R),   U_R^2 = u_R^2 + v_R^2,   alpha_R = delta - atan(v_R / u_R)
    u_R = epsilon u_P sqrt(eta (1 + kappa (sqrt(1 + 8 K_T / (pi J^2)) - 1))^2 + 1 - eta),   u_P = (1 - w_P) u
    v_R = U gamma_R beta_R,   beta_R = beta - l_R' r',   eta = D / H_R
    X_R = -(1 - t_R) F_N sin(delta),   Y_R = -(1 + a_H) F_N cos(delta),   N_R = -(x_R + a_H x_H) F_N cos(delta)

The method is made for motion ahead. The extensions beyond it are assumed:

- Astern, the resistance and the terms N_v and Y_r change sign with u (the first is drag; the others are of the order u
  v and u r). They change smoothly over drift angles from 78 to 102 degrees.
- |v'| in v'^4 of X_vvvv is limited to V_LIMIT. r'^3 grows as r' |r'| above |r'| = R_LIMIT. Captive tests do not go
  further, and r' has no bound as a ship stops.
- The propeller has no division by n or u: T = rho D^2 (k_0 n^2 D^2 + k_1 n D u_P + k_2 u_P |u_P|). Astern,
  T = rho D^2 (-astern k_0 n^2 D^2 + k_2 u_P |u_P|), without a side force.
- The rudder's inflow has no such division either, and comes from astern where u_R < 0.

The water moves with the current V_c, and the equations hold for the velocity relative to it (see manoeuvring_3dof.py).
Heave, roll and pitch follow the surface under the hull (planar_shared.py).

Propeller and rudder follow their commands with a lag T and a rate limit:

    x' = (command - x) / T, limited to `rate` in either direction.

With T = 0 they move at that rate until they reach the command.
"""

# Kernels are another language inside Python syntax.
# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false, reportInvalidTypeForm=false

import math
from collections import namedtuple
from collections.abc import Mapping

import numpy as np
import taichi as ti
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.fleet import Fleet
from taichi_sim.kernels import fast_maths
from taichi_sim.kernels.abreast import taken, taken2
from taichi_sim.kernels.conventions import AHEAD, EAST, NORTH
from taichi_sim.kernels.packs import AroundPack, FleetPack, load_at, own_numbers
from taichi_sim.kernels.rigid_body import Number
from taichi_sim.kernels.runtime import array2
from taichi_sim.models.usv.mmg_params import HullDerivatives, HullPolynomial, MmgParams, Propeller, Rudder
from taichi_sim.models.usv.planar_shared import (
    AT_ONCE,
    elevations,
    first_plane,
    in_plane,
    planar,
    water_plane,
    wave_load,
    write_rates,
    write_state,
)  # fmt: skip
from taichi_sim.models.usv.vessel_base import RHO_AIR, Vessel, wind_forces
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Limits

V_LIMIT = 0.40  # limit of |v'| in X_vvvv, beyond which it would push kvlcc2 ahead; assumed
R_LIMIT = 2.0  # limit of |r'| in Y_rrr, N_rrr; assumed
CROSSING = 0.2  # |u| / U below which terms change sign with u; assumed
SLOWEST = 1e-9  # m/s; avoids a division by zero at rest

DERIVATIVES = tuple(HullPolynomial.model_fields)
OF_PARTS = (
    *(f"propeller.{name}" for name in (
        "t_P", "w_P0", "C_1", "C_2_positive", "C_2_negative", "k_0", "k_1", "k_2", "n_ahead", "n_astern",
        "time_constant", "rate")),
    *(f"rudder.{name}" for name in (
        "area", "t_R", "a_H", "x_H", "gamma_R_positive", "gamma_R_negative", "l_R", "epsilon", "kappa",
        "time_constant", "rate_deg")),
)  # fmt: skip
"""Keys of propellers and rudders that may vary."""
VARYING = (
    "displacement", "x_G", "gyration", *(f"hull.{name}" for name in HullDerivatives.model_fields), *OF_PARTS,
    "windage.frontal_area", "windage.lateral_area",
)  # fmt: skip


MmgNumbers = namedtuple("MmgNumbers", (
    "dt",  # physics step, s
    "m11", "m22",  # kg, added mass included
    "m23", "m32",  # x_G m, kg m
    "m33",  # kg m^2
    "mass",  # kg
    "inverse_m11", "inverse_det",  # det = m22 m33 - m23^2
    "block_yaw",  # as in manoeuvring_3dof.py, kg m^2
    "length",  # m
    *DERIVATIVES,  # for SI velocities: they include 0.5 rho L d, and a factor L for each r and for N
    "T_nn", "T_nu", "T_uu",  # thrust of all propellers per n^2, n u_P and u_P^2: N s^2, N s^2/m, N s^2/m^2
    "T_astern",  # thrust per n^2 astern, N s^2
    "race",  # 8 / (pi rho count D^2), speed^2 in the race over the thrust of all propellers, m^2/s^2/N
    "push", "wake",  # 1 - t_P, 1 - w_P0
    "C_1", "C_2_positive", "C_2_negative",  # the latter less 1
    "x_P",  # x_P', in units of L
    "n_ahead", "n_astern",  # 1/s
    "normal",  # 0.5 rho A_R f_alpha of all rudders, N s^2/m^2
    "X_delta", "Y_delta",  # 1 - t_R, 1 + a_H
    "N_delta",  # x_R + a_H x_H, m
    "gamma_positive", "gamma_negative",
    "l_R",  # m
    "epsilon", "kappa", "eta",
    "angle_max",  # rad
    "lag_n", "lag_half_n",  # share of the deviation from a command that the lag closes in a step, in half a step
    "lag_delta", "lag_half_delta",
    "n_step", "delta_step",  # largest change in a step, 1/s and rad
    "wind_x", "wind_y", "wind_n",  # as in vessel.wind_forces
))  # fmt: skip
"""Numbers of one ship that the kernel uses: floats, or tensors of one shape."""


def polynomial_numbers(values: Mapping[str, Number], length: float, draft: float, density: float) -> dict[str, Number]:
    """Derivatives for SI velocities, from `values` of "hull.NAME": those of MmgNumbers with the same names."""
    area = 0.5 * density * length * draft
    return {
        name: area * length ** (name.count("r") + (name[0] == "N")) * values[f"hull.{name}"] for name in DERIVATIVES
    }


def part_numbers(
    values: Mapping[str, Number], propeller: Propeller, rudder: Rudder, propellers: int, rudders: int, length: float,
    density: float, dt: float,
) -> dict[str, Number]:  # fmt: skip
    """Compute MmgNumbers of `propellers` propellers and `rudders` rudders together, from `values` of `OF_PARTS`."""
    D = propeller.diameter
    thrust = density * propellers * D**2
    lags = {}
    for name, key in (("n", "propeller"), ("delta", "rudder")):
        x = dt / (values[f"{key}.time_constant"] + AT_ONCE)
        lags |= {f"lag_{name}": 1 - math.e**-x, f"lag_half_{name}": 1 - math.e ** (-0.5 * x)}
    a_H = values["rudder.a_H"]
    return dict(
        length=length,
        T_nn=thrust * D**2 * values["propeller.k_0"],
        T_nu=thrust * D * values["propeller.k_1"],
        T_uu=thrust * values["propeller.k_2"],
        T_astern=thrust * D**2 * values["propeller.k_0"] * propeller.astern,
        race=8 / (math.pi * thrust),
        push=1 - values["propeller.t_P"],
        wake=1 - values["propeller.w_P0"],
        C_1=values["propeller.C_1"],
        C_2_positive=values["propeller.C_2_positive"] - 1,
        C_2_negative=values["propeller.C_2_negative"] - 1,
        x_P=propeller.x,
        n_ahead=values["propeller.n_ahead"],
        n_astern=values["propeller.n_astern"],
        normal=0.5 * density * rudders * rudder.lift_gradient * values["rudder.area"],
        X_delta=1 - values["rudder.t_R"],
        Y_delta=1 + a_H,
        N_delta=length * (rudder.x + a_H * values["rudder.x_H"]),
        gamma_positive=values["rudder.gamma_R_positive"],
        gamma_negative=values["rudder.gamma_R_negative"],
        l_R=length * values["rudder.l_R"],
        epsilon=values["rudder.epsilon"],
        kappa=values["rudder.kappa"],
        eta=D / rudder.span,
        angle_max=math.radians(rudder.angle_max_deg),
        n_step=dt * values["propeller.rate"],
        delta_step=dt * math.pi / 180 * values["rudder.rate_deg"],
        **lags,
    )


def numbers_of(values: Mapping[str, Number], params: MmgParams, dt: float) -> MmgNumbers:
    """Compute the kernel's numbers for a step dt (s): `values` for all keys that vary, all others from `params`."""
    L, d, rho, windage = params.length, params.draft, params.density, params.windage
    propeller, rudder, area = params.propeller, params.rudder, 0.5 * rho * L * d
    mass = rho * values["displacement"]
    m11, m22 = mass + area * L * values["hull.m_x"], mass + area * L * values["hull.m_y"]
    m23 = mass * values["x_G"]
    m33 = mass * (values["gyration"] ** 2 + values["x_G"] ** 2) + area * L**3 * values["hull.J_z"]
    return MmgNumbers(
        *(dt, m11, m22, m23, m23, m33),
        mass=mass,
        inverse_m11=1 / m11,
        inverse_det=1 / (m22 * m33 - m23 * m23),
        block_yaw=mass * L**2 / 12 + area * L**3 * values["hull.J_z"],
        wind_x=0.5 * RHO_AIR * windage.c_x * values["windage.frontal_area"],
        wind_y=0.5 * RHO_AIR * windage.c_y * values["windage.lateral_area"],
        wind_n=RHO_AIR * windage.c_n * L * values["windage.lateral_area"],
        **polynomial_numbers(values, L, d, rho),
        **part_numbers(values, propeller, rudder, propeller.count, rudder.count, L, rho, dt),
    )


@ti.func
def followed(p: ti.template(), now, command, close_n, close_delta, share):
    """Controls [n, delta] after `share` of a step. A lag alone closes the shares `close_n` and `close_delta` of the
    deviation from the command; the rates limit both.
    """
    most = ti.Vector([share * p.n_step, share * p.delta_step])
    way = ti.Vector([(command[0] - now[0]) * close_n, (command[1] - now[1]) * close_delta])
    return now + ti.max(ti.min(way, most), -most)


@ti.func
def acceleration(p: ti.template(), u, v, r, tau):
    """nu_dot (m/s^2, rad/s^2) of eq. (4) at velocity [u v r] through the water, under tau = [X Y N]."""
    X = tau[0] + p.m22 * v * r + p.m23 * r * r
    Y = tau[1] - p.m11 * u * r
    N = tau[2] - p.m23 * u * r
    return ti.Vector(
        [X * p.inverse_m11, (p.m33 * Y - p.m23 * N) * p.inverse_det, (p.m22 * N - p.m23 * Y) * p.inverse_det]
    )


@ti.func
def loads(p: ti.template(), u, v, r, n, delta):
    """[X Y N] (N, N m) of hull, propellers at n (1/s) and rudders at delta (rad), at velocity [u v r] through the
    water.
    """
    T = thrust(p, u, v, r, n)
    return hull_load(p, u, v, r) + rudder_load(p, u, v, r, T, delta) + ti.Vector([p.push * T, 0.0, 0.0])


@ti.func
def hull_load(p: ti.template(), u, v, r):
    """[X Y N] of the hull (eq. 7). The derivatives have their dimensions, so that only velocities over U remain."""
    U = ti.sqrt(u * u + v * v) + SLOWEST
    a = v / U
    way = ti.max(ti.min(u / (CROSSING * U), 1.0), -1.0)
    a4 = ti.min(a * a, V_LIMIT * V_LIMIT)
    r3 = r * r * ti.max(ti.min(r / U, R_LIMIT / p.length), -R_LIMIT / p.length)  # r^3 / U
    X = (-p.R_0 * way + p.X_vvvv * a4 * a4) * U * U + p.X_vv * v * v + p.X_vr * v * r + p.X_rr * r * r
    Y = p.Y_v * U * v + p.Y_r * way * U * r + (p.Y_vvv * v * v + p.Y_vrr * r * r) * a + p.Y_vvr * a * v * r
    N = p.N_v * way * U * v + p.N_r * U * r + (p.N_vvv * v * v + p.N_vrr * r * r) * a + p.N_vvr * a * v * r
    return ti.Vector([X, Y + p.Y_rrr * r3, N + p.N_rrr * r3])


@ti.func
def drift(u, v):
    """Drift angle (rad), the same for motion astern and ahead."""
    return ti.atan2(-v, ti.abs(u) + SLOWEST)


@ti.func
def inflow(p: ti.template(), u, v, r):
    """Speed u_P (m/s) of the water at the propeller."""
    U = ti.sqrt(u * u + v * v) + SLOWEST
    beta = drift(u, v) - p.x_P * p.length * r / U
    change = (1.0 - ti.exp(-p.C_1 * ti.abs(beta))) * ti.select(beta > 0, p.C_2_positive, p.C_2_negative)
    return p.wake * (1.0 + change) * u


@ti.func
def thrust(p: ti.template(), u, v, r, n):
    """Thrust T (N) of all propellers at n (1/s)."""
    u_P = inflow(p, u, v, r)
    T = p.T_nn * n * n + p.T_nu * n * u_P
    if n < 0:
        T = -p.T_astern * n * n
    return T + p.T_uu * u_P * ti.abs(u_P)


@ti.func
def rudder_load(p: ti.template(), u, v, r, T, delta):
    """[X Y N] of the rudders at delta (rad) behind propellers of thrust T (N)."""
    U, u_P = ti.sqrt(u * u + v * v), inflow(p, u, v, r)
    race = u_P + p.kappa * (ti.sqrt(ti.max(u_P * u_P + p.race * T, 0.0)) - ti.abs(u_P))
    square = p.eta * race * ti.abs(race) + (1.0 - p.eta) * u_P * ti.abs(u_P)
    u_R = p.epsilon * ti.sqrt(ti.abs(square)) * ti.select(square < 0, -1.0, 1.0)
    across = U * drift(u, v) - p.l_R * r  # U beta_R
    v_R = across * ti.select(across > 0, p.gamma_positive, p.gamma_negative)
    sine, cosine = ti.sin(delta), ti.cos(delta)
    F_N = p.normal * ti.sqrt(u_R * u_R + v_R * v_R) * (u_R * sine - v_R * cosine)  # U_R^2 sin(delta - atan(v_R / u_R))
    return ti.Vector([-p.X_delta * F_N * sine, -p.Y_delta * F_N * cosine, -p.N_delta * F_N * cosine])


AUX = (
    "displacement_north", "displacement_east", "displacement_change_north", "displacement_change_east",  # m
    "wave_X", "wave_Y", "wave_N",  # N, N m
    "propeller", "rudder", "thrust",  # 1/s, rad, N
    "twist", "elevation_change", "slope_ahead_change", "slope_right_change", "twist_change",  # 1/m, m, 1, 1, 1/m
)  # fmt: skip
LABEL, TWIST, WAVE, CONTROLS, THRUST = map(AUX.index, ("displacement_north", "twist", "wave_X", "propeller", "thrust"))


@ti.data_oriented
class Mmg3Dof(Vessel):
    """Steps a team of ships in place: RK4 in (x, y, psi, u_r, v_r, r), with waves constant over a substep.

    Actions are in [-1, 1]. `propeller` maps to revolutions from -n_astern to n_ahead; 0 is stopped. `rudder` maps to
    angles from -angle_max to angle_max; positive turns to starboard. Controls are the actual revolutions (1/s) and
    rudder angle (rad).

    The auxiliary state (`aux_names`) holds the displacement of the surface particle at the hull's centre and its change
    in the last substep (found as in unity_boat.py), the wave load in the middle of the next one, extrapolated, the
    controls, the thrust of all propellers, the twist of the water plane, and the change of the plane in the last
    substep. The ship follows the surface, so it cannot capsize or be swamped. The current at the surface and the wind
    on its areas act on it.
    """

    Params = MmgParams
    action_names = ("propeller", "rudder")
    control_names = ("propeller", "rudder")
    aux_names = AUX
    aux_size = len(AUX)
    varying = VARYING
    free_step = True

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
        """Compute the kernel's numbers from `values`."""
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
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for e, i in ti.ndrange(fleet.state.shape[0], fleet.state.shape[1]):
            y, memory = taken(fleet.state, e, i, 0, 13), taken(fleet.aux, e, i, 0, ti.static(len(AUX)))
            V_c, V_w = taken2(around.current, e, 2), taken2(around.wind, e, 2)
            asked, tau = taken(fleet.action, e, i, 0, 2), load_at(build, fleet.load, e, i)
            s, plane = planar(y, V_c)
            start = ti.Vector([y[NORTH], y[EAST]])
            self.advance(
                own_numbers(self, build, fleet.numbers, e, i), build, fleet, around, e, i, start, s, plane, memory,
                asked, tau, V_c, V_w,
            )  # fmt: skip

    @ti.func
    def advance(
        self, p: ti.template(), build: ti.template(), fleet: ti.template(), around: ti.template(), e, i, start, s,
        plane, memory, action, tau, V_c, V_w,
    ):  # fmt: skip
        """Advance vehicle i of environment e by one control step, and store it."""
        D = ti.Vector([memory[LABEL], memory[LABEL + 1]])
        change = ti.Vector([memory[LABEL + 2], memory[LABEL + 3]])
        wave = ti.Vector([memory[WAVE + k] for k in ti.static(range(3))])
        plane[3] = memory[TWIST]
        risen = ti.Vector([memory[TWIST + 1 + k] for k in ti.static(range(4))])  # change of the plane in a substep
        rate = plane * 0.0
        if D.norm_sqr() + change.norm_sqr() == 0.0:  # without a last step
            D, plane = first_plane(around, build, e, start, s, self.p.length, self.p.beam)
            if ti.static(self.p.wave_response):
                wave = wave_load(p, plane)
        controls = ti.Vector([memory[CONTROLS], memory[CONTROLS + 1]])
        command = ti.Vector([action[0] * ti.select(action[0] > 0, p.n_ahead, p.n_astern), action[1] * p.angle_max])
        outside = in_plane(tau)
        for n in range(self.substeps):
            middle = followed(p, controls, command, p.lag_half_n, p.lag_half_delta, 0.5)
            end = followed(p, controls, command, p.lag_n, p.lag_delta, 1.0)
            s = self.runge_kutta(p, s, controls, middle, end, wave + outside, V_c, V_w)
            controls = end
            D_next, heights = elevations(
                around, build, e, (n + 1) * p.dt, start, s, D + change, self.p.length, self.p.beam
            )
            change = D_next - D
            D = D_next
            before, risen_before = plane, risen
            plane = water_plane(ti.static(self.p.length), ti.static(self.p.beam), heights)
            risen = plane - before
            rate = (1.5 * risen - 0.5 * risen_before) / p.dt  # of the parabola through the last three planes
            if ti.static(self.p.wave_response):
                wave = wave_load(p, plane + 0.5 * risen)  # in the middle of the next substep
        for k in ti.static(range(2)):
            memory[LABEL + k], memory[LABEL + 2 + k], memory[CONTROLS + k] = D[k], change[k], controls[k]
        for k in ti.static(range(3)):
            memory[WAVE + k] = wave[k]
        memory[THRUST] = thrust(p, s[3], s[4], s[5], controls[0])
        memory[TWIST] = plane[3]
        for k in ti.static(range(4)):
            memory[TWIST + 1 + k] = risen[k]
        write_state(fleet, e, i, start, s, plane, rate, memory, V_c)

    @ti.func
    def derivatives(self, p: ti.template(), s, controls, outside, V_c, V_w):
        """Rates of s = [x, y, psi, u_r, v_r, r] at the given controls, under the external load [X Y N]."""
        sine, cosine = fast_maths.sincos(s[2])
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
        h = p.dt
        k1 = self.derivatives(p, s, begin, outside, V_c, V_w)
        k2 = self.derivatives(p, s + (0.5 * h) * k1, middle, outside, V_c, V_w)
        k3 = self.derivatives(p, s + (0.5 * h) * k2, middle, outside, V_c, V_w)
        k4 = self.derivatives(p, s + h * k3, end, outside, V_c, V_w)
        return s + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
