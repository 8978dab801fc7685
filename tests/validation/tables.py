"""Reading reference tables strictly: whatever is wrong with one is a TableError that names where."""

import json
import re
import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

UNEVEN = 1e-3  # of an interval, by which evenly spaced times may differ as printed
FEWEST_DIGITS = 6  # printed by "%g": a table with fewer holds exact values


class TableError(ValueError):
    """A table that cannot be used; the message says where and why."""


class InputsMissingError(TableError):
    """A table whose inputs are missing or contradict it: it says nothing about the physics."""


@dataclass(frozen=True)
class Table:
    """A CSV of numbers: header cells and the text of each row."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @cached_property
    def _index(self) -> dict[str, int]:
        """Full header cells, and their names without a unit or remark in brackets or after an equals sign."""
        short = {re.split(r"[(=\[]", name)[0]: i for i, name in reversed(list(enumerate(self.header)))}
        return short | {name: i for i, name in enumerate(self.header)}

    def __contains__(self, name: str) -> bool:
        """Whether there is a column of that name."""
        return name in self._index

    def __getitem__(self, name: str) -> np.ndarray:
        """A column, float64 [row]; "depth_m" finds "depth_m(-1=deep)".

        Raises:
            TableError: if it is missing or holds anything but finite numbers.
        """
        values = np.array([self._number(name, row, cell) for row, cell in enumerate(self._cells(name))])
        return values

    def resolution(self, name: str) -> np.ndarray:
        """Half a unit of the last digit of each cell [row]: rounding of the table itself.

        All numbers are taken as printed with as many significant digits as the longest one in the table.
        """
        digits = max(FEWEST_DIGITS, max(len(_significant(cell)) for row in self.rows for cell in row))
        magnitude = np.abs(self[name])
        exponent = np.floor(np.log10(np.where(magnitude > 0, magnitude, 1.0)))
        return np.where(magnitude > 0, 0.5 * 10.0 ** (exponent + 1 - digits), 0.0)

    def where(self, keep: np.ndarray) -> "Table":
        """The rows for which `keep` holds."""
        return Table(self.header, tuple(row for row, use in zip(self.rows, keep, strict=True) if use))

    def _cells(self, name: str) -> list[str]:
        if name not in self._index:
            raise TableError(f"column {name!r} is missing; there are {', '.join(self.header)}")
        return [row[self._index[name]] for row in self.rows]

    def _number(self, name: str, row: int, cell: str) -> float:
        try:
            value = float(cell)
        except ValueError:
            value = float("nan")
        if not np.isfinite(value):
            raise TableError(f"column {name!r}, row {row + 2}: {cell!r} is not a finite number")
        return value


def even_interval(t: np.ndarray) -> float:
    """The one time (s) from row to row of a column of times.

    Raises:
        TableError: if rows are not evenly spaced in time, but for rounding.
    """
    intervals = np.diff(t)
    if intervals.size == 0 or intervals.min() <= 0 or np.ptp(intervals) > UNEVEN * intervals.mean():
        raise TableError("column 't': rows must be evenly spaced in time")
    return float(intervals.mean())


def read_csv(path: Path) -> Table:
    """The table in a CSV file; commas inside brackets of a header cell do not separate.

    Raises:
        TableError: if it is unreadable, empty, or its rows differ in length.
    """
    lines = [line for line in _text(path).splitlines() if line.strip()]
    if len(lines) < 2:
        raise TableError("the table has no rows")
    header = tuple(cell.strip().strip('"') for cell in re.split(r",(?![^(]*\))", lines[0]))
    rows = tuple(tuple(cell.strip() for cell in line.split(",")) for line in lines[1:])
    for number, row in enumerate(rows):
        if len(row) != len(header):
            raise TableError(f"row {number + 2} has {len(row)} cells, the header has {len(header)}")
    return Table(header, rows)


def read_json(path: Path) -> Any:
    """The value in a JSON file."""
    try:
        return json.loads(_text(path))
    except ValueError as error:
        raise TableError(f"not valid JSON: {error}") from None


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file."""
    try:
        return tomllib.loads(_text(path))
    except tomllib.TOMLDecodeError as error:
        raise TableError(f"not valid TOML: {error}") from None


def number(record: Any, *keys: str) -> float:
    """The finite number at `keys` of nested JSON or TOML sections.

    Raises:
        TableError: naming the key, if it is missing or not a number.
    """
    value = record
    for depth, key in enumerate(keys):
        if not isinstance(value, dict) or key not in value:
            raise TableError(f"key {'.'.join(keys[: depth + 1])!r} is missing")
        value = value[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise TableError(f"key {'.'.join(keys)!r}: {value!r} is not a finite number")
    return float(value)


def records(data: Any, key: str) -> list[dict[str, Any]]:
    """The non-empty list of objects at `key`."""
    rows = data.get(key) if isinstance(data, dict) else None
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise TableError(f"key {key!r} is not a list of objects")
    return rows


def numbers(rows: list[dict[str, Any]], key: str) -> np.ndarray:
    """The numbers at `key` of each record, float64 [row]."""
    return np.array([number(row, key) for row in rows])


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"cannot be read: {error}") from None


def _significant(cell: str) -> str:
    """Digits of a printed number from the first that is not zero."""
    return re.split("[eE]", cell)[0].translate(str.maketrans("", "", "+-.")).lstrip("0")
