"""`unity_boat`: the USV of the seed paper (sec. 3.1), a rigid body by Unity's rules on a Gerstner sea.

In Unity's axes (x right, y up, z forward; left-handed), each physics step applies, with the acceleration signal I_v in
[0, 1] and the yaw signal I_h in [-1, 1],

    force J I_v along z;  torque -T_a I_v about x, K I_h about y, -T_s I_h about z.

In forward-right-down axes this is X = J I_v, K = T_s I_h (banks into the turn), M = T_a I_v (bow up), N = K I_h. PhysX
integrates v <- (v + F/m dt) (1 - drag dt), then x <- x + v dt. Rates are integrated likewise, without a gyroscopic
torque: omega_b <- (omega_b + I^-1 tau_b dt) (1 - angular_drag dt).

The Unity script has no current. Here the drag is that of the water, which moves with the current V_c at its surface:
PhysX's rule holds for the velocity relative to the water, v - V_c.

Buoyancy acts at the four corners of the hull. Each has a spring and a damper on its height above the surface
(unclipped, as in the Unity script), preloaded so that the boat floats with its origin on the surface. The sum pushes
the boat down the slope of the plane through the four elevations, so waves shorter than the hull do not push it.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np
import taichi as ti
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.config import Finite, NonNegative, Positive
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import abreast, lanes
from taichi_sim.kernels.abreast import group, put, taken, taken2
from taichi_sim.kernels.conventions import ELEVATION, GRAVITY, SURGE
from taichi_sim.kernels.packs import AroundPack, Build, FleetPack, load_at, own_numbers
from taichi_sim.kernels.position import move
from taichi_sim.kernels.rigid_body import quaternion_rate
from taichi_sim.kernels.rotation import position_of, quaternion_advance, rotation_matrix, store
from taichi_sim.kernels.runtime import array2
from taichi_sim.models.usv.vessel_base import Beam, CollisionRadius, Height, Length, Number, Vessel, steady_speed
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea import gerstner
from taichi_sim.vehicle import Limits, VehicleParams


class UnityBoatParams(VehicleParams):
    """Parameters in configs/vehicles/unity_boat.toml."""

    mass: Annotated[Positive, Plausible(5e-4, 1.0, "kg", of="rho_sea length beam height")]
    length: Length
    beam: Beam
    height: Height
    force_factor: Annotated[Positive, Plausible(0.01, 10.0, "N", of="mass g")]  # J
    yaw_factor: Annotated[Positive, Plausible(0.01, 2.0, "N m", of="force_factor length")]  # K
    pitch_factor: Annotated[Finite, Plausible(5e-4, 1.0, "N m", of="force_factor length")]  # T_a
    roll_factor: Annotated[Finite, Plausible(5e-4, 1.0, "N m", of="force_factor length")]  # T_s
    drag: Annotated[NonNegative, Plausible(0.05, 20.0, "1/s")]
    angular_drag: Annotated[NonNegative, Plausible(0.05, 50.0, "1/s")]
    buoyancy_stiffness: Annotated[NonNegative, Plausible(0.1, 100.0, "N/m", of="mass g length^-1")]  # N/m per corner
    # N s/m per corner
    buoyancy_damping: Annotated[NonNegative, Plausible(0.01, 10.0, "N s/m", of="buoyancy_stiffness^0.5 mass^0.5")]
    collision_radius: CollisionRadius

    @property
    def inertia(self) -> tuple[float, float, float]:
        """Diagonal inertia of a solid box about the forward, right and down axes, kg m^2."""
        x, y, z = self.inertia_shares
        return self.mass * x, self.mass * y, self.mass * z

    @property
    def inertia_shares(self) -> tuple[float, float, float]:
        """Diagonal inertia over the mass, m^2."""
        a, b, c = self.length, self.beam, self.height
        return (b * b + c * c) / 12, (a * a + c * c) / 12, (a * a + b * b) / 12

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, beam, height, m."""
        return self.length, self.beam, self.height


