"""The tracks of the mission: smooth closed curves through unevenly spaced numbered checkpoints.

Section 4 of the seed paper: a track about 4,000 m long, within an area about 3,000 m by 3,000 m, with 22
checkpoints unevenly distributed on it. One track per world, drawn from a seed:

    course        chi(t) = +-2 pi t + sum_k a_k cos(2 pi k t + phi_k), k = 2..6: one turn a lap, and meanders
    curve         the integral of exp(i chi) less its drift, so that it closes; checkpoints at uneven t on it
    track         the periodic cubic spline through them in chord length: C2, so course and curvature close
    size          scaled to the arc length `length_m`; placed at random inside the area less the margin
    softening     the curve is drawn again with slightly smaller a_k until it fits the area, has no bend tighter than
                  `min_radius_m`, and no two strands nearer than twice that; the limit is a circle

Frame: NED, positions are [north, east] in m from the centre of the area, or the complex number north + i east
while a track is made. Course is clockwise from north (the argument of the velocity), rad. Curvature
d(course)/ds, in 1/m, is positive when the track bends to starboard.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import taichi as ti
import torch
from numpy.typing import NDArray
from torch import Tensor

from taichi_sim.kernels.runtime import array1, array2

# All assumed: the paper gives only a length, an area and a number of checkpoints.
HARMONICS = np.arange(2, 7)
SWING_RAD = 2.6  # greatest a_k is this / k
SWING_LEAST = 0.3  # least a_k as a share of the greatest
GAP_RATIO = (0.35, 1.65)  # gap between neighbouring checkpoints over the mean gap, before the curve closes
SHRINK = 0.96
MAX_DRAWS = 150
GAP_SOFTENING = 0.1  # below this share of the swing the gaps become even too: the limit is a circle
BEND_SLACK = 1.03  # between checked nodes a bend may be a little tighter
REACH_SLACK = 1.02  # and two strands a little nearer
LENGTH_SHARE = 0.98  # largest length_m, as a share of the longest circle's
RADIUS_SHARE = 0.5  # largest min_radius_m, as a share of the circle's radius
REACH_STRIDE = 3  # every third node is checked for distance

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]  # north + i east

NODES = 264, 8  # least number per lap and per gap
GAUSS_POINT, GAUSS_WEIGHT = np.polynomial.legendre.leggauss(3)
PI = math.pi
TRACK_STREAM = 0  # random stream of the first draw; each draw has the next one


class TrackSample:
    """Columns of a table of tracks: place (m), course (rad), curvature (1/m, positive to starboard)."""

    NORTH, EAST, COURSE, CURVATURE, SIZE = range(5)


class TrackPoint(NamedTuple):
    """A point of a track: position [.., 2] (north, east, m), course [..] in [-pi, pi), curvature [..] 1/m."""

    position: Tensor
    course: Tensor
    curvature: Tensor


@dataclass(frozen=True)
class Tracks:
    """One closed track per world, sampled at equal steps of arc length.

    table         float32 [world, sample, 4]: north (m), east (m), course (rad, unwrapped: the lap closes at
                  a multiple of 2 pi), curvature (1/m, positive to starboard); the first sample is checkpoint 1
    length_m      float32 [world]
    checkpoints   float32 [world, checkpoint, 2]: north, east (m)
    checkpoint_s  float32 [world, checkpoint]: arc length from checkpoint 1 (m), increasing from 0
    rows          float32 [world * (sample + 1), 4]: the table with the end of the lap, one after the other, for kernels
    """

    table: Tensor
    length_m: Tensor
    checkpoints: Tensor
    checkpoint_s: Tensor
    rows: Tensor = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Build the rows: each world's samples followed by the end of its lap, [world * (sample + 1), 4]."""
        end = self.table[:, :1].clone()
        turned = self.table[:, -1:, TrackSample.COURSE] - end[..., TrackSample.COURSE]
        end[..., TrackSample.COURSE] += 2 * torch.pi * torch.round(turned / (2 * torch.pi))
        object.__setattr__(self, "rows", torch.cat((self.table, end), dim=1).flatten(0, 1).contiguous())

    @property
    def worlds(self) -> int:
        """Number of worlds."""
        return self.table.shape[0]

    @property
    def samples(self) -> int:
        """Number of samples per lap."""
        return self.table.shape[1]

    def to(self, device: torch.device | str, dtype: torch.dtype) -> "Tracks":
        """Return the same tracks on another device, in another precision."""
        tensors = self.table, self.length_m, self.checkpoints, self.checkpoint_s
        return Tracks(*(tensor.to(device, dtype) for tensor in tensors))

    def at(self, world: Tensor, s: Tensor) -> TrackPoint:
        """The point at arc length `s` [..] (m, modulo the length) on the track of `world` [..].

        `world` is int64 with the shape of `s`; its values are not checked. Course and curvature are linear between
        samples. Position is linear plus the bow of the arc over its chord, kappa h^2 f (f - 1) / 2 to starboard. At the
        usual spacing h of 3.9 m the chord alone is off by kappa h^2 / 8 = 19 mm in a bend of 100 m radius; with the bow
        the error is below 1 mm.
        """
        world, s_flat = world.to(self.table.device).flatten().contiguous(), s.to(self.length_m).flatten().contiguous()
        found = self.table.new_empty((s_flat.shape[0], 4))
        _look_up(found, self.rows, self.length_m, world, s_flat)
        north, east, course, curvature = found.view(*s.shape, 4).unbind(-1)
        return TrackPoint(torch.stack((north, east), dim=-1), course, curvature)


