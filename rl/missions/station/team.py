"""The boat that keeps station: what it knows, observes, is rewarded for, ends by."""

import math
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from rl.guidance.rewards import coarse, ending, near, nearest, steady
from rl.guidance.targets_and_errors import wrap
from rl.missions.station.config import StationScenario, StationTeam
from rl.missions.station.keeper import Craft, Keeper, KeeperGains, Known
from rl.perception.instruments import Readings
from rl.step import Due, Endings
from rl.team import Controller, Host, Team
from rl.terms import Term
from taichi_sim.config import Positive
from taichi_sim.config.io import validate
from taichi_sim.fleet import Fleet

SUM_LIMIT = (20.0, 20.0, 4.0)  # m s, m s, rad s: of the sum of errors; assumed
COUNTED = (1.0, 1.0, 0.2)  # m, m, rad: greater errors do not count in it, those of a boat under way; assumed
WIDE, NARROW = (5.0, 5.0, 1.0), (0.5, 0.5, 0.1)  # m, m, rad: scales of observed errors; assumed


class Slot(NamedTuple):
    """Where the boat is to be, and how that moves: north, east, heading, [env, 1, 3] each, SI."""

    place: Tensor
    rate: Tensor
    push: Tensor  # acceleration


class Course(Host, Protocol):
    """What the boat asks of its mission (mission.py)."""

    quay: Tensor  # [env, 1, 2] bearing of the quay from the origin (rad), and its distance (m)

    @property
    def slot(self) -> Slot:
        """The place."""
        ...

    @property
    def config(self) -> StationScenario:
        """The scenario."""
        ...


def heading_kept(team: "Boat", scale_deg: Positive) -> Tensor:
    """exp(-(a / scale)^2), a the error of the heading (deg)."""
    return coarse(team.error[..., 2], math.radians(scale_deg))


def kept(team: "Boat") -> Tensor:
    """1 where place and heading are kept, by `[station]`."""
    return team.kept.to(team.error.dtype)


