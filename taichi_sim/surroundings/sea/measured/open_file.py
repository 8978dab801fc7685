"""Records of the file that `sea.spectrum` names: format, place, time, and substitutes for missing directions."""

import warnings
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

import numpy as np

from taichi_sim.config import ConfigError, SeaConfig
from taichi_sim.errors import reading, refuse
from taichi_sim.surroundings.sea.measured.ndbc import is_ndbc, read_ndbc
from taichi_sim.surroundings.sea.measured.netcdf import read_netcdf
from taichi_sim.surroundings.sea.measured.spectra import Gridded, checked
from taichi_sim.surroundings.sea.measured.spotter import is_spotter, read_spotter
from taichi_sim.surroundings.sea.measured.wave_models import read_text
from taichi_sim.surroundings.sea.measured.wave_record import (
    WaveRecord,
    direction_grid,
    maximum_entropy,
    narrowed,
    normalised,
)
from taichi_sim.surroundings.sea.spectrum import spreading

ALL = "all"
NETCDF = (".nc", ".nc4", ".cdf", ".netcdf")
BREAKING = 0.142  # height over length of the highest deep-water wave (Michell 1893)
BEGIN = 4000  # characters of a text, by which its format is known
NAMED = 6  # most places of a file that an error names


@dataclass(frozen=True, eq=False)
class SpectraFile:
    """Records of a file at one place, the earliest first.

    Attributes:
        path: the file.
        place: name of the place.
        times: [t], UTC.
        edges: edges of the frequency bands, [f + 1], Hz.
        density: [t, f], m^2/Hz; NaN where a value is missing.
        c1, c2: moments of the direction of travel, [t, f], or None.
        angles, grid: directions of travel [d] and energy by direction [t, f, d], or None. A file without directions has
            neither moments nor a grid.
    """

    path: Path
    place: str
    times: np.ndarray
    edges: np.ndarray
    density: np.ndarray
    c1: np.ndarray | None = None
    c2: np.ndarray | None = None
    angles: np.ndarray | None = None
    grid: np.ndarray | None = None

    def find(self, time: str | None) -> int:
        """Index of the record of a time ("2020-06-08 03:50", UTC); without a time, of the latest record."""
        if time is None:
            return self.times.size - 1
        try:
            moment = datetime.fromisoformat(time)
        except ValueError:
            raise ConfigError(
                f"sea.record = {time!r}: not a time; expected one such as {_text(self.times[-1])!r}, or {ALL!r}"
            ) from None
        if moment.tzinfo is not None:
            moment = moment.astimezone(UTC).replace(tzinfo=None)
        wanted = np.datetime64(moment, "m")
        away = np.abs(self.times - wanted)
        nearest = int(away.argmin())
        if away[nearest] != np.timedelta64(0, "m"):
            raise ConfigError(
                f"sea.record = {time!r}: {self.path.name} has no record of that time; the nearest is "
                f"{_text(self.times[nearest])!r} (it has {self.times.size}, from {_text(self.times[0])} to "
                f"{_text(self.times[-1])})"
            )
        return nearest

    def whole(self) -> list[int]:
        """Indices of the records without a missing density."""
        return np.flatnonzero(np.isfinite(self.density).all(axis=1)).tolist()

    def _way_out(self) -> str:
        """How to name another record."""
        whole = self.whole()
        if not whole:
            return "no record of this place is whole"
        return f"{len(whole)} of {self.times.size} records are whole, the latest of {_text(self.times[whole[-1]])}; " \
               f"{ALL!r} takes these"  # fmt: skip

    def record(self, t: int, direction_deg: float | None = None, spreading_s: float | None = None) -> WaveRecord:
        """Return record t. The arguments give mean direction and cos^2s spreading to a record without directions.

        A band without directions takes those of the nearest band that has some.
        """
        name, density = f"{self.place}, {_text(self.times[t])}", self.density[t]
        lacks, middles = ~np.isfinite(density), (self.edges[1:] + self.edges[:-1]) / 2
        if lacks.any():
            what = "no spectrum, every value is missing (land, ice, or nothing was measured)"
            what = what if lacks.all() else f"no density at {middles[lacks][0]:.4g} Hz"
            raise ConfigError(f"{self.path}: the record of {_text(self.times[t])} has {what}: {self._way_out()}")
        spread = self._spread(t)
        if spread is None:
            spread = self._assumed(name, density, direction_deg, spreading_s)
        record = WaveRecord(name, self.edges, np.maximum(density, 0.0), spread)
        if not record.calm and record.steepness > BREAKING:
            raise ConfigError(
                f"{self.path}: the record of {_text(self.times[t])} has a significant height of {record.hs:.4g} m at a "
                f"mean period of {record.tm02:.3g} s, steeper than a wave can be: its frequencies or densities have "
                "other units than it says (periods, rad/s, per degree, cm^2, logarithms), or marks of missing values"
            )
        return record

    def _spread(self, t: int) -> np.ndarray | None:
        """Directional distribution of each band of a record, [f, ANGLES]; None if no band has directions."""
        if self.grid is not None and self.angles is not None:
            cell = 2 * np.pi / self.angles.size
            index = np.floor((direction_grid() - (self.angles[0] - cell / 2)) / cell).astype(int) % self.angles.size
            energy = np.nan_to_num(self.grid[t])
            known = energy.sum(axis=1) > 0
            if not known.any():
                return None
            return normalised(energy[_nearest(known)][:, index])
        if self.c1 is None or self.c2 is None:
            return None
        known = np.isfinite(self.c1[t])
        if not known.any():
            return None
        c1, c2 = self.c1[t], np.where(np.isfinite(self.c2[t]), self.c2[t], narrowed(np.nan_to_num(self.c1[t])))
        nearest = _nearest(known)
        return maximum_entropy(c1[nearest], c2[nearest])

    def _assumed(
        self, name: str, density: np.ndarray, direction_deg: float | None, spreading_s: float | None
    ) -> np.ndarray:
        if (direction_deg is None or spreading_s is None) and density.any():
            raise ConfigError(
                f"{self.path}: there are no directions for {name}"
                f"{' (files .swdir, .swdir2, .swr1, .swr2)' if is_ndbc(self.path) else ''}: give sea.direction_deg and "
                "sea.spreading_s for the whole sea"
            )
        offset = (direction_grid() - np.deg2rad(direction_deg or 0.0) + np.pi) % (2 * np.pi) - np.pi
        return normalised(np.broadcast_to(spreading(offset, spreading_s or 1.0), (density.size, offset.size)))


