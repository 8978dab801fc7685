"""The gate of tables: text to columns of numbers and times, and what no column may hold.

Series (config/series.py), logs (fit/log.py) and Spotter's CSV (sea/measured/spotter.py) are read by it:

    text        UTF-8, with a byte order mark or without; cells parted by commas, semicolons or tabs, as in the header;
                where no comma parts cells, a number may have a decimal comma
    header      names, and units in brackets: speed (kn), time [min]; a unit that is not known is refused
    times       numbers, or dates and times of ISO 8601; without an offset they are UTC, never the machine's time zone;
                digits that read as dates (20240501) are refused, and so are offsets on some rows alone
    numbers     finite; a row that is cut short or too long is refused, and so is a value that only marks a missing one

A row that lacks a value is refused by its line. Leave it out: readers interpolate between two rows.
"""

import csv
import math
import re
import warnings
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config.base import ConfigError

Array = NDArray[np.float64]

KNOT = 1852 / 3600  # m/s
TURN = 360.0  # deg
UNIX = 1e8  # s; from here on (three years) a number is no time of a world, but seconds since 1970
LATEST = 1e10  # s; from here on (the year 2286) a number is no second since 1970, but a millisecond
MISSING = np.array(
    [9.99, 99, 99.9, 99.99, 999, 999.9, 999.99, 9999, 9999.9, 99999, 6999, 7999, 32767, 32768]
)  # with either sign, marks of a missing value: NDBC, ISD, Campbell's loggers, 16 bits
AWAY = 0.5  # a mark lies at least this share of itself away from the values around it
LEAST = {"speed": 0.0, "length": 90.0}  # quantity -> size up to which a mark is a value; TURN for all others
UNITS = {  # quantity -> unit -> factor to the unit in which it is wanted
    "time": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "hours": 3600.0,
             "d": 86400.0, "days": 86400.0, "utc": 1.0, "gmt": 1.0, "z": 1.0, "unix": 1.0, "epoch": 1.0},
    "speed": {"m/s": 1.0, "m s-1": 1.0, "ms-1": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "kn": KNOT,
              "kt": KNOT, "kts": KNOT, "knot": KNOT, "knots": KNOT, "mph": 0.44704, "ft/s": 0.3048},
    "degrees": {"deg": 1.0, "degree": 1.0, "degrees": 1.0, "°": 1.0, "degt": 1.0, "rad": 180 / math.pi},
    "radians": {"rad": 1.0, "radians": 1.0, "deg": math.pi / 180, "degrees": math.pi / 180, "°": math.pi / 180},
    "degrees per second": {"deg/s": 1.0, "°/s": 1.0, "rad/s": 180 / math.pi, "deg/min": 1 / 60},
    "radians per second": {"rad/s": 1.0, "deg/s": math.pi / 180, "°/s": math.pi / 180},
    "length": {"m": 1.0, "km": 1e3, "cm": 1e-2, "ft": 0.3048, "nm": 1852.0},
    "number": {"-": 1.0, "1": 1.0},
}  # fmt: skip
_DIGITS = re.compile(r"(19|20)\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])(([01]\d|2[0-3])([0-5]\d){0,2})?")  # yyyymmddhhmm
_COMMA = re.compile(r"[+-]?\d+,\d+")  # a decimal comma
_UNIT = re.compile(r"(.*?)\s*[\[(]([^\])]*)[\])]")


class Column(NamedTuple):
    """Where a column is: its position, its name in the header and the unit stated there ("" for none)."""

    position: int
    title: str
    unit: str


