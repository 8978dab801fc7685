"""rsl-rl's runner without prints, safe to interrupt, and resumable."""

import contextlib
import io
import math
import sys
from pathlib import Path

import torch
from rsl_rl.runners import OnPolicyRunner
from tqdm import tqdm

from rl.learn.env import MissionEnv
from rl.learn.history import COLUMNS, HISTORY, spent, trim_history
from rl.learn.improvement import PlannedImprovement
from rl.learn.policy import STD, UNTRAINED, CheckpointError, check_signature, read_checkpoint, write_checkpoint
from rl.learn.ppo import LeanPPO, RecurrentPPO
from rl.learn.progress import ProgressLogger, writer_config
from rl.learn.start_from import STARTED, fit_actor
from rl.runs import ranks, signals
from rl.scenario import StageConfig
from taichi_sim.errors import UserError

OBS_GROUPS = {"actor": ["policy"], "critic": ["policy"]}


def actor_config(stage: StageConfig) -> dict:
    """rsl-rl's configuration of a stage's actor network.

    There is no running normaliser, because observations are of order one. A normaliser divides rare observations (a
    second obstacle in range) by their tiny spread. Policies then met such moments with inputs far outside their
    training, and swerved: follower errors of 2-3 m rms became 0.1 m without it.
    """
    memory = {"class_name": "RNNModel", "rnn_type": "gru", "rnn_hidden_dim": stage.gru}
    return {
        **(memory if stage.gru else {"class_name": "MLPModel"}),
        "hidden_dims": list(stage.hidden_dims),
        "activation": stage.activation,
        "obs_normalization": False,
        "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": stage.initial_std},
    }


def ppo_config(stage: StageConfig, privileged: bool = False) -> dict[str, object]:
    """rsl-rl's configuration of a stage; `privileged`: the critic also gets privileged information."""
    network = actor_config(stage)
    critic = {key: network[key] for key in ("hidden_dims", "activation", "obs_normalization")}
    update = PlannedImprovement if stage.planning else RecurrentPPO if stage.gru else LeanPPO
    return {
        "class_name": "OnPolicyRunner",
        "num_steps_per_env": stage.steps_per_iteration,
        "save_interval": stage.checkpoint_interval,
        "obs_groups": OBS_GROUPS | ({"critic": ["policy", "truth"]} if privileged else {}),
        "actor": network,
        "critic": critic | {"class_name": "MLPModel"},
        "algorithm": {
            "class_name": update,
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
        },  # fmt: skip
    }


DIVERGED = (
    "training has diverged to values that are not finite; lower the stage's learning_rate or the weights of its "
    "rewards, and begin a new run. Iterations completed:"
)


class DivergedError(UserError, RuntimeError):
    """Training has produced values that are not finite."""


