"""Table of offsets from a mesh: a few stations and points with which the simulator floats a hull.

At each station, half-breadths at some levels are read off the wetted mesh; for two hulls, the inner half-breadths as
well. Chords lie inside a rounded hull. The half-breadths are therefore stretched, by about a per cent: those at the
waterline until the waterplane has the mesh's area, those below until the volume is the mesh's.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.hydro.panelling import wetted
from taichi_sim.applications.hydro.wetted_surface import WettedSurface, X
from taichi_sim.models.usv.hull.mesh import Panels, StationsHull, mesh

Array = NDArray[np.float64]
BREADTH, LEVEL = 0, 1  # columns of sections and segments: y, z
INSIDE = 1e-4  # distance of the end sections from the ends, over the length
NEAR = 2e-3  # distance of the readings from a flat bottom and from the waterline, over the draught
FINE = 400  # sections from which stations are chosen
ROUNDS = 12  # iterations of the stretching
DIGITS = 4  # decimals of offsets for a length of 10 m; one less for each factor of ten


def offsets(hull: WettedSurface, stations: int, points: int, freeboard: float) -> StationsHull:
    """Hull of `stations` sections with `points` levels from keel to waterline, and vertical walls of height
    `freeboard` (m).
    """
    triangles = _triangles(hull)
    x = triangles[..., X]
    ends = np.array([x.min(), x.max()])
    twin = is_twin(hull)
    places = _places(triangles, ends, stations, points, twin)
    sections = np.stack([_section(triangles, at, ends, points, twin) for at in places])
    decimals = max(1, DIGITS - int(np.floor(np.log10(np.ptp(ends)))) + 1)
    wanted = hull.volume, hull.waterplane["A"]
    below = top = 1.0
    made = _hull(places, sections, freeboard, decimals)
    for _ in range(ROUNDS):
        fine = _measured(mesh(made))
        top *= wanted[1] / fine.waterplane["A"]
        below *= wanted[0] / fine.volume
        stretched = sections.copy()
        level = np.abs(sections[..., LEVEL]) < 1e-9
        middle = sections[..., BREADTH].mean(axis=1, keepdims=True) if twin else 0.0
        stretched[..., BREADTH] = middle + (sections[..., BREADTH] - middle) * np.where(level, top, below)
        made = _hull(places, np.maximum(stretched, 0.0) if not twin else stretched, freeboard, decimals)
    return made


def compared(
    made: Panels, hull: WettedSurface, mass: float, cg: Array, rho: float, g: float
) -> dict[str, tuple[float, float]]:
    """Compare quantities of the offsets (first) and of the mesh (second), by name with unit."""
    ours = _measured(made)
    pairs = (("volume, m^3", lambda s: s.volume), ("waterplane, m^2", lambda s: s.waterplane["A"]),
             ("waterplane Ixx, m^4", lambda s: s.waterplane["yy"]),
             ("waterplane Iyy, m^4", lambda s: s.waterplane["xx"]),
             ("LCB, m", lambda s: s.centre_of_buoyancy[0]), ("KB below water, m", lambda s: -s.centre_of_buoyancy[2]),
             ("GM_T, m", lambda s: s.stiffness(mass, cg, rho, g)[3, 3] / (mass * g)),
             ("GM_L, m", lambda s: s.stiffness(mass, cg, rho, g)[4, 4] / (mass * g)))  # fmt: skip
    return {name: (float(of(ours)), float(of(hull))) for name, of in pairs}


def _measured(panels: Panels) -> WettedSurface:
    """The wetted panels, divided a few times in each direction, for integrals."""
    return wetted(panels, 0.01 * float(np.ptp(panels.centre, axis=0).max()), divisions=4)


def _triangles(hull: WettedSurface) -> Array:
    """Triangles [n, 3, 3] of the whole wetted hull."""
    a, b, c, d = np.moveaxis(hull.whole, 1, 0)
    both = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return both[np.linalg.norm(np.cross(both[:, 1] - both[:, 0], both[:, 2] - both[:, 0]), axis=1) > 0]


def _cut(triangles: Array, at: float) -> Array:
    """Segments [n, 2, 2] (y, z) in which the plane x = at intersects triangles."""
    side = triangles[..., X] - at
    across = triangles[(side.min(axis=1) < 0) & (side.max(axis=1) > 0)]
    segments = []
    for corners in across:
        d = corners[:, 0] - at
        ends = [corners[i, 1:] + (corners[j, 1:] - corners[i, 1:]) * d[i] / (d[i] - d[j])
                for i, j in ((0, 1), (1, 2), (2, 0)) if d[i] * d[j] < 0]  # fmt: skip
        ends += [corners[i, 1:] for i in range(3) if d[i] == 0]
        if len(ends) == 2:
            segments.append(ends)
    return np.array(segments).reshape(-1, 2, 2)


def is_twin(hull: WettedSurface) -> bool:
    """Whether no section crosses the centreplane amidships."""
    triangles = _triangles(hull)
    at = (triangles[..., X].min() + triangles[..., X].max()) / 2 + 1e-7
    y = _cut(triangles, at)[..., BREADTH]
    return bool(len(y)) and not ((y.min(axis=1) <= 1e-9) & (y.max(axis=1) >= -1e-9)).any()


def _section(triangles: Array, at: float, ends: Array, points: int, twin: bool) -> Array:
    """Points [n, 2] (y, z down) of the starboard half at a station, from the keel (of a twin hull: from the inner
    waterline).
    """
    inset = INSIDE * np.ptp(ends)
    segments = _cut(triangles, float(np.clip(at, ends[0] + inset, ends[1] - inset)) + 1e-9)
    segments = segments[segments[..., BREADTH].mean(axis=1) > 0]
    keel = float(-segments[..., LEVEL].min())
    angle = np.linspace(0, np.pi / 2, points)
    levels = keel * np.cos(angle)  # closer at the keel, for the turn of the bilge
    levels[-1] = 0.0
    inner, outer = np.array([_breadths(segments, -level, NEAR * keel) for level in levels]).T
    if twin:
        return np.stack([[*inner[::-1], *outer], [*levels[::-1], *levels]], axis=1)
    return np.stack([[0.0, *outer], [keel, *levels]], axis=1)


def _breadths(segments: Array, z: float, tiny: float) -> tuple[float, float]:
    """Smallest and largest y at a level."""
    z = float(np.clip(z, segments[..., LEVEL].min() + tiny, segments[..., LEVEL].max() - tiny))
    (y0, z0), (y1, z1) = segments[:, 0].T, segments[:, 1].T
    across = (np.minimum(z0, z1) <= z) & (np.maximum(z0, z1) >= z) & (np.abs(z1 - z0) > 1e-12)
    if not across.any():
        return 0.0, 0.0
    y = y0[across] + (z - z0[across]) / (z1 - z0)[across] * (y1 - y0)[across]
    return float(y.min()), float(y.max())


def _places(triangles: Array, ends: Array, stations: int, points: int, twin: bool) -> Array:
    """x of stations: both ends, then by turns two kinds of places.

    One is where linear interpolation between the stations has the largest error. The other is midway between the two
    stations that are farthest apart, because waves are evaluated at the stations.
    """
    x = np.linspace(*ends, FINE)
    shape = np.stack([_section(triangles, at, ends, points, twin).ravel() for at in x])
    chosen = [0, FINE - 1]
    while len(chosen) < stations:
        chosen.sort()
        line = np.stack([np.interp(x, x[chosen], shape[chosen, j]) for j in range(shape.shape[1])], axis=1)
        miss = np.abs(shape - line).sum(axis=1)
        miss[chosen] = 0.0
        gap = int(np.diff(chosen).argmax())
        straight = len(chosen) % 2 or miss.max() < INSIDE * np.abs(shape).max()
        chosen.append((chosen[gap] + chosen[gap + 1]) // 2 if straight else int(miss.argmax()))
    return x[sorted(chosen)]


def _hull(places: Array, sections: Array, freeboard: float, decimals: int) -> StationsHull:
    """Hull of the sections, with vertical walls above the waterline."""
    stations = []
    for x, section in zip(places, sections, strict=True):
        y, z = np.round(section, decimals).T + 0.0
        rows = [*zip(y.tolist(), z.tolist(), strict=True), (float(y[-1]), -freeboard)]
        if sections[0, 0, 1] < sections[0, 1, 1]:  # begins at the inner waterline
            rows = [(float(y[0]), -freeboard), *rows]
        stations.append((round(float(x), decimals), tuple(rows)))
    return StationsHull(stations=tuple(stations))