class Sheet:
    """A table of text: `header`, and `rows` with the numbers of their lines."""

    def __init__(self, path: Path, refusal: type[ConfigError] = ConfigError):
        """Read a file; what is wrong with it is raised as `refusal`, here and later."""
        self.path, self.refusal = path, refusal
        try:
            text = path.read_bytes().decode("utf-8-sig")
        except OSError as error:
            raise refusal(f"{path}: cannot be read: {error.strerror}") from None
        except UnicodeDecodeError as error:
            raise refusal(f"{path}: cannot be read: this is no text in UTF-8 ({error.reason})") from None
        warn_if_cut(path, text)
        lines = text.splitlines()
        top = next((line for line in lines if line.strip()), "")
        self.separator = max(",;\t", key=top.count)
        try:
            parted = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=self.separator)]
        except csv.Error as error:
            raise refusal(f"{path}: cannot be read: {error}") from None
        numbered = [(k, row) for k, row in enumerate(parted, 1) if any(row)]
        self.header = numbered[0][1] if numbered else []
        self.rows = numbered[1:]
        for line, row in self.rows:
            if any(row[len(self.header) :]):
                raise self.wrong(line, f"{len(row)} cells under {len(self.header)} names (numbers with decimal commas "
                                 "are parted by semicolons; nothing stands above the names)")  # fmt: skip

    def wrong(self, line: int, told: str) -> ConfigError:
        """The refusal of a line of the file."""
        return self.refusal(f"{self.path}, line {line}: {told}")

    def line(self, k: int) -> int:
        """Number of the line of row k."""
        return self.rows[k][0]

    def find(self, name: str) -> Column | None:
        """The column of a name, with its unit in brackets or without; None if there is none.

        Raises:
            ConfigError: if several have the name.
        """
        found = [Column(k, title, "") for k, title in enumerate(self.header) if title == name]
        if not found:
            split = [(k, title, _UNIT.fullmatch(title)) for k, title in enumerate(self.header)]
            found = [Column(k, title, match[2].strip()) for k, title, match in split if match and match[1] == name]
        if len(found) > 1:
            raise self.refusal(f"{self.path}: {len(found)} columns are called {name}: leave one")
        return found[0] if found else None

    def numbers(self, place: Column, quantity: str = "", missing: bool = False) -> Array:
        """Values of a column in the unit of its `quantity` (UNITS); "" takes them as they are.

        Where values may be `missing`, an empty cell, NaN and a mark of a missing value are NaN.

        Raises:
            ConfigError: for an unknown unit, a cell without a finite number, or a mark of a missing value.
        """
        values = np.empty(len(self.rows))
        for k, (line, text) in enumerate(self._cells(place)):
            number = math.nan if missing and not text else self._number(text)
            if number is None:
                way = ("write decimal points: commas part columns here" if _COMMA.fullmatch(text) else
                       "leave out rows without a value")  # fmt: skip
                raise self.wrong(line, f"{place.title} is not a number: {text!r}; {way}")
            if not (math.isfinite(number) or missing and math.isnan(number)):
                raise self.wrong(line, f"{place.title} = {text}: numbers must be finite: leave out such rows")
            values[k] = number
        if missing:
            return without_marks(values, least=LEAST.get(quantity, TURN)) * self._factor(place, quantity)
        k = missing_mark(values, least=LEAST.get(quantity, TURN))
        if k is not None:
            raise self.wrong(self.line(k), f"{place.title} = {values[k]:g} marks a missing value: leave out such rows")
        return values * self._factor(place, quantity)

    def times(self, place: Column) -> tuple[Array, bool]:
        """Times of a column, s, and whether they are dates: seconds since 1970, UTC.

        Raises:
            ConfigError: for a cell that is no time, numbers among dates, times that do not rise, or other units than s.
        """
        values, dates, zoned = np.empty(len(self.rows)), None, None
        factor = self._factor(place, "time")
        if self.rows and not place.unit and all(_DIGITS.fullmatch(text) for _, text in self._cells(place)):
            raise self.wrong(self.line(0), f"{place.title} = {self.rows[0][1][place.position]} reads as a date: dates "
                             f"are 2024-05-01T12:00; seconds are told in the header: {place.title} [s]")  # fmt: skip
        for k, (line, text) in enumerate(self._cells(place)):
            number = self._number(text)
            dated = number is None
            if dates not in (None, dated):
                raise self.wrong(line, f"{place.title} = {text!r}: numbers and dates are mixed in this column")
            dates = dated
            if number is None:
                moment = self._moment(line, place.title, text)
                if zoned not in (None, moment.tzinfo is not None):
                    raise self.wrong(line, f"{place.title} = {text!r}: some times of this column have an offset from "
                                     "UTC, others have none: give all of them one")  # fmt: skip
                zoned = moment.tzinfo is not None
                values[k] = (moment if zoned else moment.replace(tzinfo=UTC)).timestamp()
            else:
                values[k] = factor * number
            if not math.isfinite(values[k]):
                raise self.wrong(line, f"{place.title} = {text}: numbers must be finite: leave out such rows")
            if k and values[k] <= values[k - 1]:
                same = "is there twice" if values[k] == values[k - 1] else "comes after a later one"
                raise self.wrong(line, f"{place.title} = {text} {same}: it must increase, for times rise")
            if abs(values[k]) >= LATEST:
                raise self.wrong(line, f"{place.title} = {text}: no time in s. Milliseconds are told in the header: "
                                 "time [ms]; dates are 2024-05-01T12:00")  # fmt: skip
        return values, bool(dates) or (len(values) > 0 and values[0] >= UNIX)

    def _cells(self, place: Column) -> Iterable[tuple[int, str]]:
        for line, row in self.rows:
            if place.position >= len(row):
                raise self.wrong(line, f"cut short: {len(row)} of {len(self.header)} cells")
            yield line, row[place.position]

    def _number(self, text: str) -> float | None:
        if self.separator != "," and text.count(",") == 1:
            text = text.replace(",", ".")
        try:
            return None if "_" in text else float(text)
        except ValueError:
            return None

    def _moment(self, line: int, name: str, text: str) -> datetime:
        try:
            return datetime.fromisoformat(text)
        except ValueError:
            raise self.wrong(line, f"{name} is not a number, nor a date such as 2024-05-01T12:00Z: {text!r}") from None

    def _factor(self, place: Column, quantity: str) -> float:
        known = UNITS.get(quantity)
        if not place.unit or known is None:
            return 1.0
        if place.unit.lower() not in known:
            raise self.refusal(f"{self.path}: column {place.title}: this unit is not known here; known are "
                               f"{', '.join(known)}")  # fmt: skip
        return known[place.unit.lower()]


