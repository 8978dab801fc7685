"""`unity_aircraft`: the UAV of the seed paper (sec. 3.2), a kinematic attitude and one force along the nose.

Smoothed increments of pitch, yaw and roll move toward their commands by `smooth_rate` dt per step, and each angle
advances by increment x dt x speed (eqs 7-9; speed 100 deg/s). Pitch and roll are clamped. The force
thrust_factor T a acts along the nose as it was before the step's rotation; PhysX integrates
v <- (v + F/m dt) (1 - drag dt), x <- x + v dt. No gravity, no lift: with these rules attitude is the control.

The paper lists pitch, yaw and boost as actions, so roll follows from yaw, by one of two rules:
- "script", the public one: the roll command is minus the yaw command, or levels (-roll / max_roll) when the yaw
  command is exactly zero, which a continuous policy never commands;
- "coordinated" (default): bank command + yaw - roll / max_roll levels and banks at once; at the script's three
  yaw values -1, 0, 1 it starts and ends alike.
Roll does not turn the nose, so the choice changes what one sees, not the path.

Signs here are forward-right-down: pitch up, yaw right and bank right are positive (Unity: nose down, right, left).
"""

from typing import Annotated, Literal

import taichi as ti
import torch
from pydantic import Field

from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.kinematics import store
from taichi_sim.maths import fast
from taichi_sim.maths.rotation import (
    quaternion_from_euler,
    rotation_matrix,
    torch_euler_from_quaternion,
    wrap_pi,
)
from taichi_sim.surroundings import Surroundings

DEG = 0.017453292519943295


