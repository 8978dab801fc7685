"""Draws one moment: vehicles with trails, slots and targets, the scene, a mission's overlays.

The colours, lengths and levels are those of recordings for rerun (taichi_sim/visualisation/recording/).
"""

from collections.abc import Callable, Mapping

import numpy as np

from taichi_sim.kernels.conventions import DOWN
from taichi_sim.kernels.rotation import numpy_rotation_matrix
from taichi_sim.visualisation.film.moment import Moment, TeamMoment
from taichi_sim.visualisation.film.primitives import Pen, Solids, faces_of, moved
from taichi_sim.visualisation.recording.bodies import body_mesh
from taichi_sim.visualisation.recording.episode import Array
from taichi_sim.visualisation.recording.overlays import Arrows, Cylinders, Ellipsoids, Lines, Points
from taichi_sim.visualisation.recording.palette import CHECKPOINT, FRAME, OBSTACLE, PLUMB, TARGET, Colour

SUNK_M = 6.0  # depth of an obstacle below mean sea level
RING = np.linspace(0.0, 2.0 * np.pi, 33)  # rad
SLOT_RING = 0.75  # radius over the larger of length and beam
TARGET_BALL, TARGET_UP = {"water": 0.11, "air": 0.08}, 0.2  # radius and height of a target over the vehicle's length
ON_WATER = 0.05  # height of trails and rings above the waves over the vehicle's length
TRACK, WAKE, THIN, THICK = 1.4, 1.8, 1.0, 2.4  # px
METRES_PX = 1.5  # width of a line whose radius is in m, px


class Cast:
    """Bodies of an episode's vehicles, built once."""

    def __init__(self) -> None:
        """Start without bodies."""
        self._bodies: dict[tuple[str, int], Solids] = {}

    def body(self, team: TeamMoment, vehicle: int) -> Solids:
        """Faces of a vehicle's body, in b."""
        key = (team.track.name, vehicle)
        if key not in self._bodies:
            self._bodies[key] = faces_of(body_mesh(team.track, team.livery.of(vehicle)))
        return self._bodies[key]

    def bodies(self, pen: Pen, moment: Moment, scales: Mapping[str, float]) -> None:
        """Draw all vehicles; those of a team are `scales[team]` times as large."""
        for name, team in moment.teams.items():
            for vehicle in range(len(team.position_n)):
                R_nb = numpy_rotation_matrix(team.quaternion_nb[vehicle])
                scale = scales.get(name, 1.0) * team.track.scale_of(vehicle)
                body = moved(self.body(team, vehicle), team.position_n[vehicle], R_nb, scale)
                pen.solids(body, "world")


def draw_moment(pen: Pen, moment: Moment) -> None:
    """Draw everything but the bodies."""
    chop = wave_height(moment)
    _draw_scene(pen, moment, chop)
    _draw_on_water(pen, moment)
    for team in moment.teams.values():
        if not team.track.on_water:
            _draw_in_air(pen, team)
        if team.target_n is not None:
            _draw_target(pen, team, chop)
    for overlay in moment.overlays:
        places = KINDS[type(overlay)](pen, overlay, 2.0 * chop if overlay.on_water else 0.0)
        for text, place in zip(overlay.labels, places, strict=False):
            pen.label(place, text, overlay.colour, overlay.where)
    for event, place_n in moment.events:
        pen.dots(place_n, event.colour, 6.0, chop)


def wave_height(moment: Moment) -> float:
    """Half the significant wave height, m; 0.3 m if the sea is unknown."""
    return 0.3 if moment.waves is None else max(2.0 * float(np.sqrt(0.5 * np.sum(moment.waves[0] ** 2))), 0.05)


def _draw_scene(pen: Pen, moment: Moment, chop: float) -> None:
    scene = moment.scene
    for name, track in scene.tracks_n.items():
        team = moment.teams[name]
        pen.lines(track, team.livery.track, TRACK, 2.0 * chop if team.track.on_water else 0.0)
    if len(scene.checkpoints_n):
        flown = next((float(track[:, DOWN].mean()) for track in scene.tracks_n.values()), 0.0)  # of the first track
        level = np.full((len(scene.checkpoints_n), 1), flown)
        pen.dots(np.concatenate([scene.checkpoints_n, level], axis=1), CHECKPOINT, 4.0, chop)
    if len(scene.obstacles):
        north, east, radius, height = np.asarray(scene.obstacles, dtype=np.float64).T
        middle = np.stack([north, east, 0.5 * (SUNK_M - height)], axis=-1)
        pen.cylinders(middle, radius, height + SUNK_M, OBSTACLE)
    if scene.area_m is not None:
        half = 0.5 * scene.area_m * np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0], [1, 1, 0]])
        pen.lines(half, FRAME, THIN, where="map")


