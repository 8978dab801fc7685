"""One table under check: where it is, what it was run in, and the comparisons made.

Errors come in three kinds, because each quantity has one sensible scale:

- `relative`: largest |ours - table| over the table's largest magnitude of that quantity. For signed
  quantities that pass through zero (velocity, normal, pressure), whose ratio to themselves means nothing.
- `elementwise`: largest |ours - table| / |table|. For positive quantities over many decades (wavenumbers).
- `absolute`: largest |ours - table| in the quantity's unit. For lengths, and the Unity sequences.

Lengths are held to both an absolute (m) and a relative error. A tolerance is the required one plus half a
unit of the table's last printed digit, which matters only where a table has fewer digits than required.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tests.validation.tables import InputsMissingError, Table, TableError

SUFFIXES = (".csv", ".json", ".toml", ".spec", ".data_spec", ".swdir", ".swdir2", ".swr1", ".swr2")  # of tables
TOLERANCE = {"f64": 1e-6, "f32": 1e-4}  # m for lengths, 1 for ratios


@dataclass(frozen=True)
class Check:
    """One row of the report; `error` is None where the table could not be used, and `problem` says why."""

    table: str
    quantity: str
    precision: str
    error: float | None
    tolerance: float | None
    passed: bool
    problem: str = ""


@dataclass
class Folder:
    """The reference directory, and which of its files have been read."""

    root: Path
    used: set[Path] = field(default_factory=set)
    bem: Path | None = None  # where computed databases of hulls are kept (remembering.py); None: not beyond this run

    @cached_property
    def computed(self) -> Path:
        """Where to keep what is computed."""
        if self.bem is not None:
            return self.bem
        self._temporary = TemporaryDirectory(prefix="validate-")
        return Path(self._temporary.name)

    def use(self, path: Path) -> Path:
        """`path`, noted as read."""
        if not path.is_file():
            raise InputsMissingError(f"{self.name(path)} is missing, and its numbers are needed")
        self.used.add(path)
        return path

    def name(self, path: Path) -> str:
        """`path` relative to the directory."""
        return path.relative_to(self.root).as_posix() if path.is_relative_to(self.root) else str(path)

    def files(self) -> list[Path]:
        """Every table and parameter file."""
        return sorted(p for p in self.root.rglob("*") if p.suffix in SUFFIXES and p.is_file())


@dataclass
class Case:
    """A table, the precision it is run in, and its checks so far."""

    folder: Folder
    path: Path
    precision: str
    checks: list[Check] = field(default_factory=list)

    def relative(self, quantity: str, ours, table, resolution=0.0) -> None:
        """Compare on the scale of the table's largest magnitude."""
        scale = float(np.max(np.abs(table), initial=0.0)) or 1.0
        self._add(quantity, ours, table, scale, TOLERANCE[self.precision], resolution)

    def elementwise(self, quantity: str, ours, table, resolution=0.0) -> None:
        """Compare on the scale of each value (of 1 where the value is zero)."""
        scale = np.where(np.asarray(table) == 0, 1.0, np.abs(table))
        self._add(quantity, ours, table, scale, TOLERANCE[self.precision], resolution)

    def absolute(self, quantity: str, ours, table, tolerance: float, resolution=0.0) -> None:
        """Compare in the quantity's own unit."""
        self._add(quantity, ours, table, 1.0, tolerance, resolution)

    def length(self, quantity: str, ours, table, resolution=0.0) -> None:
        """Compare in metres, and on the scale of the largest length."""
        self.absolute(f"{quantity}, m", ours, table, TOLERANCE[self.precision], resolution)
        self.relative(f"{quantity}, relative", ours, table, resolution)

    def columns(self, compare: Callable[..., None], table: Table, ours: dict[str, np.ndarray]) -> None:
        """Compare each column of `table` named in `ours` by one of the methods above."""
        for name, values in ours.items():
            compare(name, values, table[name], table.resolution(name))

    def _add(self, quantity: str, ours, table, scale, tolerance: float, resolution) -> None:
        ours, table = np.asarray(ours, dtype=np.float64), np.asarray(table, dtype=np.float64)
        if ours.shape != table.shape:
            raise TableError(f"{quantity}: {ours.shape} values computed for {table.shape} in the table")
        error = float(np.max(np.abs(ours - table) / scale))
        tolerance += float(np.max(resolution / scale))
        passed = bool(error <= tolerance)  # a NaN fails
        problem = "" if np.isfinite(error) else "not a finite number"
        name = self.folder.name(self.path)
        self.checks.append(
            Check(name, quantity, self.precision, error if not problem else None, tolerance, passed, problem)
        )
