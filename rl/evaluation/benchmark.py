"""The benchmark (docs/benchmark.md): tasks whose episodes, levels and figure are frozen, so that scores can be cited.

    score = 100 (classical - policy) / (classical - oracle)

of one figure of the mission's judge, over the same episodes: 0 is the classical controller, 100 the oracle. A score is
marked `unsafe` where the task's share of safe episodes is more than `POINT` below the classical one. The levels are
those of headroom.py (configs/oracle). A task without an oracle's level has no score yet; the ratio of the policy's
figure to the classical one takes its place.

A task's digest covers all that its figures depend on, but for the code: scenario, vehicle files, levels. What changes
it makes a new version of the task, not another number of the old one.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, TypedDict

from pydantic import Field

from rl.evaluation.episodes import mission_class
from rl.evaluation.headroom import (
    Array,
    Bound,
    bound_file,
    headroom,
    judge_on_bounds,
    read_levels,
    simulated,
    with_keys_of_stored,
)
from rl.evaluation.intervals import Interval, intervals, ratios
from rl.evaluation.store import plain
from rl.judge import Judge
from rl.mission import Policy
from rl.missions import load_scenario
from rl.runs.folder import RunError, measured_files
from rl.scenario import Scenario
from taichi_sim.config import ConfigError, Strict
from taichi_sim.config.explain_errors import nearly
from taichi_sim.config.io import config_folder, read_toml, validate, vehicle_file
from taichi_sim.models.catalogue import vehicle_files

VERSION = 1
POINT = 0.01  # of the share of safe episodes
NOT_JUDGED = ("plan", "terms")  # keys that change no policy's episodes


class Task(Strict):
    """One task: `[NAME]` in configs/benchmark."""

    scenario: Annotated[str, Field(min_length=1)]  # a shipped one
    teams: Annotated[tuple[str, ...], Field(min_length=1)]  # that are judged, each by itself
    figure: Annotated[str, Field(min_length=1)]  # of the mission's judge; less is better
    safe: Annotated[str, Field(min_length=1)] = "collision_free_episodes"  # figure of the judge, a share
    digest: Annotated[str, Field(min_length=1)]

    @property
    def source(self) -> Path:
        """File of the scenario."""
        return config_folder() / f"{self.scenario}.toml"


class TeamScore(TypedDict):
    """What a policy of one team did in a task; an interval is (value, low, high), at 95 %."""

    score: Interval | None  # None: there is no oracle's level
    ratio: Interval  # the policy's figure over the classical one
    unsafe: bool
    figures: dict[str, dict[str, Interval]]  # figure -> controller -> interval
    of_each_episode: dict[str, list[float | None]]  # the policy's, from Judge.episodes; None: it has no such number


def task_file() -> Path:
    """The file of all tasks."""
    return config_folder() / "benchmark" / f"v{VERSION}.toml"


def read_tasks() -> dict[str, Task]:
    """All tasks by name."""
    return {name: validate(Task, data, f"{task_file()}: {name}") for name, data in read_toml(task_file()).items()}


def find_task(name: str) -> Task:
    """The task of that name."""
    tasks = read_tasks()
    if name in tasks:
        return tasks[name]
    close = nearly(name, tasks)
    raise ConfigError(f"{name}: no such task{f', did you mean {close!r}?' if close else ''}; tasks: {', '.join(tasks)}")


def frozen(task: Task) -> str:
    """The digest of a task as its files are now."""
    config = load_scenario(task.source)
    levels = json.loads(file.read_text(encoding="utf-8"))["teams"] if (file := bound_file(config)).is_file() else {}
    content = [task.model_dump(mode="json", exclude={"digest"}), {team: levels.get(team) for team in task.teams}]
    beside = sorted({other for team in task.teams for other in simulated(config, team)})
    apart = {name for name in config.teams if name not in beside}
    data = config.model_dump(mode="json", exclude_none=True, exclude={"stages", "seed", "replaced"} | apart)
    for key in ("seed", "episodes"):
        data["evaluation"].pop(key)
    for name in beside:
        for key in NOT_JUDGED:
            data[name].pop(key, None)
    hashed = hashlib.sha256(
        json.dumps([*content, with_keys_of_stored(config, data)], sort_keys=True, default=str).encode()
    )
    for name in beside:
        for file in vehicle_files(vehicle_file(config.teams[name], task.source), task.source):
            hashed.update(file.read_bytes())
    for file in sum(measured_files(config).values(), []):
        hashed.update(file.read_bytes())
    return hashed.hexdigest()[:16]


def open_task(name: str) -> tuple[Task, Scenario, dict[str, Bound]]:
    """A task, its scenario, and the levels of its teams."""
    task = find_task(name)
    if frozen(task) != task.digest:
        raise RunError(
            f"{name}: {task.source}, a vehicle of it or {bound_file(load_scenario(task.source))} has changed since the "
            "task was frozen: a score would be another task's"
        )
    config = load_scenario(task.source)
    levels = read_levels(config)
    if missing := [team for team in task.teams if team not in levels]:
        raise RunError(
            f"{name}: no levels of {' and '.join(missing)}: python tools/oracle.py {task.scenario} makes them"
        )
    return task, config, {team: levels[team] for team in task.teams}


def score(
    task: Task, config: Scenario, levels: Mapping[str, Bound], policies: Mapping[str, Policy],
    *, show_progress: bool = False,
) -> dict[str, TeamScore]:  # fmt: skip
    """The scores of policies, team -> policy: each team is judged by itself, on the episodes of its levels."""
    kind = mission_class(config, task.source).Judge
    found = judge_on_bounds(levels, config, policies, task.source, show_progress=show_progress)
    return {team: team_score(task, kind, levels[team], learned) for team, learned in found.items()}


def team_score(task: Task, kind: type[Judge], level: Bound, learned: Mapping[str, Array]) -> TeamScore:
    """The score of one team whose policy did the episodes of `level`."""
    share = headroom(kind, learned, level)[task.figure] if level.oracle else None
    by_controller = {"policy": learned, "classical": level.classical, "oracle": level.oracle}
    of_each = {name: intervals(kind, episodes) for name, episodes in by_controller.items() if episodes}
    keys = dict.fromkeys((task.figure, task.safe, *kind.plotted))
    safe, classical = (of_each[name][task.safe].value or 0.0 for name in ("policy", "classical"))
    return {
        "score": None if share is None else Interval(*(None if x is None else 100 * x for x in share)),
        "ratio": ratios(kind, learned, level.classical)[task.figure],
        "unsafe": safe < classical - POINT - 1e-9,
        "figures": {key: {name: of[key] for name, of in of_each.items()} for key in keys},
        "of_each_episode": plain(learned),
    }


def told(name: str, task: Task, team: str, scored: TeamScore, episodes: int) -> str:
    """The score of a team, and figures beside it, as lines to read."""
    if scored["score"] is not None:
        value, low, high = (_text(x, 0) for x in scored["score"])
        head = f"{value} ({low} to {high})"
    else:
        value, low, high = (_text(x, 2) for x in scored["ratio"])
        head = f"no score (no oracle has run); {value} ({low} to {high}) times the classical {task.figure}"
    head += ", unsafe" * scored["unsafe"]
    lines = [f"{name}, {team}: {head}; {episodes} episodes"]
    for key, of in scored["figures"].items():
        cells = (f"{who} {_text(found.value, 3)}" for who, found in of.items())
        lines.append(f"  {key}: {', '.join(cells)}")
    if scored["unsafe"]:
        lines.append(f"  unsafe: {task.safe} is more than {100 * POINT:.0f} point below the classical controller's")
    return "\n".join(lines)


def _text(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
