"""Rewards, one function per term; errors and gaps [env, vehicle] in, reward [env, vehicle] out.

`d` is a vehicle's distance (m) to what it tracks: the target for a leader, its slot for a follower.
"""

import torch
from torch import Tensor


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


def coarse(d: Tensor, scale: float) -> Tensor:
    """A wide bell, exp(-(d / scale)^2): which way is home."""
    return torch.exp(-(d * d) * (1 / scale**2))


def fine(d: Tensor, scale: float) -> Tensor:
    """A sharp peak, 1 / (1 + (d / scale)^2): the last metre."""
    return 1 / (1 + (d * d) * (1 / scale**2))


def approach(d: Tensor) -> Tensor:
    """-d, so that far away closer is better."""
    return -d


def action_rate(action: Tensor, previous: Tensor) -> Tensor:
    """Minus the squared change of the action [env, vehicle, action]."""
    return -(action - previous).square().sum(-1)


def clearance(gap: Tensor, reach: float) -> Tensor:
    """-(1 - gap / reach)^2 where the gap (m) to obstacles and team mates is below `reach`, else 0."""
    return -(1 - gap * (1 / reach)).clamp(0.0, 1.5).square()


def penalty(happened: Tensor) -> Tensor:
    """-1 where it happened: the paper's collision penalty (sec. 3.5), and that of an early ending."""
    return -happened.to(torch.get_default_dtype())
