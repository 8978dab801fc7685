"""Reading of a hull's surface from a file, and its preparation for boundary elements: unit, cut, orientation,
closedness.

Formats are STL, OBJ, PLY, VTK, MSH and others that meshio reads, WAMIT's GDF of flat panels, and CSV of panels with the
columns x1, y1, z1 ... x4, y4, z4. The frame is x forward, y to port, z up. A GDF of one half declares this (ISX, ISY);
a CSV of one half has no y below 0.
"""

import warnings
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.config.base import MissingExtraError
from taichi_sim.hydro.surface import WettedSurface, Y, Z, area_vectors, as_triangles, reverse

Array = NDArray[np.float64]
UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254, "ft": 0.3048}
LONGEST = 500.0  # m; only a few ships are longer, so the unit is wrong
MERGE = 1e-6  # tolerance over the mesh's size: closer corners are merged
OPEN = 2e-3  # tolerated relative difference of volumes by different integrals (panels that meet at T-junctions)
ALIKE = 1e-3  # tolerance over the mesh's size: corners of port and starboard that are images of each other
DRY = 1e-4  # tolerance over the mesh's size: corners this close to the water lie in its surface


class Polygons(NamedTuple):
    """Panels [n, 4, 3] of a file, and the planes of symmetry that it declares."""

    panels: Array
    planes: tuple[int, ...]


def read(path: Path, unit: str = "m") -> Polygons:
    """Read the panels of a file, in m.

    Raises:
        ConfigError: if the file cannot be read or has no surface; the message names it.
        MissingExtraError: if meshio is needed and not installed.
    """
    if not path.is_file():
        raise ConfigError(f"{path}: no such file")
    readers = {".gdf": _gdf, ".csv": _csv}
    try:
        found = readers.get(path.suffix.lower(), _meshio)(path)
    except (OSError, ValueError, IndexError) as error:
        raise ConfigError(f"{path}: not a readable mesh: {error}") from None
    if not len(found.panels):
        raise ConfigError(f"{path}: holds no panels (triangles or quadrilaterals)")
    if not np.isfinite(found.panels).all():
        raise ConfigError(f"{path}: a corner is not a finite number")
    return Polygons(found.panels * UNITS[unit], found.planes)


def _csv(path: Path) -> Polygons:
    panels = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    if panels.shape[1] != 12:
        raise ValueError(f"{panels.shape[1]} columns; expected x1,y1,z1 ... x4,y4,z4")
    panels = panels.reshape(-1, 4, 3)
    tiny = MERGE * np.ptp(panels.reshape(-1, 3), axis=0).max()
    return Polygons(panels, (1,) if panels[..., Y].min() > -tiny else ())


def _gdf(path: Path) -> Polygons:
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()[1:]
    scale = float(lines[0].split()[0])
    is_x, is_y = (int(v) for v in lines[1].split()[:2])
    first = lines[2].split()
    if len(first) > 1 and first[1].lstrip("-").isdigit() and int(first[1]) != 0:
        raise ValueError("a GDF of higher order (IGDEF not 0); export one of flat panels (WAMIT: ILOWGDF)")
    count = int(first[0])
    numbers = np.array(" ".join(lines[3:]).split(), dtype=float)
    if numbers.size < 12 * count:
        raise ValueError(f"{count} panels announced, numbers for {numbers.size // 12} found: is the file truncated?")
    planes = tuple(axis for axis, on in ((1, is_y), (0, is_x)) if on == 1)
    return Polygons(scale * numbers[: 12 * count].reshape(-1, 4, 3), planes)


def _meshio(path: Path) -> Polygons:
    try:
        import meshio
    except ImportError as error:
        raise MissingExtraError("meshio", "bem") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # from a text STL that is first read as a binary one
            mesh = meshio.read(path)
    except (meshio.ReadError, SystemExit) as error:
        raise ValueError(str(error) or "unknown format") from None
    parts = []
    for block in mesh.cells:
        corners = np.asarray(mesh.points, dtype=float)[np.asarray(block.data)]
        if block.type == "triangle":
            parts.append(corners[:, [0, 1, 2, 2]])
        elif block.type == "quad":
            parts.append(corners)
    return Polygons(np.concatenate(parts) if parts else np.empty((0, 4, 3)), ())


