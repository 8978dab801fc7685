"""Panels for boundary elements: the wetted part of the simulator's own panels, and lids in the water's surface.

Hull: a panel of the simulator is a bilinear patch x(s, t) whose z is linear along each line of constant s, so that the
water cuts each line at one t. A patch is divided at each s where the water leaves it at an end of its lines; the wet
part of each line is then divided in t. Patches across a plane of symmetry are halved there. The divided surface is the
simulator's hull without its deck and everything else above water. Panels narrow towards sharp edges of the hull and
towards the waterline, where the flow is singular. Panels of one size have errors of several per cent; the same number
of narrowed ones has less than one (docs/hydrodynamics.md).

Lid inside a hull: a boundary-element code gives wrong loads near the frequencies at which water inside the hull would
slosh ("irregular frequencies"). A rigid lid over the inner waterplane removes them (Ohmatsu 1975; Lee and Sclavounos
1989). It keeps half a panel's size away from the waterline. A lid that touches the waterline shifts the loads by some
per cent, because panels of lid and hull meet in the logarithmic singularity of the surface.

Lid between hulls: real water oscillates between the hulls of a catamaran. Potential theory has no viscosity and
exaggerates this near resonance. A damping lid absorbs energy there (Chen 2004; capytaine_extensions.py). Both lids are
built strip by strip along x, from the crossings of the waterline: inside and gap alternate across the hull.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.hydro.wetted_surface import PLANES, WettedSurface, X, Z, area_vectors, as_triangles
from taichi_sim.models.usv.hull.mesh import Panels

Array = NDArray[np.float64]
GRID = 1e6  # 1/m; grid on which corners of the two halves are compared
TINY = 1e-12  # m; shorter edges are none
LEVEL = 1e-9  # m; a corner within this height lies in the water's surface
THIN = 1e-4  # shorter wet lines, over the panel size, are left out
Z_UP = np.array([1.0, -1.0, -1.0])  # body frame to this one, and back
END = 0.25  # size of a panel next to a sharp edge or the waterline, over the panel size
GROWTH = 0.4  # growth of a panel's length with its distance from there
SHARP = np.cos(np.deg2rad(25.0))  # cosine of the angle between panels from which their edge is sharp
CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], dtype=float)
EDGES = ((3, 0), (1, 2), (0, 1), (2, 3))  # corners of the edges s = -1, s = 1, t = -1, t = 1
INSET = 1e-6  # distance, over a strip's width, from its ends at which crossings of the waterline are found
AWAY = 0.5  # distance of the inner lid from the waterline, over a panel's size
IN_SURFACE = 1e-6  # m; an edge within this height lies in the water's surface


class Patch(NamedTuple):
    """A bilinear patch, with a mark for each sharp edge among s = -1, s = 1, t = -1, t = 1."""

    form: Array  # [4, 3]: centre, e_s, e_t, e_st; e_s x e_t points out of the hull; z up
    sharp: tuple[bool, bool, bool, bool]

    def at(self, s, t) -> Array:
        """Points [..., 3]."""
        s, t = np.asarray(s, dtype=float)[..., None], np.asarray(t, dtype=float)[..., None]
        return self.form[0] + s * self.form[1] + t * self.form[2] + s * t * self.form[3]

    @property
    def corners(self) -> Array:
        """Corners [4, 3] in order around the patch."""
        return self.at(*CORNERS.T)

    def part(self, s: tuple[float, float], t: tuple[float, float]) -> "Patch":
        """The part between two s and two t; edges along the cuts are not sharp."""
        (s0, s1), (t0, t1) = s, t
        a, b, c, d = (self.at(i, j) for i, j in ((s0, t0), (s1, t0), (s1, t1), (s0, t1)))
        form = np.array([(a + b + c + d) / 4, (b + c - a - d) / 4, (c + d - a - b) / 4, (a + c - b - d) / 4])
        whole = (s0 == -1, s1 == 1, t0 == -1, t1 == 1)
        return Patch(form, tuple(own and uncut for own, uncut in zip(self.sharp, whole, strict=True)))


def wetted(hull: Panels, size: float, divisions: int = 0) -> WettedSurface:
    """The part of `hull` below water, in panels with edges of at most about `size` (m).

    With `divisions`, the wet part of each panel of the simulator is instead divided into that many even parts each way.
    """
    patches = _patches(hull)
    planes = tuple(axis for axis in PLANES if _alike(patches, axis))
    for axis in planes:
        patches = _positive_side(patches, axis)
    fine = [part for patch in patches for part in _divided(patch, size, divisions)]
    return WettedSurface(np.concatenate(fine), planes)


def _patches(hull: Panels) -> list[Patch]:
    """Convert the hull's panels to patches; an edge is sharp if it has no neighbour, or an angle to it."""
    sign = np.sign(np.sum(np.cross(hull.along, hull.up) * hull.area, axis=1))[:, None]
    forms = np.stack([hull.centre, sign * hull.along, hull.up, sign * hull.twist], axis=1) * Z_UP
    smooth = Patch(forms[0], (False,) * 4)
    bare = [smooth._replace(form=form) for form in forms]
    normals: dict[tuple, list[Array]] = {}
    keys, ways = [], []
    for patch in bare:
        whole = np.rint(patch.corners * GRID).astype(np.int64)
        keys.append([tuple(sorted((tuple(whole[i].tolist()), tuple(whole[j].tolist())))) for i, j in EDGES])
        ways.append([_normal(patch, s, t) for s, t in ((-1, 0), (1, 0), (0, -1), (0, 1))])
        for key, way in zip(keys[-1], ways[-1], strict=True):
            normals.setdefault(key, []).append(way)

    def sharp(key: tuple, way: Array) -> bool:
        met = normals[key]
        return key[0] != key[1] and (len(met) < 2 or min(float(way @ other) for other in met) < SHARP)

    return [
        patch._replace(sharp=tuple(sharp(key, way) for key, way in zip(own, way_of, strict=True)))
        for patch, own, way_of in zip(bare, keys, ways, strict=True)
    ]


