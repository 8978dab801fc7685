"""The worlds of a scenario: tracks, obstacles beside them and in the lanes, traffic, and initial states.

A pool of starts for each world is drawn once, so that a reset only gathers rows. A start puts the target at a random
place of the track, the leader within `start_distance` of it with about the slot's heading and speed, and followers near
their slots; the formation is drawn with the start. If a vehicle touches an obstacle, its team is moved closer to its
slots. If the slots touch one, too, or vehicles would meet before they can turn away or stop, another place is drawn.
If none is found, the world's other starts are used, as where an obstacle beside a team's lanes is in its way to them,
or two mates near each other too fast.
Where all obstacles end below the flight height, aircraft begin above those ahead.
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from rl.guidance.course.obstacles import HEIGHT_BAND_M, ROWS, Cylinder, Span, Traffic, generate_obstacles
from rl.guidance.course.route import Route, laid, read_route
from rl.guidance.course.tracks import Tracks, generate_tracks
from rl.guidance.shapes import lane_half_width
from rl.guidance.targets_and_errors import LEAST_SHARE, crab, strongest_wind
from rl.missions.formation.config import FormationScenario
from rl.missions.formation.slots import Drawn, draw_formations, offsets_of, unit_offsets
from rl.scenario import derive_seed
from taichi_sim.config import ConfigError
from taichi_sim.errors import named, refuse
from taichi_sim.kernels.conventions import DOWN, QUATERNION, STATE_SIZE, SURGE
from taichi_sim.kernels.rotation import torch_heading, torch_quaternion_from_euler
from taichi_sim.randomisation.conditions import nominal_conditions
from taichi_sim.vehicle import Vehicle

PER_WORLD = 32  # starts drawn for each world
HEADING_SPREAD = 0.5, 0.15  # rad, standard deviations: of a team's heading about the course, of a vehicle's about that
SPEED_RANGE = (0.6, 1.2)  # of the target's speed, one draw per team
FOLLOWER_SPREAD = 0.2  # standard deviation of a follower's place, in spacings
HEIGHT_SPREAD = 0.07  # of the flight height, standard deviation of UAV start heights
LARGEST_DROP = 0.3  # of the flight height
MAX_DRAWS = 50  # of places for a start
MARGIN = 3.0  # m from obstacles, beyond the collision radius; between mates too, or half the room of their slots
ROUNDING = 1e-3  # m, of heights in single precision
PULLS = (1.0, 0.5, 0.25, 0.0)  # shares of the random offsets that are tried, in order
TURNING_TIME = 3.0  # s that vehicles which cannot stop are given to turn away from each other; assumed
STOPPING_TIME = 2.0  # s that vehicles which can stop are given to keep clear of each other; assumed
CLEAR_TIME = 3.0  # s for which a vehicle that goes straight on meets no obstacle: room for an evasion; assumed
FREE_TIME = 7.0  # s to any obstacle ahead with the wind, of vehicles that cannot stop: room for a turn; assumed
TALLEST = 90.0  # m, of generated obstacles
VESSEL_TOPS = 4.0, 15.0  # m, of traffic on the sea; assumed
ON_THE_WAY = 15.0  # s after which a team is in its lanes: of collisions of boats, four in five came before; assumed
SHORTEST = 15.0  # s: in shorter episodes nothing could move that is not too near at the start
FLYING_SPAN = 15.0  # m, below and above the flight height, of traffic in the air; assumed
EDGE = 200.0  # m, from a route to the edge of the area: as generated tracks keep
MOST_MET = 256  # moving obstacles that a team meets in an episode; each is checked against all others


class Starts(NamedTuple):
    """Start `i` of world `w`: progress [world, i] m along the track; states[team] [world, i, vehicle, 13], and the
    formation [world, i] that the team begins in.
    """

    progress: Tensor
    states: dict[str, Tensor]
    formations: dict[str, Drawn]

    def to(self, device: torch.device, dtype: torch.dtype) -> "Starts":
        """A copy on another device, with progress in another precision."""
        states = {name: s.to(device) for name, s in self.states.items()}
        formations = {name: Drawn(f.shape.to(device), f.spacing.to(device)) for name, f in self.formations.items()}
        return Starts(self.progress.to(device, dtype), states, formations)


class Draw(NamedTuple):
    """Random numbers for the starts that are `due`, which do not depend on which are: all are drawn."""

    shape: tuple[int, int]  # worlds, starts of each
    due: tuple[Tensor, ...]  # world and start of each that is due
    generator: torch.Generator

    def __call__(self, kind: Callable[..., Tensor], *size: int) -> Tensor:
        """Numbers [due, 1, *size] of a `kind`: `torch.rand` or `torch.randn`."""
        return kind(*self.shape, *size, generator=self.generator)[self.due].unsqueeze(1)


def draw_starts(
    config: FormationScenario, tracks: Tracks, obstacles: Tensor, models: Mapping[str, Vehicle],
    generator: torch.Generator,
) -> Starts:  # fmt: skip
    """Draw `PER_WORLD` starts in each world for the teams named in `models`."""
    shape = (tracks.worlds, PER_WORLD)
    progress = torch.zeros(shape)
    states = {t: torch.zeros((*shape, config.teams[t].count, STATE_SIZE)) for t in models}
    # Drawn once: if they were drawn again with each place, shapes that seldom fit would be rare.
    formations = {t: draw_formations(config.formations[t], shape, generator) for t in models}
    missing = torch.ones(shape, dtype=torch.bool)
    wind = strongest_wind(config, config.track.flight_height)
    fastest = {t: config.pace(t).speed if m.limits.stops else m.limits.speeds[1] + wind for t, m in models.items()}
    clear_of = config.track.flight_height - HEIGHT_BAND_M
    low = bool((obstacles[..., Cylinder.HEIGHT] <= clear_of + ROUNDING).all())  # nobody who flies can meet them
    met = {t: obstacles[:, :0] if low and model.medium == "air" else obstacles for t, model in models.items()}
    for _ in range(MAX_DRAWS):
        due = missing.nonzero(as_tuple=True)  # world and start of each that is missing, here [missing, 1]
        at = due[0].unsqueeze(1)
        drawn = (torch.rand(shape, generator=generator) * tracks.length_m.unsqueeze(1))[due].unsqueeze(1)
        place = tracks.at(at, drawn)
        clear, fresh = torch.ones_like(at, dtype=torch.bool), {}
        for team, model in models.items():
            formation, near = formations[team].at(*(x.unsqueeze(1) for x in due)), met[team][due[0]]
            draw = Draw(shape, due, generator)
            fresh[team], fits = _team_states(config, team, model, formation, place, near, draw)
            clear &= fits
            margin = model.collision_radius + MARGIN
            if model.limits.stops and config.obstacles.off_ways:
                clear &= _mates_clear(fresh[team], 2.2 * model.collision_radius)
            elif not model.limits.stops:
                clear &= _pass_clear(fresh[team], fastest[team], 2 * margin)
                clear &= ~_ahead(fresh[team], near, fastest[team], margin).flatten(2).any(-1)
            if low and model.medium == "air" and obstacles.shape[1]:
                fresh[team] = _above(fresh[team], obstacles[due[0]], fastest[team], margin)
        clear = clear.squeeze(1)
        found = tuple(x[clear] for x in due)
        progress[found] = drawn[clear, 0]
        for team in models:
            states[team][found] = fresh[team][clear, 0]
        missing[found] = False
        if not missing.any():
            break
    without = int(missing.all(dim=1).sum())
    if without:
        raise ConfigError(
            f"no room to start: in {without} of {tracks.worlds} worlds all starts touch an obstacle after {MAX_DRAWS} "
            "draws; lower obstacles.count or obstacles.fixed, raise obstacles.clearance_min, or shrink the formation"
        )
    starts = Starts(progress, states, formations)
    for team, model in models.items() if config.obstacles.off_ways else ():
        unfit = []
        if model.limits.stops:
            unfit.append(_could_meet(states[team], 2 * model.collision_radius))
        if met[team].shape[1] and _beside(config, team, model):
            unfit.append(_way_blocked(config, team, model, starts, tracks, met[team]))
        for blocked in unfit:
            missing = torch.where((missing | blocked).all(dim=1, keepdim=True), missing, missing | blocked)
    return _others_for(missing, starts)


def _beside(config: FormationScenario, team: str, model: Vehicle) -> bool:
    """Whether the obstacles of a scenario stand beside the lanes of a team, not in them."""
    cylinders = config.obstacles
    half, widest = _half_widths(config)
    return max(widest + cylinders.clearance_min, cylinders.track_clearance) > half[team] + model.collision_radius


def _half_widths(config: FormationScenario) -> tuple[dict[str, float], float]:
    """Distance from the track to the outer edge of each team's lanes, and of the widest, m."""
    each = {name: lane_half_width(t.shapes, t.count, t.spacings[1]) for name, t in config.formations.items()}
    return each, max(each.values())


