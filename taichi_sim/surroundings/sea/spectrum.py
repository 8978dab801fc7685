"""Wave spectra, spreading and dispersion (NumPy, float64, once per run).

JONSWAP in the normalisation of DNV-RP-C205 (2010), sec. 3.5.5:

    S(w) = A_g 5/16 Hs^2 wp^4 w^-5 exp(-5/4 (w/wp)^-4) gamma^exp(-(w-wp)^2 / (2 s^2 wp^2)),
    A_g = 1 - 0.287 ln gamma,  s = 0.07 for w <= wp, else 0.09.

gamma = 1 is the Bretschneider (two-parameter Pierson-Moskowitz) spectrum. Directional spreading is cos^2s:
D(theta) = N cos^2s((theta - theta0) / 2), N = Gamma(s+1) / (2 sqrt(pi) Gamma(s + 1/2)), Longuet-Higgins 1963.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from taichi_sim.kernels.conventions import GRAVITY

PM_ALPHA, PM_BETA = 8.1e-3, 0.74  # constants of Pierson & Moskowitz (1964)
CALM_PERIOD = 4.0  # s, nominal period of a calm sea
QUADRATURE_PANEL = 0.02  # width in ln(omega) of a quadrature panel; the peak is about 0.07 wide


@dataclass(frozen=True)
class Components:
    """Wave components of one or more sea realisations; every array is [sea, component], float64."""

    amplitude: np.ndarray  # m
    k: np.ndarray  # rad/m
    omega: np.ndarray  # rad/s
    direction: np.ndarray  # rad, where the component travels to, clockwise from north
    phase: np.ndarray  # rad

    @property
    def hs(self) -> np.ndarray:
        """Significant wave height 4 sqrt(m0), with m0 = sum a^2 / 2, of each realisation, m."""
        return 4 * np.sqrt(np.sum(self.amplitude**2, axis=1) / 2)

    @property
    def sum_ka(self) -> np.ndarray:
        """Largest possible slope of each realisation's linear surface; from 1 on, Gerstner waves may loop."""
        return np.sum(self.k * self.amplitude, axis=1)

    def steepness(self, depth: float | None = None) -> np.ndarray:
        """Sum of k a coth(k depth) of each realisation; from 1 on its surface could loop. depth: m, None for deep."""
        return (self.k * self.semi_axis(depth)).sum(axis=1)

    def semi_axis(self, depth: float | None = None) -> np.ndarray:
        """Horizontal semi-axis a coth(k depth) of the particles' paths at the surface, m."""
        return self.amplitude * (1.0 if depth is None else 1 / np.tanh(self.k * depth))

    @property
    def rms_slope(self) -> np.ndarray:
        """Root-mean-square slope sqrt(sum (k a)^2 / 2) of each realisation's linear surface."""
        return np.sqrt(np.sum((self.k * self.amplitude) ** 2, axis=1) / 2)


def jonswap(omega: np.ndarray, hs: float, tp: float, gamma_js: float = 3.3) -> np.ndarray:
    """One-sided JONSWAP density S(omega) (m^2 s); omega in rad/s (> 0, any shape), hs in m, tp in s."""
    omega = np.asarray(omega, dtype=np.float64)
    wp = 2 * math.pi / tp
    width = np.where(omega <= wp, 0.07, 0.09)
    peak = gamma_js ** np.exp(-((omega - wp) ** 2) / (2 * width**2 * wp**2))
    norm = 1 - 0.287 * math.log(gamma_js)
    return norm * 5 / 16 * hs**2 * wp**4 * omega**-5.0 * np.exp(-1.25 * (wp / omega) ** 4) * peak


def pierson_moskowitz(omega: np.ndarray, wind_speed_19_5: float, g: float = GRAVITY) -> np.ndarray:
    """S(omega) (m^2 s) of a fully developed sea under a wind (m/s) at 19.5 m (Pierson & Moskowitz 1964):

    S(w) = 8.1e-3 g^2 w^-5 exp(-0.74 (g / (U w))^4).
    """
    omega = np.asarray(omega, dtype=np.float64)
    return PM_ALPHA * g**2 * omega**-5.0 * np.exp(-PM_BETA * (g / (wind_speed_19_5 * omega)) ** 4)


