"""Spectra in netCDF: what the attributes state is used, else what the model or the buoy's owner is known to write.

| variable | of | directions | density |
|---|---|---|---|
| d2fd | ERA5, ECMWF | to, number n of N: (n - 1/2) 360 / N deg | log10 of m^2/Hz/rad; f = 0.03453 Hz 1.1^(n - 1) |
| density | SWAN | by standard_name: from; or to, counter-clockwise from x, which points east | m^2/Hz/rad |
| efth with frequency, direction | WAVEWATCH III | to | m^2/Hz/rad; bands by frequency1, frequency2 |
| efth with freq, dir | wavespectra | from | m^2/Hz/degree |
| spectral_wave_density | NDBC | alpha1, alpha2 from, r1, r2 | m^2/Hz |
| waveEnergyDensity | CDIP | a1, b1, a2, b2 from, clockwise from north | m^2/Hz; bands by waveBandwidth |

Words of an attribute (standard_name, long_name, comment ...) on where directions count from or to go before the table.

A cell that ERA5 leaves out has no energy (it masks tiny values); a record without any cell is no spectrum: land, ice or
a gap. In all other files a missing cell makes its band missing.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.errors import needs, refuse
from taichi_sim.surroundings.sea.measured.spectra import (
    FEWEST_ANGLES,
    Gridded,
    agreed,
    of_density,
    of_energy,
    within_a_turn,
)

if TYPE_CHECKING:
    from xarray import DataArray, Dataset

ECMWF_FREQUENCIES = (25, 29, 30, 36)  # numbers of frequencies of ECMWF's spectra; ERA5 has 30
ECMWF_ANGLES = (24, 36)  # directions of ECMWF's spectra since ERA-Interim
_ZERO = r"(?! (?:the )?(?:true |magnetic )?(?:north|east|x))"  # from north is where an angle begins
FROM = re.compile(rf"from.direction|(?:com\w+|travel\w*|propagat\w+|direction) from{_ZERO}|from which|\bfrom\)|"
                  "nautical|meteorologic")  # fmt: skip
TO = re.compile(r"to.direction|(?:go\w*|travel\w*|propagat\w+|head\w*|direct\w+) to\b|towards?\b|to which|\bto\)|"
                "propagation|oceanographic")  # fmt: skip
OTHER_ANGLES = re.compile("counter|anti-?clock|mathematic|cartesian|trigonometric|from east|from the east")
AREA = re.compile(r"(m|met(?:er|re)s?)\W{0,3}2|m²|j")  # how units of densities begin
MISSING = 998.0  # deg; from here on a direction is missing (NDBC writes 999)
HERTZ = ("", "1", "hz", "hertz", "s-1", "s^-1", "s**-1", "1/s", "1/second", "cycles/second")
FIRST, RATIO = 0.03453, 1.1  # Hz; frequencies of ECMWF's spectra
FAINTEST = 30.0  # of ECMWF's logarithms; larger ones of either sign are marks of missing values
SEAWATER, GRAVITY = 1025.0, 9.81  # kg/m^3, m/s^2; of SWAN's energy densities (its defaults)
TIMES, FREQUENCIES = ("time", "valid_time", "waveTime"), ("frequency", "freq", "frequencyNumber", "waveFrequency")
PARTS = "part", "partition", "system", "realization", "realisation", "ensemble", "member", "number"
DIRECTIONS = ("direction", "dir", "directionNumber")
GOOD = (1, 2)  # CDIP's flags of records: good, not evaluated (3 questionable, 4 bad, 9 missing)


def read_netcdf(path: Path) -> Gridded:
    """Read the spectra of a file; xarray raises what it likes for a file that is none."""
    with needs("netCDF4", "waves"):
        import netCDF4  # noqa: F401
        import xarray

    with xarray.open_dataset(path, decode_timedelta=False) as opened:
        data = opened.load()
    names = {*data.variables}
    if "spectral_wave_density" in names:
        return _of_ndbc(path, data)
    if "waveEnergyDensity" in names:
        return _of_cdip(path, data)
    variable = next((name for name in ("d2fd", "density", "efth") if name in names), None)
    if variable is None:
        raise ConfigError(f"no known spectrum in it; its variables are {', '.join(sorted(map(str, names)))}")
    return _of_a_model(path, data, variable)


def _of_a_model(path: Path, data: "Dataset", variable: str) -> Gridded:
    """Energy by frequency and direction."""
    energy = data[variable]
    time, frequency, direction = (_axis(energy, known) for known in (TIMES, FREQUENCIES, DIRECTIONS))
    unit = "" if variable == "d2fd" else str(energy.attrs.get("units", "")).lower()
    many = next((name for name in energy.dims if str(name).lower() in PARTS and energy.sizes[name] > 1), None)
    parts = energy.sizes[many] if many else 1
    refuse(
        ConfigError,
        (not frequency, f"{variable} has no dimension of frequency; it has {', '.join(map(str, energy.dims))}"),
        (unit and not AREA.match(unit), f"{variable} is in {unit}: known are m2 s rad-1, m2 s degree-1, J m-2 s rad-1"),
        (many, f"{variable} has {parts} parts or realisations ({many}): write their sum, or one of them"),
    )
    assert frequency is not None
    f, angular = _frequencies(data, frequency, variable)
    for name in (time or "time", direction or "direction"):
        energy = energy if name in energy.dims else energy.expand_dims(name)
    time, direction = time or "time", direction or "direction"
    where = [name for name in energy.dims if name not in (time, frequency, direction)]
    energy = energy.stack(place=where, create_index=False) if where else energy.expand_dims("place")
    places = _places(data, energy) if where else [path.stem]
    values = np.asarray(energy.transpose(time, "place", frequency, direction), dtype=float)
    if values.shape[3] == 1 and variable != "d2fd":  # no directions at all
        values *= _energy(unit) * (2 * np.pi if angular and ("rad" in unit or not unit) else 1.0)
        return of_density(_times(data, time), places, f, values[..., 0])
    logarithms = variable == "d2fd"
    values[np.abs(values) > (FAINTEST if logarithms else np.inf)] = np.nan
    per = "deg" in unit or "rad" in unit
    refuse(
        ConfigError,
        (values.shape[3] < FEWEST_ANGLES, f"{values.shape[3]} directions: no directional spectrum"),
        (logarithms and not (values < 0).any() and not np.isnan(values).all(),
         "d2fd has no value below 0: no logarithms, as ECMWF's are; write the files as they come"),
        (unit and not per,
         f"{variable} is in {unit}, per degree or per radian is not said: m2 s degree-1, or m2 s rad-1?"),
    )  # fmt: skip
    if logarithms:
        values = np.where(
            np.isnan(values).all(axis=(2, 3), keepdims=True), np.nan, np.nan_to_num(10.0**values, nan=0.0)
        )
    values *= _scale(unit, direction, angular)
    bands = None
    if {"frequency1", "frequency2"} <= {*data.variables} and not angular:
        bands = np.stack(
            [np.asarray(data[name], dtype=float).reshape(-1) for name in ("frequency1", "frequency2")], axis=1
        )
        bands = bands if bands.shape == (f.size, 2) else None
    return of_energy(_times(data, time), places, f, _toward(data, direction, variable), values, bands)


def _axis(energy: "DataArray", known: tuple[str, ...]) -> str | None:
    return next((name for name in known if name in energy.dims), None)


def _frequencies(data: "Dataset", name: str, variable: str) -> tuple[np.ndarray, bool]:
    """Frequencies, Hz, and whether the file has them in rad/s."""
    given, size = name in data.coords, data.sizes[name]
    unit, ecmwf = str(data[name].attrs.get("units", "Hz")).lower(), variable == "d2fd"
    refuse(
        ConfigError,
        (ecmwf and not given and size not in ECMWF_FREQUENCIES,
         f"d2fd has {size} frequencies without their numbers, and ECMWF's spectra "
         f"{', '.join(map(str, ECMWF_FREQUENCIES))}: write the file with the coordinate {name}"),
        (not ecmwf and not given, f"{name} has no values"),
        (not ecmwf and unit not in HERTZ and "rad" not in unit, f"{name} is in {unit}: known are Hz and rad/s"),
    )  # fmt: skip
    if ecmwf:
        return FIRST * RATIO ** (_numbers(data, name) - 1), False
    values = np.asarray(data[name], dtype=float)
    return (values / (2 * np.pi), True) if "rad" in unit else (values, False)


def _numbers(data: "Dataset", name: str) -> np.ndarray:
    """Numbers of ECMWF's frequencies or directions, from 1."""
    if name not in data.coords:
        return np.arange(1.0, data.sizes[name] + 1)
    values = np.asarray(data[name], dtype=float)
    if not (values == np.rint(values)).all() or values.min() < 1:
        raise ConfigError(f"{name} has {values[:3]}: wanted are ECMWF's numbers from 1")
    return values


