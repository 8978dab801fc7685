"""The static scene in the 3D views (`world/...`, east-north-up, m) and on the map (`map/...`, east and south, m)."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import DOWN, HORIZONTAL
from taichi_sim.visualisation.recording.east_north_up import enu, map_point
from taichi_sim.visualisation.recording.episode import Array, Episode
from taichi_sim.visualisation.recording.overlays import Note
from taichi_sim.visualisation.recording.palette import CHECKPOINT, FRAME, OBSTACLE, Colour
from taichi_sim.visualisation.recording.rerun_stream import Stream
from taichi_sim.visualisation.recording.sea_patch import SeaPatch, patch_of

LEVELS = {"stall": "WARN"}  # log level of a kind of event; others are an "ERROR", or "INFO" if they are a goal
SUNK_M = 6.0  # depth of an obstacle below mean sea level, so that no trough shows its foot
CHECKPOINT_UP_M = 3.0  # height of a checkpoint's mark above the track
MAP_MARGIN_M, MAP_LEAST_M = 120.0, 20.0  # margin of the map: the second plus the extent, at most the first
# radii below zero are in points of the screen, whatever the distance
TRACK_POINTS, MAP_POINTS = -1.2, -1.5


def line_lift(episode: Episode) -> float:
    """Lift of lines drawn on the sea, m, so that crests do not hide them."""
    return max(float(np.quantile(np.abs(episode.whole.afloat.wave_height), 0.9)), 0.1)


def map_bounds(episode: Episode) -> tuple[Array, Array]:
    """South-west and north-east corner [2] (north, east, m) of the map."""
    episode = episode.whole
    tracks = [track[:, HORIZONTAL] for track in episode.scene.tracks_n.values()]
    ways = [team.position_n[..., HORIZONTAL].reshape(-1, 2) for team in episode.teams.values()]
    places = np.concatenate([*tracks, *ways])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    margin = min(MAP_MARGIN_M, MAP_LEAST_M + float(np.max(high - low)))
    return low - margin, high + margin


def send_scene(stream: Stream, episode: Episode) -> None:
    """Send tracks, checkpoints, obstacles and the border of the area, where they exist."""
    scene = episode.scene
    for name, track in scene.tracks_n.items():
        path = enu(track)
        path[:, 2] += line_lift(episode) if episode.teams[name].on_water else 0.0
        colour = episode.liveries[name].track
        stream.static(f"world/track/{name}", rr.LineStrips3D([path], colors=colour, radii=TRACK_POINTS))
        flat = rr.LineStrips2D([map_point(track)], colors=colour, radii=MAP_POINTS)
        stream.static(f"map/track/{name}", flat)
    if len(scene.checkpoints_n):
        numbers = [str(number + 1) for number in range(len(scene.checkpoints_n))]
        spot, radius = map_point(scene.checkpoints_n), 0.2 * episode.afloat.size_m[0]
        track = scene.tracks_n.get(episode.afloat.name)  # of the team that the sea patch follows
        up = np.full(len(spot), CHECKPOINT_UP_M + (0.0 if track is None else -float(np.mean(track[:, DOWN]))))
        place = np.column_stack([spot[:, 0], -spot[:, 1], up])
        stream.static("world/checkpoints", rr.Points3D(place, labels=numbers, colors=CHECKPOINT, radii=radius))
        mark = rr.Points2D(spot, labels=numbers, show_labels=True, colors=CHECKPOINT, radii=-4.0, draw_order=20.0)
        stream.static("map/checkpoints", mark)
    if len(scene.obstacles):
        radius, height = np.asarray(scene.obstacles[:, 2:], dtype=np.float32).T
        spot = map_point(scene.obstacles[:, :2])
        centre = np.column_stack([spot[:, 0], -spot[:, 1], 0.5 * (height - SUNK_M)])
        pillar = {"lengths": height + SUNK_M, "radii": radius, "centers": centre, "colors": OBSTACLE}
        stream.static("world/obstacles", rr.Cylinders3D(**pillar, fill_mode="solid"))
        stream.static("map/obstacles", rr.Points2D(spot, radii=radius, colors=OBSTACLE))
    if scene.area_m is not None:
        half = 0.5 * scene.area_m
        stream.static("map/area", rr.Boxes2D(mins=[-half, -half], sizes=[2.0 * half, 2.0 * half], colors=FRAME))


def send_sea(stream: Stream, episode: Episode) -> None:
    """Send the patches of sea that follow the teams."""
    for name in dict.fromkeys(patch_of(episode.whole).values()):
        team, path = episode.teams[name], f"world/{name}/sea"
        if path not in stream.memory:
            stream.memory[path] = SeaPatch(episode, team)
            triangles = stream.memory[path].grid.triangles()
            corners = rr.Mesh3D.columns(triangle_indices=triangles).partition([len(triangles)])
            # sent as the first row, because rerun writes columns in order but static data at any time
            stream.columns(path, corners, np.arange(1))
        for frames in stream.memory[path].frames(stream, episode, team):
            count, points = frames.vertices.shape[:2]
            surface = rr.Mesh3D.columns(
                vertex_positions=frames.vertices.reshape(-1, 3), vertex_colors=frames.colours.reshape(-1, 3)
            ).partition([points] * count)
            place = rr.Transform3D.columns(translation=frames.origin_enu)
            stream.columns(path, [*surface, *place], frames.index)


def send_events(stream: Stream, episode: Episode) -> None:
    """Send each event and note to the log, and each event as a mark in space that stays."""
    log = [(note.time_s, note.text, note.level) for note in episode.overlays if isinstance(note, Note)]
    for event in episode.events:
        whose = episode.teams[event.team].vehicle_name(event.vehicle)
        level = "INFO" if event.goal else LEVELS.get(event.kind, "ERROR")
        log.append((event.time_s, f"{whose} {event.kind}: {event.text}", level))
    if log:
        times, texts, levels = zip(*sorted(log, key=lambda line: line[0]), strict=True)
        stream.columns("events", rr.TextLog.columns(text=texts, level=levels), _steps(episode, times))
    _mark_events(stream, episode)


def _steps(episode: Episode, times: Sequence[float]) -> NDArray[np.int64]:
    """The steps at `times` (s)."""
    index = np.searchsorted(episode.time_s, np.asarray(times) - 1e-6)
    return np.minimum(index, len(episode.time_s) - 1)


def _mark_events(stream: Stream, episode: Episode) -> None:
    """Send the marks: each row holds all events so far, because the viewer draws the latest row."""
    happened = sorted(episode.events, key=lambda event: event.time_s)
    if not happened:
        return
    index = _steps(episode, [event.time_s for event in happened])
    marked: list[tuple[Array, str, Colour]] = stream.memory.setdefault("world/events", [])
    counts = np.arange(1, len(happened) + 1) + len(marked)
    for event, step in zip(happened, index, strict=True):
        marked.append((episode.teams[event.team].position_n[step, event.vehicle], event.kind, event.colour))
    radius = 0.25 * max(team.size_m[0] for team in episode.teams.values())
    stream.static("world/events", rr.Points3D.from_fields(radii=radius))
    so_far = np.concatenate([np.arange(count) for count in counts])
    places = enu(np.stack([place for place, _, _ in marked]))
    kinds = [marked[number][1] for number in so_far]
    colours = [marked[number][2] for number in so_far]
    marks = rr.Points3D.columns(positions=places[so_far], labels=kinds, colors=colours)
    stream.columns("world/events", marks.partition(counts), index)