def _way_blocked(
    config: FormationScenario, team: str, model: Vehicle, starts: Starts, tracks: Tracks, obstacles: Tensor
) -> Tensor:
    """Whether an obstacle stands within `MARGIN` of a vehicle's way to its slot: bool [world, start].

    Its way, in the `ON_THE_WAY` first seconds, is the strip between its slot and where it would be if it kept its
    distance from that.
    """
    state, speed, keeps = starts.states[team], config.pace(team).speed, model.collision_radius + MARGIN
    offsets = offsets_of(unit_offsets(config.formations[team]), starts.formations[team]).float()
    at = torch.arange(tracks.worlds).unsqueeze(1).expand(starts.progress.shape)
    middle = tracks.at(at, starts.progress + speed * ON_THE_WAY / 2).position.unsqueeze(2)
    reach = speed * ON_THE_WAY / 2 + (state[..., :2] - middle).norm(dim=-1).amax(-1) + offsets.norm(dim=-1).amax(-1)
    gap = (obstacles[:, None, :, :2] - middle).norm(dim=-1) - obstacles[:, None, :, Cylinder.RADIUS] - keeps
    world, start, number = (gap < reach.unsqueeze(-1)).nonzero(as_tuple=True)  # all that could be in a way
    near, ahead, aside = obstacles[world, number], offsets[world, start], None
    found = torch.zeros(starts.progress.shape, dtype=torch.bool)
    for time in torch.linspace(0.0, ON_THE_WAY, 1 + math.ceil(speed * ON_THE_WAY / MARGIN)).tolist():
        place = tracks.at(world, starts.progress[world, start] + speed * time)
        turn = torch.stack((place.course.cos(), place.course.sin(), -place.course.sin(), place.course.cos()), -1)
        turn = turn.view(-1, 1, 2, 2)  # rows: along the course and to starboard, in n
        slot = place.position.unsqueeze(1) + (ahead.unsqueeze(-2) @ turn).squeeze(-2)
        aside = (turn @ (state[world, start, :, :2] - slot).unsqueeze(-1)).mT if aside is None else aside
        off, to = (aside @ turn).squeeze(-2), near[:, None, :2] - slot
        share = (to * off).sum(-1, keepdim=True) / off.square().sum(-1, keepdim=True).clamp(min=1e-6)
        gap = (to - share.clamp(0.0, 1.0) * off).norm(dim=-1).amin(-1) - near[:, Cylinder.RADIUS]
        met = gap < keeps
        found[world[met], start[met]] = True
    return found


