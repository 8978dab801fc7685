"""The tail of wave heights and crests in 100,000 waves, with fixed and with random amplitudes, against their laws.

Zero up-crossing waves of records at a point. In a Gaussian sea crests have Rayleigh's law exp(-8 (c / hs)^2), and
heights from crest to trough that of Naess (1985), exp(-h^2 / (4 m0 (1 - rho))), rho the least of the autocorrelation.
With rho = -1, a narrow band, it is Rayleigh's exp(-2 (H / hs)^2), by which one wave in 10^4 reaches 2.15 hs. Crests of
a real sea are higher by the second order: Forristall (2000, J. Physical Oceanography 30, 1931), here for waves from all
sides in deep water.
"""

import numpy as np
import pytest

from taichi_sim.config import SeaConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.surroundings.sea import Sea

pytestmark = [pytest.mark.usefixtures("f64"), pytest.mark.slow]
HS, TP = 2.0, 9.0
SEAS, DURATION, INTERVAL = 512, 1600.0, 0.45  # s
LAG = np.arange(0.0, 8.0, 0.01)  # s


def components(**more):
    return Sea.from_config(SeaConfig(hs=HS, tp=TP, realisations=SEAS, **more), seed=3)


def waves(records):
    """Heights and crests over hs of the waves between zero up-crossings, [wave] each."""
    records = records - records.mean()
    heights, crests = [], []
    for x in records:
        starts = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0)) + 1
        whole = x[: starts[-1]]
        crest, trough = np.maximum.reduceat(whole, starts[:-1]), np.minimum.reduceat(whole, starts[:-1])
        heights.append(crest - trough)
        crests.append(crest)
    return np.concatenate(heights) / HS, np.concatenate(crests) / HS


def linear(sea):
    """Records of the sum of cosines [sea, time]."""
    c, time = sea.components, np.arange(0, DURATION, INTERVAL)
    return np.stack([a @ np.cos(p[:, None] - np.outer(w, time))
                     for a, p, w in zip(c.amplitude, c.phase, c.omega, strict=True)])  # fmt: skip


def one_in(values, n):
    """What one in `n` values exceeds."""
    return np.quantile(values, 1 - 1 / n)


def test_random_amplitudes_have_the_tail_and_few_fixed_ones_have_not():
    sea = components(components=32, amplitudes="random")
    heights, crests = waves(linear(sea))
    assert heights.size > 100_000
    energy, omega = sea.components.amplitude.ravel() ** 2, sea.components.omega.ravel()
    rho = (np.cos(np.outer(LAG, omega)) @ energy).min() / energy.sum()
    assert -0.8 < rho < -0.6
    for n, error in ((100, 0.02), (1000, 0.03), (10_000, 0.06)):
        assert one_in(crests, n) == pytest.approx(np.sqrt(np.log(n) / 8), rel=error)
        assert one_in(heights, n) == pytest.approx(np.sqrt(np.log(n) * (1 - rho)) / 2, rel=error)
    fixed, _ = waves(linear(components(components=16)))
    assert one_in(fixed, 10_000) < 1.7 < 1.9 < one_in(heights, 10_000)  # of Rayleigh's 2.15, of Naess's 2.0


def test_crests_of_the_surface_are_between_rayleighs_and_forristalls():
    """A Gerstner surface has sharp crests, but hardly higher ones: it lacks a part of the second order."""
    sea = components(components=32, amplitudes="random")
    time = np.arange(0, DURATION, INTERVAL)
    records = sea.elevation(0.0, 0.0, time, sea=np.arange(SEAS)[:, None]).numpy()
    _, crests = waves(records)
    c = sea.components
    period = 2 * np.pi * (c.amplitude**2).sum() / (c.amplitude**2 * c.omega).sum()  # Tm01
    steepness = 2 * np.pi * HS / (GRAVITY * period**2)
    alpha, beta = 0.3536 + 0.2568 * steepness, 2 - 1.7912 * steepness
    for n in (100, 1000):
        rayleigh, forristall = np.sqrt(np.log(n) / 8), alpha * np.log(n) ** (1 / beta)
        assert 0.98 * rayleigh < one_in(crests, n) < forristall
        assert one_in(crests, n) == pytest.approx(forristall, rel=0.06)
