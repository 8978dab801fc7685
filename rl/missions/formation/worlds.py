"""The worlds of a scenario: tracks, obstacles beside them and in the lanes, and traffic."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from rl.course.obstacles import ROWS, Span, Traffic, generate_obstacles
from rl.course.tracks import Tracks, generate_tracks
from rl.guidance.shapes import lane_half_width
from rl.missions.formation.config import FormationScenario
from rl.missions.formation.slots import offsets_of, unit_offsets
from rl.missions.formation.starts import Starts
from rl.scenario import derive_seed
from taichi_sim.config import ConfigError
from taichi_sim.randomisation.conditions import nominal_conditions
from taichi_sim.vehicle import Vehicle

TALLEST = 90.0  # m, of generated obstacles
VESSEL_TOPS = 4.0, 15.0  # m, of traffic on the sea; assumed
SHORTEST = 15.0  # s: in shorter episodes nothing could move that is not too near at the start
FLYING_SPAN = 15.0  # m, below and above the flight height, of traffic in the air; assumed


def generate_worlds(config: FormationScenario, seed: int) -> tuple[Tracks, Tensor]:
    """Tracks and generated obstacles [world, count, 4] of a scenario.

    Raises:
        ConfigError: if the scenario's sections track, obstacles and area leave no room for them.
    """
    track, cylinders = config.track, config.obstacles
    widest = max(lane_half_width(t.shapes, t.count, t.spacings[1]) for t in config.formations.values())
    try:
        tracks = generate_tracks(
            track.worlds, derive_seed(seed, "tracks"), length_m=track.length, area_m=config.area,
            checkpoints=track.checkpoints, min_radius_m=track.min_radius,
        )  # fmt: skip
        obstacles = generate_obstacles(
            tracks, derive_seed(seed, "obstacles"),
            count=cylinders.count - round(cylinders.moving_fraction * cylinders.count),
            lane_half_width_m=widest, clearance_m=(cylinders.clearance_min, cylinders.clearance_max),
            track_clearance_m=cylinders.track_clearance, radius_m=(cylinders.radius_min, cylinders.radius_max),
            height_m=(5.0, max(TALLEST, track.flight_height + 30.0)), tall_fraction=cylinders.tall_fraction,
            flight_height_m=track.flight_height, area_m=config.area,
        )  # fmt: skip
    except ValueError as error:
        raise ConfigError(
            f"scenario {config.name!r}: the tracks (track.length = {track.length}, track.min_radius = "
            f"{track.min_radius}, area = {config.area}) or the obstacles do not fit: {error}"
        ) from None
    return tracks, obstacles


def traffic_of(config: FormationScenario, places: Mapping[str, Tensor]) -> Traffic:
    """Parameters of a scenario's traffic: in each medium, the moving share of the obstacles that a team would meet.

    places: medium -> slots of a team there [world, start, vehicle, 2], m.
    """
    track, cylinders = config.track, config.obstacles
    met = cylinders.count * config.episode_duration * track.target_speed / track.length
    radius = cylinders.radius_min, cylinders.radius_max
    top = track.flight_height + FLYING_SPAN
    heights = {"water": (0.0, VESSEL_TOPS), "air": (track.flight_height - FLYING_SPAN, (top, top))}
    nominal = nominal_conditions(config)
    heading, speed = math.radians(nominal["sea.current.direction_deg"]), nominal["sea.current.speed"]
    return Traffic(
        count=math.ceil(cylinders.moving_fraction * met) if config.episode_duration > SHORTEST else 0,
        spans=tuple(Span(*heights[medium], radius, there) for medium, there in places.items()),
        drifting=cylinders.drifting_fraction, overtaking=cylinders.overtaking_fraction,
        speed=(cylinders.speed_min, cylinders.speed_max),
        current=(speed * math.cos(heading), speed * math.sin(heading)), duration=config.episode_duration,
        team_speed=track.target_speed,
    )  # fmt: skip


def draw_traffic(
    config: FormationScenario, tracks: Tracks, starts: Starts, obstacles: Tensor, models: Mapping[str, Vehicle],
    generator: torch.Generator,
) -> Tensor:  # fmt: skip
    """Draw traffic for each start [world, start, 8, body] (rl/course/obstacles.py), among `obstacles` [world, n, 4].

    Raises:
        ConfigError: if it is faster than the vehicles, or finds no free path.
    """
    places: dict[str, Tensor] = {}
    for name, model in models.items():
        offsets = offsets_of(unit_offsets(config.formations[name]), starts.formations[name])
        places.setdefault(model.medium, offsets.float())
    traffic = traffic_of(config, places)
    if not traffic.bodies:
        return torch.zeros((*starts.progress.shape, ROWS, 0))
    for name, model in models.items():
        top = model.limits.speeds[2]
        if config.obstacles.speed_max > top:
            raise ConfigError(
                f"obstacles.speed_max = {config.obstacles.speed_max} m/s: traffic must not be faster than {name}'s "
                f"vehicles can go, {top:.3g} m/s: nobody could keep clear of it"
            )
    where = torch.cat([state[..., :2] for state in starts.states.values()], dim=2)
    try:
        return traffic.draw(tracks, starts.progress, where, obstacles, generator)
    except ValueError as error:
        raise ConfigError(f"scenario {config.name!r}: {error}") from None
