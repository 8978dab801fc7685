"""Functions of rewards that missions share, and terms (rl/terms.py) made of them; every one is [env, vehicle]."""

from typing import Protocol

import torch
from torch import Tensor

from rl.perception.sensors import Sensor
from rl.step import Endings
from taichi_sim.config import Positive


class Acting(Protocol):
    """What terms read of any team."""

    action: Tensor
    previous_action: Tensor


class Keeping(Protocol):
    """What terms read of a team that keeps a place."""

    sensor: Sensor

    @property
    def distance(self) -> Tensor:
        """Distance from the place, m."""
        ...


def coarse(d: Tensor, scale: float) -> Tensor:
    """A wide bell, exp(-(d / scale)^2): its gradient reaches far from the slot."""
    return torch.exp(-(d * d) * (1 / scale**2))


def fine(d: Tensor, scale: float) -> Tensor:
    """A sharp peak, 1 / (1 + (d / scale)^2): its gradient is largest within the last metre."""
    return 1 / (1 + (d * d) * (1 / scale**2))


def action_rate(action: Tensor, previous: Tensor) -> Tensor:
    """Minus the squared change of the action [env, vehicle, action]."""
    return -(action - previous).square().sum(-1)


def clearance(gap: Tensor, reach: float) -> Tensor:
    """-(1 - gap / reach)^2 where the gap (m) to obstacles and team mates is below `reach`, else 0."""
    return -(1 - gap * (1 / reach)).clamp(0.0, 1.5).square()


def penalty(happened: Tensor) -> Tensor:
    """-1 where the event happened: the paper's collision penalty (sec. 3.5), and the penalty of an early ending."""
    return -happened.to(torch.get_default_dtype())


# -- terms -------------------------------------------------------------------------------------------------------------


def near(team: Keeping, scale: Positive) -> Tensor:
    """exp(-(d / scale)^2), d the distance (m) from where it is to be."""
    return coarse(team.distance, scale)


def nearest(team: Keeping, scale: Positive) -> Tensor:
    """1 / (1 + (d / scale)^2), d the distance (m) from where it is to be."""
    return fine(team.distance, scale)


def steady(team: Acting) -> Tensor:
    """-|a - a_previous|^2 of the vehicle's actions."""
    return action_rate(team.action, team.previous_action)


def clear(team: Keeping, range: Positive) -> Tensor:
    """-(1 - gap / range)^2 where the gap (m) to the nearest obstacle or team mate is smaller than the range (m)."""
    return clearance(team.sensor.gap, range)


def ending(ended: Endings) -> Tensor:
    """-1 at a collision, or any other early ending."""
    return penalty(ended.any)
