"""A pool of worlds in which episodes of the escort begin, each with its own obstacles, places and courses.

The vessel begins at the centre of the area, on its first course. The boats begin at some distance from it in any
direction, side by side, and head roughly for it. Fixed obstacles stand along the boats' way to the vessel, the first
nearly on it, and ahead of the vessel. Moving obstacles cross that way at the time when the boats would be there. No
vehicle begins nearer than `ROOM` to an obstacle. All is drawn on the CPU: the same worlds on every device. `afloat` and
`aloft` make initial states [env, vehicle, 13] of boats and aircraft; `check_parts` and `check_slots` refuse teams that
cannot do their part. Frame: NED, m from the centre.
"""

import math
import warnings
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from rl.guidance.course.obstacles import AWAY, CROSSING_ANGLE, NORTH, ROWS, Cylinder
from rl.guidance.targets_and_errors import strongest_wind
from rl.missions.escort.config import ROOM, EscortScenario
from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.rotation import level_states
from taichi_sim.vehicle import Vehicle

PASSAGE = 12.0  # m between the surfaces of two obstacles; assumed
TRIES = 30  # draws of an obstacle before it is left out
AIM = 3.0  # m, greatest distance of the first obstacle from the boats' way
ABREAST = 12.0  # m between boats at the start; assumed
TALLEST, LOWEST = 15.0, 4.0  # m, heights of obstacles; aircraft pass above; assumed
CLOSING = 1.0  # m/s, speed of boats for timing the crossings; assumed

NEAR = 12.0  # m, standard deviation about the slots of boats that begin near the vessel; assumed
BOAT_SPEED = (0.5, 1.5)  # m/s at which boats begin; assumed
APART = 40.0  # m between aircraft that begin; assumed
MOST_WIND = 0.8  # greatest wind in which aircraft circle, in cruising speeds; assumed


class Worlds(NamedTuple):
    """A pool of starts: [world, ...], m, rad, m/s."""

    course: Tensor  # of the vessel
    speed: Tensor
    obstacles: Tensor  # [world, n, 4] north, east, radius, height
    bodies: Tensor  # [world, 8, n] moving bodies (rl/guidance/course/obstacles.py); the first is the vessel
    place: Tensor  # [world, boat, 2]
    heading: Tensor  # [world, boat]
    aloft: Tensor  # [world, 2] about which the aircraft begin
    near: Tensor  # bool: boats begin near the vessel

    def to(self, device: torch.device) -> "Worlds":
        """A copy on another device."""
        return Worlds(*(x.to(device) for x in self))


def draw_worlds(
    config: EscortScenario, boats: int, offsets: Tensor, radius: float, generator: torch.Generator
) -> Worlds:
    """Draw `config.escort.worlds` starts.

    Args:
        config: the scenario.
        boats: their number.
        offsets: their slots about the vessel, [boat, 2], m.
        radius: of the vessel, m.
        generator: of random numbers.
    """
    n, ways = config.escort.worlds, config.escort

    def uniform(low: float, high: float, *size: int) -> Tensor:
        return low + (high - low) * torch.rand((n, *size), generator=generator)

    def normal(*size: int) -> Tensor:
        return torch.randn((n, *size), generator=generator)

    course, speed = uniform(-math.pi, math.pi), uniform(*config.course.speed)
    bearing, far = uniform(-math.pi, math.pi), uniform(*ways.start_distance)
    near = uniform(0.0, 1.0) < ways.near_fraction
    out = torch.stack((bearing.cos(), bearing.sin()), dim=-1)  # direction from the vessel to the boats
    side = torch.stack((-bearing.sin(), bearing.cos()), dim=-1)
    middle = far.unsqueeze(-1) * out
    rank = (torch.arange(boats) - (boats - 1) / 2) * ABREAST
    place = middle.unsqueeze(1) + rank.view(1, -1, 1) * side.unsqueeze(1) + 1.5 * normal(boats, 2).clamp(-2, 2)
    heading = (bearing + math.pi).unsqueeze(-1) + 0.4 * normal(1) + 0.15 * normal(boats)
    if boats:
        ahead, starboard = offsets.float().unbind(-1)
        c, s = course.cos().unsqueeze(-1), course.sin().unsqueeze(-1)
        scatter = NEAR * normal(1, 2) + 2.0 * normal(boats, 2).clamp(-1, 1)
        slots = torch.stack((c * ahead - s * starboard, s * ahead + c * starboard), dim=-1)
        pushed = slots + scatter
        clear = (pushed.norm(dim=-1) > 2 * radius + 4.0).all(-1) & (_apart(pushed) > 2 * radius + 2.0)
        by_slots = torch.where(clear[:, None, None], pushed, slots)
        place = torch.where(near[:, None, None], by_slots, place)
        heading = torch.where(near[:, None], course.unsqueeze(-1) + 0.3 * normal(boats), heading)
    aloft = torch.where(near.unsqueeze(-1), 30.0 * normal(2), middle)
    taken = torch.cat((place, torch.zeros(n, 1, 2)), dim=1)  # positions of vehicles at the start
    forward = torch.stack((course.cos(), course.sin()), dim=-1)
    obstacles = _standing(config, taken, middle, side, forward, uniform)
    fixed = torch.tensor([[o.north, o.east, o.radius, o.height] for o in config.obstacles.fixed]).reshape(-1, 4)
    if len(fixed):
        gap = (place.unsqueeze(2) - fixed[:, :2]).norm(dim=-1) - fixed[:, Cylinder.RADIUS]
        if bool((gap < radius).any()):
            raise ConfigError(
                f"obstacles.fixed: boats would begin in one of them in {int((gap < radius).flatten(1).any(1).sum())} "
                f"of {n} worlds: they begin {list(ways.start_distance)} m (escort.start_distance) from (0, 0), on any "
                "side"
            )
        obstacles = torch.cat((fixed.expand(n, -1, 4), obstacles), dim=1)
    bodies = _moving(config, taken, middle, bearing, far, near, uniform)
    return Worlds(course, speed, obstacles, bodies, place, heading, aloft, near)


