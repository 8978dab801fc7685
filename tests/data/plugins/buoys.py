"""A mission and a script of somebody else's: `buoys:Buoys` and `buoys:Ferry`, named by buoys.toml beside them."""

from typing import Any

import torch
from torch import Tensor

from rl.mission import Mission
from rl.scenario import Scenario
from rl.team import Endings, Team
from taichi_sim.config import Positive
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import POSITION, QUATERNION, STATE_SIZE
from taichi_sim.world import Script

APART = 20.0  # m between neighbours at the start


def row(fleet: Fleet, envs: int, east: float) -> Tensor:
    """States [envs, vehicle, 13] at rest, side by side from `east` (m) on, heading north."""
    state = fleet.state.new_zeros((envs, fleet.count, STATE_SIZE))
    state[..., QUATERNION.start] = 1.0
    state[..., POSITION.start + 1] = east + APART * torch.arange(fleet.count)
    return state


class BuoysScenario(Scenario):
    """Where the buoy is, and whether vehicles know how they move."""

    buoy_distance: Positive = 50.0  # m, north of the origin
    blind: bool = False


class Seeker(Team):
    """Every vehicle is to reach one buoy."""

    logged = ("distance",)

    def offset(self) -> Tensor:
        """From each vehicle to the buoy, in distances of it."""
        far = self.mission.config.buoy_distance
        return (self.fleet.state.new_tensor([far, 0.0]) - self.fleet.position_n[..., :2]) / far

    def observe(self) -> dict[str, Tensor]:
        """Where the buoy is, the heading, and unless `blind` the own velocity."""
        seen = {"buoy": self.offset(), "heading": torch.stack(self.fleet.heading, dim=-1)}
        return seen if self.mission.config.blind else seen | {"velocity": self.fleet.velocity_b / 10.0}

    def reward(self, ended: Endings) -> Tensor:
        """Minus the distance."""
        return -self.offset().norm(dim=-1)

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """The mean distance, m."""
        return {"distance": self.offset().norm(dim=-1).mean() * self.mission.config.buoy_distance}


class Buoys(Mission):
    """Teams begin side by side."""

    Config, Team = BuoysScenario, Seeker

    def begin(self, envs: Tensor, **where: Any) -> None:
        """Teams side by side, all in one row."""
        east = 0.0
        for name, team in self.teams.items():
            self.world.place(name, envs, row(team.fleet, len(envs), east))
            east += APART * team.fleet.count


class Ferry(Script):
    """Begins far away and goes full ahead."""

    def begin(self, world: Any, envs: Tensor) -> None:
        """Out of everybody's way."""
        fleet = world.teams[self.name]
        world.place(self.name, envs, row(fleet, len(envs), -500.0))

    def __call__(self, world: Any) -> Tensor:
        """The first action is the throttle."""
        action = torch.zeros_like(world.teams[self.name].action)
        action[..., 0] = 1.0
        return action
