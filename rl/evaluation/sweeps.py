"""Sweeps: policy and classical controller on the same episodes under a grid of conditions, cell by cell.

A sweep's file has axes of conditions; a cell is one set of them, as overrides of a run's scenario. An interrupted sweep
continues where it stopped.

RUN/sweeps/NAME/cells.jsonl          a line for each finished cell, with a hash of all that it depends on
RUN/sweeps/NAME/sweep.json, .csv     all cells, when all are finished
"""

import contextlib
import csv
import functools
import hashlib
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, product
from pathlib import Path
from typing import Annotated, NamedTuple, TextIO, TypedDict

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from tqdm import tqdm

from rl.evaluation.episodes import judge_episodes, mission_class
from rl.evaluation.intervals import Interval, differences, intervals
from rl.judge import Judge
from rl.learn.policy import CheckpointError, checkpoints
from rl.mission import Policy
from rl.missions import find_mission, shipped
from rl.runs import folder as run_folder
from rl.runs import ranks
from rl.scenario import Scenario
from rl.team import ControllerError
from taichi_sim.config import ConfigError, Positive, Strict
from taichi_sim.config.arguments import ActionError
from taichi_sim.config.base import Table
from taichi_sim.config.explain_errors import keys_at, meant, nearly
from taichi_sim.config.files import named_files
from taichi_sim.config.io import config_folder, read_toml, replacing, toml_text, validate, vehicle_file
from taichi_sim.surroundings.sea import SteepSeaError

FOLDER = "sweeps"  # of sweep files in configs/, and of results in a run's folder
CELLS = "cells.jsonl"
CANNOT = (ConfigError, SteepSeaError, ControllerError, CheckpointError, ActionError)
"""Errors that make a cell impossible: scenario or sea refused, no controller, unfit policy, motion not finite."""
ESTIMATE_AFTER = 3  # cells, from which the remaining time is estimated
SIGNIFICANT = 6  # significant digits of each figure
TELL = functools.partial(tqdm.write, file=sys.stderr)  # prints above the progress bar
JSON, CSV = "sweep.json", "sweep.csv"
TEAMS = "*"  # in a key: every trained team


class Axis(Strict):
    """One axis of a sweep: `[[axis]]`.

    Each of `values` is set for all `keys`, or is a list with one value for each key. `*` in a key stands for every
    trained team. Numbers are multiplied by `scale`, and by the scenario's value of the key `times`. Tables and plots
    show `labels` in place of values, if given.
    """

    name: Annotated[str, Field(min_length=1)]
    keys: tuple[Annotated[str, Field(min_length=1)], ...]
    values: tuple[object, ...]
    labels: tuple[str | int | float, ...] | None = None
    unit: str = ""  # of `values`, as printed
    scale: Positive = 1.0  # from `unit` to the unit of the keys
    times: str | None = None

    def _mistakes(self) -> Iterator[str]:
        for what, given in (("keys", self.keys), ("values", self.values)):
            if not given:
                yield f"axis {self.name!r} has no {what}: an axis sets at least one key to at least one value"
        for value in self.values:
            if isinstance(value, tuple) and len(value) != len(self.keys):
                yield f"axis {self.name!r}: {list(value)} has {len(value)} values for {len(self.keys)} keys"
            scaled = self.scale != 1.0 or self.times is not None
            if scaled and not all(isinstance(v, int | float) for v in self.of_keys(value)):
                yield f"axis {self.name!r}: {value!r} is not a number: scale and times need numbers"
        if self.labels is not None and len(self.labels) != len(self.values):
            yield f"axis {self.name!r} has {len(self.labels)} labels for {len(self.values)} values"

    def label(self, value: object) -> object:
        """The label of one of `values`."""
        return value if self.labels is None else self.labels[self.values.index(value)]

    def of_keys(self, value: object) -> tuple[object, ...]:
        """One value for each key."""
        return value if isinstance(value, tuple) else (value,) * len(self.keys)


class Sweep(Strict):
    """A sweep: each axis alone around the run's own scenario, or with `grid` the product of all axes."""

    axis: tuple[Axis, ...]
    grid: bool = False
    episodes: Annotated[int, Field(ge=2, le=100_000)] = 256  # under each condition
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 5000  # of the episodes; not the evaluation's or training's

    def _mistakes(self) -> Iterator[str]:
        names = [axis.name for axis in self.axis]
        if not names:
            yield "there is no [[axis]]: nothing is varied"
        if len(set(names)) < len(names):
            yield f"two axes of one name: {', '.join(names)}"


def find_sweep(name: str | Path) -> Path:
    """The file `name`, or the shipped sweep of that name ("default", "configs/sweeps/default.toml")."""
    path, folder = Path(name), config_folder() / FOLDER
    shipped = folder / path.with_suffix(".toml").name
    if path.is_file():
        return path
    if path.parent in (Path("."), Path("configs") / FOLDER) and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in folder.glob("*.toml")))
    raise ConfigError(f"{path}: no such sweep file; shipped sweeps: {names}")


