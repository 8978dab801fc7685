"""Obstacles of a course: vertical cylinders that stand beside the track, and traffic that crosses the lanes.

The paper (sec. 4) has several obstacles and gives no numbers; all numbers here are assumed. The lap is divided into
`count` equal stretches with one obstacle each, on either side. Tall obstacles end at least `HEIGHT_BAND_M` above the
aircraft's flight height, all others as far below it, so that an obstacle clearly is in an aircraft's way or not.

A drawn obstacle is accepted if it keeps its distance from the whole track and from its neighbours and lies in the area.
Otherwise it is drawn again, further along the track and later also further out.

A moving obstacle lies between two heights above the sea, and keeps its course and speed or drifts with the current.
Each start of each world has its own (a mission says where starts are). Each is timed to meet one vehicle of the team,
if that stays in its place. Number, size and speed are assumed:

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

from rl.guidance.course.tracks import Real, Tracks, TrackSample, world_uniform
from taichi_sim.config import Finite, Positive, Strict
from taichi_sim.state.memory import Remembers
from taichi_sim.visualisation.recording.overlays import Cylinders

OBSTACLE_STREAM = 1 << 16  # random stream of the first round; each round has the next one
ROUNDS = 48
STRETCH_GROWTH = 0.25  # per round: growth of the stretch of track for an obstacle
PATIENCE = 16  # rounds before obstacles may stand further out than clearance_m says
OUTWARD_GROWTH = 0.1  # per later round: growth of the greatest clearance
TRACK_CLEARANCE_M = 12.0  # default distance from an obstacle's surface to the track
LEAST_SPREAD_M = 2.0  # least range of distances, so that there is room
PASSAGE_M = 10.0  # least gap between two obstacles
HEIGHT_BAND_M = 10.0  # no obstacle ends within this distance of the flight height
CHUNK = 1024  # obstacles measured at once
BLOCK = 16  # samples of a track that are left out together where they are far
ROUNDING_M = 1e-3  # float32 at 1.5 km

NORTH, EAST, RADIUS, BOTTOM, TOP, V_NORTH, V_EAST, CARRIED, ROWS = range(9)  # rows of a moving obstacle
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


class Cylinder:
    """Columns of a table of fixed obstacles: place of the axis, radius, height above mean sea level, m."""

    NORTH, EAST, RADIUS, HEIGHT, SIZE = range(5)


class FixedObstacle(Strict):
    """A vertical cylinder that stands in every world."""

    north: Finite  # m
    east: Finite  # m
    radius: Positive  # m
    height: Positive  # above mean sea level, m


def generate_obstacles(
    tracks: Tracks,
    seed: int,
    *,
    count: int = 24,
    lane_half_width_m: float,
    clearance_m: tuple[float, float] = (6.0, 60.0),
    track_clearance_m: float = TRACK_CLEARANCE_M,
    radius_m: tuple[float, float] = (3.0, 10.0),
    height_m: tuple[float, float] = (5.0, 90.0),
    tall_fraction: float = 0.4,
    flight_height_m: float = 60.0,
    area_m: float = 3000.0,
) -> Tensor:
    """Draw `count` cylinders for each world; return float32 [world, count, 4]: north, east, radius, height (m).

    World w depends only on its track, the seed and w. Obstacles are numbered roughly along the track.

    Args:
        tracks: the tracks.
        seed: of the draw.
        count: obstacles in each world.
        lane_half_width_m: distance from the track to the outer edge of the widest formation's lanes.
        clearance_m: least and, where possible, greatest distance from an obstacle's surface to the edge of the lanes; a
            negative value allows obstacles in followers' lanes.
        track_clearance_m: least distance from an obstacle's surface to the track.
        radius_m, height_m: least and greatest.
        tall_fraction: share of obstacles that reach above flight_height_m + 10; the others stay below
            flight_height_m - 10, or at height_m[0] if that is higher.
        flight_height_m: of the aircraft.
        area_m: side of the square area.
    """
    _check(count, lane_half_width_m, clearance_m, radius_m, height_m, tall_fraction, flight_height_m)
    worlds = tracks.worlds
    size, rank, share = np.moveaxis(world_uniform(seed, OBSTACLE_STREAM, worlds, count, 3), -1, 0)
    radius = radius_m[0] + (radius_m[1] - radius_m[0]) * size
    height = _heights(rank, share, height_m, tall_fraction, flight_height_m)
    obstacle = torch.zeros(worlds, count, 4)
    obstacle[..., 2:] = torch.from_numpy(np.stack((radius, height), axis=-1))

    nearest = max(lane_half_width_m + clearance_m[0], track_clearance_m)
    furthest = max(lane_half_width_m + clearance_m[1], nearest + LEAST_SPREAD_M)
    placed = torch.zeros(worlds, count, dtype=torch.bool)
    for round_ in range(ROUNDS):
        world, number = (~placed).nonzero(as_tuple=True)
        if world.numel() == 0:
            return obstacle
        draw = torch.from_numpy(world_uniform(seed, OBSTACLE_STREAM + 1 + round_, worlds, count, 3))
        along, side, out = draw[world, number].float().unbind(-1)
        s = (number + 0.5 + (along - 0.5) * (1 + STRETCH_GROWTH * round_)) / count * tracks.length_m[world]
        widest = nearest + (furthest - nearest) * (1 + OUTWARD_GROWTH * max(0, round_ - PATIENCE))
        offset = nearest + (widest - nearest) * out + obstacle[world, number, Cylinder.RADIUS]
        offset = torch.where(side < 0.5, offset, -offset)
        track = tracks.at(world, s)
        starboard = torch.stack((-track.course.sin(), track.course.cos()), dim=-1)
        obstacle[world, number, :2] = track.position + offset[:, None] * starboard

        drawn = obstacle[world, number]
        fits = (drawn[:, :2].abs() + drawn[:, 2:3] <= area_m / 2).all(dim=-1)
        fits &= distance_to_tracks(tracks, world, drawn[:, :2]) >= nearest + drawn[:, Cylinder.RADIUS] + ROUNDING_M
        candidate = placed.clone()
        candidate[world, number] = fits
        placed = candidate & (placed | ~_hits_earlier(obstacle, candidate, placed))
    missing = int((~placed).sum())
    if missing == 0:
        return obstacle
    raise ValueError(
        f"no room for {missing} of {worlds * count} obstacles: lower count={count}, radius_m={radius_m} or "
        f"lane_half_width_m={lane_half_width_m:g} + clearance_m={clearance_m}, or raise area_m={area_m:g}"
    )


def distance_to_tracks(tracks: Tracks, world: Tensor, position: Tensor) -> Tensor:
    """Distance [point] (m) of `position` [point, 2] from the whole track of `world` [point], rounded down.

    It is the distance to the polyline through all samples, minus the greatest bow of the arc over its chord.
    """
    here = tracks.table[..., :2]
    chord = here.roll(-1, dims=1) - here
    per_chord2 = 1 / chord.square().sum(dim=-1)
    spacing = tracks.length_m / tracks.samples
    bow = tracks.table[..., TrackSample.CURVATURE].abs().amax(dim=1) * spacing**2 / 8
    reach = BLOCK * chord.square().sum(dim=-1).amax().sqrt()  # from a block's first sample to its last
    first = here[:, ::BLOCK].permute(2, 0, 1).contiguous()
    nearest = [torch.empty(0)]
    for w, p in zip(world.split(CHUNK), position.split(CHUNK), strict=True):
        gap = torch.hypot(*(p.T[:, :, None] - first[:, w]))
        point, block = (gap <= gap.amin(dim=1, keepdim=True) + reach).nonzero(as_tuple=True)  # others are further
        sample = (block[:, None] * BLOCK + torch.arange(BLOCK)) % tracks.samples
        of = w[point, None]
        along_n, along_e = chord[of, sample].unbind(-1)
        from_n, from_e = (p[point, None] - here[of, sample]).unbind(-1)
        f = ((from_n * along_n + from_e * along_e) * per_chord2[of, sample]).clamp_(0, 1)
        gap2 = ((from_n - f * along_n).square_() + (from_e - f * along_e).square_()).amin(dim=1)
        least = torch.full((len(p),), math.inf).scatter_reduce_(0, point, gap2, "amin")
        nearest.append(least.sqrt_() - bow[w])
    return torch.cat(nearest)


def _hits_earlier(obstacle: Tensor, candidate: Tensor, placed: Tensor) -> Tensor:
    """Whether each obstacle [world, count] is too near a placed obstacle or a candidate with a lower number."""
    apart = torch.hypot(*(obstacle[:, :, None, i] - obstacle[:, None, :, i] for i in (0, 1)))
    room = obstacle[:, :, None, Cylinder.RADIUS] + obstacle[:, None, :, Cylinder.RADIUS] + PASSAGE_M
    earlier = torch.ones(obstacle.shape[1], obstacle.shape[1], dtype=torch.bool).tril(-1)
    itself = torch.eye(obstacle.shape[1], dtype=torch.bool)
    rival = (placed[:, None, :] | (candidate[:, None, :] & earlier)) & ~itself
    return ((apart < room) & rival).any(dim=-1)


def _heights(rank: Real, share: Real, height_m: tuple[float, float], tall_fraction: float, flight: float) -> Real:
    """Heights [world, count] (m): the lowest `rank` are tall; `share` is the position within the height range."""
    count = rank.shape[1]
    tall = rank.argsort(axis=1).argsort(axis=1) < round(tall_fraction * count)
    low = np.where(tall, max(height_m[0], flight + HEIGHT_BAND_M), height_m[0])
    high = np.where(tall, height_m[1], max(height_m[0], min(height_m[1], flight - HEIGHT_BAND_M)))
    return high - (high - low) * share


def _check(
    count: int,
    lane_half_width_m: float,
    clearance_m: tuple[float, float],
    radius_m: tuple[float, float],
    height_m: tuple[float, float],
    tall_fraction: float,
    flight_height_m: float,
) -> None:
    """Refuse parameters that no placement can satisfy; the message names the parameter and its range."""
    tall = flight_height_m + HEIGHT_BAND_M
    for name, value, low, high in (
        ("count", count, 0, math.inf),
        ("lane_half_width_m", lane_half_width_m, 0.0, math.inf),
        ("clearance_m[1]", clearance_m[1], clearance_m[0], math.inf),
        ("radius_m[0]", radius_m[0], 0.0, math.inf),
        ("radius_m[1]", radius_m[1], radius_m[0], math.inf),
        ("height_m[0]", height_m[0], 0.0, tall if round(tall_fraction * count) < count else math.inf),
        ("height_m[1]", height_m[1], height_m[0], math.inf),
        ("tall_fraction", tall_fraction, 0.0, 1.0 if height_m[1] > tall else 0.0),
    ):
        if not low <= value <= high:
            raise ValueError(f"{name} must be in [{low:g}, {high:g}], got {value:g}")


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
                    f"{missing} of the first {progress.numel() * (k + 1)} moving obstacles find no way between the "
                    "fixed ones: lower obstacles.count, obstacles.radius_max or track.target_speed"
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
        """Whether each `body` begins far from the vehicles and keeps clear of all obstacles, [world, start].

        `starts` are the vehicles' positions, `obstacles` the fixed cylinders, `others` the moving obstacles placed
        before.
        """
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


class Bodies(Remembers):
    """The moving obstacles of every environment.

    Attributes:
        table: [env, 8, body], written in place; drifting ones have the velocity of the water.
        present: whether there are any.
    """

    def __init__(self, num_envs: int, pool: Tensor):
        """Use the moving obstacles of all starts, `pool` [world, start, 8, body]; without any, one is far away."""
        self.present = pool.shape[-1] > 0
        self._pool = pool
        self.table = self.remember(pool.new_zeros((num_envs, ROWS, max(pool.shape[-1], 1))))
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
