"""Points at which a hull samples the wave pressure: straight lines of equally spaced points, in b.

On the hull, a component is exp(kappa . r) with a complex kappa: wavenumber along the surface, decay downwards. From one
point of a line to the next it is multiplied by one complex number, so a line of points costs little more than its first
point. (Otherwise the waves at the hull would be nearly the whole cost of a step.) Each row of panels (mesh.py) needs a
line through the points at which its pressure is evaluated: the middle of its wet part at the design waterline. Rows
side by side that are closer than waves can resolve, such as the two sides of a slender pontoon, share a line and use
the pressure's change across it. Single panels, and rows that are dry at rest, use the nearest point of a line. Lines
come in parallel pairs, port and starboard, with the same step; a line without a parallel is its own partner.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.usv.hull.mesh import Panels

Array = NDArray[np.float64]
LONGEST = 8  # points per line; longer rows are divided, because every point of a line occupies registers
NEAR = 0.2, 0.5  # rows closer than this (m, share of their own step) share a line; 2 % of a wave of 3 m is lost


@dataclass(frozen=True)
class WaveLines:
    """Pairs of lines of `points` points each, and the point that each panel reads; the lines of a pair are adjacent."""

    start: Array  # [line, 3] first point, m, b
    step: Array  # [line, 3] from one point to the next, m; the same in a pair
    points: int
    node: NDArray[np.int32]  # [N] line * points + index of the point that each panel reads
    across: Array  # [N] distance of a panel's wave point to starboard of the point that it reads, m
    ahead: Array  # [N] distance ahead of it, m

    @property
    def position(self) -> Array:
        """All points [line * points, 3], m, b."""
        return _positions(self.start, self.step, self.points)


def wave_points(panels: Panels) -> Array:
    """Points [N, 3] (m, b) at which each panel evaluates the wave pressure.

    They are at the panel's centre, in the middle of the depths that it wets at the design waterline; for a dry panel,
    at the depth nearest to the water.
    """
    rise = panels.up[:, 2]
    steep = np.abs(rise) > 1e-9
    # z = centre + t up is at the water line at t0; the wet part extends from there to the lower end of the panel
    t0 = np.clip(-panels.centre[:, 2] / np.where(steep, rise, 1.0), -1.0, 1.0)
    lower = np.sign(rise)
    t = np.where(steep, (t0 + lower) / 2, 0.0)
    t = np.where(_dry(panels), lower, t)
    point = panels.centre.copy()
    point[:, 2] = np.maximum(point[:, 2] + t * rise, 0.0)
    return point


def wave_lines(panels: Panels) -> WaveLines:
    """Lines through the wave points of `panels`."""
    point, dry = wave_points(panels), _dry(panels)
    rows = [np.flatnonzero(panels.row == r) for r in np.unique(panels.row)]
    pieces = [piece for row in rows if len(row) > 1 and not dry[row].all() for piece in _pieces(row)] or rows
    pieces = [_forward(piece, point) for piece in pieces]
    bundles = _bundles(pieces, point)
    points = max(len(piece) for piece in pieces)
    start, step, bundles = _pair([(bundle, *_fit(_middle(bundle, point))) for bundle in bundles], points)
    node = np.full(len(panels), -1, dtype=np.int32)
    for line, bundle in enumerate(bundles):
        for piece in bundle:
            node[piece] = line * points + np.arange(len(piece))
    place = _positions(start, step, points)
    used = np.unique(node[node >= 0])  # a short line continues beyond its rows, where no panel reads
    alone = node < 0
    for panel in np.flatnonzero(alone):
        node[panel] = used[np.argmin(np.linalg.norm(place[used] - point[panel], axis=1))]
    offset = np.where(alone[:, None], 0.0, point - place[node])
    return WaveLines(start, step, points, node, across=offset[:, 1], ahead=offset[:, 0])


def _dry(panels: Panels) -> NDArray[np.bool_]:
    return panels.centre[:, 2] + np.abs(panels.up[:, 2]) <= 0


def _positions(start: Array, step: Array, points: int) -> Array:
    return (start[:, None] + np.arange(points)[None, :, None] * step[:, None]).reshape(-1, 3)


def _pieces(row: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Divide a row into pieces of nearly equal length, none longer than LONGEST."""
    return np.array_split(row, -(-len(row) // LONGEST))


def _bundles(pieces: list[NDArray[np.int64]], point: Array) -> list[list[NDArray[np.int64]]]:
    """Bundles of pieces side by side, each near the first one of its bundle."""
    bundles: list[list[NDArray[np.int64]]] = []
    for piece in pieces:
        step = np.linalg.norm(_fit(point[piece])[1])
        for bundle in bundles:
            if len(bundle[0]) == len(piece):
                gap = np.linalg.norm(point[piece] - point[bundle[0]], axis=1).max()
                if gap < min(NEAR[0], NEAR[1] * step):
                    bundle.append(piece)
                    break
        else:
            bundles.append([piece])
    return bundles


def _forward(piece: NDArray[np.int64], point: Array) -> NDArray[np.int64]:
    """The piece, reversed if needed, so that its longest extent runs forward, to starboard or down."""
    way = point[piece[-1]] - point[piece[0]]
    return piece if way[np.abs(way).argmax()] >= 0 else piece[::-1]


def _middle(bundle: list[NDArray[np.int64]], point: Array) -> Array:
    """Points [n, 3] through which the line of a bundle should pass."""
    return np.mean([point[piece] for piece in bundle], axis=0)


def _pair(lines: list[tuple], points: int) -> tuple[Array, Array, list]:
    """Starts, steps and bundles of `lines` = (bundle, start, step), in pairs of nearly the same step."""
    start, step, bundles, left = [], [], [], list(lines)
    while left:
        bundle, at, way = left.pop(0)
        # With the mean step of both, the ends of a line stay as close to their points as those of a bundle.
        allowed = 4 * min(NEAR[0], NEAR[1] * float(np.linalg.norm(way))) / max(points - 1, 1)
        other = next((n for n, line in enumerate(left) if np.linalg.norm(line[2] - way) < allowed), None)
        bundle_b, at_b, way_b = (list[NDArray[np.int64]](), at, way) if other is None else left.pop(other)
        mean, half = (way + way_b) / 2, (points - 1) / 2
        start += [at + half * (way - mean), at_b + half * (way_b - mean)]
        step += [mean, mean]
        bundles += [bundle, bundle_b]
    return np.array(start), np.array(step), bundles


def _fit(points: Array) -> tuple[Array, Array]:
    """First point and step of the equally spaced straight line that best fits `points` [n, 3]."""
    place = np.arange(len(points)) - (len(points) - 1) / 2
    step = place @ points / max(place @ place, 1.0)
    return points.mean(axis=0) + place[0] * step, step
