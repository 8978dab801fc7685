"""Parameters and loads of a vessel in the plane: M, C, D and g of `manoeuvring_3dof`.

Inertia, Coriolis and damping are those of eqs (3)-(4) of the seed paper, in the notation of Skjetne, Smogeli & Fossen
(2004), Modeling, Identification and Control 25(1), 3-27:

    m11 = m - X_udot, m22 = m - Y_vdot, m23 = m x_g - Y_rdot, m32 = m x_g - N_vdot, m33 = I_z - N_rdot,
    c13 = -m22 v - (m23 + m32) r / 2,  c23 = m11 u,
    d11 = -(X_u + X_uu |u| + X_uuu u^2),
    d22 = -(Y_v + Y_vv |v| + Y_rv |r|),  d23 = -(Y_r + Y_vr |v| + Y_rr |r|),
    d32 = -(N_v + N_vv |v| + N_rv |r|),  d33 = -(N_r + N_vr |v| + N_rr |r|).

The disturbance g is the load of waves. A long wave accelerates the water by -g grad(zeta). The load on a body in
accelerated water is (displaced mass + added mass) times that acceleration (Taylor 1928). The body is a wall-sided block
of the hull's length and beam, and the slope is averaged over it. The yaw moment comes from the change of the transverse
acceleration along the hull.
"""

# Kernels are another language inside Python syntax.
# pyright: reportAttributeAccessIssue=false, reportInvalidTypeForm=false

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
import taichi as ti
from pydantic import model_validator

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.conventions import GRAVITY
from taichi_sim.usv.vessel import Number, steady_speed

AT_ONCE = 1e-300  # s; added to an actuator's time constant, so that one without lag follows at once


