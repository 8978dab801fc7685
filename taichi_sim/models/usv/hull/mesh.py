"""Shapes of hulls in vehicle files, and their surfaces as a few quadrilateral panels.

Both are in m, in the body frame b (forward-right-down) with its origin CO midships, on the centreline, in the design
waterline. A panel is the bilinear patch

    x(s, t) = centre + s along + t up + s t twist,    s, t in [-1, 1].

`along` and `up` are half-edge vectors; `up` is the one closer to the vertical, so that a level water line cuts across
it. `twist` is zero for a rectangle, and describes taper and warp. The area vector of the patch is 4 along x `up` up to
sign, half the cross product of its diagonals. Decks are panels, too, so that the hull is closed and floats on its own
deck when it capsizes.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from taichi_sim.config import Finite, NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.kernels.conventions import BELOW

Array = NDArray[np.float64]
Count = Annotated[int, Field(ge=1, le=400)]
Along = Annotated[Finite, Plausible(2e-4, 0.6, "m", of="length", either=True)]
Half = Annotated[NonNegative, Plausible(0.0, 0.6, "m", of="beam")]  # next to nothing at a stem
Depth = Annotated[Finite, Plausible(-1.2, 1.2, "m", of="height")]
Breadth = Annotated[NonNegative, Plausible(0.01, 1.1, "m", of="beam")]
Section = Annotated[tuple[tuple[Half, Depth], ...], Field(min_length=2, max_length=50)]
Notch = Annotated[float, Plausible(0.0, 0.3, far=math.inf)]
"""How far a point is above those of the stations before and behind it, or of its section, over the greatest depth."""
Waist = Annotated[float, Plausible(0.0, 0.9, far=math.inf)]
"""How much narrower a point is than the narrower of these two, over that one."""
DECK_STEP = 1e-9  # m, tolerance for a level deck
MIN_AREA = 1e-12  # m^2; smaller panels are the closed ends of pointed hulls and are left out


def _notch(z: Array) -> float:
    """`Notch` of depths [station, point]."""
    return float((np.minimum(z[:-2], z[2:]) - z[1:-1]).max(initial=0.0) / np.abs(z).max())


def _waist(y: Array) -> float:
    """`Waist` of half-breadths [station, point]."""
    beside = np.minimum(y[:-2], y[2:])
    return float((1 - y[1:-1] / np.maximum(beside, DECK_STEP)).max(initial=0.0, where=beside > DECK_STEP))


class BoxHull(Strict):
    """A box with its bottom `draft` below the design waterline, and its deck `freeboard` above it."""

    shape: Literal["box"] = "box"
    length: Annotated[Positive, Plausible(0.5, 1.1, "m", of="length")]
    beam: Annotated[Positive, Plausible(0.2, 1.1, "m", of="beam")]
    draft: Annotated[Positive, Plausible(0.02, 2.0, "m", of="beam")]
    freeboard: Annotated[Positive, Plausible(0.03, 20.0, "m", of="draft")]
    panels_along: Count = 2
    panels_across: Count = 2
    panels_up: Count = 2  # rows of the sides; with 2 or more, the last row is above the design waterline

    @property
    def depth(self) -> float:
        """Depth of the keel below the design waterline, m."""
        return self.draft


class WigleyHull(Strict):
    """Wigley's (1942) hull, wall-sided above the design waterline: y = +-B/2 (1 - (2x/L)^2) (1 - (z/T)^2) below."""

    shape: Literal["wigley"] = "wigley"
    length: Annotated[Positive, Plausible(0.5, 1.1, "m", of="length")]
    beam: Annotated[Positive, Plausible(0.2, 1.1, "m", of="beam")]
    draft: Annotated[Positive, Plausible(0.02, 2.0, "m", of="beam")]
    freeboard: Annotated[Positive, Plausible(0.03, 20.0, "m", of="draft")]
    panels_along: Count = 10
    panels_up: Annotated[int, Field(ge=2, le=400)] = 3  # the last row is above the design waterline

    @property
    def depth(self) -> float:
        """Depth of the keel below the design waterline, m."""
        return self.draft


