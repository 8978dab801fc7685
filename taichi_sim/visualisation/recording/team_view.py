"""The teams in the 3D views and on the map: bodies, trails, slots, targets, rings and wakes, and lines from aircraft.

Lines on the waves move as often as the water around a hull (sea_patch.py). Their heights are rounded, so that the file
compresses well.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import EAST, NORTH
from taichi_sim.visualisation.recording.bodies import body_mesh
from taichi_sim.visualisation.recording.east_north_up import enu, enu_quaternion, level_quaternion, map_point
from taichi_sim.visualisation.recording.episode import Array, Episode, TeamTrack
from taichi_sim.visualisation.recording.palette import PLUMB, TARGET, WATER, Colour
from taichi_sim.visualisation.recording.rerun_stream import Stream
from taichi_sim.visualisation.recording.sea_patch import OFF, Cadence, bias, rounded
from taichi_sim.visualisation.recording.table import ENDING, TABLE, numbers_of

TRAIL_S = 25.0  # age of the oldest point of a wake
TRAIL_POINTS = -1.5  # radius of a trail in points of the screen, whatever the distance
WAKE_S, WAKE_LENGTHS = 0.25, 0.25  # least interval between the points of a wake: time, and vehicle lengths
WAKE_MOST_S = 2.5  # largest interval between the points of a wake
NEWEST = 3  # points of a wake at the hull, which move as often as the water there
WAKE_OFF = 0.1  # m: greatest error of a wake's height; the wake is drawn this much higher
RING = np.linspace(0.0, 2.0 * np.pi, 29)  # rad
SLOT_RING, WATER_RING = 0.75, 0.9  # radii over the larger of length and beam
ABOVE_WATER = 0.02  # lift of lines on the water in lengths, so that the water does not hide them
JUMP_M = 5.0  # a trail is broken where a vehicle moves farther than its speed allows by this much
PLUMB_POINTS = -0.5  # radius in points of the screen, whatever the distance
HOOP = np.linspace(0.0, 2.0 * np.pi, 41)  # rad, a ring in the air
TARGET_BALL = {"water": 0.14, "air": 0.05}  # radius of the target in vehicle lengths; aircraft fly inside it
TARGET_UP = 0.2  # height of a boat's target above the water, in vehicle lengths
PALE = 0.7  # share of white in a ghost's colours
COURSE_S = 1.5  # averaging time of the course that turns the view of aircraft


def surface(episode: Episode, place_n: Array, index: NDArray[np.int64]) -> Array:
    """Elevation [F, ...] (m) at `place_n` [F, ..., 2] (north, east, m) in the steps `index` [F]."""
    if not len(index):
        return np.zeros(place_n.shape[:-1])
    steps = zip(np.asarray(place_n, dtype=np.float64), np.asarray(episode.time_s)[index], strict=True)
    return np.stack([episode.elevation(at[..., NORTH], at[..., EAST], float(time)) for at, time in steps])


def jumps(stream: Stream, team: TeamTrack) -> NDArray[np.bool_]:
    """Mask [T, V] of vehicles placed anew since the previous step: they moved farther than their speed allows."""
    now, key = stream.ns * 1e-9, f"{team.name}/jumps"
    seconds = np.diff(now, prepend=stream.before(f"{key}/time", now))[:, None]
    place = np.asarray(team.position_n, dtype=np.float64)
    before = stream.before(f"{key}/place", place)
    moved = np.linalg.norm(np.diff(place, axis=0, prepend=before[None]), axis=-1)
    return moved > 2.0 * np.linalg.norm(team.velocity_n, axis=-1) * seconds + JUMP_M


def send_rings(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send a ring at each slot, and a ring around each boat that shows the water it floats in."""
    length, beam = team.size_m[:2]
    index = Cadence.of(episode.whole.time_s).steps(stream)
    livery = episode.liveries[team.name]
    above, below = ABOVE_WATER * length, bias(max(float(np.abs(episode.whole.teams[team.name].wave_height).max()), 0.1))
    rings = [("water", team.position_n, WATER_RING, 0.006)]
    if team.slot_n is not None:
        rings.insert(0, ("slot", team.slot_n, SLOT_RING, 0.012))
    for name, middle, share, thick in rings:
        ring = share * max(length, beam) * np.stack([np.cos(RING), np.sin(RING)], axis=-1)
        middle = np.asarray(middle[index, :, :2], dtype=np.float64)
        up = rounded(surface(episode, middle[:, :, None] + ring, index) + above)  # [F, V, 29]
        strips = enu(np.concatenate([np.broadcast_to(ring, (*up.shape, 2)), -(up + below)[..., None]], axis=-1))
        place = enu(np.concatenate([middle, np.full_like(middle[..., :1], below)], axis=-1))
        for vehicle in range(team.vehicles):
            path = f"world/{team.name}/{name}_{vehicle}"
            own = TARGET if vehicle == 0 else livery.of(vehicle)
            colour = own if name == "slot" else WATER
            stream.static(path, rr.LineStrips3D.from_fields(colors=colour, radii=thick * length))
            shape = rr.LineStrips3D.columns(strips=list(strips[:, vehicle]))
            stream.columns(path, [*shape, *rr.Transform3D.columns(translation=place[:, vehicle])], index)


