"""The gate for every mesh: what passes is one hull's wetted skin, about its centreplane; all else is refused by name.

Passing means, of the part below water (z < 0): every edge has two panels, but for edges in the water's surface, so that
the skin is closed; normals can be made to point outward; no point of space is inside twice; port and starboard are
alike. What lies above water may be open, doubled or missing. Water between hulls and through a moonpool is outside.

Edges. Corners within MERGE are one. Open edges may meet others along their length (T-junctions), or miss them or a
plane of symmetry by at most GAP, which is reported. An edge with three panels is the edge of a floor, a bulkhead or a
plate.

Inside and outside. A line through a point of a panel, along the axis closest to the panel's normal, crosses the skin at
known places, and each crossing changes by one how many times a point is inside (the winding number). It must be 0 on
the outer side of every panel and 1 on its inner side. A part within another (an inner skin, a tank) has 1 and 2, two
parts face to face have 1 and 1. Each panel has one such point and large ones have more, so an overlap is found if it
covers a panel or a thousandth of the skin. Parts are turned outward one by one first, so an inner skin is found
whichever way its normals point.

Halves. Open edges in y = 0 make a half hull, declared or not: the other half is its mirror image.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.hydro.mesh_file import UNITS, Polygons
from taichi_sim.applications.hydro.wetted_surface import (
    WettedSurface,
    X,
    Y,
    Z,
    area_vectors,
    as_triangles,
    mirrored,
    reverse,
)
from taichi_sim.config import ConfigError
from taichi_sim.errors import refuse

Array = NDArray[np.float64]
Whole = NDArray[np.int64]
LONGEST, SHORTEST = 500.0, 0.1  # m; few ships are longer and no vehicle is shorter, so the unit is wrong
# Tolerances over the mesh's size
MERGE = 1e-6  # corners this close are one
PROFILE = 0.3  # share of the length or beam over which a half hull is open in its plane of symmetry, at least
DRY = 1e-4  # corners this close to the water lie in its surface
GAP = 5e-4  # open edges this close to each other, or to a plane of symmetry, are joined
TIE = 1e-5  # crossings this close are at one place
ALIKE = 1e-3  # corners of port and starboard that are images of each other
# Other tolerances
OPEN = 2e-3  # relative difference of volumes by different integrals, where open edges were joined
FIN = 0.05  # share of the area that may be back to back
STRAY = 1e-3  # share of the area that may seem to be inside twice, where open edges were joined
UNEVEN = 0.01  # share of the hull that may differ between port and starboard
SAID = 1e-3  # share from which that is reported
FULL = 1.02  # volume over waterplane area and draught from which the hull widens downward
MANY = 4000  # open edges that are compared with each other
PAIRS = 1e9  # lines times triangles; of more panels, fewer lines are drawn
LINES = 200  # that are drawn at once
SPREAD = 2000  # points of a skin through which lines go, beside one of each panel; by area
R2, START = np.array([0.7548777, 0.5698403]), np.array([0.32, 0.21])  # their steps and first place in a triangle
WARPED = 1e-4  # height of a quadrilateral's corners over its plane, over its size, from which it is warped
BESIDE = 0.03  # distance of a second point, over that of the first from the middle
SECTIONS = 47, 11  # lines across the hull along its length and depth, by which port and starboard are compared
CAUSES = 40  # open edges that are looked at to tell a floor from a hole


def checked(mesh: Polygons, name: str, length: float | None) -> WettedSurface:
    """Return the wetted surface of a mesh whose water is z = 0, with outward normals, and print what was done to it.

    For a mesh whose port and starboard are alike, it is the port half. `length` (m) is the vehicle's, to find a wrong
    unit.
    """
    panels = mesh.panels
    size = float(np.ptp(panels.reshape(-1, 3), axis=0).max())
    _check_size(size, name, length)
    _check_water(panels[..., Z], size, name)
    wet = _cut(_snapped(panels, MERGE * size), DRY * size)
    wet = _snapped(wet, MERGE * size)
    if not len(wet):
        raise ConfigError(f"{name}: has no surface below the water; give --waterline, the height of the water in its z")
    wet = _unfolded(wet, mesh.planes, size, name)
    for axis in mesh.planes:
        _check_half(wet, axis, size, name)
        wet = _flush(wet if wet[..., axis].max() > DRY * size else mirrored(wet, axis), axis, DRY * size)
        print(f"{name}: a half hull, completed by its mirror image in {'xyz'[axis]} = 0")
    planes = mesh.planes
    wet, sheet = _closed(wet, planes, size, name)
    if 1 not in planes and (side := _half(sheet, size)):
        word = "port" if side > 0 else "starboard"
        print(f"{name}: a {word} half, open along y = 0; completed by its mirror image")
        planes = (1, *planes)
        wet = _flush(wet if side > 0 else mirrored(wet, Y), Y, DRY * size)
        wet, sheet = _closed(_unfolded(wet, planes, size, name), planes, size, name)
    _check_edges(sheet, panels, name, size)
    wet, part = _outward(sheet, name)
    surface = WettedSurface(wet, planes)
    if sheet.gap > 0:
        _check_volumes(surface, name)
    _check_inside(surface, part, STRAY if sheet.gap > 0 else 0.0, name, size)
    if 1 not in planes:
        _check_even(surface, panels, name, size)
        surface = WettedSurface(_port(wet, DRY * size), (1, *planes))
    _tell(surface, name)
    return surface


def _check_size(size: float, name: str, length: float | None) -> None:
    units = f"give --unit ({', '.join(UNITS)})"
    told, vehicle = f"{name}: is {size:.4g} m long", size if length is None else length
    refuse(
        ConfigError,
        (not 0.2 < size / vehicle < 5, f"{told}; the vehicle is {vehicle:g} m: is it in millimetres? {units}"),
        (size > LONGEST, f"{told}: is it in millimetres? {units}"),
        (size < SHORTEST, f"{told}: is it in another unit? {units}"),
    )


def _check_water(z: Array, size: float, name: str) -> None:
    wanted = "give --waterline, the height of the water in the mesh's own z, which must point up"
    refuse(
        ConfigError,
        (z.min() > -DRY * size,
         f"{name}: lies above the water (z from {z.min():.4g} to {z.max():.4g} m); {wanted}"),
        (z.max() < -DRY * size, f"{name}: lies wholly under water (z up to {z.max():.4g} m); {wanted}"),
    )  # fmt: skip


def _check_half(wet: Array, axis: int, size: float, name: str) -> None:
    """Require a half that a file declares to be on one side of its plane of symmetry, and open there."""
    declared = f"{name}: is a half hull (ISX or ISY of a GDF, no y < 0 in a CSV), mirrored in {'xyz'[axis]} = 0, but"
    x, tiny = wet[..., axis], DRY * size
    flat = (np.abs(x) < tiny).all(axis=1).sum()
    ends = np.stack((wet, np.roll(wet, -1, axis=1)), axis=2)  # of edges [n, 4, 2, 3]
    inside, along = ends[(np.abs(ends[..., axis]) < tiny).all(axis=2)], 1 - axis
    reach = np.ptp(inside[..., along]) if len(inside) else 0.0
    refuse(
        ConfigError,
        (x.min() < -tiny and x.max() > tiny,
         f"{declared} has panels on both sides of it: write 0 for no symmetry, or delete one side"),
        (flat, f"{declared} has {flat} panels in that plane: delete them, they are inside the hull"),
        (np.abs(x).min() < tiny and reach < PROFILE * np.ptp(wet[..., along]),
         f"{declared} only touches it, and is not open there: is it a whole hull whose origin is at its side? Move it "
         "to its centreplane, or write 0 for no symmetry"),
    )  # fmt: skip


def _flush(panels: Array, axis: int, tiny: float) -> Array:
    """Move corners within `tiny` of a plane of symmetry into it."""
    near = (np.abs(panels[..., axis]) < tiny)[..., None] & (np.arange(3) == axis)
    return np.where(near, 0.0, panels)


class _Border(NamedTuple):
    """Where edges may be open."""

    planes: tuple[int, ...]
    tiny: float  # m

    def holds(self, ends: Array) -> NDArray[np.bool_]:
        """Whether edges [n, 2, 3] lie in the water's surface or in a plane of symmetry."""
        bare = [ends[..., Z] > -self.tiny, *(np.abs(ends[..., axis]) < self.tiny for axis in self.planes)]
        return np.asarray(np.stack(bare).all(axis=2).any(axis=0))