class TwinPontoons(Strict):
    """Two equal pontoons with straight lines between stations; ends with a beam are closed by transoms.

    With `section = "vee"` the sides are flat from the keel to the deck edge. With `"round"` a section is a half circle
    of the station's beam, replaced by a polygon of `panels_girth` equal sides with the same area and centre, wall-sided
    above the centre.
    """

    shape: Literal["twin_pontoons"] = "twin_pontoons"
    y: Annotated[Positive, Plausible(0.1, 0.6, "m", of="beam")]  # distance of the pontoons' centrelines from the hull's
    stations: Annotated[tuple[tuple[Along, Breadth, Depth], ...], Field(min_length=2, max_length=100)]
    freeboard: Annotated[Positive, Plausible(0.03, 1.0, "m", of="height")]
    section: Literal["vee", "round"] = "vee"
    panels_girth: Annotated[int, Field(ge=2, le=200)] = 3  # sides of a round section

    @property
    def depth(self) -> float:
        """Depth of the keel below the design waterline, m."""
        return max(keel for _, _, keel in self.stations)

    @property
    def notch(self) -> Notch:
        """Of the keel."""
        return _notch(np.array(self.stations)[:, 2:])

    def _mistakes(self) -> Iterator[str]:
        x, beam, keel = np.array(self.stations).T
        if np.any(np.diff(x) <= 0):
            yield "stations = [[x, beam, keel depth], ...] must run forward, from stern to bow"
        if np.any(beam > 2 * self.y):
            yield f"a pontoon's beam {beam.max()} reaches over the centreline: at most 2 y = {2 * self.y}"
        if np.any(keel <= -self.freeboard):
            yield f"a keel lies above the deck: every keel depth must be above {-self.freeboard}"
        if self.section == "round" and np.any(beam / 2 - keel > self.freeboard + 1e-9):
            yield (
                f"freeboard = {self.freeboard} is below the centre of a round section: "
                f"it must be at least {(beam / 2 - keel).max():.4g}"
            )


class StationsHull(Strict):
    """A hull given by a table of offsets: sections of points (y, z), straight between points and between stations.

    Points are those of the starboard half, the same number at each station. Those of a single hull run from the keel (y
    = 0) to the deck edge. Those of a twin hull run from the inner deck edge around the keel to the outer one.
    """

    shape: Literal["stations"] = "stations"
    # x from stern to bow, and [y, z] of each point with z down from the design waterline, m
    stations: Annotated[tuple[tuple[Along, Section], ...], Field(min_length=2, max_length=100)]

    @property
    def depth(self) -> float:
        """Depth of the keel below the design waterline, m."""
        return max(z for _, section in self.stations for _, z in section)

    @property
    def points(self) -> Array:
        """Points [station, point, 3] of the starboard half."""
        return np.array([[(x, y, z) for y, z in section] for x, section in self.stations], dtype=np.float64)

    @property
    def notch(self) -> Notch:
        """Of a line of points along the hull, or of a section."""
        z = self.points[..., 2]
        return max(_notch(z), _notch(z.T))

    @property
    def waist(self) -> Waist:
        """Of the same lines."""
        y = self.points[..., 1]
        return max(_waist(y), _waist(y.T))

    @property
    def twin(self) -> bool:
        """Whether there is water between two hulls."""
        return any(section[0][0] > 0 for _, section in self.stations)

    def _mistakes(self) -> Iterator[str]:
        if any(len(section) != len(self.stations[0][1]) for _, section in self.stations):
            yield "stations = [[x, [[y, z], ...]], ...] must have as many points at each station"
        x, deck = self.points[:, 0, 0], self.points[:, -1, 2]
        if np.any(np.diff(x) <= 0):
            yield "stations = [[x, [[y, z], ...]], ...] must run forward, from stern to bow"
        if np.any(np.abs(deck - deck[0]) > DECK_STEP):
            yield f"the deck must be level: the last points' z run from {deck.min()} to {deck.max()}"
        if self.twin and np.any(np.abs(self.points[:, 0, 2] - deck) > DECK_STEP):
            yield (
                "the first points must lie on the centreline (y = 0), or, of twin hulls, on the inner deck edge, as "
                "high as the outer one"
            )
        for station, section in zip(x, self.points[..., 1:], strict=True):
            ring = np.concatenate([section, [[section[0, 0], deck[0]]]])
            (y0, z0), (y1, z1) = ring.T, np.roll(ring, -1, axis=0).T
            area = float(np.sum(y1 * z0 - y0 * z1)) / 2
            if area < -DECK_STEP or _crosses(section):
                yield (
                    f"the section at x = {station:g} crosses itself or runs backwards: points run from the keel (of "
                    "twin hulls: from the inner deck edge around the keel) to the deck edge, with z down"
                )


