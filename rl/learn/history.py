"""Tables of a training in a team's folder: progress.csv, a row for each iteration, and checkups.csv."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.mission import History
from taichi_sim.config.io import replacing

HISTORY, CHECKUPS = "progress.csv", "checkups.csv"
COLUMNS = (  # the mission's logs follow
    "iteration", "agent_steps", "wall_time_s", "reward_per_step", "policy_loss", "value_loss", "entropy",
    "action_std", "learning_rate",
)  # fmt: skip


def read_rows(file: Path) -> list[dict[str, str]]:
    """The rows of a table in a CSV file; none if there is no file."""
    if not file.is_file():
        return []
    with file.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream, restval=""))


def write_rows(file: Path, rows: Sequence[Mapping[str, object]], columns: Sequence[str] = ()) -> None:
    """Write a table as a CSV file: `columns`, or those of the last row."""
    with replacing(file) as part, part.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns or list(rows[-1]), extrasaction="ignore")
        writer.writeheader()
        writer.writerows({k: "" if v is None else v for k, v in row.items()} for row in rows)


def trim_history(file: Path, done: int, columns: Sequence[str] = COLUMNS) -> float:
    """Drop rows of progress.csv after iteration `done`, the last checkpoint; return the seconds up to it."""
    rows = [r for r in read_rows(file) if r["iteration"].isdigit() and int(r["iteration"]) < done]
    if file.is_file():
        write_rows(file, rows, columns)
    return float(rows[-1]["wall_time_s"]) if rows else 0.0


class Spent(NamedTuple):
    """Time and steps of a team's training so far."""

    seconds: float
    agent_steps: int


def spent(file: Path, iterations: int | None = None) -> Spent:
    """Time and steps of the first `iterations` (default all) in progress.csv, with those before a resumption."""
    history = read_history(file) if file.is_file() else {}
    seconds, steps = (history.get(name, np.empty(0))[:iterations] for name in ("wall_time_s", "agent_steps"))
    return Spent(float(seconds[-1]), int(steps[-1])) if len(steps) else Spent(0.0, 0)


def read_history(path: Path) -> dict[str, NDArray[np.float64]]:
    """The columns of a team's progress.csv; a blank is NaN."""
    return _columns(read_rows(path), list(COLUMNS))


def team_history(folder: Path) -> History:
    """What the folder of a team in a run tells of its training."""
    rows = read_rows(folder / CHECKUPS)
    of_each = {who: [{k: v for k, v in row.items() if k != "controller"} for row in rows if row["controller"] == who]
               for who in dict.fromkeys(row["controller"] for row in rows)}  # fmt: skip
    return History(read_history(folder / HISTORY), {who: _columns(of) for who, of in of_each.items()})


def _columns(rows: Sequence[Mapping[str, str]], names: Sequence[str] = ()) -> dict[str, NDArray[np.float64]]:
    return {name: np.array([float(row[name] or math.nan) for row in rows]) for name in (rows[0] if rows else names)}
