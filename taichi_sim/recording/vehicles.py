"""The teams in the 3D views and on the map: bodies, trails, slots, targets, and lines from aircraft."""

import numpy as np
import rerun as rr

from taichi_sim.recording.bodies import body_mesh
from taichi_sim.recording.episode import Array, Episode, TeamTrack
from taichi_sim.recording.frames import enu, enu_quaternion, level_quaternion, map_point
from taichi_sim.recording.palette import PLUMB, TARGET, Colour
from taichi_sim.recording.stream import Stream
from taichi_sim.recording.water_lines import SLOT_RING, TRAIL_POINTS, jumps, send_rings, send_wakes, surface

PLUMB_POINTS = -0.5  # radius in points of the screen, whatever the distance
RING = np.linspace(0.0, 2.0 * np.pi, 41)  # rad, points of an upright ring
TARGET_BALL = {"water": 0.14, "air": 0.05}  # radius of the target in vehicle lengths; aircraft fly inside it
TARGET_UP = 0.2  # height of a boat's target above the water, in vehicle lengths
COURSE_S = 1.5  # averaging time of the course that turns the view of aircraft


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
    """Send the body of each vehicle and its pose."""
    position, turn = enu(team.position_n), enu_quaternion(team.quaternion_nb)
    for vehicle in range(team.vehicles):
        path = f"world/{team.name}/vehicle_{vehicle}"
        if not stream.has(path):
            body = body_mesh(team, episode.liveries[team.name].of(vehicle))
            normals, colours = body.normals_b, body.colours
            mesh = rr.Mesh3D(vertex_positions=body.vertices_b, vertex_normals=normals, vertex_colors=colours)
            stream.static(path, mesh)
        stream.columns(path, rr.Transform3D.columns(translation=position[:, vehicle], quaternion=turn[:, vehicle]))


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
    ring = SLOT_RING * max(length, beam) * np.stack([0.0 * RING, np.cos(RING), np.sin(RING)], axis=-1)
    place, turn = enu(team.slot_n), level_quaternion(team.course)
    for vehicle in range(team.vehicles):
        path = f"world/{team.name}/slot_{vehicle}"
        colour = TARGET if vehicle == 0 else episode.liveries[team.name].of(vehicle)
        stream.static(path, rr.LineStrips3D([ring], colors=colour, radii=0.025 * length))
        stream.columns(path, rr.Transform3D.columns(translation=place[:, vehicle], quaternion=turn))
