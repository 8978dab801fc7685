"""Plausible ranges of numbers: each is declared beside its number, and all are judged when a vehicle file is read.

    k_m: Annotated[Positive, Plausible(0.02, 0.8, "N m s^2", of="k_f radius")]

A number over its scale is plausible from `low` to `high`. A number outside is told, because it can be meant; one that
is outside by more than a factor of `far` is refused. A number of the other sign is told: types refuse signs that cannot
be. Zero is plausible where the type allows it: it means "none". Ranges are generous: they hold boats from 0.3 m to the
largest ships, and aircraft from 20 g to a few hundred kg.

Scales are products of other numbers of the file, with powers: "mass length^2". A name is looked up in the number's own
section, then in the sections around it, except for the number itself: `beam` of the section [hull] may be "of beam",
that of the vehicle. A marker on the return type of a property judges what follows from several numbers.
"""

import math
import types
import typing
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Annotated, Any, NamedTuple, Union

from pydantic import BaseModel, ValidationError

from taichi_sim.config.base import ConfigError
from taichi_sim.config.explain_errors import source_of

FAR = 10.0  # factor outside a range beyond which a number is refused; assumed
NOTHING = 1e-9  # a number over its scale below which it is 0: 0.3 m times the cosine of 90 degrees
MOST_TOLD = 3  # findings that a message lists
CONSTANTS = {"rho_sea": 1025.0, "g": 9.81}  # kg/m^3, m/s^2: scales are rough
FOOT, INCH, POUND = 0.3048, 0.0254, 0.45359237  # m, m, kg
RPM = 2 * math.pi / 60  # rad/s
MISTAKES: Mapping[str, Mapping[str, float]] = {
    "m": {"mm": 1e-3, "cm": 1e-2, "inches": INCH, "feet": FOOT, "km": 1e3},
    "m^2": {"mm^2": 1e-6, "cm^2": 1e-4, "square inches": INCH**2, "square feet": FOOT**2},
    "m^3": {"litres": 1e-3, "cm^3": 1e-6},
    "kg": {"g": 1e-3, "t": 1e3, "pounds": POUND},
    "kg m^2": {"kg mm^2": 1e-6, "kg cm^2": 1e-4, "g m^2": 1e-3},
    "kg/m^3": {"slug/ft^3": 515.379, "g/cm^3": 1e3},
    "s": {"ms": 1e-3, "minutes": 60.0},
    "N": {"kN": 1e3, "kgf": 9.80665, "pounds": 4.44822, "mN": 1e-3},
    "N m": {"kN m": 1e3, "N mm": 1e-3},
    "m/s": {"knots": 0.514444, "km/h": 1 / 3.6, "mm/s": 1e-3},
    "rad/s": {"rpm": RPM, "rev/s": 2 * math.pi},
    "1/s": {"rpm": 1 / 60, "rad/s": 0.5 / math.pi},
    "N s^2": {"N per rpm^2": RPM**-2, "N per (rev/s)^2": 0.25 / math.pi**2},
    "N m s^2": {"N m per rpm^2": RPM**-2, "N m per (rev/s)^2": 0.25 / math.pi**2},
    "deg": {"rad": 180 / math.pi, "turns": 360.0},
    "deg/s": {"rad/s": 180 / math.pi},
    "rad": {"deg": math.pi / 180},
    "1/rad": {"1/deg": 180 / math.pi},
    "A": {"mA": 1e-3},
    "V": {"mV": 1e-3},
    "ohm": {"mohm": 1e-3},
}
"""Unit -> units in which people give it by mistake, in that unit."""
SLIPS: Mapping[str, float] = {"of the other sign": -1.0, "1,000 times too large": 1e-3, "1,000 times too small": 1e3}
"""Mistakes in any unit, and the factor that mends them."""


class NumberWarning(UserWarning):
    """A number of a vehicle file is outside of what is plausible."""


