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

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.guidance.avoidance import AvoidanceGains, Avoider, SlotController
from rl.guidance.controllers.laws import approach, cross, limited, swung
from rl.guidance.knowledge import Knowledge, KnownPack, TeamKernel
from rl.guidance.targets_and_errors import COURSE_RATE, ERROR, ERROR_RATE, SLOT_VELOCITY, row_of
from rl.guidance.targets_and_errors import V as VELOCITY
from rl.team import ControllerError
from taichi_sim.config import Positive
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import DOWN, EAST, GRAVITY, NORTH
from taichi_sim.kernels.packs import values_at
from taichi_sim.kernels.runtime import array3
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import READINGS, FixedWing6DOF
from taichi_sim.models.uav.fixed_wing.gains import ZETA, behind

BRAKING = 1.0  # m/s^2, deceleration along: less than the drag at idle throttle; assumed
EVADING = 1e-3  # m/s: less of a change by avoidance is rounding
CHANGE = 3  # column of the rate, behind the velocity


class FixedWing6DofGains(AvoidanceGains):
    """Gains, tuned by taichi-sim tune on `aerosonde`."""

    acceleration: Positive = 3.0
    course: Positive = 1.0  # gain of the course loop, over the autopilot's
    bank_share: Positive = 0.5  # deceleration aside, as a share of the largest bank's acceleration
    leader_share: Positive = 0.5  # bank of a leader that returns to its slot from ahead, as a share of the largest
    closing_share: Positive = 0.3  # limit of what an error along adds, as a share of the range of airspeeds
    intercept_share: Positive = 0.7  # limit of what an error aside adds, as a share of cruise: about 35 deg


class FlightCommand(NamedTuple):
    """The velocity command of each vehicle."""

    velocity: Tensor  # [env, vehicle, 3] v*, NED, m/s
    change: Tensor  # [env, vehicle, 2] rate of what the error adds to it, NED, m/s^2
    evading: Tensor  # [env, vehicle, 1]: 1 where avoidance has changed it, else 0


@ti.func
def velocity_through_air(aux: ti.template(), known: ti.template(), e, i):
    """Velocity (NED, m/s) through the air, of the airspeed and the angles that aircraft i of environment e measures."""
    Va, alpha, beta = aux[e, i, READINGS], aux[e, i, READINGS + 1], aux[e, i, READINGS + 2]
    level, R = Va * ti.cos(beta), taken(known.derived, e, i, 0, 9)  # R_nb by rows
    v = ti.Vector([level * ti.cos(alpha), Va * ti.sin(beta), level * ti.sin(alpha)])
    return ti.Vector([R[3 * a] * v[0] + R[3 * a + 1] * v[1] + R[3 * a + 2] * v[2] for a in ti.static(range(3))])


@ti.func
def level_flight(air, floor):
    """Level speed (m/s, at least `floor`) of a velocity through the air, and the unit vector of its course."""
    speed = ti.max(ti.sqrt(air[NORTH] * air[NORTH] + air[EAST] * air[EAST]), floor)
    return speed, ti.Vector([air[NORTH] / speed, air[EAST] / speed])


@ti.func
def along_aside(v, nose):
    """Parts of v (NED) along the unit vector `nose` and to starboard of it."""
    return nose[NORTH] * v[NORTH] + nose[EAST] * v[EAST], cross(nose, v)


@ti.func
def chase(error, rate, gain, acceleration, most):
    """Velocity (m/s) that reduces `error` (m), at most `most`, and its rate where it is linear (m/s^2)."""
    velocity = limited(approach(error, gain, acceleration), -most, most)
    linear = gain * ti.abs(error) <= ti.min(most, 2.0 * acceleration / gain)
    return velocity, ti.select(linear, gain * rate, 0.0)


