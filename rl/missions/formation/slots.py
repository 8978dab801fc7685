"""Slots: where each vehicle of a line formation should be.

The leader's slot is the target. Follower i's slot is the leader's position plus an offset in the path frame, whose
first axis is the target's course: (0, +-j spacing) in a line abreast, starboard first; (-i spacing, 0) astern.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class Target(NamedTuple):
    """The moving target of each environment."""

    position: Tensor  # [env, 3] NED, m
    course: Tensor  # [env] rad
    cos: Tensor  # [env] of the course
    sin: Tensor  # [env]
    course_rate: Tensor  # [env] rad/s
    speed: Tensor  # [env] m/s


def formation_offsets(formation: str, count: int, spacing: float) -> Tensor:
    """Offsets [vehicle, 2] (m) ahead and to starboard of the leader; the leader's is zero."""
    i = torch.arange(count, dtype=torch.float64)
    zero = torch.zeros_like(i)
    if formation == "astern":
        return torch.stack((-i * spacing, zero), dim=1)
    side = torch.where(i % 2 == 1, 1.0, -1.0)
    return torch.stack((zero, side * torch.ceil(i / 2) * spacing), dim=1)


def lane_half_width(formation: str, count: int, spacing: float) -> float:
    """Largest distance (m) of a slot from the leader, sideways."""
    return float(formation_offsets(formation, count, spacing)[:, 1].abs().max())


class Slots(NamedTuple):
    """Where vehicles should be, and how that place moves; both [env, vehicle, 3], NED."""

    position: Tensor  # m
    velocity: Tensor  # m/s


def slots(target: Target, leader_position: Tensor, leader_velocity: Tensor, offsets: Tensor) -> Slots:
    """Slots of a team.

    Args:
        target: the team's. leader_position, leader_velocity: [env, 3], NED.
        offsets: [vehicle, 2], ahead and to starboard.
    """
    ahead, starboard = offsets[:, 0], offsets[:, 1]
    c, s = target.cos.unsqueeze(1), target.sin.unsqueeze(1)
    north = c * ahead - s * starboard
    east = s * ahead + c * starboard
    offset = torch.stack((north, east, torch.zeros_like(north)), dim=-1)
    rate = target.course_rate.unsqueeze(1)
    swing = torch.stack((-rate * east, rate * north, torch.zeros_like(north)), dim=-1)
    position = leader_position.unsqueeze(1) + offset
    velocity = leader_velocity.unsqueeze(1) + swing
    position[:, 0] = target.position
    velocity[:, 0, 0] = target.speed * target.cos
    velocity[:, 0, 1] = target.speed * target.sin
    velocity[:, 0, 2] = 0.0
    return Slots(position, velocity)
