"""States in which boats and aircraft begin an episode, [env, vehicle, 13] (taichi_sim/conventions.py)."""

import math
from typing import Any

import torch
from torch import Tensor

from rl.missions.landing.config import LandingConfig, LandingScenario
from taichi_sim.conventions import STATE_SIZE
from taichi_sim.kernels.rotation import torch_quaternion_from_euler


def afloat(team: Any, config: LandingScenario, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """Boats of `n` environments, abreast, on one course at speeds of their own; states, courses (rad), speeds (m/s)."""
    like, count = team.fleet.state, team.fleet.count
    draw = torch.rand((n, count + 1), generator=generator).to(like)
    course = (2 * math.pi * draw[:, :1]).expand(-1, count)
    low, high = config.course.speed
    speed = low + (high - low) * draw[:, 1:]
    state = like.new_zeros((n, count, STATE_SIZE))
    rank = (torch.arange(count, device=like.device) - (count - 1) / 2) * config.landing.apart
    state[..., 0], state[..., 1] = -rank * course.sin(), rank * course.cos()
    state[..., 3:7] = torch_quaternion_from_euler(0 * course, 0 * course, course)
    state[..., 7] = speed
    return state, course, speed


def aloft(team: Any, over: Tensor, config: LandingConfig, generator: torch.Generator) -> Tensor:
    """Aircraft in hover around places `over` [n, aircraft, 2] (m), headed any way."""
    like = team.fleet.state
    draw = torch.rand((*over.shape[:2], 4), generator=generator).to(like)
    (near, far), (low, high) = config.distance, config.height
    bearing, heading = 2 * math.pi * draw[..., 0], 2 * math.pi * draw[..., 1]
    distance = near + (far - near) * draw[..., 2]
    state = like.new_zeros((*over.shape[:2], STATE_SIZE))
    state[..., 0] = over[..., 0] + distance * bearing.cos()
    state[..., 1] = over[..., 1] + distance * bearing.sin()
    state[..., 2] = -(low + (high - low) * draw[..., 3])
    state[..., 3:7] = torch_quaternion_from_euler(0 * heading, 0 * heading, heading)
    return state
