"""Results of trials: figures with their units, curves to draw, and IMO's criteria for ships.

Criteria are those of IMO resolution MSC.137(76), for ships of 100 m and more, ahead at their test speed. A model is
judged as the ship that it represents: lengths by its scale, times by the root of it (Froude).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError

Array = NDArray[np.float64]
ADVANCE, TACTICAL, INITIAL, REACH, OVERSHOOT_20 = 4.5, 5.0, 2.5, 15.0, math.radians(25.0)  # lengths; rad


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


class Criterion(NamedTuple):
    """A figure and its limit."""

    name: str
    case: str
    value: float
    limit: float
    unit: str

    @property
    def met(self) -> bool:
        """Whether the figure is within the limit."""
        return self.value <= self.limit


@dataclass(frozen=True)
class TrialsReport:
    """Results of all trials of a craft."""

    vehicle: str
    kind: str
    conditions: str
    outcomes: list[Outcome]
    criteria: list[Criterion]
    length: float


def first_overshoot_limit(slowness: float) -> float:
    """Limit of the first overshoot of a 10/10 zigzag, rad; slowness is L / V (s).

    10 degrees for L / V < 10 s, 20 degrees from 30 s, 5 + (L / V) / 2 degrees between.
    """
    return math.radians(min(max(5.0 + 0.5 * slowness, 10.0), 20.0))


def second_overshoot_limit(slowness: float) -> float:
    """Limit of the second overshoot of a 10/10 zigzag, rad; slowness is L / V (s).

    25 degrees for L / V < 10 s, 40 degrees from 30 s, 17.5 + 0.75 (L / V) degrees between.
    """
    return math.radians(min(max(17.5 + 0.75 * slowness, 25.0), 40.0))


def criteria(outcomes: Sequence[Outcome], length: float, scale: float = 1.0) -> list[Criterion]:
    """Criteria of MSC.137(76) for which the trials have figures. The vessel of `length` (m) is a model at 1 :
    `scale`.
    """
    found = []
    for out in outcomes:
        for case in dict.fromkeys(f.case for f in out.figures):
            speed = out.mean(case, "approach speed")
            slowness = math.sqrt(scale) * length / speed if speed > 0 else math.nan
            limits = {
                "turning": (("advance over length", ADVANCE, ""), ("tactical diameter over length", TACTICAL, "")),
                "zigzag10_10": (
                    ("initial turning distance over length", INITIAL, ""),
                    ("overshoot 1", first_overshoot_limit(slowness), "rad"),
                    ("overshoot 2", second_overshoot_limit(slowness), "rad"),
                ),
                "zigzag20_20": (("overshoot 1", OVERSHOOT_20, "rad"),),
                "stop": (("track reach over length", REACH, ""),),
            }.get(out.name, ())
            for name, limit, unit in limits:
                value = out.mean(case, name)
                if not math.isnan(value):
                    found.append(Criterion(f"{out.title}: {name}", case, value, limit, unit))
    return found
