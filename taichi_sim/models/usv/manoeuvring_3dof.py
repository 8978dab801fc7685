"""`manoeuvring_3dof`: a USV in surge, sway and yaw, eqs (1)-(4) of the seed paper, on waves and in a current.

    eta_dot = R(psi) nu,   M nu_dot = -C(nu) nu - D(nu) nu - g + tau,

with eta = [x, y, psi] in n and nu = [u, v, r] in b. The disturbance g is the load of waves (planar_shared.py). M, C and
D are those of eqs (3)-(4), in the notation of Skjetne, Smogeli & Fossen (2004), Modeling, Identification and Control
25(1), 3-27:

    m11 = m - X_udot, m22 = m - Y_vdot, m23 = m x_g - Y_rdot, m32 = m x_g - N_vdot, m33 = I_z - N_rdot,
    c13 = -m22 v - (m23 + m32) r / 2,  c23 = m11 u,
    d11 = -(X_u + X_uu |u| + X_uuu u^2),
    d22 = -(Y_v + Y_vv |v| + Y_rv |r|),  d23 = -(Y_r + Y_vr |v| + Y_rr |r|),
    d32 = -(N_v + N_vv |v| + N_rv |r|),  d33 = -(N_r + N_vr |v| + N_rr |r| + N_rrr r^2).

Current: the water moves with V_c, constant in n. In b, nu_c = R^T V_c turns: nu_c_dot = -S(r) nu_c. Rigid-body terms
act on nu, hydrodynamic ones on nu_r = nu - nu_c and its derivative. Because M_rb nu_c_dot + C_rb(nu) nu - C_rb(nu_r)
nu_r = 0, this is the same equation in nu_r (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control,
sec. 10.3). The model integrates that equation, with eta_dot = R nu_r + V_c.

Heave, roll and pitch follow the plane through the elevations under the four corners of the waterplane. X, Y and N of an
external load act as on a hull that floats upright; Z, K and M have no effect.
"""

# Kernels are another language inside Python syntax.
# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false, reportInvalidTypeForm=false

import math
from collections import namedtuple
from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

import numpy as np
import taichi as ti
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.config import Finite, NonNegative, NonPositive, Positive
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import fast_maths
from taichi_sim.kernels.abreast import taken, taken2
from taichi_sim.kernels.conventions import EAST, NORTH
from taichi_sim.kernels.packs import AroundPack, FleetPack, load_at, own_numbers
from taichi_sim.kernels.runtime import array2
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
from taichi_sim.models.usv.vessel_base import (
    Beam,
    CollisionRadius,
    Height,
    Lag,
    Length,
    Number,
    TopSpeed,
    Vessel,
    steady_speed,
)  # fmt: skip
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Limits, UnstableStepError, VehicleParams


