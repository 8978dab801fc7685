"""Set points: how the actions of a policy reach an autopilot.

| a policy whose actions are | order | the autopilot's mode |
|---|---|---|
| corrections of a velocity command, of vessels (../guidance/residual.py); or of course and speed, of an encounter |
  SET_POSITION_TARGET_LOCAL_NED | GUIDED |
| velocity and yaw rate, of a multirotor | SET_POSITION_TARGET_LOCAL_NED | GUIDED |
| thrust and yaw, or both shafts, of a hull with two propellers | MANUAL_CONTROL, throttle and steering | MANUAL |

ArduPilot's Rover makes heading and speed of a velocity (GCS_MAVLink_Rover.cpp). A Copter takes velocities ahead, to
starboard and down of its own heading. In MANUAL, a skid-steered boat adds
steering to the throttle of its left propeller and takes it from that of its right one (mode.cpp, AP_MotorsUGV.cpp); so

    throttle = (left + right) / 2,    steering = (left - right) / 2

of the shares of the propellers' greatest speeds, which the action commands by the vehicle file. It needs `PARAMETERS`.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from rl.adapters.pilot.autopilot_link import AUTOPILOT, Link
from rl.adapters.pilot.laid_course import LaidCourse
from rl.guidance.controllers.vessel import shaft
from rl.guidance.residual import CORRECTIONS
from rl.team import Team
from taichi_sim.config import ConfigError
from taichi_sim.models.uav.multirotor.controller import VELOCITY_ACTIONS
from taichi_sim.models.uav.multirotor.params import Control, MultirotorParams
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof

Array = NDArray[np.float64]
BOAT = {11: "a boat"}  # MAV_TYPE of a Rover with FRAME_CLASS 2
COPTERS = {2: "a quadrotor", 13: "a hexarotor", 14: "an octorotor", 15: "a tricopter", 29: "a dodecarotor"}
ROVER_MODES = {0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW", 7: "SIMPLE", 8: "DOCK",
               9: "CIRCLE", 10: "AUTO", 11: "RTL", 12: "SMART_RTL", 15: "GUIDED", 16: "INITIALISING"}  # fmt: skip
COPTER_MODES = {0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE",
                9: "LAND", 16: "POSHOLD", 17: "BRAKE", 21: "SMART_RTL"}  # fmt: skip
"""Of ArduPilot, by number (HEARTBEAT.custom_mode)."""
LOCAL_NED, BODY_OFFSET_NED = 1, 9  # MAV_FRAME
VELOCITY_ALONE, WITH_YAW, WITH_YAW_RATE = 0b110111000111, 0b100111000111, 0b010111000111
"""POSITION_TARGET_TYPEMASK, what is ignored: of a velocity, one with a heading, one with a rate of it."""
FULL, NO_AXIS = 1000, 0x7FFF  # MANUAL_CONTROL: a full deflection; an axis that is given back
PARAMETERS = {
    "RCMAP_ROLL": 1, "RCMAP_THROTTLE": 3, "RC1_DZ": 0, "RC3_DZ": 0, "PILOT_STEER_TYPE": 3, "MANUAL_STR_EXPO": 0,
    "MOT_SLEWRATE": 0, "MOT_THST_EXPO": 0,
}  # fmt: skip
"""With which throttle and steering reach the propellers as they are: no dead zone, no curve, no limited rate, steering
to the same side astern."""


class Orders(Protocol):
    """How one kind of actions reaches an autopilot.

    Attributes:
        mode: ArduPilot's number of the mode in which orders are obeyed. modes: number -> name. station: whether orders
            must come from the ground station. kinds: MAV_TYPE -> name, of vehicles that obey. parameters: name -> value
            that they need.
    """

    mode: int
    modes: Mapping[int, str]
    station: bool
    kinds: Mapping[int, str]
    parameters: Mapping[str, float]

    def of(self, team: Team, taken: torch.Tensor, laid: LaidCourse) -> Array:
        """Orders [vehicle, n], of the actions `taken` [1, vehicle, action] that the team takes."""
        ...

    def give(self, link: Link, order: Array) -> None:
        """Send the order [n] of one vehicle."""
        ...

    def stop(self, link: Link, down: float) -> None:
        """Order a vehicle to stop, but for a velocity `down` (m/s), if it flies."""
        ...

    def release(self, link: Link) -> None:
        """Leave a vehicle to whom it obeys now."""
        ...


class Velocity:
    """Velocity over ground [vehicle, 2] (m/s), in GUIDED."""

    mode, station = 15, False
    modes: Mapping[int, str] = ROVER_MODES
    kinds: Mapping[int, str] = BOAT
    parameters: Mapping[str, float] = {}

    def of(self, team: Team, taken: torch.Tensor, laid: LaidCourse) -> Array:
        """The velocity command as the policy has corrected it."""
        assert team.ordered is not None, "a policy that corrects nothing"
        return laid.over_sea(team.ordered[0, :, :2].double().cpu().numpy())

    def give(self, link: Link, order: Array) -> None:
        """Send a velocity."""
        velocity_target(link, LOCAL_NED, VELOCITY_ALONE, (*order, 0.0))

    def stop(self, link: Link, down: float) -> None:
        """Send no speed, on the present heading: without one, a Rover would turn to the north."""
        if link.attitude is not None:
            velocity_target(link, LOCAL_NED, WITH_YAW, (0.0, 0.0, 0.0), yaw=link.attitude.euler[2])

    def release(self, link: Link) -> None:
        """Send nothing."""


class HeadingVelocity:
    """Velocity ahead, to starboard and down (m/s), and rate of the heading (rad/s) [vehicle, 4], in GUIDED."""

    mode, station = 4, False
    modes: Mapping[int, str] = COPTER_MODES
    kinds: Mapping[int, str] = COPTERS
    parameters: Mapping[str, float] = {}

    def __init__(self, control: Control):
        """Take what actions of 1 command."""
        self.control = control

    def of(self, team: Team, taken: torch.Tensor, laid: LaidCourse) -> Array:
        """What the actions command (taichi_sim/models/uav/multirotor/controller.py)."""
        c, action = self.control, taken[0].double().cpu().numpy()
        vertical = np.where(action[:, 2] > 0, c.descent, c.climb)
        most = np.column_stack([np.full(len(action), x) for x in (c.speed, c.speed, 0.0, np.radians(c.yaw_rate_deg))])
        most[:, 2] = vertical
        return action * most

    def give(self, link: Link, order: Array) -> None:
        """Send velocity and rate."""
        velocity_target(link, BODY_OFFSET_NED, WITH_YAW_RATE, tuple(order[:3]), yaw_rate=order[3])

    def stop(self, link: Link, down: float) -> None:
        """Order it to stay where it is, or to rise or sink there."""
        velocity_target(link, BODY_OFFSET_NED, WITH_YAW_RATE, (0.0, 0.0, down))

    def release(self, link: Link) -> None:
        """Send nothing."""


def velocity_target(
    link: Link, frame: int, mask: int, velocity: Sequence[float], *, yaw: float = 0.0, yaw_rate: float = 0.0
) -> None:
    """Send a velocity [3] (m/s) in a MAV_FRAME, and what else the `mask` lets through."""
    link.say("set_position_target_local_ned", 0, link.system, AUTOPILOT, frame, mask, 0, 0, 0, *velocity, 0, 0, 0, yaw,
             yaw_rate)  # fmt: skip


class Sticks:
    """Throttle and steering [vehicle, 2] in [-1, 1], in MANUAL."""

    mode, station = 0, True
    modes: Mapping[int, str] = ROVER_MODES
    kinds: Mapping[int, str] = BOAT
    parameters: Mapping[str, float] = PARAMETERS

    def __init__(self, model: Hull6Dof):
        """Take the propellers of a vehicle."""
        self.thrusters, self.both = model.params.thrusters, model.params.actions == "left_right"

    def of(self, team: Team, taken: torch.Tensor, laid: LaidCourse) -> Array:
        """Throttle and steering of the speeds that the actions command."""
        first, second = taken[0].double().cpu().unbind(-1)
        if self.both:
            left, right = first, second
        else:
            t = self.thrusters
            surge, yaw = 0.5 * (first + 1.0) * t.thrust_max, 0.5 * second * (t.thrust_max - t.thrust_min)
            left, right = (shaft(t, x.clamp(t.thrust_min, t.thrust_max)) for x in (surge + yaw, surge - yaw))
        return torch.stack((0.5 * (left + right), 0.5 * (left - right)), dim=-1).numpy()

    def give(self, link: Link, order: Array) -> None:
        """Send throttle and steering."""
        throttle, steering = (round(FULL * float(x)) for x in order)
        self._send(link, steering, throttle)

    def stop(self, link: Link, down: float) -> None:
        """Send both in the middle. The autopilot gives the sticks back after RC_OVERRIDE_TIME."""
        self._send(link, 0, 0)

    def release(self, link: Link) -> None:
        """Give the sticks back at once."""
        self._send(link, NO_AXIS, NO_AXIS)

    @staticmethod
    def _send(link: Link, steering: int, throttle: int) -> None:
        link.say("manual_control", link.system, NO_AXIS, steering, throttle, NO_AXIS, 0)


def orders_of(team: Team) -> Orders:
    """The orders for a team's actions."""
    model, names = team.fleet.model, team.action_names
    if model.medium == "water" and (names == CORRECTIONS or team.ordered is not None):
        return Velocity()
    if isinstance(model, Hull6Dof) and model.params.thrusters and model.params.actions in ("surge_yaw", "left_right"):
        return Sticks(model)
    if model.action_names == VELOCITY_ACTIONS and isinstance(model.params, MultirotorParams):
        return HeadingVelocity(model.params.control)
    raise ConfigError(
        f"{team.name}: a companion has no set points for the actions {', '.join(names)} of a {type(model).__name__}: "
        "it sends velocities of vessels, thrust and yaw of a hull with two propellers, and velocities of "
        "multirotors (docs/pilot.md)"
    )
