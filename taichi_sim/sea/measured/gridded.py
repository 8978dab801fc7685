"""Spectra that the library wavespectra reads: ERA5, WAVEWATCH III, SWAN, NDBC's netCDF, Sofar's Spotter.

The content of a file identifies its format: the variables of a netCDF, the first line of a text. Wave models give
energy by frequency and direction. Their values are used as they are, constant over a cell; only the directions are
turned from "comes from" to "travels to". Buoys give moments, from which the distribution of maximum entropy is made
(record.py). wavespectra keeps a Spotter's a1, b1, a2 and b2 (direction of travel, counter-clockwise from east) if it
is asked for no directions. From NDBC's netCDF it would make a truncated Fourier series, which is negative for some
directions, and no record where one value is missing. This module therefore reads NDBC's variables itself.
"""

import warnings
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.config.base import MissingExtraError

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

NETCDF = (".nc", ".nc4", ".cdf", ".netcdf")
NDBC = "ndbc"  # read by this module, not by the library
NDBC_NAMES = {"waveFrequency": "frequency", "waveTime": "time", "waveEnergyDensity": "spectral_wave_density"}
READERS = {  # variable of a netCDF -> reader of wavespectra
    "d2fd": "read_era5", "density": "read_ncswan", "spectral_wave_density": NDBC, "waveEnergyDensity": NDBC,
}  # fmt: skip
KNOWN = (
    "NDBC's text, and by wavespectra netCDF of ERA5, WAVEWATCH III, SWAN and NDBC, text of SWAN and WAVEWATCH III, "
    "Spotter's JSON and CSV"
)
FEWEST_ANGLES = 3  # directions of a directional spectrum, at least
EVEN = 0.1  # relative tolerance for the spacing of directions, which text rounds


class Gridded(NamedTuple):
    """Content of a file: a grid of energy by direction, or moments of the direction.

    Attributes:
        times: [t].
        places: names of the places, [p].
        frequency: [f], Hz.
        density: [t, p, f], m^2/Hz.
        angles: directions of travel, [d], rad, rising and evenly spaced.
        grid: energy by direction, [t, p, f, d], m^2/Hz/rad.
        c1, c2: moments of the direction of travel, [t, p, f], complex.
    """

    times: np.ndarray
    places: list[str]
    frequency: np.ndarray
    density: np.ndarray
    angles: np.ndarray | None = None
    grid: np.ndarray | None = None
    c1: np.ndarray | None = None
    c2: np.ndarray | None = None


def read_gridded(path: Path) -> Gridded:
    """Read the spectra of a file.

    Raises:
        ConfigError: for a file that no reader can read.
        MissingExtraError: without wavespectra.
    """
    try:
        import wavespectra
        import xarray
    except ImportError as error:
        raise MissingExtraError("wavespectra", "waves") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            name, options = _reader(path, xarray)
            if name == NDBC:
                with xarray.open_dataset(path) as data:
                    return _of_ndbc(path, data.load())
            data = getattr(wavespectra, name)(str(path), **options).load()
            return _of_moments(path, data) if name == "read_spotter" else _of_directions(path, data)
    except ConfigError:
        raise
    except Exception as error:  # each reader fails in its own way
        raise ConfigError(f"{path}: wavespectra cannot read it ({type(error).__name__}: {error})") from None


def _reader(path: Path, xarray: ModuleType) -> tuple[str, dict[str, str | None]]:
    """Name of the library's reader for a file, and its options."""
    if path.suffix.lower() in NETCDF:
        with xarray.open_dataset(path) as data:
            names = {*data.variables}
        reader = next((reader for variable, reader in READERS.items() if variable in names), None)
        if reader is None and "efth" in names:
            reader = "read_wavespectra" if "freq" in names else "read_ww3"
        if reader is None:
            raise ConfigError(f"{path}: no known spectrum in it; its variables are {', '.join(sorted(names))}")
        return reader, {}
    try:
        begin = path.read_text(encoding="utf-8", errors="replace")[:4000]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    if begin.startswith("SWAN"):
        return "read_swan", {}
    if begin.lstrip().startswith("'WAVEWATCH III SPECTRA'"):
        return "read_ww3_station", {}
    if '"frequencyData"' in begin or '"spotterId"' in begin:
        return "read_spotter", {"filetype": "json", "dd": None}
    if "a1_0" in begin and "Epoch Time" in begin:
        return "read_spotter", {"filetype": "csv", "dd": None}
    raise ConfigError(f"{path}: not known as a spectrum; known formats are {KNOWN}")