def _normal(patch: Patch, s: float, t: float) -> Array:
    """Unit normal at a point slightly inside the patch, because an edge may have no length."""
    form, (s, t) = patch.form, (0.98 * s, 0.98 * t)
    normal = np.cross(form[1] + t * form[3], form[2] + s * form[3])
    return normal / max(float(np.linalg.norm(normal)), 1e-300)


def _alike(patches: list[Patch], axis: int) -> bool:
    """Whether the hull equals its image in the plane normal to `axis`."""
    corners = np.rint(np.stack([p.corners for p in patches]) * GRID).astype(np.int64)
    image = np.where(np.arange(3) == axis, -corners, corners)
    one, other = (sorted(sorted(panel) for panel in found.tolist()) for found in (corners, image))
    return one == other


def _positive_side(patches: list[Patch], axis: int) -> list[Patch]:
    """Patches on the positive side of a plane of symmetry; those that cross it are halved."""
    found = []
    for patch in patches:
        x = patch.corners[:, axis]
        if x.min() < -1 / GRID and x.max() > 1 / GRID:
            halves = [patch.part(s, (-1, 1)) for s in ((-1, 0), (0, 1))]
            if not _one_sided(halves, axis):
                halves = [patch.part((-1, 1), t) for t in ((-1, 0), (0, 1))]
            if not _one_sided(halves, axis):
                raise ValueError("a panel crosses a plane of symmetry obliquely")
            found += [half for half in halves if half.form[0, axis] > 0]
        elif patch.form[0, axis] > 0:
            found.append(patch)
    return found


def _one_sided(patches: list[Patch], axis: int) -> bool:
    x = np.stack([p.corners[:, axis] for p in patches])
    return bool(((x > -1 / GRID).all(axis=1) | (x < 1 / GRID).all(axis=1)).all())


def _divided(patch: Patch, size: float, divisions: int) -> list[Array]:
    """Wet panels [n, 4, 3] of a patch."""
    z = patch.form[:, 2]
    ends = {-1.0, 1.0}
    for t in (-1.0, 1.0):  # s at which the water leaves the patch at an end of its lines; z(s, t) is linear in s
        level, slope = z[0] + t * z[2], z[1] + t * z[3]
        if abs(slope) > LEVEL and abs(level / slope) < 1:
            ends.add(-level / slope)
    cuts = sorted(ends)
    strips = (_strip(patch, s0, s1, size, divisions) for s0, s1 in zip(cuts, cuts[1:], strict=False))
    return [strip for strip in strips if len(strip)]