@ti.kernel
def _lead(direct: array3, aux: array3, known: KnownPack, kind: ti.template(), form: ti.template()):
    """Write the velocity [env, vehicle, 3] that leads to the slots, and the rate [.., 2] of what the error adds."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(direct.shape[0], direct.shape[1]):
        g = values_at(kind, known.numbers)
        _, nose = level_flight(velocity_through_air(aux, known, e, i), g.floor)
        error = taken(known.table, e, i, ERROR, 3)
        along, aside = along_aside(error, nose)
        along_rate, aside_rate = along_aside(taken(known.table, e, i, ERROR_RATE, 3), nose)
        x, x_rate = chase(along, along_rate, g.k_along, BRAKING, g.closing)
        y, y_rate = chase(aside, aside_rate, g.k_aside, g.braking_aside, g.intercept)
        slot, back = taken(known.table, e, i, SLOT_VELOCITY, 3), ti.Vector([nose[NORTH], -nose[EAST]])
        north, east = along_aside(ti.Vector([x, y]), back)
        rate_north, rate_east = along_aside(ti.Vector([x_rate, y_rate]), back)
        direct[e, i, NORTH], direct[e, i, EAST] = slot[NORTH] + north, slot[EAST] + east
        direct[e, i, DOWN] = slot[DOWN] + limited(g.k_height * error[DOWN], -g.climb, g.climb)
        direct[e, i, CHANGE], direct[e, i, CHANGE + 1] = rate_north, rate_east


@ti.kernel
def _fly(
    action: array3, velocity: array3, change: array3, evading: array3, aux: array3, known: KnownPack,
    kind: ti.template(), form: ti.template(),
):  # fmt: skip
    """Write the actions (pitch or climb, yaw, boost) that follow a command; see the module."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(action.shape[0], action.shape[1]):
        g = values_at(kind, known.numbers)
        v, air = taken(known.derived, e, i, VELOCITY, 3), velocity_through_air(aux, known, e, i)
        level, nose = level_flight(air, g.floor)
        to_fly = ti.Vector([velocity[e, i, a] - (v[a] - air[a]) for a in ti.static(range(2))])
        climb = limited(-velocity[e, i, DOWN], -g.climb, g.climb)
        pitch = climb / g.climb
        if g.by_pitch > 0.0:
            pitch = (climb + g.k_climb * (climb + v[DOWN])) / ti.max(air.norm(), g.floor) / g.sin_pitch

        x, y = along_aside(to_fly, nose)
        square, most = ti.max(x * x + y * y, g.floor * g.floor), g.side / level
        slot = swung(taken(known.table, e, i, SLOT_VELOCITY, 3), known.target[e, row_of(known.target, i), COURSE_RATE])
        steady, chasing = cross(to_fly, slot) / square, cross(to_fly, taken(change, e, i, NORTH, 2)) / square
        evades = evading[e, i, 0] > 0.0
        back = ti.select(evades, 0.0, chasing) + g.course * ti.atan2(y, x)
        limit = ti.select(i > 0 or evades or x < 0.0, 2.0, g.leader_share) * most  # 2: from one bank to the other
        turn = ti.select(evades, 0.0, steady) + limited(back, -limit, limit)

        airspeed = ti.sqrt(to_fly[0] * to_fly[0] + to_fly[1] * to_fly[1])
        over = airspeed - g.cruise
        action[e, i, 0], action[e, i, 1] = pitch, turn / most
        action[e, i, 2] = over / ti.select(over > 0.0, g.high - g.cruise, g.cruise - g.low)


class FixedWing6DofController(SlotController):
    """Acts for a team of aircraft with an autopilot; it has no state."""

    Gains = FixedWing6DofGains
    gains: FixedWing6DofGains

    def __init__(self, model: FixedWing6DOF, gains: FixedWing6DofGains | None = None):
        """Compute gains from those of the autopilot: each loop is slower than the one within it (gains.behind).

        The course aside follows in 1 / `course`. The airspeed, under proportional and integral throttle, first follows
        in 1 / (2 ZETA omega) of that loop's frequency omega.
        """
        if model.actions == "surfaces":
            raise ControllerError(
                "there is no classical controller for a fixed_wing_6dof that is flown by its surfaces: it needs "
                'autopilot.actions = "guidance" or "altitude"'
            )
        self.gains = gains or FixedWing6DofGains()
        self.avoid, limits = Avoider(self.gains), model.autopilot_limits
        low, cruise, high = limits.speeds
        side = GRAVITY * limits.tan_bank  # m/s^2 in the steepest bank
        numbers = {
            "floor": limits.floor, "low": low, "cruise": cruise, "high": high, "climb": limits.climb,
            "sin_pitch": limits.sin_pitch, "by_pitch": float(model.actions == "guidance"),
            "k_along": behind(1 / (2 * ZETA * GRAVITY * model.gains.pitch_airspeed)),
            "k_aside": behind(1 / model.gains.course), "k_height": model.gains.height, "k_climb": model.gains.climb,
            "course": self.gains.course * model.gains.course, "side": side,
            "braking_aside": self.gains.bank_share * side, "leader_share": self.gains.leader_share,
            "closing": self.gains.closing_share * (high - low), "intercept": self.gains.intercept_share * cruise,
        }  # fmt: skip
        self._lead, self._fly = TeamKernel(_lead, numbers), TeamKernel(_fly, numbers)

    def wanted(self, team: Knowledge) -> FlightCommand:
        """The velocity command that leads to the slots, along and aside of the velocity through the air."""
        return self.evaded(team, self._lead(team, CHANGE + 2, team.fleet.aux))

    def evaded(self, team: Knowledge, led: Tensor) -> FlightCommand:
        """The command that keeps clear of bodies, of `led` [env, vehicle, 5]: a velocity, and its rate (`change`)."""
        direct = led[..., :CHANGE]
        velocity = self.avoid(team, direct)
        evading = (velocity - direct).norm(dim=-1, keepdim=True) > EVADING
        return FlightCommand(velocity, led[..., CHANGE:], evading.to(led.dtype))

    def act(self, team: Knowledge, wanted: FlightCommand) -> Tensor:
        """Actions [env, vehicle, (pitch or climb, yaw, boost)] in [-1, 1].

        They are 0 where they would be NaN, as for a state that is not finite.
        """
        return torch.nan_to_num(self._fly(team, 3, *wanted, team.fleet.aux)).clamp(-1.0, 1.0)
