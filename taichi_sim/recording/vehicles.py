"""The teams in the 3D views and on the map: bodies, trails, slots, targets, and the water under the boats."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.recording.bodies import body_mesh
from taichi_sim.recording.episode import Array, Episode, TeamTrack
from taichi_sim.recording.frames import enu, enu_quaternion, level_quaternion, map_point
from taichi_sim.recording.palette import PLUMB, TARGET, WATER, Colour
from taichi_sim.recording.stream import Stream

TRAIL_S = 25.0  # how much of a trail is shown
WAKE_S = 0.25  # between the points of a boat's trail
JUMP_M = 5.0  # a trail is broken where a vehicle moves farther than its speed allows by this much
TRAIL_POINTS, PLUMB_POINTS = -1.5, -0.5  # radius in points of the screen, whatever the distance
RING = np.linspace(0.0, 2.0 * np.pi, 49)  # rad
SLOT_RING, WATER_RING = 0.75, 0.9  # radii, of the longer of length and beam
TARGET_BALL = {"water": 0.14, "air": 0.05}  # radius of the target, of the length: an aircraft flies in it
TARGET_UP = 0.2  # of the length: height of a boat's target over the water
COURSE_S = 1.5  # over which the course is averaged that the view of an aircraft turns with
ABOVE_WATER = 0.02  # of the length: lines on the water are drawn this much higher, that it may not hide them


def send_team(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Bodies, trails, slots and the target of one team, and the frame that its view follows."""
    root, position = f"world/{team.name}", enu(team.position_n)
    eye = position[:, 0].copy()
    if team.on_water:
        eye[:, 2] = 0.0  # the view does not heave
        frame = rr.Transform3D.columns(translation=eye)
        _send_rings_on_water(stream, episode, team)
        _send_wakes(stream, episode, team)
    else:
        frame = rr.Transform3D.columns(translation=eye, quaternion=level_quaternion(smooth_course(episode, team)))
        _send_rings_in_air(stream, episode, team)
        _send_trails(stream, episode, team)
        _send_plumb_lines(stream, team)
    stream.columns(f"{root}/follow", frame)
    _send_target(stream, episode, team)
    for vehicle in range(team.vehicles):
        place, colour = f"{root}/vehicle_{vehicle}", episode.liveries[team.name].of(vehicle)
        body = body_mesh(team, colour)
        mesh = rr.Mesh3D(vertex_positions=body.vertices_b, vertex_normals=body.normals_b, vertex_colors=body.colours)
        stream.static(place, mesh)
        pose = rr.Transform3D.columns(
            translation=position[:, vehicle], quaternion=enu_quaternion(team.quaternion_nb[:, vehicle])
        )
        stream.columns(place, pose)
        dot = rr.Points2D.from_fields(
            colors=colour,
            radii=-6.0 if vehicle == 0 else -4.0,
            draw_order=40.0,
            labels=team.name.upper(),
            show_labels=vehicle == 0,
        )
        stream.static(f"map/{team.name}/vehicle_{vehicle}", dot)
        spot = rr.Points2D.columns(positions=map_point(team.position_n[:, vehicle]))
        stream.columns(f"map/{team.name}/vehicle_{vehicle}", spot)


def jumps(stream: Stream, team: TeamTrack) -> NDArray[np.bool_]:
    """[T, V]: a vehicle has been put elsewhere since the step before, for it moved farther than its speed allows."""
    seconds = np.diff(stream.ns, prepend=stream.ns[:1])[:, None] * 1e-9
    reach = np.linalg.norm(team.velocity_n, axis=-1) * seconds
    moved = np.linalg.norm(np.diff(team.position_n, axis=0, prepend=team.position_n[:1]), axis=-1)
    return moved > 2.0 * reach + JUMP_M


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