def _strip(patch: Patch, s0: float, s1: float, size: float, divisions: int) -> Array:
    """Wet panels [n, 4, 3] of a patch between two s, between which the water crosses no end of the lines."""
    lines = np.linspace(s0, s1, 9)
    low, high = _wet(patch, lines)
    if not ((high - low)[1:-1] > 0).all():
        return np.empty((0, 4, 3))
    below, above = patch.at(lines, low), patch.at(lines, high)
    height = np.linalg.norm(above - below, axis=1).max()
    if height < THIN * size:
        return np.empty((0, 4, 3))
    length = max(np.linalg.norm(np.diff(edge, axis=0), axis=1).sum() for edge in (below, above))
    uncut = s0 == -1, s1 == 1
    u = _spaced(length, size, divisions, tuple(own and end for own, end in zip(patch.sharp[:2], uncut, strict=True)))
    edges = [own or bool((np.abs(line[1:-1, 2]) < 1e-6).all())  # the waterline counts as sharp
             for own, line in zip(patch.sharp[2:], (below, above), strict=True)]  # fmt: skip
    v = _spaced(height, size, divisions, tuple(edges))
    s = s0 + (s1 - s0) * u
    low, high = _wet(patch, s)
    t = low[:, None] + (high - low)[:, None] * v
    points = patch.at(np.broadcast_to(s[:, None], t.shape), t)
    quads = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    quads = as_triangles(quads, THIN * size)
    return quads[np.linalg.norm(area_vectors(quads), axis=1) > (THIN * size) ** 2]  # none without area


def _spaced(length: float, size: float, divisions: int, sharp: tuple[bool, ...]) -> Array:
    """Divisions of a length, 0 to 1: parts of `size`, or END times that at sharp ends, growing with the distance
    from them.
    """
    if divisions:
        return np.linspace(0, 1, divisions + 1)
    u = np.linspace(0, 1, 513)
    away = length * np.minimum(u if sharp[0] else u + np.inf, 1 - u if sharp[1] else u + np.inf)  # from a sharp end
    wanted = length / np.minimum(size, END * size + GROWTH * away)  # parts per length, at u
    parts = np.concatenate([[0.0], np.cumsum((wanted[1:] + wanted[:-1]) / 2 * np.diff(u))])
    n = max(1, int(np.ceil(parts[-1] - 1e-6)))
    return np.interp(np.linspace(0, parts[-1], n + 1), parts, u)


def _wet(patch: Patch, s: Array) -> tuple[Array, Array]:
    """First and last t below water on each line s; they are equal where the line is dry."""
    centre, along, up, twist = patch.form[:, 2]
    level, slope = centre + s * along, up + s * twist
    steep = np.abs(slope) > LEVEL
    cut = np.clip(-level / np.where(steep, slope, 1.0), -1, 1)
    dry_level = ~steep & (level > -LEVEL)
    low = np.where(steep & (slope < 0), cut, -1.0)
    high = np.where(steep & (slope > 0), cut, 1.0)
    return low, np.where(dry_level, low, high)


def refined(surface: WettedSurface, size: float) -> WettedSurface:
    """Halve panels across their longest edge until no edge is longer than `size` (m)."""
    panels, done = surface.panels, []
    while len(panels):
        large = WettedSurface(panels).edge > size
        done.append(panels[~large])
        panels = _halved(panels[large])
    return WettedSurface(np.concatenate(done), surface.planes)


def _halved(panels: Array) -> Array:
    """Both halves of panels [n, 4, 3], cut from the middle of the longest edge to the opposite corner of a triangle, or
    the middle of the opposite edge of a quadrilateral.
    """
    length = np.linalg.norm(np.roll(panels, -1, axis=1) - panels, axis=2)
    order = (length.argmax(axis=1)[:, None] + np.arange(4)) % 4
    a, b, c, d = np.moveaxis(np.take_along_axis(panels, order[..., None], axis=1), 1, 0)
    three = (panels[:, 2] == panels[:, 3]).all(axis=1)
    ab, cd = (a + b) / 2, (c + d) / 2
    top = np.where(three[:, None], np.where((b == c).all(axis=1)[:, None], d, c), cd)
    one, other = np.stack([a, ab, top, d], axis=1), np.stack([ab, b, c, top], axis=1)
    return as_triangles(np.concatenate([one, other]), TINY)


