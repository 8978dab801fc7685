"""Spectra as every reader gives them, and the gate that they pass: times, frequencies, densities, moments, bands.

Readers: ndbc.py (NDBC's text), netcdf.py (ERA5, WAVEWATCH III, SWAN, wavespectra, NDBC, CDIP), spotter.py (Sofar's
Spotter), and the library wavespectra for texts of SWAN and WAVEWATCH III. Wave models give energy by frequency and
direction. Their values are used as they are, constant over a cell; only the directions are turned to where waves travel
to, clockwise from north. Buoys give moments, from which the distribution of maximum entropy is made (wave_record.py).

Where a file states its bands, they are used: m_n = sum S (high^(n+1) - low^(n+1)) / (n + 1).
"""

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.config.columns import MISSING, TURN, without_marks
from taichi_sim.errors import refuse
from taichi_sim.surroundings.sea.measured.wave_record import band_edges

FEWEST_ANGLES = 3  # directions of a directional spectrum, at least
EVEN = 0.1  # relative tolerance for the spacing of directions, which text rounds
MARKS = 2  # marks of missing values in a file, at most; more large values are values
MOST = 1e4  # m^2/Hz; no sea is so dense (20 m and 20 s have 3e3), larger numbers mark missing values
ROUNDED = 0.05  # tolerance of a moment above 1
TILES = 0.2  # of a band's width, within which rounded bands may overlap or leave gaps


class Gridded(NamedTuple):
    """Content of a file: a grid of energy by direction, or moments of the direction.

    Attributes:
        times: [t], UTC.
        places: names of the places, [p].
        frequency: [f], Hz.
        density: [t, p, f], m^2/Hz; NaN where a value is missing.
        angles: directions of travel, [d], rad, rising and evenly spaced.
        grid: energy by direction, [t, p, f, d], m^2/Hz/rad.
        c1, c2: moments of the direction of travel, [t, p, f], complex.
        bands: edges of the frequency bands, where the file states them, [f, 2], Hz.
    """

    times: np.ndarray
    places: list[str]
    frequency: np.ndarray
    density: np.ndarray
    angles: np.ndarray | None = None
    grid: np.ndarray | None = None
    c1: np.ndarray | None = None
    c2: np.ndarray | None = None
    bands: np.ndarray | None = None


def of_density(times: np.ndarray, places: list[str], frequency: np.ndarray, density: np.ndarray) -> Gridded:
    """Spectra of densities [t, p, f] (m^2/Hz) without directions, in the order of their frequencies."""
    rising = np.argsort(frequency, kind="stable")
    return Gridded(times, places, frequency[rising], density[..., rising])


def of_energy(
    times: np.ndarray,
    places: list[str],
    frequency: np.ndarray,
    toward: np.ndarray,
    energy: np.ndarray,
    bands: np.ndarray | None = None,
) -> Gridded:
    """Spectra of energies [t, p, f, d] (m^2/Hz/rad) by directions of travel [d] (deg); both are put in order.

    Negative energies that are larger than all others are marks of missing ones; others are lobes of a truncated Fourier
    series, and become 0.
    """
    rising = np.argsort(frequency, kind="stable")
    frequency, energy = frequency[rising], energy[:, :, rising]
    bands = None if bands is None else bands[rising]
    angles = np.mod(toward, 360.0)
    order = np.argsort(angles, kind="stable")
    angles, energy = np.deg2rad(angles[order]), energy[..., order]
    around = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    if not np.allclose(around, 2 * np.pi / angles.size, rtol=EVEN, atol=0):
        least, most = np.rad2deg([around.min(), around.max()])
        raise ConfigError(f"directions are not evenly spaced over the circle, each once: they are {least:.4g} to "
                          f"{most:.4g} degrees apart")  # fmt: skip
    with np.errstate(invalid="ignore"):
        most = np.nanmax(np.where(np.isfinite(energy), energy, 0.0), axis=(2, 3), keepdims=True, initial=0.0)
        energy = np.where(energy < -most, np.nan, np.where(energy < 0, 0.0, energy))  # marks; lobes of Fourier series
    energy = _without_marks(energy)
    density = energy.sum(axis=3) * (2 * np.pi / angles.size)
    return Gridded(times, places, frequency, density, angles=angles, grid=energy, bands=bands)


def within_a_turn(name: str, degrees: np.ndarray) -> None:
    """Refuse directions of the column `name` that are beyond a turn."""
    if (np.abs(degrees) > TURN).any():
        raise ConfigError(f"{name} goes to {np.nanmax(np.abs(degrees)):g} degrees: it must be up to {TURN:g}")


def agreed(c1: np.ndarray, stated: np.ndarray, density: np.ndarray) -> None:
    """Compare mean directions of travel of moments c1 [..] with those that a file states (deg), weighted by density."""
    known = np.isfinite(c1) & np.isfinite(stated) & (density > 0) & (density < MOST)
    apart = density[known] * np.abs(c1[known]) * np.exp(1j * (np.angle(c1[known]) - np.deg2rad(stated[known])))
    if abs(apart.sum()) > 0.5 * np.abs(apart).sum() and apart.sum().real < abs(apart.sum()) * np.cos(AGREE):
        angle = np.degrees(abs(np.angle(apart.sum())))
        raise ConfigError(f"moments and mean directions are {angle:.0f} degrees apart: one has another convention")


