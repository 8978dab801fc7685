"""A mission's overlays in the 3D views, on the map, in the plots and in the log of events."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.visualisation.recording.east_north_up import enu, level_quaternion, map_point
from taichi_sim.visualisation.recording.episode import Array, Episode
from taichi_sim.visualisation.recording.overlays import (
    Arrows,
    Cylinders,
    Ellipsoids,
    Lines,
    Note,
    Plot,
    Points,
    entity_name,
)
from taichi_sim.visualisation.recording.palette import FOLLOWERS
from taichi_sim.visualisation.recording.plots import as_shown, send_plot
from taichi_sim.visualisation.recording.rerun_stream import Stream
from taichi_sim.visualisation.recording.static_scene import line_lift

RIGID_M = 2e-3  # m: largest deformation of a line that counts as rigid
ROUND = np.linspace(0.0, 2.0 * np.pi, 33)  # rad, an ellipse on the map


Geometry = Lines | Points | Cylinders | Ellipsoids | Arrows


class Style(NamedTuple):
    """rerun's archetype and data of one overlay, without items that hold NaN."""

    kind: Any  # such as rr.Points3D
    rows: Mapping[str, Array | list[Array]]  # component -> [rows, ...]
    look: Mapping[str, float | str]  # components that hold for all rows


def send_overlays(stream: Stream, episode: Episode) -> None:
    """Send all of `episode.overlays` except notes, which are events."""
    lift = line_lift(episode)
    drawn = {overlay.name: overlay for overlay in episode.whole.overlays if not isinstance(overlay, Plot | Note)}
    for overlay in episode.overlays:
        if isinstance(overlay, Plot):
            labels, factor = as_shown(overlay.lines, overlay.unit)
            colours = list(overlay.colours) or [FOLLOWERS[line % len(FOLLOWERS)] for line in range(len(labels))]
            send_plot(stream, f"plots/{entity_name(overlay)}", factor * overlay.values, labels, colours)
        elif not isinstance(overlay, Note):
            _send_geometry(stream, overlay, drawn.get(overlay.name, overlay), lift if overlay.on_water else 0.0)


def _send_geometry(stream: Stream, overlay: Geometry, like: Geometry, lift: float) -> None:
    """Send a part of an overlay in the style of `like`, the same overlay of the whole episode."""
    arrays = tuple(overlay.shapes)
    moves = max(len(getattr(one, name)) for one in (overlay, like) for name in arrays) > 1
    given = [getattr(overlay, name) for name in arrays]
    frames, count = max(len(array) for array in given), given[0].shape[1]
    values = [np.broadcast_to(array, (frames, *array.shape[1:])).astype(np.float64) for array in given]
    seen = np.logical_and.reduce([_known(name, array) for name, array in zip(arrays, values, strict=True)])
    labels = np.broadcast_to(overlay.labels, (frames, count))[seen].tolist() if overlay.labels else []
    looks = LOOKS[type(overlay)](like, lift, *(array[seen] for array in values))
    for root, look in zip(("world", "map"), looks, strict=True):
        if overlay.where in (root, "both"):
            _send(stream, f"{root}/{entity_name(overlay)}", look, overlay, labels, seen.sum(axis=1) if moves else None)


def _known(name: str, array: Array) -> NDArray[np.bool_]:
    """Mask of items [F, N] that can be drawn: all numbers finite, or at least two points of a line."""
    finite = np.isfinite(array)
    if name == "points_n":
        return np.asarray(finite.all(axis=-1).sum(axis=-1) >= 2)
    return np.asarray(finite.reshape(*array.shape[:2], -1).all(axis=-1))


def _send(
    stream: Stream, path: str, look: Style, overlay: Geometry, labels: Sequence[str], counts: NDArray[np.integer] | None
) -> None:
    """Send `look` with counts[t] items in step t; `counts` None: the overlay is static."""
    rows = {**look.rows, **({"labels": labels} if labels else {})}
    whole = {"colors": overlay.colour, **({"show_labels": True} if labels else {}), **look.look}
    if counts is None:
        stream.static(path, look.kind.from_fields(**rows, **whole))
        return
    stream.static(path, look.kind.from_fields(**whole))
    columns, still = look.kind.columns(**rows).partition(counts), None
    if "strips" in rows and not labels and (counts == 1).all():
        still = _send_if_rigid(stream, path, look)
    if still is None:
        if stream.memory.get(path) is not None:  # the line was rigid before
            stream.columns(path, rr.Transform3D.columns(translation=np.zeros((1, 3))), np.arange(1))
        stream.columns(path, columns)
    stream.memory[path] = still