def of_number(surface: WettedSurface, wanted: int) -> WettedSurface:
    """Divide a surface into about `wanted` panels, as near as halving comes; a finer one stays as it is."""
    even = float(np.sqrt(np.linalg.norm(area_vectors(surface.panels), axis=1).sum() / wanted))
    low, high = 0.5 * even, max(float(surface.edge.max()), even)
    while high / low > 1.01:
        size = float(np.sqrt(low * high))
        low, high = (size, high) if len(refined(surface, size)) > wanted else (low, size)
    return refined(surface, high)


def inner_lid(hull: WettedSurface, size: float) -> Array:
    """Panels [n, 4, 3] of a lid inside `hull`, on its positive sides, normals down."""
    return _lid(hull, size, AWAY * size, inside=True)


def gap_lid(hull: WettedSurface, size: float) -> Array:
    """Panels [n, 4, 3] of a lid over the water between two hulls; none for a single hull."""
    return _lid(hull, size, 0.0, inside=False)


def waterline(hull: WettedSurface) -> Array:
    """Edges [n, 2, 2] (x, y) of panels that lie in the water's surface, without images."""
    ends = np.stack([hull.panels, np.roll(hull.panels, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return ends[(np.abs(ends[..., Z]) < IN_SURFACE).all(axis=1) & (length > IN_SURFACE)][..., :2]


def _lid(hull: WettedSurface, size: float, away: float, inside: bool) -> Array:
    """Quadrilaterals between consecutive stations, `away` (m) from the waterline."""
    edges = waterline(hull)
    if not len(edges):
        return np.empty((0, 4, 3))
    half = 1 in hull.planes  # the waterline is of the port half only
    x_first = 0.0 if 0 in hull.planes else edges[..., X].min() + away
    stations = _stations(edges, x_first, edges[..., X].max() - away, size)
    found = []
    for x0, x1 in zip(stations, stations[1:], strict=False):
        inset = INSET * (x1 - x0)
        a, b = _crossings(edges, x0 + inset), _crossings(edges, x1 - inset)
        if len(a) != len(b):
            continue
        a, b = (_intervals(y, half, inside, away) for y in (a, b))
        for (a0, a1), (b0, b1) in zip(a, b, strict=True):
            if a0 > a1 or b0 > b1:
                continue
            n = max(1, int(np.ceil(max(a1 - a0, b1 - b0) / size - 1e-9)))
            ya, yb = np.linspace(a0, a1, n + 1), np.linspace(b0, b1, n + 1)
            for i in range(n):
                found.append([(x0, ya[i], 0), (x0, ya[i + 1], 0), (x1, yb[i + 1], 0), (x1, yb[i], 0)])
    panels = np.array(found, dtype=float).reshape(-1, 4, 3)
    return panels[np.abs(area_vectors(panels)[:, Z]) > 1e-3 * size**2]


def _stations(edges: Array, x_first: float, x_last: float, size: float) -> Array:
    """x of stations at most `size` apart, including the knuckles of the waterline."""
    ends = np.unique(np.round(edges[..., X].ravel(), 6))
    ends = ends[(ends > x_first + size / 2) & (ends < x_last - size / 2)]
    kept = [x_first]
    for x in [*ends, x_last]:
        if x - kept[-1] >= size / 2 or x == x_last:
            n = max(1, int(np.ceil((x - kept[-1]) / size - 1e-9)))
            kept.extend(np.linspace(kept[-1], x, n + 1)[1:])
    return np.array(kept)


def _crossings(edges: Array, x: float) -> Array:
    """Ascending y at which the waterline crosses a station."""
    x0, x1 = edges[:, 0, 0], edges[:, 1, 0]
    across = (np.minimum(x0, x1) <= x) & (np.maximum(x0, x1) > x)
    (x0, y0), (x1, y1) = (edges[across, end].T for end in (0, 1))
    return np.sort(y0 + (x - x0) / (x1 - x0) * (y1 - y0))


def _intervals(y: Array, half: bool, inside: bool, away: float) -> list[tuple[float, float]]:
    """Intervals of y inside the hulls, or in the gaps between them; those of a half hull begin at the centreplane."""
    if half:
        y = np.concatenate([-y[::-1], y])
    bounds = [(y[i] + away, y[i + 1] - away) for i in range(0 if inside else 1, len(y) - 1, 2)]
    if half:
        bounds = [(max(a, 0.0), b) for a, b in bounds if b > -away]
    return bounds
