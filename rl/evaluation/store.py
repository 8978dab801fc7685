"""What a run's folder holds: the last evaluation of each controller, and everything that a report shows.

evaluation/policy.json, classical.json     figures; of each episode: its numbers, its conditions, how vehicles ended
evaluation/policy.npz, classical.npz       the worst and the median episode, and collisions (episode_log.py)
evaluation/headroom.json                   the policies' numbers on an oracle's episodes (headroom.py)
evaluation/odds.json                       the odds of endings: the last ones of each question (odds/report.py)
"""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.evaluation.conditions import Conditions
from rl.evaluation.episode_log import Crash, End, Excerpt, load_log, save_log
from rl.evaluation.episodes import EvaluationOutcome, mission_class, shown_numbers
from rl.evaluation.sweeps import FOLDER as SWEEPS
from rl.evaluation.sweeps import JSON, SweepTable
from rl.judge import Judge
from rl.learn.history import HISTORY, team_history
from rl.mission import Histories
from rl.runs import folder as run_folder
from rl.runs.folder import EvaluationResult, Meta, RunError, Summary
from rl.scenario import Scenario

FOLDER, HEADROOM, ODDS = "evaluation", "headroom.json", "odds.json"
FILM = "episode.webp"  # of the recorded episode
CONTROLLERS = ("policy", "untrained", "classical", "oracle", "honest")


class EvaluationConditions(NamedTuple):
    """How an evaluation differs from the run's own scenario."""

    config: str | None = None  # file of another scenario
    overrides: tuple[str, ...] = ()

    def __str__(self) -> str:
        """The arguments on the command line."""
        config = [] if self.config is None else [f"--config {self.config}"]
        return " ".join(config + [f"--set {text}" for text in self.overrides])


class StoredEvaluation(NamedTuple):
    """An evaluation in a run's folder."""

    result: EvaluationResult
    conditions: EvaluationConditions
    episodes: dict[str, dict[str, NDArray[np.float64]]]  # team -> name -> [episode]
    of_each: Conditions  # empty in files of earlier versions
    ends: list[End]

    @property
    def trial(self) -> tuple[object, ...]:
        """A key that is equal for evaluations of the same episodes."""
        return self.result["seed"], self.result["episodes"], tuple(self.result["teams"]), self.conditions


def save_evaluation(
    run: Path, outcome: EvaluationOutcome, config: Path | None = None, overrides: Sequence[str] = ()
) -> None:
    """Store an evaluation in a run's folder; it replaces the previous one of the same controller."""
    file = evaluation_file(run, outcome.result["controller"])
    file.parent.mkdir(exist_ok=True)
    made = conditions(config, overrides)
    save_log(log_file(run, outcome.result["controller"]), outcome.shown, outcome.crashes)
    run_folder.write_json(
        file,
        outcome.result
        | {
            "conditions": made,
            "of_each_episode": {team: plain(of) for team, of in outcome.episodes.items()},
            "conditions_of_each_episode": {key: of.tolist() for key, of in outcome.conditions.items()},
            "ends": [end._asdict() for end in outcome.ends],
        },
    )


def conditions(config: Path | None, overrides: Sequence[str]) -> dict[str, Any]:
    """`EvaluationConditions` of --config and --set, for JSON."""
    return {"config": None if config is None else str(Path(config).resolve()), "set": list(overrides)}


def save_odds(run: Path, figures: Mapping[str, Any], config: Path | None, overrides: Sequence[str]) -> None:
    """Store odds (odds/report.py) in a run's folder; they replace those of the same question."""
    (run / FOLDER).mkdir(exist_ok=True)
    one = {**figures, "under": conditions(config, overrides)}
    asked = ("team", "ending", "controller", "under")
    kept = [other for other in load_odds(run) if any(other[key] != one[key] for key in asked)]
    run_folder.write_json(run / FOLDER / ODDS, [*kept, one])


def load_odds(run: Path) -> list[dict[str, Any]]:
    """The odds that `save_odds` stored; empty without a file."""
    file = run / FOLDER / ODDS
    return run_folder.read_json(file, list) if file.is_file() else []


def load_evaluation(run: Path, controller: str) -> StoredEvaluation | None:
    """The last evaluation of a controller; None if there is none."""
    file = evaluation_file(run, controller)
    if not file.is_file():
        return None
    content = run_folder.read_json(file, dict)
    try:
        made, arrays = content.pop("conditions"), _arrays(content.pop("of_each_episode"))
        each = {key: np.array(of) for key, of in content.pop("conditions_of_each_episode", {}).items()}
        ends = [End(**end) for end in content.pop("ends", [])]
        under = EvaluationConditions(made["config"], tuple(made["set"]))
        return StoredEvaluation(EvaluationResult(**content), under, arrays, each, ends)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RunError(f"{file}: not a stored evaluation ({error!r}); evaluate again") from None


