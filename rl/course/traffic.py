"""Moving obstacles that cross the lanes, at constant course and speed or with the current.

An obstacle is a vertical cylinder between two heights above the sea. Each start of each world has its own (a mission
says where starts are). Each is timed to meet one vehicle of the team, if that stays in its place. Number, size and
speed are assumed:

    crossing    at 50 to 130 degrees to the track, from either side
    overtaken   along the track within 15 degrees, slower than the team, which overtakes it
    drifting    carried by the current

No moving obstacle passes through a fixed one, near the start of a vehicle, or near another that is close at the same
time. Frame: NED, m from the centre.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from rl.course.obstacles import Cylinder
from rl.course.tracks import Tracks
from taichi_sim.recording.overlays import Cylinders

NORTH, EAST, RADIUS, BOTTOM, TOP, V_NORTH, V_EAST, CARRIED, ROWS = range(9)  # rows of a moving obstacle
CROSSING, OVERTAKING, DRIFTING = range(3)
CROSSING_ANGLE = math.radians(50.0), math.radians(130.0)
OVERTAKING_ANGLE = math.radians(15.0)
MEETING = 0.2, 0.9  # of an episode's duration: between these a body meets the team
DRAWS = 40  # of a body, until it is in nobody's way
AIM = 0.8  # of its radius, the most by which a body's axis would pass beside the vehicle that it meets
ROOM_M = 10.0  # between the surfaces of a body and of an obstacle, or of another body, at the least
HEAD_START = 3.0  # s that a body and a team on collision course are apart when an episode begins, at the least
INSTANTS = 24  # of an episode at which a body's path is checked
AWAY = 1e6  # m: where what is not there is put
COLOUR = (196, 120, 40)  # in recordings


class Span(NamedTuple):
    """Size and meeting points of one kind of moving obstacle.

    Heights (m) above the sea of its ends, its radii (m), and the places in the team that it meets:
    [world, start, vehicle, 2], ahead and to starboard of the target (m).
    """

    bottom: float
    top: tuple[float, float]
    radius: tuple[float, float]
    places: Tensor


@dataclass(frozen=True)
class Traffic:
    """Parameters of the moving obstacles.

    Attributes:
        count: obstacles of each span and start.
        spans: one for boats, one for aircraft.
        drifting, overtaking: shares of all obstacles; the rest crosses.
        speed: least and greatest over ground, m/s.
        current: mean velocity of the water, north and east, m/s.
        duration: of an episode, s.
        team_speed: along the track, m/s.
    """

    count: int
    spans: tuple[Span, ...]
    drifting: float
    overtaking: float
    speed: tuple[float, float]
    current: tuple[float, float]
    duration: float
    team_speed: float

    @property
    def bodies(self) -> int:
        """Number of moving obstacles for each start."""
        return self.count * len(self.spans)

    def draw(
        self, tracks: Tracks, progress: Tensor, starts: Tensor, obstacles: Tensor, generator: torch.Generator
    ) -> Tensor:
        """Moving obstacles [world, start, 8, body] at the beginning of an episode; the constants above name the 8 rows.

        Args:
            tracks: the tracks of the worlds.
            progress: [world, start], m along the track to where the target begins.
            starts: [world, start, vehicle, 2], m, where vehicles begin.
            obstacles: fixed obstacles [world, n, 4]: north, east, radius, height.
            generator: of random numbers.

        Raises:
            ValueError: if more than a tenth of them find no way between the fixed obstacles.
        """
        shape = progress.shape
        found = torch.zeros((*shape, ROWS, self.bodies))
        found[..., NORTH, :] = AWAY
        missing = 0
        for k in range(self.bodies):
            span = self.spans[k % len(self.spans)]
            open_ = torch.ones(shape, dtype=torch.bool)
            for _ in range(DRAWS):
                body = self._drawn(tracks, progress, span, generator)
                fits = open_ & self._free(body, starts, obstacles, found[..., :k])
                found[..., k] = torch.where(fits.unsqueeze(-1), body, found[..., k])
                open_ &= ~fits
                if not open_.any():
                    break
            missing += int(open_.sum())
        if missing > 0.1 * progress.numel() * self.bodies:
            raise ValueError(
                f"{missing} of {progress.numel() * self.bodies} moving obstacles find no way between the fixed ones: "
                "lower obstacles.count or obstacles.radius_max"
            )
        return found

    def _drawn(self, tracks: Tracks, progress: Tensor, span: Span, generator: torch.Generator) -> Tensor:
        """A candidate for each start, [world, start, 8], without any check."""

        def uniform(low: float, high: float) -> Tensor:
            return low + (high - low) * torch.rand(progress.shape, generator=generator)

        world = torch.arange(progress.shape[0]).unsqueeze(1).expand(progress.shape).contiguous()
        when, radius = self.duration * uniform(*MEETING), uniform(*span.radius)
        whose = torch.randint(span.places.shape[2], progress.shape, generator=generator)
        ahead, aside = span.places.gather(2, whose[..., None, None].expand(*whose.shape, 1, 2))[:, :, 0].unbind(-1)
        place = tracks.at(world, progress + self.team_speed * when)
        ahead, aside = (x + AIM * radius * uniform(-1.0, 1.0) / math.sqrt(2) for x in (ahead, aside))
        kind, side = uniform(0.0, 1.0), torch.where(uniform(-1.0, 1.0) < 0, -1.0, 1.0)
        turn = torch.where(
            kind < self.drifting + self.overtaking, uniform(-OVERTAKING_ANGLE, OVERTAKING_ANGLE),
            side * uniform(*CROSSING_ANGLE),
        )  # fmt: skip
        slowest = min(self.speed[0], 0.7 * self.team_speed)
        slower = uniform(slowest, min(self.speed[1], 0.7 * self.team_speed))
        speed = torch.where(kind < self.drifting + self.overtaking, slower, uniform(*self.speed))
        carried = (kind < self.drifting).float()
        course = place.course + turn
        velocity = (1 - carried).unsqueeze(-1) * speed.unsqueeze(-1) * torch.stack((course.cos(), course.sin()), -1)
        water = carried.unsqueeze(-1) * torch.tensor(self.current)
        starboard = torch.stack((-place.course.sin(), place.course.cos()), dim=-1)
        forward = torch.stack((place.course.cos(), place.course.sin()), dim=-1)
        meeting = place.position + ahead.unsqueeze(-1) * forward + aside.unsqueeze(-1) * starboard
        begin = meeting - (velocity + water) * when.unsqueeze(-1)
        heights = torch.full_like(when, span.bottom), uniform(*span.top)
        return torch.stack((*begin.unbind(-1), radius, *heights, *velocity.unbind(-1), carried), dim=-1)

    def _free(self, body: Tensor, starts: Tensor, obstacles: Tensor, others: Tensor) -> Tensor:
        """Whether its way is free of fixed and other moving obstacles and of the vehicles' starts, [world, start]."""
        time = torch.linspace(0.0, self.duration, INSTANTS)
        velocity = body[..., V_NORTH : V_EAST + 1] + body[..., CARRIED, None] * torch.tensor(self.current)
        way = body[..., None, :2] + velocity.unsqueeze(-2) * time.unsqueeze(-1)  # [world, start, instant, 2]
        fine = torch.ones(body.shape[:2], dtype=torch.bool)
        if obstacles.shape[1]:
            begin, end = body[..., None, :2], (body[..., :2] + self.duration * velocity).unsqueeze(-2)
            along = end - begin
            to = obstacles[:, None, :, :2] - begin
            share = (to * along).sum(-1) / along.square().sum(-1).clamp(min=1e-6)
            apart = (to - share.clamp(0.0, 1.0).unsqueeze(-1) * along).norm(dim=-1)
            fine &= (apart > obstacles[:, None, :, Cylinder.RADIUS] + body[..., RADIUS, None] + ROOM_M).all(-1)
        near = (starts - body[..., None, :2]).norm(dim=-1).amin(-1)
        closing = velocity.norm(dim=-1) + self.team_speed
        fine &= near > body[..., RADIUS] + HEAD_START * closing
        for k in range(others.shape[-1]):
            other = others[..., k]
            speed = other[..., V_NORTH : V_EAST + 1] + other[..., CARRIED, None] * torch.tensor(self.current)
            its = other[..., None, :2] + speed.unsqueeze(-2) * time.unsqueeze(-1)
            fine &= ((its - way).norm(dim=-1) > (other[..., RADIUS] + body[..., RADIUS] + ROOM_M).unsqueeze(-1)).all(-1)
        return fine


