"""Velocities that keep clear: past obstacles on a tangent, and with room to stop before team mates.

An obstacle of radius r at rest or in steady motion, at a horizontal distance D, is passed at the distance
R = r + own radius + `BERTH`. A velocity u relative to it that would come nearer (a velocity obstacle, Fiorini and
Shiller 1998) is turned, at its speed, to the nearer of the two tangents of that circle,

    |angle(u, p)| >= asin(R / D);   inside the circle away from it at (R - D) / TAU at least.

What is turned goes no faster than its slot: a vehicle that catches up at top speed has no thrust left to turn with.

It counts from when there is no more time than is needed to move aside by R with the acceleration a, `EARLY` times that.
What lies above or below by more than the own radius and `BERTH` is not in the way.

A team mate is taken to move with the formation (its velocity is not sensed) and to do half of the avoiding: the closing
speed is at most sqrt(2 a/4 h), to stop in the clearance h (m) beyond `MARGIN`, -h / TAU where h < 0. A velocity that
closes faster loses the excess and is turned along the mate's side at its old speed. Frame: NED.
"""

import torch
from torch import Tensor

from rl.missions.formation.team import TeamTask

MARGIN = 2.0  # m kept beyond contact with a team mate; tuned on seeds 7 and 8
BERTH = 2.0  # m likewise, of obstacles
TAU = 0.5  # s to leave the margin again; assumed
EARLY = 2.0  # assumed
CHANGE = 1e-3  # m/s: less of a change is rounding
LEAST_PACE = 0.3  # of a relative velocity, that is kept; assumed
ASTERN = 1.0  # weight of passing astern of what moves; chosen on seed 7
LEAN = 0.3  # weight of the wanted velocity beside the actual one in the choice of a side; assumed
ROOM = 25.0  # m: an arc that passes what is seen of an obstacle with that much passes the rest of it too; assumed
PASSES = 2  # a second one, because avoiding one body may lead towards another


def avoid(team: TeamTask, velocity: Tensor, acceleration: float, turn_rate: Tensor | None = None) -> Tensor:
    """The velocity [env, vehicle, 2 or 3] (m/s) nearest to `velocity` with which `team` keeps clear.

    acceleration  a, m/s^2
    turn_rate     [env, vehicle] or [env, 1], rad/s: how `velocity` turns. Obstacles that its arc passes by are left
                  alone; without it all that are near count.
    """
    given, actual = velocity, team.fleet.velocity_n[..., :2]
    sensor, formation = team.sensor, team.now.slot_velocity[..., : team.axes]
    for _ in range(PASSES):
        for k in range(sensor.num_obstacles):
            seen = sensor.obstacles[..., k, :]
            toward, its, own = seen[..., 1:3], seen[..., 4:6], velocity[..., :2]
            level = seen[..., 0] - seen[..., 7].clamp(min=0.0) < team.radius + BERTH
            near = level & (toward.abs().sum(-1) > 0)
            if turn_rate is not None:
                past = passing(given[..., :2] - its, turn_rate, toward, seen[..., 0] - team.radius) > ROOM
                near &= ~past
            lean = actual - its + LEAN * (own - its) - ASTERN * its
            radius = seen[..., 6] + team.radius + BERTH
            past = tangent(own - its, lean, toward, seen[..., 7] + seen[..., 6], radius, acceleration)
            changed = near & ((past - (own - its)).norm(dim=-1) > CHANGE)
            turned = its + _paced(past, its, formation[..., :2].norm(dim=-1))
            velocity = torch.cat((torch.where(changed.unsqueeze(-1), turned, own), velocity[..., 2:]), dim=-1)
        for k in range(sensor.num_mates):
            seen = sensor.team_mates[..., k, :]
            toward = seen[..., 1 : 1 + team.axes]
            clearance = seen[..., 0] - 2 * team.radius
            velocity = formation + _turned(velocity - formation, toward, clearance, acceleration / 4)
    return velocity


def tangent(
    velocity: Tensor, lean: Tensor, toward: Tensor, distance: Tensor, radius: Tensor, acceleration: float
) -> Tensor:
    """A horizontal `velocity` [.., 2] relative to a circle, turned so that it passes by.

    toward: unit vector to its centre. distance: to its centre, m. radius: of the circle, m.
    """
    speed = velocity.norm(dim=-1).clamp(min=1e-3)
    along = (velocity * toward).sum(-1)
    aside = toward[..., 0] * lean[..., 1] - toward[..., 1] * lean[..., 0]  # to starboard of the centre
    side = torch.where(aside < 0, -1.0, 1.0)
    sine = (radius / distance.clamp(min=1e-3)).clamp(max=1.0)
    cosine = (1 - sine * sine).sqrt()
    hits = (along > 0) & (along > cosine * speed)
    needed = EARLY * torch.sqrt(2 * radius / acceleration)
    soon = distance - radius < along * needed
    starboard = torch.stack((-toward[..., 1], toward[..., 0]), dim=-1)
    past = speed.unsqueeze(-1) * (cosine.unsqueeze(-1) * toward + (side * sine).unsqueeze(-1) * starboard)
    out = (radius - distance).clamp(min=0.0) / TAU  # inside the circle
    past = torch.where((distance < radius).unsqueeze(-1), past - out.unsqueeze(-1) * toward, past)
    return torch.where((hits & soon).unsqueeze(-1) | (distance < radius).unsqueeze(-1), past, velocity)


def _paced(relative: Tensor, its: Tensor, most: Tensor) -> Tensor:
    """`relative` [.., 2], shortened so that with the obstacle's velocity `its` it is at most `most` [..], m/s."""
    square, along = relative.square().sum(-1).clamp(min=1e-6), (relative * its).sum(-1)
    room = (most.square() - its.square().sum(-1)).clamp(min=0.0)
    share = (torch.sqrt(along.square() + room * square) - along) / square
    return relative * share.clamp(LEAST_PACE, 1.0).unsqueeze(-1)


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