class _Sheet(NamedTuple):
    """Panels, and their edges after joining: open edges that run along others are cut where these end."""

    panels: Array  # [n, 4, 3]
    corners: Array  # [c, 3]
    edges: Whole  # [e, 3]: panel, first and last corner in the panel's order
    group: Whole  # [e]: edges between the same corners have the same number
    count: Whole  # [e]: how many edges are in its group
    border: NDArray[np.bool_]  # [e]: may be open
    gap: float  # m, widest gap over which edges were joined

    @property
    def open(self) -> NDArray[np.bool_]:
        """Edges of one panel that should have two."""
        return (self.count == 1) & ~self.border


def _sheet(panels: Array, corners: Array, edges: Whole, border: _Border, gap: float) -> _Sheet:
    edges = edges[edges[:, 1] != edges[:, 2]]
    ends = np.sort(edges[:, 1:], axis=1)
    _, group, count = np.unique(ends[:, 0] * len(corners) + ends[:, 1], return_inverse=True, return_counts=True)
    return _Sheet(panels, corners, edges, group, count[group], border.holds(corners[edges[:, 1:]]), gap)


def _closed(panels: Array, planes: tuple[int, ...], size: float, name: str) -> tuple[Array, _Sheet]:
    """Panels with their edges; open edges within GAP of a plane of symmetry, as at a stem, are moved into it."""
    sheet = _joined(panels, _Border(planes, MERGE * size), size, name)
    for axis in planes:
        near = sheet.edges[sheet.open, 1:]
        near = near[(np.abs(sheet.corners[near, axis]) < GAP * size).all(axis=1)]
        if len(near):
            gap = 2 * np.abs(sheet.corners[near, axis]).max()
            print(f"{name}: a gap of {gap:.2g} m in {'xyz'[axis]} = 0 {_where(sheet.corners[near])}; closed")
            number = np.unique(panels.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 4)
            panels = panels.copy()
            panels[..., axis][np.isin(number, near)] = 0.0
            sheet = _joined(panels, _Border(planes, MERGE * size), size, name)
    return panels, sheet