def _toward(data: "Dataset", name: str, variable: str) -> np.ndarray:
    """Directions of travel, deg clockwise from north."""
    if variable == "d2fd":
        numbers = _numbers(data, name)
        if numbers.size not in ECMWF_ANGLES:
            raise ConfigError(
                f"{name} has {numbers.size} values: ECMWF's spectra have 24 or 36 (part of them, or ERA-40?)"
            )
        return (numbers - 0.5) * 360.0 / max(numbers.size, numbers.max())
    attributes = {key: str(value).lower() for key, value in data[name].attrs.items()}
    values = np.asarray(data[name], dtype=float)
    unit = attributes.get("units", "radians" if variable == "density" else "degrees")
    values = np.rad2deg(values) if unit.startswith("rad") else values
    stated = [value for key, value in attributes.items() if key != "units"]
    comes, goes = (any(words.search(value) for value in stated) for words in (FROM, TO))
    swan, other = variable == "density", next((v for v in stated if OTHER_ANGLES.search(v)), "")
    refuse(
        ConfigError,
        (name not in data.coords, f"{name} has no values"),
        (not unit.startswith(("deg", "rad")), f"{name} is in {unit}: known are degrees and radians"),
        (not (np.abs(values) <= 720).all(), f"{name} goes to {np.abs(values).max():g} degrees: is it in {unit}?"),
        (not swan and other, f"{name} is {other!r}: wanted are degrees clockwise from north, or SWAN's density"),
        (comes and goes, f"{name} is said to count both from and to: {'; '.join(stated)}: mend its attributes"),
        (swan and goes == comes,
         f"{name} does not state where it counts from: give it the standard_name sea_surface_wave_from_direction "
         "(SET NAUTICAL) or sea_surface_wave_to_direction (SWAN's Cartesian convention)"),
    )  # fmt: skip
    if swan:
        return 90.0 - values if goes else values + 180.0
    if goes == comes:
        comes = name == "dir"  # of wavespectra; WAVEWATCH III has where waves go to
    return values + 180.0 if comes else values