@ti.func
def track_point(rows: ti.template(), length: ti.template(), world, s):
    """(north, east, course, curvature) at arc length s (m) on the track of `world`; see `Tracks.at`."""
    samples = rows.shape[0] // length.shape[0] - 1
    lap = s / length[world]
    x = (lap - ti.floor(lap)) * samples
    sample = ti.min(ti.cast(x, ti.i32), samples - 1)  # the difference may round up to a whole lap
    f, row = x - sample, sample + world * (samples + 1)
    here, step = ti.Vector([x * 0.0 for _ in range(4)]), ti.Vector([x * 0.0 for _ in range(4)])
    for c in ti.static(range(4)):
        here[c] = rows[row, c]
        step[c] = rows[row + 1, c] - here[c]
    curvature = here[3] + f * step[3]
    bow = (f * f - f) * (0.5 * length[world] / samples) * curvature
    course = here[2] + f * step[2]
    course -= ti.floor((course + PI) * ti.static(0.5 / PI)) * ti.static(2 * PI)
    return ti.Vector([here[0] + f * step[0] - bow * step[1], here[1] + f * step[1] + bow * step[0], course, curvature])


@ti.kernel
def _look_up(out: array2, rows: array2, length: array1, world: ti.types.ndarray(dtype=ti.i64, ndim=1), s: array1):
    for n in range(s.shape[0]):
        place = track_point(rows, length, ti.cast(world[n], ti.i32), s[n])
        for c in ti.static(range(4)):
            out[n, c] = place[c]


class Jet(NamedTuple):
    """Complex position, velocity and acceleration [..] with respect to the parameter of the spline."""

    position: Complex
    velocity: Complex
    acceleration: Complex

    def curvature(self) -> Real:
        """Signed curvature [..], positive to starboard."""
        return (self.velocity.conj() * self.acceleration).imag / np.abs(self.velocity) ** 3


