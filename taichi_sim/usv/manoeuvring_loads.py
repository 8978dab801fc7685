"""Numbers and forces of a surface vessel in the plane: the M, C, D and g of `manoeuvring_3dof`.

Inertia, Coriolis and damping are those of eqs (3)-(4) of the seed paper in the notation of Skjetne, Smogeli & Fossen
(2004), Modeling, Identification and Control 25(1), 3-27:

    m11 = m - X_udot, m22 = m - Y_vdot, m23 = m x_g - Y_rdot, m32 = m x_g - N_vdot, m33 = I_z - N_rdot,
    c13 = -m22 v - (m23 + m32) r / 2,  c23 = m11 u,
    d11 = -(X_u + X_uu |u| + X_uuu u^2),
    d22 = -(Y_v + Y_vv |v| + Y_rv |r|),  d23 = -(Y_r + Y_vr |v| + Y_rr |r|),
    d32 = -(N_v + N_vv |v| + N_rv |r|),  d33 = -(N_r + N_vr |v| + N_rr |r|).

Waves are the disturbance g. The water of a long wave is accelerated by -g grad(zeta), and a body in accelerated water
feels (mass displaced + added mass) times that (Taylor 1928): a wall-sided block of the hull's length and beam, with
the slope averaged over it. Its yaw moment is that of a transverse acceleration that changes along the hull.
"""

from math import factorial
from typing import Literal

import numpy as np
import taichi as ti
from pydantic import model_validator

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.conventions import GRAVITY


class Manoeuvring3dofParams(Strict):
    """Numbers of a vehicle file with model = "manoeuvring_3dof"; derivatives not given are zero."""

    length: Positive  # m
    beam: Positive  # m
    height: Positive  # m
    collision_radius: Positive  # m
    mass: Positive  # kg, which is also the mass of the water displaced
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
    sway_force_max: NonNegative = 0.0  # N, of actions = "surge_sway_yaw"
    yaw_moment_max: Positive  # N m
    time_constant: NonNegative = 0.0  # of the actuators, s; 0: a command acts at once
    wave_response: bool = True  # whether waves push the hull; it rides on them either way

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
        """Inertia matrix [3, 3] of eq. (4), rigid body and added mass."""
        m23, m32 = self.mass * self.x_g - self.Y_rdot, self.mass * self.x_g - self.N_vdot
        m11, m22, m33 = self.mass - self.X_udot, self.mass - self.Y_vdot, self.I_z - self.N_rdot
        return np.array([[m11, 0.0, 0.0], [0.0, m22, m23], [0.0, m32, m33]])

    def steady_surge(self, force: float) -> float:
        """Speed (m/s) of a straight run under `force` (N >= 0): X_uuu u^3 + X_uu u^2 + X_u u + force = 0."""
        roots = np.roots([self.X_uuu, self.X_uu, self.X_u, force])
        ahead = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]
        return float(ahead.min(initial=np.inf))

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
        """Largest step (s) of RK4 at which what decays, at rest and in a straight run at full force, does not grow."""
        top = self.steady_surge(self.surge_force_max)
        speeds = (0.0, top) if np.isfinite(top) else (0.0,)
        return min(_rk4_limit(value) for u in speeds for value in self.eigenvalues(u))


def _rk4_limit(eigenvalue: complex) -> float:
    """Smallest dt > 0 with |1 + z + z^2/2 + z^3/6 + z^4/24| = 1 at z = eigenvalue dt; infinite if none decays."""
    if eigenvalue.real >= 0:
        return np.inf
    growth = np.array([eigenvalue**k / factorial(k) for k in range(5)])
    square_less_one = np.convolve(growth, growth.conj()).real[1:]  # over dt
    roots = np.roots(square_less_one[::-1])
    return float(roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].min())


@ti.data_oriented
class ManoeuvringLoads:
    """Forces on one hull as functions of values; the numbers are constants of the compiled kernels."""

    def __init__(self, params: Manoeuvring3dofParams):
        """Bake the numbers of `params`."""
        self.p = params
        M = params.M
        self.m11, self.m22, self.m23, self.m32, self.m33 = (float(m) for m in M[[0, 1, 1, 2, 2], [0, 1, 2, 1, 2]])
        self.c13_r = 0.5 * (self.m23 + self.m32)
        self.det = self.m22 * self.m33 - self.m23 * self.m32
        # Inertia in yaw of the water that a wall-sided block displaces, with the added one, kg m^2
        self.block_yaw = params.mass * params.length**2 / 12 - params.N_rdot
        self.slope_gain = GRAVITY if params.wave_response else 0.0

    @ti.func
    def acceleration(self, u, v, r, tau):
        """nu_dot (m/s^2, rad/s^2) of eq. (3) at velocity [u v r] relative to the water, under tau [X Y N]."""
        au, av, ar = ti.abs(u), ti.abs(v), ti.abs(r)
        c13, c23 = -self.m22 * v - self.c13_r * r, self.m11 * u
        d11 = -(self.p.X_u + self.p.X_uu * au + self.p.X_uuu * u * u)
        d22 = -(self.p.Y_v + self.p.Y_vv * av + self.p.Y_rv * ar)
        d23 = -(self.p.Y_r + self.p.Y_vr * av + self.p.Y_rr * ar)
        d32 = -(self.p.N_v + self.p.N_vv * av + self.p.N_rv * ar)
        d33 = -(self.p.N_r + self.p.N_vr * av + self.p.N_rr * ar)
        X = tau[0] - c13 * r - d11 * u
        Y = tau[1] - c23 * r - d22 * v - d23 * r
        N = tau[2] + c13 * u + c23 * v - d32 * v - d33 * r
        v_dot = (self.m33 * Y - self.m23 * N) / ti.static(self.det)
        r_dot = (self.m22 * N - self.m32 * Y) / ti.static(self.det)
        return ti.Vector([X / ti.static(self.m11), v_dot, r_dot])

    @ti.func
    def water_plane(self, heights):
        """Mean elevation (m), slopes ahead and to starboard, and the change of the latter per metre ahead (1/m).

        `heights` (m, up) are those of the bow port, bow starboard, stern port and stern starboard corners.
        """
        bow, stern = heights[1] - heights[0], heights[3] - heights[2]
        ahead = (heights[0] + heights[1] - heights[2] - heights[3]) / ti.static(2.0 * self.p.length)
        right = (bow + stern) / ti.static(2.0 * self.p.beam)
        twist = (bow - stern) / ti.static(self.p.beam * self.p.length)
        return ti.Vector([0.25 * heights.sum(), ahead, right, twist])

    @ti.func
    def wave_load(self, plane):
        """Force X, Y (N) and moment N (N m) of the waves on the hull, from its water plane."""
        a_x, a_y, a_yx = -self.slope_gain * plane[1], -self.slope_gain * plane[2], -self.slope_gain * plane[3]
        Y = self.m22 * a_y + self.m23 * a_yx
        return ti.Vector([self.m11 * a_x, Y, self.m32 * a_y + self.block_yaw * a_yx])
