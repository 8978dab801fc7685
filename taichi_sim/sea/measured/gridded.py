"""Spectra that the library wavespectra reads: ERA5, WAVEWATCH III, SWAN, NDBC's netCDF, Sofar's Spotter.

A file is known by its content: a netCDF by the names of its variables, text by its first line. Models give energy by
frequency and direction, which is taken as it is, the same all over a cell; directions come from, and are turned about.
Buoys give moments, of which the distribution of largest entropy is made (entropy.py). A Spotter's a1, b1, a2 and b2,
of the direction of travel, counter-clockwise from east, the library keeps if it is asked for no directions. Of NDBC's
netCDF it would make a Fourier series cut off, which is negative for some directions, and no record at all where one
value is missing: its variables are read here.
"""

import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.config.extras import MissingExtraError

NETCDF = (".nc", ".nc4", ".cdf", ".netcdf")
NDBC = "ndbc"  # is read here
NDBC_NAMES = {"waveFrequency": "frequency", "waveTime": "time", "waveEnergyDensity": "spectral_wave_density"}
READERS = {  # variable of a netCDF -> reader of the library
    "d2fd": "read_era5", "density": "read_ncswan", "spectral_wave_density": NDBC, "waveEnergyDensity": NDBC,
}  # fmt: skip
KNOWN = (
    "NDBC's text, and by wavespectra netCDF of ERA5, WAVEWATCH III, SWAN and NDBC, text of SWAN and WAVEWATCH III, "
    "Spotter's JSON and CSV"
)
FEWEST_ANGLES = 3  # of a spectrum with directions
EVEN = 0.1  # by which directions, rounded in text, may be apart from evenly spaced ones


class Gridded(NamedTuple):
    """What a file says: times [t], places [p] in words, frequency [f] (Hz), density [t, p, f] (m^2/Hz), and either
    `grid` [t, p, f, d], m^2/Hz/rad, by direction of travel `angles` [d] (rad, rising, evenly spaced), or the moments
    c1, c2 [t, p, f] (complex).
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
    """The spectra in a file.

    Raises:
        ConfigError: for a file that none of the readers can read. MissingExtraError: without wavespectra.
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


def _reader(path: Path, xarray: Any) -> tuple[str, dict[str, Any]]:
    """The library's reader for a file, and what it is told."""
    if path.suffix.lower() in NETCDF:
        with xarray.open_dataset(path) as data:
            names = {*data.variables}
        reader = next((reader for variable, reader in READERS.items() if variable in names), None)
        if reader is None and "efth" in names:
            reader = "read_wavespectra" if "freq" in names else "read_ww3"
        if reader is None:
            raise ConfigError(f"{path}: no spectrum in it that is known: variables are {', '.join(sorted(names))}")
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
    raise ConfigError(f"{path}: not known as a spectrum; what can be read is {KNOWN}")


def _of_moments(path: Path, data: Any) -> Gridded:
    """A Spotter's: from east counter-clockwise to north clockwise, exp(i (pi/2 - x))."""

    def values(name: str) -> np.ndarray:
        return np.asarray(data[name].transpose("time", "freq"), dtype=float)[:, None, :]

    c1 = 1j * (values("a1") - 1j * values("b1"))
    c2 = -(values("a2") - 1j * values("b2"))
    return Gridded(_times(data), [path.stem], np.asarray(data.freq, dtype=float), values("efth"), c1=c1, c2=c2)


def _of_ndbc(path: Path, data: Any) -> Gridded:
    """NDBC's netCDF, whose alpha1, alpha2 (degrees from), r1 and r2 are taken as in its text (ndbc.py)."""
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


def _of_directions(path: Path, data: Any) -> Gridded:
    """A model's: energy by frequency and direction, m^2/Hz/degree; of one direction, it is a spectrum without any."""
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


def _times(data: Any) -> np.ndarray:
    return np.atleast_1d(np.asarray(data["time"], dtype="datetime64[m]"))


def _places(data: Any, energy: Any) -> list[str]:
    """In words: 30.25 N 75.00 W."""
    count = energy.sizes["place"]
    try:
        given = [np.asarray(energy[name] if name in energy.coords else data[name]) for name in ("lat", "lon")]
        lat, lon = (np.broadcast_to(x.astype(float).reshape(-1), count) for x in given)
    except (KeyError, ValueError):
        return [f"place {k}" for k in range(count)]
    return [f"{abs(y):.2f} {'N' if y >= 0 else 'S'} {abs(x):.2f} {'E' if x >= 0 else 'W'}"
            for y, x in zip(lat, (lon + 180) % 360 - 180, strict=True)]  # fmt: skip