class Boat(Team[Course, StationTeam]):
    """One boat; tensors are [env, boat, ...], errors and rates in the heading frame: ahead, to starboard, heading.

    Attributes:
        own: as its instruments measure it. error: from the place, by the truth, m, m, rad. seen: the same, as measured.
    """

    terms = {
        "coarse": Term(near, 0.5, {"scale": 2.0}),
        "fine": Term(nearest, 1.0, {"scale": 0.3}),
        "heading": Term(heading_kept, 0.5, {"scale_deg": 5.0}),
        "kept": Term(kept, 0.5),
        "action_rate": Term(steady, 0.05),
        "ending": Term(ending, 50.0),
    }
    logged = ("error_m", "heading_error_deg", "kept")
    meanings = {
        "error": f"of place and heading, ahead, to starboard, m, m, rad, squashed by {WIDE}, then by {NARROW}",
        "error_rate": "its rate, m/s, rad/s",
        "sum": "of errors, as a share of its limit",
        "down": "unit vector down, ahead and to starboard",
        "rates": "roll and pitch rate, rad/s",
        "pace": "velocity of the place, m/s, m/s, rad/s",
        "previous_action": "the last actions, -1 to 1",
    }

    def __init__(self, mission: Course, name: str):
        """Make the boat."""
        super().__init__(mission, name)
        config, interval = mission.config, mission.config.decision_interval
        sensors = self.section.sensors
        self.own: Fleet | Readings = self.remember(
            self.fleet if sensors.exact else Readings(self.fleet, sensors, interval, config.first_number(name))
        )
        like = self.fleet.state
        self.error = self.remember(like.new_zeros((*like.shape[:2], 3)))
        self.seen = self.remember(like.new_zeros((*like.shape[:2], 3)))
        self._sum = self.remember(like.new_zeros((*like.shape[:2], 3)))  # of errors north, east, of the heading
        length, beam, _ = self.fleet.model.size
        self._half = length / 2, beam / 2

    # -- phases of a step ------------------------------------------------------------------------------------------

    def _off(self, fleet: Fleet | Readings) -> Tensor:
        """The place less where `fleet` is, north, east (m), heading (rad)."""
        c, s = fleet.heading
        off = self.mission.slot.place - torch.cat((fleet.position_n[..., :2], torch.atan2(s, c).unsqueeze(-1)), dim=-1)
        return torch.cat((off[..., :2], wrap(off[..., 2:])), dim=-1)

    def truth(self, due: Due) -> None:
        """Measure the error."""
        self.error = self.fleet.to_level(self._off(self.fleet))

    def perceive(self, due: Due) -> None:
        """Read the instruments."""
        if isinstance(self.own, Readings):
            self.own.read(due)

    def conclude(self, due: Due) -> None:
        """Measure the error by them, and add it up."""
        off = self._off(self.own)
        limit, counted = off.new_tensor(SUM_LIMIT), torch.where(off.abs() < off.new_tensor(COUNTED), off, 0.0)
        grown = (self._sum + self.mission.config.decision_interval * counted).clamp(-limit, limit)
        on, begins = due.goes_on.view(-1, 1, 1), due.begins.view(-1, 1, 1)
        self._sum = torch.where(begins, 0.0, torch.where(on, grown, self._sum))
        self.seen = self.own.to_level(off)

    @property
    def known(self) -> Known:
        """What the keeper reads."""
        own, slot = self.own, self.mission.slot
        velocity = torch.cat((own.velocity_n[..., :2], own.angular_velocity_b[..., 2:]), dim=-1)
        rate, pace, push, total = map(own.to_level, (slot.rate - velocity, slot.rate, slot.push, self._sum))
        return Known(self.seen, rate, pace, push, total, own.down_b[..., :2])

    # -- by the truth ----------------------------------------------------------------------------------------------

    @property
    def distance(self) -> Tensor:
        """Distance [env, boat] from the place, m."""
        return self.error[..., :2].norm(dim=-1)

    @property
    def kept(self) -> Tensor:
        """Whether place and heading are kept, by `[station]`, bool [env, boat]."""
        s = self.mission.config.station
        return (self.distance < s.near) & (self.error[..., 2].abs() < math.radians(s.near_deg))

    @property
    def gap(self) -> Tensor:
        """Clearance [env, boat] of the hull's rectangle to the quay, m."""
        bearing, away = self.mission.quay.unbind(-1)
        c, s = self.fleet.heading
        b_c, b_s = bearing.cos(), bearing.sin()
        north, east = self.fleet.position_n[..., 0], self.fleet.position_n[..., 1]
        ahead, aside = (c * b_c + s * b_s).abs(), (c * b_s - s * b_c).abs()
        return away - b_c * north - b_s * east - self._half[0] * ahead - self._half[1] * aside

    def margins(self) -> dict[str, Tensor]:
        """To contact with the quay, and to being too far from the place, m."""
        return {"collided": self.gap, "lost": self.mission.config.station.lost - self.distance}

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """Errors now, and the share of boats that keep their place."""
        degrees = self.error[..., 2].abs().rad2deg()
        return dict(zip(self.logged, (self.distance.mean(), degrees.mean(), self.kept.float().mean()), strict=True))

    # -- by what it knows ------------------------------------------------------------------------------------------

    def observe(self) -> dict[str, Tensor]:
        """See `meanings`."""
        known, like = self.known, self.error.new_tensor
        error = known.error
        return {
            "error": torch.cat([error / (error.abs() + like(scale)) for scale in (WIDE, NARROW)], dim=-1),
            "error_rate": known.error_rate,
            "sum": known.sum / like(SUM_LIMIT),
            "down": known.down,
            "rates": self.own.angular_velocity_b[..., :2],
            "pace": known.pace,
            "previous_action": self.action,
        }

    def planned(self, correction: Tensor, known: object = None) -> Tensor:
        """Vehicle actions of the keeper, who always acts on what is known, corrected; see Team.planned."""
        return super().planned(correction, self.known)

    def make_controller(self) -> Controller | None:
        """A keeper for a craft that pushes to any side; the vehicle's own for another, if it has one."""
        if Craft.of(self.fleet.model) is None:
            return super().make_controller()
        gains = validate(KeeperGains, dict(self.section.control), f"{self.name}.control")
        return Keeper(self.fleet.model, gains)
