"""Periodic cubic splines in the plane, in batches, as complex numbers north + i east.

Each curve is the closed C2 spline through given points with the chord length as parameter: de Boor (1978), A Practical
Guide to Splines, ch. IV. Three-point Gauss quadrature between nodes gives arc lengths.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]  # north + i east

NODES = 264, 8  # least number per lap and per gap
GAUSS_POINT, GAUSS_WEIGHT = np.polynomial.legendre.leggauss(3)


class ClosedSpline(NamedTuple):
    """Periodic cubic splines: p(v) = sum_i coefficient_i v^i, v in [0, chord) on each gap between two points.

    Attributes:
        coefficient: complex [world, gap, 4].
        chord: [world, gap].
    """

    coefficient: Complex
    chord: Real

    @staticmethod
    def through(point: Complex) -> ClosedSpline:
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

    def scaled(self, factor: Real) -> ClosedSpline:
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


class Jet(NamedTuple):
    """Complex position, velocity and acceleration [..] with respect to the parameter of the spline."""

    position: Complex
    velocity: Complex
    acceleration: Complex

    def curvature(self) -> Real:
        """Signed curvature [..], positive to starboard."""
        return (self.velocity.conj() * self.acceleration).imag / np.abs(self.velocity) ** 3


def evaluate(c: Complex, v: Real) -> Jet:
    """Evaluate cubics `c` [.., 4] at `v` [..]."""
    c0, c1, c2, c3 = (c[..., i] for i in range(4))
    return Jet(c0 + v * (c1 + v * (c2 + v * c3)), c1 + v * (2 * c2 + v * (3 * c3)), 2 * c2 + v * (6 * c3))


def nodes_per_gap(gaps: int) -> int:
    """Number of nodes on each gap between checkpoints."""
    return max(-(-NODES[0] // gaps), NODES[1])