class ClosedSpline(NamedTuple):
    """Periodic cubic splines in the plane: p(v) = sum_i coefficient_i v^i, v in [0, chord) on each gap between two
    points, as complex numbers north + i east.

    Each curve is the closed C2 spline through given points with the chord length as parameter: de Boor (1978), A
    Practical Guide to Splines, ch. IV. Three-point Gauss quadrature between nodes gives arc lengths.

    Attributes:
        coefficient: complex [world, gap, 4].
        chord: [world, gap].
    """

    coefficient: Complex
    chord: Real

    @staticmethod
    def through(point: Complex) -> "ClosedSpline":
        """The closed C2 curves through `point` [world, gap] with the chord length as parameter."""
        worlds, gaps = point.shape
        rise = np.roll(point, -1, axis=1) - point
        chord = np.abs(rise)
        after = 1 / chord
        before = np.roll(after, 1, axis=1)
        j = np.arange(gaps)
        continuity = np.zeros((worlds, gaps, gaps))  # continuity of the second derivative, in terms of the first
        continuity[:, j, j - 1] = before
        continuity[:, j, j] = 2 * (before + after)
        continuity[:, j, (j + 1) % gaps] = after
        pull = 3 * rise * after**2
        pull = (pull + np.roll(pull, 1, axis=1)).view(np.float64).reshape(worlds, gaps, 2)
        slope = np.ascontiguousarray(np.linalg.solve(continuity, pull)).view(np.complex128).squeeze(-1)
        slope_end = np.roll(slope, -1, axis=1)
        second = (3 * rise * after - 2 * slope - slope_end) * after
        third = (slope + slope_end - 2 * rise * after) * after**2
        return ClosedSpline(np.stack((point, slope, second, third), axis=-1), chord)

    def scaled(self, factor: Real) -> "ClosedSpline":
        """The curves enlarged by `factor` [world]."""
        power = factor[:, None] ** (1 - np.arange(4))
        return ClosedSpline(self.coefficient * power[:, None], self.chord * factor[:, None])

    def nodes(self) -> tuple[Jet, Real]:
        """The curves at evenly spaced nodes on each gap [world, node], and their arc lengths [world, node + 1]."""
        worlds, gaps = self.chord.shape
        per_gap = nodes_per_gap(gaps)
        v = self.chord[..., None] * (np.arange(per_gap) / per_gap)
        jet = Jet(*(x.reshape(worlds, -1) for x in evaluate(self.coefficient[:, :, None], v)))
        s = np.zeros((worlds, 1 + jet.position.shape[1]))
        cell = self.chord[..., None] / per_gap
        for point, weight in zip(GAUSS_POINT, GAUSS_WEIGHT, strict=True):
            speed = np.abs(evaluate(self.coefficient[:, :, None], v + cell * (point + 1) / 2).velocity)
            s[:, 1:] += (weight / 2 * cell * speed).reshape(worlds, -1)
        return jet, np.cumsum(s, axis=1)


def evaluate(c: Complex, v: Real) -> Jet:
    """Evaluate cubics `c` [.., 4] at `v` [..]."""
    c0, c1, c2, c3 = (c[..., i] for i in range(4))
    return Jet(c0 + v * (c1 + v * (c2 + v * c3)), c1 + v * (2 * c2 + v * (3 * c3)), 2 * c2 + v * (6 * c3))