def checked(mesh: Polygons, name: str, length: float | None) -> WettedSurface:
    """Return the wetted surface of a mesh whose water is z = 0, with outward normals, and print repairs.

    For a mesh whose port and starboard are alike, it is the port half. `length` (m) is the vehicle's, to find a wrong
    unit.

    Raises:
        ConfigError: if the mesh is implausibly large, above the water, not closed, or its normals cannot be made
        consistent.
    """
    panels = mesh.panels
    size = float(np.ptp(panels.reshape(-1, 3), axis=0).max())
    if size > LONGEST or (length is not None and not 0.2 < size / length < 5):
        than = f"; the vehicle is {length:g} m" if length is not None else ""
        raise ConfigError(f"{name}: is {size:.4g} m long{than}: is it in millimetres? give --unit ({', '.join(UNITS)})")
    z = panels[..., Z]
    if z.min() > -DRY * size:
        raise ConfigError(
            f"{name}: lies above the water (z from {z.min():.4g} to {z.max():.4g} m); give --waterline, the height of "
            "the water in the mesh's own z"
        )
    if z.max() < -DRY * size:
        raise ConfigError(f"{name}: lies wholly under water (z up to {z.max():.4g} m); give --waterline")
    panels = _consistent(_snapped(panels, MERGE * size), name)
    wet = _cut(panels, DRY * size)
    surface = WettedSurface(wet, mesh.planes)
    if surface.volume < 0:
        print(f"{name}: its normals pointed inward; turned over")
        panels, surface = reverse(panels), WettedSurface(reverse(wet), mesh.planes)
    _check_closed(surface, name, size)
    if not mesh.planes and _alike(panels, size):
        return WettedSurface(_cut(_port(panels, DRY * size), DRY * size), (1,))
    return surface


def _alike(panels: Array, size: float) -> bool:
    """Whether the corners of port and starboard are mirror images."""
    corners = np.unique(np.round(panels.reshape(-1, 3), 9), axis=0)
    image = corners * [1.0, -1.0, 1.0]
    return all(np.abs(corners - own).max(axis=1).min() <= ALIKE * size for own in image)


def _port(panels: Array, tiny: float) -> Array:
    """Parts of panels on the port side; panels that cross the centreplane are cut."""
    return _cut(panels[..., [0, 2, 1]] * [1.0, 1.0, -1.0], tiny)[..., [0, 2, 1]] * [1.0, -1.0, 1.0]


def refined(surface: WettedSurface, size: float) -> WettedSurface:
    """Divide panels at the middles of their edges until edges are at most about `size` (m)."""
    panels = surface.panels
    for _ in range(12):
        large = WettedSurface(panels).edge > size * 1.2
        if not large.any():
            break
        panels = np.concatenate([panels[~large], _quartered(panels[large])])
    return WettedSurface(panels, surface.planes)


def _quartered(panels: Array) -> Array:
    a, b, c, d = np.moveaxis(panels, 1, 0)
    three = (c == d).all(axis=1)
    ab, bc, cd, da, middle = (a + b) / 2, (b + c) / 2, (c + d) / 2, (d + a) / 2, (a + b + c + d) / 4
    quads = [(a, ab, middle, da), (ab, b, bc, middle), (middle, bc, c, cd), (da, middle, cd, d)]
    triangles = [(a, ab, da, da), (ab, b, bc, bc), (da, bc, c, c), (ab, bc, da, da)]
    four = np.concatenate([np.stack(q, axis=1)[~three] for q in quads])
    return np.concatenate([four, *(np.stack(t, axis=1)[three] for t in triangles)])