def _crosses(line: Array) -> bool:
    """Whether a line of points [n, 2] crosses itself; one that touches itself does not."""
    a, b = line[:-1], line[1:]

    def side(p: Array, q: Array, at: Array) -> Array:
        return np.sign((q - p)[..., 0] * (at - p)[..., 1] - (q - p)[..., 1] * (at - p)[..., 0])

    c, d = a[:, None], b[:, None]
    return bool(((side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)).any())


HullShape = Annotated[BoxHull | WigleyHull | TwinPontoons | StationsHull, Field(discriminator="shape")]


@dataclass(frozen=True)
class Panels:
    """N panels of a closed hull, and the M corners of its deck edge, in b, m."""

    centre: Array  # [N, 3] mean of the corners
    along: Array  # [N, 3] half-edge vector e1
    up: Array  # [N, 3] half-edge vector e2, the one closer to the vertical
    twist: Array  # [N, 3] vector e3, factor of s t
    area: Array  # [N, 3] area vector out of the hull, m^2
    row: NDArray[np.int64]  # [N] panels with the same number form a row along the hull (at its ends, across it)
    deck: Array  # [M, 3] corners of the deck edge

    @classmethod
    def of(cls, patches: list[Array], deck: Array) -> "Panels":
        """Make panels from patches [n, m, 4, 3] of corners, ordered clockwise around each panel as seen from inside the
        hull.

        The n panels of each of the m columns of a patch form a row.
        """
        corners = np.concatenate([patch.reshape(-1, 4, 3) for patch in patches])
        first = np.cumsum([0, *(patch.shape[1] for patch in patches)])
        columns = [np.tile(np.arange(p.shape[1]), p.shape[0]) + k for p, k in zip(patches, first[:-1], strict=True)]
        row = np.concatenate(columns)
        area = 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        keep = np.linalg.norm(area, axis=1) > MIN_AREA
        a, b, c, d = np.moveaxis(corners[keep], 1, 0)
        e1, e2, e3 = (b + c - a - d) / 4, (c + d - a - b) / 4, (a + c - b - d) / 4
        swap = (_steepness(e1) > _steepness(e2))[:, None]
        return cls(
            (a + b + c + d) / 4,
            np.where(swap, e2, e1),
            np.where(swap, e1, e2),
            e3,
            area[keep],
            row[keep],
            np.unique(deck, axis=0),
        )

    def __len__(self) -> int:
        """Number of panels."""
        return len(self.area)

    @property
    def draft(self) -> float:
        """Deepest point below the design waterline, m."""
        return float(self.corners[..., BELOW].max())

    @property
    def corners(self) -> Array:
        """Corners [N, 4, 3] in order around each panel, m, b."""
        return np.stack([self.centre + s * self.along + t * self.up + s * t * self.twist for s, t in _CORNERS], axis=1)

    @property
    def area_slopes(self) -> tuple[Array, Array]:
        """Change of the area vector along s and along t, [N, 3], m^2: dA = (area + s . + t .) ds dt / 4."""
        sign = np.sign(np.sum(np.cross(self.along, self.up) * self.area, axis=1))[:, None]
        return 4 * sign * np.cross(self.along, self.twist), 4 * sign * np.cross(self.twist, self.up)

    def surface(self) -> tuple[Array, NDArray[np.int64]]:
        """Vertices [4 N, 3] (m, b) and triangles [2 N, 3] to draw the hull, counter-clockwise from outside."""
        corners = self.corners
        inward = np.sum(np.cross(self.along, self.up) * self.area, axis=1) < 0
        corners[inward] = corners[inward, ::-1]
        first = 4 * np.arange(len(self))[:, None, None]
        return corners.reshape(-1, 3), (first + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)