def _send_wakes(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """The last seconds of each boat's way, on the water as it is now: a whole line per step."""
    time = np.asarray(episode.time_s, dtype=np.float64)
    stride = max(1, round(WAKE_S / float(np.median(np.diff(time))))) if len(time) > 1 else 1
    jumped = jumps(stream, team)
    strips: list[list[NDArray[np.float32]]] = [[] for _ in range(team.vehicles)]
    for step, now in enumerate(time):
        first = int(np.searchsorted(time, now - TRAIL_S))
        way = np.append(np.arange(-(-first // stride) * stride, step, stride), step)  # the same points every step
        place = np.asarray(team.position_n[way, :, :2], dtype=np.float64)
        up = episode.elevation(place[..., 0], place[..., 1], float(now)) + ABOVE_WATER * team.size_m[0]
        points = enu(np.concatenate([place, -up[..., None]], axis=-1))
        for vehicle, strip in enumerate(strips):
            breaks = np.flatnonzero(jumped[: step + 1, vehicle])
            strip.append(points[way >= (breaks[-1] if len(breaks) else 0), vehicle])
    for vehicle, strip in enumerate(strips):
        path, colour = f"world/{team.name}/trail_{vehicle}", episode.liveries[team.name].of(vehicle)
        stream.static(path, rr.LineStrips3D.from_fields(colors=colour, radii=TRAIL_POINTS))
        stream.columns(path, rr.LineStrips3D.columns(strips=strip))


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
    ball = rr.Ellipsoids3D(half_sizes=[[TARGET_BALL[team.medium] * length] * 3], colors=TARGET, fill_mode="solid")
    if team.target_course is not None:
        stream.static(root, rr.Arrows3D(vectors=[[1.2 * length, 0, 0]], colors=TARGET, radii=0.04 * length))
    stream.static(f"{root}/ball", ball)
    place = enu(team.target_n)
    if team.on_water:
        place[:, 2] = _surface(episode, team.target_n[:, None, None, :2])[:, 0, 0] + TARGET_UP * length
    pose = rr.Transform3D.columns(translation=place, quaternion=level_quaternion(team.course))
    stream.columns(root, pose)
    spot = f"map/{team.name}/target"
    stream.static(spot, rr.Points2D.from_fields(colors=TARGET, radii=-3.0, draw_order=50.0))
    stream.columns(spot, rr.Points2D.columns(positions=map_point(team.target_n)))


def _surface(episode: Episode, place_n: Array) -> Array:
    """Elevation [T, ...] (m) at `place_n` [T, ..., 2] (north, east, m)."""
    steps = zip(np.asarray(place_n, dtype=np.float64), episode.time_s, strict=True)
    return np.stack([episode.elevation(at[..., 0], at[..., 1], float(time)) for at, time in steps])


def _slot_colour(episode: Episode, team: TeamTrack, vehicle: int) -> Colour:
    return TARGET if vehicle == 0 else episode.liveries[team.name].of(vehicle)


def _send_rings_in_air(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """A ring at each slot, upright and across the course."""
    if team.slot_n is None:
        return
    length, beam = team.size_m[:2]
    ring = SLOT_RING * max(length, beam) * np.stack([0.0 * RING, np.cos(RING), np.sin(RING)], axis=-1)
    place, turn = enu(team.slot_n), level_quaternion(team.course)
    for vehicle in range(team.vehicles):
        path = f"world/{team.name}/slot_{vehicle}"
        stream.static(path, rr.LineStrips3D([ring], colors=_slot_colour(episode, team, vehicle), radii=0.025 * length))
        stream.columns(path, rr.Transform3D.columns(translation=place[:, vehicle], quaternion=turn))


def _send_rings_on_water(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Rings that lie on the waves: one at each slot, and one around each boat that shows the water it floats in."""
    length, beam = team.size_m[:2]
    for name, middle, share, thick in (
        ("slot", team.slot_n, SLOT_RING, 0.012),
        ("water", team.position_n, WATER_RING, 0.006),
    ):
        if middle is None:
            continue
        ring = share * max(length, beam) * np.stack([np.cos(RING), np.sin(RING)], axis=-1)
        place = middle[..., None, :2] + ring  # [T, V, 49, 2]
        up = _surface(episode, place)
        strips = enu(np.concatenate([place, -up[..., None] - ABOVE_WATER * length], axis=-1))
        for vehicle in range(team.vehicles):
            path = f"world/{team.name}/{name}_{vehicle}"
            colour = _slot_colour(episode, team, vehicle) if name == "slot" else WATER
            stream.static(path, rr.LineStrips3D.from_fields(colors=colour, radii=thick * length))
            stream.columns(path, rr.LineStrips3D.columns(strips=list(strips[:, vehicle])))
