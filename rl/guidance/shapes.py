"""Shapes of a formation: where vehicles are about their leader, in the path frame.

Its first axis is the target's course, the second is to starboard of it. Vehicle 0 leads and is at (0, 0). Where a shape
has two sides, odd numbers are to starboard and even ones to port, the nearest first; vehicle i is in rank
j = ceil(i / 2), on the side sigma = +1 of odd and -1 of even i. With a spacing of 1:

    abreast    (0, sigma j)
    astern     (-i, 0)
    wedge      (-j, sigma j) / sqrt(2): a V behind the leader, whose arms are at right angles
    echelon    (-i, i) / sqrt(2)
    pairs      (-floor(i / 2), i mod 2): a column of pairs, in which the leader has the first place to port
    circle     (R cos(theta) - R, R sin(theta)), theta = sigma j 2 pi / n, R = 1 / (2 sin(pi / n)): the leader foremost

No two vehicles are nearer than the spacing.

An escort has the vessel at (0, 0) and all boats about it: its shapes are those above with the vessel as the leader, and
`ring`, n boats at even angles on a circle of R = spacing max(1, 1 / (2 sin(pi / n))), the first astern.
"""

import math
from collections.abc import Callable, Iterable
from typing import Literal

import torch
from torch import Tensor

Shape = Literal["abreast", "astern", "wedge", "echelon", "pairs", "circle"]
EscortShape = Literal["abreast", "astern", "wedge", "echelon", "ring"]


def _sides(i: Tensor) -> tuple[Tensor, Tensor]:
    """Rank, and rank times side, of vehicles `i`."""
    rank = torch.ceil(i / 2)
    return rank, torch.where(i % 2 == 1, rank, -rank)


def _circle(i: Tensor) -> tuple[Tensor, Tensor]:
    radius = 0.5 / math.sin(math.pi / len(i)) if len(i) > 1 else 0.0
    angle = _sides(i)[1] * (2 * math.pi / len(i))
    return radius * (angle.cos() - 1), radius * angle.sin()


SHAPES: dict[Shape, Callable[[Tensor], tuple[Tensor, Tensor]]] = {
    "abreast": lambda i: (torch.zeros_like(i), _sides(i)[1]),
    "astern": lambda i: (-i, torch.zeros_like(i)),
    "wedge": lambda i: (-_sides(i)[0] * math.sqrt(0.5), _sides(i)[1] * math.sqrt(0.5)),
    "echelon": lambda i: (-i * math.sqrt(0.5), i * math.sqrt(0.5)),
    "pairs": lambda i: (-torch.floor(i / 2), i % 2),
    "circle": _circle,
}
"""Name -> ahead and to starboard, each [vehicle], of vehicles numbered 0, 1, .. with a spacing of 1."""


def formation_offsets(shape: Shape, count: int, spacing: float) -> Tensor:
    """Offsets [vehicle, 2] (m, float64) ahead and to starboard of the leader; the leader's is zero."""
    return spacing * torch.stack(SHAPES[shape](torch.arange(count, dtype=torch.float64)), dim=1)


def lane_half_width(shapes: Iterable[Shape], count: int, spacing: float) -> float:
    """Largest distance (m) of a slot from the leader, sideways, in any of `shapes`."""
    return max(float(formation_offsets(shape, count, spacing)[:, 1].abs().max()) for shape in shapes)


def escort_offsets(shape: EscortShape, count: int, spacing: float) -> Tensor:
    """Offsets [boat, 2] (m, float64) of an escort, ahead and to starboard of the vessel."""
    if shape == "ring":
        radius = spacing * (max(1.0, 0.5 / math.sin(math.pi / count)) if count > 1 else 1.0)
        angle = math.pi + 2 * math.pi / count * torch.arange(count, dtype=torch.float64)
        return radius * torch.stack((angle.cos(), angle.sin()), dim=1)
    return formation_offsets(shape, count + 1, spacing)[1:]