_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _steepness(edge: Array) -> Array:
    """How vertical edges [N, 3] are; of two level edges the transverse one wins, because heel is larger than trim."""
    length = np.maximum(np.linalg.norm(edge, axis=1), 1e-300)
    return (np.abs(edge[:, 2]) + 1e-6 * np.abs(edge[:, 1])) / length


def mesh(hull: HullShape) -> Panels:
    """Make panels of the hull section of a vehicle file."""
    if isinstance(hull, StationsHull):
        return _stations(hull)
    if isinstance(hull, BoxHull):
        return _box(hull)
    if isinstance(hull, WigleyHull):
        return _wigley(hull)
    return _twin_pontoons(hull)


def _patch(points: Array) -> Array:
    """Corners [n, m, 4, 3] of a grid of points [n+1, m+1, 3]; the outward normal is d/di x d/dj."""
    return np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2)


def _grid(x, y, z) -> Array:
    """Points [n, m, 3] from coordinates that broadcast to [n, m]."""
    return np.stack(np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (x, y, z))), axis=-1)


def _rows(draft: float, freeboard: float, rows: int) -> Array:
    """Levels z [rows + 1] of a side from the keel up; the last row is above the design waterline."""
    if rows == 1:
        return np.array([draft, -freeboard])
    return np.append(np.linspace(draft, 0.0, rows), -freeboard)


def _box(hull: BoxHull) -> Panels:
    """The six faces, each of them a grid."""
    x = np.linspace(-hull.length / 2, hull.length / 2, hull.panels_along + 1)
    y = np.linspace(-hull.beam / 2, hull.beam / 2, hull.panels_across + 1)
    z = _rows(hull.draft, hull.freeboard, hull.panels_up)
    faces = [
        _grid(x[:, None], y, hull.draft),  # bottom
        _grid(x[:, None], y[::-1], -hull.freeboard),  # deck
        _grid(x[:, None], hull.beam / 2, z),  # starboard
        _grid(x[::-1, None], -hull.beam / 2, z),  # port
        _grid(hull.length / 2, y[::-1, None], z),  # bow
        _grid(-hull.length / 2, y[:, None], z),  # stern
    ]
    deck = _grid(x[:, None], y[[0, -1]], -hull.freeboard).reshape(-1, 3)
    return Panels.of([_patch(f) for f in faces], deck)


def _wigley(hull: WigleyHull) -> Panels:
    """Both sides and the deck; the ends are sharp."""
    x = np.linspace(-hull.length / 2, hull.length / 2, hull.panels_along + 1)
    z = _rows(hull.draft, hull.freeboard, hull.panels_up)
    below = np.maximum(z, 0.0) / hull.draft
    y = hull.beam / 2 * (1 - (2 * x[:, None] / hull.length) ** 2) * (1 - below**2)
    sections = np.concatenate(
        [_grid(x[:, None], -y[:, ::-1], z[::-1]), _grid(x[:, None], y[:, 1:], z[1:])], axis=1
    )  # from the port deck edge around the keel
    return Panels.of(*_close(sections))


def _twin_pontoons(hull: TwinPontoons) -> Panels:
    """One pontoon about its centreline, placed to port and to starboard."""
    x, beam, keel = np.array(hull.stations, dtype=np.float64).T
    girth = _vee(beam, keel, hull.freeboard) if hull.section == "vee" else _round(beam, keel, hull)
    patches, deck = _close(_grid(x[:, None], *np.moveaxis(girth, -1, 0)))
    sides = [np.array([0.0, side * hull.y, 0.0]) for side in (-1, 1)]
    return Panels.of([patch + s for s in sides for patch in patches], np.concatenate([deck + s for s in sides]))


