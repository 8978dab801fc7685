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
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config.base import ConfigError
from taichi_sim.errors import reading

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


Check = tuple[Iterable[object], Callable[[int], str]]
"""Whether it holds, by row, and the words for a row."""


def judge(refusal: type[Exception], place: Callable[[int], str], *checks: Check) -> None:
    """Refuse the first row of which one of the `checks` holds, by its `place`."""
    for wrong, told in checks:
        for k, holds in enumerate(wrong):
            if holds:
                raise refusal(f"{place(k)}: {told(k)}")


class Sheet:
    """A table of text: `header`, and `rows` with the numbers of their lines."""

    def __init__(self, path: Path, refusal: type[ConfigError] = ConfigError):
        """Read a file; what is wrong with it is raised as `refusal`, here and later."""
        self.path, self.refusal = path, refusal
        with reading(path, refusal):
            text = path.read_bytes().decode("utf-8-sig")
            lines = text.splitlines()
            top = next((line for line in lines if line.strip()), "")
            self.separator = max(",;\t", key=top.count)
            parted = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=self.separator)]
        warn_if_cut(path, text)
        numbered = [(k, row) for k, row in enumerate(parted, 1) if any(row)]
        self.header = numbered[0][1] if numbered else []
        self.rows = numbered[1:]
        wide, rows = len(self.header), [row for _, row in self.rows]
        self.judge((
            [any(row[wide:]) for row in rows],
            lambda k: f"{len(rows[k])} cells under {wide} names (numbers with decimal commas are parted by semicolons; "
            "nothing stands above the names)",
        ))  # fmt: skip

    def judge(self, *checks: Check) -> None:
        """Refuse the first row of which one of the `checks` holds, by its line."""
        judge(self.refusal, lambda k: f"{self.path}, line {self.line(k)}", *checks)

    def line(self, k: int) -> int:
        """Number of the line of row k."""
        return self.rows[k][0]

    def find(self, name: str) -> Column | None:
        """The column of a name, with its unit in brackets or without; None if there is none."""
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
        """
        texts, title, least = self._cells(place), place.title, LEAST.get(quantity, TURN)
        found = [math.nan if missing and not text else self._number(text) for text in texts]

        def no_number(k: int) -> str:
            comma = _COMMA.fullmatch(texts[k])
            way = "write decimal points: commas part columns here" if comma else "leave out rows without a value"
            return f"{title} is not a number: {texts[k]!r}; {way}"

        self.judge(([value is None for value in found], no_number))
        values = np.array(found, dtype=np.float64)
        self.judge((
            ~(np.isfinite(values) | (missing & np.isnan(values))),
            lambda k: f"{title} = {texts[k]}: numbers must be finite: leave out such rows",
        ))  # fmt: skip
        if missing:
            return without_marks(values, least) * self._factor(place, quantity)
        mark = missing_mark(values, least)
        self.judge((
            np.arange(len(values)) == (-1 if mark is None else mark),
            lambda k: f"{title} = {values[k]:g} marks a missing value: leave out such rows",
        ))  # fmt: skip
        return values * self._factor(place, quantity)

    def times(self, place: Column) -> tuple[Array, bool]:
        """Times of a column, s, and whether they are dates: seconds since 1970, UTC."""
        factor, texts, title = self._factor(place, "time"), self._cells(place), place.title
        numbers = [self._number(text) for text in texts]
        moments = [_moment(text) if number is None else None for text, number in zip(texts, numbers, strict=True)]
        dated, zoned = ([x is not None for x in moments], [x is not None and x.tzinfo is not None for x in moments])
        digits = bool(texts) and not place.unit and all(_DIGITS.fullmatch(text) for text in texts)
        self.judge(
            ([digits], lambda k: f"{title} = {texts[k]} reads as a date: dates are 2024-05-01T12:00; seconds are told "
             f"in the header: {title} [s]"),
            ([x is None and y is None for x, y in zip(numbers, moments, strict=True)],
             lambda k: f"{title} is not a number, nor a date such as 2024-05-01T12:00Z: {texts[k]!r}"),
            ([x != dated[0] for x in dated],
             lambda k: f"{title} = {texts[k]!r}: numbers and dates are mixed in this column"),
            ([x != zoned[0] for x in zoned],
             lambda k: f"{title} = {texts[k]!r}: some times of this column have an offset from UTC, others have none: "
             "give all of them one"),
        )  # fmt: skip
        seconds = (x and (x if x.tzinfo else x.replace(tzinfo=UTC)).timestamp() for x in moments)
        pairs = zip(numbers, seconds, strict=True)
        values = np.array([second if number is None else factor * number for number, second in pairs], dtype=np.float64)
        steps = np.diff(values, prepend=-math.inf)
        self.judge(
            (~np.isfinite(values), lambda k: f"{title} = {texts[k]}: numbers must be finite: leave out such rows"),
            (np.abs(values) >= LATEST, lambda k: f"{title} = {texts[k]}: no time in s. Milliseconds are told in the "
             "header: time [ms]; dates are 2024-05-01T12:00"),
            (steps == 0, lambda k: f"{title} = {texts[k]} is there twice: it must increase, for times rise"),
            (steps < 0, lambda k: f"{title} = {texts[k]} comes after a later one: it must increase, for times rise"),
        )  # fmt: skip
        return values, any(dated) or (len(values) > 0 and values[0] >= UNIX)

    def _cells(self, place: Column) -> list[str]:
        wide = [len(row) for _, row in self.rows]
        self.judge(([place.position >= x for x in wide], lambda k: f"cut short: {wide[k]} of {len(self.header)} cells"))
        return [row[place.position] for _, row in self.rows]

    def _number(self, text: str) -> float | None:
        if self.separator != "," and text.count(",") == 1:
            text = text.replace(",", ".")
        try:
            return None if "_" in text else float(text)
        except ValueError:
            return None

    def _factor(self, place: Column, quantity: str) -> float:
        known = UNITS.get(quantity)
        if not place.unit or known is None:
            return 1.0
        if place.unit.lower() not in known:
            raise self.refusal(f"{self.path}: column {place.title}: this unit is not known here; known are "
                               f"{', '.join(known)}")  # fmt: skip
        return known[place.unit.lower()]


def _moment(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


NO_DIRECTION = "directions are from 0 to 360, or from -180 to 180; a mark of a missing value? Leave out such rows"


def no_directions(degrees: Array) -> NDArray[np.bool_]:
    """Which of some directions (deg) are none: those beyond a turn, or below 0 where others are above 180."""
    return (np.abs(degrees) > TURN + 1e-6) | ((degrees < 0) & (degrees.max(initial=0.0) > 0.5 * TURN))


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
