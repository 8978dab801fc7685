"""A mission and a script of somebody else's: `buoys:Buoys` and `buoys:Ferry`, named by buoys.toml beside them."""

from typing import Any

import torch
from torch import Tensor

from rl.mission import Endings, Mission, Step, Team
from rl.scenario import Scenario
from taichi_sim.config import Positive
from taichi_sim.conventions import POSITION, QUATERNION, STATE_SIZE
from taichi_sim.fleet import Fleet
from taichi_sim.script import Script

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


class Buoys(Mission):
    """Every vehicle of every team is to reach one buoy."""

    Config = BuoysScenario
    logged = ("distance",)

    def begin(self, envs: Tensor, **where: Any) -> None:
        """Teams side by side, all in one row."""
        east = 0.0
        for name, team in self.teams.items():
            self.world.place(name, envs, row(team.fleet, len(envs), east))
            east += APART * team.fleet.count

    def _offset(self, team: Team) -> Tensor:
        buoy = team.fleet.state.new_tensor([self.config.buoy_distance, 0.0])
        return (buoy - team.fleet.position_n[..., :2]) / self.config.buoy_distance

    def observe(self, team: Team) -> dict[str, Tensor]:
        """Where the buoy is, the heading, and unless `blind` the own velocity."""
        fleet = team.fleet
        seen = {"buoy": self._offset(team), "heading": torch.stack(fleet.heading, dim=-1)}
        return seen if self.config.blind else seen | {"velocity": fleet.velocity_b / 10.0}

    def reward(self, team: Team, ended: Endings) -> Tensor:
        """Minus the distance."""
        return -self._offset(team).norm(dim=-1)

    def log(self, team: Team, step: Step) -> dict[str, Tensor]:
        """The mean distance, m."""
        return {"distance": self._offset(team).norm(dim=-1).mean() * self.config.buoy_distance}


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