def _stations(hull: StationsHull) -> Panels:
    """Both halves of a single hull, or both hulls of a twin hull, each about its own middle."""
    points = hull.points
    port = points[:, ::-1] * [1.0, -1.0, 1.0]
    if not hull.twin:
        return Panels.of(*_close(np.concatenate([port, points[:, 1:]], axis=1)))
    middle = np.array([0.0, (points[:, 0, 1] + points[:, -1, 1]).mean() / 2, 0.0])
    sides = [_close(half - side * middle) for side, half in ((1, points), (-1, port))]
    patches = [patch + side * middle for side, (own, _) in zip((1, -1), sides, strict=True) for patch in own]
    return Panels.of(patches, np.concatenate([deck + s * middle for s, (_, deck) in zip((1, -1), sides, strict=True)]))


def _vee(beam: Array, keel: Array, freeboard: float) -> Array:
    """Section points (y, z) [station, 3, 2]: port deck edge, keel, starboard deck edge."""
    y = np.stack([-beam / 2, 0 * beam, beam / 2], axis=1)
    z = np.stack([0 * keel - freeboard, keel, 0 * keel - freeboard], axis=1)
    return np.stack([y, z], axis=-1)


def _round(beam: Array, keel: Array, hull: TwinPontoons) -> Array:
    """Section points (y, z) from the port to the starboard deck edge, [station, girth + 1, 2] or [station, girth +
    3, 2].
    """
    n = hull.panels_girth
    angle = np.linspace(-np.pi / 2, np.pi / 2, n + 1)  # from the keel's direction
    radius = beam / 2 * np.sqrt(np.pi / (n * np.sin(np.pi / n)))  # so that the polygon has the area of the half circle
    centre = keel - beam / 2
    y, z = radius[:, None] * np.sin(angle), centre[:, None] + radius[:, None] * np.cos(angle)
    if not np.allclose(centre, -hull.freeboard):  # straight up to the deck edges
        y, z = np.pad(y, ((0, 0), (1, 1)), mode="edge"), np.pad(z, ((0, 0), (1, 1)), constant_values=-hull.freeboard)
    return np.stack([y, z], axis=-1)


def _close(sections: Array) -> tuple[list[Array], Array]:
    """Patches [n, m, 4, 3] of a hull of sections [station, point, 3] about y = 0, and its deck edge [M, 3].

    Sections run from the port to the starboard deck edge around the keel, stations from stern to bow.
    """
    half = (sections.shape[1] + 1) // 2
    # Transoms join port and starboard points at the same level, down to a keel point (a triangle) or a flat bottom.
    stern = np.stack([sections[0, :half], sections[0, ::-1][:half]], axis=1)
    bow = np.stack([sections[-1, :half], sections[-1, ::-1][:half]], axis=0)
    edge = sections[:, [0, -1]]
    return [_patch(sections), _deck(edge), _patch(stern), _patch(bow)], edge.reshape(-1, 3)


def _deck(edge: Array) -> Array:
    """Patch [1, 1, 4, 3]: a rectangle with the area, centroid and longitudinal second moment of a flat deck.

    edge [station, 2, 3] holds port and starboard; it is straight between stations.
    """
    x, beam = edge[:, 0, 0], edge[:, 1, 1] - edge[:, 0, 1]
    node = np.array([-1.0, 1.0]) / np.sqrt(3.0)  # Gauss points, exact for beam x^2
    share = (1 + node[:, None]) / 2
    at = x[:-1] + share * np.diff(x)
    slice_area = (beam[:-1] + share * np.diff(beam)) * np.diff(x) / 2
    area = slice_area.sum()
    x_c = (slice_area * at).sum() / area
    a = np.sqrt(3 * (slice_area * (at - x_c) ** 2).sum() / area)
    b = area / (4 * a)
    return _patch(_grid(x_c + a * np.array([[-1.0], [1.0]]), b * np.array([1.0, -1.0]), edge[0, 0, 2]))
