"""Classical control of `fixed_wing_6dof`: a field of velocities about the slot, flown through the wind.

Over ground (Beard & McLain 2012, ch. 10: a vector field that leads back to the path), with the error e = slot -
position along and aside of the velocity through the air, and evasion of near bodies (../avoidance.py):

    v* = v_s + sat(k e).

The velocity through the air is v_a = v - w (the wind triangle, ch. 2.4). The wind w, gusts included, is measured
velocity over ground minus measured velocity through the air. Then (v* - w) - v_a = v* - v in any wind, and the airspeed
demand

    V* = |v* - w|

holds the speed over ground. A coordinated turn of the course chi_a through the air, chi_a' = (g / V_a) tan phi
(ch. 9.2), follows the direction of v* - w, whose rate comes from the target's course rate:

    tan phi = (V_a / g) (chi_a*' + k_course (chi_a* - chi_a)).

k_course is the autopilot's own gain times `course`; at 1 aircraft evade later than avoidance counts on. A leader turns
back to its slot with at most leader_share of the bank, so that its followers can turn with it. The climb demand is the
slot's climb plus k_height times the height error; pitch follows as in the autopilot's own loop.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from rl.guidance.avoidance import AvoidanceGains, Avoider, SlotController
from rl.guidance.knowledge import Knowledge
from rl.guidance.targets_and_errors import approach, into, turning
from rl.team import ControllerError
from taichi_sim.config import Positive
from taichi_sim.kernels.conventions import DOWN, GRAVITY
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import READINGS, FixedWing6DOF
from taichi_sim.models.uav.fixed_wing.gains import ZETA, behind

BRAKING = 1.0  # m/s^2, deceleration along: less than the drag at idle throttle; assumed
EVADING = 1e-3  # m/s: less of a change by avoidance is rounding


class FixedWing6DofGains(AvoidanceGains):
    """Gains, tuned by taichi-sim tune on `aerosonde`."""

    acceleration: Positive = 3.0
    course: Positive = 1.0  # gain of the course loop, over the autopilot's
    bank_share: Positive = 0.5  # deceleration aside, as a share of the largest bank's acceleration
    leader_share: Positive = 0.5  # bank of a leader that returns to its slot from ahead, as a share of the largest
    closing_share: Positive = 0.3  # limit of what an error along adds, as a share of the range of airspeeds
    intercept_share: Positive = 0.7  # limit of what an error aside adds, as a share of cruise: about 35 deg


class FixedWing6DofController(SlotController):
    """Acts for a team of aircraft with an autopilot; it has no state."""

    Gains = FixedWing6DofGains
    gains: FixedWing6DofGains

    def __init__(self, model: FixedWing6DOF, gains: FixedWing6DofGains | None = None):
        """Compute gains from those of the autopilot: each loop is slower than the one within it (gains.behind).

        The course aside follows in 1 / `course`. The airspeed, under proportional and integral throttle, first follows
        in 1 / (2 ZETA omega) of that loop's frequency omega.

        Raises:
            ControllerError: if the aircraft is flown by its surfaces.
        """
        if model.actions == "surfaces":
            raise ControllerError(
                "there is no classical controller for a fixed_wing_6dof that is flown by its surfaces: it needs "
                'autopilot.actions = "guidance" or "altitude"'
            )
        self.gains = gains or FixedWing6DofGains()
        self.avoid = Avoider(self.gains)
        self.actions, self.loops, self.limits = model.actions, model.gains, model.autopilot_limits
        self.course = self.gains.course * model.gains.course
        self.k_aside = behind(1 / model.gains.course)
        self.k_along = behind(1 / (2 * ZETA * GRAVITY * model.gains.pitch_airspeed))
        self.side = GRAVITY * self.limits.tan_bank  # m/s^2 in the steepest bank
        low, cruise, high = self.limits.speeds
        self.closing, self.intercept = self.gains.closing_share * (high - low), self.gains.intercept_share * cruise

    def wanted(self, team: Knowledge) -> "FlightCommand":
        """The velocity command that leads to the slots, along and aside of the velocity through the air."""
        nose = self._way_flown(velocity_through_air(team))[1]
        slot, now, climb = team.now.slot_velocity, team.now, self.limits.climb
        (along, aside), (along_rate, aside_rate) = (into(x[..., :2], nose) for x in (now.error, now.error_rate))
        x, x_rate = _chase(along, along_rate, self.k_along, BRAKING, self.closing)
        y, y_rate = _chase(aside, aside_rate, self.k_aside, self.gains.bank_share * self.side, self.intercept)
        north, east = into(torch.stack((x, y), dim=-1), (nose[0], -nose[1]))
        down = (self.loops.height * now.error[..., DOWN]).clamp(-climb, climb)
        direct = slot + torch.stack((north, east, down), dim=-1)
        velocity = self.avoid(team, direct)
        return FlightCommand(velocity, (x_rate, y_rate), (velocity - direct).norm(dim=-1) > EVADING)

    def act(self, team: Knowledge, wanted: "FlightCommand") -> Tensor:
        """Actions [env, vehicle, (pitch or climb, yaw, boost)] in [-1, 1].

        They are 0 where they would be NaN, as for a state that is not finite.
        """
        v, air = team.fleet.velocity_n, velocity_through_air(team)
        flown = air[..., :2]
        level, nose = self._way_flown(air)
        to_fly = wanted.velocity[..., :2] - (v[..., :2] - flown)
        climb = (-wanted.velocity[..., DOWN]).clamp(-self.limits.climb, self.limits.climb)
        if self.actions == "altitude":
            pitch = climb / self.limits.climb
        else:
            through_air = climb + self.loops.climb * (climb + v[..., DOWN])
            pitch = through_air / air.norm(dim=-1).clamp(min=self.limits.floor) / self.limits.sin_pitch
        turn = level / self.side * self._turn_rate(team, wanted, into(to_fly, nose), nose, self.side / level)
        action = torch.stack((pitch, turn, self._boost(to_fly.norm(dim=-1))), dim=-1)
        return torch.nan_to_num(action).clamp(-1.0, 1.0)

    def _way_flown(self, air: Tensor) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Level speed (m/s) and (cos, sin) of the course of a velocity `air` [.., 3]."""
        level, (north, east, _) = air[..., :2].norm(dim=-1).clamp(min=self.limits.floor), air.unbind(-1)
        return level, (north / level, east / level)

    def _turn_rate(self, team: Knowledge, wanted: "FlightCommand", to_fly, nose, most: Tensor) -> Tensor:
        """Rate (rad/s) of the course that follows `to_fly` (along, aside); `most` in the steepest turn."""
        x, y = to_fly
        square = (x * x + y * y).clamp(min=self.limits.floor**2)
        slot_x, slot_y = into(turning(team.target, team.now.slot_velocity)[..., :2], nose)
        steady = torch.where(wanted.evading, 0.0, (x * slot_y - y * slot_x) / square)
        chasing = torch.where(wanted.evading, 0.0, (x * wanted.change[1] - y * wanted.change[0]) / square)
        back = chasing + self.course * torch.atan2(y, x)
        limit = 2 * most  # from one bank to the other
        limit[:, 0] = torch.where(wanted.evading | (x < 0), limit, self.gains.leader_share * most)[:, 0]
        return steady + torch.minimum(torch.maximum(back, -limit), limit)

    def _boost(self, airspeed: Tensor) -> Tensor:
        """The action that demands `airspeed` (m/s)."""
        low, cruise, high = self.limits.speeds
        over = airspeed - cruise
        return torch.where(over > 0, over / (high - cruise), over / (cruise - low))


