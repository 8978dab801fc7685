"""`unity_boat`: the USV of the seed paper (sec. 3.1), a rigid body in Unity's rules on a Gerstner sea.

In Unity's axes (x right, y up, z forward; left-handed) each physics step applies, with the acceleration signal
I_v in [0, 1] and the yaw signal I_h in [-1, 1],

    force J I_v along z;  torque -T_a I_v about x, K I_h about y, -T_s I_h about z,

which in forward-right-down axes is X = J I_v, K = T_s I_h (banks into the turn), M = T_a I_v (bow up),
N = K I_h. PhysX integrates v <- (v + F/m dt) (1 - drag dt), then x <- x + v dt, and the same for rates, with no
gyroscopic torque: omega_b <- (omega_b + I^-1 tau_b dt) (1 - angular_drag dt).

The script knows no current. Here the drag is the water's, which moves with the current V_c of its surface: PhysX's rule
holds for the velocity relative to the water, v - V_c.

Buoyancy acts at the four corners of the hull: a spring and a damper on the height of the corner over the surface
at that place (unclipped, as in the Unity script), preloaded to float with the body origin on the surface. The sum
pushes the boat down the slope of the plane through the four heights: waves shorter than the hull do not push.
"""

import math

import taichi as ti
import torch

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.conventions import GRAVITY
from taichi_sim.kinematics import store
from taichi_sim.maths.rotation import quaternion_advance, rotation_matrix
from taichi_sim.sea import waves
from taichi_sim.surroundings import Surroundings