def _joined(panels: Array, border: _Border, size: float, name: str) -> _Sheet:
    """Panels with their edges; open edges are joined with others within GAP."""
    corners, number = np.unique(panels.reshape(-1, 3), axis=0, return_inverse=True)
    number = number.reshape(-1, 4)
    edges = np.stack([np.repeat(np.arange(len(panels)), 4), number.ravel(), np.roll(number, -1, axis=1).ravel()], 1)
    sheet = _sheet(panels, corners, edges, border, 0.0)
    loose = np.flatnonzero(sheet.open)
    if not len(loose):
        return sheet
    if len(loose) > MANY:
        raise ConfigError(
            f"{name}: its panels are not connected: {len(loose)} edges below the water have one panel; merge its "
            "vertices, or export the mesh anew"
        )
    corners, edges = sheet.corners, sheet.edges.copy()
    # Corners at the end of open edges move into the first within GAP; other edges of these corners follow
    tips = np.unique(edges[loose, 1:])
    away = np.linalg.norm(corners[tips][:, None] - corners[tips], axis=2)
    first = (away <= GAP * size).argmax(axis=1)
    gap = float(away[np.arange(len(tips)), first].max())
    moved = np.arange(len(corners))
    moved[tips] = tips[first]
    edges[:, 1:] = moved[edges[:, 1:]]
    tips = np.unique(moved[tips])
    # Open edges are cut at corners on them
    a, b = corners[edges[loose, 1]], corners[edges[loose, 2]]
    along = b - a
    s = np.einsum("etk,ek->et", corners[tips] - a[:, None], along) / np.maximum((along**2).sum(axis=1), 1e-300)[:, None]
    off = np.linalg.norm(corners[tips] - a[:, None] - s[..., None] * along[:, None], axis=2)
    ends = (tips == edges[loose, 1][:, None]) | (tips == edges[loose, 2][:, None])
    on = (s > 0) & (s < 1) & (off <= GAP * size) & ~ends
    cut = [edges[np.setdiff1d(np.arange(len(edges)), loose)]]
    for k, edge in enumerate(loose):
        panel, i, j = edges[edge]
        between = tips[on[k]][np.argsort(s[k, on[k]])]
        chain = np.array([i, *between, j])
        cut.append(np.stack([np.full(len(chain) - 1, panel), chain[:-1], chain[1:]], axis=1))
    joined = _sheet(panels, corners, np.concatenate(cut), border, 0.0)
    if on.any():
        gap = max(gap, float(off[on].max()))
    if joined.open.any() or gap <= TIE * size:
        return joined
    print(f"{name}: {len(loose)} edges of its panels do not meet (gaps up to {gap:.2g} m); joined")
    return joined._replace(gap=gap)


def _half(sheet: _Sheet, size: float) -> int:
    """1 for a port half and -1 for a starboard half that is open along y = 0 and nowhere else; else 0."""
    y, loose = sheet.panels[..., Y], sheet.corners[sheet.edges[sheet.open, 1:]][..., Y]
    if not loose.size or np.abs(loose).max() > GAP * size:
        return 0
    return 1 if y.min() > -DRY * size else -1 if y.max() < DRY * size else 0


