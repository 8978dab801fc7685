"""What a vehicle observes; every term is [env, vehicle, n], scaled to be of order one.

`observations = "paper"` is sec. 3.3 (current and previous distance and direction to the target) and what partial
observability needs to avoid collisions: the nearest obstacles and team mates within the detection range. "full"
adds the error and its rate as vectors, own velocity, attitude and rates, the target's course, the previous action
and the role; of aircraft with air data, airspeed and wind too. Directions are in the body frame (of USVs: its
horizontal part), so a policy needs no compass.
"""

import torch
from torch import Tensor

DISTANCE_SCALE = 10.0  # m, where squashed distances are half way to 1
SPEED_SCALE = 10.0  # m/s, likewise for speeds
RATE_SCALE = 2.0  # rad/s, of own rotation
TURN_SCALE = 0.1  # rad/s, of the target's course


def squash(x: Tensor, scale: float) -> Tensor:
    """x / (|x| + scale): linear near zero, bounded by 1."""
    return x / (x.abs() + scale)


def range_and_direction(distance: Tensor, direction_b: Tensor) -> Tensor:
    """Squashed distance (m, [env, vehicle]) and unit direction [env, vehicle, 2 or 3]."""
    return torch.cat((squash(distance, DISTANCE_SCALE).unsqueeze(-1), direction_b), dim=-1)


def role(count: int, envs: int, like: Tensor) -> Tensor:
    """1 for the leader, 0 for followers: [env, vehicle, 1]."""
    flag = torch.zeros((envs, count, 1), dtype=like.dtype, device=like.device)
    flag[:, 0] = 1.0
    return flag
