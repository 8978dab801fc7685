"""Spectra of SWAN and WAVEWATCH III as text.

    SWAN 1 ...                  SWAN's own format: header with keywords, then a block for each time and place
    'WAVEWATCH III SPECTRA' ... transfer files of ww3_outp: header, then a block for each time and place

SWAN's directions are nautical (NDIR: comes from, clockwise from north) or Cartesian (CDIR: travels to, counter-
clockwise from x, which points east). WAVEWATCH III writes where waves travel to, rad, clockwise from north.
"""

import re
from datetime import datetime
from pathlib import Path

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.config.columns import warn_if_cut
from taichi_sim.errors import refuse
from taichi_sim.surroundings.sea.measured.netcdf import GRAVITY, SEAWATER
from taichi_sim.surroundings.sea.measured.spectra import Gridded, of_energy

MANY = 1_000_000  # places, frequencies or directions of a file, at most
KNOWN = (
    "NDBC's text, netCDF of ERA5, WAVEWATCH III, SWAN, wavespectra, NDBC and CDIP, text of SWAN and WAVEWATCH III, "
    "Spotter's JSON and CSV"
)


STATIONARY = np.datetime64("1970-01-01T00:00", "m")  # time of the record of a run that has none


class _Lines:
    """The lines of a text, one after the other, with their numbers."""

    def __init__(self, text: str):
        self._lines = [(k, line.strip()) for k, line in enumerate(text.splitlines(), 1)]
        self._next = 0

    def more(self) -> bool:
        """Whether another line that is not empty follows."""
        while self._next < len(self._lines) and not self._lines[self._next][1]:
            self._next += 1
        return self._next < len(self._lines)

    def take(self) -> str:
        """The next line that is not empty."""
        if not self.more():
            raise ConfigError("it is cut short: it has no spectrum, or ends in the middle of a block")
        self._next += 1
        return self._lines[self._next - 1][1]

    def numbers(self, count: int) -> list[float]:
        """The next `count` numbers, over whole lines."""
        found: list[float] = []
        while len(found) < count:
            found += map(number, self.take().split())
        self.refuse((len(found) != count, f"{len(found)} numbers in place of {count}"))
        return found

    def numbers_of_line(self, count: int = 1) -> list[float]:
        """The first `count` numbers of the next line, which words may follow."""
        return [number(x) for x in self.take().split()[:count]]

    def count(self) -> int:
        """A number of things that the next line gives."""
        found = self.numbers_of_line()[0]
        self.refuse((not 1 <= found <= MANY or found % 1, "a number of things is wanted"))
        return int(found)

    def refuse(self, *checks: tuple[object, str]) -> None:
        """Refuse the line that was taken last by the first of the `checks` that holds."""
        place, line = self._lines[self._next - 1]
        refuse(ConfigError, *((wrong, f"line {place}: {told}: {line[:40]!r}") for wrong, told in checks))


def number(text: str) -> float:
    """A number; ValueError for any other text, and for 1_0."""
    return float(text.replace("_", "x"))


def read_text(path: Path, begin: str) -> Gridded:
    """Read the spectra of a text that begins with `begin`."""
    swan = begin.startswith("SWAN")
    if not swan and not begin.lstrip().startswith("'WAVEWATCH III SPECTRA'"):
        raise ConfigError(f"not known as a spectrum; known formats are {KNOWN}")
    text = path.read_text(encoding="utf-8", errors="replace")
    warn_if_cut(path, text)
    lines = _Lines(text)
    try:
        return _of_swan(path, lines) if swan else _of_wavewatch(lines)
    except ConfigError:
        raise
    except (ValueError, IndexError) as error:
        lines.refuse((True, f"a number, or a date and time is wanted ({error})"))
        raise


def _time(text: str, form: str) -> np.datetime64:
    return np.datetime64(datetime.strptime(text, form), "m")