def pierson_moskowitz_hs_tp(wind_speed_19_5: float, g: float = GRAVITY) -> tuple[float, float]:
    """Significant height 0.2092 U^2/g (m) and peak period (s; wp = 0.877 g/U) of the `pierson_moskowitz` sea."""
    hs = 2 * math.sqrt(PM_ALPHA / PM_BETA) * wind_speed_19_5**2 / g
    return hs, 2 * math.pi * wind_speed_19_5 / ((0.8 * PM_BETA) ** 0.25 * g)


def spectral_moment(
    density: Callable[[np.ndarray], np.ndarray], order: int, wp: float, band: tuple[float, float] = (0.2, 200.0)
) -> float:
    """Moment m_n = integral of w^n S(w) dw over `band`, given in multiples of the peak frequency wp (rad/s).

    The quadrature has Gauss-Legendre panels in log w, split at wp, where JONSWAP's width jumps; relative error about
    1e-12.
    """
    node, weight = np.polynomial.legendre.leggauss(8)
    low, high = np.log(band)
    ends = sorted({low, high, min(max(0.0, low), high)})
    total = 0.0
    for start, end in zip(ends[:-1], ends[1:], strict=True):
        edges = np.linspace(start, end, max(2, math.ceil((end - start) / QUADRATURE_PANEL) + 1))
        half = np.diff(edges)[:, None] / 2
        omega = wp * np.exp((edges[:-1] + edges[1:])[:, None] / 2 + half * node)
        total += float(np.sum(half * weight * omega ** (order + 1) * density(omega)))
    return total


def spreading(angle: np.ndarray, s: float) -> np.ndarray:
    """cos^2s density D (1/rad) at an angle from the mean direction (rad, in [-pi, pi])."""
    norm = math.exp(math.lgamma(s + 1) - math.lgamma(s + 0.5)) / (2 * math.sqrt(math.pi))
    return norm * np.abs(np.cos(np.asarray(angle) / 2)) ** (2 * s)


def wavenumber(omega: np.ndarray, depth: float | None = None, g: float = GRAVITY) -> np.ndarray:
    """Wavenumber k (rad/m) that solves omega^2 = g k tanh(k depth); depth in m, None for deep water.

    Newton's method starts at Guo's (2002) explicit estimate and converges to rounding in five steps.
    """
    omega = np.asarray(omega, dtype=np.float64)
    deep = omega**2 / g
    if depth is None:
        return deep
    x = omega * math.sqrt(depth / g)
    kh = x**2 * (1 - np.exp(-(x**2.4908))) ** (-0.4015)
    for _ in range(8):
        t = np.tanh(kh)
        kh = kh - (kh * t - deep * depth) / (t + kh * (1 - t**2))
    return kh / depth


def group_speed(k: np.ndarray, depth: float | None = None, g: float = GRAVITY) -> np.ndarray:
    """Group speed d omega / d k (m/s) at the wavenumber k (rad/m); depth in m, None for deep water."""
    k = np.asarray(k, dtype=np.float64)
    if depth is None:
        return np.sqrt(g / k) / 2
    kh = k * depth
    # 2 kh / sinh(2 kh), in a form that cannot overflow
    ratio = 4 * kh * np.exp(-2 * kh) / -np.expm1(-4 * kh)
    return np.sqrt(g * np.tanh(kh) / k) * (1 + ratio) / 2


def encounter_frequency(
    omega: np.ndarray, speed: np.ndarray, angle: np.ndarray, depth: float | None = None
) -> np.ndarray:
    """Frequency omega - k U cos(angle) (rad/s) at which a vessel of `speed` U (m/s) meets waves of frequency omega
    (rad/s).

    `angle` (rad) is between heading and wave direction: 0 in a following sea, pi in a head sea. The result is negative
    when the vessel overtakes the waves (Lewandowski 2004, The Dynamics of Marine Craft, ch. 5).
    """
    return np.asarray(omega) - wavenumber(omega, depth) * np.asarray(speed) * np.cos(angle)