def _coincident(panels: Array) -> tuple[Whole, Whole]:
    """Number [n] that panels with the same corners have in common, and how many [n] have it."""
    number = np.unique(panels.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 4)
    ring = np.sort(np.where([False, False, False, True] & (number[:, 2:3] == number[:, 3:]), -1, number), axis=1)
    _, same, times = np.unique(ring, axis=0, return_inverse=True, return_counts=True)
    return same.ravel(), times[same.ravel()]


def _unfolded(panels: Array, planes: tuple[int, ...], size: float, name: str) -> Array:
    """Leave out pairs of panels back to back: fins without thickness, as triangulation makes at a sharp stem, and faces
    between parts. Of a half hull, panels in its plane of symmetry are such.
    """
    area = area_vectors(panels)
    share = np.linalg.norm(area, axis=1) / np.linalg.norm(area, axis=1).sum()
    same, times = _coincident(panels)
    net = np.stack([np.bincount(same, area[:, k])[same] for k in range(3)], axis=1)
    flat = (times == 2) & (np.linalg.norm(net, axis=1) < np.linalg.norm(area, axis=1))
    for axis in planes:
        flat |= (np.abs(panels[..., axis]) < DRY * size).all(axis=1)
    if not flat.any() or share[flat].sum() > FIN:
        return panels
    print(f"{name}: {flat.sum()} panels back to back (a fin without thickness, or parts face to face) left out")
    return panels[~flat]


def _check_edges(sheet: _Sheet, panels: Array, name: str, size: float) -> None:
    """Require two panels at every edge that is below water and off the planes of symmetry; four are two parts."""
    same, times = _coincident(sheet.panels)
    twice = times > 1
    if twice.any():
        raise ConfigError(
            f"{name}: has {len(np.unique(same[twice]))} panels twice {_where(sheet.panels[twice])}: doubled, or of "
            "parts that overlap or stand face to face (a bulkhead); delete the doubles, or unite the parts (a Boolean "
            "union) and export anew"
        )
    loose, many = np.flatnonzero(sheet.open), np.flatnonzero((sheet.count % 2 == 1) & (sheet.count > 1))
    many = many[~sheet.border[many]]
    ends_on = _ending_on_panels(sheet, loose, size)
    if len(many) or ends_on:
        at = many if len(many) else loose
        how = "three panels or more" if len(many) else "no panel beside them, and lie on others"
        raise ConfigError(
            f"{name}: has a panel inside (a bulkhead, floor or plate): {len(np.unique(sheet.group[at]))} edges "
            f"{_where(sheet.corners[sheet.edges[at, 1:]])} have {how}; keep the outer skin alone"
        )
    if not len(loose):
        return
    places = sheet.corners[sheet.edges[loose, 1:]].reshape(-1, 3)
    raise ConfigError(
        f"{name}: has holes below the water, or stray panels: {len(loose)} open edges {_where(places)}; "
        + (_opening(places, panels, size) or "close them, or export the mesh anew")
    )


def _opening(places: Array, panels: Array, size: float) -> str:
    """What a mesh is whose open edges [n, 3] all lie in one side of its box; empty if they do not."""
    sides = np.zeros(3, dtype=bool)
    for end in (panels.reshape(-1, 3).min(axis=0), panels.reshape(-1, 3).max(axis=0)):
        bare = ~(np.abs(panels - end) < DRY * size).all(axis=1).any(axis=0)  # no panel lies in that side
        sides |= bare & (np.abs(places - end).max(axis=0) < DRY * size)
    sides[X] &= np.ptp(places[:, Y]) > PROFILE * np.ptp(panels[..., Y])
    if sides[Y]:
        hint = "; or is its y up?" if _upside(panels) else ""
        return f"all lie in y = {places[:, Y].mean():.4g} m: move the half so that it is open at y = 0{hint}"
    if sides[X]:
        return f"all lie in x = {places[:, X].mean():.4g} m: half a hull; mirror it, or let its GDF declare ISX = 1"
    if sides[Z]:
        return "all lie at its lowest z: its z points down; turn it so that z is up"
    return "its y is up: turn it so that z is up and y to port" if _upside(panels) else ""


