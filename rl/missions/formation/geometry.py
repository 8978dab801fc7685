"""Where a team's vehicles are relative to their slots: one pure function from state to errors."""

from typing import NamedTuple

import torch
from torch import Tensor

from rl.missions.formation.observations import range_and_direction
from rl.missions.formation.slots import Target, slots


class Geometry(NamedTuple):
    """Errors of a team; [env, vehicle, ...]."""

    slot: Tensor  # [.., 3] position of the slot, NED, m
    slot_velocity: Tensor  # [.., 3] NED, m/s
    error: Tensor  # [.., 3] slot minus position, NED, m
    error_rate: Tensor  # [.., 3] NED, m/s
    distance: Tensor  # [..] norm of the error's first `axes` components, m
    error_b: Tensor  # [.., axes] in the body frame; for USVs in the heading frame, m
    error_rate_b: Tensor  # [.., axes] likewise, m/s
    course_b: Tensor  # [.., axes] unit vector of the target's course, likewise
    sight: Tensor  # [.., 1 + axes] squashed distance and unit direction, as observed


def geometry(position: Tensor, derived: Tensor, target: Target, offsets: Tensor, axes: int) -> Geometry:
    """Errors of vehicles at `position` [env, vehicle, 3] with `derived` [env, vehicle, 14] (kinematics.py)."""
    velocity = derived[..., 9:12]
    place = slots(target, position[:, 0], velocity[:, 0], offsets)
    error = place.position - position
    rate = place.velocity - velocity
    zero = torch.zeros_like(target.cos)
    course = torch.stack((target.cos, target.sin, zero), dim=-1).unsqueeze(1).expand_as(error)
    own = to_body(torch.stack((error, rate, course), dim=-2), derived, axes)
    error_b = own[..., 0, :]
    distance = torch.linalg.vector_norm(error_b, dim=-1)
    direction = error_b / distance.clamp(min=1e-3).unsqueeze(-1)
    sight = range_and_direction(distance, direction)
    return Geometry(
        place.position, place.velocity, error, rate, distance, error_b, own[..., 1, :], own[..., 2, :], sight
    )


def to_body(vectors: Tensor, derived: Tensor, axes: int) -> Tensor:
    """NED vectors [env, vehicle, k, 3] in the body frame (axes 3) or the heading frame (axes 2)."""
    if axes == 3:
        R_nb = derived[..., :9].unflatten(-1, (3, 3))
        return vectors @ R_nb
    c, s = derived[..., 12:13], derived[..., 13:14]
    north, east = vectors[..., 0], vectors[..., 1]
    return torch.stack((c * north + s * east, c * east - s * north), dim=-1)
