"""Everything in a run's folder that a report shows."""

import shlex
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.evaluation.episode_log import Crash, Excerpt, load_log
from rl.evaluation.episodes import mission_class
from rl.evaluation.store import CONTROLLERS, StoredEvaluation, load_evaluation, load_headroom, log_file
from rl.evaluation.sweeps import FOLDER, JSON, SweepTable
from rl.judge import Judge
from rl.learn.progress import HISTORY, read_history
from rl.mission import Histories
from rl.runs import folder as run_folder
from rl.runs.folder import Meta, Summary
from rl.scenario import Scenario

STRIP = "episode.webp"  # pictures of the recorded episode in a row


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
    shown: dict[str, Excerpt]  # of the policy
    crashes: list[Crash]  # of the policy
    sweeps: dict[str, SweepTable | None]  # name -> sweep.json; None: not finished

    @property
    def strip(self) -> Path | None:
        """The picture of the recorded episode, if there is one."""
        return file if (file := self.folder / STRIP).is_file() else None

    @property
    def name(self) -> str:
        """Name of the run: that of its folder."""
        return self.folder.resolve().name

    def command(self, script: str, *arguments: str) -> str:
        """A command line on this run."""
        return " ".join(("python", f"rl/{script}.py", shlex.quote(str(self.folder)), *arguments))


def read_run(folder: Path) -> Run:
    """Read a run's folder.

    Raises:
        RunError: if the folder is not a run, or a file in it is broken.
    """
    config, source = run_folder.load_config(folder)
    summary, meta = folder / run_folder.SUMMARY, folder / run_folder.META
    found = {controller: load_evaluation(folder, controller) for controller in CONTROLLERS}
    shown, crashes = load_log(log_file(folder, "policy"))
    teams = [team for team in config.trained if (folder / team / HISTORY).is_file()]
    sweeps = sorted((folder / FOLDER).iterdir()) if (folder / FOLDER).is_dir() else []
    return Run(
        folder=folder,
        config=config,
        judge=mission_class(config, source).Judge,
        meta=run_folder.read_json(meta, Meta) if meta.is_file() else None,
        summary=run_folder.read_json(summary, Summary) if summary.is_file() else None,
        histories={team: read_history(folder / team / HISTORY) for team in teams},
        evaluations={controller: of for controller, of in found.items() if of is not None},
        headroom=load_headroom(folder),
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