def _others_for(missing: Tensor, starts: Starts) -> Starts:
    """Replace starts that are `missing` [world, start] by others of the same world, in turn."""
    there = missing.argsort(dim=1, stable=True)  # first those that there are
    turn = torch.arange(missing.shape[1]) % (~missing).sum(dim=1, keepdim=True)
    taken = torch.where(missing, there.gather(1, turn), torch.arange(missing.shape[1]))
    rows = torch.arange(missing.shape[0]).unsqueeze(1)
    states = {name: of[rows, taken] for name, of in starts.states.items()}
    return Starts(starts.progress[rows, taken], states, {n: f.at(rows, taken) for n, f in starts.formations.items()})


def in_wind(state: Tensor, wind: Tensor, over_ground: Tensor, airspeed: float, model: Vehicle) -> Tensor:
    """Starts [env, vehicle, 13] behind a target with `airspeed`, `over_ground` [env], in a `wind` [env, 2], m/s.

    Speeds scale with the target's speed over ground. A `model` that cannot stop begins in steady flight at its cruising
    airspeed; it heads into the wind by the crab angle, so that the drawn heading becomes its course.
    """
    state = state.clone()
    state[..., SURGE] *= (over_ground * (1 / airspeed)).unsqueeze(1)
    if not model.limits.stops:
        course = torch_heading(state[..., QUATERNION])
        turn = crab(model.limits.speeds[1], wind.unsqueeze(1), course.cos(), course.sin())
        level = torch.zeros_like(course)
        state[..., QUATERNION] = torch_quaternion_from_euler(level, level, course + turn)
    return state


