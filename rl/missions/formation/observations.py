"""What a vehicle observes; every term is [env, vehicle, n], scaled to be of order one.

`observations = "paper"` is sec. 3.3 (current and previous distance and direction to the target) and what partial
observability needs to avoid collisions: the nearest obstacles and team mates within the detection range. "full"
adds the error and its rate as vectors, own velocity, attitude and rates, the target's course, the previous action
and the role; of aircraft with air data, airspeed and wind too. Directions are in the body frame (of USVs: its
horizontal part), so a policy needs no compass.
"""

from typing import Any

import torch
from torch import Tensor

from rl.missions.formation.geometry import DISTANCE_SCALE, squash, to_body

SPEED_SCALE = 10.0  # m/s, likewise for speeds
RATE_SCALE = 2.0  # rad/s, of own rotation
TURN_SCALE = 0.1  # rad/s, of the target's course


def role(count: int, envs: int, like: Tensor) -> Tensor:
    """1 for the leader, 0 for followers: [env, vehicle, 1]."""
    flag = torch.zeros((envs, count, 1), dtype=like.dtype, device=like.device)
    flag[:, 0] = 1.0
    return flag


def terms(team: Any, kind: str) -> dict[str, Tensor]:
    """Named terms of a team (team.py), in order; `kind` is "paper" or "full"."""
    found = {"sight": team.now.sight, "previous_sight": team.now.previous_sight, "surroundings": team.sensor.signals}
    return found | full_terms(team) if kind == "full" else found


def full_terms(team: Any) -> dict[str, Tensor]:
    """What "full" adds."""
    fleet, target, now = team.fleet, team.target, team.now
    turn = (target.course_rate * (1 / TURN_SCALE)).view(-1, 1, 1).expand(*team.distance.shape, 1)
    return {
        "error": squash(now.error_b, DISTANCE_SCALE),
        "error_rate": squash(now.error_rate_b, SPEED_SCALE),
        "velocity": squash(fleet.velocity_b, SPEED_SCALE),
        "down": fleet.down_b,  # roll and pitch without a jump
        "rates": fleet.angular_velocity_b * (1 / RATE_SCALE),
        "target_course": now.course_b,
        "target_turn": turn,
        "previous_action": team.action,
        "role": team.role,
        **air_terms(team),
    }


def air_terms(team: Any) -> dict[str, Tensor]:
    """What an aircraft in wind steers by: its airspeed within the range it can fly, and the wind in b."""
    fleet = team.fleet
    if "airspeed" not in fleet.model.aux_names or fleet.model.air is None:
        return {}
    low, cruise, high = fleet.model.limits.speeds
    wind = torch.stack([fleet.reading(name) for name in fleet.model.air], dim=-1)
    wind_b = to_body(wind.unsqueeze(-2), fleet.derived, team.axes).squeeze(-2)
    airspeed = (fleet.reading("airspeed") - cruise) * (2 / (high - low))
    return {"airspeed": airspeed.unsqueeze(-1), "wind": squash(wind_b, SPEED_SCALE)}
