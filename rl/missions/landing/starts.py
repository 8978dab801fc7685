"""States in which boats and aircraft begin an episode, [env, vehicle, 13] (taichi_sim/conventions.py)."""

import math
from typing import Any

import torch
from torch import Tensor

from rl.missions.landing.config import LandingConfig, LandingScenario
from taichi_sim.config import ConfigError
from taichi_sim.conventions import DOWN, EAST, NORTH, QUATERNION, STATE_SIZE, SURGE
from taichi_sim.kernels.rotation import torch_quaternion_from_euler

TRIES = 50  # draws of places, until all aircraft are apart
SPACED = 4.0  # least distance between two aircraft as an episode begins, over their collision radius; assumed


def afloat(team: Any, config: LandingScenario, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Boats of `n` environments, abreast, on one course at speeds of their own; states, courses (rad), speeds (m/s)."""
    like, count = team.fleet.state, team.fleet.count
    draw = torch.rand((n, count + 1), generator=generator).to(like)
    course = (2 * math.pi * draw[:, :1]).expand(-1, count)
    low, high = config.course.speed
    speed = low + (high - low) * draw[:, 1:]
    state = like.new_zeros((n, count, STATE_SIZE))
    rank = (torch.arange(count, device=like.device) - (count - 1) / 2) * config.landing.apart
    state[..., NORTH], state[..., EAST] = -rank * course.sin(), rank * course.cos()
    state[..., QUATERNION] = torch_quaternion_from_euler(0 * course, 0 * course, course)
    state[..., SURGE] = speed
    return state, course, speed


def aloft(team: Any, over: Tensor, config: LandingConfig, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Aircraft in hover around places `over` [n, aircraft, 2] (m), headed any way; states, and unit vectors
    [n, aircraft, 2] from those places to them. Aircraft of one deck are evenly spaced around it, within a quarter of
    that.

    Raises:
        ConfigError: where two aircraft would begin in one place.
    """
    like, n = team.fleet.state, len(over)
    state = like.new_zeros((*over.shape[:2], STATE_SIZE))
    away = like.new_zeros((*over.shape[:2], 2))
    rows = torch.arange(n, device=like.device)
    for _ in range(TRIES):
        draw = torch.rand((len(rows), over.shape[1], 4), generator=generator).to(like)
        side, heading, apart, up = draw.unbind(-1)
        (near, far), (low, high) = config.distance, config.height
        if not team.alone:
            first, each = side[:, team.boat_of], 1 / (int(team.rank.max()) + 1)
            spaced = first + each * (team.rank + 0.5 * (side - 0.5))
            side = torch.where(team.rank == 0, first, spaced)
        bearing, heading, distance = 2 * math.pi * side, 2 * math.pi * heading, near + (far - near) * apart
        away[rows] = torch.stack((bearing.cos(), bearing.sin()), dim=-1)
        state[rows, :, :2] = over[rows] + distance.unsqueeze(-1) * away[rows]
        state[rows, :, DOWN] = -(low + (high - low) * up)
        state[rows, :, QUATERNION] = torch_quaternion_from_euler(0 * heading, 0 * heading, heading)
        apart = torch.cdist(state[..., :3], state[..., :3])
        apart.diagonal(dim1=1, dim2=2).fill_(math.inf)
        rows = (apart.flatten(1).amin(1) < SPACED * team.fleet.model.collision_radius).nonzero().flatten()
        if not len(rows):
            return state, away
    raise ConfigError(
        f"landing.distance = {list(config.distance)}, landing.height = {list(config.height)}, landing.apart = "
        f"{config.apart:g}: two aircraft would begin in one place, {float(apart.amin()):.3g} m from each other; "
        f"allowed are {SPACED * team.fleet.model.collision_radius:g} m or more"
    )
