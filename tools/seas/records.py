"""Records of a sea at one point, as a wave staff measures them, with spectrum and wave heights."""

import math
from typing import NamedTuple

import numpy as np

from taichi_sim.sea import Sea
from taichi_sim.sea.measured import MeasuredSystem
from taichi_sim.sea.sampling import System
from taichi_sim.sea.spectrum import spectral_moment

SEAS = 64  # largest number of realisations
RECORD, SAMPLES_PER_PERIOD = 1200.0, 20  # s of each record; samples per peak period
SEGMENT = 24  # peak periods of a Welch segment


class WaveStatistics(NamedTuple):
    """Spectrum and wave heights from records at a point."""

    omega: np.ndarray  # rad/s
    density: np.ndarray  # m^2 s
    heights: np.ndarray  # m, between zero up-crossings, all records
    hs: float  # 4 standard deviations, m


def measure(sea: Sea, tp: float) -> WaveStatistics:
    """Measure the elevation at the origin in up to SEAS realisations."""
    interval = tp / SAMPLES_PER_PERIOD
    time = np.arange(0, max(RECORD, 4 * SEGMENT * tp), interval)
    index = np.arange(min(SEAS, sea.num_seas))[:, None]
    record = sea.elevation(0.0, 0.0, time, sea=index).double().cpu().numpy()
    record -= record.mean(axis=1, keepdims=True)
    omega, density = welch(record, interval, SEGMENT * SAMPLES_PER_PERIOD)
    heights = np.concatenate([crossing_heights(row) for row in record])
    return WaveStatistics(omega, density, heights, 4 * float(np.sqrt((record**2).mean())))


def welch(record: np.ndarray, interval: float, length: int) -> tuple[np.ndarray, np.ndarray]:
    """One-sided density (m^2 s over rad/s) of records [record, sample]: Hann windows of `length`, half overlapping."""
    windows = np.lib.stride_tricks.sliding_window_view(record, length, axis=1)[:, :: length // 2]
    hann = np.hanning(length)
    power = (np.abs(np.fft.rfft(windows * hann, axis=-1)) ** 2).mean(axis=(0, 1))
    omega = 2 * np.pi * np.fft.rfftfreq(length, interval)
    return omega, power * interval / (np.pi * (hann**2).sum())


def crossing_heights(elevation: np.ndarray) -> np.ndarray:
    """Crest to trough height of each wave between two zero up-crossings, m."""
    starts = np.flatnonzero((elevation[:-1] < 0) & (elevation[1:] >= 0)) + 1
    if len(starts) < 2:
        return np.zeros(0)
    whole = elevation[: starts[-1]]
    return np.maximum.reduceat(whole, starts[:-1]) - np.minimum.reduceat(whole, starts[:-1])


def target_density(system: System, omega: np.ndarray) -> np.ndarray:
    """Target density of a wave system, scaled to its exact height, m^2 s."""
    if isinstance(system, MeasuredSystem):
        return system.density(omega)
    m0 = spectral_moment(system.density, 0, 2 * math.pi / system.tp)
    return system.density(omega) * system.hs**2 / 16 / m0