def _send_if_rigid(stream: Stream, path: str, look: Style) -> Array | None:
    """Send a line that moves as a rigid body as a shape and its pose; return the shape, or None if it deforms."""
    strips = [*look.rows["strips"]]
    if any(strip.shape != strips[0].shape for strip in strips):
        return None
    lines = np.stack(strips)
    place, shape = lines[:, 0], lines[0] - lines[0, 0]
    if np.abs(lines - place[:, None] - shape).max() > RIGID_M:
        return None
    known = stream.memory.get(path)
    if known is None or known.shape != shape.shape or np.abs(known - shape).max() > RIGID_M:
        stream.columns(path, look.kind.columns(strips=[shape]), np.arange(1))
        known = shape
    place = np.pad(place, ((0, 0), (0, 3 - place.shape[1])))
    stream.columns(path, rr.Transform3D.columns(translation=place))
    return known


def _raised(place_n: Array, lift: float) -> Array:
    return enu(place_n - (0.0, 0.0, lift))


def _lines(overlay: Lines, lift: float, points: Array) -> tuple[Style, Style]:
    strips = [strip[np.isfinite(strip).all(axis=-1)] for strip in points]
    look, flat = {"radii": overlay.radius}, [map_point(strip) for strip in strips]
    raised = [_raised(strip, lift) for strip in strips]
    return Style(rr.LineStrips3D, {"strips": raised}, look), Style(rr.LineStrips2D, {"strips": flat}, look)


def _points(overlay: Points, lift: float, place: Array) -> tuple[Style, Style]:
    look = {"radii": overlay.radius}
    world = Style(rr.Points3D, {"positions": _raised(place, lift)}, look)
    return world, Style(rr.Points2D, {"positions": map_point(place)}, look)


def _cylinders(_: Cylinders, lift: float, place: Array, size: Array) -> tuple[Style, Style]:
    rows = {"centers": _raised(place, lift), "radii": size[:, 0], "lengths": size[:, 1]}
    flat = {"positions": map_point(place), "radii": size[:, 0]}
    return Style(rr.Cylinders3D, rows, {"fill_mode": "solid"}), Style(rr.Points2D, flat, {})


def _ellipsoids(
    overlay: Ellipsoids, lift: float, place: Array, half_axes: Array, heading: Array
) -> tuple[Style, Style]:  # fmt: skip
    rows = {"centers": _raised(place, lift), "half_sizes": half_axes, "quaternions": level_quaternion(heading)}
    world = Style(rr.Ellipsoids3D, rows, {"fill_mode": "majorwireframe"})
    long, wide, _ = np.moveaxis(overlay.half_axes_m, -1, 0)
    if np.array_equal(long, wide):  # circles take a tenth of the bytes
        round_about = {"centers": map_point(place), "half_sizes": half_axes[:, [0, 0]]}
        return world, Style(rr.Ellipses2D, round_about, {"line_radii": -1.2})
    along, right = half_axes[:, :1] * np.cos(ROUND), half_axes[:, 1:2] * np.sin(ROUND)
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    outline = place[:, None, :2] + np.stack([cos * along - sin * right, sin * along + cos * right], axis=-1)
    return world, Style(rr.LineStrips2D, {"strips": list(map_point(outline))}, {"radii": -1.2})


def _arrows(overlay: Arrows, lift: float, origin: Array, vector: Array) -> tuple[Style, Style]:
    look = {"radii": overlay.radius}
    world = Style(rr.Arrows3D, {"origins": _raised(origin, lift), "vectors": enu(vector)}, look)
    return world, Style(rr.Arrows2D, {"origins": map_point(origin), "vectors": map_point(vector)}, look)


LOOKS: dict[type, Callable[..., tuple[Style, Style]]] = {
    Lines: _lines, Points: _points, Cylinders: _cylinders, Ellipsoids: _ellipsoids, Arrows: _arrows,
}  # fmt: skip
"""Overlay -> how it looks in 3D and on the map."""