def save_headroom(run: Path, episodes: Mapping[str, Mapping[str, NDArray[np.float64]]]) -> None:
    """Store the numbers of a run's policies on an oracle's episodes (headroom.py): team -> name -> [episode]."""
    (run / FOLDER).mkdir(exist_ok=True)
    run_folder.write_json(run / FOLDER / HEADROOM, {team: plain(of) for team, of in episodes.items()})


def load_headroom(run: Path) -> dict[str, dict[str, NDArray[np.float64]]]:
    """The numbers that `save_headroom` stored; empty without a file."""
    file = run / FOLDER / HEADROOM
    if not file.is_file():
        return {}
    return _arrays(run_folder.read_json(file, dict))


def shown_episode(run: Path, controller: str, which: str | int) -> tuple[StoredEvaluation, int]:
    """The last evaluation of a controller, and the number of its episode `which` (one of SHOWN, or a number)."""
    found = load_evaluation(run, controller)
    if found is None:
        whose = () if controller == "policy" else ("--controller", controller)
        line = shlex.join(("taichi-sim", "evaluate", str(run), *whose))
        raise RunError(f"{run}: no evaluation of {controller!r} in it; make one with: {line}")
    count, number = found.result["episodes"], shown_numbers(found.result).get(str(which), which)
    if number not in range(count):
        raise RunError(f"--episode {which}: the last evaluation of {controller!r} has episodes 0 to {count - 1}")
    return found, int(number)


def recording_name(controller: str, which: str | int) -> str:
    """The file in a run's folder that holds the recording of an episode, in SHOWN or by its number."""
    name = which if isinstance(which, str) else f"episode-{which}"
    return f"{name}.rrd" if controller == "policy" else f"{name}-{controller}.rrd"


def log_file(run: Path, controller: str) -> Path:
    """The file that holds the excerpts and collisions of an evaluation."""
    return run / FOLDER / f"{controller}.npz"


def plain(episodes: Mapping[str, NDArray[np.float64]]) -> dict[str, list[float | None]]:
    """Numbers of a team's episodes as lists for JSON; None stands for values that are not finite."""
    return {name: [x if np.isfinite(x) else None for x in values.tolist()] for name, values in episodes.items()}


def _arrays(plain: Mapping[str, Mapping[str, list[float | None]]]) -> dict[str, dict[str, NDArray[np.float64]]]:
    return {team: {name: np.array(v, dtype=float) for name, v in of.items()} for team, of in plain.items()}


def evaluation_file(run: Path, controller: str) -> Path:
    """The file of the last evaluation of a controller."""
    return run / FOLDER / f"{controller}.json"


class Run(NamedTuple):
    """The content of a run's folder."""

    folder: Path
    config: Scenario
    judge: type[Judge]
    meta: Meta | None  # None: no file
    summary: Summary | None  # None: not finished
    histories: Histories
    evaluations: dict[str, StoredEvaluation]  # by controller
    headroom: dict[str, dict[str, NDArray[np.float64]]]  # team -> numbers on the oracle's episodes (headroom.py)
    odds: list[dict[str, Any]]  # of endings (odds/report.py)
    shown: dict[str, Excerpt]  # of the policy
    crashes: list[Crash]  # of the policy
    sweeps: dict[str, SweepTable | None]  # name -> sweep.json; None: not finished

    @property
    def film(self) -> Path | None:
        """The film of the recorded episode, if there is one."""
        return file if (file := self.folder / FILM).is_file() else None

    @property
    def name(self) -> str:
        """Name of the run: that of its folder."""
        return self.folder.resolve().name

    def command(self, script: str, *arguments: str) -> str:
        """A command line on this run."""
        return shlex.join(("taichi-sim", script, str(self.folder), *arguments))


def read_run(folder: Path) -> Run:
    """Read a run's folder."""
    config, source = run_folder.load_config(folder)
    summary, meta = folder / run_folder.SUMMARY, folder / run_folder.META
    found = {controller: load_evaluation(folder, controller) for controller in CONTROLLERS}
    shown, crashes = load_log(log_file(folder, "policy"))
    teams = [team for team in config.trained if (folder / team / HISTORY).is_file()]
    sweeps = sorted((folder / SWEEPS).iterdir()) if (folder / SWEEPS).is_dir() else []
    return Run(
        folder=folder,
        config=config,
        judge=mission_class(config, source).Judge,
        meta=run_folder.read_json(meta, Meta) if meta.is_file() else None,
        summary=run_folder.read_json(summary, Summary) if summary.is_file() else None,
        histories={team: team_history(folder / team) for team in teams},
        evaluations={controller: of for controller, of in found.items() if of is not None},
        headroom=load_headroom(folder),
        odds=load_odds(folder),
        shown=shown,
        crashes=crashes,
        sweeps={s.name: _sweep(s / JSON) for s in sweeps if s.is_dir()},
    )


def _sweep(file: Path) -> SweepTable | None:
    """The tables of a finished sweep; old files name no opponent, which was the classical controller."""
    if not file.is_file():
        return None
    found = run_folder.read_json(file, SweepTable)
    found.setdefault("opponent", "classical")
    return found