class Manoeuvring3dofParams(Strict):
    """Parameters of a vehicle file with model = "manoeuvring_3dof"; derivatives that are not given are zero."""

    length: Positive  # m
    beam: Positive  # m
    height: Positive  # m
    collision_radius: Positive  # m
    mass: Positive  # kg, also of the displaced water
    I_z: Positive  # kg m^2, about the body origin
    x_g: Finite = 0.0  # centre of mass ahead of the body origin, m
    X_udot: Finite = 0.0  # added mass, kg (negative)
    Y_vdot: Finite = 0.0  # kg
    Y_rdot: Finite = 0.0  # kg m
    N_vdot: Finite = 0.0  # kg m
    N_rdot: Finite = 0.0  # kg m^2
    X_u: Finite = 0.0  # N s/m
    X_uu: Finite = 0.0  # N s^2/m^2, of |u| u
    X_uuu: Finite = 0.0  # N s^3/m^3
    Y_v: Finite = 0.0  # N s/m
    Y_vv: Finite = 0.0  # N s^2/m^2, of |v| v
    Y_rv: Finite = 0.0  # N s^2/m, of |r| v
    Y_r: Finite = 0.0  # N s
    Y_vr: Finite = 0.0  # N s^2/m, of |v| r
    Y_rr: Finite = 0.0  # N s^2, of |r| r
    N_v: Finite = 0.0  # N s
    N_vv: Finite = 0.0  # N s^2/m, of |v| v
    N_rv: Finite = 0.0  # N s^2, of |r| v
    N_r: Finite = 0.0  # N m s
    N_vr: Finite = 0.0  # N s^2, of |v| r
    N_rr: Finite = 0.0  # N m s^2, of |r| r
    actions: Literal["acceleration_yaw", "surge_sway_yaw"] = "acceleration_yaw"
    surge_force_max: Positive  # N
    sway_force_max: NonNegative = 0.0  # N, for actions = "surge_sway_yaw"
    yaw_moment_max: Positive  # N m
    time_constant: NonNegative = 0.0  # of the actuators, s; 0: a command acts at once
    wave_response: bool = True  # whether waves push the hull; it rides on them in any case

    @model_validator(mode="after")
    def _inertia_is_positive(self):
        if np.linalg.eigvalsh(self.M + self.M.T).min() <= 0:
            raise ValueError("mass, I_z, x_g and added mass must make a positive definite inertia matrix")
        return self

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, beam, height, m."""
        return self.length, self.beam, self.height

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
    """Return m11, m22, m23, m32 and m33 (see the module's docstring)."""
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


class ManoeuvringNumbers(NamedTuple):
    """Numbers of one vessel that the kernel uses; derivatives have their names in the vehicle file."""

    m11: Number  # kg
    m22: Number  # kg
    m23: Number  # kg m
    m32: Number  # kg m
    m33: Number  # kg m^2
    c13_r: Number  # (m23 + m32) / 2, kg m
    inverse_m11: Number
    inverse_det: Number  # of m22 m33 - m23 m32
    block_yaw: Number  # yaw inertia of the water that a wall-sided block displaces, plus added inertia, kg m^2
    X_max: Number  # N
    Y_max: Number  # N
    N_max: Number  # N m
    lag_end: Number  # remaining share of an actuator's deviation from its command after a step
    lag_mean: Number  # mean of that share over the step
    X_u: Number
    X_uu: Number
    X_uuu: Number
    Y_v: Number
    Y_vv: Number
    Y_rv: Number
    Y_r: Number
    Y_vr: Number
    Y_rr: Number
    N_v: Number
    N_vv: Number
    N_rv: Number
    N_r: Number
    N_vr: Number
    N_rr: Number


DAMPING = ManoeuvringNumbers._fields[ManoeuvringNumbers._fields.index("X_u") :]
ADDED_MASS = ("X_udot", "Y_vdot", "Y_rdot", "N_vdot", "N_rdot")
VARYING = (
    "mass", "I_z", "x_g", *ADDED_MASS, *DAMPING, "surge_force_max", "sway_force_max", "yaw_moment_max", "time_constant",
)  # fmt: skip


def numbers_of(values: Mapping[str, Number], length: float, dt: float) -> ManoeuvringNumbers:
    """Numbers for a kernel with step dt (s), of a hull of `length` (m) with `values` for all keys that vary."""
    m11, m22, m23, m32, m33 = _inertia(values)
    # An actuator's deviation from its command decays by exp(-dt / T) per step; its mean over the step acts on the hull.
    x = dt / (values["time_constant"] + AT_ONCE)
    lag_end = math.e**-x
    return ManoeuvringNumbers(
        m11=m11,
        m22=m22,
        m23=m23,
        m32=m32,
        m33=m33,
        c13_r=0.5 * (m23 + m32),
        inverse_m11=1 / m11,
        inverse_det=1 / (m22 * m33 - m23 * m32),
        block_yaw=values["mass"] * length**2 / 12 - values["N_rdot"],
        X_max=values["surge_force_max"],
        Y_max=values["sway_force_max"],
        N_max=values["yaw_moment_max"],
        lag_end=lag_end,
        lag_mean=(1 - lag_end) / x,
        **{name: values[name] for name in DAMPING},
    )


@ti.func
def acceleration(p: ti.template(), u, v, r, tau):
    """nu_dot (m/s^2, rad/s^2) of eq. (3) at velocity [u v r] relative to the water, under tau = [X Y N]."""
    au, av, ar = ti.abs(u), ti.abs(v), ti.abs(r)
    c13, c23 = -p.m22 * v - p.c13_r * r, p.m11 * u
    d11 = -(p.X_u + p.X_uu * au + p.X_uuu * u * u)
    d22 = -(p.Y_v + p.Y_vv * av + p.Y_rv * ar)
    d23 = -(p.Y_r + p.Y_vr * av + p.Y_rr * ar)
    d32 = -(p.N_v + p.N_vv * av + p.N_rv * ar)
    d33 = -(p.N_r + p.N_vr * av + p.N_rr * ar)
    X = tau[0] - c13 * r - d11 * u
    Y = tau[1] - c23 * r - d22 * v - d23 * r
    N = tau[2] + c13 * u + c23 * v - d32 * v - d33 * r
    return ti.Vector(
        [X * p.inverse_m11, (p.m33 * Y - p.m23 * N) * p.inverse_det, (p.m22 * N - p.m32 * Y) * p.inverse_det]
    )


@ti.func
def wave_load(p: ti.template(), plane):
    """Wave force X, Y (N) and moment N (N m) on the hull, from its water plane."""
    a_x, a_y, a_yx = -GRAVITY * plane[1], -GRAVITY * plane[2], -GRAVITY * plane[3]
    return ti.Vector([p.m11 * a_x, p.m22 * a_y + p.m23 * a_yx, p.m32 * a_y + p.block_yaw * a_yx])
