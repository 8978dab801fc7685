"""Slots: where each vehicle of a line formation should be, as offsets from the leader in the path frame.

Its first axis is the target's course: (0, +-j spacing) in a line abreast, starboard first; (-i spacing, 0) astern. How
slots move is in geometry.py.
"""

import torch
from torch import Tensor


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