def _ending_on_panels(sheet: _Sheet, loose: Whole, size: float) -> bool:
    """Whether most of the open edges lie on panels that do not have them."""
    if not len(loose):
        return False
    triangles, owner = _triangles(sheet.panels)
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(u, v)
    area = (normal**2).sum(axis=1)
    on = 0
    some = loose[:: max(1, len(loose) // CAUSES)]
    for edge in some:
        middle = sheet.corners[sheet.edges[edge, 1:]].mean(axis=0)
        w = middle - a
        off = np.abs((w * normal).sum(axis=1)) / np.sqrt(area)
        s = (np.cross(w, v) * normal).sum(axis=1) / area
        t = (np.cross(u, w) * normal).sum(axis=1) / area
        within = (s > -MERGE) & (t > -MERGE) & (s + t < 1 + MERGE) & (owner != sheet.edges[edge, 0])
        on += bool((within & (off < GAP * size)).any())
    return on > len(some) / 2


def _where(points: Array) -> str:
    """The one of points [..., 3] that is nearest their middle, in words: the middle of two hulls is in the water."""
    points = points.reshape(-1, 3)
    x, y, z = np.round(points[np.linalg.norm(points - points.mean(axis=0), axis=1).argmin()], 4) + 0.0
    return f"about x = {x:.4g}, y = {y:.4g}, z = {z:.4g} m"


def _outward(sheet: _Sheet, name: str) -> tuple[Array, Whole]:
    """Turn panels so that neighbours traverse their common edge in opposite directions, and each part outward; also
    return the number of the part of each panel.
    """
    order = np.argsort(sheet.group, kind="stable")
    pairs = order[sheet.count[order] == 2].reshape(-1, 2)
    one, other = sheet.edges[pairs[:, 0]], sheet.edges[pairs[:, 1]]
    same = one[:, 1] == other[:, 1]
    beside: list[list[tuple[int, bool]]] = [[] for _ in sheet.panels]
    for i, j, way in zip(one[:, 0].tolist(), other[:, 0].tolist(), same.tolist(), strict=True):
        beside[i].append((j, way))
        beside[j].append((i, way))
    turn = np.zeros(len(sheet.panels), dtype=bool)
    part = np.full(len(sheet.panels), -1)
    parts = 0
    for start in range(len(beside)):
        if part[start] >= 0:
            continue
        part[start], heap = parts, [start]
        while heap:
            panel = heap.pop()
            for neighbour, way in beside[panel]:
                wanted = turn[panel] ^ way
                if part[neighbour] < 0:
                    part[neighbour], turn[neighbour] = parts, wanted
                    heap.append(neighbour)
                elif turn[neighbour] != wanted:
                    raise ConfigError(f"{name}: its surface has only one side: normals cannot be made consistent")
        parts += 1
    panels = np.where(turn[:, None, None], reverse(sheet.panels), sheet.panels)
    triangles, owner = _triangles(panels)
    upward = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])[:, Z] / 2
    volume = np.bincount(part[owner], triangles[..., Z].mean(axis=1) * upward, parts)
    inward = (volume < 0)[part]
    turned = turn ^ inward
    if turned.all():
        print(f"{name}: its normals pointed inward; turned over")
    elif turned.any():
        print(f"{name}: the normals of {turned.sum()} of {len(turned)} panels were turned over")
    return np.where(inward[:, None, None], reverse(panels), panels), part


def _check_volumes(surface: WettedSurface, name: str) -> None:
    """Require the volumes by x, y and z to agree, as they do of a closed surface."""
    volumes = np.array([surface.integral(lambda p, a=a: p[..., a])[a] for a in (X, Y, Z)])
    off = float(np.ptp(volumes) / np.abs(volumes).max())
    if off > OPEN:
        raise ConfigError(
            f"{name}: is not closed: panels that do not meet leave {100 * off:.2g} % of its volume open (allowed are "
            f"{100 * OPEN:g} %); close the gaps, or export the mesh anew"
        )


def _triangles(panels: Array) -> tuple[Array, Whole]:
    """Triangles [m, 3, 3] of panels, without those of no area, and the panel [m] of each.

    A warped quadrilateral has four, around its middle: with two, sides that meet in a sharp stem would cross.
    """
    a, b, c, d = np.moveaxis(panels, 1, 0)
    normal = area_vectors(panels)
    high = np.abs(((c - a) * normal).sum(axis=1) - ((b - a) * normal).sum(axis=1))
    warped = high > WARPED * np.linalg.norm(normal, axis=1) ** 1.5
    middle = panels.mean(axis=1)
    number = np.arange(len(panels))
    flat = number[~warped]
    found = [panels[flat][:, [0, 1, 2]], panels[flat][:, [0, 2, 3]]]
    found += [np.stack([p, q, middle], axis=1)[warped] for p, q in ((a, b), (b, c), (c, d), (d, a))]
    triangles = np.concatenate(found)
    owner = np.concatenate([flat, flat, *[number[warped]] * 4])
    kept = (np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) != 0).any(axis=1)
    return triangles[kept], owner[kept]


