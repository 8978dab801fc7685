"""Rewards: one function for each term, and the terms with their weights.

`d` is a vehicle's distance (m) to what it tracks: the target for a leader, its slot for a follower. Every term is
[env, vehicle].
"""

from typing import Protocol

import torch
from torch import Tensor

from rl.guidance.rewards import clearance, ending, near, nearest, penalty, steady
from rl.guidance.targets_and_errors import SlotErrors, Target
from rl.perception.sensors import Mate, Obstacle, Sensor
from rl.step import Endings
from rl.terms import Term
from taichi_sim.config import NonNegative, Positive
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import EAST, NORTH
from taichi_sim.vehicle import Vehicle


def paper_usv(d: Tensor, toward: Tensor, along: Tensor) -> Tensor:
    """Eq. (10). `toward` = D_df, the cosine between heading and the direction to the target; `along` = D_ff, the
    cosine between heading and the target's course. The paper leaves d = 100 open: the near branch takes it.
    """
    return torch.where(d > 100.0, toward * (1 - 0.001 * d), along * (0.9 + 2 - 0.02 * d))


def paper_uav_leader(d: Tensor, toward: Tensor, along: Tensor) -> Tensor:
    """Eq. (11), with A_df and A_ff as D_df and D_ff in eq. (10)."""
    return torch.where(d > 100.0, toward * (1 - 0.0005 * d), along * (0.95 + 1 - 0.01 * d))


def paper_uav_follower(d: Tensor) -> Tensor:
    """Sec. 3.5: 1 - 0.025 d below 100 m; the paper gives nothing beyond, so 0 there."""
    return torch.where(d < 100.0, 1 - 0.025 * d, torch.zeros_like(d))


class Keeper(Protocol):
    """What rewards read of a team (team.py); tensors are [env, vehicle, ...]."""

    axes: int
    fleet: Fleet[Vehicle]
    action: Tensor
    previous_action: Tensor
    sensor: Sensor
    target: Target

    @property
    def now(self) -> SlotErrors:
        """Errors from the slots."""
        ...

    @property
    def distance(self) -> Tensor:
        """Distance from the slot, m."""
        ...


def gap_ahead(team: Keeper, time: float) -> Tensor:
    """Least gap (m) to what is sensed, from above, in the next `time` (s) if all go straight on; 0: the gap now."""
    sensor, radius = team.sensor, team.sensor.radius
    if time == 0:
        return sensor.gap
    things, mates, own = sensor.obstacles, sensor.team_mates, team.fleet.velocity_n[..., None, :2]
    away = torch.cat((things[..., Obstacle.LEVEL] + things[..., Obstacle.RADIUS], mates[..., Mate.DISTANCE]), dim=-1)
    sizes = torch.cat((things[..., Obstacle.RADIUS] + radius, torch.full_like(mates[..., 0], 2 * radius)), dim=-1)
    its = torch.cat((things[..., Obstacle.V_NORTH : Obstacle.RADIUS], mates[..., Mate.V_NORTH : Mate.SIZE]), dim=-2)
    there = torch.cat((things[..., Obstacle.NORTH : Obstacle.DOWN], mates[..., Mate.NORTH : Mate.DOWN]), dim=-2)
    place, w = away.unsqueeze(-1) * there, own - its
    nearest = ((place * w).sum(-1) / w.square().sum(-1).clamp(min=1e-6)).clamp(0.0, time)
    gap = (place - nearest.unsqueeze(-1) * w).norm(dim=-1) - sizes
    none = torch.cat((things[..., Obstacle.NUMBER], mates[..., Mate.NUMBER]), dim=-1) < 0
    return torch.minimum(sensor.gap, gap.masked_fill(none, sensor.reach).amin(-1))


def approach(team: Keeper) -> Tensor:
    """-d per metre: its gradient does not vanish far away."""
    return -team.distance


def squared(team: Keeper, limit: Positive = 15.0) -> Tensor:
    """-d^2 per square metre, up to `limit` (m): the quantity of the rms error."""
    return -team.distance.clamp(max=limit).square()


def keep_clear(team: Keeper, range: Positive = 4.0, time: NonNegative = 0.0) -> Tensor:
    """-(1 - gap / range)^2 where the gap (m) to the nearest obstacle or team mate is smaller than the range (m); the
    least gap in the next `time` (s) if all go straight on.
    """
    return clearance(gap_ahead(team, time), range)


def paper(team: Keeper) -> Tensor:
    """Eqs (10) and (11) of the seed paper."""
    d, derived = team.distance, team.fleet.derived
    forward = derived[..., 0:9:3][..., : team.axes]  # the nose, in n
    direction = team.now.error[..., : team.axes] / d.clamp(min=1e-3).unsqueeze(-1)
    toward = (forward * direction).sum(-1)
    along = forward[..., NORTH] * team.target.cos + forward[..., EAST] * team.target.sin
    if team.fleet.model.medium == "water":
        return paper_usv(d, toward, along)
    leader = paper_uav_leader(d[:, :1], toward[:, :1], along[:, :1])
    return torch.cat((leader, paper_uav_follower(d[:, 1:])), dim=1)


def collision(ended: Endings) -> Tensor:
    """-1 at a collision."""
    return penalty(ended["collided"])


TERMS = {
    "coarse": Term(near, 1.0, {"scale": 8.0}),
    "fine": Term(nearest, 1.0, {"scale": 0.5}),
    "approach": Term(approach, 0.02),
    "squared": Term(squared, 0.0),
    "action_rate": Term(steady, 0.02),
    "clearance": Term(keep_clear, 0.5),
    "ending": Term(ending, 10.0),
    "paper": Term(paper, 0.0),
    "collision": Term(collision, 0.0),
}
"""Terms of the reward, with the weights of `reward = "tracking"`."""
PAPER = dict.fromkeys(TERMS, 0.0) | {"paper": 1.0, "collision": 1.0}
"""Weights of `reward = "paper"`."""
