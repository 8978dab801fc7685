"""Lids: panels in the water's surface, inside a hull and between hulls.

Inside a hull: a boundary-element code gives wrong loads near the frequencies at which water inside the hull would slosh
("irregular frequencies"). A rigid lid over the inner waterplane removes them (Ohmatsu 1975; Lee and Sclavounos 1989).

Between the hulls of a catamaran, real water oscillates. Potential theory has no viscosity and exaggerates this near
resonance. A damping lid absorbs energy there (Chen 2004; problem.py).

The inner lid keeps half a panel's size away from the waterline. A lid that touches the waterline shifts the loads by
some per cent, because panels of lid and hull meet in the logarithmic singularity of the surface. A lid with a distance
also removes the irregular frequencies, and hardly shifts the loads (docs/hydrodynamics.md).

Both lids are built strip by strip along x, from the crossings of the waterline: inside and gap alternate across the
hull.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.hydro.surface import WettedSurface, X, Z

Array = NDArray[np.float64]
INSET = 1e-6  # distance, over a strip's width, from its ends at which crossings of the waterline are found
AWAY = 0.5  # distance of the inner lid from the waterline, over a panel's size
LEVEL = 1e-6  # m; an edge lies in the surface within this height


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
    return ends[(np.abs(ends[..., Z]) < LEVEL).all(axis=1) & (length > LEVEL)][..., :2]


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
    area = np.cross(panels[:, 2] - panels[:, 0], panels[:, 3] - panels[:, 1])[:, 2] / 2
    return panels[np.abs(area) > 1e-3 * size**2]


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
