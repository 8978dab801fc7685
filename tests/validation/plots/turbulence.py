"""Turbulence that the kernels make, against MIL-F-8785C: densities over frequency, variances over height and wind."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Folder
from tests.validation.dryden import KNOT
from tests.validation.plots.dryden_records import records
from tests.validation.plots.style import OTHER, OURS, THIRD, legend, points
from tests.validation.tables import Table, TableError, read_csv
from tools.draw_sea import welch

FOOT = 0.3048  # m
DT, TIME, COUNT = 0.01, 600.0, 32  # s, s, 1: of the records
WINDOW = 16384  # samples, of Welch's method
PER_DECADE = 8  # points of the measured density
SHOWN = 50.0  # rad/s; beyond, samples at DT fold what is above their Nyquist frequency
ERRORS = 2.0  # standard errors, of a bar
ASIDE = (-3.0, 3.0, 0.0)  # points, that u, v and w are moved by, so as to be told apart
TICKS = (3, 10, 30, 100, 300)  # m
CLOSED = "#B6BFC8"
HEIGHTS = (3.048, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0, 304.8)  # m
WINDS_KT = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0, 45.0)
PARTS = {"u": ("along the flight", OURS), "v": ("to the right", THIRD), "w": ("down", OTHER)}
PSD = "dryden_psd_one_sided_rad_s*.csv"


def scales(h, W20) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (m) and intensities (m/s) [3, ...] of u, v, w at h (m) and W20 (m/s), in feet as MIL-F-8785C has it."""
    feet, W20 = np.broadcast_arrays(np.asarray(h) / FOOT, W20)
    y = 0.177 + 0.000823 * feet
    length, sigma = feet / y**1.2 * FOOT, 0.1 * W20
    return np.stack((length, length, feet * FOOT)), np.stack((sigma / y**0.4, sigma / y**0.4, sigma))


def density(row: int, omega: np.ndarray, V: float, h: float, W20: float) -> np.ndarray:
    """One-sided density (m^2/s) of u, v or w (0, 1, 2) at omega (rad/s): MIL-F-8785C's Dryden form at omega / V."""
    L, sigma = (x[row] for x in scales(h, W20))
    s = (L / V * omega) ** 2
    return sigma**2 * L / (np.pi * V) * (2 / (1 + s) if row == 0 else (1 + 3 * s) / (1 + s) ** 2)


def spectra(folder: Folder) -> Figure:
    """Densities of u, v and w, at the table's first airspeed, height and wind."""
    table = _first_flight(folder)
    V, h, knots = (table[name][0] for name in ("V", "h_m", "W20_kt"))
    gusts = records(V, h, knots * KNOT, DT, TIME, COUNT, seed=0)
    figure = new_figure(12.5, 4.2, f"Turbulence met at {V:g} m/s, {h:g} m high, wind {knots:g} kt at 20 ft")
    first = None
    for row, (name, (way, colour)) in enumerate(PARTS.items()):
        first = axes = figure.add_subplot(1, len(PARTS), row + 1, sharex=first, sharey=first)
        omega, measured = _thinned(*welch(gusts[:, row], DT, WINDOW))
        fine = np.geomspace(table["omega"].min() / 1.5, SHOWN, 300)
        axes.loglog(fine, density(row, fine, V, h, knots * KNOT), color=CLOSED, lw=4, label="MIL-F-8785C")
        axes.loglog(omega, measured, ".", color=colour, ms=7, label="this package's records", zorder=5)
        points(axes, table["omega"], table[f"Phi_{name}"], INK, "reference table")
        dress(axes, f"{name}, {way}", "frequency (rad/s)", "density (m²/s² per rad/s)" if row == 0 else "")
        axes.set_xlim(fine[0], fine[-1])
        legend(axes, loc="lower left")
    return figure


def variances(folder: Folder) -> Figure:
    """Variance of u, v, w over height in the table's first wind, and over wind at its first height."""
    table = _first_flight(folder)
    V, h, knots = (table[name][0] for name in ("V", "h_m", "W20_kt"))
    figure = new_figure(12.0, 4.4, f"Turbulence: variance of {COUNT} records of {TIME:g} s at {V:g} m/s")
    over_height, over_wind = figure.subplots(1, 2)
    heights, winds = np.geomspace(HEIGHTS[0], HEIGHTS[-1], 200), np.linspace(0, 1.05 * WINDS_KT[-1], 100)
    sampled = [records(V, x, knots * KNOT, DT, TIME, COUNT, seed) for seed, x in enumerate(HEIGHTS)]
    _variance(over_height, HEIGHTS, sampled, heights, scales(heights, knots * KNOT)[1] ** 2)
    sampled = [records(V, h, x * KNOT, DT, TIME, COUNT, seed) for seed, x in enumerate(WINDS_KT, len(HEIGHTS))]
    _variance(over_wind, WINDS_KT, sampled, winds, scales(h, winds * KNOT)[1] ** 2)
    dress(over_height, f"Wind {knots:g} kt at 20 ft", "height (m)", "variance (m²/s²)")
    dress(over_wind, f"Height {h:g} m", "wind at 20 ft (kt)", "variance (m²/s²)")
    over_height.set(xscale="log", ylim=(0, None))
    over_height.set_xticks(TICKS, [f"{x:g}" for x in TICKS])
    over_height.minorticks_off()
    over_wind.set(xlim=(0, winds[-1]), ylim=(0, None))
    legend(over_height, loc="upper right")
    return figure


def _first_flight(folder: Folder) -> Table:
    """The rows of the table of densities at its first airspeed, height and wind."""
    found = sorted(folder.root.rglob(PSD))
    if not found:
        raise TableError(f"no {PSD}")
    table = read_csv(found[0])
    return table.where(np.all([table[name] == table[name][0] for name in ("V", "h_m", "W20_kt")], axis=0))


def _thinned(omega: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means over parts of a decade; without the first two, which the windows have smeared."""
    omega, measured = omega[2:], measured[2:]
    part = np.floor(PER_DECADE * np.log10(omega)).astype(int)
    use = [part == k for k in np.unique(part[omega < SHOWN])]
    return np.array([np.exp(np.log(omega[u]).mean()) for u in use]), np.array([measured[u].mean() for u in use])


def _variance(axes: Axes, x, gusts: list[np.ndarray], fine: np.ndarray, closed: np.ndarray) -> None:
    """Mean square of each part with its standard error from record to record, over sigma^2 (`closed` [3, fine])."""
    square = np.array([(g**2).mean(axis=-1) for g in gusts])  # [x, record, part]
    mean, error = square.mean(axis=1), square.std(axis=1, ddof=1) / np.sqrt(square.shape[1])
    for row, (name, (_, colour)) in enumerate(PARTS.items()):
        if name != "v":  # whose intensity is that of u
            label = "MIL-F-8785C: σ² of u and v" if name == "u" else "MIL-F-8785C: σ² of w"
            axes.plot(fine, closed[row], color=CLOSED, lw=2.5, ls="-" if name == "u" else "--", label=label)
        aside = ScaledTranslation(ASIDE[row] / 72, 0, axes.get_figure().dpi_scale_trans)
        axes.errorbar(x, mean[:, row], ERRORS * error[:, row], color=colour, fmt="o", ms=4.5, mfc="white", capsize=3,
                      lw=1.3, zorder=5, transform=axes.transData + aside,
                      label=f"{name}, with {ERRORS:g} standard errors")  # fmt: skip
