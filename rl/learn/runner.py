"""rsl-rl's runner, made quiet, safe to interrupt, and resumable."""

import contextlib
import csv
import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from rsl_rl.runners import OnPolicyRunner
from rsl_rl.utils.logger import Logger
from tqdm import tqdm

from rl import processes, signals
from rl.learn.env import MissionEnv
from rl.learn.policy import (
    OBS_GROUPS,
    CheckpointError,
    actor_config,
    check_signature,
    read_checkpoint,
    write_checkpoint,
)
from rl.scenario import StageConfig

HISTORY = "progress.csv"
COLUMNS = (  # and after these, what the mission logs
    "iteration", "agent_steps", "wall_time_s", "reward_per_step", "episode_reward", "policy_loss", "value_loss",
    "entropy", "action_std", "learning_rate",
)  # fmt: skip


def ppo_config(stage: StageConfig, privileged: bool = False) -> dict[str, Any]:
    """rsl-rl's configuration of a stage; with `privileged`, its critic is told the truth too (asymmetric)."""
    network = actor_config(stage)
    critic = {k: v for k, v in network.items() if k != "distribution_cfg"}
    return {
        "class_name": "OnPolicyRunner",
        "num_steps_per_env": stage.steps_per_iteration,
        "save_interval": stage.checkpoint_interval,
        "obs_groups": OBS_GROUPS | ({"critic": ["policy", "truth"]} if privileged else {}),
        "actor": network,
        "critic": critic,
        "algorithm": {
            "class_name": "PPO",
            "learning_rate": stage.learning_rate,
            "num_learning_epochs": stage.learning_epochs,
            "num_mini_batches": stage.mini_batches,
            "gamma": stage.discount,
            "lam": stage.gae_lambda,
            "clip_param": stage.clip,
            "entropy_coef": stage.entropy,
            "desired_kl": stage.desired_kl,
            "schedule": "adaptive",
            "value_loss_coef": 1.0,
            "max_grad_norm": 1.0,
            "use_clipped_value_loss": True,
        },
    }