def load_sweep(file: Path, **changes: int | None) -> Sweep:
    """Read a sweep from its file; `changes` replace single keys, unless None."""
    given: Table = {key: value for key, value in changes.items() if value is not None}
    return validate(Sweep, {**read_toml(file), **given}, str(file))


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
    """All cells for a run's scenario in order; `file` is the sweep's, for error messages."""
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
    """The reason why a scenario lacks an axis; None if it has the axis."""
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


class AxisTable(TypedDict):
    """One axis of a sweep."""

    name: str
    unit: str
    values: list[object]


class CellResult(TypedDict):
    """Figures of one cell of a sweep."""

    cannot_be: dict[str, str]  # controller -> why it could not run
    teams: dict[str, dict[str, dict[str, list[float | None]]]]
    """Team -> controller or "difference" -> figure -> value, low, high."""


class CellRow(CellResult):
    """One cell in sweep.json."""

    values: dict[str, object]  # axis -> its value
    set: list[str]  # KEY=VALUE


class SweepTable(TypedDict):
    """sweep.json."""

    sweep: str
    scenario: str
    seed: int
    episodes: int
    opponent: str
    grid: bool
    axes: list[AxisTable]
    cells: list[CellRow]


class Contest(NamedTuple):
    """The controllers to compare, and the run that they belong to."""

    run: Path  # the run's folder
    config: Scenario  # its own scenario
    source: Path  # the file of `config`
    load: Callable[[tuple[str, ...]], Scenario]  # the scenario with a cell's overrides
    controllers: Mapping[str, Mapping[str, Policy]]  # "policy" and its opponent -> team -> its policy

    @property
    def opponent(self) -> str:
        """Name of the policy's opponent: "classical", or another controller."""
        return next((who for who in self.controllers if who != "policy"), "classical")


def run_sweep(
    sweep: Sweep, file: Path, contest: Contest, *, show_progress: bool = True, tell: Callable[[str], None] = TELL
) -> Path:
    """Run a sweep, the content of `file`; return the folder of its tables.

    Processes share the cells; rank 0 writes. `tell` is called with an estimate of the remaining time.

    Raises:
        KeyboardInterrupt: on Ctrl-C; the message says how to continue.
    """
    config = contest.config
    for whose, other in (("the evaluation's", config.evaluation.seed), ("the training's", config.seed)):
        if sweep.seed == other:
            raise ConfigError(f"{file}: seed = {other} is {whose}: a sweep needs another seed")
    opponent, place = contest.opponent, ranks.here()
    name = file.stem if opponent == "classical" else f"{file.stem}-{opponent}"
    out = contest.run / FOLDER / name
    todo = cells(sweep, config, file)
    first = next(todo)  # refuses unknown keys before any file is written
    judge, total = mission_class(config, contest.source).Judge, count_cells(sweep)
    common = _key(toml_text(config), _files(contest), sweep.episodes, sweep.seed)
    keyed = [(_key(common, cell.overrides, cell.missing), cell) for cell in chain([first], todo)]
    with contextlib.ExitStack() as stack:
        if place.first:
            out.mkdir(parents=True, exist_ok=True)
            stack.enter_context(run_folder.lock(out))
            lines = stack.enter_context((out / CELLS).open("a+", encoding="utf-8"))
        done = ranks.broadcast(lambda: _read(lines))
        left = [(key, cell) for key, cell in keyed if key not in done]
        begun = total - len(left)
        shown = show_progress and place.first
        bar = stack.enter_context(
            tqdm(total=total, initial=begun, desc=f"sweep {file.stem}", unit="cell", disable=not shown)
        )
        start = time.perf_counter()
        try:
            for turn in range(0, len(left), place.count):
                batch = left[turn : turn + place.count]
                mine = batch[place.rank][1] if place.rank < len(batch) else None
                measure = functools.partial(_measure, mine, sweep, contest, judge)
                for (key, _), found in zip(batch, ranks.gather(measure), strict=False):
                    done[key] = found
                    lines.write(json.dumps({"key": key} | found) + "\n")
                    lines.flush()
                    bar.update(1)
                now = turn + len(batch)
                if place.first and turn < ESTIMATE_AFTER <= now < len(left):
                    tell(_estimate(len(left) - now, now, time.perf_counter() - start))
        except KeyboardInterrupt as interrupt:
            finished = sum(key in done for key, _ in keyed)
            text = f"{finished} of {total} cells are in {out}; the same command continues"
            raise type(interrupt)(text) from None
    if place.first:
        rows = [CellRow(values=cell.values, set=list(cell.overrides), **done[key]) for key, cell in keyed]
        axes = [AxisTable(name=a.name, unit=a.unit, values=[a.label(v) for v in a.values]) for a in sweep.axis]
        table = SweepTable(
            sweep=name, scenario=config.name, seed=sweep.seed, episodes=sweep.episodes, opponent=opponent,
            grid=sweep.grid, axes=axes, cells=rows,
        )  # fmt: skip
        write_tables(out, table)
    return out