class BoatNumbers(NamedTuple):
    """Numbers of one boat that the kernel uses."""

    dt: Number  # physics step, s
    weight: Number  # N
    preload: Number  # preload of a corner's spring, N
    inverse_mass: Number  # 1/kg
    inverse_Ix: Number  # 1/(kg m^2)  # noqa: N815
    inverse_Iy: Number  # noqa: N815
    inverse_Iz: Number  # noqa: N815
    force: Number  # J, N
    roll: Number  # T_s, N m
    pitch: Number  # T_a, N m
    yaw: Number  # K, N m
    drag: Number  # 1/s
    angular_drag: Number  # 1/s
    stiffness: Number  # N/m per corner
    damping: Number  # N s/m per corner


@ti.data_oriented
class UnityBoat(Vessel):
    """Steps a team of boats in place. Actions in [-1, 1] map to I_v in [0, 1] and to I_h; the controls are I_v and I_h.

    The Lagrangian labels of the corners (gerstner.py) are their positions plus one displacement for all four: D, the
    horizontal displacement of the surface particle at the hull's centre. D is updated by one fixed-point step per
    physics step, from a linear prediction. The auxiliary state [env, vehicle, 4] is D (north, east, m) and its change
    in the last step. On the paper's sea, at speed, the mean height under the hull is within 5 % of hs of the exact
    inverse (test_unity_boat.py). Four exact inverses would take four times as long, which a boat with a
    guessed mass does not justify. The buoyancy of the corners rights the boat until it lies on its side, and it cannot
    be swamped. The current at the surface acts on it; the wind does not.
    """

    Params = UnityBoatParams
    action_names = ("acceleration", "yaw")
    control_names = ("I_v", "I_h")
    aux_size, free_step = 4, True
    varying = (
        "mass", "force_factor", "yaw_factor", "pitch_factor", "roll_factor", "drag", "angular_drag",
        "buoyancy_stiffness", "buoyancy_damping",
    )  # fmt: skip

    @property
    def limits(self) -> Limits:
        """Limits of the boat; the top speed is that at which drag equals the whole thrust."""
        return Limits((0.0, 0.0, steady_speed(self.params.force_factor, self.params.mass * self.params.drag)))

    def steer(self, ahead: ArrayLike, helm: ArrayLike) -> NDArray[np.float64]:
        """Return the actions of a helmsman: `ahead` is I_v, `helm` is I_h."""
        return np.stack(np.broadcast_arrays(2.0 * np.asarray(ahead) - 1.0, helm), axis=-1)

    def own(self, values: Mapping[str, Number]) -> BoatNumbers:
        """Return the kernel's numbers, derived from the `values` of the vehicle file."""
        mass = values["mass"]
        Ix, Iy, Iz = (mass * share for share in self.params.inertia_shares)
        return BoatNumbers(
            dt=self.dt,
            weight=mass * GRAVITY,
            preload=mass * GRAVITY / 4,
            inverse_mass=1 / mass,
            inverse_Ix=1 / Ix,
            inverse_Iy=1 / Iy,
            inverse_Iz=1 / Iz,
            force=values["force_factor"],
            roll=values["roll_factor"],
            pitch=values["pitch_factor"],
            yaw=values["yaw_factor"],
            drag=values["drag"],
            angular_drag=values["angular_drag"],
            stiffness=values["buoyancy_stiffness"],
            damping=values["buoyancy_damping"],
        )

    def build(self, fleet: Fleet, around: Surroundings) -> Build:
        """What the kernel is compiled for."""
        return super().build(fleet, around)._replace(width=lanes.width())

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance by one control step."""
        with abreast.vectors():
            fleet.launch(self._step, fleet.pack, around.pack, self.build(fleet, around))

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13] in the limit of short PhysX steps; the wind has no effect."""
        out = torch.empty_like(state)
        self._rhs(out, state, controls, current, load)
        return out

    @ti.kernel
    def _rhs(self, out: array2, state: array2, controls: array2, current: array2, load: array2):
        for n in range(state.shape[0]):
            y = ti.Vector([state[n, k] for k in ti.static(range(13))])
            V_c = ti.Vector([current[n, 0], current[n, 1], 0.0])
            tau = ti.Vector([load[n, k] for k in ti.static(range(6))])
            calm = ti.Vector([y[0] * 0.0 for _ in ti.static(range(4))])
            R = rotation_matrix(ti.Vector([y[3], y[4], y[5], y[6]]))
            v_b, omega = ti.Vector([y[7], y[8], y[9]]), ti.Vector([y[10], y[11], y[12]])
            v = R @ v_b - V_c
            force, torque = self.loads(
                self.constants, ti.Vector([y[0], y[1], y[2]]), R, v, omega, calm, controls[n, 0], controls[n, 1], tau
            )
            p = ti.static(self.constants)
            a_b = R.transpose() @ (force * p.inverse_mass - p.drag * v) - omega.cross(v_b)
            alpha = self.angular_acceleration(self.constants, torque) - p.angular_drag * omega
            v_n, rate = R @ v_b, quaternion_rate(ti.Vector([y[3], y[4], y[5], y[6]]), omega)
            for k in ti.static(range(3)):
                out[n, k], out[n, 7 + k], out[n, 10 + k] = v_n[k], a_b[k], alpha[k]
            for k in ti.static(range(4)):
                out[n, 3 + k] = rate[k]

    @ti.kernel
    def _step(self, fleet: FleetPack, around: AroundPack, build: ti.template()):
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for g in range((fleet.state.shape[0] * fleet.state.shape[1] + build.width - 1) // build.width):
            e, i = group(build.width, g * build.width, fleet.state.shape[0], fleet.state.shape[1])
            y, label = taken(fleet.state, e, i, 0, 13), taken(fleet.aux, e, i, 0, 4)
            flow, command = taken2(around.current, e, 2), taken(fleet.action, e, i, 0, 2)
            V_c = ti.Vector([flow[0], flow[1], 0.0])
            I_v, I_h = 0.5 * (command[0] + 1.0), command[1]
            tau = load_at(build, fleet.load, e, i)
            start, level = position_of(y), y[2] * 0.0
            y, label, level = self.advance(
                own_numbers(self, build, fleet.numbers, e, i), build, around, e, y, label, V_c, I_v, I_h, tau
            )
            R = rotation_matrix(ti.Vector([y[3], y[4], y[5], y[6]]))
            v = ti.Vector([y[7], y[8], y[9]])
            store(fleet.derived, e, i, R, v)
            v_b = R.transpose() @ v
            move(fleet, e, i, start, position_of(y), [y[3], y[4], y[5], y[6]])
            put(fleet.state, e, i, SURGE, [v_b[0], v_b[1], v_b[2], y[10], y[11], y[12]])
            put(fleet.aux, e, i, 0, [label[0], label[1], label[2], label[3]])
            put(fleet.surface, e, i, ELEVATION, [level])

    @ti.func
    def advance(self, p: ti.template(), build: ti.template(), around: ti.template(), e, y, label, V_c, I_v, I_h, tau):
        """State (its way since the beginning in place of its position, its velocity in n), label (D and its change) and
        mean elevation after one control step.
        """
        start, omega = position_of(y), ti.Vector([y[10], y[11], y[12]])
        pos, way = start, start * 0.0
        q = ti.Vector([y[3], y[4], y[5], y[6]])
        D, change = ti.Vector([label[0], label[1]]), ti.Vector([label[2], label[3]])
        v = rotation_matrix(q) @ ti.Vector([y[7], y[8], y[9]]) - V_c  # relative to the water
        level = pos[2] * 0.0
        for n in range(self.substeps):
            R = rotation_matrix(q)
            D_next, heights = self.surface(around, build, e, n * p.dt, pos, R, D + change)
            change = D_next - D
            D = D_next
            force, torque = self.loads(p, pos, R, v, omega, heights, I_v, I_h, tau)
            v, omega = self.physx_velocities(p, v, omega, force, torque)
            # two terms, so that a boat without current has the same bits
            way += v * p.dt + V_c * p.dt
            pos = start + way
            q = quaternion_advance(q, omega, p.dt)
            level = 0.25 * heights.sum()
        v += V_c
        y = ti.Vector([way[0], way[1], way[2], q[0], q[1], q[2], q[3], v[0], v[1], v[2], omega[0], omega[1], omega[2]])
        return y, ti.Vector([D[0], D[1], change[0], change[1]]), level

    @ti.func
    def loads(self, p: ti.template(), pos, R, v, omega, heights, I_v, I_h, tau):
        """Force (N, n) and torque (N m, b) of buoyancy, weight, the two signals and the external load tau."""
        force, torque_n = self.buoyancy(p, pos, R, v, omega, heights)
        force += R @ ti.Vector([p.force * I_v + tau[0], tau[1], tau[2]])
        control = ti.Vector([p.roll * I_h, p.pitch * I_v, p.yaw * I_h])
        return force, R.transpose() @ torque_n + control + ti.Vector([tau[3], tau[4], tau[5]])

    @ti.func
    def surface(self, around: ti.template(), build: ti.template(), e, tau, pos, R, D):
        """Displacement (m) of the water at the centre, from its prediction D, and elevations (m, up) under the corners.

        The corners are bow port, bow starboard, stern port, stern starboard.
        """
        a, b = ti.static(0.5 * self.params.length, 0.5 * self.params.beam)
        ahead, right = ti.Vector([a * R[0, 0], a * R[1, 0]]), ti.Vector([b * R[0, 1], b * R[1, 1]])
        return gerstner.displacement_and_corners(
            around, build.components, e, pos[0] + D[0], pos[1] + D[1], ahead, right, tau
        )

    @ti.func
    def buoyancy(self, p: ti.template(), pos, R, v, omega, heights):
        """Force (N) and torque (N m) of the corner springs and of gravity, both in n and about the body origin."""
        a, b = 0.5 * ti.static(self.params.length), 0.5 * ti.static(self.params.beam)
        omega_n = R @ omega
        total = pos[2] * 0.0
        torque = ti.Vector([total, total, total])
        for c in ti.static(range(4)):
            r_b = ti.Vector([a * (1 - 2 * (c // 2)), b * (2 * (c % 2) - 1), 0.0])
            r = R @ r_b
            down_speed = v[2] + omega_n[0] * r[1] - omega_n[1] * r[0]
            lift = p.preload + p.stiffness * (pos[2] + r[2] + heights[c])
            lift += p.damping * down_speed
            total += lift
            torque += ti.Vector([-r[1] * lift, r[0] * lift, 0.0])
        bow = (heights[0] + heights[1] - heights[2] - heights[3]) / (2.0 * self.params.length)
        starboard = (heights[1] + heights[3] - heights[0] - heights[2]) / (2.0 * self.params.beam)
        slope_n = bow * R[0, 0] + starboard * R[0, 1]
        slope_e = bow * R[1, 0] + starboard * R[1, 1]
        return ti.Vector([-total * slope_n, -total * slope_e, p.weight - total]), torque

    @ti.func
    def angular_acceleration(self, p: ti.template(), torque):
        """Angular acceleration (rad/s^2, b); PhysX has no gyroscopic torque."""
        return ti.Vector([torque[0] * p.inverse_Ix, torque[1] * p.inverse_Iy, torque[2] * p.inverse_Iz])

    @ti.func
    def physx_velocities(self, p: ti.template(), v, omega, force, torque):
        """Velocity in n and rates in b after one step of PhysX: the impulse first, then the drag."""
        v_next = (v + force * (p.dt * p.inverse_mass)) * (1 - p.drag * p.dt)
        omega_next = omega + self.angular_acceleration(p, torque) * p.dt
        return v_next, omega_next * (1 - p.angular_drag * p.dt)