def _draw_on_water(pen: Pen, moment: Moment) -> None:
    """Draw wakes of boats and a ring at each slot on the waves, with one query of wave heights."""
    strips: list[tuple[Array, Colour, float, float]] = []
    for team in (team for team in moment.teams.values() if team.track.on_water):
        above = ON_WATER * team.track.size_m[0]
        wakes = np.swapaxes(team.trail_n, 0, 1).copy()  # [V, n, 3]
        bow = np.stack([np.cos(team.heading), np.sin(team.heading), 0.0 * team.heading], axis=-1)
        wakes[:, -1] -= 0.5 * team.track.size_m[0] * bow  # they end at the stern
        strips += [(wake, team.livery.of(v), WAKE, above) for v, wake in enumerate(wakes)]
        if team.slot_n is not None:
            ring = SLOT_RING * max(team.track.size_m[:2]) * np.stack([np.cos(RING), np.sin(RING), 0.0 * RING], axis=-1)
            strips += [(slot + ring, _of_slot(team, v), THIN, above) for v, slot in enumerate(team.slot_n)]
    if not strips:
        return
    points = np.concatenate([points for points, *_ in strips])
    known = np.isfinite(points).all(axis=-1)
    points[known, 2] = -np.asarray(moment.elevation(points[known, 0], points[known, 1]))
    for placed, (_, colour, width, above) in zip(
        np.split(points, np.cumsum([len(points) for points, *_ in strips])[:-1]), strips, strict=True
    ):
        pen.lines(placed - (0.0, 0.0, above), colour, width, above, "both" if width == WAKE else "world")


def _of_slot(team: TeamMoment, vehicle: int) -> Colour:
    return TARGET if vehicle == 0 and team.target_n is not None else team.livery.of(vehicle)


def _draw_in_air(pen: Pen, team: TeamMoment) -> None:
    """Draw trails of aircraft, lines from them down to the sea, and a ring at each slot, upright across the course."""
    for vehicle, way in enumerate(np.swapaxes(team.trail_n, 0, 1)):
        pen.lines(way, team.livery.of(vehicle), WAKE)
    foot = team.position_n * (1.0, 1.0, 0.0)
    pen.lines(np.stack([team.position_n, foot], axis=1), PLUMB, THIN, where="aloft")
    if team.slot_n is not None:
        radius = SLOT_RING * max(team.track.size_m[:2])
        across = np.stack([-np.sin(team.course) * np.cos(RING), np.cos(team.course) * np.cos(RING), np.sin(RING)], -1)
        for vehicle, slot in enumerate(team.slot_n):
            pen.lines(slot + radius * across, _of_slot(team, vehicle), THIN, where="world")


def _draw_target(pen: Pen, team: TeamMoment, chop: float) -> None:
    """Draw a ball with an arrow along the course; a boat's target lies above the waves."""
    assert team.target_n is not None
    length = team.track.size_m[0]
    place = team.target_n - (0.0, 0.0, TARGET_UP * length + chop if team.track.on_water else 0.0)
    pen.ball(place, TARGET_BALL[team.track.medium] * length, TARGET, "world")
    ahead = 1.2 * length * np.array([np.cos(team.course), np.sin(team.course), 0.0])
    pen.arrows(place[None], ahead[None], TARGET, THICK, "world")
    pen.dots(team.target_n, TARGET, 4.0, where="map")


def _width(radius: float) -> float:
    """Width of an overlay's line, px; lines whose radius is in m are drawn alike."""
    return 1.1 * abs(radius) if radius < 0.0 else METRES_PX


def _lines(pen: Pen, overlay: Lines, lift: float) -> Array:
    pen.lines(overlay.points_n[0], overlay.colour, _width(overlay.radius), lift, overlay.where)
    return overlay.points_n[0][:, 0]


def _points(pen: Pen, overlay: Points, lift: float) -> Array:
    pen.dots(overlay.position_n[0], overlay.colour, 2.0 * _width(overlay.radius), lift, overlay.where)
    return overlay.position_n[0]


def _cylinders(pen: Pen, overlay: Cylinders, _: float) -> Array:
    place, size = np.broadcast_arrays(overlay.position_n[0], np.pad(overlay.size_m[0], ((0, 0), (0, 1))))
    pen.cylinders(place, size[:, 0], size[:, 1], overlay.colour, overlay.where)
    return place


def _ellipsoids(pen: Pen, overlay: Ellipsoids, lift: float) -> Array:
    """Draw an ellipsoid as three ellipses; a flat one as its level ellipse."""
    place, axes, turn = overlay.position_n[0], overlay.half_axes_m[0], overlay.heading[0][..., None]
    cos, sin, none = np.cos(RING), np.sin(RING), 0.0 * RING
    for along, right, down in ((cos, sin, none), (cos, none, sin), (none, cos, sin)):
        a, b, c = axes[:, :1] * along, axes[:, 1:2] * right, axes[:, 2:] * down
        ring = np.stack([np.cos(turn) * a - np.sin(turn) * b, np.sin(turn) * a + np.cos(turn) * b, c], axis=-1)
        pen.lines(place[:, None] + ring, overlay.colour, METRES_PX, max(lift, 0.5), overlay.where)
    return place


def _arrows(pen: Pen, overlay: Arrows, _: float) -> Array:
    origin, vector = np.broadcast_arrays(overlay.origin_n[0], overlay.vector_n[0])
    pen.arrows(origin, vector, overlay.colour, _width(overlay.radius), overlay.where)
    return origin


KINDS: dict[type, Callable[..., Array]] = {
    Lines: _lines, Points: _points, Cylinders: _cylinders, Ellipsoids: _ellipsoids, Arrows: _arrows,
}  # fmt: skip
"""Kind of overlay -> the function that draws it and returns the places of its labels."""
