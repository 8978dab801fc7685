"""Results of trials: figures with their units, curves to draw, and IMO's criteria for ships.

Criteria are those of IMO resolution MSC.137(76), for ships of 100 m and more, ahead at their test speed. A model is
judged as the ship that it represents: lengths by its scale, times by the root of it (Froude).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from taichi_sim.config import ConfigError
from taichi_sim.config.plausible import Leaf, Plausible, leaves, scale_of

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


class Credible(NamedTuple):
    """A range in which a figure of every vessel lies, and what is likely missing in a file whose vessel is outside."""

    trial: str  # how its name begins
    figure: str  # likewise
    low: float
    high: float
    causes: tuple[str, ...]  # of CAUSES


CAUSES: Mapping[str, tuple[str, ...]] = {
    "cross-flow drag": (
        "hydrodynamics.cross_flow_coefficient", "hydrodynamics.quadratic.1", "Y_vv", "hull.Y_vvv", "mmg.hull.Y_vvv",
    ),
    "damping of sway": ("hydrodynamics.linear.1", "Y_v", "hull.Y_v", "mmg.hull.Y_v"),
    "added mass of sway": ("hydrodynamics.added_mass.1", "Y_vdot", "hull.m_y"),
    "damping of yaw": (
        "hydrodynamics.linear.5", "hydrodynamics.quadratic.5", "N_r", "N_rr", "hull.N_r", "mmg.hull.N_r",
    ),
    "added inertia of yaw": ("hydrodynamics.added_mass.5", "N_rdot", "hull.J_z"),
    "resistance": (
        "hydrodynamics.linear.0", "hydrodynamics.quadratic.0", "X_u", "X_uu", "X_uuu", "hull.R_0", "mmg.hull.R_0",
    ),
}  # fmt: skip
"""What a vessel needs -> keys of vehicle files that give it; one of them is enough."""
ASIDE = ("cross-flow drag", "added mass of sway", "damping of sway")
CREDIBLE = (  # assumed: wider than figures of published ships and boats, which turn in 1.5 to 6 lengths
    Credible("turning", "tactical diameter over length", 1.0, math.inf, (*ASIDE, "damping of yaw")),
    Credible("turning", "steady drift angle", -math.radians(45.0), math.radians(45.0), ASIDE),
    Credible("zigzag", "overshoot", -math.inf, math.radians(90.0), ("damping of yaw", *ASIDE, "added inertia of yaw")),
)
FULL_AHEAD = "100%"  # case of a speed trial
BALANCE = 1.5  # largest ratio of a speed sailed to that at which thrust and resistance balance, either way; assumed


class Doubt(NamedTuple):
    """A figure that no vessel has, and why that may be."""

    trial: str
    case: str
    name: str
    value: float
    unit: str
    why: str

    def __str__(self) -> str:
        """One line; angles in degrees."""
        factor, unit = (math.degrees(1.0), "deg") if self.unit == "rad" else (1.0, self.unit)
        value = f"{self.value * factor:.4g} {unit}".rstrip()
        return f"{self.trial}, {self.case}: {self.name} = {value}: {self.why}"


def doubts(outcomes: Sequence[Outcome], params: BaseModel) -> list[Doubt]:
    """Figures that no vessel has, of one with the numbers `params`."""
    balance = getattr(params, "top_speed", 0.0)
    speeds = Credible("speed", "speed", balance / BALANCE, balance * BALANCE, ("resistance",))
    numbers, found = {leaf.key: leaf for leaf in leaves(params)}, []
    for out in outcomes:
        for case, name, unit in dict.fromkeys((f.case, f.name, f.unit) for f in out.figures):
            value, at_full = out.mean(case, name), balance > 0 and case == FULL_AHEAD
            for c in (*CREDIBLE, *([speeds] if at_full else [])):
                if out.name.startswith(c.trial) and name.startswith(c.figure) and not c.low <= value <= c.high:
                    why = "; ".join(said for cause in c.causes if (said := _missing(cause, numbers)))
                    rest = f"thrust balances resistance at {balance:.3g} m/s" if c is speeds else "nothing is missing"
                    found.append(Doubt(out.title, case, name, value, unit, why or rest))
    return found


def _missing(cause: str, numbers: Mapping[str, Leaf]) -> str:
    """Says that a vehicle file has nothing for a cause, or less than is plausible; empty if it has something."""
    given = [numbers[key] for key in CAUSES[cause] if key in numbers]
    few = [leaf for leaf in given if leaf.value == 0.0 or any(_less(leaf, marker) for marker in leaf.ranges)]
    if not given or len(few) < len(given):
        return ""
    return f"no {cause}? " + ", ".join(f"{leaf.key} = {leaf.value:g}" for leaf in few)


def _less(leaf: Leaf, marker: Plausible) -> bool:
    scale = scale_of(leaf, marker.of)
    return bool(scale) and abs(leaf.value / scale) < min(abs(marker.low), abs(marker.high))


class Criterion(NamedTuple):
    """A figure and its limit."""

    name: str
    case: str
    value: float
    limit: float
    unit: str
    credible: bool = True

    @property
    def met(self) -> bool:
        """Whether the figure is within the limit, and can be believed."""
        return self.value <= self.limit and self.credible

    @property
    def judgement(self) -> str:
        """In a word or two."""
        return "met" if self.met else "NOT MET" if self.credible else "DOUBTED"


@dataclass(frozen=True)
class TrialsReport:
    """Results of all trials of a craft."""

    vehicle: str
    kind: str
    conditions: str
    outcomes: list[Outcome]
    criteria: list[Criterion]
    length: float
    doubts: list[Doubt] = field(default_factory=list)


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


def criteria(
    outcomes: Sequence[Outcome], length: float, scale: float = 1.0, doubted: Sequence[Doubt] = ()
) -> list[Criterion]:
    """Criteria of MSC.137(76) for which the trials have figures. The vessel of `length` (m) is a model at 1 :
    `scale`. None is met by a trial with a `doubted` figure.
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
                    believed = not any(doubt.trial == out.title and doubt.case == case for doubt in doubted)
                    found.append(Criterion(f"{out.title}: {name}", case, value, limit, unit, believed))
    return found
