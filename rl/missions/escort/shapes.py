"""Formations of boats about the vessel that they escort: offsets in the frame of its course.

The vessel is at (0, 0). `ring` puts n boats at even angles on a circle of R = spacing max(1, 1 / (2 sin(pi / n))), the
leader astern. All other shapes are those of formations (rl/guidance/shapes.py) with the vessel as the leader.
"""

import math
from typing import Literal

import torch
from torch import Tensor

from rl.guidance.shapes import formation_offsets

Shape = Literal["abreast", "astern", "wedge", "echelon", "ring"]


def escort_offsets(shape: Shape, count: int, spacing: float) -> Tensor:
    """Offsets [boat, 2] (m, float64), ahead and to starboard of the vessel."""
    if shape == "ring":
        radius = spacing * (max(1.0, 0.5 / math.sin(math.pi / count)) if count > 1 else 1.0)
        angle = math.pi + 2 * math.pi / count * torch.arange(count, dtype=torch.float64)
        return radius * torch.stack((angle.cos(), angle.sin()), dim=1)
    return formation_offsets(shape, count + 1, spacing)[1:]
