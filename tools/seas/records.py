"""Records of a sea at one point, as a wave staff measures them, with spectrum and wave heights.

Of measured seas also the panel of draw_sea.py that shows directions by frequency, as measured and as realised.
"""

import math
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from taichi_sim.plotting.style import dress
from taichi_sim.sea import Sea
from taichi_sim.sea.measured import MeasuredSystem, WaveRecord, band_moments
from taichi_sim.sea.sampling import System
from taichi_sim.sea.spectrum import Components, spectral_moment

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


TWO_PI = 2 * np.pi
LEAST = 0.002  # least energy of a band whose directions are drawn, in energies of the densest band
MEASURED, REALISED = "#D55E00", "#0072B2"


def directions_by_frequency(axes: Axes, components: Components, record: WaveRecord) -> None:
    """Draw mean direction of travel and circular deviation to both sides of it over angular frequency."""
    middle = np.pi * (record.edges[1:] + record.edges[:-1])
    drawn = record.energy > LEAST * record.energy.max()
    centre = np.rad2deg(record.direction)

    def degrees(moments: np.ndarray) -> np.ndarray:
        """Angles within 180 degrees of the overall mean."""
        return centre + (np.rad2deg(np.angle(moments)) - centre + 180.0) % 360.0 - 180.0

    mean, width = degrees(record.c1), deviation(record.c1)
    omega = np.where(drawn, middle, np.nan)
    shade = {"color": MEASURED, "alpha": 0.18, "lw": 0, "step": "mid", "label": "its spread"}
    axes.fill_between(omega, mean - width, mean + width, **shade)
    axes.plot(omega, mean, color=MEASURED, lw=2, drawstyle="steps-mid", label="measured")
    whole = band_moments(components, record).sum(axis=0)
    energy = band_energy(components, record)
    there = energy > 0
    moments = np.divide(whole, energy, out=np.zeros_like(whole), where=there)
    bars = {"fmt": "o", "color": REALISED, "ms": 4, "elinewidth": 1.2, "label": "components, and their spread"}
    axes.errorbar(middle[there], degrees(moments)[there], deviation(moments)[there], **bars)
    dress(axes, "Direction of travel by frequency", "angular frequency (rad/s)", "degrees clockwise from north")
    axes.set_xlim(0.9 * TWO_PI * record.edges[:-1][drawn][0], 1.05 * TWO_PI * record.edges[1:][drawn][-1])
    axes.set_ylim(centre - 185, centre + 185)
    ticks = np.arange(np.ceil((centre - 180) / 45) * 45, centre + 181, 45)
    axes.set_yticks(ticks, [f"{tick % 360:.0f}" for tick in ticks])
    axes.legend(frameon=False, fontsize=9, loc="upper right", ncols=2)


def deviation(moments: np.ndarray) -> np.ndarray:
    """Circular deviation sqrt(2 (1 - r1)), degrees, of moments c1."""
    return np.rad2deg(np.sqrt(2 * (1 - np.minimum(np.abs(moments), 1.0))))


def band_energy(components: Components, record: WaveRecord) -> np.ndarray:
    """Sum of a^2 / 2 of all realisations in each band [f], m^2."""
    alike = Components(components.amplitude, components.k, components.omega, 0 * components.direction, components.phase)
    return band_moments(alike, record).sum(axis=0).real
