"""The last evaluation of each controller, kept in a run's folder: figures, numbers of each episode, what is shown.

evaluation/policy.json, classical.json     what evaluate.py prints, how it was made, and the numbers of each episode
evaluation/policy.npz, classical.npz       the worst and the median episode, and collisions (log.py)
evaluation/headroom.json                   what the policies made of an oracle's episodes (headroom.py)
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.evaluation.episode_log import save_log
from rl.evaluation.episodes import SHOWN, Outcome
from rl.runs import folder as run_folder
from rl.runs.folder import RunError

FOLDER, HEADROOM = "evaluation", "headroom.json"
CONTROLLERS = ("policy", "classical", "oracle", "honest")


class Conditions(NamedTuple):
    """What beside the run's own scenario an evaluation was made with."""

    config: str | None = None  # another scenario's file
    overrides: tuple[str, ...] = ()

    def __str__(self) -> str:
        """As on the command line."""
        config = [] if self.config is None else [f"--config {self.config}"]
        return " ".join(config + [f"--set {text}" for text in self.overrides])


class Kept(NamedTuple):
    """An evaluation as it is kept."""

    result: dict[str, Any]  # what `evaluate` returned
    conditions: Conditions
    episodes: dict[str, dict[str, NDArray[np.float64]]]  # team -> name -> [episode]

    @property
    def trial(self) -> tuple[Any, ...]:
        """Two evaluations of the same trial have the same episodes."""
        return self.result["seed"], self.result["episodes"], tuple(self.result["teams"]), self.conditions


def keep(run: Path, outcome: Outcome, config: Path | None = None, overrides: Sequence[str] = ()) -> None:
    """Keep an evaluation in a run's folder, in the place of its controller's last."""
    file = _file(run, outcome.result["controller"])
    file.parent.mkdir(exist_ok=True)
    numbers = {
        team: {name: [x if np.isfinite(x) else None for x in values.tolist()] for name, values in of_team.items()}
        for team, of_team in outcome.episodes.items()
    }
    made = {"config": None if config is None else str(Path(config).resolve()), "set": list(overrides)}
    save_log(log_file(run, outcome.result["controller"]), outcome.shown, outcome.crashes)
    run_folder.write_json(file, outcome.result | {"conditions": made, "of_each_episode": numbers})


def kept(run: Path, controller: str) -> Kept | None:
    """The last evaluation of a controller, if there is one.

    Raises:
        RunError: if it cannot be read.
    """
    file = _file(run, controller)
    if not file.is_file():
        return None
    content = run_folder.read_json(file)
    try:
        made, numbers = content.pop("conditions"), content.pop("of_each_episode")
        arrays = {t: {name: np.array(v, dtype=float) for name, v in of.items()} for t, of in numbers.items()}
        return Kept(content, Conditions(made["config"], tuple(made["set"])), arrays)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RunError(f"{file}: not a kept evaluation ({error!r}); evaluate again") from None


def keep_headroom(run: Path, episodes: Mapping[str, Mapping[str, NDArray[np.float64]]]) -> None:
    """Keep what a run's policies made of an oracle's episodes (headroom.py): team -> name -> [episode]."""
    (run / FOLDER).mkdir(exist_ok=True)
    plain = {
        team: {name: [x if np.isfinite(x) else None for x in values.tolist()] for name, values in of_team.items()}
        for team, of_team in episodes.items()
    }
    run_folder.write_json(run / FOLDER / HEADROOM, plain)


def kept_headroom(run: Path) -> dict[str, dict[str, NDArray[np.float64]]]:
    """What `keep_headroom` has kept; nothing if it was not."""
    file = run / FOLDER / HEADROOM
    if not file.is_file():
        return {}
    found = run_folder.read_json(file)
    return {t: {k: np.array(v, dtype=float) for k, v in e.items()} for t, e in found.items()}


def shown_episode(run: Path, controller: str, name: str) -> tuple[Kept, int]:
    """The last evaluation of a controller, and the number of its episode `name` (SHOWN).

    Raises:
        RunError: if it was never evaluated.
    """
    found = kept(run, controller)
    if found is None:
        classical = "" if controller == "policy" else f" --controller {controller}"
        raise RunError(f"{run}: no evaluation of {controller!r} in it: python rl/evaluate.py {run}{classical}")
    if name not in SHOWN:
        raise ValueError(f"{name!r}: allowed are {', '.join(SHOWN)}")
    return found, found.result[f"{name}_episode"]


def recording_name(controller: str, name: str) -> str:
    """The file in a run's folder that holds the recording of an episode in SHOWN."""
    return f"{name}.rrd" if controller == "policy" else f"{name}-{controller}.rrd"


def log_file(run: Path, controller: str) -> Path:
    """Where what is shown of single episodes lies."""
    return run / FOLDER / f"{controller}.npz"


def _file(run: Path, controller: str) -> Path:
    return run / FOLDER / f"{controller}.json"
