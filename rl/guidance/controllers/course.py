"""Track control of a displacement vessel with surge force X and yaw moment N: loads that follow the slot.

Over ground, with the error e = slot - position, the drift z (`Drift`), and evasion (../avoidance.py) of what is near:

    v* = v_s + sat(k_e e) + z,   v*' = chi' x v_s + k_e (v_s - v).

The slot's velocity v_s is that of the formation (the target's, plus the swing about the leader). The leader's measured
velocity also contains its motion in waves, which a follower would chase in vain. Speed, where u* is the part of v*
along the nose and a the waves' push:

    X = m11 (v*'_x + k_u (u* - u) - a_x) + d_u(u*).

The nose follows the direction chi* of v*, turned inwards by the drift angle beta of a steady turn at the target's rate.
It leads further (`lead`, vessel.py) where the course is slow to follow:

    r* = (v*'_y - wave_share a_y) / |v*| + approach(chi* + beta - psi + lead (chi* - chi)),
    N = m33 k_r (r* - r) + d_r(r*).

Waves: the hull floats on the water's slope, so its tilt measures a = -g (R_nb e_3)_{n,e}. Thrust cancels the part along
the nose. Only a turn can cancel the part to starboard, and a turn in every wave costs moment and thrust that steering
needs: wave_share is small. The heading is fed back and not the course over ground, which contains the sway in waves.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from rl.guidance.avoidance import Avoider
from rl.guidance.controllers.force_vector import approach, to_starboard, turning, wrap
from rl.guidance.controllers.vessel import CourseGains, VesselDynamics, loops
from rl.guidance.knowledge import Knowledge
from taichi_sim.conventions import GRAVITY

SPEED_SHARE = 0.95  # largest desired speed, as a share of the top speed; assumed
LEAST_SHARE = 0.1  # a shorter velocity has no direction to follow; share of the top speed; assumed
RATE_SHARE = 0.9  # largest desired yaw rate, as a share of the top yaw rate; assumed
COURSE_TIME = 8.0  # s of the integral of the course error; assumed
COURSE_ERROR = 0.5  # sine of the course error: larger ones are turns; assumed
DRIFT_SHARE = 0.2  # of the top speed, the greatest drift; assumed
EVADING = 1e-3  # m/s: less of a change by avoidance is rounding


class Load(NamedTuple):
    """Loads demanded of the actuators, without limits, each [env, vehicle]."""

    X: Tensor  # N
    Y: Tensor  # N, for vessels that can push to the side
    N: Tensor  # N m


class CourseCommand(NamedTuple):
    """The velocity command, each [env, vehicle, 2], NED."""

    velocity: Tensor  # v*, m/s
    change: Tensor  # v*', m/s^2


Way = CourseCommand  # its earlier name


class Course:
    """Computes the loads for a team of one kind of vessel; its only state is the drift."""

    STATE = ("drift",)

    def __init__(self, vessel: VesselDynamics, gains: CourseGains, interval: float):
        """Compute what follows from the `gains` for decisions every `interval` s."""
        self.vessel, self.interval, self.gains = vessel, interval, gains
        self.loops, self.avoid = loops(vessel, gains, interval), Avoider(gains)
        self.drift = Drift(self.loops.k_i, vessel.top_speed, interval)
        self.top_speed, self.least_speed = SPEED_SHARE * vessel.top_speed, LEAST_SHARE * vessel.top_speed
        self.top_rate = RATE_SHARE * vessel.top_rate
        self.turn = vessel.moment / vessel.m33

    def load(self, team: Knowledge, wanted: CourseCommand) -> Load:
        """Loads that follow the command."""
        k, ship = self.loops, self.vessel
        heading = team.fleet.heading
        u, sway = into(team.fleet.velocity_n[..., :2], heading)
        ahead, aside = into(wanted.velocity, heading)
        change_x, change_y = into(wanted.change, heading)
        push_x, push_y = into(self._push(team), heading)
        X = ship.m11 * (change_x + k.k_u * (ahead - u) - push_x) + ship.surge.at(ahead)
        Y = ship.m22 * (change_y + k.k_u * (aside - sway) - push_y) + ship.sway.at(aside)

        speed = wanted.velocity.norm(dim=-1).clamp(min=self.least_speed)
        slide = ship.slide(speed, team.target.course_rate)
        off = torch.atan2(aside, ahead)
        slip = torch.atan2(sway, u.clamp(min=self.least_speed))
        error = wrap(off + torch.atan(slide / speed) + k.lead * wrap(off - slip))
        rate = (change_y - self.gains.wave_share * push_y) / speed + approach(error, k.k_psi, self.turn)
        rate = rate.clamp(-self.top_rate, self.top_rate)
        r = (team.fleet.R_nb[..., 2, :] * team.fleet.angular_velocity_b).sum(-1)
        return Load(X, Y, ship.m33 * k.k_r * (rate - r) + ship.yaw.at(rate))

    def wanted(self, team: Knowledge) -> CourseCommand:
        """v* and v*' that lead to the team's slots."""
        slot, error, v = formation_velocity(team), team.now.error[..., :2], team.fleet.velocity_n[..., :2]
        chase = self.loops.k_e * error
        limit = self._fastest(slot, chase, team.now.about).clamp(
            self.least_speed, self.gains.closing_share * self.top_speed
        )
        share = (limit / chase.norm(dim=-1, keepdim=True).clamp(min=1e-6)).clamp(max=1.0)
        direct, drift = slot + share * chase, self.drift.at(team.fleet.position_n[..., :2], team.steps == 0)
        wanted = self.avoid(team, direct)  # without the drift, which is no motion over ground
        evading = (wanted - direct).norm(dim=-1, keepdim=True) > EVADING
        able = (share >= 1) & ~evading
        self.drift.learn(error, able & (chase.norm(dim=-1, keepdim=True) < self.drift.most))
        if team.now.about:
            self.drift.correct(wanted, v, share < 1)
        change = turning(team, slot) + torch.where(able, self.loops.k_e * (slot - v), 0.0)
        return CourseCommand(wanted + drift, change)

    def _fastest(self, slot: Tensor, chase: Tensor, about: bool) -> Tensor:
        """Limit [env, vehicle, 1] (m/s) of the `chase`: its sum with the slot's velocity stays below the top speed.

        The sum is limited in any direction; for slots `about` a target, which may be far, in the chase's own direction
        (constant bearing guidance: Breivik & Fossen 2009, Guidance laws for autonomous underwater vehicles, sec. 5.2).
        """
        own = slot.norm(dim=-1, keepdim=True)
        if not about:
            return self.top_speed - own
        toward = (slot * chase).sum(-1, keepdim=True) / chase.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        return (self.top_speed**2 - own * own + toward * toward).clamp(min=0.0).sqrt() - toward

    def _push(self, team: Knowledge) -> Tensor:
        """Acceleration [env, vehicle, 2] (m/s^2, NED) by the waves, half an interval ahead."""
        R, omega = team.fleet.R_nb, team.fleet.angular_velocity_b
        down_rate = R[..., :2, 0] * omega[..., 1:2] - R[..., :2, 1] * omega[..., 0:1]  # of R e_3: R (omega x e_3)
        return -GRAVITY * (R[..., :2, 2] + 0.5 * self.interval * down_rate)


class Drift:
    """Drift of a team: a velocity, added to the desired one, that compensates current, wind and sway.

    It is the integral of the position error in n, z' = k_i e: in n a current is constant however the hull turns.
    Against wind-up it is limited, and held while the hull cannot follow its command or is farther off than a drift
    explains. Far from a slot about a target, the course over ground is held instead, by the integral of the velocity
    error to the side of the command: the integral action of line-of-sight guidance (Børhaug, Pavlov & Pettersen 2008,
    IEEE CDC, eq. 7, in terms of velocities). An episode begins without a drift.
    """

    STATE = ("place", "moved", "value", "given")

    def __init__(self, k_i: float, top_speed: float, interval: float):
        """`k_i` 1/s^2, `top_speed` m/s, `interval` s."""
        self.interval, self.step, self.most = interval, k_i * interval, DRIFT_SHARE * top_speed
        self.place: Tensor | None = None  # as the other states are before the first decision
        self.moved: Tensor | None = None
        self.value: Tensor | None = None
        self.given: Tensor | None = None

    def at(self, position: Tensor, begins: Tensor) -> Tensor:
        """The drift (m/s) of vehicles at `position` (m), both [env, vehicle, 2]; 0 where an episode `begins` [env]."""
        place, value, given = self.place, self.value, self.given
        if place is None or value is None or given is None or place.shape != position.shape:
            place, value = position, torch.zeros_like(position)
            given = value
        fresh = begins.view(-1, 1, 1)
        self.value = torch.where(fresh, 0.0, value)
        self.moved = ~fresh & (position != place).any(-1, keepdim=True)
        self.given = torch.where(self.moved | fresh, self.value, given)  # or a second call at the same moment
        self.place = position.clone()
        return self.given

    def learn(self, error: Tensor, able: Tensor) -> None:
        """Integrate `error` [env, vehicle, 2] (m) of those that are `able` [env, vehicle, 1] to follow."""
        self._add(self.step * error, able)

    def correct(self, wanted: Tensor, velocity: Tensor, able: Tensor) -> None:
        """Integrate the part of `velocity` across `wanted` (m/s), both [env, vehicle, 2], of those that are `able`."""
        speed = wanted.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        side = to_starboard(wanted) / speed
        off = (velocity * side).sum(-1, keepdim=True)
        steady = off.abs() < COURSE_ERROR * velocity.norm(dim=-1, keepdim=True)
        self._add(-self.interval / COURSE_TIME * off * side, able & steady)

    def _add(self, change: Tensor, able: Tensor) -> None:
        assert self.value is not None and self.moved is not None, "`at` comes first"
        value = self.value + change
        value = value * (self.most / value.norm(dim=-1, keepdim=True).clamp(min=1e-6)).clamp(max=1.0)
        self.value = torch.where(able & self.moved & value.isfinite(), value, self.value)


def formation_velocity(team: Knowledge) -> Tensor:
    """Velocity [env, vehicle, 2] (m/s, NED) of slots: about a leader that keeps to its own, or about the target."""
    if team.now.about:
        return team.now.slot_velocity[..., :2]
    target = team.target
    leader = target.speed.unsqueeze(-1) * torch.stack((target.cos, target.sin), dim=-1)
    about = team.now.slot_velocity[..., :2] - team.fleet.velocity_n[:, :1, :2]
    about[:, 0] = 0.0
    return leader + about


def into(vector: Tensor, heading: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Parts of a `vector` [.., 2] (NED) along the nose and to starboard of it; `heading`: its cosine and sine."""
    (c, s), (north, east) = heading, vector.unbind(-1)
    return c * north + s * east, c * east - s * north
