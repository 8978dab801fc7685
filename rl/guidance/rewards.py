"""Reward terms that all missions share, [env, vehicle], and their weighted sum."""

from collections.abc import Callable, Mapping
from typing import Protocol, TypeVar

import torch
from torch import Tensor

from taichi_sim.config import Strict
from taichi_sim.fleet import Fleet


class Rewarded(Protocol):
    """What every reward reads of a team."""

    fleet: Fleet


T = TypeVar("T", bound=Rewarded)
E = TypeVar("E")
W = TypeVar("W", bound=Strict)


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


def paid(terms: Mapping[str, Callable[[T, E, W], Tensor]], weights: W, team: T, ended: E) -> Tensor:
    """Weighted sum of `terms`; a term with weight 0 is not computed."""
    parts = [
        getattr(weights, name) * term(team, ended, weights) for name, term in terms.items() if getattr(weights, name)
    ]
    return sum(parts, team.fleet.state.new_zeros(team.fleet.never.shape))