class FlightCommand(NamedTuple):
    """The velocity command of each vehicle, [env, vehicle]."""

    velocity: Tensor  # [.., 3] v*, NED, m/s
    change: tuple[Tensor, Tensor]  # rate of what the error adds to it, along and aside, m/s^2
    evading: Tensor  # bool: avoidance has changed it


def velocity_through_air(team: Knowledge) -> Tensor:
    """Velocity through the air [env, vehicle, 3] (m/s, NED), of the airspeed and the angles the aircraft measures."""
    Va, alpha, beta = team.fleet.aux[..., READINGS : READINGS + 3].unbind(-1)
    level = Va * beta.cos()
    v_b = torch.stack((level * alpha.cos(), Va * beta.sin(), level * alpha.sin()), dim=-1)
    return (team.fleet.R_nb * v_b.unsqueeze(-2)).sum(-1)  # a product of small matrices is slower


def _chase(error: Tensor, rate: Tensor, gain: float, acceleration: float, most: float) -> tuple[Tensor, Tensor]:
    """Velocity (m/s) that reduces `error` (m), at most `most`, and its rate where it is linear (m/s^2)."""
    velocity = approach(error, gain, acceleration).clamp(-most, most)
    linear = gain * error.abs() <= min(most, 2 * acceleration / gain)
    return velocity, torch.where(linear, gain * rate, 0.0)
