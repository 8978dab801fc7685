"""Results of trials: figures with their units, and curves to draw."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError

Array = NDArray[np.float64]


class TrialError(ConfigError):
    """A trial that a craft cannot do or did not complete; the message says why."""


class Figure(NamedTuple):
    """A figure of a trial, in SI units (angles in rad)."""

    trial: str
    case: str  # "starboard", "port", "10/10 starboard" ...
    run: int  # realisation of the sea
    name: str
    value: float
    unit: str  # "" for a ratio


class Curve(NamedTuple):
    """Samples of one case, for pictures and CSV files."""

    case: str
    columns: dict[str, Array]  # name with unit -> [sample]


class Panel(NamedTuple):
    """One picture of a trial: which column is drawn over which."""

    title: str
    x: str  # column
    y: str  # column
    equal: bool = False  # equal scales, for a track


@dataclass
class Outcome:
    """Results of one trial of a craft."""

    name: str
    title: str
    figures: list[Figure] = field(default_factory=list)
    curves: list[Curve] = field(default_factory=list)
    panels: tuple[Panel, ...] = ()
    refused: str = ""  # reason why it was not done

    def add(self, case: str, run: int, values: Iterable[tuple[str, float, str]]) -> None:
        """Add the figures (name, value, unit) of a case and a run."""
        self.figures += [Figure(self.name, case, run, name, float(value), unit) for name, value, unit in values]

    def mean(self, case: str, name: str) -> float:
        """Mean of a figure over all runs; NaN if there is none."""
        found = [f.value for f in self.figures if f.case == case and f.name == name]
        return float(np.mean(found)) if found else float("nan")


def crossing(x: Array, y: Array, level: float) -> float:
    """The first x at which y(x), linear between samples, reaches `level` from below; NaN if it does not."""
    above = np.flatnonzero((y[:-1] < level) & (y[1:] >= level))
    if not len(above):
        return float("nan")
    k = int(above[0])
    return float(x[k] + (x[k + 1] - x[k]) * (level - y[k]) / (y[k + 1] - y[k]))


def peaks(x: Array, y: Array) -> tuple[Array, Array]:
    """Positions and heights of the maxima of y(x), by the parabola through three evenly spaced samples."""
    k = np.flatnonzero((y[1:-1] > y[:-2]) & (y[1:-1] >= y[2:])) + 1
    left, middle, right = y[k - 1], y[k], y[k + 1]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend
    return x[k] + shift * (x[k + 1] - x[k]), middle - 0.25 * (left - right) * shift
