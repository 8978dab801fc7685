"""The teams in the 3D views and on the map: bodies, trails, slots, targets, and what is special to aircraft."""

import numpy as np
import rerun as rr

from taichi_sim.recording.bodies import body_mesh
from taichi_sim.recording.episode import Array, Episode, TeamTrack
from taichi_sim.recording.frames import enu, enu_quaternion, level_quaternion, map_point
from taichi_sim.recording.palette import PLUMB, TARGET
from taichi_sim.recording.stream import Stream
from taichi_sim.recording.water_lines import RING, SLOT_RING, TRAIL_POINTS, jumps, send_rings, send_wakes, surface

PLUMB_POINTS = -0.5  # radius in points of the screen, whatever the distance
TARGET_BALL = {"water": 0.14, "air": 0.05}  # radius of the target, of the length: an aircraft flies in it
TARGET_UP = 0.2  # of the length: height of a boat's target over the water
COURSE_S = 1.5  # over which the course is averaged that the view of an aircraft turns with


def send_team(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Bodies, trails, slots and the target of one team, and the frame that its view follows."""
    if team.on_water:
        send_rings(stream, episode, team)
        send_wakes(stream, episode, team)
    else:
        _send_rings_in_air(stream, episode, team)
        _send_trails(stream, episode, team)
        _send_plumb_lines(stream, team)
    stream.columns(f"world/{team.name}/follow", _followed(episode, team))
    _send_target(stream, episode, team)
    _send_bodies(stream, episode, team)
    _send_dots(stream, episode, team)


def _followed(episode: Episode, team: TeamTrack) -> rr.ComponentColumnList:
    """The frame of the team's view, at its first vehicle: upright; of aircraft along their course."""
    eye = enu(team.position_n[:, 0])
    if team.on_water:
        eye[:, 2] = 0.0  # the view does not heave
        return rr.Transform3D.columns(translation=eye)
    return rr.Transform3D.columns(translation=eye, quaternion=level_quaternion(smooth_course(episode, team)))


def _send_bodies(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """The body of each vehicle and its pose."""
    position, turn = enu(team.position_n), enu_quaternion(team.quaternion_nb)
    for vehicle in range(team.vehicles):
        path = f"world/{team.name}/vehicle_{vehicle}"
        body = body_mesh(team, episode.liveries[team.name].of(vehicle))
        mesh = rr.Mesh3D(vertex_positions=body.vertices_b, vertex_normals=body.normals_b, vertex_colors=body.colours)
        stream.static(path, mesh)
        stream.columns(path, rr.Transform3D.columns(translation=position[:, vehicle], quaternion=turn[:, vehicle]))


def _send_dots(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """The vehicles on the map: the first with the team's name, and the others."""
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
    """One segment per step and vehicle; the view shows the last seconds of them."""
    position, jumped = enu(team.position_n), jumps(stream, team)
    for vehicle in range(team.vehicles):
        path, here = f"world/{team.name}/trail_{vehicle}", position[:, vehicle]
        segment = np.stack([np.concatenate([here[:1], here[:-1]]), here], axis=1)
        segment[jumped[:, vehicle], 0] = segment[jumped[:, vehicle], 1]
        line = rr.LineStrips3D.from_fields(colors=episode.liveries[team.name].of(vehicle), radii=TRAIL_POINTS)
        stream.static(path, line)
        stream.columns(path, rr.LineStrips3D.columns(strips=list(segment)))


def smooth_course(episode: Episode, team: TeamTrack) -> Array:
    """[T] course (rad) of the first over ground, averaged over a short time, so that turbulence does not shake it."""
    time = np.asarray(episode.time_s, dtype=np.float64)
    near = np.abs(time[:, None] - time) <= 0.5 * COURSE_S
    north, east = near @ np.asarray(team.velocity_n[:, 0, 0]), near @ np.asarray(team.velocity_n[:, 0, 1])
    return np.arctan2(east, north)


def _send_plumb_lines(stream: Stream, team: TeamTrack) -> None:
    """From each aircraft down to the sea: how high it is, and over what."""
    for vehicle in range(team.vehicles):
        here = enu(team.position_n[:, vehicle])
        foot = np.column_stack([here[:, :2], team.wave_height[:, vehicle].astype(np.float32)])
        path = f"world/{team.name}/plumb_{vehicle}"
        stream.static(path, rr.LineStrips3D.from_fields(colors=PLUMB, radii=PLUMB_POINTS))
        stream.columns(path, rr.LineStrips3D.columns(strips=list(np.stack([here, foot], axis=1))))


def _send_target(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """A ball with an arrow along the course; that of the boats rides on the waves."""
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
    """A ring at each slot, upright and across the course."""
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
