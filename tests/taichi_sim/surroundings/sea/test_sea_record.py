"""What a wave staff would measure: heights, variance and repetition of long records at a point."""

import math
from functools import partial

import numpy as np
import pytest

from taichi_sim.config import SeaConfig
from taichi_sim.surroundings.sea import Sea, sea_size
from taichi_sim.surroundings.sea.spectrum import jonswap, spectral_moment

pytestmark = pytest.mark.usefixtures("f64")
DURATION, INTERVAL = 3600.0, 0.25  # s


@pytest.fixture(scope="module")
def record(f64):
    """Elevation at the origin of 8 realisations of the default sea, [sea, time]."""
    sea = Sea.from_config(SeaConfig(realisations=8), seed=11)
    time = np.arange(0, DURATION, INTERVAL)
    return sea.elevation(0.0, 0.0, time, sea=np.arange(8)[:, None]).numpy()


def test_height_of_records_is_that_of_the_sea(record):
    """Within 4 standard errors, sqrt(2 pi int S^2 / T) / m0, of a record T long; the mean height within 1 %."""
    hs, tp = sea_size(SeaConfig())
    squared = spectral_moment(lambda w: jonswap(w, hs, tp) ** 2, 0, 2 * math.pi / tp)
    error = math.sqrt(2 * math.pi * squared / DURATION) / (hs**2 / 16)
    measured = 4 * record.std(axis=1)
    assert np.abs(measured / hs - 1).max() < 4 * error / 2  # hs goes as the square root of the variance
    assert measured.mean() == pytest.approx(hs, rel=0.01)


def test_records_do_not_repeat_within_600_s(record):
    """Autocorrelation of the measured elevation for lags from two periods to 600 s."""
    x = record - record.mean(axis=1, keepdims=True)
    padded = np.fft.rfft(x, 2 * x.shape[1], axis=1)
    covariance = np.fft.irfft(np.abs(padded) ** 2, axis=1)[:, : x.shape[1]]
    covariance /= np.arange(x.shape[1], 0, -1)
    lags = slice(round(8 / INTERVAL), round(600 / INTERVAL))
    assert (covariance[:, lags] / covariance[:, :1]).max() < 0.9


def test_mean_period_of_records_is_that_of_the_band(record):
    """Zero up-crossings: T_z = 2 pi sqrt(m0 / m2) over the sampled band."""
    hs, tp = sea_size(SeaConfig())
    wp = 2 * math.pi / tp
    m0, m2 = (spectral_moment(partial(jonswap, hs=hs, tp=tp), n, wp, (0.6, 3.0)) for n in (0, 2))
    x = record - record.mean(axis=1, keepdims=True)
    crossings = ((x[:, :-1] < 0) & (x[:, 1:] >= 0)).sum()
    assert 8 * DURATION / crossings == pytest.approx(2 * math.pi * math.sqrt(m0 / m2), rel=0.03)
