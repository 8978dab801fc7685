"""What the 3D views show (`world/...`, east-north-up, m) and the map (`map/...`, east and south, m)."""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.recording.episode import Array, Episode, TeamTrack
from taichi_sim.recording.frames import enu, enu_quaternion, map_point
from taichi_sim.recording.meshes import BODIES
from taichi_sim.recording.palette import (
    ALARM,
    CHECKPOINT,
    FRAME,
    OBSTACLE,
    TARGET,
    TRACK,
    Colour,
    vehicle_colour,
    vehicle_name,
)
from taichi_sim.recording.sea_patch import sea_frames, sea_triangles
from taichi_sim.recording.stream import Stream

ERRORS = {"collision", "capsized", "lost"}  # kinds of event that end a run; the others warn
JUMP_M = 5.0  # a trail is broken where a vehicle moves farther than its speed allows by this much
SUNK_M = 6.0  # how far an obstacle reaches below mean sea level, so that no trough shows its foot
CHECKPOINT_UP_M = 3.0  # height of a checkpoint's mark
# radii below zero are in points of the screen, whatever the distance
TRACK_POINTS, TRAIL_POINTS, MAP_POINTS = -1.2, -1.5, -1.5


def line_lift(episode: Episode) -> float:
    """How much higher than they lie the lines on the sea are drawn, m: else the crests would hide them."""
    return max(float(np.quantile(np.abs(episode.afloat.wave_height), 0.9)), 0.1)


def send_scene(stream: Stream, episode: Episode) -> None:
    """Tracks, checkpoints, obstacles and the border of the area."""
    scene = episode.scene
    for name, track in scene.tracks_n.items():
        path = enu(track)
        path[:, 2] += line_lift(episode) if name == "usv" else 0.0
        stream.static(f"world/track/{name}", rr.LineStrips3D([path], colors=TRACK[name], radii=TRACK_POINTS))
        flat = rr.LineStrips2D([map_point(track)], colors=TRACK[name], radii=MAP_POINTS)
        stream.static(f"map/track/{name}", flat)
    if len(scene.checkpoints_n):
        numbers = [str(number + 1) for number in range(len(scene.checkpoints_n))]
        spot = map_point(scene.checkpoints_n)
        place = np.column_stack([spot[:, 0], -spot[:, 1], np.full(len(spot), CHECKPOINT_UP_M)])
        stream.static("world/checkpoints", rr.Points3D(place, labels=numbers, colors=CHECKPOINT, radii=0.8))
        mark = rr.Points2D(
            spot, labels=numbers, show_labels=True, colors=CHECKPOINT, radii=-4.0, draw_order=20.0
        )
        stream.static("map/checkpoints", mark)
    if len(scene.obstacles):
        radius, height = np.asarray(scene.obstacles[:, 2:], dtype=np.float32).T
        spot = map_point(scene.obstacles[:, :2])
        centre = np.column_stack([spot[:, 0], -spot[:, 1], 0.5 * (height - SUNK_M)])
        pillar = rr.Cylinders3D(
            lengths=height + SUNK_M, radii=radius, centers=centre, colors=OBSTACLE, fill_mode="solid"
        )
        stream.static("world/obstacles", pillar)
        stream.static("map/obstacles", rr.Points2D(spot, radii=radius, colors=OBSTACLE))
    side = scene.area_m
    border = rr.Boxes2D(mins=[-0.5 * side, -0.5 * side], sizes=[side, side], colors=FRAME)
    stream.static("map/area", border)


def send_sea(stream: Stream, episode: Episode) -> None:
    """The patch of sea that follows the formation."""
    stream.static("world/sea", rr.Mesh3D.from_fields(triangle_indices=sea_triangles()))
    for frames in sea_frames(episode):
        count, points = frames.vertices.shape[:2]
        surface = rr.Mesh3D.columns(
            vertex_positions=frames.vertices.reshape(-1, 3), vertex_colors=frames.colours.reshape(-1, 3)
        ).partition([points] * count)
        stream.columns("world/sea", surface, frames.index)
        stream.columns("world/sea", rr.Transform3D.columns(translation=frames.origin_enu), frames.index)