def _team_states(config, team, model, formation: Drawn, place, obstacles, draw: Draw) -> tuple[Tensor, Tensor]:
    """States [world, start, vehicle, 13] of a team, and whether they are clear of everything [world, start]."""
    section, margin, spacing = config.teams[team], model.collision_radius + MARGIN, formation.spacing
    shape = (*place.course.shape, section.count)
    course = place.course.unsqueeze(-1)

    radius = section.start_distance * draw(torch.rand, 1).sqrt()
    bearing = 2 * math.pi * draw(torch.rand, 1)
    leader = torch.stack((radius * bearing.cos(), radius * bearing.sin()), dim=-1)
    scatter = leader + (FOLLOWER_SPREAD * spacing).float()[..., None, None] * draw(torch.randn, section.count, 2)
    scatter[..., 0, :] = leader[..., 0, :]
    ahead, starboard = offsets_of(unit_offsets(section), formation).float().unbind(-1)
    north = course.cos() * ahead - course.sin() * starboard
    east = course.sin() * ahead + course.cos() * starboard
    slot = place.position.unsqueeze(2) + torch.stack((north, east), dim=-1)
    room = spacing - 2 * (margin - MARGIN)  # between neighbours in their slots
    apart = spacing - torch.maximum(room - MARGIN, room / 2)
    pull, clear = _first_clear_pull(slot, scatter, obstacles, margin, apart)

    state = torch.zeros((*shape, STATE_SIZE))
    state[..., :2] = slot + pull * scatter
    of_team, of_vehicle = HEADING_SPREAD  # neighbours on crossing courses could not miss each other
    heading = course + of_team * draw(torch.randn, 1) + of_vehicle * draw(torch.randn, section.count)
    if model.medium == "air":
        spread = (HEIGHT_SPREAD * draw(torch.randn, section.count)).clamp(-LARGEST_DROP, LARGEST_DROP)
        state[..., DOWN] = -config.track.flight_height * (1 + spread)
    level = torch.zeros_like(heading)
    state[..., QUATERNION] = torch_quaternion_from_euler(level, level, heading)
    low, high = SPEED_RANGE
    state[..., SURGE] = config.pace(team).speed * (low + (high - low) * draw(torch.rand, 1))
    return state, clear & _way_clear(state, obstacles, margin)


def _bow(state: Tensor) -> Tensor:
    """Direction [.., vehicle, 2] (NED) in which vehicles [.., vehicle, 13] head."""
    heading = torch_heading(state[..., QUATERNION])
    return torch.stack((heading.cos(), heading.sin()), dim=-1)


def _way_clear(state: Tensor, obstacles: Tensor, margin: float) -> Tensor:
    """Whether vehicles [world, start, vehicle, 13] keep `margin` (m) from obstacles for `CLEAR_TIME` [world, start]."""
    way = (CLEAR_TIME * state[..., SURGE, None] * _bow(state)).unsqueeze(3)
    to = obstacles[:, None, None, :, :2] - state[..., None, :2]
    share = (to * way).sum(-1, keepdim=True) / way.square().sum(-1, keepdim=True).clamp(min=1e-6)
    apart = (to - share.clamp(0.0, 1.0) * way).norm(dim=-1) - obstacles[:, None, None, :, Cylinder.RADIUS]
    return (apart > margin).flatten(2).all(-1)