def _of_swan(path: Path, lines: _Lines) -> Gridded:
    """SWAN's spectral file (user manual, appendix D)."""
    lines.take()
    timed, places, frequency, toward, line = False, [], None, None, ""
    while not (line := lines.take()).startswith("QUANT"):
        keyword = line.split()[0].upper()
        if keyword.startswith("$"):
            continue
        if keyword == "TIME":
            timed = lines.numbers_of_line()[0] == 1
            lines.refuse((not timed, "time code 1 is wanted (yyyymmdd.hhmmss)"))
        elif keyword in ("LOCATIONS", "LONLAT"):
            places = [lines.numbers_of_line(2) for _ in range(lines.count())]
        elif keyword in ("AFREQ", "RFREQ"):
            frequency = np.array(lines.numbers(lines.count()))
        elif keyword in ("NDIR", "CDIR"):
            values = np.array(lines.numbers(lines.count()))
            toward = values + 180.0 if keyword == "NDIR" else 90.0 - values
        else:
            lines.refuse((True, "this keyword is not known"))
    whole = frequency is not None and toward is not None and bool(places)
    lines.refuse((not whole, "no directional spectrum: LOCATIONS, AFREQ and NDIR or CDIR come before QUANT"))
    assert frequency is not None and toward is not None
    quantities = lines.count()
    kind, unit = lines.take().split()[0], lines.take().split()[0].lower()
    exception, known = lines.numbers_of_line()[0], kind.lower() in ("vadens", "endens") and "deg" in unit
    lines.refuse(
        (quantities != 1, "one quantity is wanted (SPEC2D)"),
        (not known, f"{kind} in {unit}: known are VaDens in m2/Hz/degr and EnDens in J/m2/Hz/degr"),
    )
    factor = np.rad2deg(1.0) / (SEAWATER * GRAVITY if unit.startswith("j") else 1.0)
    shape, times, energies = (frequency.size, toward.size), [], []
    while lines.more() or not times:
        lines.refuse((times and not timed, "more than one record, and none has a time"))
        times.append(_time(lines.take().split()[0], "%Y%m%d.%H%M%S") if timed else STATIONARY)
        here = np.full((len(places), *shape), np.nan)
        for k in range(len(places)):
            word = lines.take().split()[0].upper()
            lines.refuse((word not in ("ZERO", "FACTOR", "NODATA"), "FACTOR, ZERO or NODATA is wanted"))
            if word == "ZERO":
                here[k] = 0.0
            elif word == "FACTOR":
                scale = lines.numbers(1)[0]
                block = np.array([lines.numbers(toward.size) for _ in range(frequency.size)])
                here[k] = np.where(block == exception, np.nan, block) * scale * factor
        energies.append(here)
    names = [path.stem] if len(places) == 1 else [f"x {x:g} y {y:g}" for x, y in places]
    return of_energy(np.array(times), names, frequency, toward, np.array(energies))


def _of_wavewatch(lines: _Lines) -> Gridded:
    """A transfer file of ww3_outp (user manual, point output, type 1, subtype 3)."""
    header = re.match(r"'WAVEWATCH III SPECTRA'\s*(\d+)\s+(\d+)\s+(\d+)", lines.take())
    lines.refuse((header is None, "numbers of frequencies, directions and places are wanted"))
    assert header is not None
    size_f, size_d, size_p = (int(x) for x in header.groups())
    frequency, toward = np.array(lines.numbers(size_f)), np.rad2deg(lines.numbers(size_d))
    times, names, energies = [], [], []
    while lines.more() or not times:
        times.append(_time(lines.take(), "%Y%m%d %H%M%S"))
        here, named = np.empty((size_p, size_f, size_d)), []
        for k in range(size_p):
            match = re.match(r"'(.*?)'\s*(\S+)\s+(\S+)", lines.take())
            lines.refuse((match is None, "name, latitude and longitude of a place are wanted"))
            assert match is not None
            named.append(match[1].strip())
            here[k] = np.array(lines.numbers(size_f * size_d)).reshape(size_d, size_f).T
        lines.refuse((names and named != names, "its places differ from those of the first time"))
        names, energies = named, [*energies, here]
    return of_energy(np.array(times), names, frequency, toward, np.array(energies))
