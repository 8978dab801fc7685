"""Running every checker over a directory, and its report as text and JSON."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from taichi_sim.kernels import runtime
from tests.validation.case import Case, Check, Folder
from tests.validation.registry import CHECKERS, Checker
from tests.validation.tables import InputsMissingError, TableError

PRECISIONS = ("f64", "f32")
INPUTS = "inputs missing"  # a problem of the table: it says nothing about this package


class NothingToCheckError(ValueError):
    """The directory is missing or holds no table that a checker knows."""


@dataclass(frozen=True)
class Report:
    """All checks, and the files that none looked at."""

    checks: list[Check]
    unchecked: list[str]

    @property
    def passed(self) -> bool:
        """Whether every check passed."""
        return all(check.passed for check in self.checks)

    @property
    def verdict(self) -> str:
        """How many checks there are and how many failed; those without inputs have not failed, but are not made."""
        without = sum(check.problem == INPUTS for check in self.checks)
        failed = sum(not check.passed for check in self.checks) - without
        more = f", {without} could not be made: inputs missing" if without else ""
        return f"{len(self.checks)} checks, {failed} failed{more}"

    def to_json(self) -> str:
        """As JSON; an error that could not be computed is null."""
        keys = ("table", "quantity", "precision", "error", "tolerance", "passed")
        checks = [{key: getattr(check, key) for key in keys} for check in self.checks]
        return json.dumps({"checks": checks, "unchecked": self.unchecked}, indent=1, allow_nan=False)

    def to_text(self) -> str:
        """As a table to read."""
        names = [f"{c.table}: {c.quantity}" for c in self.checks]
        width = max((len(n) for n, c in zip(names, self.checks, strict=True) if c.error is not None), default=40)
        lines = [f"{'check':{width}}  prec  {'error':>9}  {'tolerance':>9}  result"]
        for name, c in zip(names, self.checks, strict=True):
            result = "pass" if c.passed else c.problem if c.problem == INPUTS else f"FAIL {c.problem}"
            figures = f"{c.precision}  {_short(c.error)}  {_short(c.tolerance)}"
            lines.append(f"{name:{width}}  {figures}  {result.rstrip()}")
        lines.append(f"\n{self.verdict}")
        if self.unchecked:
            lines.append(f"no check for {len(self.unchecked)} files:")
            lines.extend(f"  {name}" for name in self.unchecked)
        return "\n".join(lines)


def _short(value: float | None) -> str:
    return f"{value:9.1e}" if value is not None else f"{'-':>9}"


class Job(NamedTuple):
    """A table, and a checker that knows it by its name."""

    path: Path
    checker: Checker
    numbers: dict[str, float]  # in the name

    def checks(self, folder: Folder, precision: str) -> list[Check]:
        """The checks in one precision; none if the checker declines the table, one failed check if it is unusable."""
        case = Case(folder, self.path, precision)
        try:
            self.checker.function(case, **self.numbers)
            if case.checks:
                folder.use(self.path)
        except Exception as error:  # whatever is wrong with one table must not hide the others
            folder.used.add(self.path)
            text = str(error) if isinstance(error, TableError) else f"{type(error).__name__}: {error}"
            problem = INPUTS if isinstance(error, InputsMissingError) else "cannot be used"
            case.checks.append(Check(folder.name(self.path), text, precision, None, None, False, problem))
        return case.checks


def jobs(folder: Folder, checkers: Sequence[Checker] = CHECKERS) -> list[Job]:
    """Every table in the folder with each checker that knows it."""
    found = ((path, checker, checker.match(path)) for path in folder.files() for checker in checkers)
    return [Job(path, checker, numbers) for path, checker, numbers in found if numbers is not None]


def validate(reference: Path, checkers: Sequence[Checker] = CHECKERS, bem: Path | None = None) -> Report:
    """Run this package against the tables in `reference`; `bem`: a folder for computed databases of ships (ships.py).

    Raises:
        NothingToCheckError: if the directory is missing or holds no table that a checker knows.
    """
    if not reference.is_dir():
        raise NothingToCheckError(f"{reference}: no such directory")
    folder = Folder(reference.resolve(), bem=bem)
    found = jobs(folder, checkers)
    if not found:
        raise NothingToCheckError(f"{reference}: no table that a checker knows, {len(folder.files())} other files")
    done: list[tuple[int, Check]] = []
    for precision in PRECISIONS:
        runtime.init(precision=precision, threads=1)
        for order, job in enumerate(found):
            if precision in job.checker.precisions:
                done.extend((order, check) for check in job.checks(folder, precision))
    checks = [check for _, check in sorted(done, key=lambda item: item[0])]
    return Report(checks, [folder.name(path) for path in folder.files() if path not in folder.used])