def _apart(place: Tensor) -> Tensor:
    """Least distance between two positions [world, n, 2]: [world]; inf for a single one."""
    gap = torch.cdist(place, place) + 1e9 * torch.eye(place.shape[1])
    return gap.amin(dim=(1, 2))


def _standing(config, taken, middle, side, forward, uniform) -> Tensor:
    """Fixed obstacles [world, n, 4], alternately along the boats' way and where the vessel is going."""
    count, spread, n = config.obstacles.count, config.obstacles.spread, len(middle)
    found = torch.zeros(n, count, 4)
    found[..., :2] = AWAY
    for k in range(count):
        radius, height = uniform(*config.obstacles.radius), uniform(LOWEST, TALLEST)
        missing = torch.ones(n, dtype=torch.bool)
        for _ in range(TRIES):
            if k % 2 == 0:
                aside = uniform(-AIM, AIM) if k == 0 else uniform(-spread, spread)
                at = uniform(0.1, 0.9).unsqueeze(-1) * middle + aside.unsqueeze(-1) * side
            else:
                at = uniform(0.0, 6 * spread).unsqueeze(-1) * forward + torch.stack(
                    (uniform(-2 * spread, 2 * spread), uniform(-2 * spread, 2 * spread)), dim=-1
                )
            clear = ((taken - at.unsqueeze(1)).norm(dim=-1) > (radius + ROOM).unsqueeze(-1)).all(-1)
            between = (found[..., :2] - at.unsqueeze(1)).norm(dim=-1)
            apart = between - found[..., Cylinder.RADIUS] - radius.unsqueeze(-1)
            fits = missing & clear & (apart > PASSAGE).all(-1)
            rows = torch.cat((at, radius.unsqueeze(-1), height.unsqueeze(-1)), dim=-1)
            found[:, k] = torch.where(fits.unsqueeze(-1), rows, found[:, k])
            missing &= ~fits
            if not missing.any():
                break
    return found


def _moving(config, taken, middle, bearing, far, near, uniform) -> Tensor:
    """Moving obstacles [world, 8, n] that cross the boats' way; the first column is left for the vessel."""
    count, n = config.obstacles.moving, len(middle)
    found = torch.zeros(n, ROWS, 1 + count)
    found[:, NORTH] = AWAY
    for k in range(1, 1 + count):
        radius, speed = uniform(*config.obstacles.radius), uniform(*config.obstacles.speed)
        missing = torch.ones(n, dtype=torch.bool)
        for _ in range(TRIES):
            share = uniform(0.2, 0.8)
            when = share * far / CLOSING
            turn = torch.where(uniform(-1.0, 1.0) < 0, uniform(*CROSSING_ANGLE), -uniform(*CROSSING_ANGLE))
            course = bearing + math.pi + turn
            velocity = speed.unsqueeze(-1) * torch.stack((course.cos(), course.sin()), dim=-1)
            begin = (1 - share).unsqueeze(-1) * middle - when.unsqueeze(-1) * velocity
            clear = ((taken - begin.unsqueeze(1)).norm(dim=-1) > (radius + 2 * ROOM).unsqueeze(-1)).all(-1)
            fits = missing & clear & ~near
            heights = torch.zeros(n), torch.full((n,), LOWEST)
            body = torch.stack((*begin.unbind(-1), radius, *heights, *velocity.unbind(-1), torch.zeros(n)), dim=-1)
            found[..., k] = torch.where(fits.unsqueeze(-1), body, found[..., k])
            missing &= ~fits
            if not missing.any():
                break
    return found