@dataclass(frozen=True)
class Plausible:
    """Range of a number over its scale; see the module."""

    low: float
    high: float
    unit: str = ""
    of: str = ""  # "" is the unit itself
    far: float = FAR
    either: bool = False  # whether the range is that of the magnitude

    def outside(self, ratio: float) -> float:
        """Factor by which a number over its scale is outside: 0 inside, -1 for the other sign."""
        ratio = abs(ratio) if self.either else ratio
        if self.low <= ratio <= self.high or abs(ratio) < NOTHING:
            return 0.0
        end = self.high if ratio > self.high else self.low
        return max(ratio / end, end / ratio) if ratio * end > 0 else -1.0


class Finding(NamedTuple):
    """A number outside of its range."""

    key: str
    value: float
    range: Plausible
    scale: float

    @property
    def factor(self) -> float:
        """`Plausible.outside`."""
        return self.range.outside(self.value / self.scale)

    @property
    def absurd(self) -> bool:
        """Whether it cannot be meant."""
        return self.factor > self.range.far

    def __str__(self) -> str:
        """Key, value, plausible range."""
        low, high, unit, of = self.range.low, self.range.high, self.range.unit, self.range.of
        ends = low * self.scale, high * self.scale
        told = f"{self.key} = {self.value:.6g} {unit}".rstrip()
        told = f"{told}: plausible are {ends[0]:.3g} to {ends[1]:.3g} {unit}".rstrip()
        either = ", of either sign" if self.range.either else ""
        return told + either + (f" ({low:g} to {high:g} times {of})" if of else "")


class Leaf(NamedTuple):
    """A number of a file: its key, its value, its ranges, the sections around it from the inside out."""

    key: str
    value: float
    ranges: tuple[Plausible, ...]
    sections: tuple[BaseModel, ...]


def leaves(section: BaseModel, key: str = "", around: tuple[BaseModel, ...] = ()) -> Iterator[Leaf]:
    """All numbers of a section, with those of the sections inside it, and its judged properties."""
    chain = (section, *around)
    for name, annotation, ranges in _fields(type(section)):
        yield from _inside(annotation, getattr(section, name), f"{key}{name}", ranges, chain)
    for name, ranges in _properties(type(section)):
        yield Leaf(f"{key}{name}", float(getattr(section, name)), ranges, chain)
    for name, value in (section.__pydantic_extra__ or {}).items():  # teams of a scenario
        yield from _inside(None, value, f"{key}{name}", (), chain)


@cache
def _fields(kind: type[BaseModel]) -> list[tuple[str, Any, tuple[Plausible, ...]]]:
    fields = kind.model_fields.items()
    return [(name, f.annotation, tuple(m for m in f.metadata if isinstance(m, Plausible))) for name, f in fields]


@cache
def _properties(kind: type[BaseModel]) -> list[tuple[str, tuple[Plausible, ...]]]:
    found = {name: value for base in reversed(kind.__mro__) for name, value in vars(base).items()}
    given = ((name, x.fget.__annotations__) for name, x in found.items() if isinstance(x, property) and x.fget)
    return [(name, ranges) for name, notes in given if (ranges := _unwrapped(notes.get("return"))[1])]


@cache
def _unwrapped(kind: Any) -> tuple[Any, tuple[Plausible, ...]]:
    """A type without `Annotated` and `| None`, and the ranges there."""
    if typing.get_origin(kind) in (Union, types.UnionType):
        kind = next(one for one in typing.get_args(kind) if one is not type(None))
    if typing.get_origin(kind) is not Annotated:
        return kind, ()
    bare, *notes = typing.get_args(kind)
    return bare, tuple(note for note in notes if isinstance(note, Plausible))


def _inside(kind: Any, value: Any, key: str, ranges: tuple[Plausible, ...], chain: tuple) -> Iterator[Leaf]:
    """Numbers of a `value` of a type."""
    if isinstance(value, BaseModel):
        yield from leaves(value, f"{key}.", chain)
    elif isinstance(value, float):
        yield Leaf(key, value, ranges + _unwrapped(kind)[1], chain)
    elif isinstance(value, dict):
        for name, item in value.items():
            yield from _inside(None, item, f"{key}.{name}", (), chain)
    elif isinstance(value, tuple):
        kinds = typing.get_args(_unwrapped(kind)[0])
        kinds = kinds[:1] * len(value) if Ellipsis in kinds else kinds or (None,) * len(value)
        for i, (one, item) in enumerate(zip(kinds, value, strict=True)):
            yield from _inside(one, item, f"{key}.{i}", ranges, chain)


