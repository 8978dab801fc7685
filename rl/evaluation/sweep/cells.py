"""The cells of a sweep: sets of conditions, each as overrides of a run's scenario."""

import json
import math
from collections.abc import Iterator, Mapping
from itertools import chain, product
from pathlib import Path
from typing import NamedTuple

from rl.evaluation.sweep.config import Axis, Sweep
from rl.missions import find_mission, shipped
from rl.scenario import Scenario
from taichi_sim.config import ConfigError
from taichi_sim.config.explain import keys_at, meant, nearly

TEAMS = "*"  # in a key: every trained team


class Cell(NamedTuple):
    """One set of conditions."""

    values: dict[str, object]  # axis -> its value, as in the file; other axes keep the run's value
    overrides: tuple[str, ...]  # KEY=VALUE
    missing: str | None  # why this scenario lacks an axis


def count_cells(sweep: Sweep) -> int:
    """Number of cells: with `grid` the product of the axes; else one a value, and one for the run's own conditions."""
    lengths = [len(axis.values) for axis in sweep.axis]
    return math.prod(lengths) if sweep.grid else 1 + sum(lengths)


def cells(sweep: Sweep, config: Scenario, file: Path) -> Iterator[Cell]:
    """All cells in order.

    Args:
        sweep: the sweep.
        config: the run's scenario.
        file: the sweep's file, for error messages.

    Raises:
        ConfigError: before the first cell, if no scenario has one of the keys.
    """
    missing = {axis.name: _missing(axis, config, file) for axis in sweep.axis}
    if sweep.grid:
        chosen = (tuple(zip(sweep.axis, values, strict=True)) for values in product(*(a.values for a in sweep.axis)))
    else:
        alone = (((axis, value),) for axis in sweep.axis for value in axis.values)
        chosen = chain([()], alone)
    for given in chosen:
        reason = next((missing[axis.name] for axis, _ in given if missing[axis.name]), None)
        overrides = () if reason else tuple(text for axis, value in given for text in _set(axis, value, config))
        yield Cell({axis.name: axis.label(value) for axis, value in given}, overrides, reason)


def _set(axis: Axis, value: object, config: Scenario) -> Iterator[str]:
    """The overrides that set an axis to a value."""
    times = 1.0 if axis.times is None else _value(config, axis.times)
    assert isinstance(times, int | float)  # `_missing` has looked
    factor = axis.scale * times
    for key, given in zip(axis.keys, axis.of_keys(value), strict=True):
        for name in _every(key, config):
            if isinstance(given, str):
                yield f"{name}={given}"
            elif factor == 1.0:
                yield f"{name}={json.dumps(given)}"
            else:
                assert isinstance(given, int | float)  # `Axis` has looked
                whole = isinstance(_value(config, name), int)
                yield f"{name}={round(given * factor) if whole else given * factor}"


def _every(key: str, config: Scenario) -> list[str]:
    """A key as a list; one that begins with `*` gives a key for each trained team."""
    return [key.replace(TEAMS, team, 1) for team in config.trained] if key.startswith(f"{TEAMS}.") else [key]


def _value(config: object, key: str) -> object:
    """The scenario's value of a key; None if it has none."""
    for part in key.split("."):
        config = getattr(config, part, None)
    return config


def _missing(axis: Axis, config: Scenario, file: Path) -> str | None:
    """The reason why a scenario lacks an axis; None if it has the axis.

    Raises:
        ConfigError: if no mission has such a key.
    """
    reasons = []
    for key in (*axis.keys, *([axis.times] if axis.times else [])):
        for name in _every(key, config):
            reasons.append(_absent(name, config, f"{file}: axis {axis.name!r}: {name}"))
    if axis.times and not any(reasons) and not isinstance(_value(config, axis.times), int | float):
        reasons.append(f"{axis.times} is not given in this scenario")
    return next((reason for reason in reasons if reason), None)


def _absent(key: str, config: Scenario, place: str) -> str | None:
    kind, parts = type(config), key.split(".")
    wrong = _unknown(kind, parts, config.teams)
    if wrong is None:
        return None
    if any(_unknown(find_mission(name).Config, parts, config.teams) is None for name in shipped()):
        return f"{key}: the mission {config.mission!r} has no such key"
    known = {*keys_at(kind, ()), *config.teams}
    of_team = len(parts) > 1 and _unknown(kind, parts, {parts[0]: None}) is None
    if of_team and parts[0] not in kind.model_fields and not nearly(parts[0], known):
        return f"{key}: the scenario has no team {parts[0]!r}"
    depth, allowed = wrong
    raise ConfigError(f"{place}: unknown key{meant(parts[depth], allowed)}; allowed here: {', '.join(sorted(allowed))}")


def _unknown(kind: type[Scenario], parts: list[str], teams: Mapping[str, object]) -> tuple[int, list[str]] | None:
    """Position of the first part of a key that the scenario lacks, and the allowed names; None without such a part."""
    for depth, part in enumerate(parts):
        allowed = keys_at(kind, tuple(parts[:depth])) + (list(teams) if depth == 0 else [])
        if parts[depth - 1 : depth] == ["vary"]:
            return None  # below `vary`, keys are paths
        if part not in allowed:
            return depth, allowed
    return None
