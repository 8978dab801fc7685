"""Fixed obstacles: vertical cylinders in the sea beside the track.

The paper (sec. 4) has several obstacles and gives no numbers; all numbers here are assumed. The lap is divided into
`count` equal stretches with one obstacle each, on either side. Tall obstacles end at least `HEIGHT_BAND_M` above the
aircraft's flight height, all others as far below it, so that an obstacle clearly is in an aircraft's way or not.

A drawn obstacle is accepted if it keeps its distance from the whole track and from its neighbours and lies in the area.
Otherwise it is drawn again, further along the track and later also further out. Frame: NED, m from the centre.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from rl.course.tracks import Real, Tracks, TrackSample, world_uniform
from taichi_sim.config import Finite, Positive, Strict

OBSTACLE_STREAM = 1 << 16  # random stream of the first round; each round has the next one
ROUNDS = 48
STRETCH_GROWTH = 0.25  # per round: growth of the stretch of track for an obstacle
PATIENCE = 16  # rounds before obstacles may stand further out than clearance_m says
OUTWARD_GROWTH = 0.1  # per later round: growth of the greatest clearance
TRACK_CLEARANCE_M = 12.0  # default distance from an obstacle's surface to the track
LEAST_SPREAD_M = 2.0  # least range of distances, so that there is room
PASSAGE_M = 10.0  # least gap between two obstacles
HEIGHT_BAND_M = 10.0  # no obstacle ends within this distance of the flight height
CHUNK = 128  # obstacles measured at once: the working set stays in cache
ROUNDING_M = 1e-3  # float32 at 1.5 km


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
    chord = (here.roll(-1, dims=1) - here).permute(2, 0, 1).contiguous()
    here = here.permute(2, 0, 1).contiguous()
    per_chord2 = 1 / chord.square().sum(dim=0)
    spacing = tracks.length_m / tracks.samples
    bow = tracks.table[..., TrackSample.CURVATURE].abs().amax(dim=1) * spacing**2 / 8
    nearest = [torch.empty(0)]
    for w, p in zip(world.split(CHUNK), position.split(CHUNK), strict=True):
        along_n, along_e = chord[:, w]
        from_n, from_e = p.T[:, :, None] - here[:, w]
        f = ((from_n * along_n + from_e * along_e) * per_chord2[w]).clamp_(0, 1)
        gap = (from_n - f * along_n).square_() + (from_e - f * along_e).square_()
        nearest.append(gap.amin(dim=1).sqrt_() - bow[w])
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