def _of_moments(path: Path, data: "Dataset") -> Gridded:
    """Convert a Spotter's moments from east, counter-clockwise, to north, clockwise: exp(i (pi/2 - x))."""

    def values(name: str) -> np.ndarray:
        return np.asarray(data[name].transpose("time", "freq"), dtype=float)[:, None, :]

    c1 = 1j * (values("a1") - 1j * values("b1"))
    c2 = -(values("a2") - 1j * values("b2"))
    return Gridded(_times(data), [path.stem], np.asarray(data.freq, dtype=float), values("efth"), c1=c1, c2=c2)


def _of_ndbc(path: Path, data: "Dataset") -> Gridded:
    """Read NDBC's netCDF. Its alpha1, alpha2 (degrees, comes from), r1 and r2 are those of NDBC's text (ndbc.py)."""
    data = data.rename({old: new for old, new in NDBC_NAMES.items() if old in data.variables})

    def values(name: str) -> np.ndarray:
        if name not in data:
            return np.full(density.shape, np.nan)
        found = np.asarray(data[name].transpose("time", ..., "frequency"), dtype=float)
        return found.reshape(found.shape[0], -1, found.shape[-1])

    density = values("spectral_wave_density")
    first, second = (np.deg2rad(values(name) + 180.0) for name in ("mean_wave_dir", "principal_wave_dir"))
    c1, c2 = values("wave_spectrum_r1") * np.exp(1j * first), values("wave_spectrum_r2") * np.exp(2j * second)
    places = [path.stem] if density.shape[1] == 1 else [f"place {k}" for k in range(density.shape[1])]
    return Gridded(_times(data), places, np.asarray(data["frequency"], dtype=float), density, c1=c1, c2=c2)


def _of_directions(path: Path, data: "Dataset") -> Gridded:
    """Read a wave model's energy by frequency and direction (m^2/Hz/degree); one direction means none at all."""
    energy = data["efth"]
    for name in ("time", "dir"):
        energy = energy if name in energy.dims else energy.expand_dims(name)
    where = [name for name in energy.dims if name not in ("time", "freq", "dir")]
    energy = energy.stack(place=where, create_index=False) if where else energy.expand_dims("place")
    places = _places(data, energy) if where else [path.stem]
    frequency = np.asarray(energy["freq"], dtype=float)
    rising = np.argsort(frequency)
    values = np.asarray(energy.transpose("time", "place", "freq", "dir"), dtype=float)[:, :, rising]
    frequency = frequency[rising]
    if values.shape[3] < FEWEST_ANGLES:
        return Gridded(_times(data), places, frequency, values[..., 0])
    angles = np.mod(np.asarray(energy["dir"], dtype=float) + 180.0, 360.0)
    order = np.argsort(angles)
    angles, values = np.deg2rad(angles[order]), np.maximum(np.rad2deg(values[..., order]), 0.0)
    if not np.allclose(np.diff(angles), 2 * np.pi / angles.size, rtol=EVEN):
        raise ConfigError(f"{path}: directions are not evenly spaced over the circle")
    density = values.sum(axis=3) * (2 * np.pi / angles.size)
    return Gridded(_times(data), places, frequency, density, angles=angles, grid=values)


def _times(data: "Dataset") -> np.ndarray:
    return np.atleast_1d(np.asarray(data["time"], dtype="datetime64[m]"))


def _places(data: "Dataset", energy: "DataArray") -> list[str]:
    """Names of the places by their coordinates: 30.25 N 75.00 W."""
    count = energy.sizes["place"]
    try:
        given = [np.asarray(energy[name] if name in energy.coords else data[name]) for name in ("lat", "lon")]
        lat, lon = (np.broadcast_to(x.astype(float).reshape(-1), count) for x in given)
    except (KeyError, ValueError):
        return [f"place {k}" for k in range(count)]
    return [f"{abs(y):.2f} {'N' if y >= 0 else 'S'} {abs(x):.2f} {'E' if x >= 0 else 'W'}"
            for y, x in zip(lat, (lon + 180) % 360 - 180, strict=True)]  # fmt: skip