class _Crossings(NamedTuple):
    """Where lines cross triangles."""

    line: Whole  # [k]
    at: Array  # [k], m, along the axis
    step: Whole  # [k]: 1 into the hull, -1 out of it


def _crossings(triangles: Array, points: Array, axis: int) -> _Crossings:
    """Crossings of triangles [m, 3, 3] by lines along `axis` through points [n, 3].

    The two sides of a line through an edge are told by the same arithmetic for both its triangles, so that a line never
    slips between them.
    """
    u, v = (a for a in range(3) if a != axis)
    flat, places = triangles[..., [u, v]], points[:, [u, v]]
    low, high = flat.min(axis=1), flat.max(axis=1)
    pairs = []
    order = np.argsort(places[:, 0])
    for first in range(0, len(points), LINES):
        lines = order[first : first + LINES]
        p = places[lines, None]
        near = np.flatnonzero((low[:, 0] <= p[..., 0].max()) & (high[:, 0] >= p[..., 0].min()))
        lo, hi = low[near], high[near]
        line, triangle = np.nonzero(
            (p[..., 0] >= lo[:, 0]) & (p[..., 0] <= hi[:, 0]) & (p[..., 1] >= lo[:, 1]) & (p[..., 1] <= hi[:, 1])
        )
        pairs.append(np.stack([lines[line], near[triangle]], axis=1))
    line, triangle = np.concatenate(pairs).T
    left = np.stack([_left(flat[triangle, i], flat[triangle, (i + 1) % 3], places[line]) for i in range(3)], axis=1)
    hit = left.all(axis=1) | ~left.any(axis=1)
    line, triangle, left = line[hit], triangle[hit], left[hit]
    a, b, c = np.moveaxis(triangles[triangle], 1, 0)
    normal = np.cross(b - a, c - a)
    slope = np.where(normal[:, axis] == 0, 1.0, normal[:, axis])
    rise = -((places[line, 0] - a[:, u]) * normal[:, u] + (places[line, 1] - a[:, v]) * normal[:, v]) / slope
    # From above, corners run to the left about the axis x and z, and to the right about y, where u, v are x, z
    upward = left[:, 0] ^ (axis == Y)
    return _Crossings(line, a[:, axis] + rise, np.where(upward, -1, 1))