def _scale(unit: str, direction: str, angular: bool) -> float:
    """Factor of densities to m^2/Hz/rad, by their unit, or else by the writer's usual one.

    "m2 s rad-1" is per Hz and per rad, also where frequencies are in rad/s (`angular`); "m2 s rad-2" is per rad/s.
    """
    per_degree = "deg" in unit if "deg" in unit or "rad" in unit else direction == "dir"
    radians = unit.count("rad") + len(re.findall(r"rad(?:ian)?s?\W*-2", unit))
    per_angular = angular and (not unit or radians + per_degree > 1)
    return _energy(unit) * (np.rad2deg(1.0) if per_degree else 1.0) * (2 * np.pi if per_angular else 1.0)


def _energy(unit: str) -> float:
    """Factor of densities in J/m^2 to those in m^2."""
    return 1 / (SEAWATER * GRAVITY) if unit.startswith("j") else 1.0


def _of_ndbc(path: Path, data: "Dataset") -> Gridded:
    """Read NDBC's netCDF. Its alpha1, alpha2 (degrees, comes from), r1 and r2 are those of NDBC's text (ndbc.py)."""

    def values(name: str) -> np.ndarray:
        if name not in data:
            return np.full(density.shape, np.nan)
        found = np.asarray(data[name].transpose("time", ..., "frequency"), dtype=float)
        found = found.reshape(found.shape[0], -1, found.shape[-1])
        return np.where(np.abs(found) < MISSING, found, np.nan)

    density = values("spectral_wave_density")
    alpha1, alpha2 = (values(name) for name in ("mean_wave_dir", "principal_wave_dir"))
    for name, angle in (("mean_wave_dir", alpha1), ("principal_wave_dir", alpha2)):
        within_a_turn(name, angle)
    first, second = (np.deg2rad(alpha + 180.0) for alpha in (alpha1, alpha2))
    c1, c2 = values("wave_spectrum_r1") * np.exp(1j * first), values("wave_spectrum_r2") * np.exp(2j * second)
    places = [path.stem] if density.shape[1] == 1 else [f"place {k}" for k in range(density.shape[1])]
    return Gridded(_times(data, "time"), places, _frequencies(data, "frequency", "")[0], density, c1=c1, c2=c2)


