"""Terms that rewards of any mission are made of, [env, vehicle], and their weighted sum."""

from typing import Any

import torch
from torch import Tensor


def coarse(d: Tensor, scale: float) -> Tensor:
    """A wide bell, exp(-(d / scale)^2): which way is home."""
    return torch.exp(-(d * d) * (1 / scale**2))


def fine(d: Tensor, scale: float) -> Tensor:
    """A sharp peak, 1 / (1 + (d / scale)^2): the last metre."""
    return 1 / (1 + (d * d) * (1 / scale**2))


def action_rate(action: Tensor, previous: Tensor) -> Tensor:
    """Minus the squared change of the action [env, vehicle, action]."""
    return -(action - previous).square().sum(-1)


def clearance(gap: Tensor, reach: float) -> Tensor:
    """-(1 - gap / reach)^2 where the gap (m) to obstacles and team mates is below `reach`, else 0."""
    return -(1 - gap * (1 / reach)).clamp(0.0, 1.5).square()


def penalty(happened: Tensor) -> Tensor:
    """-1 where it happened: the paper's collision penalty (sec. 3.5), and that of an early ending."""
    return -happened.to(torch.get_default_dtype())


def paid(terms: dict[str, Any], weights: Any, team: Any, ended: Any) -> Tensor:
    """The weighted sum of `terms`; a weight of 0 costs nothing."""
    parts = [
        getattr(weights, name) * term(team, ended, weights) for name, term in terms.items() if getattr(weights, name)
    ]
    return sum(parts, torch.zeros_like(team.fleet.state[..., 0]))
