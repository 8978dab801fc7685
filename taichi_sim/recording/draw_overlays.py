"""A mission's overlays in the 3D views, on the map, in the plots and in the log of events."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.recording.episode import Array, Episode
from taichi_sim.recording.frames import enu, level_quaternion, map_point
from taichi_sim.recording.overlays import Arrows, Cylinders, Ellipsoids, Lines, Note, Plot, Points, entity_name
from taichi_sim.recording.palette import FOLLOWERS
from taichi_sim.recording.plots import as_shown, send_plot
from taichi_sim.recording.space import line_lift
from taichi_sim.recording.stream import Stream

ROUND = np.linspace(0.0, 2.0 * np.pi, 33)  # rad, an ellipse on the map


class Look(NamedTuple):
    """One overlay as one of rerun's things: a row for each thing in each frame, those with NaN left out."""

    kind: Any  # rr.Points3D and the like
    rows: dict[str, Any]  # component -> [rows, ...]
    look: dict[str, Any]  # components that hold for all


def send_overlays(stream: Stream, episode: Episode) -> None:
    """Everything in `episode.overlays` but the notes, which are events."""
    lift = line_lift(episode)
    for overlay in episode.overlays:
        if isinstance(overlay, Plot):
            labels, factor = as_shown(overlay.lines, overlay.unit)
            colours = list(overlay.colours) or [FOLLOWERS[line % len(FOLLOWERS)] for line in range(len(labels))]
            send_plot(stream, f"plots/{entity_name(overlay)}", factor * overlay.values, labels, colours)
        elif not isinstance(overlay, Note):
            _send_geometry(stream, overlay, lift if overlay.on_water else 0.0)


def _send_geometry(stream: Stream, overlay: Any, lift: float) -> None:
    arrays, world, flat = KINDS[type(overlay)]
    given = [getattr(overlay, name) for name in arrays]
    frames, count = max(len(array) for array in given), given[0].shape[1]
    values = [np.broadcast_to(array, (frames, *array.shape[1:])).astype(np.float64) for array in given]
    seen = np.logical_and.reduce([_known(name, array) for name, array in zip(arrays, values, strict=True)])
    labels = np.broadcast_to(overlay.labels, (frames, count))[seen].tolist() if overlay.labels else []
    for root, draw in (("world", world), ("map", flat)):
        if overlay.where in (root, "both"):
            look = draw(overlay, lift, *(array[seen] for array in values))
            _send(stream, f"{root}/{entity_name(overlay)}", look, overlay, labels, seen.sum(axis=1))


def _known(name: str, array: Array) -> NDArray[np.bool_]:
    """[F, N]: a thing is known in a frame by all its numbers, a strip by two of its points."""
    finite = np.isfinite(array)
    if name == "points_n":
        return np.asarray(finite.all(axis=-1).sum(axis=-1) >= 2)
    return np.asarray(finite.reshape(*array.shape[:2], -1).all(axis=-1))


def _send(
    stream: Stream, path: str, look: Look, overlay: Any, labels: Sequence[str], counts: NDArray[np.integer]
) -> None:
    rows = look.rows | ({"labels": labels} if labels else {})
    whole = {"colors": overlay.colour} | ({"show_labels": True} if labels else {}) | look.look
    if len(counts) == 1:
        stream.static(path, look.kind.from_fields(**rows, **whole))
    else:
        stream.static(path, look.kind.from_fields(**whole))
        stream.columns(path, look.kind.columns(**rows).partition(counts))


def _raised(place_n: Array, lift: float) -> Array:
    return enu(place_n - (0.0, 0.0, lift))


def _strips(points_n: Array) -> list[Array]:
    return [strip[np.isfinite(strip).all(axis=-1)] for strip in points_n]


def _lines(overlay: Lines, lift: float, points: Array) -> Look:
    strips = [_raised(strip, lift) for strip in _strips(points)]
    return Look(rr.LineStrips3D, {"strips": strips}, {"radii": overlay.radius})


def _flat_lines(overlay: Lines, _: float, points: Array) -> Look:
    return Look(rr.LineStrips2D, {"strips": [map_point(strip) for strip in _strips(points)]}, {"radii": overlay.radius})


def _points(overlay: Points, lift: float, place: Array) -> Look:
    return Look(rr.Points3D, {"positions": _raised(place, lift)}, {"radii": overlay.radius})


def _flat_points(overlay: Points, _: float, place: Array) -> Look:
    return Look(rr.Points2D, {"positions": map_point(place)}, {"radii": overlay.radius})


def _cylinders(_: Cylinders, lift: float, place: Array, size: Array) -> Look:
    rows = {"centers": _raised(place, lift), "radii": size[:, 0], "lengths": size[:, 1]}
    return Look(rr.Cylinders3D, rows, {"fill_mode": "solid"})


def _flat_cylinders(_: Cylinders, __: float, place: Array, size: Array) -> Look:
    return Look(rr.Points2D, {"positions": map_point(place), "radii": size[:, 0]}, {})


def _ellipsoids(_: Ellipsoids, lift: float, place: Array, half_axes: Array, heading: Array) -> Look:
    rows = {"centers": _raised(place, lift), "half_sizes": half_axes, "quaternions": level_quaternion(heading)}
    return Look(rr.Ellipsoids3D, rows, {"fill_mode": "majorwireframe"})


def _flat_ellipsoids(_: Ellipsoids, __: float, place: Array, half_axes: Array, heading: Array) -> Look:
    along, right = half_axes[:, :1] * np.cos(ROUND), half_axes[:, 1:2] * np.sin(ROUND)
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    outline = place[:, None, :2] + np.stack([cos * along - sin * right, sin * along + cos * right], axis=-1)
    return Look(rr.LineStrips2D, {"strips": list(map_point(outline))}, {"radii": -1.2})


def _arrows(overlay: Arrows, lift: float, origin: Array, vector: Array) -> Look:
    return Look(rr.Arrows3D, {"origins": _raised(origin, lift), "vectors": enu(vector)}, {"radii": overlay.radius})


def _flat_arrows(overlay: Arrows, _: float, origin: Array, vector: Array) -> Look:
    return Look(rr.Arrows2D, {"origins": map_point(origin), "vectors": map_point(vector)}, {"radii": overlay.radius})


KINDS: dict[type, tuple[tuple[str, ...], Callable[..., Look], Callable[..., Look]]] = {
    Lines: (("points_n",), _lines, _flat_lines),
    Points: (("position_n",), _points, _flat_points),
    Cylinders: (("position_n", "size_m"), _cylinders, _flat_cylinders),
    Ellipsoids: (("position_n", "half_axes_m", "heading"), _ellipsoids, _flat_ellipsoids),
    Arrows: (("origin_n", "vector_n"), _arrows, _flat_arrows),
}
"""Overlay -> its arrays, and how they look in 3D and on the map."""
