"""Standards for ship manoeuvrability, IMO resolution MSC.137(76), applied to the figures of a ship's trials.

They are for ships of 100 m and more, ahead at their test speed. A model is judged as the ship that it represents:
lengths by its scale, times by the root of it (Froude).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from taichi_sim.trials.figures import Outcome

ADVANCE, TACTICAL, INITIAL, REACH, OVERSHOOT_20 = 4.5, 5.0, 2.5, 15.0, math.radians(25.0)  # lengths; rad


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
