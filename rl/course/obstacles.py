"""The obstacles of the mission: vertical cylinders standing on the sea beside the track.

Section 4 of the seed paper has multiple obstacles in the scene and gives no number; all numbers here are
assumed. Obstacles are spread over the whole lap, one drawn in each of `count` equal stretches of it, on
either side. The tall ones cross the flight height of the aircraft with `HEIGHT_BAND_M` to spare, the others
stay as far below it: an obstacle is in an aircraft's way or it is not.

A drawn obstacle stays if it keeps its distance from the whole track, stands in the area, and is clear of its
neighbours; the others are drawn again, further along and (late) further out. Frame: NED, m from the centre.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from rl.course.tracks import Real, Tracks, world_uniform
from taichi_sim.config import Finite, Positive, Strict

OBSTACLE_STREAM = 1 << 16  # and one stream after it per round
ROUNDS = 48
STRETCH_GROWTH = 0.25  # per round, of the stretch of track in which an obstacle is drawn
PATIENCE = 16  # rounds before an obstacle may stand further out than asked
OUTWARD_GROWTH = 0.1  # per later round, of the widest clearance
TRACK_CLEARANCE_M = 12.0  # from the surface of an obstacle to the track itself, unless asked for less
LEAST_SPREAD_M = 2.0  # of distances: at one alone there would be no room
PASSAGE_M = 10.0  # between the surfaces of two obstacles, at the least
HEIGHT_BAND_M = 10.0  # either side of the flight height, in which no obstacle ends
CHUNK = 128  # obstacles measured at once: the working set stays in cache
ROUNDING_M = 1e-3  # float32 at 1.5 km


class FixedObstacle(Strict):
    """One vertical cylinder that stands in every world."""

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
    """Draw `count` cylinders per world; return float32 [world, count, 4]: north, east, radius, height (m).

    World w depends only on its track, the seed and w; obstacles are numbered roughly along the track.

    lane_half_width_m  from the track to the outer edge of the widest formation's lanes
    clearance_m        least and, where possible, greatest distance from a surface to the lanes' edge; if
                       negative, obstacles may stand in followers' lanes
    track_clearance_m  least distance from a surface to the track itself
    tall_fraction      share, rounded, that reach above flight_height_m + 10; the others stay below
                       flight_height_m - 10, or at height_m[0] if that is higher
    """
    _check(count, lane_half_width_m, clearance_m, radius_m, height_m, tall_fraction, flight_height_m)
    worlds = tracks.worlds
    draws = world_uniform(seed, OBSTACLE_STREAM, worlds, count, 3)
    radius = radius_m[0] + (radius_m[1] - radius_m[0]) * draws[..., 0]
    height = _heights(draws[..., 1], draws[..., 2], height_m, tall_fraction, flight_height_m)
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
        offset = nearest + (widest - nearest) * out + obstacle[world, number, 2]
        offset = torch.where(side < 0.5, offset, -offset)
        track = tracks.at(world, s)
        starboard = torch.stack((-track.course.sin(), track.course.cos()), dim=-1)
        obstacle[world, number, :2] = track.position + offset[:, None] * starboard

        drawn = obstacle[world, number]
        fits = (drawn[:, :2].abs() + drawn[:, 2:3] <= area_m / 2).all(dim=-1)
        fits &= distance_to_tracks(tracks, world, drawn[:, :2]) >= nearest + drawn[:, 2] + ROUNDING_M
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
    """Distance [point] (m) of `position` [point, 2] to the whole track of `world` [point], rounded down.

    The distance to the polyline of all samples, less the greatest bow of the arc over its chord.
    """
    here = tracks.table[..., :2]
    chord = (here.roll(-1, dims=1) - here).permute(2, 0, 1).contiguous()
    here = here.permute(2, 0, 1).contiguous()
    per_chord2 = 1 / chord.square().sum(dim=0)
    spacing = tracks.length_m / tracks.samples
    bow = tracks.table[..., 3].abs().amax(dim=1) * spacing**2 / 8
    nearest = [torch.empty(0)]
    for w, p in zip(world.split(CHUNK), position.split(CHUNK), strict=True):
        along_n, along_e = chord[:, w]
        from_n, from_e = p.T[:, :, None] - here[:, w]
        f = ((from_n * along_n + from_e * along_e) * per_chord2[w]).clamp_(0, 1)
        gap = (from_n - f * along_n).square_() + (from_e - f * along_e).square_()
        nearest.append(gap.amin(dim=1).sqrt_() - bow[w])
    return torch.cat(nearest)


def _hits_earlier(obstacle: Tensor, candidate: Tensor, placed: Tensor) -> Tensor:
    """Whether each obstacle [world, count] is too near a placed one, or a candidate of a lower number."""
    apart = torch.hypot(*(obstacle[:, :, None, i] - obstacle[:, None, :, i] for i in (0, 1)))
    room = obstacle[:, :, None, 2] + obstacle[:, None, :, 2] + PASSAGE_M
    earlier = torch.ones(obstacle.shape[1], obstacle.shape[1], dtype=torch.bool).tril(-1)
    itself = torch.eye(obstacle.shape[1], dtype=torch.bool)
    rival = (placed[:, None, :] | (candidate[:, None, :] & earlier)) & ~itself
    return ((apart < room) & rival).any(dim=-1)


def _heights(rank: Real, share: Real, height_m: tuple[float, float], tall_fraction: float, flight: float) -> Real:
    """Heights [world, count] (m): those of lowest `rank` are tall; `share` is the place in the range."""
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
    """Refuse what no placing can meet, naming the parameter and its range."""
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