def nodes_per_gap(gaps: int) -> int:
    """Number of nodes on each gap between checkpoints."""
    return max(-(-NODES[0] // gaps), NODES[1])


def world_uniform(seed: int, stream: int, worlds: int, *shape: int) -> Real:
    """Uniform numbers in [0, 1) [world, *shape]; those of world w depend only on seed, stream, w and shape.

    Philox is counter-based and uses one 64-bit draw per number: each world has a fixed part of its sequence.
    """
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed must be in [0, 2^64), got {seed}")
    return np.random.Generator(np.random.Philox(key=seed + (stream << 64))).random((worlds, *shape))


def generate_tracks(
    num_worlds: int,
    seed: int,
    *,
    length_m: float = 4000.0,
    area_m: float = 3000.0,
    checkpoints: int = 22,
    min_radius_m: float = 100.0,
    margin_m: float = 200.0,
    samples: int = 1024,
) -> Tracks:
    """Draw one track for each world; world w of a seed is the same for any `num_worlds`.

    Args:
        num_worlds: number of worlds.
        seed: of the draw.
        length_m: length of a lap, exact.
        area_m: side of the square area, centred at the origin.
        checkpoints: number of checkpoints, unevenly spaced.
        min_radius_m: least radius of bends; strands of the track keep twice this distance.
        margin_m: least distance from the track to the edge of the area.
        samples: rows of the table per lap.
    """
    _check(num_worlds, length_m, area_m, checkpoints, min_radius_m, margin_m, samples)
    side_m = area_m - 2 * margin_m
    point = np.empty((num_worlds, checkpoints), dtype=np.complex128)
    pending = np.arange(num_worlds)
    numbers = 3 + checkpoints + 2 * len(HARMONICS)
    for draw in range(MAX_DRAWS):
        uniform = world_uniform(seed, TRACK_STREAM + 1 + draw, num_worlds, numbers)
        point[pending] = _checkpoints(uniform[pending], SHRINK**draw, checkpoints)
        pending = pending[~_acceptable(ClosedSpline.through(point[pending]), length_m, min_radius_m, side_m)]
        if pending.size == 0:
            place = world_uniform(seed, TRACK_STREAM, num_worlds, 2)
            return _tabulate(ClosedSpline.through(point), place, length_m, side_m, samples)
    raise ValueError(
        f"no track for {pending.size} of {num_worlds} worlds: min_radius_m = {min_radius_m:g} is too large "
        f"for length_m = {length_m:g} through {checkpoints} checkpoints"
    )


def _check(
    num_worlds: int,
    length_m: float,
    area_m: float,
    checkpoints: int,
    min_radius_m: float,
    margin_m: float,
    samples: int,
) -> None:
    """Refuse parameters that no track can satisfy. The softest track is a circle, so a circle sets the limits."""
    longest = LENGTH_SHARE * np.pi * (area_m - 2 * margin_m)
    widest = RADIUS_SHARE * length_m / (2 * np.pi)
    for name, value, low, high, note in (
        ("num_worlds", num_worlds, 1, np.inf, ""),
        ("checkpoints", checkpoints, 4, np.inf, ""),
        ("samples", samples, 4 * checkpoints, np.inf, " (four per checkpoint)"),
        ("margin_m", margin_m, 0.0, area_m / 2, f" m (half of area_m = {area_m:g})"),
        ("length_m", length_m, 1.0, longest, f" m (area_m = {area_m:g}, margin_m = {margin_m:g})"),
        ("min_radius_m", min_radius_m, 0.0, widest, f" m (for length_m = {length_m:g})"),
    ):
        if not low <= value <= high:
            raise ValueError(f"{name} must be in [{low:g}, {high:.6g}]{note}, got {value:g}")


def _checkpoints(uniform: Real, softness: float, count: int) -> Complex:
    """Checkpoints [world, count] on a random closed curve of length about 1; `softness` 0 gives a circle."""
    reverse, turn, start = uniform[:, 0:1], uniform[:, 1:2], uniform[:, 2:3]
    gap, swing, phase = np.split(uniform[:, 3:], (count, count + len(HARMONICS)), axis=1)
    steps = nodes_per_gap(count) * count
    t = np.arange(steps) / steps
    swing = softness * SWING_RAD / HARMONICS * (SWING_LEAST + (1 - SWING_LEAST) * swing)
    phase = 2 * np.pi * phase
    course = np.where(reverse < 0.5, 1, -1) * 2 * np.pi * t + 2 * np.pi * turn
    for i, k in enumerate(HARMONICS):
        course += swing[:, i : i + 1] * np.cos(2 * np.pi * k * t + phase[:, i : i + 1])
    velocity: Complex = np.exp(1j * course)
    velocity -= velocity.mean(axis=1, keepdims=True)
    # The trapezoidal rule: periodic, so the curve closes.
    curve = np.cumsum(velocity + np.roll(velocity, 1, axis=1), axis=1) / (2 * steps)

    gap = 1 + (GAP_RATIO[0] - 1 + np.ptp(GAP_RATIO) * gap) * min(1, softness / GAP_SOFTENING)
    at = np.cumsum(gap, axis=1) / gap.sum(axis=1, keepdims=True)
    step = np.rint((at + start) * steps).astype(np.int64) % steps
    return curve[np.arange(len(curve))[:, None], step]


def _extent(position: Complex) -> tuple[Real, Real]:
    """Least and greatest (north, east) [world, 2] of `position` [world, node]."""
    parts = np.stack((position.real, position.imag), axis=1)
    return parts.min(axis=-1), parts.max(axis=-1)


def _acceptable(spline: ClosedSpline, length_m: float, min_radius_m: float, side_m: float) -> NDArray[np.bool_]:
    """Whether each curve [world] at its final size keeps the least radius and distance and fits the area."""
    jet, s = spline.nodes()
    scale = length_m / s[:, -1]
    bend = np.abs(jet.curvature()).max(axis=1) / scale
    low, high = _extent(jet.position)
    fits = (bend * min_radius_m * BEND_SLACK <= 1) & ((high - low).max(axis=1) * scale <= side_m)

    # A bend of radius R turns back on itself after pi R, 2 R apart; only the curves still good are measured.
    strand = (jet.position * scale[:, None])[fits, ::REACH_STRIDE]
    s = (s * scale[:, None])[fits, :-1:REACH_STRIDE]
    away = np.abs(s[:, :, None] - s[:, None])
    away = np.minimum(away, length_m - away)
    near = np.abs(strand[:, :, None] - strand[:, None]) < 2 * min_radius_m * REACH_SLACK
    fits[fits] = ~(near & (away > np.pi * min_radius_m * REACH_SLACK)).any(axis=(1, 2))
    return fits


def _tabulate(spline: ClosedSpline, place: Real, length_m: float, side_m: float, samples: int) -> Tracks:
    """Scale to the length, sample at equal arc lengths, and move by `place` [world, 2] in [0, 1)."""
    spline = spline.scaled(length_m / spline.nodes()[1][:, -1])
    node, node_s = spline.nodes()
    worlds, cells = node.position.shape
    world = np.arange(worlds)[:, None]

    # Invert s(v) by cubic Hermite on the cells between nodes: dv/ds = 1 / speed.
    s = length_m * np.arange(samples) / samples
    apart = 2 * length_m * world  # so that one sorted search serves all worlds
    cell = np.searchsorted((node_s[:, 1:-1] + apart).ravel(), (s + apart).ravel(), side="right")
    cell = cell.reshape(worlds, samples) - world * (cells - 1)
    pace = 1 / np.abs(node.velocity)
    step_s = np.diff(node_s, axis=1)
    f = (s - node_s[world, cell]) / step_s[world, cell]
    start, end = (step_s * pace)[world, cell], (step_s * np.roll(pace, -1, axis=1))[world, cell]
    per_gap = cells // spline.chord.shape[1]
    gap = cell // per_gap
    step_v = spline.chord[world, gap] / per_gap
    bend = 3 * step_v - 2 * start - end + f * (start + end - 2 * step_v)
    jet = evaluate(spline.coefficient[world, gap], (cell % per_gap) * step_v + f * (start + f * bend))

    low, high = _extent(jet.position)
    offset = (-side_m / 2 - low + place * (side_m - (high - low)))[:, None]
    position = np.stack((jet.position.real, jet.position.imag), axis=-1) + offset
    course = np.unwrap(np.angle(jet.velocity), axis=1)
    table = np.concatenate((position, np.stack((course, jet.curvature()), axis=-1)), axis=-1)
    point = node.position[:, ::per_gap]
    checkpoints = np.stack((point.real, point.imag), axis=-1) + offset
    tensors = table, np.full(worlds, length_m), checkpoints, node_s[:, :-1:per_gap]
    return Tracks(*(torch.from_numpy(x.astype(np.float32)) for x in tensors))
