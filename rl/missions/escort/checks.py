"""Checks of an escort's teams: vehicles, circles in the wind, slots, speeds."""

import math
import warnings
from collections.abc import Mapping
from typing import Any

import torch

from rl.missions.escort.config import EscortScenario
from rl.perception.wind_triangle import strongest_wind
from taichi_sim.config import ConfigError

MOST_WIND = 0.8  # greatest wind in which aircraft circle, in cruising speeds; assumed


def check_parts(config: EscortScenario, teams: Mapping[str, Any]) -> None:
    """Refuse teams that cannot play their part.

    Raises:
        ConfigError: if so; the message names the key and the numbers.
    """
    parts = config.escort
    for name, medium in ((parts.boats, "water"), (parts.aircraft, "air")):
        team = teams.get(name)
        if team is not None and team.fleet.model.medium != medium:
            raise ConfigError(
                f"{name}.vehicle = {team.section.vehicle!r} moves in {team.fleet.model.medium}: "
                f"escort.{'boats' if medium == 'water' else 'aircraft'} need one that moves in {medium}"
            )
    for name in teams:
        if name not in (parts.boats, parts.aircraft):
            raise ConfigError(
                f"{name}: escort.boats = {parts.boats!r} and escort.aircraft = {parts.aircraft!r} name the teams "
                "of the escort; give any other a script"
            )
    team = teams.get(parts.aircraft)
    if team is not None:
        _check_orbit(config, team)


def _check_orbit(config: EscortScenario, team: Any) -> None:
    """Refuse a circle that cannot be flown in the wind, or that is too small for the number of aircraft."""
    orbit, limits, name = team.orbit, team.fleet.model.limits, team.name
    around = 2 * math.pi * orbit.radius / team.fleet.count
    if team.fleet.count > 1 and orbit.height_step <= 2 * team.radius and around <= 4 * team.radius:
        raise ConfigError(
            f"{name}.orbit.radius = {orbit.radius} m: {team.fleet.count} aircraft at even phases would be "
            f"{around:.3g} m apart, and each needs {2 * team.radius} m (twice its collision_radius) and as much "
            f"again: give a greater radius, or orbit.height_step above {2 * team.radius} m"
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


def tell_speeds(config: EscortScenario, boats: Any) -> None:
    """Warn if the vessel may outrun the boats; this is allowed."""
    top, fastest = boats.fleet.model.limits.speeds[2], config.course.speed[1]
    if fastest >= top:
        warnings.warn(
            f"course.speed = {list(config.course.speed)}: {boats.name}'s vehicles go {top:.3g} m/s at most: "
            "boats arrive only while the vessel is slower, or comes towards them",
            stacklevel=2,
        )


def check_slots(boats: Any, radius: float) -> None:
    """Refuse slots in which boats would touch the vessel, of that `radius` (m), or each other.

    Raises:
        ConfigError: if so; the message names the key and the numbers.
    """
    near = float(boats.offsets.norm(dim=-1).min())
    if near <= boats.radius + radius:
        raise ConfigError(
            f"{boats.name}.spacing = {boats.section.spacing} m: a slot is {near:.3g} m from the vessel: boats "
            f"would touch it (collision radii {boats.radius} and {radius} m)"
        )
    if boats.fleet.count > 1 and float(torch.pdist(boats.offsets).min()) <= 2 * boats.radius:
        raise ConfigError(f"{boats.name}.spacing = {boats.section.spacing} m: neighbours would touch in their slots")
