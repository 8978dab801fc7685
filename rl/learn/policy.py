"""A trained team's policy, read from a checkpoint without executing anything in it."""

import pickle
from collections.abc import Callable
from pathlib import Path

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import Tensor

from rl.missions.formation.team import TeamTask
from taichi_sim.config import ScenarioConfig, StageConfig

Policy = Callable[[TeamTask], Tensor]
"""What decides for a team: reads the team's task, returns actions [env, vehicle, action] in [-1, 1]."""

OBS_GROUPS = {"actor": ["policy"], "critic": ["policy"]}


class CheckpointError(RuntimeError):
    """A checkpoint that cannot be used: cut short, of another shape, or not a checkpoint."""


def actor_config(stage: StageConfig) -> dict:
    """rsl-rl's description of the actor network of a stage.

    No running normaliser: observations are of order one by themselves, and one would divide what is seldom seen (a
    second obstacle in range) by its tiny spread. Policies then met such moments with inputs far outside all they had
    learned from, and swerved: follower errors of 2-3 m rms became 0.1 m without it.
    """
    return {
        "class_name": "MLPModel",
        "hidden_dims": list(stage.hidden_dims),
        "activation": stage.activation,
        "obs_normalization": False,
        "distribution_cfg": {"class_name": "GaussianDistribution", "init_std": stage.initial_std},
    }


def read_checkpoint(file: Path) -> dict:
    """The content of a checkpoint: tensors and plain values only (`weights_only=True`).

    Raises:
        CheckpointError: if the file is missing, incomplete, or holds anything else.
    """
    try:
        content = torch.load(file, weights_only=True, map_location="cpu")
    except FileNotFoundError:
        raise CheckpointError(f"{file}: no such checkpoint") from None
    except (RuntimeError, EOFError, OSError, ValueError, KeyError, pickle.UnpicklingError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"{file}: not a whole checkpoint: {reason}") from None
    if not isinstance(content, dict) or not {"actor_state_dict", "iter"} <= content.keys():
        raise CheckpointError(f"{file}: not a checkpoint of this project")
    return content


def checkpoints(folder: Path) -> list[Path]:
    """Checkpoints `model_N.pt` of a stage's folder, newest last."""
    found = [p for p in folder.glob("model_*.pt") if p.stem.removeprefix("model_").isdigit()]
    return sorted(found, key=lambda p: int(p.stem.removeprefix("model_")))


class TrainedPolicy:
    """The mean action of a trained actor: deterministic, its weights never change."""

    def __init__(self, actor: MLPModel):
        """Freeze `actor`."""
        self.actor = actor.eval().requires_grad_(False)

    @classmethod
    def load(cls, file: Path, stage: StageConfig) -> "TrainedPolicy":
        """The policy of a checkpoint.

        Raises:
            CheckpointError: if the file is unusable or its network is not the stage's.
        """
        state = read_checkpoint(file)["actor_state_dict"]
        try:
            size = state["mlp.0.weight"].shape[-1]
            example = TensorDict({"policy": torch.zeros(1, size)}, batch_size=[1])
            options = actor_config(stage)
            options.pop("class_name")
            actions = state["distribution.std_param"].shape[0]
            actor = MLPModel(example, OBS_GROUPS, "actor", actions, **options)
            actor.load_state_dict(state, strict=True)
        except (KeyError, RuntimeError, AttributeError) as error:
            first = str(error).splitlines()[0]
            raise CheckpointError(f"{file}: its network is not the one configured: {first}") from None
        return cls(actor)

    @property
    def num_observations(self) -> int:
        """Observations the network takes."""
        return self.actor.obs_dim

    def __call__(self, team: TeamTask) -> Tensor:
        """Actions [env, vehicle, action] of a team now.

        Raises:
            CheckpointError: if the team observes other things than the policy was trained on.
        """
        return self.act(team.observe())

    def act(self, observations: Tensor) -> Tensor:
        """Actions [env, vehicle, action] for observations [env, vehicle, n], clipped to [-1, 1]."""
        if observations.shape[-1] != self.num_observations:
            raise CheckpointError(
                f"this policy was trained on {self.num_observations} observations and the scenario gives "
                f"{observations.shape[-1]}: observations, sensing and team sizes must be those of its training"
            )
        with torch.no_grad():
            rows = observations.flatten(0, 1).float()
            actions = self.actor(TensorDict({"policy": rows}, batch_size=[rows.shape[0]]))
        return actions.view(*observations.shape[:2], -1).clamp(-1.0, 1.0)


def load_policy(run: Path, config: ScenarioConfig, team: str) -> TrainedPolicy:
    """The newest policy of a team in a run folder.

    Raises:
        CheckpointError: if the team has not been trained there, or its checkpoint is unusable.
    """
    stage = next((s for s in config.stages.values() if s.team == team), None)
    saved = checkpoints(run / team)
    if stage is None or not saved:
        raise CheckpointError(f"{run}: no trained {team} policy (no {team}/model_N.pt, or no stage that describes it)")
    return TrainedPolicy.load(saved[-1], stage)
