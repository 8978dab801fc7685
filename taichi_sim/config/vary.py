"""Ranges from which numbers are drawn for each environment, in tables by key.

    [usv.vary]                                      # numbers of each vehicle of a team, drawn for every episode
    "rigid_body.mass" = { factor = [0.9, 1.2] }

    [vary]                                          # sea and air, one draw for each realisation of the sea
    "sea.hs" = [0.2, 1.0]                           # the same as { range = [0.2, 1.0] }
    "air.direction_deg" = { add = [-30, 30], distribution = "normal" }

Keys are dotted; nested TOML tables (`rigid_body.mass = ...`) are equivalent.
"""

import difflib
from collections.abc import Iterator, Mapping
from typing import Annotated, Literal, overload

from pydantic import BeforeValidator, model_validator

from taichi_sim.config.base import Finite, Strict, Table

WAYS = ("range", "factor", "add")  # alternatives for giving a range

SIZE = ("sea.hs", "sea.tp", "sea.sea_state")
CONDITIONS: Mapping[str, tuple[float, float]] = {
    "sea.hs": (0.0, 15.0),  # m
    "sea.tp": (0.5, 30.0),  # s
    "sea.sea_state": (0.0, 6.0),  # between the middles of WMO's codes
    "sea.direction_deg": (-3600.0, 3600.0),
    "sea.current.speed": (0.0, 10.0),  # m/s
    "sea.current.direction_deg": (-3600.0, 3600.0),
    "air.speed": (0.0, 60.0),  # m/s
    "air.direction_deg": (-3600.0, 3600.0),
    "air.turbulence": (0.0, 10.0),  # factor of the intensity, 1
}
"""Conditions of sea and air that may vary, with their allowed bounds (randomisation/conditions.py)."""

FIXED_BY: Mapping[str, tuple[str, ...]] = {
    **{f"sea.{key}": SIZE for key in ("hs", "tp", "sea_state", "wind_speed", "fetch")},
    "sea.follows_wind": (*SIZE, "sea.direction_deg"),
    "sea.record": (*SIZE, "sea.direction_deg"),
    "air.beaufort": ("air.speed",),
    "air.series": ("air.speed", "air.direction_deg"),
    "sea.current.series": ("sea.current.speed", "sea.current.direction_deg"),
}
"""Key of a scenario -> other conditions that it fixes, so that they are no longer drawn (io.py)."""

Pair = tuple[Finite, Finite]


class Range(Strict):
    """A range to draw a number from, given in exactly one way; a plain list is a `range`.

    The world's `variation` scales the range about the nominal value, which the file itself gives: at 1 the range is as
    given, at 0 it is the nominal value alone. Between and beyond, both ends move in proportion, whether or not the
    range contains the nominal value.
    """

    range: Pair | None = None  # the lowest and the highest value
    factor: Pair | None = None  # factors of the nominal value
    add: Pair | None = None  # terms added to the nominal value
    distribution: Literal["uniform", "normal"] = "uniform"  # normal: the ends are 2 standard deviations from the middle

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, given: object) -> object:
        return {"range": tuple(given)} if isinstance(given, list | tuple) else given

    def _mistakes(self) -> Iterator[str]:
        given = [way for way in WAYS if getattr(self, way) is not None]
        if len(given) != 1:
            yield f"give exactly one of {', '.join(WAYS)}; given: {', '.join(given) or 'none'}"
        low, high = getattr(self, given[0])
        if low > high:
            yield f"{given[0]} = [{low:g}, {high:g}]: the first must not be above the second"

    @property
    def way(self) -> str:
        """The name in `WAYS` of the key that gives it."""
        return next(way for way in WAYS if getattr(self, way) is not None)

    def ends(self, nominal: float, variation: float = 1.0) -> tuple[float, float]:
        """Lowest and highest value for a `nominal` value."""
        pair = getattr(self, self.way)
        if self.way == "factor" and nominal == 0.0:
            raise ValueError(f"factor = {list(pair)} changes nothing, for the nominal value is 0: use add or range")
        given = {"range": pair, "factor": [nominal * x for x in pair], "add": [nominal + x for x in pair]}[self.way]
        low, high = sorted(given if variation == 1.0 else [nominal + variation * (x - nominal) for x in given])
        return low, high

    def __str__(self) -> str:
        """The range as written in a file."""
        shape = "" if self.distribution == "uniform" else f', distribution = "{self.distribution}"'
        return f"{{ {self.way} = {list(getattr(self, self.way))}{shape} }}"


@overload
def flattened(table: dict) -> Table: ...
@overload
def flattened(table: object) -> object: ...
def flattened(table: object) -> object:
    """A table of ranges with dotted keys in place of nested tables; other values unchanged."""
    if not isinstance(table, dict):
        return table
    flat: Table = {}
    for key, value in table.items():
        if isinstance(value, dict) and not _is_range(value):
            flat |= {f"{key}.{inner}": item for inner, item in flattened(value).items()}
        else:
            flat[key] = value
    return flat


def _is_range(table: dict) -> bool:
    """Whether a table is one range: at least one key is, or resembles, a key of a range."""
    return not table or any(difflib.get_close_matches(str(key), Range.model_fields, n=1, cutoff=0.7) for key in table)


def with_range(table: dict, key: str, value: object) -> Table:
    """A table of ranges with `key` set to `value`; "KEY.factor" (range, add, distribution) sets one part of a range.

    Like any override, it removes other ways of giving that range, and other sizes of the sea.
    """
    flat = dict(flattened(table))
    head, _, last = key.rpartition(".")
    if head and last in Range.model_fields:
        old = flat.get(head, {})
        kept = dict(old) if isinstance(old, dict) else {"range": old}
        if last in WAYS:
            kept = {name: item for name, item in kept.items() if name not in WAYS}
        key, value = head, {**kept, last: value}
    taken_back = {"sea.sea_state": SIZE[:2], "sea.hs": SIZE[2:], "sea.tp": SIZE[2:]}.get(key, ())
    return {name: item for name, item in flat.items() if name not in taken_back} | {key: value}


Ranges = Annotated[dict[str, Range], BeforeValidator(flattened)]
"""Dotted key -> the range from which its value is drawn."""