def send_team(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Bodies, trails, slots and the target of one team, and the frame that its view follows."""
    root, position = f"world/{team.name}", enu(team.position_n)
    eye = position[:, 0].copy()
    eye[:, 2] = -team.target_n[:, 2].mean()
    stream.columns(f"{root}/follow", rr.Transform3D.columns(translation=eye))
    _send_target(stream, team)
    _send_slots(stream, episode, team)
    lift = np.array([0.0, 0.0, line_lift(episode) if team.name == "usv" else 0.0], np.float32)
    for vehicle in range(team.vehicles):
        place, colour = f"{root}/vehicle_{vehicle}", vehicle_colour(team.name, vehicle)
        body = BODIES[team.name](team.size_m, colour)
        mesh = rr.Mesh3D(
            vertex_positions=body.vertices_b, vertex_normals=body.normals_b, vertex_colors=body.colours
        )
        stream.static(place, mesh)
        pose = rr.Transform3D.columns(
            translation=position[:, vehicle], quaternion=enu_quaternion(team.quaternion_nb[:, vehicle])
        )
        stream.columns(place, pose)
        trail = position[:, vehicle] + lift
        _send_trail(stream, f"{root}/trail_{vehicle}", trail, team.velocity_n[:, vehicle], colour)
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


def _send_trail(
    stream: Stream, path: str, position: NDArray[np.float32], velocity_n: Array, colour: Colour
) -> None:
    """One segment per step [T, 2, 3]; the view shows the last seconds of them."""
    segment = np.stack([np.concatenate([position[:1], position[:-1]]), position], axis=1)
    seconds = np.diff(stream.ns, prepend=stream.ns[:1]) * 1e-9
    reach = np.linalg.norm(velocity_n, axis=-1) * seconds
    jump = np.linalg.norm(segment[:, 1] - segment[:, 0], axis=-1) > 2.0 * reach + JUMP_M
    segment[jump, 0] = segment[jump, 1]
    stream.static(path, rr.LineStrips3D.from_fields(colors=colour, radii=TRAIL_POINTS))
    stream.columns(path, rr.LineStrips3D.columns(strips=list(segment)))


def _course_quaternion(team: TeamTrack) -> NDArray[np.float32]:
    """[T, 4] of a level frame that points along the target's course."""
    half = 0.5 * np.asarray(team.target_course, dtype=np.float64)
    return enu_quaternion(np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1))


def _send_target(stream: Stream, team: TeamTrack) -> None:
    """A ball with an arrow along the course."""
    length, root = team.size_m[0], f"world/{team.name}/target"
    arrow = rr.Arrows3D(vectors=[[1.2 * length, 0, 0]], colors=TARGET, radii=0.04 * length)
    ball = rr.Ellipsoids3D(half_sizes=[[0.14 * length] * 3], colors=TARGET, fill_mode="solid")
    stream.static(root, arrow)
    stream.static(f"{root}/ball", ball)
    pose = rr.Transform3D.columns(translation=enu(team.target_n), quaternion=_course_quaternion(team))
    stream.columns(root, pose)
    spot = f"map/{team.name}/target"
    stream.static(spot, rr.Points2D.from_fields(colors=TARGET, radii=-3.0, draw_order=50.0))
    stream.columns(spot, rr.Points2D.columns(positions=map_point(team.target_n)))


def _send_slots(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """A ring at each slot: lying on the water, or upright in the air and across the course."""
    length, beam = team.size_m[:2]
    angle = np.linspace(0.0, 2.0 * np.pi, 33)
    ring = 0.75 * max(length, beam) * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
    slot = np.array(team.slot_n, dtype=np.float64)
    if team.name == "uav":
        ring = ring[:, [2, 0, 1]]
    else:
        for step, time in enumerate(episode.time_s):
            up = episode.elevation(slot[step, :, 0], slot[step, :, 1], float(time))
            slot[step, :, 2] = -up - 0.1 * length  # a little above the water, that it may be seen
    place, turn = enu(slot), _course_quaternion(team)
    for vehicle in range(team.vehicles):
        colour = TARGET if vehicle == 0 else vehicle_colour(team.name, vehicle)
        path = f"world/{team.name}/slot_{vehicle}"
        stream.static(path, rr.LineStrips3D([ring], colors=colour, radii=0.025 * length))
        stream.columns(path, rr.Transform3D.columns(translation=place[:, vehicle], quaternion=turn))


def send_events(stream: Stream, episode: Episode) -> None:
    """For each event a line in the log, and a mark in space that stays from then on."""
    if not episode.events:
        return
    happened = sorted(episode.events, key=lambda event: event.time_s)
    index = np.searchsorted(episode.time_s, [event.time_s - 1e-6 for event in happened])
    index = np.minimum(index, len(episode.time_s) - 1)
    texts = [f"{vehicle_name(event.team, event.vehicle)} {event.kind}: {event.text}" for event in happened]
    levels = ["ERROR" if event.kind in ERRORS else "WARN" for event in happened]
    stream.columns("events", rr.TextLog.columns(text=texts, level=levels), index)
    places = [
        episode.teams[event.team].position_n[step, event.vehicle]
        for event, step in zip(happened, index, strict=True)
    ]
    radius = 0.25 * max(team.size_m[0] for team in episode.teams.values())
    stream.static("world/events", rr.Points3D.from_fields(colors=ALARM, radii=radius))
    # each row holds the events so far: the latest row is what the viewer draws
    counts = np.arange(1, len(happened) + 1)
    so_far = np.concatenate([np.arange(count) for count in counts])
    marks = rr.Points3D.columns(
        positions=enu(np.stack(places))[so_far], labels=[happened[number].kind for number in so_far]
    )
    stream.columns("world/events", marks.partition(counts), index)
