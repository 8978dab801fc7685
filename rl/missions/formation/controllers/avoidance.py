"""Velocities that leave room to stop: a barrier on how fast a vehicle nears what it senses.

Towards each sensed body, at a clearance h (m) beyond `MARGIN`, the closing speed is at most

    sqrt(2 a h)        (to stop, or turn aside, in h with the acceleration a),   -h / TAU where h < 0.

A desired velocity that closes faster loses the excess and is turned along the body's side at its old speed, to the
side it already leans to: all that as seen from the body, which moves at its own velocity. A team mate is taken to move
with the formation (its velocity is not sensed) and to do half of the avoiding. A body is a place and a clearance: its
radius is not sensed. Frame: NED.
"""

import torch
from torch import Tensor

from rl.missions.formation.team import TeamTask

MARGIN = 2.0  # m kept beyond contact; tuned on seeds 7 and 8
TAU = 0.5  # s to leave the margin again; assumed
ROOM = 25.0  # m: an arc that passes what is seen of an obstacle with that much passes the rest of it too; assumed
PASSES = 2  # a second one, because avoiding one body may lead towards another


def avoid(team: TeamTask, velocity: Tensor, acceleration: float, turn_rate: Tensor | None = None) -> Tensor:
    """The velocity [env, vehicle, 2 or 3] (m/s) nearest to `velocity` with which `team` keeps clear.

    acceleration  a, m/s^2
    turn_rate     [env, vehicle] or [env, 1], rad/s: how `velocity` turns. Obstacles that its arc passes by are left
                  alone; without it all that are near count.
    """
    given = velocity
    sensor, formation = team.sensor, team.now.slot_velocity[..., : team.axes]
    for _ in range(PASSES):
        for k in range(sensor.num_obstacles):
            seen = sensor.obstacles[..., k, :]
            toward, its = torch.zeros_like(velocity), torch.zeros_like(velocity)
            toward[..., :2], its[..., :2] = seen[..., 1:3], seen[..., 4:6]
            clear = seen[..., 0] - team.radius
            if turn_rate is not None:
                passed = passing(given - its, turn_rate, toward, clear) > ROOM
                toward = torch.where(passed.unsqueeze(-1), 0.0, toward)
            velocity = its + _turned(velocity - its, toward, clear, acceleration)
        for k in range(sensor.num_mates):
            seen = sensor.team_mates[..., k, :]
            toward = seen[..., 1 : 1 + team.axes]
            clearance = seen[..., 0] - 2 * team.radius
            velocity = formation + _turned(velocity - formation, toward, clearance, acceleration / 4)
    return velocity


def passing(velocity: Tensor, turn_rate: Tensor, toward: Tensor, distance: Tensor) -> Tensor:
    """Distance (m) [env, vehicle] at which the arc of a `velocity` that turns at `turn_rate` (rad/s) passes a place.

    The place is `distance` (m) away along the unit vector `toward`. About the arc's centre, V / turn_rate to starboard,
    the arc has the radius V / |turn_rate|.
    """
    course, speed = velocity[..., :2], velocity[..., :2].norm(dim=-1).clamp(min=1e-3)
    x = distance * (course * toward[..., :2]).sum(-1) / speed
    y = distance * (course[..., 0] * toward[..., 1] - course[..., 1] * toward[..., 0]) / speed
    bend = turn_rate / speed
    # |centre - place| - radius = (x^2 + y^2 - 2 y / bend) / (|centre - place| + radius), times |bend| above and below
    return (bend * (x * x + y * y) - 2 * y).abs() / (1 + torch.hypot(bend * x, 1 - bend * y))


def _turned(velocity: Tensor, toward: Tensor, clearance: Tensor, acceleration: float) -> Tensor:
    """`velocity` with its part along the unit vectors `toward` (zero where nothing is sensed) limited."""
    h = (clearance - MARGIN).unsqueeze(-1)
    limit = torch.where(h > 0, torch.sqrt(2 * acceleration * h.clamp(min=0.0)), h / TAU)
    closing = (velocity * toward).sum(-1, keepdim=True)
    aside = velocity - closing * toward
    starboard = torch.zeros_like(toward)  # for a body straight ahead
    starboard[..., 0], starboard[..., 1] = -toward[..., 1], toward[..., 0]
    norm = aside.norm(dim=-1, keepdim=True)
    direction = torch.where(norm > 1e-3, aside / norm.clamp(min=1e-3), starboard)
    speed = torch.sqrt((closing.square() + norm.square() - limit.square()).clamp(min=0.0))
    turned = limit * toward + torch.maximum(speed, norm) * direction
    sensed = toward.abs().sum(-1, keepdim=True) > 0
    return torch.where(sensed & (closing > limit), turned, velocity)