class Manoeuvring3dofParams(VehicleParams):
    """Parameters of a vehicle file with model = "manoeuvring_3dof"; derivatives that are not given are zero."""

    length: Length
    beam: Beam
    height: Height
    collision_radius: CollisionRadius
    mass: Annotated[Positive, Plausible(5e-4, 0.2, "kg", of="rho_sea length^2 beam")]  # also of the displaced water
    I_z: Annotated[Positive, Plausible(0.01, 0.25, "kg m^2", of="mass length^2")]  # about the body origin
    x_g: Annotated[Finite, Plausible(5e-4, 0.3, "m", of="length", either=True)] = 0.0  # CM ahead of the origin
    X_udot: Annotated[NonPositive, Plausible(-1.5, -5e-3, "kg", of="mass")] = 0.0  # added mass, kg (negative)
    Y_vdot: Annotated[NonPositive, Plausible(-5.0, -0.03, "kg", of="mass")] = 0.0
    Y_rdot: Annotated[Finite, Plausible(1e-4, 0.5, "kg m", of="mass length", either=True)] = 0.0
    N_vdot: Annotated[Finite, Plausible(1e-4, 0.5, "kg m", of="mass length", either=True)] = 0.0
    N_rdot: Annotated[NonPositive, Plausible(-0.5, -1e-3, "kg m^2", of="mass length^2")] = 0.0
    X_u: Annotated[Finite, Plausible(-1.5, -3e-4, "N s/m", of="mass g^0.5 length^-0.5")] = 0.0
    X_uu: Annotated[Finite, Plausible(-0.3, -3e-4, "N s^2/m^2", of="rho_sea length beam")] = 0.0  # of |u| u
    X_uuu: Annotated[Finite, Plausible(-1.0, -1e-3, "N s^3/m^3", of="rho_sea g^-0.5 length^0.5 beam")] = 0.0
    Y_v: Annotated[NonPositive, Plausible(-100.0, -0.05, "N s/m", of="X_u")] = 0.0
    Y_vv: Annotated[Finite, Plausible(-10.0, -0.01, "N s^2/m^2", of="mass beam^-1")] = 0.0  # of |v| v
    Y_rv: Annotated[Finite, Plausible(1e-3, 5.0, "N s^2/m", of="mass beam^-1 length", either=True)] = 0.0  # of |r| v
    Y_r: Annotated[Finite, Plausible(1e-4, 3.0, "N s", of="mass g^0.5 length^0.5", either=True)] = 0.0
    Y_vr: Annotated[Finite, Plausible(1e-3, 5.0, "N s^2/m", of="mass beam^-1 length", either=True)] = 0.0  # of |v| r
    Y_rr: Annotated[Finite, Plausible(1e-3, 3.0, "N s^2", of="mass beam^-1 length^2", either=True)] = 0.0  # of |r| r
    N_v: Annotated[Finite, Plausible(1e-4, 0.3, "N s", of="mass g^0.5 length^0.5", either=True)] = 0.0
    N_vv: Annotated[Finite, Plausible(1e-3, 2.0, "N s^2/m", of="mass beam^-1 length", either=True)] = 0.0  # of |v| v
    N_rv: Annotated[Finite, Plausible(0.01, 10.0, "N s^2", of="N_rr length^-1", either=True)] = 0.0  # of |r| v
    N_r: Annotated[NonPositive, Plausible(-1.0, -5e-4, "N m s", of="mass g^0.5 length^1.5")] = 0.0
    N_vr: Annotated[Finite, Plausible(0.01, 10.0, "N s^2", of="N_rr length^-1", either=True)] = 0.0  # of |v| r
    N_rr: Annotated[Finite, Plausible(-3.0, -1e-3, "N m s^2", of="mass beam^-1 length^3")] = 0.0  # of |r| r
    N_rrr: Annotated[Finite, Plausible(-5.0, -5e-3, "N m s^3", of="I_z g^-0.5 length^0.5")] = 0.0
    actions: Literal["acceleration_yaw", "surge_sway_yaw"] = "acceleration_yaw"
    surge_force_max: Annotated[Positive, Plausible(2e-4, 2.0, "N", of="mass g")]
    # for actions = "surge_sway_yaw"
    sway_force_max: Annotated[NonNegative, Plausible(0.02, 3.0, "N", of="surge_force_max")] = 0.0
    yaw_moment_max: Annotated[Positive, Plausible(0.01, 2.0, "N m", of="surge_force_max length")]
    time_constant: Lag = 0.0  # of the actuators, s; 0: a command acts at once
    wave_response: bool = True  # whether waves push the hull; it rides on them in any case

    def _mistakes(self) -> Iterator[str]:
        for axis, force, damping in (
            ("Y", max(self.sway_force_max, self.surge_force_max), (self.Y_v, self.Y_vv, 0.0)),
            ("N", self.yaw_moment_max, (self.N_r, self.N_rr, self.N_rrr)),
        ):
            grows = any(damping) and math.isinf(steady_speed(force, *(-x for x in damping)))
            if grows:
                names = "Y_v, Y_vv" if axis == "Y" else "N_r, N_rr"
                yield f"{names} = {damping[0]}, {damping[1]} do not damp: damping is negative in these signs"
        if np.linalg.eigvalsh(self.M + self.M.T).min() <= 0:
            yield "mass, I_z, x_g and added mass must make a positive definite inertia matrix"

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, beam, height, m."""
        return self.length, self.beam, self.height

    @property
    def top_speed(self) -> TopSpeed:
        """Speed of a straight run under the whole force, m/s; 0 without damping, which gives none."""
        return self.steady_surge(self.surge_force_max) if self.X_u or self.X_uu or self.X_uuu else 0.0

    @property
    def M(self) -> np.ndarray:  # noqa: N802
        """Inertia matrix [3, 3] of eq. (4): rigid body plus added mass."""
        m11, m22, m23, m32, m33 = _inertia(self.model_dump())
        return np.array([[m11, 0.0, 0.0], [0.0, m22, m23], [0.0, m32, m33]])

    def steady_surge(self, force: float) -> float:
        """Speed (m/s) of a straight run under `force` (N >= 0), from X_uuu u^3 + X_uu u^2 + X_u u + force = 0."""
        return steady_speed(force, -self.X_u, -self.X_uu, -self.X_uuu)

    def eigenvalues(self, u: float) -> np.ndarray:
        """Eigenvalues [3] (1/s) of the model linearised about a straight run at u (m/s)."""
        M = self.M
        d11 = -(self.X_u + 2 * self.X_uu * abs(u) + 3 * self.X_uuu * u * u)
        coriolis = u * np.array([[0, M[0, 0]], [M[1, 1] - M[0, 0], 0.5 * (M[1, 2] + M[2, 1])]])
        lateral = coriolis - np.array([[self.Y_v, self.Y_r], [self.N_v, self.N_r]])
        sway_yaw = np.linalg.eigvals(-np.linalg.solve(M[1:, 1:], lateral))
        return np.concatenate(([-d11 / M[0, 0]], sway_yaw))

    @property
    def largest_dt(self) -> float:
        """Largest step (s) at which RK4 is stable, at rest and in a straight run at full force."""
        top = self.steady_surge(self.surge_force_max)
        speeds = (0.0, top) if np.isfinite(top) else (0.0,)
        return min(_rk4_limit(value) for u in speeds for value in self.eigenvalues(u))


def _inertia(values: Mapping[str, Number]) -> tuple[Number, Number, Number, Number, Number]:
    """m11, m22, m23, m32 and m33."""
    mass, x_g = values["mass"], values["x_g"]
    m23, m32 = mass * x_g - values["Y_rdot"], mass * x_g - values["N_vdot"]
    return mass - values["X_udot"], mass - values["Y_vdot"], m23, m32, values["I_z"] - values["N_rdot"]


def _rk4_limit(eigenvalue: complex) -> float:
    """Smallest dt > 0 with |1 + z + z^2/2 + z^3/6 + z^4/24| = 1 at z = eigenvalue dt; infinite if none decays."""
    if eigenvalue.real >= 0:
        return np.inf
    growth = np.array([eigenvalue**k / math.factorial(k) for k in range(5)])
    square_less_one = np.convolve(growth, growth.conj()).real[1:]  # (|growth|^2 - 1) / dt
    roots = np.roots(square_less_one[::-1])
    return float(roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].min())


DAMPING = tuple(
    name for name in Manoeuvring3dofParams.model_fields if name[:2] in ("X_", "Y_", "N_") and "d" not in name
)
ManoeuvringNumbers = namedtuple("ManoeuvringNumbers", (
    "dt",  # physics step, s
    "m11", "m22",  # kg
    "m23", "m32",  # kg m
    "m33",  # kg m^2
    "c13_r",  # (m23 + m32) / 2, kg m
    "inverse_m11", "inverse_det",  # det = m22 m33 - m23 m32
    "block_yaw",  # yaw inertia of the water that a wall-sided block displaces, plus added inertia, kg m^2
    "X_max", "Y_max", "N_max",  # N, N m
    "lag_end",  # remaining share of an actuator's deviation from its command after a step
    "lag_mean",  # mean of that share over the step
    *DAMPING,  # as in the vehicle file
))  # fmt: skip
"""Numbers of one vessel that the kernel uses: floats, or tensors of one shape."""
ADDED_MASS = ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")
VARYING = (
    "mass", "I_z", "x_g", *ADDED_MASS, *DAMPING, "surge_force_max", "sway_force_max", "yaw_moment_max", "time_constant",
)  # fmt: skip


@ti.func
def acceleration(p: ti.template(), u, v, r, tau):
    """nu_dot (m/s^2, rad/s^2) of eq. (3) at velocity [u v r] relative to the water, under tau = [X Y N]."""
    au, av, ar = ti.abs(u), ti.abs(v), ti.abs(r)
    c13, c23 = -p.m22 * v - p.c13_r * r, p.m11 * u
    d11 = -(p.X_u + p.X_uu * au + p.X_uuu * u * u)
    d22 = -(p.Y_v + p.Y_vv * av + p.Y_rv * ar)
    d23 = -(p.Y_r + p.Y_vr * av + p.Y_rr * ar)
    d32 = -(p.N_v + p.N_vv * av + p.N_rv * ar)
    d33 = -(p.N_r + p.N_vr * av + p.N_rr * ar + p.N_rrr * r * r)
    X = tau[0] - c13 * r - d11 * u
    Y = tau[1] - c23 * r - d22 * v - d23 * r
    N = tau[2] + c13 * u + c23 * v - d32 * v - d33 * r
    return ti.Vector(
        [X * p.inverse_m11, (p.m33 * Y - p.m23 * N) * p.inverse_det, (p.m22 * N - p.m32 * Y) * p.inverse_det]
    )


ACTION_NAMES = {"acceleration_yaw": ("acceleration", "yaw"), "surge_sway_yaw": ("surge", "sway", "yaw")}
AUX = (
    "displacement_north", "displacement_east", "displacement_change_north", "displacement_change_east",  # m
    "wave_X", "wave_Y", "wave_N", "X", "Y", "N",  # N, N m
    "twist", "elevation_change", "slope_ahead_change", "slope_right_change", "twist_change",  # 1/m, m, 1, 1, 1/m
)  # fmt: skip
LABEL, TWIST, WAVE, CONTROLS = map(AUX.index, ("displacement_north", "twist", "wave_X", "X"))  # first column of each


@ti.data_oriented
class Manoeuvring3dof(Vessel):
    """Steps a team of vessels in place: RK4 in (x, y, psi, u_r, v_r, r), with waves and thrust constant over a substep.

    Actions are in [-1, 1]. Acceleration maps to X in [0, surge_force_max], yaw to N = yaw_moment_max yaw. With actions
    = "surge_sway_yaw" all three are symmetric. Controls are the forces X, Y (N) and the moment N (N m).

    The auxiliary state (`aux_names`) holds the displacement of the surface particle at the hull's centre and its change
    in the last substep (found as in unity_boat.py), the wave load in the middle of the next one, extrapolated, the
    controls, the twist of the water plane, and the change of the plane in the last substep. The vessel follows the
    surface, so it cannot capsize or be swamped. The current at the surface acts on it; the wind does not.
    """

    Params = Manoeuvring3dofParams
    control_names = ("X", "Y", "N")
    aux_names = AUX
    aux_size = len(AUX)
    varying = VARYING
    free_step = True

    def __init__(self, params: Manoeuvring3dofParams, dt: float, substeps: int):
        """Take `params`, the step dt (s) and the number of substeps in a control step."""
        super().__init__(params, dt, substeps)
        if not dt <= params.largest_dt:
            raise UnstableStepError(
                f"dt = {dt} s is unstable for this vehicle: allowed are up to {params.largest_dt:.4g} s"
            )
        self.p, self.longest_step = params, params.largest_dt
        self.action_names = ACTION_NAMES[params.actions]
        self.backs = params.actions == "surge_sway_yaw"

    @property
    def limits(self) -> Limits:
        """Limits of the vessel; the top speed is that at which damping equals the whole thrust."""
        return Limits((0.0, 0.0, self.params.steady_surge(self.params.surge_force_max)))

    def steer(self, ahead: ArrayLike, helm: ArrayLike) -> NDArray[np.float64]:
        """Return the actions of a helmsman: `ahead` and `helm` are shares of surge_force_max and yaw_moment_max."""
        ahead, helm = np.broadcast_arrays(np.asarray(ahead, dtype=np.float64), helm)
        if self.backs:
            return np.stack((ahead, np.zeros_like(ahead), helm), axis=-1)
        return np.stack((2.0 * ahead - 1.0, helm), axis=-1)

    def own(self, values: Mapping[str, Number]) -> ManoeuvringNumbers:
        """Compute the kernel's numbers from `values`."""
        m11, m22, m23, m32, m33 = _inertia(values)
        # the deviation from the command decays by exp(-dt / T) in a step; its mean acts on the hull
        x = self.dt / (values["time_constant"] + AT_ONCE)
        lag_end = math.e**-x
        return ManoeuvringNumbers(
            *(self.dt, m11, m22, m23, m32, m33),
            c13_r=0.5 * (m23 + m32),
            inverse_m11=1 / m11,
            inverse_det=1 / (m22 * m33 - m23 * m32),
            block_yaw=values["mass"] * self.p.length**2 / 12 - values["N_rdot"],
            X_max=values["surge_force_max"],
            Y_max=values["sway_force_max"],
            N_max=values["yaw_moment_max"],
            lag_end=lag_end,
            lag_mean=(1 - lag_end) / x,
            **{name: values[name] for name in DAMPING},
        )

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
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for e, i in ti.ndrange(fleet.state.shape[0], fleet.state.shape[1]):
            y, memory = taken(fleet.state, e, i, 0, 13), taken(fleet.aux, e, i, 0, ti.static(len(AUX)))
            actions = taken(fleet.action, e, i, 0, ti.static(len(self.action_names)))
            V_c = taken2(around.current, e, 2)
            tau = load_at(build, fleet.load, e, i)
            s, plane = planar(y, V_c)
            start = ti.Vector([y[NORTH], y[EAST]])
            self.advance(
                own_numbers(self, build, fleet.numbers, e, i), build, fleet, around, e, i, start, s, plane, memory,
                actions, tau, V_c,
            )  # fmt: skip

    @ti.func
    def advance(
        self, p: ti.template(), build: ti.template(), fleet: ti.template(), around: ti.template(), e, i, start, s,
        plane, memory, actions, tau, V_c,
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
        controls = ti.Vector([memory[CONTROLS + k] for k in ti.static(range(3))])
        command = self.commanded(p, actions)
        outside = in_plane(tau)
        for n in range(self.substeps):
            excess = controls - command
            s = self.runge_kutta(p, s, command + p.lag_mean * excess + wave + outside, V_c)
            controls = command + p.lag_end * excess
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
            memory[LABEL + k], memory[LABEL + 2 + k] = D[k], change[k]
        for k in ti.static(range(3)):
            memory[WAVE + k], memory[CONTROLS + k] = wave[k], controls[k]
        memory[TWIST] = plane[3]
        for k in ti.static(range(4)):
            memory[TWIST + 1 + k] = risen[k]
        write_state(fleet, e, i, start, s, plane, rate, memory, V_c)

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
        sine, cosine = fast_maths.sincos(s[2])
        a = acceleration(p, s[3], s[4], s[5], tau)
        x_dot, y_dot = cosine * s[3] - sine * s[4] + V_c[0], sine * s[3] + cosine * s[4] + V_c[1]
        return ti.Vector([x_dot, y_dot, s[5], a[0], a[1], a[2]])

    @ti.func
    def runge_kutta(self, p: ti.template(), s, tau, V_c):
        """s after one step of the classical fourth-order method."""
        h = p.dt
        k1 = self.derivatives(p, s, tau, V_c)
        k2 = self.derivatives(p, s + (0.5 * h) * k1, tau, V_c)
        k3 = self.derivatives(p, s + (0.5 * h) * k2, tau, V_c)
        k4 = self.derivatives(p, s + h * k3, tau, V_c)
        return s + (h / 6.0) * (k1 + 2.0 * (k2 + k3) + k4)