AGREE = np.deg2rad(20.0)  # within which moments and stated directions agree


def checked(path: Path, data: Gridded) -> tuple[Gridded, np.ndarray]:
    """Spectra in the order of their times, NaN for marks of missing values, and the edges of their bands [f + 1]."""
    untimed = np.isnat(data.times)
    refuse(
        ConfigError,
        (not data.times.size or not data.density.size, f"{path}: it has no record"),
        (untimed.any(), f"{path}: record {int(untimed.argmax() if untimed.size else 0) + 1} has no time"),
    )
    order = np.argsort(data.times, kind="stable")
    times = data.times[order]
    again = np.flatnonzero(times[1:] == times[:-1]) + 1
    pairs = ((k, *data.density[order[[k - 1, k]]]) for k in again)
    twice = next((str(times[k]).replace("T", " ") for k, one, two in pairs if not np.array_equal(one, two, True)), "")
    order, times = np.delete(order, again), np.delete(times, again)
    rises = np.diff(data.frequency, prepend=0.0) > 0
    density = data.density[order].astype(float)
    beyond = density[np.isfinite(density) & (density >= MOST)]
    most = beyond.max(initial=0.0)
    refuse(
        ConfigError,
        (twice, f"{path}: the record of {twice} is there twice, and differs"),
        (rises.size < 2 or not rises.all() or not np.isfinite(data.frequency).all(),
         f"{path}: its frequencies must be two or more, and rise from above 0: {data.frequency[:9]} Hz"),
        (np.unique(beyond).size > MARKS,
         f"{path}: densities go to {most:.3g} m^2/Hz, and no sea has {MOST:g}: are they in cm^2/Hz? Divide by 10,000"),
    )  # fmt: skip
    with np.errstate(invalid="ignore"):
        density[~((density >= 0) & (density < MOST))] = np.nan
    density = _without_marks(density)
    c1, c2, grid = (None if x is None else x[order] for x in (data.c1, data.c2, data.grid))
    for name, moments in (("first", c1), ("second", c2)):
        if moments is not None and (large := np.abs(np.nan_to_num(moments)) > 1 + ROUNDED).any():
            worst = float(np.abs(moments[large]).max())
            raise ConfigError(f"{path}: a {name} moment of the directions is {worst:g}: it must be from 0 to 1")
    data = data._replace(times=times, density=density, c1=c1, c2=c2, grid=grid)
    return (data, band_edges(data.frequency)) if data.bands is None else _tiled(path, data, data.bands)


def _without_marks(values: np.ndarray) -> np.ndarray:
    """Values [.., n] with NaN for marks of missing ones above TURN in their rows (columns.missing_mark)."""
    rows = values.reshape(-1, values.shape[-1])
    for k in np.flatnonzero(np.isin(np.abs(rows).astype(np.float32), MISSING.astype(np.float32)).any(axis=1)):
        rows[k] = without_marks(rows[k], least=TURN)
    return rows.reshape(values.shape)


def _tiled(path: Path, data: Gridded, bands: np.ndarray) -> tuple[Gridded, np.ndarray]:
    """Spectra with bands side by side, and their edges: bands without energy fill gaps between those stated."""
    low, high = bands.T
    width = high - low
    if not (np.isfinite(bands).all() and (width > 0).all() and (low > 0).all()):
        raise ConfigError(f"{path}: widths of its bands must be above 0, and bands above 0 Hz")
    near = TILES * np.minimum(width[1:], width[:-1])
    between = low[1:] - high[:-1]
    if (between < -near).any():
        k = int((between < -near).argmax())
        warnings.warn(f"{path}: its bands at {data.frequency[k]:.4g} and {data.frequency[k + 1]:.4g} Hz overlap by the "
                      "widths that it states: widths are derived from the frequencies", stacklevel=2)  # fmt: skip
        return data, band_edges(data.frequency)
    gaps = between > near
    inner = [[a, b] if gap else [(a + b) / 2] for a, b, gap in zip(high[:-1], low[1:], gaps, strict=True)]
    edges = np.concatenate(([low[0]], *inner, [high[-1]]))
    after = np.flatnonzero(gaps) + 1

    def wider(values: np.ndarray | None, fill: float) -> np.ndarray | None:
        return None if values is None else np.insert(values, after, fill, axis=2)

    density = np.insert(data.density, after, 0.0, axis=2)
    frequency = (edges[1:] + edges[:-1]) / 2
    return data._replace(frequency=frequency, density=density, grid=wider(data.grid, 0.0), c1=wider(data.c1, np.nan),
                         c2=wider(data.c2, np.nan), bands=None), edges  # fmt: skip