@cache
def _powers(of: str) -> list[tuple[str, float]]:
    return [(name, float(power or 1)) for name, _, power in (word.partition("^") for word in of.split())]


def scale_of(leaf: Leaf, of: str) -> float:
    """Product of the powers in `of`; 0 if a number is not given, or is 0."""
    scale, own = 1.0, leaf.key.rpartition(".")[2]
    for name, power in _powers(of):
        value = _lookup(name, leaf.sections[1:] if name == own else leaf.sections)
        if not value or not math.isfinite(value):
            return 0.0
        scale *= abs(value) ** power
    return scale


def _lookup(name: str, sections: tuple[BaseModel, ...]) -> float | None:
    first, *rest = name.split(".")
    for section in sections:
        value: Any = getattr(section, first, None)
        for part in rest:
            value = value[int(part)] if isinstance(value, tuple) else getattr(value, part, None)
        if value is not None:
            return float(value)
    return CONSTANTS.get(name)


def findings(params: BaseModel) -> list[Finding]:
    """Numbers of a vehicle file outside of their plausible ranges."""
    found = []
    for leaf in leaves(params):
        for marker in leaf.ranges:
            scale = scale_of(leaf, marker.of) if marker.of else 1.0
            if scale and marker.outside(leaf.value / scale):
                found.append(Finding(leaf.key, leaf.value, marker, scale))
                break
    return found


def judge(params: BaseModel, source: str, sources: Mapping[str, str] | None = None) -> None:
    """Warn of numbers that are not plausible in `params`, which were read from the file `source`; `sources` names
    another source for single keys.
    """
    found = findings(params)
    if not found:
        return
    first, origin = _mended(params, found), partial(source_of, file=source, sources=sources or {})
    told = [f"{origin(finding.key)}: {first or finding}" for finding in found[: 1 if first else MOST_TOLD]]
    if len(found) > MOST_TOLD and not first:
        told.append(f"{source}: and {len(found) - MOST_TOLD} more")
    if any(finding.absurd for finding in found):
        raise ConfigError("\n".join(told))
    warnings.warn("\n".join(told), NumberWarning, stacklevel=3)


def _mended(params: BaseModel, found: list[Finding]) -> str | None:
    """What is wrong if one number in another unit explains all findings; None otherwise."""
    keyed = {leaf.key: leaf for leaf in leaves(params)}
    flagged = {finding.key: finding for finding in found}
    scales = {name.rpartition(".")[2] for finding in found for name, _ in _powers(finding.range.of)}
    last = [key for key in keyed if key not in flagged and key.rpartition(".")[2] in scales]
    for key in (*flagged, *last):
        leaf = keyed[key]
        unit = next((marker.unit for marker in leaf.ranges), "")
        ways = [(f"in {name}", factor) for name, factor in MISTAKES.get(unit, {}).items()]
        names = {name for marker in leaf.ranges for name, power in _powers(marker.of) if power > 0}
        ways += [(f"over {name}", scale) for name in sorted(names) if (scale := scale_of(leaf, name))]
        for what, factor in (*ways, *SLIPS.items()):
            if not _changed(params, key, leaf.value * factor):
                told = str(flagged[key]) if key in flagged else f"{key} = {leaf.value:.6g} {unit}".rstrip()
                return f"{told}: is it {what}?" + ("" if key in flagged else f" With it, {found[0]}")
    return None


def _changed(params: BaseModel, key: str, value: float) -> bool:
    """Whether anything is left to find, or to refuse, with another value at `key`."""
    data: Any = params.model_dump()

    def replaced(node: Any, parts: list[str]) -> Any:
        if not parts:
            return value
        if isinstance(node, tuple):
            return tuple(replaced(x, parts[1:]) if str(i) == parts[0] else x for i, x in enumerate(node))
        return node | {parts[0]: replaced(node[parts[0]], parts[1:])}

    try:
        return bool(findings(type(params).model_validate(replaced(data, key.split(".")))))
    except (ValidationError, KeyError, TypeError):  # a property has no place in the file
        return True
