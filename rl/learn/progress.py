"""History of a training on rank 0: for each iteration a row of progress.csv, scalars of TensorBoard or of Weights and
Biases, and a progress bar.

Where a later stage or a resumption begins, all episodes begin at once. Means over their first `evaluation.settle` would
dip there, and are left out.
"""

import contextlib
import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import TypedDict, Unpack

import torch
from rsl_rl.utils.log_writer import LogWriter
from rsl_rl.utils.logger import Logger
from torch import Tensor
from tqdm import tqdm

from rl.learn.env import Extras, Learner
from rl.learn.history import COLUMNS, HISTORY
from rl.runs import ranks, signals

SHOWN = 3  # logs beside the progress bar


class Iteration(TypedDict):
    """Arguments with which rsl-rl logs an iteration."""

    collect_time: float  # s
    learn_time: float  # s
    loss_dict: dict[str, float]
    learning_rate: float
    action_std: Tensor
    rnd_weight: float | None


class NoWriter(LogWriter):
    """Writes no events; rsl-rl saves checkpoints only beside a writer."""

    def __init__(self, log_dir: str):
        """Take rsl-rl's argument."""

    def add_scalar(self, tag: str, scalar_value: float, global_step: int) -> None:
        """Do nothing."""


def writer_config(logger: str, folder: Path) -> str | dict[str, object]:
    """rsl-rl's configuration of the writer "tensorboard", "wandb" or "none", for a team's `folder` in a run's."""
    if logger == "wandb":
        os.environ.setdefault("WANDB_RUN_GROUP", folder.parent.name)  # a run of theirs is a stage of ours
        return {"class_name": "WandbLogWriter", "project_name": "taichi-sim"}
    return logger if logger == "tensorboard" else {"class_name": NoWriter}


class ProgressLogger(Logger):
    """Logger of rsl-rl that writes progress.csv and moves a progress bar instead of printing."""

    bar: tqdm | None = None
    elapsed_before = 0.0  # s, before an interruption and in the team's earlier stages
    steps_before, iterations_before = 0, 0  # in the team's earlier stages
    completed = 0  # iterations
    joint: Sequence[Learner] = ()  # teams that learn from the same steps (joint_learner.py)
    columns: tuple[str, ...] = COLUMNS
    settling = 0  # next decisions, whose means are left out

    def __init__(self, *args, **options):
        """Take rsl-rl's arguments."""
        super().__init__(*args, **options)
        self._logs: list[dict[str, Tensor]] = []  # logs of this iteration's steps, on every rank
        self.env_cfg = SimpleNamespace(to_dict=lambda: options["env_cfg"])  # as rsl-rl's writer for wandb wants it

    def _store_code_state(self) -> list[str]:
        return []  # the run folder already holds the commit and the package versions

    def process_env_step(
        self, rewards: Tensor, dones: Tensor, extras: Extras, intrinsic_rewards: Tensor | None = None
    ) -> None:
        """Count a step. Returns of finished episodes, which rsl-rl collects, are those of short ones at first."""
        self._logs.append(extras["log"])

    def log(self, it: int, start_it: int, total_it: int, **values: Unpack[Iteration]) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Record one iteration; the runner calls this with rsl-rl's arguments.

        Raises:
            KeyboardInterrupt: on all ranks after the same iteration, if a signal is pending on any of them.
        """
        for learner in self.joint:
            learner.update()
        means = self._means()
        shown, self.completed = means, it + 1
        means = {} if self.settling > 0 else means
        self.settling -= self.cfg["num_steps_per_env"]
        if self.writer is not None:
            self.ep_extras = [{key: torch.tensor([value]) for key, value in means.items()}]
            with contextlib.redirect_stdout(io.StringIO()):
                super().log(it, start_it, total_it, **values)
            self._write_row(it, means, values)
        if self.bar is None:
            return  # it learns beside another: the driving runner shows progress and handles signals
        self._show(self.bar, shown, values)
        if number := ranks.greatest(signals.pending()):
            raise signals.interruption(number)

    def _show(self, bar: tqdm, means: dict[str, float], values: Iteration) -> None:
        """Move the progress bar."""
        if not bar.disable:
            steps = self.cfg["num_steps_per_env"] * self.num_envs * self.gpu_world_size
            rate = steps / (values["collect_time"] + values["learn_time"])
            shown = {"reward": f"{means.get('/reward', float('nan')):.2f}"}
            shown |= {key[1:]: f"{means[key]:.2f}" for key in list(means)[:SHOWN] if key != "/reward"}
            shown["steps/s"] = f"{rate / 1000:.0f}k"
            bar.set_postfix(shown, refresh=False)
            bar.update(1)

    def _means(self) -> dict[str, float]:
        """Means of the mission's logs over the iteration and all ranks."""
        logs, self._logs = self._logs, []
        keys = dict.fromkeys(key for log in logs for key in log)
        return ranks.mean({key: float(torch.stack([log[key].mean() for log in logs]).mean()) for key in keys})

    def _write_row(self, it: int, means: dict[str, float], values: Iteration) -> None:
        losses, n = values["loss_dict"], self.cfg["num_steps_per_env"] * self.num_envs * self.gpu_world_size
        row = {
            "iteration": it,
            "agent_steps": self.steps_before + (it + 1 - self.iterations_before) * n,
            "wall_time_s": round(self.elapsed_before + self.tot_time, 3),
            "reward_per_step": means.get("/reward"),
            "policy_loss": losses["surrogate"],
            "value_loss": losses["value"],
            "entropy": losses["entropy"],
            "action_std": float(values["action_std"].detach().mean()),
            "learning_rate": values["learning_rate"],
            **{name: means.get(f"/{name}") for name in self.columns[len(COLUMNS) :]},
        }
        path = Path(self.log_dir) / HISTORY  # type: ignore[arg-type]
        new = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self.columns)
            if new:
                writer.writeheader()
            writer.writerow({k: "" if v is None else v for k, v in row.items()})
