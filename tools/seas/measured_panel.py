"""The panel of draw_sea.py for measured seas: directions by frequency, as measured and as realised."""

import numpy as np
from matplotlib.axes import Axes

from taichi_sim.plotting.style import dress
from taichi_sim.sea.measured import WaveRecord, band_moments
from taichi_sim.sea.spectrum import Components

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
