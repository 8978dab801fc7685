"""The team of boats, where they take part: a policy that deviates from the ordered course and speed to steady the deck.

It may deviate within the limits of `[course]`, and observes what the boat measures of itself (boats.py). Without a
policy, boats hold the ordered course.
"""

from typing import Protocol

import torch
from torch import Tensor

from rl.guidance.observations import squashed
from rl.guidance.rewards import paid
from rl.guidance.targets_and_errors import wrap
from rl.missions.landing import rewards
from rl.missions.landing.boats import COURSE, SPEED, Boats
from rl.missions.landing.config import LandingTeam
from rl.missions.landing.deck_motion import DeckMotion
from rl.missions.landing.host import Parts
from rl.missions.landing.level_frame import into_level
from rl.step import Due, Endings
from rl.team import Controller, Team
from taichi_sim.state.memory import Remembers


class Served(Parts, Protocol):
    """What the boats ask of their mission, too."""

    def served(self) -> Tensor:
        """Whether an aircraft has landed on each boat in this step, bool [env, boat]."""
        ...


class BoatTeam(Team[Served, LandingTeam]):
    """The team of boats; every tensor is [env, boat, ...].

    Attributes:
        boats: what the team sails. chosen, chosen_before: [.., 2] the policy's last two actions.
    """

    logged = ("landed",)

    def __init__(self, mission: Served, name: str, boats: Boats):
        """Make team `name`, which sails `boats`."""
        super().__init__(mission, name)
        self.boats = boats
        self.chosen, self.chosen_before = (self.remember(torch.zeros_like(boats.ordered)) for _ in range(2))

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the policy's outputs."""
        return ("course", "speed")

    def commanded(self, action: Tensor) -> Tensor:
        """Vessel actions [env, boat, a] for a policy's deviations [env, boat, 2] from the ordered course and speed."""
        self.chosen_before, self.chosen = self.chosen, action
        return self.boats.sail(self.chosen)

    def make_controller(self) -> Controller:
        """The boats hold their course."""
        return Hold()

    def truth(self, due: Due) -> None:
        """Forget the actions of an episode that is over."""
        fresh = due.begins.view(-1, 1, 1)
        self.chosen = torch.where(fresh, 0.0, self.chosen)
        self.chosen_before = torch.where(fresh, 0.0, self.chosen_before)

    @property
    def deck(self) -> DeckMotion:
        """The motion of the decks, the truth."""
        return self.boats.deck

    @property
    def swing(self) -> Tensor:
        """Horizontal speed of the deck relative to its mean velocity, m/s."""
        return self.boats.swing

    @property
    def served(self) -> Tensor:
        """Whether an aircraft of each boat has landed in this step."""
        return self.mission.served()

    def reward(self, ended: Endings) -> Tensor:
        """See rewards.py."""
        return paid(rewards.BOAT_TERMS, self.section.boat_reward, self, ended)

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """Share of boats whose aircraft landed in this step."""
        return {"landed": self.served.float().mean()}

    def observe(self) -> dict[str, Tensor]:
        """Observation terms of each boat."""
        boats, own, R = self.boats, self.boats.own, self.boats.seen.R
        level = into_level(boats.seen.velocity, own.heading)
        (c, s), course = own.heading, boats.ordered[..., COURSE]
        off, steered = wrap(torch.atan2(s, c) - course), wrap(boats.steered - course)
        return {
            "velocity": squashed(level, 1.0),
            "acceleration": squashed(into_level(boats.acceleration, own.heading), 1.0),
            "tilt": 5.0 * R[..., 2, :2],
            "rates": own.angular_velocity_b * 2.0,
            "moves": boats.squares.sqrt() * boats.squares.new_tensor((1.0, 5.0, 5.0)),
            "heading": torch.stack((off.cos(), off.sin()), dim=-1),
            "steered": torch.stack((steered.cos(), steered.sin()), dim=-1),
            "speed": torch.stack((boats.ordered[..., SPEED], boats.aim[..., SPEED]), dim=-1) / 2.0,
            "previous_action": self.chosen,
        }

    def truth_now(self) -> Tensor | None:
        """Ground truth [env, boat, n]: the significant wave height, and the numbers and conditions that vary."""
        mission = self.mission
        told = [mission.hs.view(-1, 1, 1).expand(*self.chosen.shape[:2], 1) / 4.0]
        if mission.config.varies:
            told.append(mission.world.truth[self.name])
        return torch.cat(told, dim=-1)


class Hold(Remembers):
    """The classical controller of the boats: it holds the ordered course and speed."""

    def __call__(self, team: BoatTeam) -> Tensor:
        """Actions [env, boat, a] of the vessels."""
        return team.commanded(torch.zeros_like(team.chosen))
