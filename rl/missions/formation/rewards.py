"""Rewards: the weights, one function per term, and the terms that make a reward.

`d` is a vehicle's distance (m) to what it tracks: the target for a leader, its slot for a follower. Every term is
[env, vehicle]. To add one to the tracking reward: its weight in `TrackingReward`, its function, its line in `TERMS`.
"""

from collections.abc import Callable
from typing import Protocol

import torch
from torch import Tensor

from rl.guidance.rewards import action_rate, clearance, coarse, fine, paid, penalty
from rl.guidance.targets_and_errors import SlotErrors, Target
from rl.perception.sensors import Mate, Obstacle, Sensor
from rl.step import Endings
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import EAST, NORTH
from taichi_sim.vehicle import Vehicle


class TrackingReward(Strict):
    """Weights and scales of `reward = "tracking"`; a function each, below."""

    coarse: NonNegative = 1.0  # exp(-(d / coarse_scale)^2)
    coarse_scale: Positive = 8.0  # m
    fine: NonNegative = 1.0  # 1 / (1 + (d / fine_scale)^2)
    fine_scale: Positive = 0.5  # m
    approach: NonNegative = 0.02  # -d per metre: its gradient does not vanish far away
    squared: NonNegative = 0.0  # -d^2 per square metre, up to squared_limit
    squared_limit: Positive = 15.0  # m
    action_rate: NonNegative = 0.02  # -|a - a_previous|^2
    clearance: NonNegative = 0.5  # -(1 - gap / clearance_range)^2 inside the range
    clearance_range: Positive = 4.0  # m, gap to the nearest obstacle or team mate
    clearance_time: NonNegative = 0.0  # s ahead, of the least gap if all go straight on; 0: the gap now
    ending: NonNegative = 10.0  # -1 at a collision, or any other early ending


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


def squared(d: Tensor, limit: float) -> Tensor:
    """-d^2 up to `limit` (m): the quantity of the rms error."""
    return -d.clamp(max=limit).square()


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


TERMS: dict[str, Callable[[Keeper, Endings, TrackingReward], Tensor]] = {
    "coarse": lambda team, ended, w: coarse(team.distance, w.coarse_scale),
    "fine": lambda team, ended, w: fine(team.distance, w.fine_scale),
    "approach": lambda team, ended, w: -team.distance,
    "squared": lambda team, ended, w: squared(team.distance, w.squared_limit),
    "action_rate": lambda team, ended, w: action_rate(team.action, team.previous_action),
    "clearance": lambda team, ended, w: clearance(gap_ahead(team, w.clearance_time), w.clearance_range),
    "ending": lambda team, ended, w: penalty(ended.any),
}
"""Terms of `reward = "tracking"`: name of the weight -> function of a team, its endings, and the weights."""


def tracking(weights: TrackingReward, team: Keeper, ended: Endings) -> Tensor:
    """`reward = "tracking"`: the weighted sum of `TERMS`."""
    return paid(TERMS, weights, team, ended)


def paper(team: Keeper, ended: Endings) -> Tensor:
    """`reward = "paper"`: eqs (10) and (11), and the penalty of a collision."""
    d, derived = team.distance, team.fleet.derived
    forward = derived[..., 0:9:3][..., : team.axes]  # the nose, in n
    direction = team.now.error[..., : team.axes] / d.clamp(min=1e-3).unsqueeze(-1)
    toward = (forward * direction).sum(-1)
    along = forward[..., NORTH] * team.target.cos + forward[..., EAST] * team.target.sin
    if team.fleet.model.medium == "water":
        reward = paper_usv(d, toward, along)
    else:
        leader = paper_uav_leader(d[:, :1], toward[:, :1], along[:, :1])
        reward = torch.cat((leader, paper_uav_follower(d[:, 1:])), dim=1)
    return reward + penalty(ended["collided"])