def no_direction(degrees: Array) -> int | None:
    """First of some directions (deg) that is none: beyond a turn, or below 0 where others are above 180."""
    wrong = (np.abs(degrees) > TURN + 1e-6) | ((degrees < 0) & (degrees.max(initial=0.0) > 0.5 * TURN))
    return int(wrong.argmax()) if wrong.any() else None


def warn_if_cut(path: Path, text: str) -> None:
    """Warn of a text whose last line has no end: its last number may have lost digits."""
    if text and text[-1] not in "\r\n":
        warnings.warn(f"{path}: its last line has no end: is the file cut short? It is read as it is", stacklevel=2)


def without_marks(values: Array, least: float = 0.0) -> Array:
    """The values [n] with NaN for each `missing_mark`."""
    values = values.copy()
    while (k := missing_mark(values, least)) is not None:
        values[k] = np.nan
    return values


def missing_mark(values: Array, least: float = 0.0) -> int | None:
    """First of the values [n] that is a mark of a missing one (MISSING) and has nothing near it; None without any.

    A mark that the values before and after it approach within AWAY is a value: a boat may be 999 m from its start.
    Marks up to `least` are values, but for a negative one among others that are not.
    """
    size = np.abs(values)
    marked = np.isclose(size[:, None], MISSING, rtol=1e-6, atol=0.0).any(axis=1)
    others = np.flatnonzero(~marked & ~np.isnan(values))
    strange = size > least if (values[others] < 0).any() else (size > least) | (values < 0)
    for k in np.flatnonzero(marked & strange):
        after = int(np.searchsorted(others, k))
        near = values[others[max(after - 1, 0) : after + 1]]
        if (np.abs(near - values[k]) > AWAY * size[k]).all():
            return int(k)
    return None
