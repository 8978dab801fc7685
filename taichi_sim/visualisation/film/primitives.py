"""A pen that draws lines and bodies, each for some of the views, as painted triangles and straight strokes.

Lengths are m, places in n (north-east-down); widths are px of a picture 480 px high.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import DOWN, HORIZONTAL
from taichi_sim.visualisation.recording.bodies import Mesh
from taichi_sim.visualisation.recording.episode import Array
from taichi_sim.visualisation.recording.palette import Colour

Where = Literal["world", "map", "both", "aloft"]
"""In the 3D views, on the map, in both, in all 3D views but those that follow boats."""
SHOWN = {"near": ("world", "both"), "far": ("world", "both", "aloft"), "map": ("map", "both")}
"""Kind of view -> what is seen there."""
SIDES = 20  # faces around a cylinder
ROUND = np.linspace(0.0, 2.0 * np.pi, SIDES + 1)
HEAD = 0.22  # length of an arrow's head over the arrow's


class Solids(NamedTuple):
    """Painted triangles, one colour and one normal each."""

    corners_n: NDArray[np.floating]  # [F, 3, 3] m
    normals_n: NDArray[np.floating]  # [F, 3] unit, outward; zero: emits light, visible from both sides
    colours: NDArray[np.uint8]  # [F, 3]


class Strokes(NamedTuple):
    """Straight pieces of lines; one of length zero is a square dot."""

    ends_n: NDArray[np.floating]  # [S, 2, 3] m
    colours: NDArray[np.uint8]  # [S, 3]
    width_px: NDArray[np.floating]  # [S]
    lift_m: NDArray[np.floating]  # [S] waves up to this height do not hide what lies on the mean level of the sea


NO_SOLIDS = Solids(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
NO_STROKES = Strokes(np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8), np.zeros(0), np.zeros(0))


class Label(NamedTuple):
    """A text at a position."""

    place_n: Array  # [3] m
    text: str
    colour: Colour


class Drawing(NamedTuple):
    """Lines, bodies and labels for one kind of view."""

    solids: Solids
    strokes: Strokes  # widths are px of a picture 480 px high
    labels: tuple[Label, ...]


class Pen:
    """Collects lines, bodies and labels by kind of view."""

    def __init__(self) -> None:
        """Start with empty drawings."""
        self._strokes: list[tuple[Where, Strokes]] = []
        self._solids: list[tuple[Where, Solids]] = []
        self._labels: list[tuple[Where, Label]] = []

    def lines(self, points_n: Array, colour: Colour, width: float = 1.5, lift: float = 0.0, where: Where = "both"):
        """Add line strips [..., P, 3]; points that are not finite break them."""
        points = np.asarray(points_n, dtype=np.float64)
        ends = np.stack([points[..., :-1, :], points[..., 1:, :]], axis=-2).reshape(-1, 2, 3)
        self._add(ends[np.isfinite(ends).all(axis=(1, 2))], colour, width, lift, where)

    def dots(self, places_n: Array, colour: Colour, width: float = 4.0, lift: float = 0.0, where: Where = "both"):
        """Add square dots at [..., 3]."""
        places = np.asarray(places_n, dtype=np.float64).reshape(-1, 1, 3)
        ends = places[np.isfinite(places).all(axis=(1, 2))].repeat(2, axis=1)
        self._add(ends, colour, width, lift, where)

    def _add(self, ends: Array, colour: Colour, width: float, lift: float, where: Where) -> None:
        if n := len(ends):
            shade = np.broadcast_to(np.array(colour, np.uint8), (n, 3))
            self._strokes.append((where, Strokes(ends, shade, np.full(n, width), np.full(n, lift))))

    def arrows(self, origin_n: Array, vector_n: Array, colour: Colour, width: float = 1.5, where: Where = "both"):
        """Add arrows [N, 3] with level heads; a level arrow's head stands upright."""
        tip = origin_n + vector_n
        aside = np.cross(vector_n, (0.0, 0.0, 1.0))
        level = np.linalg.norm(aside, axis=-1, keepdims=True)
        size = np.linalg.norm(vector_n, axis=-1, keepdims=True)
        aside = np.where(level > 0.1 * size, aside * size / np.maximum(level, 1e-9), (0.0, 1.0, 0.0) * size)
        left, right = (tip - HEAD * vector_n + sign * 0.5 * HEAD * aside for sign in (-1.0, 1.0))
        for points in ((origin_n, tip), (left, tip, right)):
            self.lines(np.stack(points, axis=1), colour, width, where=where)

    def solids(self, solids: Solids, where: Where = "both") -> None:
        """Add triangles unchanged."""
        self._solids.append((where, solids))

    def cylinders(self, middle_n: Array, radius: Array, height: Array, colour: Colour, where: Where = "both") -> None:
        """Add upright cylinders at [N, 3]."""
        known = np.isfinite(middle_n).all(axis=-1)
        middle, radius, height = middle_n[known], radius[known, None], height[known, None]
        if not len(middle):
            return
        ring = np.stack([np.cos(ROUND), np.sin(ROUND)], axis=-1)  # clockwise from above
        rim = np.empty((len(middle), SIDES + 1, 3))
        rim[..., HORIZONTAL] = middle[:, None, HORIZONTAL] + radius[..., None] * ring
        rim[..., DOWN] = middle[:, DOWN:] - 0.5 * height
        foot = rim + (0.0, 0.0, 1.0) * height[..., None]
        hub = np.broadcast_to(middle[:, None] - 0.5 * height[..., None] * (0.0, 0.0, 1.0), rim.shape)
        a, b, c, d = rim[:, :-1], rim[:, 1:], foot[:, 1:], foot[:, :-1]
        corners = np.concatenate([np.stack(t, axis=2) for t in ((a, b, c), (a, c, d), (hub[:, 1:], a, b))], axis=1)
        half = 0.5 * (ROUND[:-1] + ROUND[1:])
        side = np.stack([np.cos(half), np.sin(half), 0.0 * half], axis=-1)
        normals = np.concatenate([side, side, np.broadcast_to((0.0, 0.0, -1.0), side.shape)])
        normals = np.broadcast_to(normals, (len(middle), *normals.shape)).reshape(-1, 3)
        self.solids(_in_one_colour(corners.reshape(-1, 3, 3), normals, colour), where)

    def ball(self, middle_n: Array, radius: float, colour: Colour, where: Where = "both") -> None:
        """Add a ball at [3]."""
        self.solids(_in_one_colour(middle_n + radius * BALL, BALL_NORMALS, colour), where)

    def label(self, place_n: Array, text: str, colour: Colour, where: Where = "both") -> None:
        """Add a text at [3]."""
        if np.isfinite(place_n).all():
            self._labels.append((where, Label(np.asarray(place_n, dtype=np.float64), text, colour)))

    def drawing(self, kind: str) -> Drawing:
        """Collect what a view of this `kind` shows (a key of SHOWN): solids, strokes and labels."""
        seen = SHOWN[kind]
        strokes = [one for where, one in self._strokes if where in seen] or [NO_STROKES]
        solids = [one for where, one in self._solids if where in seen] or [NO_SOLIDS]
        labels = tuple(label for where, label in self._labels if where in seen)
        return Drawing(Solids(*joined(solids)), Strokes(*joined(strokes)), labels)


