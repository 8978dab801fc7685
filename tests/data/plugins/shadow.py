"""Boats keep under aircraft that keep a circle: a mission of two teams, each of which learns."""

import math
from types import MappingProxyType
from typing import Any

import torch
from torch import Tensor

from rl.guidance.rewards import coarse, fine
from rl.mission import Endings, Mission, Team
from rl.scenario import Scenario
from rl.step import Due
from taichi_sim.config import Positive


class ShadowScenario(Scenario):
    """Keys beside those of every scenario."""

    circle: Positive = 150.0  # m, radius of the aircraft's circle
    height: Positive = 60.0  # m
    lost: Positive = 300.0  # m, from its place, at which a vehicle is lost


class Follower(Team):
    """What both teams have in common; `truth` writes `error` [env, vehicle, 2 or 3], to the place to be at, m."""

    logged = ("error_m",)

    def __init__(self, mission: Any, name: str):
        """Begin without an error."""
        super().__init__(mission, name)
        self.error = self.remember(torch.zeros_like(self.fleet.position_n))

    def observe(self) -> dict[str, Tensor]:
        """The way to go, and the own motion."""
        return {"error": self.fleet.to_level(self.error) / 50.0, "velocity": self.fleet.velocity_b / 10.0}

    def reward(self, ended: Endings) -> Tensor:
        """Near is good."""
        far = self.error.norm(dim=-1)
        return coarse(far, 50.0) + fine(far, 5.0) - ended.any.to(far)

    def endings(self) -> dict[str, Tensor]:
        """Too far away."""
        return {"lost": self.error.norm(dim=-1) > self.mission.config.lost}

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """The mean error, m."""
        return {"error_m": self.error.norm(dim=-1).mean()}


class Aircraft(Follower):
    """They fly to the nearest point of their circle about the origin."""

    def truth(self, due: Due) -> None:
        """Measure the way to the circle."""
        config, place = self.mission.config, self.fleet.position_n
        out = place[..., :2] / place[..., :2].norm(dim=-1, keepdim=True).clamp(min=1.0)
        circle = torch.cat((config.circle * out, torch.full_like(out[..., :1], -config.height)), dim=-1)
        self.error = circle - place


class Boats(Follower):
    """Boat k keeps under aircraft k."""

    def truth(self, due: Due) -> None:
        """Measure the way to the place under the aircraft."""
        self.error = self.mission.world.teams["aircraft"].position_n - self.fleet.position_n
        self.error[..., 2] = 0.0


class Shadow(Mission):
    """Boats in the shadow of aircraft."""

    Config = ShadowScenario
    Teams = MappingProxyType({"boats": Boats, "aircraft": Aircraft})

    def begin(self, envs: Tensor) -> None:
        """Aircraft begin on their circle, evenly spaced, and boats below them, at rest."""
        for name, team in self.teams.items():
            turn = 2 * math.pi * torch.rand((len(envs), 1), generator=self.generator)
            angle = turn + 2 * math.pi / team.fleet.count * torch.arange(team.fleet.count)
            place = self.config.circle * torch.stack((angle.cos(), angle.sin()), dim=-1)
            if name == "aircraft":
                place = torch.cat((place, torch.full_like(place[..., :1], -self.config.height)), dim=-1)
            self.place(name, envs, place, angle + math.pi / 2, team.fleet.model.limits.speeds[1])
