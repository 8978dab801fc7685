"""Spectra that the US National Data Buoy Center publishes as text, with r1, r2, alpha1 and alpha2.

    41010.data_spec, .swdir, .swdir2, .swr1, .swr2     last 45 days: value (frequency) value (frequency) ...
    41010w2019.txt, 41010d..., i..., j..., k...        one year: frequencies in the header, r1 and r2 in hundredths

The files hold density (m^2/Hz), alpha1, alpha2 (degrees clockwise from north, where waves come FROM), r1 and r2. 999
and MM mark a missing value. The readers of libraries convert them at once to a two-dimensional spectrum, by a Fourier
series truncated after two terms. That series is negative for some directions, and hours with a 999 are lost. This
module therefore reads the columns itself.

Bands: frequencies are printed with three decimals (0.0325 Hz as 0.033). They are replaced by those of NDBC's wave
processing module, which are known (www.ndbc.noaa.gov/faq/wavespectra.shtml).

Hundredths: spectra of the last days arrive in WMO code FM 65 WAVEOB. It gives each density in hundredths of the largest
one, rounded down. A record whose densities are all such multiples is taken to be in this code. Half a hundredth is
added to each density but the largest, from the first band with energy on. Above the last band with energy, no more is
added than a tail of f^-4 has (the equilibrium range: Toba 1973, Donelan et al. 1985). Without this correction the 24
hours of 41010 in June 2020 are on average 0.019 m too low and 0.10 s too long (Hs, Tm02); with it, 0.004 m and 0.004 s.
One case remains open: a wind sea under a swell that is a hundred times as dense. The mean period of a pure JONSWAP
swell of 13 s becomes 0.4 s too short; it is too long if the code has lost a wind sea. Directions have steps of 4
degrees in this code.
"""

import gzip
import re
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.config.columns import warn_if_cut
from taichi_sim.config.files import ndbc_set
from taichi_sim.errors import refuse
from taichi_sim.surroundings.sea.measured.spectra import Gridded

MISSING = 998.0  # from here on a value is missing (NDBC writes 999)
BANDS = np.concatenate((0.0325 + 0.005 * np.arange(13), 0.1 + 0.01 * np.arange(26), 0.365 + 0.02 * np.arange(7)))  # Hz
PRINTED = 0.00051  # Hz; largest error of a printed frequency
TAIL = 4  # power of the frequency in the decay of a spectrum's tail
LARGEST = {"alpha1": 360.0, "alpha2": 360.0, "r1": 1.05, "r2": 1.05}  # deg and 1, with room for rounding
STEPS = 100  # steps up to the largest density in code FM 65
DISCERNIBLE = 3  # steps of the code are recognised if they are at least this many units of the last printed digit


class Part(NamedTuple):
    """Content of one file: times [t], frequencies [f] (Hz) and values [t, f], NaN where a value is missing."""

    times: np.ndarray
    frequency: np.ndarray
    values: np.ndarray
    digit: float  # unit of the last printed digit
    hundredths: bool  # whether r1 and r2 are in hundredths


def is_ndbc(path: Path) -> bool:
    """Whether the header of a file is that of NDBC's text."""
    try:
        with _open(path) as file:
            return bool(re.match(r"#?\s*YY(YY)?\s+MM\s+DD\s+hh", file.readline(200)))
    except (OSError, UnicodeDecodeError, EOFError):
        return False


def read_ndbc(path: Path) -> Gridded:
    """Read the records of a set of files; `path` is any of them."""
    parts = ndbc_set(path)
    density = read_part(parts.get("density", path))
    if "density" not in parts and parts:
        raise ConfigError(f"{path}: the file of the densities, which every spectrum needs, is not in the same folder")
    first = parts.get("density", path)
    given = {
        kind: _aligned(kind, read_part(file), density, file, first) for kind, file in parts.items() if kind != "density"
    }
    nothing = np.full(density.values.shape, np.nan)
    alpha1, r1, alpha2, r2 = (given.get(kind, nothing) for kind in ("alpha1", "r1", "alpha2", "r2"))
    to_first, to_second = (np.deg2rad(alpha + 180.0) for alpha in (alpha1, alpha2))  # from -> to
    values = with_cut_off_returned(density.values, density.digit, bands(density.frequency))
    c1, c2 = r1 * np.exp(1j * to_first), r2 * np.exp(2j * to_second)
    values, c1, c2 = (x[:, None] for x in (values, c1, c2))
    return Gridded(density.times, [path.name.partition(".")[0]], bands(density.frequency), values, c1=c1, c2=c2)


def bands(printed: np.ndarray) -> np.ndarray:
    """Replace printed frequencies by the exact ones of NDBC, if they are NDBC's."""
    known = BANDS[-printed.size :]
    return known if known.size == printed.size and np.allclose(known, printed, rtol=0, atol=PRINTED) else printed