class StageRunner(OnPolicyRunner):
    """OnPolicyRunner with atomic checkpoints that are read with `weights_only=True`.

    Iterations are counted over all stages of a team: a later stage continues the earlier one's count.

    Attributes:
        signature: names of the policy's observations and actions; every checkpoint holds them.
        first, last: iterations at which the stage begins and ends.
        batches: numbers of processes and environments, with the iteration from which they hold; a resumed stage may
            change them.
    """

    logger: ProgressLogger
    env: MissionEnv

    def __init__(self, env: MissionEnv, stage: StageConfig, folder: Path, first: int = 0, logger: str = "tensorboard"):
        """Prepare to train `env`; checkpoints, progress.csv and the events of `logger` (progress.py) go to `folder`."""
        self.folder, self.stage = folder, stage
        self.first, self.last = first, first + stage.iterations
        with contextlib.redirect_stdout(io.StringIO()):
            privileged = stage.critic == "truth" and "truth" in set(env.get_observations().keys())
            config = ppo_config(stage, privileged) | {"logger": writer_config(logger, folder)}
            super().__init__(env, config, str(folder), str(env.device))
            self.logger = ProgressLogger(
                log_dir=str(folder), cfg=self.cfg, env_cfg=env.cfg, num_envs=env.num_envs,
                is_distributed=self.is_distributed, gpu_world_size=self.gpu_world_size,
                gpu_global_rank=self.gpu_global_rank, device=str(self.device),
            )  # fmt: skip
        for group in self.alg.optimizer.param_groups:
            group["fused"], group["foreach"] = True, False  # one kernel for each tensor instead of a dozen
        self._own = own = env.mission.teams[env.team]
        self.logger.columns = (*COLUMNS, *env.mission.teams[env.team].all_logged)
        self.signature = {"observations": list(own.observation_names), "actions": list(own.action_names)}
        self.batches: list[dict[str, int]] = []
        self._begun_anew = False  # parts of the weights with which training begins

    def _configure_multi_gpu(self) -> None:
        """Set rank and number of processes.

        rsl-rl's own method requires nccl and `cuda:RANK`; here rl/runs/ranks.py has joined the processes already.
        """
        place = ranks.here()
        self.gpu_world_size, self.gpu_global_rank, self.gpu_local_rank = place.count, place.rank, place.local_rank
        self.is_distributed = place.count > 1
        numbers = {"global_rank": place.rank, "local_rank": place.local_rank, "world_size": place.count}
        self.cfg["multi_gpu"] = numbers if self.is_distributed else None

    def continue_history(self) -> int:
        """Prepare to append to the history; return the number of completed iterations."""
        done, logger = self.current_learning_iteration, self.logger
        logger.completed, logger.iterations_before = done, self.first
        if done:
            settle = self.env.mission.config.evaluation.settle
            logger.settling = math.ceil(settle / self.env.mission.config.decision_interval)
        if ranks.here().first:
            logger.elapsed_before = trim_history(self.folder / HISTORY, done, logger.columns)
            logger.steps_before = spent(self.folder / HISTORY, self.first).agent_steps
        if isinstance(self.alg, PlannedImprovement):
            self.alg.begin(self.env, self.stage, done - self.first)
        if self.is_distributed:
            self.alg.broadcast_parameters()
        now = {"processes": self.gpu_world_size, "environments": self.env.mission.num_envs * self.gpu_world_size}
        if not self.batches or self.batches[-1] != self.batches[-1] | now:
            self.batches.append({"since_iteration": done - self.first} | now)
        if not done and ranks.here().first and (self._begun_anew or not (self.folder / UNTRAINED).is_file()):
            self._write(UNTRAINED, 0)
        return done

    def train(self, *, show_progress: bool = True, label: str = "") -> None:
        """Run the remaining iterations of the stage; on KeyboardInterrupt save a checkpoint and raise it again.

        Several processes all end after the same iteration, and rank 0 saves.
        """
        logger, done, together = self.logger, self.continue_history(), self.is_distributed
        self.is_distributed = False  # else rsl-rl's loop broadcasts all weights again and prints it
        total = self.stage.iterations
        logger.bar = tqdm(total=total, initial=done - self.first, desc=label, unit="it", disable=not show_progress)
        for learner in logger.joint:
            learner.begin()
        try:
            with signals.deferred(together):
                self.learn(self.last - done)
        except KeyboardInterrupt:
            if logger.completed > done and ranks.here().first:
                self.save("")
            raise
        except (ValueError, RuntimeError) as error:
            if isinstance(error, DivergedError) or (isinstance(error, RuntimeError) and self.is_finite()):
                raise
            raise DivergedError(f"{self.folder}: {DIVERGED} {logger.completed} ({error})") from None
        finally:
            self.is_distributed = together
            logger.bar.close()
            for learner in logger.joint:
                learner.end()
            if logger.writer is not None:
                logger.stop_logging_writer()

    def is_finite(self) -> bool:
        """Whether all weights of the actor are finite."""
        return all(bool(torch.isfinite(p).all()) for p in self.alg.get_policy().parameters())

    def save(self, path: str, infos: dict | None = None) -> None:
        """Write `model_N.pt` after N completed iterations, and before it those of teams that learn beside.

        rsl-rl's `path` is not used: it counts the last iteration, not the completed ones.
        """
        completed = self.logger.completed
        for learner in self.logger.joint:
            learner.save(completed - self.first)
        if not self.is_finite():
            raise DivergedError(f"{self.folder}: {DIVERGED} {completed}")
        self._write(f"model_{completed}.pt", completed)

    def _write(self, name: str, completed: int) -> None:
        infos = self.signature | {"batches": self.batches, "learning_rate": self.stage.learning_rate}
        write_checkpoint(self.alg.save() | {"iter": completed, "infos": infos}, self.folder / name)

    def load(self, path: str, load_cfg: dict | None = None, strict: bool = True, map_location: str | None = None):
        """Continue from a checkpoint: networks, optimiser, completed iterations.

        At the start of a stage only the networks are loaded, and the exploration noise is reset; of weights that the
        stage starts from (start_from.py), the layers that fit. A learning rate that has changed counts anew.
        """
        content = ranks.broadcast(lambda: read_checkpoint(Path(path)))
        begins, infos = content["iter"] == self.first, content.get("infos") or {}
        if STARTED in infos:
            self._start_from(content, infos)
            return infos
        check_signature(infos, self._own, path)
        if begins:
            load_cfg = {"actor": True, "critic": True}
        try:
            self.alg.load(content, load_cfg, strict)
        except (RuntimeError, KeyError, ValueError) as error:
            first = str(error).splitlines()[0]
            raise CheckpointError(f"{path}: its networks are not those of the stage: {first}") from None
        if begins:
            explored = self.alg.get_policy().state_dict()
            explored[STD].fill_(self.stage.initial_std)
        else:
            self.batches = list(infos.get("batches", ()))
            if infos.get("learning_rate", self.stage.learning_rate) != self.stage.learning_rate:
                self.alg.learning_rate = self.stage.learning_rate
        self.current_learning_iteration = content["iter"]
        return infos

    def _start_from(self, content: dict, infos: dict) -> None:
        """Begin with the weights in the `content` of a checkpoint of another network."""
        with torch.no_grad():
            told = fit_actor(self.alg.get_policy(), content["actor_state_dict"], infos, self.signature)
            same = infos.get("observations", self.signature["observations"]) == self.signature["observations"]
            try:
                whole = same and "critic_state_dict" in content
                if whole:
                    self.alg.load(content, {"critic": True}, True)
            except RuntimeError:
                whole = False
        self._begun_anew = True
        if ranks.here().first:
            critic = "taken" if whole else "anew"
            print(f"{self.env.team} starts from {infos[STARTED]}: {told}; critic {critic}", file=sys.stderr)
