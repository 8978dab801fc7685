"""Checks of the teams of an escort: vehicles, circles in the wind, slots, speeds."""

import math
import warnings
from collections.abc import Mapping

import torch

from rl.guidance.geometry import strongest_wind
from rl.missions.escort.config import EscortScenario
from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet

MOST_WIND = 0.8  # greatest wind in which aircraft circle, in cruising speeds; assumed


def check_parts(config: EscortScenario, fleets: Mapping[str, Fleet]) -> None:
    """Refuse teams whose vehicles cannot do their part.

    Raises:
        ConfigError: if so; the message names the key and the numbers.
    """
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


def _check_orbit(config: EscortScenario, name: str, fleet: Fleet) -> None:
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


def warn_of_speeds(config: EscortScenario, boats: Fleet) -> None:
    """Warn where the vessel may outrun the boats, which is allowed."""
    top, fastest = boats.model.limits.speeds[2], config.course.speed[1]
    if fastest >= top:
        warnings.warn(
            f"course.speed = {list(config.course.speed)}: {boats.name}'s vehicles go {top:.3g} m/s at most: "
            "boats arrive only while the vessel is slower, or comes towards them",
            stacklevel=2,
        )


def check_slots(config: EscortScenario, boats: Fleet, offsets: torch.Tensor, radius: float) -> None:
    """Refuse slots at `offsets` [boat, 2] (m) in which boats would touch the vessel, of that radius (m), or each other.

    Raises:
        ConfigError: if so; the message names the key and the numbers.
    """
    near, own, key = float(offsets.norm(dim=-1).min()), boats.model.collision_radius, f"{boats.name}.spacing"
    spacing = config.parts[boats.name].spacing
    if near <= own + radius:
        raise ConfigError(
            f"{key} = {spacing} m: a slot is {near:.3g} m from the vessel: boats would touch it (collision radii {own} "
            f"and {radius} m)"
        )
    if boats.count > 1 and float(torch.pdist(offsets).min()) <= 2 * own:
        raise ConfigError(f"{key} = {spacing} m: neighbours would touch in their slots")