def _ahead(state: Tensor, obstacles: Tensor, speed: float, margin: float) -> Tensor:
    """Obstacles that vehicles [world, start, vehicle, 13] have not passed by `margin` (m) and could meet within
    `FREE_TIME` at a `speed`: bool [.., obstacle].
    """
    to, radius = obstacles[:, None, None, :, :2] - state[..., None, :2], obstacles[:, None, None, :, Cylinder.RADIUS]
    ahead = (to * _bow(state).unsqueeze(3)).sum(-1) > -(radius + margin)
    return ahead & (to.norm(dim=-1) - radius < FREE_TIME * speed)


def _above(state: Tensor, obstacles: Tensor, speed: float, margin: float) -> Tensor:
    """Raise aircraft [world, start, vehicle, 13] to `margin` (m) above the obstacles ahead, if they are lower."""
    tops = _ahead(state, obstacles, speed, margin) * obstacles[:, None, None, :, Cylinder.HEIGHT]
    state[..., DOWN] = torch.minimum(state[..., DOWN], -(tops + margin).amax(-1))
    return state


def _pass_clear(state: Tensor, speed: float, apart: float) -> Tensor:
    """Whether vehicles [.., vehicle, 13] that go straight on for `TURNING_TIME` stay `apart` (m) in plan view [..].

    In any wind, velocities differ by at most the greatest `speed` over ground times the difference of the courses, in
    a direction that is not known before the wind is.
    """
    gap, turn = (x.unsqueeze(-2) - x.unsqueeze(-3) for x in (state[..., :2], _bow(state)))
    nearing = (gap * turn).sum(-1) < 0.0
    least = gap.norm(dim=-1) - TURNING_TIME * speed * turn.norm(dim=-1) * nearing
    return (least + 1e9 * torch.eye(least.shape[-1])).amin(dim=(-2, -1)) > apart


def _mates(state: Tensor) -> tuple[Tensor, Tensor]:
    """Places (m) and velocities (m/s) of vehicles [.., vehicle, 13] from each other: [.., vehicle, vehicle, 2]."""
    place, velocity = state[..., :2], state[..., SURGE, None] * _bow(state)
    gap, nearing = (x.unsqueeze(-2) - x.unsqueeze(-3) for x in (place, velocity))
    return gap, nearing


def _mates_clear(state: Tensor, apart: float) -> Tensor:
    """Whether vehicles [.., vehicle, 13] that keep their velocity for `STOPPING_TIME` stay `apart` (m) [..]."""
    gap, nearing = _mates(state)
    time = -(gap * nearing).sum(-1) / nearing.square().sum(-1).clamp(min=1e-6)
    least = (gap + time.clamp(0.0, STOPPING_TIME).unsqueeze(-1) * nearing).norm(dim=-1)
    return (least + 1e9 * torch.eye(least.shape[-1])).amin(dim=(-2, -1)) > apart


def _could_meet(state: Tensor, apart: float) -> Tensor:
    """Whether two vehicles [.., vehicle, 13] near each other so fast that they would be `apart` (m) within
    `STOPPING_TIME`: both may turn, and then a miss by their courses at the start does not count [..].
    """
    gap, nearing = _mates(state)
    far = gap.norm(dim=-1) + 1e9 * torch.eye(gap.shape[-2])
    return (far + STOPPING_TIME * ((gap * nearing).sum(-1) / far).clamp(max=0.0)).amin(dim=(-2, -1)) < apart


def _first_clear_pull(
    slot: Tensor, scatter: Tensor, obstacles: Tensor, margin: float, apart: Tensor
) -> tuple[Tensor, Tensor]:
    """Largest share [world, start, 1, 1] of `scatter` at which the whole team keeps `margin` (m) from obstacles and
    is `apart` [world, start] (m), and whether there is any [world, start].
    """
    count = slot.shape[2]
    best = torch.zeros((*slot.shape[:2], 1, 1))
    any_clear = torch.zeros(slot.shape[:2], dtype=torch.bool)
    for share in reversed(PULLS):
        place = slot + share * scatter
        if obstacles.shape[1]:
            axis = obstacles[:, None, None, :, :2]
            gap = (place.unsqueeze(3) - axis).norm(dim=-1) - obstacles[:, None, None, :, Cylinder.RADIUS]
            clear = gap.amin(dim=(2, 3)) > margin
        else:
            clear = torch.ones(place.shape[:2], dtype=torch.bool)
        if count > 1:
            gap = torch.cdist(place, place) + 1e9 * torch.eye(count)
            clear &= gap.amin(dim=(2, 3)) > apart
        best = torch.where(clear[..., None, None], torch.full_like(best, share), best)
        any_clear |= clear
    return best, any_clear


