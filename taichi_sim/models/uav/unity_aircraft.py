"""`unity_aircraft`: the UAV of the seed paper (sec. 3.2), a kinematic attitude and one force along the nose.

Smoothed increments of pitch, yaw and roll move toward their commands by `smooth_rate` dt per step, and each angle
advances by increment x dt x speed (eqs 7-9; speed 100 deg/s). Pitch and roll are clamped. The force
thrust_factor T a acts along the nose as it was before the step's rotation; PhysX integrates
v <- (v + F/m dt) (1 - drag dt), x <- x + v dt. There is no gravity, lift or wind: the attitude is what is controlled.

The paper lists pitch, yaw and boost as actions, so roll follows from yaw, by one of two rules:
- "script", the published one: the roll command is minus the yaw command, or levels (-roll / max_roll) when the yaw
  command is exactly zero, which a continuous policy never commands;
- "coordinated" (default): the roll command is the bank command + yaw - roll / max_roll, which banks and levels at the
  same time; at the script's three yaw values -1, 0, 1 the motion has the same start and end as by the script.
Roll does not turn the nose, so the rule changes the picture, not the path.

Signs here are forward-right-down: pitch up, yaw right and bank right are positive (Unity: nose down, right, left).
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import math
from collections.abc import Mapping
from typing import Annotated, Literal, NamedTuple

import taichi as ti
import torch
from pydantic import Field
from torch import Tensor

from taichi_sim.config import NonNegative, Positive
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import abreast, fast_maths, lanes
from taichi_sim.kernels.abreast import group, put, taken
from taichi_sim.kernels.conventions import QUATERNION, SURGE
from taichi_sim.kernels.packs import Build, FleetPack, load_at, own_numbers
from taichi_sim.kernels.position import move
from taichi_sim.kernels.rigid_body import quaternion_rate
from taichi_sim.kernels.rotation import (
    position_of,
    quaternion_from_euler,
    rotation_matrix,
    store,
    torch_euler_from_quaternion,
    wrap_pi,
)
from taichi_sim.kernels.runtime import array2
from taichi_sim.models.uav.aircraft import Aircraft
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Limits, Number, VehicleParams

DEG = 0.017453292519943295
AUX = ("roll_increment", "pitch_increment", "yaw_increment", "roll", "pitch", "yaw")  # increments in [-1, 1]; rad
INCREMENT, ANGLE = AUX.index("roll_increment"), AUX.index("roll")  # first of three columns each


class UnityAircraftParams(VehicleParams):
    """Parameters of configs/vehicles/unity_aircraft.toml."""

    mass: Annotated[Positive, Plausible(1.0, 700.0, "kg", of="length span height")]
    thrust: Annotated[Positive, Plausible(0.1, 200.0, "N", of="mass g")]  # T
    thrust_factor: Annotated[Positive, Plausible(0.1, 10.0)]  # 2.5 in the paper
    boost_min: Annotated[Positive, Plausible(1e-3, 1.0, of="boost_max")]  # boost at the action -1
    boost_max: Annotated[Positive, Plausible(0.1, 20.0)]  # boost at the action 1
    drag: Annotated[NonNegative, Plausible(0.05, 50.0, "1/s")]
    pitch_speed_deg: Annotated[Positive, Plausible(5.0, 720.0, "deg/s")]
    yaw_speed_deg: Annotated[Positive, Plausible(5.0, 720.0, "deg/s")]
    roll_speed_deg: Annotated[Positive, Plausible(5.0, 720.0, "deg/s")]
    smooth_rate: Annotated[Positive, Plausible(0.1, 50.0, "1/s")]
    max_pitch_deg: Annotated[float, Field(gt=0, le=90), Plausible(5.0, 90.0, "deg")]
    max_roll_deg: Annotated[float, Field(gt=0, le=90), Plausible(5.0, 90.0, "deg")]
    roll_rule: Literal["script", "coordinated"]
    length: Annotated[Positive, Plausible(0.1, 50.0, "m")]
    span: Annotated[Positive, Plausible(0.2, 5.0, "m", of="length")]
    height: Annotated[Positive, Plausible(0.02, 1.5, "m", of="length")]
    collision_radius: Annotated[Positive, Plausible(0.2, 1.5, "m", of="span")]

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, span, height, m."""
        return self.length, self.span, self.height


