"""Whether slots go through obstacles, so that they have to be left."""

import math
from typing import Any

import torch
from torch import Tensor

from rl.course.traffic import BOTTOM, EAST, NORTH, RADIUS, TOP


def slot_clearance(mission: Any, team: Any) -> Tensor:
    """Distance (m) [env, vehicle] from each vehicle's sphere, were it in its slot, to the nearest obstacle's side.

    What it would pass above or below does not count.
    """
    slot, radius = team.now.slot, team.radius
    height = -slot[..., 2:] if team.axes == 3 else torch.zeros_like(slot[..., 2:])
    stands, moves = mission.obstacles[mission.env_world].unsqueeze(1), mission.bodies.table.unsqueeze(1)
    bodies: list[tuple[Any, ...]] = [(stands[..., 0], stands[..., 1], stands[..., 2], -math.inf, stands[..., 3])]
    if mission.bodies.present:
        bodies.append(tuple(moves[..., row, :] for row in (NORTH, EAST, RADIUS, BOTTOM, TOP)))
    nearest = torch.full_like(slot[..., 0], math.inf)
    for north, east, size, bottom, top in bodies:
        beside = torch.hypot(north - slot[..., :1], east - slot[..., 1:2]) - size - radius
        passed = (height - radius > top) | (height + radius < bottom)
        nearest = torch.minimum(nearest, beside.masked_fill(passed, math.inf).amin(-1))
    return nearest
