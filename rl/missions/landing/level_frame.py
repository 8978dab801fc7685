"""Vectors in the level frame of a heading: ahead, starboard, down."""

import torch
from torch import Tensor


def into_level(vector: Tensor, heading: tuple[Tensor, Tensor]) -> Tensor:
    """Rotate vectors [.., 3] from NED into the level frame (ahead, starboard, down) of a `heading` (cosine, sine)."""
    c, s = heading
    x, y, z = vector.unbind(-1)
    return torch.stack((c * x + s * y, c * y - s * x, z), dim=-1)


def out_of_level(vector: Tensor, heading: tuple[Tensor, Tensor]) -> Tensor:
    """Rotate vectors [.., 3] from the level frame of a `heading` into NED; the inverse of `into_level`."""
    c, s = heading
    x, y, z = vector.unbind(-1)
    return torch.stack((c * x - s * y, s * x + c * y, z), dim=-1)
