"""Everything that follows from a hull's shape: panels, wave lines, gauge, hydrostatics and deck; computed once."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import taichi as ti
import torch
from numpy.typing import NDArray
from torch import Tensor

from taichi_sim.kernels import fast_maths, runtime
from taichi_sim.kernels.conventions import AHEAD, STARBOARD
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics
from taichi_sim.models.usv.hull.mesh import HullShape, Panels, mesh

Array = NDArray[np.float64]
LONGEST = 8  # points per line; longer rows are divided, because every point of a line occupies registers
NEAR = 0.2, 0.5  # rows closer than this (m, share of their own step) share a line; 2 % of a wave of 3 m is lost
SHORTEST, FITTED = 0.25, 0.3  # of the hull's extent; waves shorter than the first are ignored, above the second fitted
MEAN_TERMS, SLOPE_TERMS = 9, 8  # coefficients of powers of k^2; `averages` writes them out
NODES = 200  # wavenumbers of the fit
FADING = 0.03  # weight in the fit of waves shorter than FITTED
SMALL = 0.01  # rad; a series is used below
PIECES = 8  # divisions of a panel in each direction, for the waterplane


@dataclass(frozen=True)
class WaveLines:
    """Points at which a hull samples the wave pressure: straight lines of `points` equally spaced points, in b.

    On the hull, a component is exp(kappa . r) with a complex kappa: wavenumber along the surface, decay downwards. From
    one point of a line to the next it is multiplied by one complex number, so a line of points costs little more than
    its first point. (Otherwise the waves at the hull would be nearly the whole cost of a step.) Each row of panels
    needs a line through the points at which its pressure is evaluated: the middle of its wet part at the design
    waterline. Rows side by side that are closer than waves can resolve, such as the two sides of a slender pontoon,
    share a line and use the pressure's change across it. Single panels, and rows that are dry at rest, use the nearest
    point of a line. Lines come in adjacent, parallel pairs, port and starboard, with the same step, if at least half of
    the lines have a parallel; a line without one is its own partner.
    """

    start: Array  # [line, 3] first point, m, b
    step: Array  # [line, 3] from one point to the next, m; the same in a pair
    abreast: int  # 2 for lines in pairs, else 1
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
    long = [row for row in rows if len(row) > 1 and not dry[row].all()]
    pieces = [piece for row in long for piece in np.array_split(row, -(-len(row) // LONGEST))] or rows
    pieces = [_forward(piece, point) for piece in pieces]
    bundles = _bundles(pieces, point)
    points = max(len(piece) for piece in pieces)
    middles = [np.mean([point[piece] for piece in bundle], axis=0) for bundle in bundles]
    lines = [(bundle, *_fit(middle)) for bundle, middle in zip(bundles, middles, strict=True)]
    start, step, bundles, abreast = _pair(lines, points)
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
    return WaveLines(start, step, abreast, points, node, across=offset[:, 1], ahead=offset[:, 0])


def _dry(panels: Panels) -> NDArray[np.bool_]:
    return panels.centre[:, 2] + np.abs(panels.up[:, 2]) <= 0


def _positions(start: Array, step: Array, points: int) -> Array:
    return (start[:, None] + np.arange(points)[None, :, None] * step[:, None]).reshape(-1, 3)


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


def _pair(lines: list[tuple], points: int) -> tuple[Array, Array, list, int]:
    """Starts, steps and bundles of `lines` = (bundle, start, step) in pairs of nearly the same step, and 2.

    If fewer than half of the lines have a parallel: of the lines as they are, and 1.
    """
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
    if len(bundles) > 1.5 * len(lines):
        bundles, start, step = zip(*lines, strict=True)
        return np.array(start), np.array(step), list(bundles), 1
    return np.array(start), np.array(step), bundles, 2


def _fit(points: Array) -> tuple[Array, Array]:
    """First point and step of the equally spaced straight line that best fits `points` [n, 3]."""
    place = np.arange(len(points)) - (len(points) - 1) / 2
    step = place @ points / max(place @ place, 1.0)
    return points.mean(axis=0) + place[0] * step, step


class Rule(NamedTuple):
    """M and S along one direction, as polynomials of t = (k scale)^2; at t = 1, the shortest waves, both are 0."""

    scale: float  # m
    mean: tuple[float, ...]  # MEAN_TERMS coefficients, the constant first
    slope: tuple[float, ...]  # SLOPE_TERMS coefficients of S / scale, 1/m

    @classmethod
    def of(cls, elements: "Elements") -> "Rule":
        """Fit the polynomials to the averages over `elements`."""
        extent = float((elements.x + elements.half).max() - (elements.x - elements.half).min())
        k_end, k_fitted = 2 * np.pi / (extent * SHORTEST), 2 * np.pi / (extent * FITTED)
        t = 0.5 - 0.5 * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        k = k_end * np.sqrt(t)
        fade = 0.5 + 0.5 * np.cos(np.pi * np.clip((k - k_fitted) / (k_end - k_fitted), 0, 1))
        weight = np.where(k > k_fitted, FADING, 1.0)
        m2, m4, K = elements.moment(2), elements.moment(4), k_end**2
        mean = _polynomial(t, fade * elements.mean(k), weight, [1, -m2 * K / 2, m4 * K**2 / 24], MEAN_TERMS)
        slope = _polynomial(t, fade * elements.slope(k), weight, [1, -m4 * K / (6 * m2)], SLOPE_TERMS)
        return cls(float(1 / k_end), mean, tuple(k_end * c for c in slope))


class Elements(NamedTuple):
    """A waterplane along one direction, as rectangles about its centre."""

    x: Array  # [n] middle, m
    half: Array  # [n] half length, m
    share: Array  # [n] share of the area; the sum is 1

    def moment(self, order: int) -> float:
        """Mean of x^order over the waterplane, order 2 or 4."""
        x2, h2 = self.x**2, self.half**2
        return float(self.share @ (x2 + h2 / 3 if order == 2 else x2**2 + 2 * x2 * h2 + h2**2 / 5))

    def mean(self, k: Array) -> Array:
        """M at wavenumbers k [m] (rad/m)."""
        kx, kh = np.multiply.outer(k, self.x), np.multiply.outer(k, self.half)
        return (np.cos(kx) * np.sinc(kh / np.pi)) @ self.share

    def slope(self, k: Array) -> Array:
        """Slope factor S (S(k) = int x sin(k x) dA / (k int x^2 dA)) at wavenumbers k [m] (rad/m), none of them 0; [m]
        is their number.
        """
        kx, kh = np.multiply.outer(k, self.x), np.multiply.outer(k, self.half)
        # One element has x sin(kx) sinc(kh) + cos(kx) h j(kh), j(z) = (sin z - z cos z)/z^2 = z/3 - z^3/30 + ...
        z = np.maximum(kh, SMALL)
        j = np.where(kh < SMALL, kh / 3 - kh**3 / 30, (np.sin(z) - z * np.cos(z)) / z**2)
        first = self.x * np.sin(kx) * np.sinc(kh / np.pi) + self.half * np.cos(kx) * j
        return first @ self.share / (k * self.moment(2))


class Gauge(NamedTuple):
    """Averages of a wave's height and slope over a hull's waterplane.

    For a component cos(k x) and a waterplane A with its centre at x = 0, the factors of mean height and of slope are

        M(k) = 1/A int cos(k x) dA,      S(k) = int x sin(k x) dA / (k int x^2 dA).

    The slope is that of the plane with the best fit (S = -M' / (k m_2), with m_n the n-th moment over A). For a
    rectangle of half length h they are sin(z)/z and 3 (sin z - z cos z)/z^3, z = k h; for two thin pontoons at +-y,
    cos(k y) and sin(k y)/(k y). For waves longer than a quarter of the hull they are polynomials of k^2, fitted once to
    the hull's own waterplane:

        M = 1 - m_2 k^2/2 + m_4 k^4/24 - ...,      S = 1 - m_4 k^2/(6 m_2) + ...

    These first terms are exact. Shorter waves cancel. The directions along and across the hull are treated separately:
    a wave's mean is the product of both factors, which is exact if every part of the hull has the same section.
    """

    along: Rule
    across: Rule
    depth: float  # m; depth at which the water's motion is evaluated: the draft

    @classmethod
    def of(cls, point: Array, weight: Array, half_size: Array, depth: float) -> "Gauge":
        """Make a gauge of waterplane elements at `point` with areas `weight` [n] and sides 2 half_size, both [n, 2]."""
        share = weight / weight.sum()
        x = point - share @ point
        along, across = (Rule.of(Elements(x[:, i], half_size[:, i], share)) for i in (0, 1))
        return cls(along, across, depth)


def _polynomial(t: Array, values: Array, weight: Array, first: list[float], terms: int) -> tuple[float, ...]:
    """Fit `terms` coefficients of a polynomial to `values` at t; the `first` ones are given, and their sum is 0."""
    known, powers = len(first), np.power.outer(t, np.arange(terms))
    # The last coefficient makes the sum 0, so t^n becomes t^n - t^(terms - 1).
    basis = powers[:, known:-1] - powers[:, -1:]
    left = values - powers[:, :known] @ first + sum(first) * powers[:, -1]
    found = np.linalg.lstsq(weight[:, None] * basis, weight * left, rcond=None)[0]
    return (*map(float, first), *map(float, found), float(-sum(first) - found.sum()))


@ti.func
def averages(rule: ti.template(), x):
    """M, and k S (rad/m), of a component of wavenumber k along the rule's direction; x = k rule.scale."""
    m, s = ti.static(rule.mean, rule.slope)
    t = fast_maths.at_most(x * x, 1.0)
    t2 = t * t
    # Estrin's scheme: the longest chain of operations sets the cost of a polynomial.
    mean_end = (m[4] + m[5] * t) + ((m[6] + m[7] * t) + m[8] * t2) * t2
    slope_end = (s[4] + s[5] * t) + (s[6] + s[7] * t) * t2
    t4 = t2 * t2
    mean = ((m[0] + m[1] * t) + (m[2] + m[3] * t) * t2) + mean_end * t4
    slope = ((s[0] + s[1] * t) + (s[2] + s[3] * t) * t2) + slope_end * t4
    return mean, x * slope


@dataclass(frozen=True)
class HullGeometry:
    """Geometry of one hull, in b."""

    panels: Panels
    lines: WaveLines
    gauge: Gauge
    hydrostatics: Hydrostatics

    @classmethod
    def of(cls, shape: HullShape, mass: float, cg: tuple[float, float, float]) -> "HullGeometry":
        """Mesh `shape` and prepare its tables; mass (kg) and cg (m, b) are those of the loaded hull."""
        panels = mesh(shape)
        return cls(panels, wave_lines(panels), _gauge(panels), Hydrostatics(panels, mass, cg))

    @cached_property
    def deck_corners(self) -> Array:
        """Points [corner, 3] of the deck edge that are the outermost in any of eight directions; the lowest point
        is one of them.
        """
        deck, angle = self.panels.deck, np.arange(8) * np.pi / 4
        reach = deck[:, :2] @ np.stack([np.cos(angle), np.sin(angle)])
        return deck[np.unique(reach.argmax(axis=0))]


def device_table(values: NDArray) -> Tensor:
    """Convert real numbers to a tensor for kernels, in run precision and on the run's device."""
    run = runtime.current()
    return torch.as_tensor(np.ascontiguousarray(values), dtype=run.torch_dtype, device=run.device)


def _gauge(panels: Panels) -> Gauge:
    """Gauge of the waterplane that the downward-facing panels show, each cut into PIECES x PIECES."""
    facing = panels.area[:, 2] > 0
    edges = panels.centre, panels.along, panels.up, panels.twist
    centre, along, up, twist = (v[facing, None, None, :2] for v in edges)
    middle = (2 * np.arange(PIECES) + 1) / PIECES - 1
    s, t = middle[:, None, None], middle[None, :, None]
    point, ds, dt = centre + s * along + t * up + s * t * twist, along + t * twist, up + s * twist
    area = np.abs(ds[..., AHEAD] * dt[..., STARBOARD] - ds[..., STARBOARD] * dt[..., AHEAD])
    half_size = (np.abs(ds) + np.abs(dt)) / PIECES
    return Gauge.of(point.reshape(-1, 2), area.ravel(), half_size.reshape(-1, 2), float(panels.draft))