@dataclass
class _Way:
    """The last seconds of a team's tracks, from which its wakes are drawn."""

    first: int  # number of its first step
    time: Array  # [n] s
    place: Array  # [n, V, 3] m
    broken: NDArray[np.bool_]  # [n, V]: placed anew at this step
    up: Array  # [n, V] m, height at which each point was drawn last

    def longer(self, time: Array, place: Array, broken: NDArray[np.bool_]) -> "_Way":
        """The tracks with the steps of another part, without steps too old for a wake."""
        gone = int(np.searchsorted(self.time, time[0] - TRAIL_S))
        new = (time, place, broken, np.full(broken.shape, np.nan))
        old = (self.time, self.place, self.broken, self.up)
        return _Way(self.first + gone, *(np.concatenate([a[gone:], b]) for a, b in zip(old, new, strict=True)))


def send_wakes(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send each boat's wake on the present water: a whole line in each frame."""
    key, whole, livery = f"{team.name}/wakes", episode.whole, episode.liveries[team.name]
    cadence, none = Cadence.of(whole.time_s), np.zeros((0, team.vehicles))
    apart = _steps_between_points(whole.teams[team.name], np.asarray(whole.time_s, dtype=np.float64))
    empty = _Way(stream.first, np.zeros(0), np.zeros((0, team.vehicles, 3)), none.astype(bool), none)
    time, place = np.asarray(episode.time_s, np.float64), np.asarray(team.position_n, np.float64)
    stream.memory[key] = way = stream.memory.get(key, empty).longer(time, place, jumps(stream, team))
    index = cadence.steps(stream)
    strips: list[NDArray[np.float32]] = []
    for step in index + (stream.first - way.first):
        number, now = int(step) + way.first, float(way.time[step])
        begin = int(np.searchsorted(way.time, now - TRAIL_S))
        points = np.append(np.arange(begin + -(begin + way.first) % apart, step, apart), step)  # fixed points
        _draw(episode, team, way, points if number // cadence.stride % cadence.whole == 0 else points[-NEWEST:], now)
        line = enu(np.concatenate([way.place[points, :, :2], -way.up[points, :, None]], axis=-1))
        for vehicle in range(team.vehicles):
            breaks = np.flatnonzero(way.broken[: step + 1, vehicle])
            strips.append(line[points >= (breaks[-1] if len(breaks) else 0), vehicle])
    path, colours = f"world/{team.name}/trails", [livery.of(vehicle) for vehicle in range(team.vehicles)]
    stream.static(path, rr.LineStrips3D.from_fields(colors=colours, radii=TRAIL_POINTS))
    stream.columns(path, rr.LineStrips3D.columns(strips=strips).partition([team.vehicles] * len(index)), index)


def _draw(episode: Episode, team: TeamTrack, way: _Way, points: NDArray[np.int64], now: float) -> None:
    """Move the points of a wake to the surface at step `now` where their error is visible; distant points have more
    tolerance.

    The last point is the boat's own position.
    """
    place = way.place[points]
    up = np.asarray(episode.elevation(place[..., NORTH], place[..., EAST], now), dtype=np.float64)
    off = np.clip(OFF * (np.linalg.norm(place - place[-1], axis=-1) - team.size_m[0]), 0.0, WAKE_OFF)
    up = rounded(up + ABOVE_WATER * team.size_m[0] + off)
    stays = np.abs(up - way.up[points]) <= off  # False for points without a height yet
    way.up[points] = np.where(stays, way.up[points], up)


def _steps_between_points(team: TeamTrack, time: Array) -> int:
    """Number of steps between two points of a wake."""
    if len(time) < 2:
        return 1
    speed = float(np.nanmedian(np.linalg.norm(team.velocity_n, axis=-1)))
    seconds = min(max(WAKE_S, WAKE_LENGTHS * team.size_m[0] / max(speed, 1e-9)), WAKE_MOST_S)
    return max(1, round(seconds / float(np.median(np.diff(time)))))


def send_team(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send bodies, trails, slots and the target of one team, and the frame that its view follows."""
    if team.on_water:
        send_rings(stream, episode, team)
        send_wakes(stream, episode, team)
    else:
        _send_rings_in_air(stream, episode, team)
        _send_trails(stream, episode, team)
        _send_plumb_lines(stream, team)
    stream.columns(f"world/{team.name}/follow", _followed(stream, episode, team))
    _send_target(stream, episode, team)
    _send_bodies(stream, episode, team)
    _send_dots(stream, episode, team)


def _followed(stream: Stream, episode: Episode, team: TeamTrack) -> rr.ComponentColumnList:
    """The frame of the team's view at its first vehicle: upright, and for aircraft along their course."""
    eye = enu(team.position_n[:, 0])
    if team.on_water:
        eye[:, 2] = 0.0  # the view does not heave
        return rr.Transform3D.columns(translation=eye)
    time, velocity = np.asarray(episode.time_s, dtype=np.float64), np.asarray(team.velocity_n[:, 0], dtype=np.float64)
    key = f"{team.name}/course"
    then, was = stream.memory.get(key, (time[:0], velocity[:0]))
    then, was = np.concatenate([then, time]), np.concatenate([was, velocity])
    stream.memory[key] = then[then > time[-1] - COURSE_S], was[then > time[-1] - COURSE_S]
    turn = level_quaternion(smooth_course(then, was)[-len(time) :])
    return rr.Transform3D.columns(translation=eye, quaternion=turn)


def _send_bodies(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send the body of each vehicle, its pose, and its columns of a table (table.py)."""
    position, turn = enu(team.position_n), enu_quaternion(team.quaternion_nb)
    numbers = numbers_of(team)
    for vehicle in range(team.vehicles):
        path = f"world/{team.name}/vehicle_{vehicle}"
        if not stream.has(path):
            body = body_mesh(team, episode.liveries[team.name].of(vehicle))
            normals, colours, corners = body.normals_b, body.colours, team.scale_of(vehicle) * body.vertices_b
            mesh = rr.Mesh3D(vertex_positions=corners, vertex_normals=normals, vertex_colors=colours)
            stream.static(path, mesh)
        row: dict[str, Any] = {name: values[:, vehicle] for name, values in numbers.items()}
        row |= {} if team.ending is None else {ENDING: pa.array([why or "" for why in team.ending[:, vehicle]])}
        pose = rr.Transform3D.columns(translation=position[:, vehicle], quaternion=turn[:, vehicle])
        stream.columns(path, [*pose, *rr.DynamicArchetype.columns(TABLE, components=row)])


def send_ghost(stream: Stream, ghost: Episode) -> None:
    """Send the vehicles of the same episode under another controller: pale bodies, as far as both go."""
    index = np.arange(min(len(stream.ns), len(ghost.time_s)))
    for team in ghost.teams.values():
        position, turn = enu(team.position_n)[index], enu_quaternion(team.quaternion_nb)[index]
        for vehicle in range(team.vehicles):
            path = f"world/{team.name}/ghost_{vehicle}"
            body = body_mesh(team, ghost.liveries[team.name].of(vehicle))
            colours = (PALE * 255 + (1 - PALE) * body.colours).astype(np.uint8)
            corners = team.scale_of(vehicle) * body.vertices_b
            mesh = rr.Mesh3D(vertex_positions=corners, vertex_normals=body.normals_b, vertex_colors=colours)
            stream.static(path, mesh)
            pose = rr.Transform3D.columns(translation=position[:, vehicle], quaternion=turn[:, vehicle])
            stream.columns(path, pose, index)


def _send_dots(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send the vehicles on the map, the first with the team's name."""
    spot, livery = map_point(team.position_n), episode.liveries[team.name]
    named = {"labels": team.name.upper(), "show_labels": True}
    for name, vehicles, look in (
        ("first", np.arange(1), {"radii": -6.0, **named}),
        ("others", np.arange(1, team.vehicles), {"radii": -4.0}),
    ):
        if len(vehicles):
            path, colours = f"map/{team.name}/{name}", [livery.of(vehicle) for vehicle in vehicles]  # pyright: ignore[reportArgumentType]
            stream.static(path, rr.Points2D.from_fields(colors=colours, draw_order=40.0, **look))  # pyright: ignore[reportArgumentType]
            dots = rr.Points2D.columns(positions=spot[:, vehicles].reshape(-1, 2))
            stream.columns(path, dots.partition([len(vehicles)] * len(spot)))


def _send_trails(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send one segment for each step and vehicle; the view shows the last seconds of them."""
    position, jumped = enu(team.position_n), jumps(stream, team)
    before = stream.before(f"{team.name}/trails", position)
    segment = np.stack([np.concatenate([before[None], position[:-1]]), position], axis=2)  # [T, V, 2, 3]
    segment[jumped, 0] = segment[jumped, 1]
    colours = [episode.liveries[team.name].of(vehicle) for vehicle in range(team.vehicles)]
    _send_lines(stream, f"world/{team.name}/trails", segment, colours, TRAIL_POINTS)


def _send_lines(stream: Stream, path: str, points: Array, colours: Colour | list[Colour], radius: float) -> None:
    """Send a line of P points for each vehicle and step, [T, V, P, 3] (m, ENU)."""
    stream.static(path, rr.LineStrips3D.from_fields(colors=colours, radii=radius))
    strips = rr.LineStrips3D.columns(strips=list(points.reshape(-1, *points.shape[2:])))
    stream.columns(path, strips.partition([points.shape[1]] * len(points)))


def smooth_course(time: Array, velocity_n: Array) -> Array:
    """Course [T] (rad) of velocities [T, 3] at `time` (s), averaged over COURSE_S against turbulence."""
    near = np.abs(time[:, None] - time) <= 0.5 * COURSE_S
    return np.arctan2(near @ velocity_n[:, 1], near @ velocity_n[:, 0])


def _send_plumb_lines(stream: Stream, team: TeamTrack) -> None:
    """Send a line from each aircraft down to the sea, which shows its height and position."""
    here = enu(team.position_n)
    foot = np.concatenate([here[..., :2], team.wave_height[..., None].astype(np.float32)], axis=-1)
    _send_lines(stream, f"world/{team.name}/plumb_lines", np.stack([here, foot], axis=2), PLUMB, PLUMB_POINTS)


def _send_target(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send a ball with an arrow along the course; the boats' target rides on the waves."""
    if team.target_n is None:
        return
    length, root = team.size_m[0], f"world/{team.name}/target"
    if team.target_course is not None:
        stream.static(root, rr.Arrows3D(vectors=[[1.2 * length, 0, 0]], colors=TARGET, radii=0.04 * length))
    ball = rr.Ellipsoids3D(half_sizes=[[TARGET_BALL[team.medium] * length] * 3], colors=TARGET, fill_mode="solid")
    stream.static(f"{root}/ball", ball)
    place = enu(team.target_n)
    if team.on_water:
        every = np.arange(len(place))
        place[:, 2] = surface(episode, team.target_n[:, None, :2], every)[:, 0] + TARGET_UP * length
    pose = rr.Transform3D.columns(translation=place, quaternion=level_quaternion(team.course))
    stream.columns(root, pose)
    spot = f"map/{team.name}/target"
    stream.static(spot, rr.Points2D.from_fields(colors=TARGET, radii=-3.0, draw_order=50.0))
    stream.columns(spot, rr.Points2D.columns(positions=map_point(team.target_n)))


def _send_rings_in_air(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send a ring at each slot, upright across the course."""
    if team.slot_n is None:
        return
    length, beam = team.size_m[:2]
    ring = SLOT_RING * max(length, beam) * np.stack([0.0 * HOOP, np.cos(HOOP), np.sin(HOOP)], axis=-1)
    place, turn = enu(team.slot_n), level_quaternion(team.course)
    for vehicle in range(team.vehicles):
        path = f"world/{team.name}/slot_{vehicle}"
        colour = TARGET if vehicle == 0 else episode.liveries[team.name].of(vehicle)
        stream.static(path, rr.LineStrips3D([ring], colors=colour, radii=0.025 * length))
        stream.columns(path, rr.Transform3D.columns(translation=place[:, vehicle], quaternion=turn))