class UnityAircraftParams(Strict):
    """Numbers of configs/vehicles/unity_aircraft.toml."""

    mass: Positive  # kg
    thrust: Positive  # T, N
    thrust_factor: Positive  # 2.5 in the paper
    boost_min: Positive  # the action -1
    boost_max: Positive  # the action 1
    drag: NonNegative  # 1/s
    pitch_speed_deg: Positive  # deg/s
    yaw_speed_deg: Positive  # deg/s
    roll_speed_deg: Positive  # deg/s
    smooth_rate: Positive  # 1/s
    max_pitch_deg: Annotated[float, Field(gt=0, le=90)]
    max_roll_deg: Annotated[float, Field(gt=0, le=90)]
    roll_rule: Literal["script", "coordinated"]
    length: Positive  # m
    span: Positive  # m
    height: Positive  # m
    collision_radius: Positive  # m

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, span, height, m."""
        return self.length, self.span, self.height


@ti.data_oriented
class UnityAircraft:
    """Steps a team of aircraft in place.

    Auxiliary state [env, vehicle, 6]: smoothed increments of roll, pitch, yaw (in [-1, 1]) and the angles roll,
    pitch, yaw (rad), which are state here: a quaternion cannot tell them apart at a pitch of 90 degrees.
    """

    team = "uav"
    aux_size = 6
    action_names = ("pitch", "yaw", "boost")
    Params = UnityAircraftParams

    def __init__(self, params: UnityAircraftParams, dt: float, substeps: int):
        """Bake the numbers of `params`, the step dt (s) and the substeps of a control step into the kernel."""
        self.params = params
        self.dt, self.substeps = dt, substeps
        self.p = params
        self.boost_ratio = params.boost_max / params.boost_min

    def step(self, team, action: torch.Tensor, around: Surroundings) -> None:
        """Advance one control step. `action` [env, vehicle, 3]: pitch and yaw in [-1, 1]; boost in [-1, 1] maps
        geometrically to [boost_min, boost_max], because cruise needs a small part of the range.
        """
        self._step(team.state, team.derived, team.aux, action)

    def boost_action(self, boost: float) -> float:
        """The action in [-1, 1] that commands `boost`."""
        import math

        return 2 * math.log(boost / self.p.boost_min) / math.log(self.boost_ratio) - 1

    def reset_aux(self, aux: torch.Tensor, state: torch.Tensor) -> None:
        """Auxiliary state [.., 6] of vehicles put at `state` [.., 13]."""
        aux[..., :3] = 0.0
        aux[..., 3:] = torch_euler_from_quaternion(state[..., 3:7])

    @ti.kernel
    def _step(
        self,
        state: ti.types.ndarray(ndim=3),
        derived: ti.types.ndarray(ndim=3),
        aux: ti.types.ndarray(ndim=3),
        action: ti.types.ndarray(ndim=3),
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            pos = ti.Vector([state[e, i, 0], state[e, i, 1], state[e, i, 2]])
            q = ti.Vector([state[e, i, 3], state[e, i, 4], state[e, i, 5], state[e, i, 6]])
            v = rotation_matrix(q) @ ti.Vector([state[e, i, 7], state[e, i, 8], state[e, i, 9]])
            smooth = ti.Vector([aux[e, i, 0], aux[e, i, 1], aux[e, i, 2]])
            angles = ti.Vector([aux[e, i, 3], aux[e, i, 4], aux[e, i, 5]])
            boost = self.p.boost_min * ti.pow(self.boost_ratio, 0.5 * (action[e, i, 2] + 1.0))
            force = ti.static(self.p.thrust_factor * self.p.thrust) * boost
            rates = angles * 0.0
            for _ in range(self.substeps):
                nose = self.nose(angles)
                smooth = self.smoothed(smooth, angles, action[e, i, 0], action[e, i, 1])
                turned = self.turned(angles, smooth)
                rates = (turned - angles) / self.dt
                angles = turned
                v = (v + force / self.p.mass * self.dt * nose) * ti.static(1 - self.p.drag * self.dt)
                pos += v * ti.static(self.dt)
            q = quaternion_from_euler(angles[0], angles[1], angles[2])
            R_nb = rotation_matrix(q)
            store(derived, e, i, R_nb, v)
            v_b = R_nb.transpose() @ v
            omega = self.body_rates(angles, rates)
            for k in ti.static(range(3)):
                state[e, i, k], state[e, i, 7 + k], state[e, i, 10 + k] = pos[k], v_b[k], omega[k]
                aux[e, i, k], aux[e, i, 3 + k] = smooth[k], angles[k]
            aux[e, i, 5] = wrap_pi(angles[2])
            for k in ti.static(range(4)):
                state[e, i, 3 + k] = q[k]

    @ti.func
    def smoothed(self, smooth, angles, pitch, yaw):
        """Increments (roll, pitch, yaw) one step closer to the commands."""
        step = ti.static(self.p.smooth_rate * self.dt)
        roll = yaw - angles[0] / ti.static(self.p.max_roll_deg * DEG)
        if ti.static(self.p.roll_rule == "script"):
            if yaw != 0.0:
                roll = yaw
        command = ti.Vector([roll, pitch, yaw])
        return smooth + ti.max(ti.min(command - smooth, step), -step)

    @ti.func
    def turned(self, angles, smooth):
        """Angles after one step; pitch and roll clamped."""
        step = ti.static(self.dt * DEG)
        roll = angles[0] + smooth[0] * step * self.p.roll_speed_deg
        pitch = angles[1] + smooth[1] * step * self.p.pitch_speed_deg
        yaw = angles[2] + smooth[2] * step * self.p.yaw_speed_deg
        max_roll, max_pitch = ti.static(self.p.max_roll_deg * DEG), ti.static(self.p.max_pitch_deg * DEG)
        return ti.Vector([ti.max(ti.min(roll, max_roll), -max_roll), ti.max(ti.min(pitch, max_pitch), -max_pitch), yaw])

    @ti.func
    def nose(self, angles):
        """Unit vector of the nose in n."""
        sp, cp = fast.sincos(angles[1])
        sy, cy = fast.sincos(angles[2])
        return ti.Vector([cp * cy, cp * sy, -sp])

    @ti.func
    def body_rates(self, angles, rates):
        """Angular velocity (rad/s) in b of Euler angles and their rates, z-y-x order (Fossen 2021, eq. 2.39)."""
        sr, cr = fast.sincos(angles[0])
        sp, cp = fast.sincos(angles[1])
        return ti.Vector(
            [
                rates[0] - sp * rates[2],
                cr * rates[1] + sr * cp * rates[2],
                -sr * rates[1] + cr * cp * rates[2],
            ]
        )
