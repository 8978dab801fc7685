"""Policies of teams that do not learn: hold still, follow the classical controller, or act by a trained policy."""

from pathlib import Path
from typing import TYPE_CHECKING

import torch

from rl.mission import Team
from rl.runs.folder import CONFIG, RunError, load_config
from rl.scenario import Scenario

if TYPE_CHECKING:  # rsl-rl doubles the time to import: only a frozen policy needs it
    from rl.learn.policy import Policy

ABSENT = "absent"
OTHERS = f"{ABSENT!r}, 'constant', 'classical', or the path of a run folder or of a checkpoint in one"


def policy_of_other(other: str | Path, team: Team, config: Scenario, argument: str = "other") -> "Policy":
    """The policy of a simulated `team` that does not learn, by its name in OTHERS (any but "absent").

    `argument` is the name of the argument `other` in error messages.

    Raises:
        ValueError: if `other` is not in OTHERS, or its policy is for another vehicle.
        ControllerError: if the vehicle has no classical controller.
        RunError: if the run folder has no policy of this team.
        CheckpointError: if a file cannot be used, or its policy has other observations.
    """
    if other == "constant":
        return lambda team: torch.zeros_like(team.action)
    if other == "classical":
        from rl.learn.policy import ClassicalPolicy

        policy: Policy = ClassicalPolicy()
    else:
        policy = _trained_policy(Path(other), team.name, config, argument)
    given, taken = policy(team).shape[-1], len(team.fleet.model.action_names)
    if given != taken:
        raise ValueError(f"{argument} = {str(other)!r}: its policy gives {given} actions, a {team.name} takes {taken}")
    return policy


def _trained_policy(path: Path, team: str, config: Scenario, argument: str) -> "Policy":
    """The newest policy of `team` in run folder `path`, or the policy of checkpoint `path`."""
    from rl.learn.policy import TrainedPolicy, checkpoints

    if not path.exists():
        raise ValueError(f"{argument} = {str(path)!r}: no such choice, folder or file; allowed are {OTHERS}")
    run, saved = (path, checkpoints(path / team)) if path.is_dir() else (path.resolve().parent.parent, [path])
    trained = load_config(run)[0] if path.is_dir() or (run / CONFIG).is_file() else config
    stage = trained.stage_of(team)
    if stage is None or not saved:
        raise RunError(f"{path}: no trained {team} policy (no {team}/model_N.pt, or no stage that describes it)")
    return TrainedPolicy.load(saved[-1], stage)
