"""Numbers of vehicle files in another unit or with the other sign: what goes untold, and what it changes."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import tomli_w

from taichi_sim.applications.commands.trials import ROTORS, WINGS, kind_of
from taichi_sim.applications.trials import ship
from taichi_sim.applications.trials.basin import Setting
from taichi_sim.applications.trials.results import Outcome, TrialError
from taichi_sim.config import ConfigError, Strict
from taichi_sim.config.io import read_toml, validate
from taichi_sim.config.plausible import findings, leaves
from taichi_sim.models.catalogue import find_model, load_vehicle, vehicle_files

MISTAKES = {"times 1,000": 1e3, "over 1,000": 1e-3, "other sign": -1.0}


class Slip(NamedTuple):
    """A number of a vehicle file and what is wrong with it."""

    file: Path
    key: str
    mistake: str

    def __str__(self) -> str:
        """As a line of a list."""
        return f"{self.file.stem}: {self.key}, {self.mistake}"

    def value(self) -> float:
        """The wrong value."""
        return MISTAKES[self.mistake] * _at(read_toml(self.file), self.key.split("."))


def numbers_of(file: Path) -> list[str]:
    """Keys of all numbers but 0 that a vehicle file gives."""
    data = read_toml(file)
    numbers = (leaf for leaf in leaves(_params(file, data)) if leaf.value)
    return [leaf.key for leaf in numbers if _at(data, leaf.key.split(".")) is not None]


def slips(file: Path) -> Iterator[Slip]:
    """Every number of a file with every mistake."""
    return (Slip(file, key, mistake) for key in numbers_of(file) for mistake in MISTAKES)


def untold(slip: Slip) -> bool:
    """Whether a wrong number is neither refused nor told."""
    try:
        return not findings(_params(slip.file, _with(read_toml(slip.file), slip.key.split("."), slip.value())))
    except ConfigError:
        return False


def write(slip: Slip, folder: Path) -> Path:
    """The vehicle file with the wrong number, in a folder of its own."""
    file = folder / slip.file.name
    data = _with(read_toml(slip.file), slip.key.split("."), slip.value())
    file.write_text(tomli_w.dumps(data))
    for other in vehicle_files(slip.file)[1:]:
        (folder / other.name).write_bytes(other.read_bytes())
    return file


def figures(file: Path, dt: float) -> dict[str, float]:
    """Figures of trials: of a vessel those of a turning circle, of an aircraft all."""
    model = load_vehicle(file, dt)
    kind, _ = kind_of(model, str(file))
    trials: list[Any] = [*{"fixed wing": WINGS, "multirotor": ROTORS}.get(kind, {}).values()]
    outcomes: list[Outcome] = []
    if kind == "vessel":
        with mock.patch.object(ship, "TURNS", 1.0):
            outcomes.append(ship.turning_circle(Setting(file, {}, dt=dt)))
    for trial in trials:
        try:
            outcomes.append(trial(model.params))
        except TrialError as refusal:
            outcomes.append(Outcome(trial.__name__, "", refused=str(refusal)))
    return {f"{f.trial} {f.case} {f.name}": f.value for out in outcomes for f in out.figures}


def change(ours: dict[str, float], theirs: dict[str, float]) -> tuple[float, str]:
    """Largest relative difference of figures, and which it is; infinite if one is missing."""
    worst = (0.0, "")
    for name, value in theirs.items():
        other = ours.get(name, math.nan)
        error = abs(other - value) / max(abs(value), 1e-6)
        worst = max(worst, (error if math.isfinite(error) else math.inf, name))
    return worst


def _params(file: Path, data: dict[str, Any]) -> Strict:
    data = json.loads(json.dumps(data))
    model = find_model(data.pop("model"), file)
    return validate(model.Params, data, str(file))


def _at(node: Any, parts: list[str]) -> Any:
    for part in parts:
        try:
            node = node[int(part)] if isinstance(node, list) else node[part]
        except (KeyError, IndexError):
            return None
    return node if isinstance(node, int | float) else None


def _with(node: Any, parts: list[str], value: float) -> Any:
    if not parts:
        return value
    if isinstance(node, list):
        return [_with(x, parts[1:], value) if str(i) == parts[0] else x for i, x in enumerate(node)]
    return node | {parts[0]: _with(node[parts[0]], parts[1:], value)}