class ProgressLogger(Logger):
    """Writes TensorBoard scalars and progress.csv, and moves a progress bar instead of printing pages."""

    bar: tqdm | None = None
    elapsed_before = 0.0  # s, of parts before an interruption, and of the team's earlier stages
    steps_before, iterations_before = 0, 0  # of the team's earlier stages
    completed = 0  # iterations
    companions: Sequence[Any] = ()  # that learn in the same steps (joint.py)
    columns: tuple[str, ...] = COLUMNS
    scale = 1.0  # of rewards, as the learner is told them

    def __init__(self, *args: Any, **options: Any):
        """Take rsl-rl's arguments."""
        super().__init__(*args, **options)
        self._told: list[dict[str, torch.Tensor]] = []  # what the mission logged in this iteration, on every rank

    def _store_code_state(self) -> list[str]:
        return []  # the run folder already holds the commit and the package versions

    def process_env_step(self, rewards: Any, dones: Any, extras: dict, intrinsic_rewards: Any) -> None:
        """Take a step into account."""
        self._told.append(extras["log"])
        super().process_env_step(rewards, dones, extras | {"log": {}}, intrinsic_rewards)

    def log(self, it: int, start_it: int, total_it: int, *args: Any, **values: Any) -> None:
        """Record one iteration; called by the runner with rsl-rl's arguments.

        Raises:
            KeyboardInterrupt: if a signal has been noted on any rank, on all of them after the same iteration.
        """
        for companion in self.companions:
            companion.update()
        means = self._means()
        self.completed = it + 1
        if self.writer is not None:
            self.ep_extras = [{key: torch.tensor([value]) for key, value in means.items()}]
            with contextlib.redirect_stdout(io.StringIO()):
                super().log(it, start_it, total_it, *args, **values)
            self._write_row(it, means, values)
        if self.bar is None:
            return  # of a companion: its leader shows, and asks whether to go on
        self._show(self.bar, means, values)
        if number := processes.greatest(signals.asked()):
            raise signals.interruption(number)

    def _show(self, bar: tqdm, means: dict[str, float], values: dict[str, Any]) -> None:
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
        """Of what the mission logged, over the iteration and all ranks."""
        told, self._told = self._told, []
        keys = dict.fromkeys(key for info in told for key in info)
        return processes.mean({key: float(torch.stack([i[key].mean() for i in told]).mean()) for key in keys})

    def _write_row(self, it: int, means: dict[str, float], values: dict[str, Any]) -> None:
        losses, n = values["loss_dict"], self.cfg["num_steps_per_env"] * self.num_envs * self.gpu_world_size
        row = {
            "iteration": it,
            "agent_steps": self.steps_before + (it + 1 - self.iterations_before) * n,
            "wall_time_s": round(self.elapsed_before + self.tot_time, 3),
            "reward_per_step": means.get("/reward"),
            "episode_reward": sum(self.rewbuffer) / len(self.rewbuffer) / self.scale if self.rewbuffer else None,
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


SHOWN = 3  # of what is logged, beside the progress bar

DIVERGED = (
    "training has diverged to values that are not finite; lower the stage's learning_rate or the weights of its "
    "rewards, and begin a new run. Iterations completed:"
)


class DivergedError(RuntimeError):
    """Training produced values that are not finite."""


class StageRunner(OnPolicyRunner):
    """OnPolicyRunner whose checkpoints are written beside and renamed, and read with `weights_only=True`.

    Iterations are counted over all stages of a team: one that goes on from another begins where that ended.

    Attributes:
        signature: names of what the policy observes and commands, in order; they travel in its checkpoints.
        first, last: iterations when the stage begins and ends.
        batches: how many processes and environments the stage has had, since which iteration; a resumed one may change.
    """

    logger: ProgressLogger
    env: MissionEnv

    def __init__(self, env: MissionEnv, stage: StageConfig, folder: Path, first: int = 0):
        """Prepare to train `env`; checkpoints, progress.csv and TensorBoard events go to `folder`."""
        self.folder, self.stage = folder, stage
        self.first, self.last = first, first + stage.iterations
        with contextlib.redirect_stdout(io.StringIO()):
            privileged = stage.critic == "truth" and "truth" in set(env.get_observations().keys())
            super().__init__(env, ppo_config(stage, privileged), str(folder), str(env.device))
            self.logger = ProgressLogger(
                log_dir=str(folder), cfg=self.cfg, env_cfg=env.cfg, num_envs=env.num_envs,
                is_distributed=self.is_distributed, gpu_world_size=self.gpu_world_size,
                gpu_global_rank=self.gpu_global_rank, device=str(self.device),
            )  # fmt: skip
        for group in self.alg.optimizer.param_groups:
            group["fused"], group["foreach"] = True, False  # one kernel a tensor instead of a dozen
        self._own = own = env.mission.teams[env.team]
        self.logger.scale = env.scale
        self.logger.columns = (*COLUMNS, *env.mission.logged)
        self.signature = {"observations": list(own.observation_names), "actions": list(own.action_names)}
        self.batches: list[dict[str, int]] = []

    def _configure_multi_gpu(self) -> None:
        """Say which of how many processes this is: rsl-rl's own asks for nccl and `cuda:RANK`; here they are joined by
        whoever has started them (rl/processes.py).
        """
        place = processes.here()
        self.gpu_world_size, self.gpu_global_rank, self.gpu_local_rank = place.count, place.rank, place.local_rank
        self.is_distributed = place.count > 1
        told = {"global_rank": place.rank, "local_rank": place.local_rank, "world_size": place.count}
        self.cfg["multi_gpu"] = told if self.is_distributed else None

    def go_on(self) -> int:
        """Prepare to write the history from where it is; return the iterations behind it."""
        done, logger = self.current_learning_iteration, self.logger
        logger.completed, logger.iterations_before = done, self.first
        if processes.here().first:
            logger.elapsed_before = trim_history(self.folder / HISTORY, done)
            logger.steps_before = spent(self.folder / HISTORY, self.first).agent_steps
        if self.is_distributed:
            self.alg.broadcast_parameters()
        now = {"processes": self.gpu_world_size, "environments": self.env.mission.num_envs * self.gpu_world_size}
        if not self.batches or self.batches[-1] != self.batches[-1] | now:
            self.batches.append({"since_iteration": done - self.first} | now)
        return done

    def train(self, *, show_progress: bool = True, label: str = "") -> None:
        """Run the remaining iterations of the stage; on KeyboardInterrupt save a checkpoint and raise it again.

        With other processes, all end after the same iteration, and rank 0 saves.
        """
        logger, done, together = self.logger, self.go_on(), self.is_distributed
        self.is_distributed = False  # rsl-rl's loop would tell all the weights once more, and print that it does
        total = self.stage.iterations
        logger.bar = tqdm(total=total, initial=done - self.first, desc=label, unit="it", disable=not show_progress)
        for companion in logger.companions:
            companion.begin()
        try:
            with signals.noted(together):
                self.learn(self.last - done)
        except KeyboardInterrupt:
            if logger.completed > done and processes.here().first:
                self.save("")
            raise
        except (ValueError, RuntimeError) as error:
            if isinstance(error, DivergedError) or (isinstance(error, RuntimeError) and self.is_finite()):
                raise
            raise DivergedError(f"{self.folder}: {DIVERGED} {logger.completed} ({error})") from None
        finally:
            self.is_distributed = together
            logger.bar.close()
            for companion in logger.companions:
                companion.end()
            if logger.writer is not None:
                logger.stop_logging_writer()

    def is_finite(self) -> bool:
        """Whether every weight of the actor is a number."""
        return all(bool(torch.isfinite(p).all()) for p in self.alg.get_policy().parameters())

    def save(self, path: str, infos: dict | None = None) -> None:
        """Write `model_N.pt`, N the iterations completed (rsl-rl's own `path` numbers the last one: not used), after
        those of the companions, so that theirs are there.
        """
        completed = self.logger.completed
        for companion in self.logger.companions:
            companion.save(completed - self.first)
        if not self.is_finite():
            raise DivergedError(f"{self.folder}: {DIVERGED} {completed}")
        told = self.signature | {"batches": self.batches} | (infos or {})
        content = self.alg.save() | {"iter": completed, "infos": told}
        write_checkpoint(content, self.folder / f"model_{completed}.pt")

    def load(self, path: str, load_cfg: dict | None = None, strict: bool = True, map_location: str | None = None):
        """Continue from a checkpoint: networks, optimiser, iterations completed.

        From where an earlier stage ended, networks alone, and exploration begins anew.

        Raises:
            CheckpointError: if its networks are not the stage's, or it was trained on other observations.
        """
        content = processes.told(lambda: read_checkpoint(Path(path)))
        begins = content["iter"] == self.first
        check_signature(content.get("infos") or {}, self._own, path)
        if begins:
            load_cfg = {"actor": True, "critic": True}
        try:
            self.alg.load(content, load_cfg, strict)
        except (RuntimeError, KeyError, ValueError) as error:
            first = str(error).splitlines()[0]
            raise CheckpointError(f"{path}: its networks are not those of the stage: {first}") from None
        if begins:
            explored = self.alg.get_policy().state_dict()
            explored["distribution.std_param"].fill_(self.stage.initial_std)
        else:
            self.batches = list((content.get("infos") or {}).get("batches", ()))
        self.current_learning_iteration = content["iter"]
        return content.get("infos")


def trim_history(file: Path, done: int) -> float:
    """Drop rows of progress.csv after iteration `done` (they come after the checkpoint); seconds spent until then."""
    if not file.is_file():
        return 0.0
    with file.open(newline="", encoding="utf-8") as stream:
        reader = csv.DictReader(stream)
        rows = [r for r in reader if r["iteration"].isdigit() and int(r["iteration"]) < done]
    beside = file.with_name(file.name + ".part")
    with beside.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, reader.fieldnames or COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    os.replace(beside, file)
    return float(rows[-1]["wall_time_s"]) if rows else 0.0


class Spent(NamedTuple):
    """What a team's training took so far."""

    seconds: float
    agent_steps: int


def spent(file: Path, iterations: int | None = None) -> Spent:
    """What its first `iterations` (default: all) took, by progress.csv, over all interruptions; 0 if there are none."""
    if iterations == 0 or not file.is_file():
        return Spent(0.0, 0)
    with file.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))[:iterations]
    return Spent(float(rows[-1]["wall_time_s"]), int(rows[-1]["agent_steps"])) if rows else Spent(0.0, 0)