def _left(p: Array, q: Array, at: Array) -> NDArray[np.bool_]:
    """Whether points [n, 2] lie to the left of p -> q; on the line, by a rule that is the same for q -> p."""
    swap = (p[:, 0] > q[:, 0]) | ((p[:, 0] == q[:, 0]) & (p[:, 1] > q[:, 1]))
    p, q = np.where(swap[:, None], q, p), np.where(swap[:, None], p, q)
    side = (q[:, 0] - p[:, 0]) * (at[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (at[:, 0] - p[:, 0])
    return (side >= 0) ^ swap


class _Samples(NamedTuple):
    """Points of a skin: one of each panel, and more of large ones."""

    panel: Whole  # [s]
    points: Array  # [s, 3]
    inward: Array  # [s, 3]: towards the middle of the panel's triangle
    normal: Array  # [s, 3]
    area: Array  # [s], m^2: of the panel, for each of its points

    @classmethod
    def of(cls, panels: Array) -> "_Samples":
        """Points that spread evenly over each triangle (the additive recurrence R2, folded)."""
        triangles, owner = _triangles(panels)
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        area = np.linalg.norm(normal, axis=1) / 2
        order = np.lexsort((area, owner))
        largest = order[np.flatnonzero(np.diff(owner[order], append=-1))]
        count = np.floor(area * SPREAD / area.sum()).astype(np.int64)
        count[largest] += 1
        which = np.repeat(np.arange(len(triangles)), count)
        k = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        u, v = (START + np.outer(k, R2)).T % 1.0
        folded = u + v > 1
        u, v = np.where(folded, 1 - u, u), np.where(folded, 1 - v, v)
        a, b, c = np.moveaxis(triangles[which], 1, 0)
        points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
        return cls(owner[which], points, (a + b + c) / 3 - points, normal[which], (area / np.maximum(count, 1))[which])

    def at(self, chosen: Whole) -> "_Samples":
        """Those with these numbers."""
        return _Samples(*(values[chosen] for values in self))


def _windings(surface: WettedSurface, samples: _Samples, size: float) -> Whole:
    """How many times [s, 2] the outer and the inner side of a skin are inside the hull, at its samples."""
    triangles, _ = _triangles(surface.whole)
    along = np.abs(samples.normal).argmax(axis=1)
    found = np.zeros((len(along), 2), dtype=np.int64)
    for axis in range(3):
        mine = np.flatnonzero(along == axis)
        if not len(mine):
            continue
        line, at, step = _crossings(triangles, samples.points[mine], axis)
        here = samples.points[mine, axis][line]
        before = np.bincount(line[at < here - TIE * size], step[at < here - TIE * size], len(mine))
        after = np.bincount(line[at <= here + TIE * size], step[at <= here + TIE * size], len(mine))
        outside_first = (samples.normal[mine, axis] < 0)[:, None]
        found[mine] = np.where(outside_first, np.stack([before, after], 1), np.stack([after, before], 1))
    return found


def _check_inside(surface: WettedSurface, part: Whole, allowed: float, name: str, size: float) -> None:
    """Require every panel to have water on its outer side and hull on its inner side, but for a share of the area.

    Where a point seems wrong, another beside it must, too: a line may slip through where panels were joined.
    """
    samples = _Samples.of(surface.panels)
    every = int(np.ceil(len(samples.panel) * 2 * len(surface.whole) / PAIRS))
    if every > 1:
        print(f"{name}: one of {every} panels looked at for parts that overlap")
    samples = samples.at(np.arange(0, len(samples.panel), every))
    all_parts = part[samples.panel]
    total = samples.area.sum()
    for moved in (0.0, BESIDE):
        samples = samples._replace(points=samples.points + moved * samples.inward)
        sides = _windings(surface, samples, size)
        wrong = np.flatnonzero((sides != (0, 1)).any(axis=1))
        samples, sides = samples.at(wrong), sides[wrong]
        if not len(wrong) or samples.area.sum() <= allowed * total:
            return
    outer, inner = sides.T
    within = (outer >= 1) & (inner > outer)
    at = f"{len(np.unique(samples.panel))} panels {_where(samples.points)}"
    nested = np.bincount(part[samples.panel[within]], minlength=all_parts.max() + 1) == np.bincount(all_parts)
    if nested[part[samples.panel[within]]].any():
        what = f"has an inner skin (of a wall, or a tank): {at} lie inside another part; keep the outer skin"
    elif (outer == inner).mean() > 0.5:
        what = f"has a bulkhead, a plate, or parts face to face: {at} have the same on both sides; unite its parts"
    elif within.any():
        what = f"has parts that overlap: {at} lie inside another; unite the parts (a Boolean union) and export anew"
    elif (inner - outer >= 2).mean() > 0.5:
        what = f"has panels twice: {at} lie on others; delete the doubles (or unite parts that overlap)"
    else:
        what = f"has a skin that crosses itself: {at}; mend it and export anew"
    raise ConfigError(f"{name}: {what}")


def _uneven(surface: WettedSurface) -> tuple[float, float, float]:
    """Share of a hull that differs between port and starboard of y = 0, the y of its own centreplane (m), and the share
    about that.
    """
    triangles, _ = _triangles(surface.whole)
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    x, z = ((np.arange(n) + START[k]) / n for k, n in enumerate(SECTIONS))
    grid = np.stack(np.meshgrid(x, [0.0], z, indexing="ij"), axis=-1).reshape(-1, 3)
    line, y, step = _crossings(triangles, low + grid * (high - low), Y)
    inside = -float(np.sum(step * y))
    order = np.lexsort((y, line))
    first = np.flatnonzero(np.diff(line[order], prepend=-1))
    last = np.append(first[1:], len(order)) - 1
    middle = float(np.median(y[order][first] + y[order][last])) / 2 if len(order) else 0.0

    def unlike(image: Array) -> float:
        """Share of the lines' length in the hull or in its image, but not in both."""
        # Where a line enters the hull it leaves the image
        both, at, steps = np.tile(line, 2), np.concatenate([y, image]), np.tile(step, 2)
        order = np.lexsort((at, both))
        length = np.diff(at[order], append=0.0) * (np.diff(both[order], append=-1) == 0)
        return float(np.sum(np.abs(np.cumsum(steps[order])) * length)) / max(2 * inside, 1e-300)

    return unlike(-y), middle, unlike(2 * middle - y)


def _check_even(surface: WettedSurface, panels: Array, name: str, size: float) -> None:
    """Require port and starboard to be alike."""
    off, middle, about = _uneven(surface)
    if off <= UNEVEN:
        if off > SAID:
            print(f"{name}: port and starboard differ by {100 * off:.2g} % of the hull: the port half counts for both")
        return
    y = surface.whole[..., Y]
    spread = f"y from {y.min():.4g} to {y.max():.4g} m"
    if about > UNEVEN and _upside(panels):
        what = f"is not alike to port and starboard, but is about z: its y is up ({spread}); turn it so that z is up"
    elif about <= UNEVEN:
        what = f"lies off the centreplane: {spread}, its own at y = {middle:.4g} m; move it by {-middle:.4g} m in y"
        if _upside(panels):
            what += "; or is its y up?"
        elif min(abs(y.min()), abs(y.max())) < DRY * size:
            what += " (the origin of a drawing at a corner), or, if it is one half of a hull, delete its face in y = 0"
        elif y.min() * y.max() > 0:
            what += ", or, if it is one of two hulls, give both"
    elif min(abs(y.min()), abs(y.max())) < DRY * size:
        what = f"is one half of a hull ({spread}) with a face in y = 0: delete that face, and the half is mirrored"
    else:
        what = (
            f"is not alike to port and starboard: they differ by {100 * off:.2g} % of the hull ({spread}; allowed are "
            f"{100 * UNEVEN:g} %); a part may be missing, or its middle not in y = 0"
        )
    raise ConfigError(f"{name}: {what}")


def _upside(panels: Array) -> bool:
    """Whether a mesh has equal sides along z, and is wider along it than along y, as one is whose y is up."""
    size = float(np.ptp(panels.reshape(-1, 3), axis=0).max())
    return bool(np.ptp(panels[..., Z]) > np.ptp(panels[..., Y])) and _alike(panels, size, Z)


def _alike(panels: Array, size: float, axis: int = Y) -> bool:
    """Whether corners are the mirror images of others in the plane normal to `axis`."""
    corners = np.unique(np.round(panels.reshape(-1, 3), 9), axis=0)
    image = corners.copy()
    image[:, axis] *= -1
    near = ALIKE * size
    order = np.argsort(corners[:, X])
    corners, image = corners[order], image[order]
    low, high = np.searchsorted(corners[:, X], image[:, X] - near), np.searchsorted(corners[:, X], image[:, X] + near)
    return all(
        (np.abs(corners[i:j] - own).max(axis=1) <= near).any() for own, i, j in zip(image, low, high, strict=True)
    )


def _tell(surface: WettedSurface, name: str) -> None:
    """Print the size of the wetted hull, by which a wrong unit or axis shows."""
    low, high = surface.whole.reshape(-1, 3).min(axis=0), surface.whole.reshape(-1, 3).max(axis=0)
    length, beam, draught = *(high - low)[:2], -low[2]
    print(f"{name}: below water {length:.4g} m long, {beam:.4g} m wide, {draught:.4g} m deep, {surface.volume:.4g} m^3")
    if beam > length:
        print(f"warning: {name} is wider than long: x must point forward")
    if surface.volume > FULL * surface.waterplane["A"] * draught:
        print(f"warning: {name} is wider below than at the water: if it is not meant so, its z points down")


def _port(panels: Array, tiny: float) -> Array:
    """Parts of panels on the port side; panels that cross the centreplane are cut."""
    return _cut(panels[..., [0, 2, 1]] * [1.0, 1.0, -1.0], tiny)[..., [0, 2, 1]] * [1.0, -1.0, 1.0]


def _snapped(panels: Array, tiny: float) -> Array:
    """Merge corners within `tiny`, and drop panels without area."""
    grid = np.rint(panels / tiny) * tiny
    panels = np.where(np.abs(grid) < tiny / 2, 0.0, grid)
    panels = as_triangles(panels, tiny / 2)
    return panels[np.linalg.norm(area_vectors(panels), axis=1) > tiny**2]


def _cut(panels: Array, tiny: float) -> Array:
    """Parts of panels below z = 0, without panels in the water's surface itself."""
    panels = panels.copy()
    panels[..., Z][np.abs(panels[..., Z]) < tiny] = 0.0
    z = panels[..., Z]
    found = [panels[(z <= 0).all(axis=1) & (z < 0).any(axis=1)]]
    for panel in panels[(z < 0).any(axis=1) & (z > 0).any(axis=1)]:
        ring = []
        for p, q in zip(panel, np.roll(panel, -1, axis=0), strict=True):
            if p[2] <= 0:
                ring.append(p)
            if p[2] * q[2] < 0:
                ring.append(p + (q - p) * (p[2] / (p[2] - q[2])))
        ring = [p for i, p in enumerate(ring) if (p != ring[i - 1]).any()]
        for p in ring:
            p[2] = min(p[2], 0.0)
        fans = [ring] if len(ring) in (3, 4) else [ring[:4], [ring[0], *ring[3:]]] if len(ring) == 5 else []
        found += [np.array([[*fan, fan[-1]][:4]]) for fan in fans]
    return np.concatenate(found)