class Bodies:
    """The moving obstacles of every environment.

    Attributes:
        table: [env, 8, body], written in place; drifting ones have the velocity of the water.
        present: whether there are any.
    """

    STATE = ("table",)

    def __init__(self, num_envs: int, pool: Tensor):
        """Use the moving obstacles of all starts, `pool` [world, start, 8, body]; without any, one is far away."""
        self.present = pool.shape[-1] > 0
        self._pool = pool
        self.table = pool.new_zeros((num_envs, ROWS, max(pool.shape[-1], 1)))
        self.table[:, NORTH] = AWAY

    def begin(self, envs: Tensor, worlds: Tensor, starts: Tensor, current: Tensor) -> None:
        """Begin episodes in environments `envs` [n] on `worlds` from `starts`; `current` as for `move`."""
        if self.present:
            self.table[envs] = self._pool[worlds, starts]
            self.move(0.0, current)  # sets the velocity of drifting bodies

    def move(self, interval: float, current: Tensor) -> None:
        """Move all by `interval` (s), in water with the velocity `current` [env, 2], m/s."""
        if self.present:
            velocity, carried = self.table[:, V_NORTH : V_EAST + 1], self.table[:, CARRIED : CARRIED + 1]
            velocity += carried * (current.unsqueeze(-1) - velocity)
            self.table[:, : EAST + 1] += interval * velocity

    def cylinders(self, env: int, area: float) -> tuple[Cylinders, ...]:
        """The bodies of an environment now, for recordings; those outside of `area` (m, side) are not drawn."""
        if not self.present:
            return ()
        table = self.table[env].double().cpu().numpy()[None]
        place = np.stack((table[:, NORTH], table[:, EAST], -0.5 * (table[:, BOTTOM] + table[:, TOP])), axis=-1)
        place[np.abs(table[:, NORTH]) > area] = np.nan
        size = np.stack((table[:, RADIUS], table[:, TOP] - table[:, BOTTOM]), axis=-1)
        return (Cylinders(name="traffic", colour=COLOUR, position_n=place, size_m=size),)