def _of_cdip(path: Path, data: "Dataset") -> Gridded:
    """Read CDIP's netCDF; records that it flags as questionable, bad or missing have no density."""

    def values(name: str) -> np.ndarray | None:
        if name not in data:
            return None
        return np.asarray(data[name].transpose("waveTime", "waveFrequency"), dtype=float)[:, None, :]

    density, frequency = values("waveEnergyDensity"), np.asarray(data["waveFrequency"], dtype=float)
    assert density is not None
    if "waveFlagPrimary" in data:
        density[~np.isin(np.asarray(data["waveFlagPrimary"]), GOOD)] = np.nan
    a1, b1, a2, b2 = (values(f"wave{name}Value") for name in ("A1", "B1", "A2", "B2"))
    c1 = None if a1 is None or b1 is None else -(a1 + 1j * b1)
    c2 = None if c1 is None else np.full(c1.shape, np.nan + 0j) if a2 is None or b2 is None else a2 + 1j * b2
    mean = values("waveMeanDirection")
    if c1 is not None and mean is not None:
        agreed(c1, np.where(np.abs(mean) <= 360, mean, np.nan) + 180.0, density)
    bands = None
    if "waveBandwidth" in data:
        width = np.asarray(data["waveBandwidth"], dtype=float)
        bands = np.stack((frequency - width / 2, frequency + width / 2), axis=1)
    return Gridded(_times(data, "waveTime"), [path.stem], frequency, density, c1=c1, c2=c2, bands=bands)


def _times(data: "Dataset", name: str | None) -> np.ndarray:
    values = np.atleast_1d(np.asarray(data[name] if name in data.variables else []))
    if not np.issubdtype(values.dtype, np.datetime64):
        raise ConfigError(f"{name or 'it'} has no time with a unit such as 'seconds since 1970-01-01'")
    return values.astype("datetime64[m]")


def _places(data: "Dataset", energy: "DataArray") -> list[str]:
    """Names of the places by their coordinates: 30.25 N 75.00 W."""
    count = energy.sizes["place"]
    found = []
    for known in (("latitude", "lat"), ("longitude", "lon")):
        name = next((name for name in known if name in data.variables), None)
        if name is None:
            return [f"place {k}" for k in range(count)]
        given = energy[name] if name in energy.coords else data[name]
        values = np.asarray(given, dtype=float)
        found.append(values[0] if values.ndim == 2 else values.reshape(-1))
    try:
        lat, lon = (np.broadcast_to(values, count) for values in found)
    except ValueError:
        return [f"place {k}" for k in range(count)]
    return [f"{abs(y):.2f} {'N' if y >= 0 else 'S'} {abs(x):.2f} {'E' if x >= 0 else 'W'}"
            for y, x in zip(lat, (lon + 180) % 360 - 180, strict=True)]  # fmt: skip
