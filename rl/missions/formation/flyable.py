"""Checks that a team can follow the track: slots move forward in every bend, and vehicles with limits of airspeed and
bank can fly it in the strongest wind of the scenario.

A slot at y to starboard of a leader on a bend of radius R to starboard goes at v (1 - y / R): backwards where y > R.

Over ground, the target's speed v needs airspeeds from v - w to v + w. Through the air, its airspeed V_a makes speeds
over ground up to V_a + w. Either way a bend of radius R needs the lateral acceleration v^2 / R at the largest speed
over ground v (rl/guidance/geometry.py), so R must reach v^2 / (g tan(largest bank)).
"""

import math
from collections.abc import Mapping

from rl.guidance.geometry import LEAST_SHARE, strongest_wind
from rl.guidance.shapes import lane_half_width
from rl.missions.formation.config import FormationScenario
from taichi_sim.config import ConfigError
from taichi_sim.vehicle import Vehicle


def check_teams(config: FormationScenario, models: Mapping[str, Vehicle]) -> None:
    """Refuse teams, by their vehicles' `models`, that cannot hold their slots, or follow the track in the wind.

    Raises:
        ConfigError: naming the key, and the numbers.
    """
    for name, model in models.items():
        section = config.formations[name]
        least, drawn, width = section.spacings[0], section.formation.spacing_range, 2 * model.collision_radius
        if section.count > 1 and least <= width:
            key = f"formation.spacing_range = {list(drawn)}" if drawn else f"spacing = {least}"
            raise ConfigError(
                f"{name}.{key}: must be above twice the vehicle's collision_radius, {width} m: neighbours would touch "
                "in their slots"
            )
    if config.track.speed_over == "air" and not any(model.medium == "air" for model in models.values()):
        raise ConfigError(
            f"track.speed_over = 'air': only {', '.join(models)} is simulated, and nothing flies; it needs 'ground'"
        )
    for name, model in models.items():
        section, least = config.formations[name], config.track.min_radius
        for shape in section.shapes:
            width = lane_half_width((shape,), section.count, section.spacings[1])
            if width >= least:
                raise ConfigError(
                    f"track.min_radius = {least}: {name}'s formation {shape!r} ({name}.count = {section.count}, "
                    f"{section.spacings[1]:g} m apart) reaches {width:.3g} m to the side of its leader: slots on the "
                    "inside of the tightest bends would stand still or go backwards"
                )
        _check_flyable(config, f"{name}.vehicle = {section.vehicle!r}", model)


def _check_flyable(config: FormationScenario, vehicle: str, model: Vehicle) -> None:
    """Refuse a track that `model`, of the file `vehicle`, cannot follow; a vehicle that can stop follows any track."""
    low, cruise, high = model.limits.speeds
    if model.limits.stops or math.isinf(high):
        return
    track = config.track
    speed, wind = track.target_speed, strongest_wind(config, track.flight_height)
    most = speed + wind if track.speed_over == "air" else speed
    needed = (speed, speed) if track.speed_over == "air" else (speed - wind, speed + wind)
    key = f"track.target_speed = {speed} over {track.speed_over}"
    blows = f"a wind of up to {wind:.3g} m/s at track.flight_height = {track.flight_height}"
    if track.speed_over == "air" and wind > (1 - LEAST_SHARE) * speed:
        raise ConfigError(f"{key}: {blows} leaves less than {LEAST_SHARE * speed:.3g} m/s over ground against it")
    if not low <= needed[0] <= needed[1] <= high:
        airspeeds = f"airspeeds from {needed[0]:.3g} to {needed[1]:.3g} m/s, in {blows}"
        needs = f" needs {airspeeds} ('air' needs one)" if needed[0] < needed[1] else ""
        raise ConfigError(f"{key}{needs}: {vehicle} flies from {low:.3g} to {high:.3g} m/s")
    radius = model.limits.turn_radius * (most / cruise) ** 2
    if track.min_radius < radius:
        raise ConfigError(
            f"track.min_radius = {track.min_radius}: {vehicle} cannot turn tighter than {radius:.3g} m at "
            f"{most:.3g} m/s over ground ({key}, {blows})"
        )