def afloat(boats: Fleet, place: Tensor, heading: Tensor, generator: torch.Generator) -> Tensor:
    """Boats at `place` [env, boat, 2] (m) with `heading` [env, boat] (rad), at one speed in each environment."""
    low, high = BOAT_SPEED
    speed = low + (high - low) * torch.rand((len(place), 1), generator=generator).to(boats.state)
    return level_states(place.to(boats.state), heading.to(boats.state), speed)


def aloft(aircraft: Fleet[Vehicle], down: Tensor, over: Tensor, generator: torch.Generator) -> Tensor:
    """Aircraft in steady flight over `over` [env, 2], side by side at `down` [aircraft], m, with a random heading."""
    count, like = aircraft.count, aircraft.state
    heading = (2 * math.pi * torch.rand((len(over), 1), generator=generator)).to(like).expand(-1, count)
    rank = (torch.arange(count, device=like.device) - (count - 1) / 2) * APART
    side = torch.stack((-heading.sin(), heading.cos()), dim=-1)
    place = over.unsqueeze(1).to(like) + rank.view(1, -1, 1) * side
    place = torch.cat((place, down.view(1, -1, 1).expand(len(over), -1, 1)), dim=-1)
    return level_states(place, heading, aircraft.model.limits.speeds[1])


def check_parts(config: EscortScenario, fleets: Mapping[str, Fleet[Vehicle]]) -> None:
    """Refuse teams whose vehicles cannot do their part."""
    parts = config.escort
    for name, medium in ((parts.boats, "water"), (parts.aircraft, "air")):
        if name in fleets and (moves := fleets[name].model.medium) != medium:
            raise ConfigError(
                f"{name}.vehicle = {config.parts[name].vehicle!r} moves in {moves}: "
                f"escort.{'boats' if medium == 'water' else 'aircraft'} need one that moves in {medium}"
            )
    for name in fleets:
        if name not in (parts.boats, parts.aircraft):
            raise ConfigError(
                f"{name}: escort.boats = {parts.boats!r} and escort.aircraft = {parts.aircraft!r} name the teams "
                "of the escort; give any other a script"
            )
    if parts.aircraft in fleets:
        _check_orbit(config, parts.aircraft, fleets[parts.aircraft])


def _check_orbit(config: EscortScenario, name: str, fleet: Fleet[Vehicle]) -> None:
    """Refuse a circle that cannot be flown in the wind, or that is too small for so many."""
    orbit, limits, width = config.parts[name].orbit, fleet.model.limits, 2 * fleet.model.collision_radius
    around = 2 * math.pi * orbit.radius / fleet.count
    if fleet.count > 1 and orbit.height_step <= width and around <= 2 * width:
        raise ConfigError(
            f"{name}.orbit.radius = {orbit.radius} m: {fleet.count} aircraft at even phases would be "
            f"{around:.3g} m apart, and each needs {width} m (twice its collision_radius) and as much "
            f"again: give a greater radius, or orbit.height_step above {width} m"
        )
    low, cruise, _ = limits.speeds
    wind = strongest_wind(config, orbit.height)
    if cruise > 0 and wind >= MOST_WIND * cruise:
        raise ConfigError(
            f"air.speed: up to {wind:.3g} m/s at {orbit.height} m, where {name}'s vehicles cruise at {cruise:.3g} "
            f"m/s (no slower than {low:.3g}): they could not circle; it must stay below {MOST_WIND * cruise:.3g} m/s"
        )
    if limits.turn_radius > 0:
        least = limits.turn_radius * ((cruise + wind) / cruise) ** 2
        if orbit.radius < least:
            raise ConfigError(
                f"{name}.orbit.radius = {orbit.radius} m: in a wind of {wind:.3g} m/s they cannot turn downwind in "
                f"less than {least:.0f} m"
            )


def warn_of_speeds(config: EscortScenario, boats: Fleet[Vehicle]) -> None:
    """Warn where the vessel may outrun the boats, which is allowed."""
    top, fastest = boats.model.limits.speeds[2], config.course.speed[1]
    if fastest >= top:
        warnings.warn(
            f"course.speed = {list(config.course.speed)}: {boats.name}'s vehicles go {top:.3g} m/s at most: "
            "boats arrive only while the vessel is slower, or comes towards them",
            stacklevel=2,
        )


def check_slots(config: EscortScenario, boats: Fleet[Vehicle], offsets: torch.Tensor, radius: float) -> None:
    """Refuse slots at `offsets` [boat, 2] (m) in which boats touch the vessel, of that radius (m), or each other."""
    near, own, key = float(offsets.norm(dim=-1).min()), boats.model.collision_radius, f"{boats.name}.spacing"
    spacing = config.parts[boats.name].spacing
    if near <= own + radius:
        raise ConfigError(
            f"{key} = {spacing} m: a slot is {near:.3g} m from the vessel: boats would touch it (collision radii {own} "
            f"and {radius} m)"
        )
    if boats.count > 1 and float(torch.pdist(offsets).min()) <= 2 * own:
        raise ConfigError(f"{key} = {spacing} m: neighbours would touch in their slots")
