"""Slots that pass through obstacles, which forces vehicles to evade."""

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.course.traffic import BOTTOM, EAST, NORTH, RADIUS, TOP

if TYPE_CHECKING:
    from rl.missions.formation.mission import Formation
    from rl.missions.formation.team import TeamTask


def slot_clearance(mission: "Formation", team: "TeamTask") -> Tensor:
    """Clearance (m) [env, vehicle] of each vehicle, if it were in its slot, to the side of the nearest obstacle.

    Obstacles that it would pass above or below do not count.
    """
    slot, radius = team.now.slot, team.radius
    height = -slot[..., 2:] if team.axes == 3 else torch.zeros_like(slot[..., 2:])
    stands, moves = mission.obstacles[mission.env_world].unsqueeze(1), mission.bodies.table.unsqueeze(1)
    bodies: list[tuple[Tensor | float, ...]] = [
        (stands[..., 0], stands[..., 1], stands[..., 2], -math.inf, stands[..., 3])
    ]
    if mission.bodies.present:
        bodies.append(tuple(moves[..., row, :] for row in (NORTH, EAST, RADIUS, BOTTOM, TOP)))
    nearest = torch.full_like(slot[..., 0], math.inf)
    for north, east, size, bottom, top in bodies:
        beside = torch.hypot(north - slot[..., :1], east - slot[..., 1:2]) - size - radius
        passed = (height - radius > top) | (height + radius < bottom)
        nearest = torch.minimum(nearest, beside.masked_fill(passed, math.inf).amin(-1))
    return nearest