def _snapped(panels: Array, tiny: float) -> Array:
    """Merge corners within `tiny`, and drop panels without area."""
    grid = np.rint(panels / tiny) * tiny
    panels = np.where(np.abs(grid) < tiny / 2, 0.0, grid)
    panels = as_triangles(panels, tiny / 2)
    return panels[np.linalg.norm(area_vectors(panels), axis=1) > tiny**2]


def _edges(panels: Array) -> tuple[list[list[tuple[int, int]]], Array]:
    """Edges of each panel, in order, as pairs of corner numbers; and the corners."""
    corners, number = np.unique(panels.reshape(-1, 3), axis=0, return_inverse=True)
    number = number.reshape(-1, 4)
    edges = []
    for row in number.tolist():
        ring = [row[i] for i in range(4) if row[i] != row[i - 1]]
        edges.append([(ring[i - 1], ring[i]) for i in range(len(ring))])
    return edges, corners


def _consistent(panels: Array, name: str) -> Array:
    """Turn panels so that neighbours traverse their common edge in opposite directions."""
    edges, _ = _edges(panels)
    at: dict[tuple[int, int], list[tuple[int, bool]]] = {}
    for panel, ring in enumerate(edges):
        for i, j in ring:
            at.setdefault((min(i, j), max(i, j)), []).append((panel, i < j))
    turn: dict[int, bool] = {}
    for start in range(len(panels)):
        if start in turn:
            continue
        turn[start], heap = False, [start]
        while heap:
            panel = heap.pop()
            for i, j in edges[panel]:
                met = at[(min(i, j), max(i, j))]
                if len(met) != 2 or met[0][0] == met[1][0]:
                    continue
                own, other = met if met[0][0] == panel else met[::-1]
                wanted = turn[panel] ^ (own[1] == other[1])
                if other[0] not in turn:
                    turn[other[0]] = wanted
                    heap.append(other[0])
                elif turn[other[0]] != wanted:
                    raise ConfigError(f"{name}: its surface has only one side: normals cannot be made consistent")
    turned = np.array([turn[i] for i in range(len(panels))])
    if turned.any():
        print(f"{name}: the normals of {min(turned.sum(), (~turned).sum())} of {len(panels)} panels were turned over")
    return np.where(turned[:, None, None], reverse(panels), panels)


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
        ring = [p for i, p in enumerate(ring) if np.linalg.norm(p - ring[i - 1]) > tiny]
        for p in ring:
            p[2] = min(p[2], 0.0)
        fans = [ring] if len(ring) in (3, 4) else [ring[:4], [ring[0], *ring[3:]]] if len(ring) == 5 else []
        found += [np.array([[*fan, fan[-1]][:4]]) for fan in fans]
    return np.concatenate(found)


def _check_closed(surface: WettedSurface, name: str, size: float) -> None:
    """Require panels on both sides of every edge that is below water and off the planes of symmetry."""
    panels = _snapped(surface.panels, MERGE * size)
    edges, corners = _edges(panels)
    count = Counter((min(edge), max(edge)) for ring in edges for edge in ring)
    tiny = 10 * DRY * size

    def at_border(edge: tuple[int, int]) -> bool:
        ends = corners[list(edge)]
        return bool((ends[:, 2] > -tiny).all() or any((np.abs(ends[:, a]) < tiny).all() for a in surface.planes))

    open_ones = [edge for edge, n in count.items() if n == 1 and not at_border(edge)]
    volumes = np.sum(surface.whole.mean(axis=1) * surface.area, axis=0)  # by x, y and z: of a closed surface the same
    if open_ones and float(np.ptp(volumes) / np.abs(volumes).max()) > OPEN:
        where = corners[[i for edge in open_ones for i in edge]].mean(axis=0)
        raise ConfigError(
            f"{name}: has holes below the water: {len(open_ones)} open edges about x = {where[0]:.3g}, "
            f"y = {where[1]:.3g}, z = {where[2]:.3g} m; close them, or export the mesh anew"
        )