def with_cut_off_returned(density: np.ndarray, digit: float, frequency: np.ndarray) -> np.ndarray:
    """Add half a step to densities [t, f] that were rounded down to hundredths of the largest."""
    density = density.copy()
    for row in density:
        if not np.isfinite(row).all() or row.max() < DISCERNIBLE * STEPS * digit:
            continue
        step = row.max() / STEPS
        off = np.abs(row - np.rint(row / step) * step)
        if (off <= 0.51 * digit * (1 + row / row.max())).all():
            first, last = np.flatnonzero(row)[[0, -1]]
            tail = (row[last] + step / 2) * (frequency[last] / frequency) ** TAIL
            half = np.where(np.arange(row.size) > last, np.minimum(step / 2, tail), step / 2)
            row += np.where((np.arange(row.size) >= first) & (row < row.max()), half, 0.0)
    return density


def read_part(path: Path) -> Part:
    """Read one file of a set."""
    try:
        with _open(path) as file:
            text = file.read()
        warn_if_cut(path, text)
        header, *lines = text.splitlines()
    except (OSError, UnicodeDecodeError, EOFError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read: {error or 'it is empty'}") from None
    names = header.lstrip("#").split()
    dates = 5 if len(names) > 4 and names[4].lower() == "mm" else 4
    pairs = "(" in header or any("(" in line for line in lines[:1])
    columns = None if pairs else names[dates:]
    rows = [(n, line.split()) for n, line in enumerate(lines, 2) if line.strip() and not line.startswith("#")]
    summary = "a summary of heights and periods, not a spectrum"
    refuse(
        ConfigError,
        ("WVHT" in names, f"{path}: {summary}: name {path.stem}.data_spec"),
        (not rows, f"{path}: it has no record"),
    )
    parsed = [_row(path, n, cells, dates, columns) for n, cells in rows]
    frequency, first = parsed[0][1], rows[0][0]
    odd = ((n, row[1]) for (n, _), row in zip(rows, parsed, strict=True) if not np.array_equal(row[1], frequency))
    number, there = next(odd, (0, frequency))
    refuse(
        ConfigError,
        (frequency.size < 3, f"{path}, line {first}: {frequency.size} frequencies: it is cut short, or no spectrum"),
        (there.size != frequency.size,
         f"{path}, line {number}: cut short: {there.size} of {frequency.size} frequencies"),
        (number, f"{path}, line {number}: its frequencies differ from those in line {first}"),
        (not (np.diff(frequency, prepend=0.0) > 0).all(), f"{path}: frequencies must rise from above 0"),
    )  # fmt: skip
    values = np.array([row[2] for row in parsed])
    decimals = max((len(x.partition(".")[2].rstrip(")")) for x in rows[0][1][dates:] if "." in x and "(" not in x),
                   default=0)  # fmt: skip
    return Part(np.array([row[0] for row in parsed]), frequency, values, 10.0**-decimals, not pairs)


def _row(path: Path, number: int, cells: list[str], dates: int, columns: list[str] | None):
    """Time, frequencies and values of one line."""
    try:
        year, month, day, hour, minute = ([int(x) for x in cells[:dates]] + [0])[:5]
        time = np.datetime64(datetime(year + 1900 if year < 100 else year, month, day, hour, minute), "m")
        if columns is not None:
            frequency, texts = [float(x) for x in columns], cells[dates:]
        else:
            text = cells[dates:]
            text = text[1:] if len(text) > 1 and "(" not in text[1] else text  # the separation frequency
            texts, frequency = text[::2], [float(re.fullmatch(r"\((.*)\)", x)[1]) for x in text[1::2]]  # type: ignore
        values = [np.nan if text == "MM" else float(text.replace("_", "x")) for text in texts]
        why = f"{len(texts)} of {len(frequency)} frequencies" if columns else "a value without (its frequency)"
        refuse(
            ValueError,
            (len(texts) != len(frequency), f"cut short: {why}"),
            (min(values, default=0.0) < 0, f"{min(values, default=0.0):g}: must be 0 or more"),
        )
        return time, np.array(frequency), np.array([value if value < MISSING else np.nan for value in values])
    except (TypeError, ValueError) as error:
        told = error if isinstance(error, ValueError) else "cut short: a value without (its frequency)"
        raise ConfigError(f"{path}, line {number}: {told}") from None


def _aligned(kind: str, part: Part, density: Part, path: Path, of_density: Path) -> np.ndarray:
    """Values [t, f] of a file at the times of the densities; NaN where the file lacks a time."""
    alike = part.frequency.shape == density.frequency.shape and np.allclose(part.frequency, density.frequency)
    values = part.values / 100 if part.hundredths and kind in ("r1", "r2") else part.values
    beyond = values > LARGEST[kind]
    t, f = np.argwhere(beyond)[0] if beyond.any() else (0, 0)
    refuse(
        ConfigError,
        (not alike, f"{path}: its {part.frequency.size} frequencies differ from the {density.frequency.size} of "
         f"{of_density.name}: is one of them cut short?"),
        (beyond.any(), f"{path}: {kind} is {values[t, f]:g} on {part.times[t]} at {part.frequency[f]:g} Hz: allowed "
         f"are 0 to {LARGEST[kind]:g}, and 999 or MM where it is missing"),
    )  # fmt: skip
    rows: Mapping[np.datetime64, np.ndarray] = dict(zip(part.times, values, strict=True))
    nothing = np.full(density.frequency.size, np.nan)
    return np.array([rows.get(time, nothing) for time in density.times])


def _open(path: Path):
    opened = gzip.open if path.suffix == ".gz" else open
    return opened(path, "rt", encoding="utf-8")