class AircraftNumbers(NamedTuple):
    """Numbers of one aircraft that the kernel uses."""

    inverse_mass: Number  # 1/kg
    acceleration: Number  # at a boost of 1, m/s^2
    drag: Number  # 1/s
    roll_speed: Number  # at an increment of 1, rad/s
    pitch_speed: Number
    yaw_speed: Number
    smooth_rate: Number  # 1/s


@ti.data_oriented
class UnityAircraft(Aircraft):
    """Steps a team of aircraft in place. Actions pitch and yaw are in [-1, 1]; boost in [-1, 1] maps geometrically to
    [boost_min, boost_max], because cruise needs a small part of the range. Controls are the increments and the boost.

    The angles are state of their own (`aux_names`), because a quaternion cannot tell roll from yaw at a pitch of 90
    degrees. A force from outside accelerates the aircraft. A moment from outside has no effect, because the attitude is
    commanded.
    """

    Params = UnityAircraftParams
    action_names = ("pitch", "yaw", "boost")
    control_names = ("roll", "pitch", "yaw", "boost")
    aux_names = AUX
    aux_size = len(AUX)
    varying = ("mass", "thrust", "drag", "pitch_speed_deg", "yaw_speed_deg", "roll_speed_deg", "smooth_rate")

    def __init__(self, params: UnityAircraftParams, dt: float, substeps: int):
        """Take the parameters `params`, the step dt (s) and the substeps of a control step."""
        super().__init__(params, dt, substeps)
        self.p = params
        self.boost_ratio = params.boost_max / params.boost_min

    @property
    def limits(self) -> Limits:
        """The top speed, at which drag takes all the thrust."""
        p = self.p
        top = p.thrust_factor * p.thrust * p.boost_max / p.mass
        return Limits((0.0, 0.0, top / p.drag if p.drag else math.inf))

    def own(self, values: Mapping[str, Number]) -> AircraftNumbers:
        """The numbers of the kernel for `values`, by the keys of `varying`."""
        return AircraftNumbers(
            inverse_mass=1 / values["mass"],
            acceleration=self.p.thrust_factor * values["thrust"] / values["mass"],
            drag=values["drag"],
            roll_speed=values["roll_speed_deg"] * DEG,
            pitch_speed=values["pitch_speed_deg"] * DEG,
            yaw_speed=values["yaw_speed_deg"] * DEG,
            smooth_rate=values["smooth_rate"],
        )

    def boost_action(self, boost: float) -> float:
        """The action in [-1, 1] that commands `boost`."""
        return 2 * math.log(boost / self.p.boost_min) / math.log(self.boost_ratio) - 1

    def reset_aux(self, aux: Tensor, state: Tensor, around: Surroundings) -> None:
        """Set increments to zero and angles to those of `state`."""
        aux[..., INCREMENT : INCREMENT + 3] = 0.0
        aux[..., ANGLE : ANGLE + 3] = torch_euler_from_quaternion(state[..., QUATERNION])

    def build(self, fleet: Fleet, around: Surroundings) -> Build:
        """What the kernel is compiled for; sea and air do not matter."""
        return Build(varied=fleet.varied, loaded=fleet.loaded, width=lanes.width())

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance one control step."""
        with abreast.vectors():
            fleet.launch(self._step, fleet.pack, self.build(fleet, around))

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13] in the limit of short PhysX steps, with the increments held; the wind has no effect.

        The rates of `state` are ignored: the increments turn the attitude, and its acceleration is that of this
        rotation.
        """
        out = torch.empty_like(state)
        angles = torch_euler_from_quaternion(state[:, QUATERNION]).contiguous()
        self._rhs(out, state, angles, controls, load)
        return out

    @ti.kernel
    def _rhs(self, out: array2, state: array2, angles: array2, controls: array2, load: array2):
        for n in range(state.shape[0]):
            p = ti.static(self.constants)
            q = ti.Vector([state[n, 3], state[n, 4], state[n, 5], state[n, 6]])
            v_b = ti.Vector([state[n, 7], state[n, 8], state[n, 9]])
            tau = ti.Vector([load[n, 0], load[n, 1], load[n, 2]])
            angle = ti.Vector([angles[n, 0], angles[n, 1], angles[n, 2]])
            increment = ti.Vector([controls[n, 0], controls[n, 1], controls[n, 2]])
            rates = self.angle_rates(self.constants, angle, increment)
            omega, alpha = self.body_rates(angle, rates), self.body_accelerations(angle, rates)
            R = rotation_matrix(q)
            a_n = self.acceleration(self.constants, True, angle, controls[n, 3], tau)
            v_n, a_b = R @ v_b, R.transpose() @ a_n - p.drag * v_b - omega.cross(v_b)
            turning = quaternion_rate(q, omega)
            for k in ti.static(range(3)):
                out[n, k], out[n, 7 + k], out[n, 10 + k] = v_n[k], a_b[k], alpha[k]
            for k in ti.static(range(4)):
                out[n, 3 + k] = turning[k]

    @ti.kernel
    def _step(self, fleet: FleetPack, build: ti.template()):
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for g in range((fleet.state.shape[0] * fleet.state.shape[1] + build.width - 1) // build.width):
            e, i = group(build.width, g * build.width, fleet.state.shape[0], fleet.state.shape[1])
            y, command = taken(fleet.state, e, i, 0, 13), taken(fleet.action, e, i, 0, 3)
            increment, angles = taken(fleet.aux, e, i, INCREMENT, 3), taken(fleet.aux, e, i, ANGLE, 3)
            tau = load_at(build, fleet.load, e, i)
            start, rates = position_of(y), angles * 0.0
            y, increment, angles, rates = self.advance(
                own_numbers(self, build, fleet.numbers, e, i), build, y, increment, angles, command, tau
            )
            q = quaternion_from_euler(angles[0], angles[1], angles[2])
            R_nb = rotation_matrix(q)
            v = ti.Vector([y[7], y[8], y[9]])
            store(fleet.derived, e, i, R_nb, v)
            v_b, omega = R_nb.transpose() @ v, self.body_rates(angles, rates)
            move(fleet, e, i, start, position_of(y), [q[0], q[1], q[2], q[3]])
            put(fleet.state, e, i, SURGE, [v_b[0], v_b[1], v_b[2], omega[0], omega[1], omega[2]])
            put(fleet.aux, e, i, INCREMENT, [increment[0], increment[1], increment[2]])
            put(fleet.aux, e, i, ANGLE, [angles[0], angles[1], wrap_pi(angles[2])])

    @ti.func
    def advance(self, p: ti.template(), build: ti.template(), y, increment, angles, command, tau):
        """One control step: state (way since its beginning, velocity in n), increments, angles, and rates of the angles
        after it.
        """
        v = rotation_matrix(ti.Vector([y[3], y[4], y[5], y[6]])) @ ti.Vector([y[7], y[8], y[9]])
        boost = self.p.boost_min * fast_maths.exp(ti.static(0.5 * math.log(self.boost_ratio)) * (command[2] + 1.0))
        rates, way = angles * 0.0, v * 0.0
        for _ in range(self.substeps):
            a = self.acceleration(p, build.loaded, angles, boost, tau)
            increment = self.smoothed(p, increment, angles, command[0], command[1])
            turned = self.turned(p, angles, increment)
            rates = (turned - angles) / self.dt
            angles = turned
            v = (v + a * self.dt) * (1 - p.drag * self.dt)
            way += v * ti.static(self.dt)
        for k in ti.static(range(3)):
            y[k], y[7 + k] = way[k], v[k]
        return y, increment, angles, rates

    @ti.func
    def acceleration(self, p: ti.template(), loaded: ti.template(), angles, boost, tau):
        """Acceleration (m/s^2, n) by the thrust along the nose and, if `loaded`, by the load tau from outside (b)."""
        ahead, right, down = p.acceleration * boost, angles[0] * 0.0, angles[0] * 0.0
        if ti.static(loaded):
            sr, cr = fast_maths.sincos(angles[0])
            ahead += tau[0] * p.inverse_mass
            right = (cr * tau[1] - sr * tau[2]) * p.inverse_mass  # rotated by roll; pitch and yaw follow
            down = (sr * tau[1] + cr * tau[2]) * p.inverse_mass
        sp, cp = fast_maths.sincos(angles[1])
        sy, cy = fast_maths.sincos(angles[2])
        level = cp * ahead + sp * down
        return ti.Vector([cy * level - sy * right, sy * level + cy * right, cp * down - sp * ahead])

    @ti.func
    def smoothed(self, p: ti.template(), increment, angles, pitch, yaw):
        """Increments (roll, pitch, yaw) one step closer to the commands."""
        step = p.smooth_rate * self.dt
        roll = yaw - angles[0] / ti.static(self.p.max_roll_deg * DEG)
        if ti.static(self.p.roll_rule == "script"):
            roll = ti.select(yaw != 0.0, yaw, roll)
        wanted = ti.Vector([roll, pitch, yaw])
        return increment + ti.max(ti.min(wanted - increment, step), -step)

    @ti.func
    def turned(self, p: ti.template(), angles, increment):
        """Angles after one step, with pitch and roll clamped."""
        roll = angles[0] + increment[0] * (p.roll_speed * self.dt)
        pitch = angles[1] + increment[1] * (p.pitch_speed * self.dt)
        yaw = angles[2] + increment[2] * (p.yaw_speed * self.dt)
        max_roll, max_pitch = ti.static(self.p.max_roll_deg * DEG), ti.static(self.p.max_pitch_deg * DEG)
        return ti.Vector([ti.max(ti.min(roll, max_roll), -max_roll), ti.max(ti.min(pitch, max_pitch), -max_pitch), yaw])

    @ti.func
    def angle_rates(self, p: ti.template(), angles, increment):
        """Rates (rad/s) of the angles; zero where pitch and roll are clamped."""
        rates = ti.Vector([increment[0] * p.roll_speed, increment[1] * p.pitch_speed, increment[2] * p.yaw_speed])
        for k, most in ti.static(enumerate((self.p.max_roll_deg * DEG, self.p.max_pitch_deg * DEG))):
            if ti.abs(angles[k]) >= most and angles[k] * rates[k] > 0.0:
                rates[k] = 0.0
        return rates

    @ti.func
    def body_rates(self, angles, rates):
        """Angular velocity (rad/s) in b of Euler angles and their rates, z-y-x order (Fossen 2021, eq. 2.39)."""
        sr, cr = fast_maths.sincos(angles[0])
        sp, cp = fast_maths.sincos(angles[1])
        return ti.Vector(
            [
                rates[0] - sp * rates[2],
                cr * rates[1] + sr * cp * rates[2],
                -sr * rates[1] + cr * cp * rates[2],
            ]
        )

    @ti.func
    def body_accelerations(self, angles, rates):
        """Angular acceleration (rad/s^2) in b while the rates of the Euler angles are constant."""
        sr, cr = fast_maths.sincos(angles[0])
        sp, cp = fast_maths.sincos(angles[1])
        cross = rates[1] * rates[2]
        return ti.Vector(
            [
                -cp * cross,
                rates[0] * (cr * cp * rates[2] - sr * rates[1]) - sr * sp * cross,
                -rates[0] * (sr * cp * rates[2] + cr * rates[1]) - cr * sp * cross,
            ]
        )
