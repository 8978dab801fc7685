"""Policies of trained teams, and reading and writing of checkpoints without executing code in them."""

import io
import pickle
import zipfile
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from rl.learn.actor import Actor
from rl.mission import ControllerError, Policy, Team, VehicleActions
from rl.planning.planner import HonestPlanner, Planner
from rl.scenario import Scenario, StageConfig
from taichi_sim.config.io import replacing
from taichi_sim.errors import UserError, refuse

UNREADABLE = (RuntimeError, EOFError, OSError, ValueError, LookupError, AttributeError, TypeError,
              pickle.UnpicklingError, zipfile.BadZipFile, zlib.error)  # fmt: skip
"""What reading a file that is no whole checkpoint raises."""
UNTRAINED = "model_0.pt"  # the weights with which a team's training begins
STD = "distribution.std_param"  # name of an actor's exploration noise
INTO_MEMORY = "rnn.rnn.weight_ih_l0"  # name of the weights from observations to the units of an actor's memory


class CheckpointError(UserError, RuntimeError):
    """A checkpoint that cannot be used: cut short, of another shape, or another kind of file."""


def read_checkpoint(file: Path) -> dict:
    """The content of a checkpoint: tensors and plain values only (`weights_only=True`).

    Torch reads damaged weights without a word, so the sums that its zip files hold are checked first.
    """
    try:
        with zipfile.ZipFile(file) as parts:
            damaged = parts.testzip()
        content = torch.load(file, weights_only=True, map_location="cpu")
    except UNREADABLE as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"{file}: not a whole checkpoint: {reason}") from None
    kinds = {"actor_state_dict": dict, "iter": int, "infos": dict | None}
    ours = isinstance(content, dict) and all(isinstance(content.get(key), kind) for key, kind in kinds.items())
    refuse(
        CheckpointError,
        (damaged, f"{file}: not a whole checkpoint: its part {damaged} is not what was written"),
        (not ours, f"{file}: not a checkpoint of this project"),
    )
    return content


def write_checkpoint(content: dict, file: Path) -> None:
    """Write a checkpoint to a temporary file and rename it: a kill or a full disk damages no earlier checkpoint."""
    memory = io.BytesIO()  # torch's own writer does not name a full disk
    torch.save(content, memory)
    with replacing(file) as part:
        part.write_bytes(memory.getbuffer())


def checkpoints(folder: Path) -> list[Path]:
    """Checkpoints `model_N.pt` of a team's folder after N >= 1 iterations, newest last."""
    found = [p for p in folder.glob("model_*.pt") if p.name != UNTRAINED and p.stem.removeprefix("model_").isdigit()]
    return sorted(found, key=lambda p: int(p.stem.removeprefix("model_")))


