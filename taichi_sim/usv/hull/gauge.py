"""Averages of a wave's height and slope over a hull's waterplane.

For a component cos(k x) and a waterplane A with its centre at x = 0, the factors of mean height and of slope are

    M(k) = 1/A int cos(k x) dA,      S(k) = int x sin(k x) dA / (k int x^2 dA).

The slope is that of the plane with the best fit (S = -M' / (k m_2), with m_n the n-th moment over A). For a rectangle
of half length h they are sin(z)/z and 3 (sin z - z cos z)/z^3, z = k h; for two thin pontoons at +-y, cos(k y) and
sin(k y)/(k y). For waves longer than a quarter of the hull they are polynomials of k^2, fitted once to the hull's own
waterplane:

    M = 1 - m_2 k^2/2 + m_4 k^4/24 - ...,      S = 1 - m_4 k^2/(6 m_2) + ...

These first terms are exact. Shorter waves cancel. The directions along and across the hull are treated separately: a
wave's mean is the product of both factors, which is exact if every part of the hull has the same section.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from taichi_sim.kernels import fast

Array = NDArray[np.float64]
SHORTEST, FITTED = 0.25, 0.3  # of the hull's extent; waves shorter than the first are ignored, above the second fitted
MEAN_TERMS, SLOPE_TERMS = 9, 8  # coefficients of powers of k^2; `averages` writes them out
NODES = 200  # wavenumbers of the fit
FADING = 0.03  # weight in the fit of waves shorter than FITTED
SMALL = 0.01  # rad; a series is used below


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
        mean = _fit(t, fade * elements.mean(k), weight, [1, -m2 * K / 2, m4 * K**2 / 24], MEAN_TERMS)
        slope = _fit(t, fade * elements.slope(k), weight, [1, -m4 * K / (6 * m2)], SLOPE_TERMS)
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
        """S at wavenumbers k [m] (rad/m), none of them 0."""
        kx, kh = np.multiply.outer(k, self.x), np.multiply.outer(k, self.half)
        # One element has x sin(kx) sinc(kh) + cos(kx) h j(kh), j(z) = (sin z - z cos z)/z^2 = z/3 - z^3/30 + ...
        z = np.maximum(kh, SMALL)
        j = np.where(kh < SMALL, kh / 3 - kh**3 / 30, (np.sin(z) - z * np.cos(z)) / z**2)
        first = self.x * np.sin(kx) * np.sinc(kh / np.pi) + self.half * np.cos(kx) * j
        return first @ self.share / (k * self.moment(2))


class Gauge(NamedTuple):
    """Averages of the water over a hull (see the module's docstring)."""

    along: Rule
    across: Rule
    depth: float  # m; depth at which the water's motion is evaluated: the draft

    @classmethod
    def of(cls, point: Array, weight: Array, half_size: Array, depth: float) -> "Gauge":
        """From waterplane elements at `point` [n, 2] with areas `weight` [n], each 2 half_size [n, 2] long and wide."""
        share = weight / weight.sum()
        x = point - share @ point
        along, across = (Rule.of(Elements(x[:, i], half_size[:, i], share)) for i in (0, 1))
        return cls(along, across, depth)


def _fit(t: Array, values: Array, weight: Array, first: list[float], terms: int) -> tuple[float, ...]:
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
    t = fast.at_most(x * x, 1.0)
    t2 = t * t
    # Estrin's scheme: the longest chain of operations sets the cost of a polynomial.
    mean_end = (m[4] + m[5] * t) + ((m[6] + m[7] * t) + m[8] * t2) * t2
    slope_end = (s[4] + s[5] * t) + (s[6] + s[7] * t) * t2
    t4 = t2 * t2
    mean = ((m[0] + m[1] * t) + (m[2] + m[3] * t) * t2) + mean_end * t4
    slope = ((s[0] + s[1] * t) + (s[2] + s[3] * t) * t2) + slope_end * t4
    return mean, x * slope
