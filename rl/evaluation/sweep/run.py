"""Evaluation of a sweep cell by cell. An interrupted sweep continues where it stopped.

RUN/sweeps/NAME/cells.jsonl          a line for each finished cell, with a hash of all that it depends on
RUN/sweeps/NAME/sweep.json, .csv     all cells, when all are finished
"""

import contextlib
import csv
import functools
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rl import processes
from rl.evaluation.episodes import judge_episodes, mission_class
from rl.evaluation.intervals import Interval, differences, intervals
from rl.evaluation.sweep.cells import Cell, cells, count_cells
from rl.evaluation.sweep.config import FOLDER, Sweep
from rl.judge import Judge
from rl.learn.policy import CheckpointError, Policy, checkpoints
from rl.mission import ControllerError
from rl.runs import folder as run_folder
from rl.runs.records import AxisTable, CellResult, CellRow, SweepAbout
from rl.scenario import Scenario
from taichi_sim.config import ConfigError
from taichi_sim.config.files import named_files
from taichi_sim.config.io import replacing, toml_text, vehicle_file
from taichi_sim.sea import SteepSeaError
from taichi_sim.world import ActionError

CELLS = "cells.jsonl"
CANNOT = (ConfigError, SteepSeaError, ControllerError, CheckpointError, ActionError)
"""Errors that make a cell impossible: scenario or sea refused, no controller, unfit policy, motion not finite."""
ESTIMATE_AFTER = 3  # cells, from which the remaining time is estimated
SIGNIFICANT = 6  # significant digits of each figure
TELL = functools.partial(tqdm.write, file=sys.stderr)  # prints above the progress bar
JSON, CSV = "sweep.json", "sweep.csv"


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
    """Run a sweep; return the folder of its tables.

    Processes (rl/processes) share the cells; rank 0 writes.

    Args:
        sweep: the content of `file`.
        file: the sweep's file.
        contest: the controllers to compare.
        show_progress: show a progress bar.
        tell: called with an estimate of the remaining time.

    Raises:
        ConfigError: if the sweep has the seed of the evaluation or of the training, or a key that no scenario has.
        KeyboardInterrupt: on Ctrl-C; the message says how to continue.
    """
    config = contest.config
    for whose, other in (("the evaluation's", config.evaluation.seed), ("the training's", config.seed)):
        if sweep.seed == other:
            raise ConfigError(f"{file}: seed = {other} is {whose}: a sweep needs another seed")
    opponent, place = contest.opponent, processes.here()
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
        done = processes.broadcast(lambda: _read(lines))
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
                for (key, _), found in zip(batch, processes.gather(measure), strict=False):
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
        about = SweepAbout(
            sweep=name, scenario=config.name, seed=sweep.seed, episodes=sweep.episodes, opponent=opponent,
            grid=sweep.grid, axes=axes,
        )  # fmt: skip
        write_tables(out, about, rows)
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


def write_tables(out: Path, about: SweepAbout, rows: Sequence[CellRow]) -> None:
    """Write `about` and the cells' `rows` (run.py) to `sweep.json`, and the same to `sweep.csv`."""
    run_folder.write_json(out / JSON, {**about, "cells": list(rows)})
    with replacing(out / CSV) as part, part.open("w", newline="", encoding="utf-8") as file:
        names = [axis["name"] for axis in about["axes"]]
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, "team", "controller", "figure", "value", "low", "high", "cannot be"])
        for row in rows:
            values = [value_text(row["values"].get(name, "")) for name in names]
            writer.writerows([*values, *line] for line in _lines(row, about["opponent"]))


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