def open_spectra(path: Path, site: int | None = None) -> SpectraFile:
    """Read a file of measured spectra; `site` is the index of a place in a file with several places."""
    if not path.is_file():
        raise ConfigError(f"sea.spectrum = {str(path)!r}: no such file")
    data, edges = checked(path, _read(path))
    count, named = len(data.places), "; ".join(f"{k}: {place}" for k, place in enumerate(data.places[:NAMED]))
    more = "; ..." if count > NAMED else ""
    refuse(
        ConfigError,
        (site is None and count > 1, f"{path}: has {count} places, give one as sea.site ({named}{more})"),
        ((site or 0) >= count, f"sea.site = {site}: {path.name} has {count}, allowed are 0 to {count - 1}"),
    )
    here = (slice(None), site or 0)
    c1, c2, grid = (None if x is None else x[here] for x in (data.c1, data.c2, data.grid))
    return SpectraFile(path, data.places[site or 0], data.times, edges, data.density[here], c1, c2, data.angles, grid)


def _read(path: Path) -> Gridded:
    """Read the spectra of a file of any kind."""
    if is_ndbc(path):
        return read_ndbc(path)
    with reading(path, ConfigError), warnings.catch_warnings():
        if path.suffix.lower() in NETCDF:
            warnings.simplefilter("ignore")
            return read_netcdf(path)
        with path.open(encoding="utf-8", errors="replace") as file:
            begin = file.read(BEGIN)
        return read_spotter(path) if is_spotter(begin) else read_text(path, begin)


def records_of(config: SeaConfig) -> list[WaveRecord]:
    """Records of a measured sea: one, or all of the file. Realisation r takes record r modulo their number."""
    given = config.model_fields_set
    direction = config.direction_deg if "direction_deg" in given else None
    spreading_s = config.spreading_s if "spreading_s" in given else None
    path = Path(config.spectrum)
    stamp = path.stat().st_mtime_ns if path.is_file() else 0
    return list(_records(path, stamp, config.record, config.site, direction, spreading_s))


@lru_cache(maxsize=16)
def _records(path: Path, stamp: int, time: str | None, site: int | None, direction_deg: float | None,
             spreading_s: float | None) -> tuple[WaveRecord, ...]:  # fmt: skip
    """Read each file once, in its present version (`stamp`)."""
    file = open_spectra(path, site)
    if time != ALL:
        return (file.record(file.find(time), direction_deg, spreading_s),)
    if not file.whole():
        raise ConfigError(f"{path}: every record has a missing density, or no spectrum (land, ice)")
    return tuple(file.record(t, direction_deg, spreading_s) for t in file.whole())


def _nearest(known: np.ndarray) -> np.ndarray:
    """For each position in a row, the index of the nearest known entry [f]."""
    there = np.flatnonzero(known)
    return there[np.abs(np.arange(known.size)[:, None] - there).argmin(axis=1)]


def _text(time: np.datetime64) -> str:
    return str(time.astype("datetime64[m]")).replace("T", " ")
