"""Initial states of boats and aircraft, [env, vehicle, 13] (taichi_sim/conventions.py)."""

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from taichi_sim.conventions import STATE_SIZE
from taichi_sim.kernels.rotation import torch_quaternion_from_euler

if TYPE_CHECKING:
    from rl.missions.escort.aircraft import EscortAircraft
    from rl.missions.escort.boats import EscortBoats

BOAT_SPEED = (0.5, 1.5)  # m/s at which boats begin; assumed
APART = 40.0  # m between aircraft that begin; assumed


def afloat(team: "EscortBoats", place: Tensor, heading: Tensor, generator: torch.Generator) -> Tensor:
    """Boats at `place` [env, boat, 2] (m) with `heading` [env, boat] (rad), at one speed in each environment."""
    heading = heading.to(team.fleet.state)
    state = _level(team, heading)
    state[..., :2] = place.to(state)
    low, high = BOAT_SPEED
    state[..., 7] = low + (high - low) * torch.rand((len(state), 1), generator=generator).to(state)
    return state


def aloft(team: "EscortAircraft", over: Tensor, generator: torch.Generator) -> Tensor:
    """Aircraft in steady flight over `over` [env, 2] (m), side by side at different heights, with a random heading."""
    count = team.fleet.count
    heading = (2 * math.pi * torch.rand((len(over), 1), generator=generator)).to(team.fleet.state).expand(-1, count)
    state = _level(team, heading)
    rank = (torch.arange(count, device=state.device) - (count - 1) / 2) * APART
    side = torch.stack((-heading.sin(), heading.cos()), dim=-1)
    state[..., :2] = over.unsqueeze(1).to(state) + rank.view(1, -1, 1) * side
    state[..., 2] = team.down
    state[..., 7] = team.fleet.model.limits.speeds[1]
    return state


def _level(team: "EscortBoats | EscortAircraft", heading: Tensor) -> Tensor:
    """At the origin, level, at rest, with `heading` [env, vehicle] (rad)."""
    state = team.fleet.state.new_zeros((*heading.shape, STATE_SIZE))
    state[..., 3:7] = torch_quaternion_from_euler(0 * heading, 0 * heading, heading)
    return state