class Worlds(NamedTuple):
    """A scenario's worlds, and the route that they have in common, if there is one."""

    tracks: Tracks
    obstacles: Tensor  # [world, count, 4] generated ones
    route: Route | None


def generate_worlds(config: FormationScenario, seed: int) -> Worlds:
    """Tracks, generated obstacles and route of a scenario."""
    track, cylinders = config.track, config.obstacles
    _, widest = _half_widths(config)
    tracks, route = _route(config, Path(track.file)) if track.file else (None, None)
    try:
        tracks = tracks or generate_tracks(
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
        of = f"file = {track.file!r}" if track.file else f"length = {track.length}"
        raise ConfigError(
            f"scenario {config.name!r}: the tracks (track.{of}, track.min_radius = {track.min_radius}, area = "
            f"{config.area}) or the obstacles do not fit: {error}"
        ) from None
    return Worlds(tracks, obstacles, route)


def _route(config: FormationScenario, file: Path) -> tuple[Tracks, Route]:
    """The track of a file, in all worlds, and its route."""
    route, track = read_route(file), config.track
    tracks, height = laid(route, file, track.min_radius, track.worlds), track.flight_height
    room = 2 * float(tracks.table[0, :, :2].abs().max()) + 2 * EDGE
    aloft = any(config.formations[name].medium == "air" for name in config.acting)
    heights = route.height[np.isfinite(route.height)]
    low, high = (heights.min(), heights.max()) if len(heights) else (height, height)
    crossed = [k for k, fence in enumerate(route.fences) if (fence.clearance(tracks.table[0, :, :2]) <= 0).any()]
    refuse(
        ConfigError,
        (room > config.area, f"area = {config.area:g}: track.file, with {EDGE:g} m around it, needs {room:.5g}"),
        (
            aloft and (low < height - 1.0 or high > height + 1.0),
            f"{file}: its altitudes are {low:g} to {high:g} m, track.flight_height is {height:g} m: aircraft hold one "
            "height; give the route one, or none, or the same as track.flight_height",
        ),
        (crossed, f"{file}: the track, which leads from the last waypoint back to the first, crosses geofence "
                  f"{crossed and crossed[0] + 1}, polygons first"),
    )  # fmt: skip
    return tracks, route


def traffic_of(config: FormationScenario, places: Mapping[str, Tensor], speed: float, length: float) -> Traffic:
    """Parameters of a scenario's traffic: in each medium, the moving share of the obstacles that a team would meet.

    Args:
        config: the scenario. places: medium -> slots of a team there [world, start, vehicle, 2], m. speed: of the
            slowest target, m/s. length: of a lap, m.
    """
    track, cylinders = config.track, config.obstacles
    met = cylinders.count * config.episode_duration * speed / length
    if cylinders.moving_fraction * met > MOST_MET:
        raise ConfigError(
            f"obstacles.moving_fraction = {cylinders.moving_fraction:g}: a team that passes {met:.4g} obstacles in "
            f"episode_duration = {config.episode_duration:g} s at target_speed = {speed:g} m/s "
            f"would meet {cylinders.moving_fraction * met:.4g} moving ones, allowed are {MOST_MET}"
        )
    radius = cylinders.radius_min, cylinders.radius_max
    top = track.flight_height + FLYING_SPAN
    heights = {"water": (0.0, VESSEL_TOPS), "air": (track.flight_height - FLYING_SPAN, (top, top))}
    nominal = nominal_conditions(config)
    heading, drift = math.radians(nominal["sea.current.direction_deg"]), nominal["sea.current.speed"]
    return Traffic(
        count=math.ceil(cylinders.moving_fraction * met) if config.episode_duration > SHORTEST else 0,
        spans=tuple(Span(*heights[medium], radius, there) for medium, there in places.items()),
        drifting=cylinders.drifting_fraction, overtaking=cylinders.overtaking_fraction,
        speed=(cylinders.speed_min, cylinders.speed_max),
        current=(drift * math.cos(heading), drift * math.sin(heading)), duration=config.episode_duration,
        team_speed=speed,
    )  # fmt: skip


def draw_traffic(
    config: FormationScenario, tracks: Tracks, starts: Starts, obstacles: Tensor, models: Mapping[str, Vehicle],
    generator: torch.Generator,
) -> Tensor:  # fmt: skip
    """Draw traffic for each start [world, start, 8, body] (rl/guidance/course/obstacles.py), among `obstacles` [world,
    n, 4].
    """
    places: dict[str, Tensor] = {}
    for name, model in models.items():
        offsets = offsets_of(unit_offsets(config.formations[name]), starts.formations[name])
        places.setdefault(model.medium, offsets.float())
    slowest = min(config.pace(name).speed for name in models)
    traffic = traffic_of(config, places, slowest, float(tracks.length_m[0]))
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
    with named(f"scenario {config.name!r}: ", ConfigError, ValueError):
        return traffic.draw(tracks, starts.progress, where, obstacles, generator)


def check_teams(config: FormationScenario, models: Mapping[str, Vehicle]) -> None:
    """Refuse teams, by their vehicles' `models`, that cannot hold their slots, or follow the track in the wind.

    A slot at y to starboard of a leader on a bend of radius R to starboard goes at v (1 - y / R): backwards where
    y > R.
    """
    for name, model in models.items():
        if config.formations[name].speed_over == "air" and model.medium != "air":
            raise ConfigError(f"{name}.speed_over = 'air': {name} does not fly; it needs 'ground'")
    if config.track.speed_over == "air" and not any(model.medium == "air" for model in models.values()):
        raise ConfigError(
            f"track.speed_over = 'air': only {', '.join(models)} is simulated, and nothing flies; it needs 'ground'"
        )
    for name, model in models.items():
        section, tightest, width = config.formations[name], config.track.min_radius, 2 * model.collision_radius
        (least, most), drawn = section.spacings, section.formation.spacing_range
        if section.count > 1 and least <= width:
            key = f"formation.spacing_range = {list(drawn)}" if drawn else f"spacing = {least}"
            raise ConfigError(
                f"{name}.{key}: must be above twice the vehicle's collision_radius, {width} m: neighbours would touch "
                "in their slots"
            )
        for shape in section.shapes:
            reach = lane_half_width((shape,), section.count, most)
            if reach >= tightest:
                raise ConfigError(
                    f"track.min_radius = {tightest}: {name}'s formation {shape!r} ({name}.count = {section.count}, "
                    f"{most:g} m apart) reaches {reach:.3g} m to the side of its leader: slots on the inside of the "
                    "tightest bends would stand still or go backwards"
                )
        _check_flyable(config, name, f"{name}.vehicle = {section.vehicle!r}", model)


def _check_flyable(config: FormationScenario, name: str, vehicle: str, model: Vehicle) -> None:
    """Refuse a track that `model`, of the file `vehicle`, cannot follow: too fast, or too tight if it cannot stop.

    Over ground, the target's speed v needs airspeeds from v - w to v + w. Through the air, its airspeed V_a makes
    speeds over ground up to V_a + w. Either way a bend of radius R needs the lateral acceleration v^2 / R at the
    largest speed over ground v (rl/guidance/targets_and_errors.py), so R must reach v^2 / (g tan(largest bank)).
    """
    low, cruise, high = model.limits.speeds
    track, (speed, over) = config.track, config.pace(name)
    if model.limits.stops and speed > high:
        key = "track" if config.formations[name].target_speed is None else name
        raise ConfigError(f"{key}.target_speed = {speed:g}: {vehicle} goes at most {high:.3g} m/s")
    if model.limits.stops or math.isinf(high):
        return
    wind = strongest_wind(config, track.flight_height)
    most = speed + wind if over == "air" else speed
    needed = (speed, speed) if over == "air" else (speed - wind, speed + wind)
    key = f"{'track' if config.formations[name].target_speed is None else name}.target_speed = {speed} over {over}"
    blows = f"a wind of up to {wind:.3g} m/s at track.flight_height = {track.flight_height}"
    if over == "air" and wind > (1 - LEAST_SHARE) * speed:
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
