"""Standards for ship manoeuvrability, IMO resolution MSC.137(76), of figures of a ship's trials.

They are for ships of 100 m and more, ahead at their test speed. A model is judged as the ship that it is a model of:
lengths by its scale, times by the root of it (Froude).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from taichi_sim.trials.figures import Outcome

ADVANCE, TACTICAL, INITIAL, REACH, OVERSHOOT_20 = 4.5, 5.0, 2.5, 15.0, math.radians(25.0)  # lengths; rad


class Criterion(NamedTuple):
    """A figure beside its limit."""

    name: str
    case: str
    value: float
    limit: float
    unit: str

    @property
    def met(self) -> bool:
        """Whether the figure keeps to the limit."""
        return self.value <= self.limit


def first_overshoot_limit(slowness: float) -> float:
    """Of a 10/10 zigzag, rad: 10 degrees where L / V < 10 s, 20 from 30 s on, 5 + (L / V) / 2 between."""
    return math.radians(min(max(5.0 + 0.5 * slowness, 10.0), 20.0))


def second_overshoot_limit(slowness: float) -> float:
    """Of a 10/10 zigzag, rad: 25 degrees where L / V < 10 s, 40 from 30 s on, 17.5 + 0.75 (L / V) between."""
    return math.radians(min(max(17.5 + 0.75 * slowness, 25.0), 40.0))


def criteria(outcomes: Sequence[Outcome], length: float, scale: float = 1.0) -> list[Criterion]:
    """Those of MSC.137(76) that the trials tell of, of a vessel of `length` (m), a model at 1 : `scale`."""
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