class UnityBoatParams(Strict):
    """Numbers of configs/vehicles/unity_boat.toml."""

    mass: Positive  # kg
    length: Positive  # m
    beam: Positive  # m
    height: Positive  # m
    force_factor: Positive  # J, N
    yaw_factor: Positive  # K, N m
    pitch_factor: Finite  # T_a, N m
    roll_factor: Finite  # T_s, N m
    drag: NonNegative  # 1/s
    angular_drag: NonNegative  # 1/s
    buoyancy_stiffness: NonNegative  # N/m per corner
    buoyancy_damping: NonNegative  # N s/m per corner
    collision_radius: Positive  # m

    @property
    def inertia(self) -> tuple[float, float, float]:
        """Diagonal inertia of a solid box about forward, right, down, kg m^2."""
        m, a, b, c = self.mass / 12, self.length, self.beam, self.height
        return m * (b * b + c * c), m * (a * a + c * c), m * (a * a + b * b)

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, beam, height, m."""
        return self.length, self.beam, self.height


@ti.data_oriented
class UnityBoat:
    """Steps a team of boats in place.

    The corners' labels (waves.py) are their places plus the horizontal displacement D of the surface particle at the
    hull's centre, one for all four. D follows the boat by one fixed-point step per physics step, from a linear
    prediction: auxiliary state [env, vehicle, 4] is D (north, east, m) and its change in the last step. The mean
    height under the hull is then within 5 % of hs of the exact inverse on the paper's sea, at speed
    (tests/physics/test_unity_boat.py): four inverses would cost four times the time and a boat whose mass is a guess
    does not earn them.
    """

    team = "usv"
    aux_size = 4
    capsize_cosine = 0.0  # the buoyancy of its corners rights it until it lies on its side
    deck_height = math.inf  # it cannot be swamped
    draft, wind_height = 0.0, 10.0  # m; it feels the current of the surface, and no wind
    action_names = ("acceleration", "yaw")
    Params = UnityBoatParams

    def __init__(self, params: UnityBoatParams, dt: float, substeps: int):
        """Bake the numbers of `params`, the step dt (s) and the substeps of a control step into the kernel."""
        self.params = params
        self.dt, self.substeps = dt, substeps
        self.p = params
        self.Ix, self.Iy, self.Iz = params.inertia
        self.preload = params.mass * GRAVITY / 4

    def step(self, team, action: torch.Tensor, around: Surroundings) -> None:
        """Advance one control step. `action` [env, vehicle, 2] in [-1, 1] maps to I_v in [0, 1] and I_h."""
        self._step(
            team.state, team.derived, team.aux, team.surface, action, around.sea, around.env_sea, around.phase,
            around.current, around.sea.shape[2],
        )  # fmt: skip

    def reset_aux(self, aux: torch.Tensor, state: torch.Tensor) -> None:
        """Auxiliary state [.., 2] of vehicles put at `state` [.., 13]."""
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
        count: ti.template(),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            pos = ti.Vector([state[e, i, 0], state[e, i, 1], state[e, i, 2]])
            q = ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]])
            v_b = ti.Vector([state[e, i, 7], state[e, i, 8], state[e, i, 9]])
            omega = ti.Vector([state[e, i, 10], state[e, i, 11], state[e, i, 12]])
            D = ti.Vector([aux[e, i, 0], aux[e, i, 1]])
            change = ti.Vector([aux[e, i, 2], aux[e, i, 3]])
            V_c = ti.Vector([current[e, 0], current[e, 1], 0.0])
            I_v, I_h = 0.5 * (action[e, i, 0] + 1.0), action[e, i, 1]
            v = rotation_matrix(q) @ v_b - V_c  # relative to the water
            level = pos[2] * 0.0
            s = env_sea[e]
            for n in range(self.substeps):
                tau = n * ti.static(self.dt)
                R = rotation_matrix(q)
                D_next, heights = self.surface(sea, phase, count, s, e, tau, pos, R, D + change)
                change = D_next - D
                D = D_next
                force, torque_n = self.buoyancy(pos, R, v, omega, heights)
                force += R @ ti.Vector([self.p.force_factor * I_v, 0.0, 0.0])
                torque = R.transpose() @ torque_n + self.control_torque(I_v, I_h)
                v, omega = self.physx_velocities(v, omega, force, torque)
                pos += v * ti.static(self.dt) + V_c * ti.static(self.dt)  # apart: without current, the same bits
                q = quaternion_advance(q, omega, ti.static(self.dt))
                level = 0.25 * heights.sum()
            R_nb = rotation_matrix(q)
            v += V_c
            store(derived, e, i, R_nb, v)
            v_b = R_nb.transpose() @ v
            for k in ti.static(range(3)):
                state[e, i, k], state[e, i, 7 + k], state[e, i, 10 + k] = pos[k], v_b[k], omega[k]
            for k in ti.static(range(4)):
                state[e, i, 3 + k] = q[k]
            aux[e, i, 0], aux[e, i, 1], aux[e, i, 2], aux[e, i, 3] = D[0], D[1], change[0], change[1]
            surface[e, i, 0] = level

    @ti.func
    def surface(self, sea: ti.template(), phase: ti.template(), count: ti.template(), s, e, tau, pos, R, D):
        """Displacement (m) at the centre, from its prediction D, and elevations (m, up) under the corners: bow port,
        bow starboard, stern port, stern starboard.
        """
        x, y = pos[0] + D[0], pos[1] + D[1]
        fx, fy = 0.5 * self.p.length * R[0, 0], 0.5 * self.p.length * R[1, 0]
        gx, gy = 0.5 * self.p.beam * R[0, 1], 0.5 * self.p.beam * R[1, 1]
        X = ti.Vector([x, x + fx - gx, x + fx + gx, x - fx - gx, x - fx + gx])
        Y = ti.Vector([y, y + fy - gy, y + fy + gy, y - fy - gy, y - fy + gy])
        r = waves.displacement_and_four_elevations(sea, phase, count, s, e, X, Y, tau)
        return ti.Vector([r[0], r[1]]), ti.Vector([r[2], r[3], r[4], r[5]])

    @ti.func
    def buoyancy(self, pos, R, v, omega, heights):
        """Force (N) and torque (N m) of the corner springs and of gravity, both in n, about the body origin."""
        a, b = 0.5 * ti.static(self.p.length), 0.5 * ti.static(self.p.beam)
        omega_n = R @ omega
        total = pos[2] * 0.0
        torque = ti.Vector([total, total, total])
        for c in ti.static(range(4)):
            r_b = ti.Vector([a * (1 - 2 * (c // 2)), b * (2 * (c % 2) - 1), 0.0])
            r = R @ r_b
            down_speed = v[2] + omega_n[0] * r[1] - omega_n[1] * r[0]
            lift = self.preload + self.p.buoyancy_stiffness * (pos[2] + r[2] + heights[c])
            lift += self.p.buoyancy_damping * down_speed
            total += lift
            torque += ti.Vector([-r[1] * lift, r[0] * lift, 0.0])
        bow = (heights[0] + heights[1] - heights[2] - heights[3]) / (2.0 * self.p.length)
        starboard = (heights[1] + heights[3] - heights[0] - heights[2]) / (2.0 * self.p.beam)
        slope_n = bow * R[0, 0] + starboard * R[0, 1]
        slope_e = bow * R[1, 0] + starboard * R[1, 1]
        weight = ti.static(self.p.mass * GRAVITY)
        return ti.Vector([-total * slope_n, -total * slope_e, weight - total]), torque

    @ti.func
    def control_torque(self, I_v, I_h):
        """Torque (N m) of the two signals in b."""
        return ti.Vector([self.p.roll_factor * I_h, self.p.pitch_factor * I_v, self.p.yaw_factor * I_h])

    @ti.func
    def physx_velocities(self, v, omega, force, torque):
        """Velocity relative to the water, in n, and rate in b after one step of PhysX: impulse first, then drag."""
        v_next = (v + force * ti.static(self.dt / self.p.mass)) * ti.static(1 - self.p.drag * self.dt)
        alpha = ti.Vector([torque[0] / self.Ix, torque[1] / self.Iy, torque[2] / self.Iz])
        omega_next = (omega + alpha * ti.static(self.dt)) * ti.static(1 - self.p.angular_drag * self.dt)
        return v_next, omega_next