def faces_of(mesh: Mesh) -> Solids:
    """Faces of a mesh, in its own frame b."""
    corners = mesh.vertices_b.reshape(-1, 3, 3).astype(np.float64)
    return Solids(corners, mesh.normals_b[::3].astype(np.float64), mesh.colours[::3])


def moved(body: Solids, position_n: Array, R_nb: Array, scale: float = 1.0) -> Solids:
    """A body's faces in n, `scale` times as large."""
    corners = body.corners_n.reshape(-1, 3) @ (scale * R_nb.T) + position_n
    return Solids(corners.reshape(-1, 3, 3), body.normals_n @ R_nb.T, body.colours)


def _in_one_colour(corners: Array, normals: Array, colour: Colour) -> Solids:
    return Solids(corners, normals, np.broadcast_to(np.array(colour, np.uint8), normals.shape))


def joined(parts: Sequence[tuple[NDArray, ...]]) -> list[NDArray]:
    """Columns of several Solids, or several Strokes, as those of one."""
    return [np.concatenate(columns) for columns in zip(*parts, strict=True)]


def _ball() -> Array:
    """An octahedron subdivided twice: [128, 3, 3], on the unit sphere."""
    signs = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    faces = np.array([[(x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z)] for x, y, z in signs])
    for _ in range(2):
        a, b, c = faces[:, 0], faces[:, 1], faces[:, 2]
        ab, bc, ca = a + b, b + c, c + a
        ab, bc, ca = (m / np.linalg.norm(m, axis=-1, keepdims=True) for m in (ab, bc, ca))
        faces = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return faces


BALL = _ball()
BALL_NORMALS = BALL.mean(axis=1) / np.linalg.norm(BALL.mean(axis=1), axis=-1, keepdims=True)
