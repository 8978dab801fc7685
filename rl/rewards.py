"""Reward terms that all missions share, [env, vehicle], and their weighted sum."""

from typing import Any

import torch
from torch import Tensor


def coarse(d: Tensor, scale: float) -> Tensor:
    """Wide bell exp(-(d / scale)^2), which guides from afar."""
    return torch.exp(-(d * d) * (1 / scale**2))


def fine(d: Tensor, scale: float) -> Tensor:
    """Sharp peak 1 / (1 + (d / scale)^2), for the last metre."""
    return 1 / (1 + (d * d) * (1 / scale**2))


def action_rate(action: Tensor, previous: Tensor) -> Tensor:
    """Minus the squared change of the action [env, vehicle, action]."""
    return -(action - previous).square().sum(-1)


def clearance(gap: Tensor, reach: float) -> Tensor:
    """-(1 - gap / reach)^2 where the gap (m) to obstacles and team mates is below `reach`, else 0."""
    return -(1 - gap * (1 / reach)).clamp(0.0, 1.5).square()


def penalty(happened: Tensor) -> Tensor:
    """-1 where `happened` is true: the paper's collision penalty (sec. 3.5) and that of an early ending."""
    return -happened.to(torch.get_default_dtype())


def paid(terms: dict[str, Any], weights: Any, team: Any, ended: Any) -> Tensor:
    """Weighted sum of `terms`; a term of weight 0 is not computed."""
    parts = [
        getattr(weights, name) * term(team, ended, weights) for name, term in terms.items() if getattr(weights, name)
    ]
    return sum(parts, torch.zeros_like(team.fleet.state[..., 0]))