def _measure(cell: Cell | None, sweep: Sweep, contest: Contest, judge: type[Judge]) -> CellResult:
    """Run both controllers on a cell's episodes: team -> controller or "difference" -> figure -> (value, low, high)."""
    if cell is None:
        return {"cannot_be": {}, "teams": {}}  # fewer cells are left than there are processes
    cannot: dict[str, str] = {}
    found: dict[str, dict[str, dict[str, NDArray[np.float64]]]] = {}
    for who, policies in contest.controllers.items():
        if cell.missing:
            cannot[who] = cell.missing
            continue
        try:
            config = contest.load(cell.overrides)
            outcome = judge_episodes(
                config, policies, episodes=sweep.episodes, seed=sweep.seed, source=contest.source, show_progress=False
            )
            found[who] = outcome.episodes
        except CANNOT as error:
            cannot[who] = str(error)
    teams: dict[str, dict[str, dict[str, list[float | None]]]] = {}
    for who, of_teams in found.items():
        for team, episodes in of_teams.items():
            teams.setdefault(team, {})[who] = _rounded(intervals(judge, episodes))
    for team in teams:
        if set(teams[team]) == {"policy", contest.opponent}:
            pair = found["policy"][team], found[contest.opponent][team]
            teams[team]["difference"] = _rounded(differences(judge, *pair))
    return {"cannot_be": cannot, "teams": teams}


def _rounded(figures: Mapping[str, Interval]) -> dict[str, list[float | None]]:
    return {
        name: [None if x is None else float(f"{x:.{SIGNIFICANT}g}") for x in interval]
        for name, interval in figures.items()
    }


def _estimate(left: int, done: int, taken: float) -> str:
    seconds = left * taken / done
    units = ((86400, "days"), (3600, "h"), (60, "min"), (1, "s"))
    size, unit = next((s, u) for s, u in units if seconds >= s or s == 1)
    return (
        f"{left} cells left, about {seconds / size:.1f} {unit} (the first {done} took {taken / done:.2g} s each); "
        "after Ctrl-C the same command continues"
    )


def _files(contest: Contest) -> list[str]:
    """Digests of the policies' and vehicles' files."""
    config = contest.config
    files = [checkpoints(contest.run / team)[-1] for team in config.trained if checkpoints(contest.run / team)]
    files += [vehicle_file(section, contest.source) for section in config.teams.values()]
    files += sum(named_files(config).values(), [])
    return [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]


def _key(*parts: object) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:24]


def _read(lines: TextIO) -> dict[str, CellResult]:
    """The finished cells by hash; a line that a kill has cut short is removed from the file."""
    lines.seek(0)
    done: dict[str, CellResult] = {}
    whole = 0
    for line in iter(lines.readline, ""):
        try:
            row = json.loads(line)
            done[row.pop("key")] = row
        except (ValueError, KeyError, AttributeError):
            break
        whole = lines.tell()
    lines.truncate(whole)
    return done


def write_tables(out: Path, table: SweepTable) -> None:
    """Write `table` to `sweep.json` and to `sweep.csv`."""
    run_folder.write_json(out / JSON, table)
    with replacing(out / CSV) as part, part.open("w", newline="", encoding="utf-8") as file:
        names = [axis["name"] for axis in table["axes"]]
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, "team", "controller", "figure", "value", "low", "high", "cannot be"])
        for row in table["cells"]:
            values = [value_text(row["values"].get(name, "")) for name in names]
            writer.writerows([*values, *line] for line in _lines(row, table["opponent"]))


def value_text(value: object) -> str:
    """The value of an axis as printed."""
    if isinstance(value, list | tuple):
        return ", ".join(map(value_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def named(who: str, opponent: str) -> str:
    """The name in tables of a controller, or of the "difference" from its `opponent`."""
    return f"policy - {opponent}" if who == "difference" else who


def _lines(row: CellRow, opponent: str) -> Iterator[list[str | float]]:
    """A line for each figure of a cell, and for each controller that could not run."""
    for who, reason in row["cannot_be"].items():
        yield ["", named(who, opponent), "", "", "", "", " ".join(reason.split())]
    for team, of_team in row["teams"].items():
        for who, figures in of_team.items():
            for figure, numbers in figures.items():
                yield [team, named(who, opponent), figure, *("" if x is None else x for x in numbers), ""]