class TrainedPolicy:
    """A trained actor with frozen weights; it acts by its mean action, without random numbers."""

    def __init__(self, actor: Actor, signature: Mapping[str, Sequence[str]] | None = None, source: str = "policy"):
        """Freeze an actor; `signature` names its observations and actions, `source` its file, for messages."""
        self.actor, self.source = actor.eval().requires_grad_(False), source
        self.signature = dict(signature or {})
        self._fits: Team | None = None  # the last team that passed `check`
        self.memory = actor.memory  # numbers, of each vehicle

    @classmethod
    def load(cls, file: Path, stage: StageConfig) -> "TrainedPolicy":
        """Load the policy of a checkpoint."""
        content = read_checkpoint(file)
        state, infos = content["actor_state_dict"], content.get("infos") or {}
        try:
            size = state[INTO_MEMORY if stage.gru else "mlp.0.weight"].shape[-1]
            actor = Actor(stage, size, state[STD].shape[0])
            actor.load_state_dict(state, strict=True)
        except (KeyError, RuntimeError, AttributeError, TypeError) as error:
            first = str(error).splitlines()[0]
            raise CheckpointError(f"{file}: its network is not the one configured: {first}") from None
        if not all(bool(weight.isfinite().all()) for weight in actor.parameters()):
            raise CheckpointError(f"{file}: its weights are not finite: the training had diverged")
        return cls(actor, {key: infos[key] for key in ("observations", "actions") if key in infos}, str(file))

    @property
    def num_observations(self) -> int:
        """Number of the network's inputs."""
        return self.actor.inputs

    def __call__(self, team: Team) -> Tensor:
        """Actions [env, vehicle, action] of a team."""
        if self._fits is not team:
            self.check(team)
            self.actor.to(team.fleet.state.device)
            self._fits = team
        if not self.memory:
            return self.act(team.observations())
        actions, team.policy_memory = self.go_on(team.observations(), team.recall(self.memory))
        return actions

    def check(self, team: Team) -> None:
        """Refuse a team whose observations or actions are not those of the training (`check_signature`)."""
        check_signature(self.signature, team, self.source)

    def act(self, observations: Tensor) -> Tensor:
        """Actions [env, vehicle, action] in [-1, 1] for observations [env, vehicle, n] as episodes begin."""
        return self.go_on(observations, None)[0]

    def go_on(self, observations: Tensor, memory: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """`act`, and the memory after it, with that [env, vehicle, `TrainedPolicy.memory`] of the last decision.

        None: episodes begin, or the policy has no memory.
        """
        if observations.shape[-1] != self.num_observations:
            raise CheckpointError(
                f"{self.source}: this policy was trained on {self.num_observations} observations and the scenario "
                f"gives {observations.shape[-1]}: observations and sensing must be those of its training"
            )
        rows, kept = observations.flatten(0, 1).float(), None
        with torch.no_grad():
            if self.memory:
                before = rows.new_zeros(len(rows), self.memory) if memory is None else memory.flatten(0, 1)
                actions, after = self.actor(rows, before)
                kept = after.view(*observations.shape[:2], -1)
            else:
                actions = self.actor(rows)
            return actions.view(*observations.shape[:2], -1).clamp(-1.0, 1.0), kept


def check_signature(signature: Mapping[str, Sequence[str]], team: Team, source: str) -> None:
    """Refuse a team whose observations or actions are not those in `signature`, which comes from `source`."""
    for what, names in (("observations", team.observation_names), ("actions", team.action_names)):
        trained = signature.get(what)
        if trained is not None and list(trained) != list(names):
            raise CheckpointError(f"{source}: its {what} differ: {_difference(trained, names, team.name)}")


def _difference(trained: Sequence[str], names: Sequence[str], team: str) -> str:
    """The difference between the trained names and the team's names as text."""
    before, now = (Counter(name.partition(".")[0] for name in given) for given in (trained, names))
    gone, new = (", ".join(repr(term) for term in a if term not in b) for a, b in ((before, now), (now, before)))
    found = [f"it was trained on {gone}, which {team} has not"] if gone else []
    found += [f"{team} has {new}, which it was not trained on"] if new else []
    found += [
        f"it was trained on {before[term]} numbers of {term!r}, {team} has {now[term]}"
        for term in before
        if 0 < now[term] != before[term]
    ]
    return "; ".join(found) or "their order differs"


class ClassicalPolicy:
    """A policy that acts by the team's classical controller (`Team.controller`)."""

    def __call__(self, team: Team) -> VehicleActions:
        """Actions of the vehicles."""
        controller = team.controller
        if controller is None:
            kind = type(team.fleet.model).__name__
            raise ControllerError(f"{team.name}: there is no classical controller for the vehicle model {kind}")
        return team.classical(controller)


def policies_of(kind: str, run: Path, config: Scenario) -> dict[str, Policy]:
    """A policy for each team: team -> policy.

    Of `kind` "policy" are the policies trained in the folder `run`; "untrained": these before their training. The other
    kinds are for all teams without a script. "classical": the classical controllers. "plan" or "oracle": a planner in
    forks of the true simulation. "honest": a planner in a world built from what the vehicles know.
    """
    if kind not in ("policy", "untrained"):
        make = {"classical": ClassicalPolicy, "honest": HonestPlanner}.get(kind, Planner)
        return {team: make() for team in config.teams if team not in config.scripted}
    teams = [team for team in config.trained if (run / team).is_dir()]
    if not teams:
        raise CheckpointError(f"{run}: no trained policy in it")
    return {team: load_policy(run, config, team, 0 if kind == "untrained" else None) for team in teams}


def load_policy(run: Path, config: Scenario, team: str, iterations: int | None = None) -> TrainedPolicy:
    """The policy of a team in a run folder: the newest, or that after `iterations`."""
    stage = config.stage_of(team)
    if stage is not None and iterations is not None:
        return TrainedPolicy.load(run / team / f"model_{iterations}.pt", stage)
    saved = checkpoints(run / team)
    if stage is None or not saved:
        raise CheckpointError(f"{run}: no trained {team} policy (no {team}/model_N.pt, or no stage that describes it)")
    return TrainedPolicy.load(saved[-1], stage)
