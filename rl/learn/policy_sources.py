"""Where a policy comes from, as a user names it:

    RUN               a folder of rl/train.py: the newest policy of each team
    pretrained        the policies that come with the package, configs/policies/SCENARIO
    FILE.onnx         any library's network; its metadata may name observations and actions (export.py)
    module:function   a function of your own, from tensors [row, n] to [row, action]

Each may stand behind TEAM=. A network or a function is called with float32 rows: one for each vehicle, or, where the
network's width says so, one for all vehicles of an environment side by side. It answers with actions in [-1, 1], and
keeps no state: the same observations give the same actions, whatever stands in other rows. A network that has a memory
takes it as a second input [row, unit], of each vehicle, and gives it back as a second output; an episode begins with 0.
"""

import hashlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
import torch
from onnx.reference import ReferenceEvaluator
from onnx.reference.op_run import OpRun
from torch import Tensor

from rl.learn.policy import CheckpointError, check_signature, policies_of
from rl.mission import Policy
from rl.missions import load_scenario
from rl.scenario import PRETRAINED, Scenario
from rl.team import Team
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder
from taichi_sim.config.plugins import is_plugin, load_class
from taichi_sim.errors import named
from taichi_sim.kernels import runtime

SUFFIX = ".onnx"
KINDS = f"a run's folder, {PRETRAINED}, FILE{SUFFIX} or module:function"
ABOUT = "policies.json"  # beside shipped policies: how they were made, their figures and sums
SAME = 1e-4  # actions that rounding alone may differ by, between batches of other sizes
OTHER = 0.5  # factor on observations that makes others of the same size

Rows = Callable[..., Any]
"""float32 [row, n] -> [row, action], a tensor or an array; with a memory: [row, n], [row, unit] -> both."""


# -- ONNX --------------------------------------------------------------------------------------------------------------


class Gemm(OpRun):
    """Matrix product and sum by torch, whose threads are ours to choose: NumPy's bits differ with their number."""

    op_domain = ""

    def _run(self, a, b, c=None, *, alpha=1.0, beta=1.0, transA=0, transB=0):
        left, right = (torch.tensor(x.T if turned else x) for x, turned in ((a, transA), (b, transB)))
        product = alpha * (left @ right)
        return ((product if c is None else product + beta * torch.tensor(c)).numpy(),)


class MatMul(OpRun):
    """Matrix product by torch; see `Gemm`."""

    op_domain = ""

    def _run(self, a, b):
        return (torch.matmul(torch.tensor(a), torch.tensor(b)).numpy(),)


class Network:
    """The network of an ONNX file, computed by onnx's own evaluator: every operator, no runtime to install.

    Attributes:
        inputs: numbers in a row; None if the file leaves it open. memory: units of its memory, 0: it has none.
        signature: names in its metadata. weights: by name.
    """

    def __init__(self, file: Path):
        """Read a file."""
        try:
            model = onnx.load(str(file))
            self._evaluator = ReferenceEvaluator(model, new_ops=[Gemm, MatMul])
            given = {entry.key: entry.value for entry in model.metadata_props}
            self.signature = {key: tuple(json.loads(given[key])) for key in ("observations", "actions") if key in given}
        except Exception as error:  # whatever a stranger's file makes onnx raise
            raise CheckpointError(f"{file}: not a network in ONNX: {type(error).__name__}: {error}") from None
        self.weights = {tensor.name: tensor for tensor in model.graph.initializer}
        inputs = [entry for entry in model.graph.input if entry.name not in self.weights]
        outputs = list(model.graph.output)
        kept = _sizes(inputs[1]) if len(inputs) == len(outputs) == 2 else []
        self.memory = kept[1] or 0 if len(kept) == 2 else 0
        for what, entries in (("inputs", inputs), ("outputs", outputs)):
            if len(entries) != 1 and not self.memory:
                names = ", ".join(entry.name for entry in entries)
                more = (
                    "there is no network in this file" if not entries else
                    "export the actions alone, without values or probabilities" if len(inputs) == 1 else
                    "a memory is a second input and a second output [row, unit]"
                )  # fmt: skip
                raise CheckpointError(
                    f"{file}: its {what} are {names or 'none'}: wanted is one, observations to actions; {more}"
                )
        self._kinds = {of.name: onnx.helper.tensor_dtype_to_np_dtype(of.type.tensor_type.elem_type) for of in inputs}
        self.inputs = (_sizes(inputs[0]) or [None])[-1]

    def __call__(self, *rows: Tensor) -> Any:
        """Actions [row, action] of observations [row, n]; of a network with a memory [row, unit], that after, too."""
        kinds = zip(self._kinds.items(), rows, strict=True)
        given = {name: of.cpu().numpy().astype(kind) for (name, kind), of in kinds}
        with runtime.torch_at_rest():
            found = cast(Sequence[np.ndarray], self._evaluator.run(None, given))
        return found if self.memory else found[0]


def _sizes(entry: onnx.ValueInfoProto) -> list[int | None]:
    """The sizes of an input or output; None where a file leaves one open."""
    return [size.dim_value or None for size in entry.type.tensor_type.shape.dim]


# -- policies ----------------------------------------------------------------------------------------------------------


class RowPolicy:
    """A network or function of anybody's as a policy (rl.team.Policy); see the module.

    Attributes:
        source: its name, for messages. named: whether it names what it observes.
    """

    def __init__(
        self, rows: Rows, source: str, inputs: int | None = None, signature: Mapping[str, Sequence[str]] | None = None,
        memory: int = 0,
    ):  # fmt: skip
        """A policy that calls `rows`; `inputs` numbers in a row, None: one vehicle's observations; `memory`: its units
        of each vehicle.
        """
        self._rows, self._inputs, self.source, self.memory = rows, inputs, source, memory
        self._signature = dict(signature or {})
        self.named = "observations" in self._signature
        self._fits: Team | None = None  # the last team that passed `check`
        self._together = 1  # vehicles in a row

    def __call__(self, team: Team) -> Tensor:
        """Actions [env, vehicle, action] of a team."""
        seen = team.observations()
        if self._fits is not team:
            self.check(team, seen)
            self._fits = team
        actions, kept = self._act(team, seen, team.recall(self.memory) if self.memory else None)
        if kept is not None:
            team.policy_memory = kept
        return actions.to(seen)

    def check(self, team: Team, seen: Tensor) -> None:
        """Refuse a team that this policy does not fit, and a policy that keeps state, by what it does with `seen`."""
        check_signature(self._signature, team, self.source)
        each, count = seen.shape[-1], team.fleet.count
        if self._inputs not in (None, each, each if self.memory else each * count):
            raise CheckpointError(
                f"{self.source}: it takes {self._inputs} observations; a vehicle of {team.name} has {each}, all "
                f"{count} have {each * count} (taichi-sim describe lists them)"
            )
        self._together = 1 if self._inputs in (None, each) else count
        two = torch.cat((seen, OTHER * seen))
        once, turned, again = (self._act(team, rows)[0] for rows in (two, two.flip(0), seen))
        turned = turned.flip(0)
        if max(float((once - turned).abs().max()), float((once[: len(seen)] - again).abs().max())) > SAME:
            raise CheckpointError(
                f"{self.source}: the same observations give other actions when other rows come before or beside them: "
                "a policy keeps no state, draws no random numbers, and decides for each row alone"
            )

    def _act(self, team: Team, seen: Tensor, memory: Tensor | None = None) -> tuple[Tensor, Tensor | None]:
        """Actions [env, vehicle, action] for observations [env, vehicle, n], and the memory after them; see
        `TrainedPolicy.go_on`.
        """
        names, kept = team.action_names, None
        rows = seen.float().reshape(-1, self._together * seen.shape[-1])
        try:
            with torch.no_grad():
                if self.memory:
                    before = rows.new_zeros((len(rows), self.memory)) if memory is None else memory.flatten(0, 1)
                    taken, after = map(torch.as_tensor, self._rows(rows, before))
                    kept = after.to(rows).view(*seen.shape[:2], self.memory)
                else:
                    taken = torch.as_tensor(self._rows(rows))
        except Exception as error:
            raise CheckpointError(f"{self.source}: {type(error).__name__}: {error}") from error
        wanted = (len(rows), self._together * len(names))
        if tuple(taken.shape) != wanted:
            raise CheckpointError(
                f"{self.source}: it gives {list(taken.shape)} for {list(rows.shape)}, wanted are {list(wanted)}: "
                f"{', '.join(names)} of {team.name}"
            )
        taken = taken.reshape(*seen.shape[:2], len(names))
        if not bool((taken.abs() <= 1.0).all()):
            wrong = (~(taken.abs() <= 1.0)).nonzero()[0].tolist()
            raise CheckpointError(
                f"{self.source}: its action {names[wrong[2]]!r} of {team.name} is {float(taken[tuple(wrong)]):.4g}: "
                "actions are finite and from -1 to 1: clip them in the policy"
            )
        return taken, kept


def read_onnx(file: Path) -> RowPolicy:
    """The policy in an ONNX file."""
    network = Network(file)
    return RowPolicy(network, str(file), network.inputs, network.signature, network.memory)


# -- sources -----------------------------------------------------------------------------------------------------------


def policies_from(
    sources: Sequence[str], config: Scenario, teams: Sequence[str] | None = None, beside: Sequence[Path] = ()
) -> dict[str, Policy]:
    """The policies that `sources` name, for `teams` of a scenario (default: all that are trained): team -> policy.

    `beside`: folders in which modules are looked for first.
    """
    wanted = list(config.acting if teams is None else teams)
    found: dict[str, Policy] = {}
    named_teams = [text.partition("=")[0] for text in sources if "=" in text and not Path(text).exists()]
    if twice := [team for team in named_teams if named_teams.count(team) > 1]:
        raise CheckpointError(f"{twice[0]}: two policies are given for this team")
    for text in sources:
        team, equals, named = text.partition("=")
        of_team = bool(equals) and not Path(text).exists()
        if of_team and team not in wanted:
            raise CheckpointError(f"{text}: no team {team!r} acts; allowed are {', '.join(wanted)}")
        found |= _from(named if of_team else text, config, [team] if of_team else wanted, beside)
    return found


def _from(source: str, config: Scenario, teams: Sequence[str], beside: Sequence[Path]) -> Mapping[str, Policy]:
    """The policies of one source for `teams`."""
    path = Path(source)
    if path.is_dir():
        own = _scenario_of(path, config)
        found = policies_of("policy", path, own) | given_policies(own)
        _tell_vehicles(source, own, config, teams)
    elif source == PRETRAINED:
        found = shipped_policies(config.name)
        _tell_vehicles(source, load_scenario(config.name), config, teams)
    else:
        if path.suffix != SUFFIX and not is_plugin(source):
            raise CheckpointError(f"{source}: no such policy: wanted is {KINDS}")
        if len(teams) != 1:
            raise CheckpointError(f"{source}: one policy, and there are {' and '.join(teams)}: {teams[0]}={source}")
        found = {teams[0]: read_onnx(path) if path.suffix == SUFFIX else _of_function(source, beside)}
    if not (of_teams := {team: found[team] for team in teams if team in found}):
        raise CheckpointError(f"{source}: no policy of {' or '.join(teams)} in it")
    return of_teams


def _scenario_of(run: Path, config: Scenario) -> Scenario:
    """The scenario of a run, which describes its networks; `config` if this version cannot read it."""
    file = run / "config.toml"
    if not file.is_file():
        raise CheckpointError(f"{run}: not a run folder (no {file.name} in it)")
    try:
        return load_scenario(file)
    except ConfigError:
        return config


def _tell_vehicles(source: str, own: Scenario, config: Scenario, teams: Sequence[str]) -> None:
    """Say on stderr which of `teams` have other vehicles in `config` than in the scenario of `source`."""
    for team in teams:
        if team in own.teams:
            learned, here = (Path(teams[team].vehicle).stem for teams in (own.teams, config.teams))
            if learned != here:
                print(
                    f"warning: {source}: the policy of {team} learned with {team}.vehicle = {learned!r}, and now acts "
                    f"for {here!r}",
                    file=sys.stderr,
                )


def given_policies(config: Scenario) -> dict[str, Policy]:
    """The policies of the package by which teams act that no stage of a scenario trains (`Scenario.given`)."""
    with named(f"frozen = {list(config.given.values())}: ", CheckpointError):
        return policies_from(list(config.given.values()), config, list(config.given))


def _of_function(name: str, beside: Sequence[Path]) -> RowPolicy:
    """The policy `module:function`."""
    function = load_class(name, None, beside)
    if not callable(function):
        raise ConfigError(f"{name!r}: not a function of observations [row, n]")
    return RowPolicy(function, name)


def shipped_folder() -> Path:
    """The folder of the shipped policies."""
    return config_folder() / "policies"


def shipped_files(scenario: str) -> dict[str, Path]:
    """The files of the policies that come with the package for a scenario: team -> file."""
    folder = shipped_folder() / scenario
    if not (folder / ABOUT).is_file():
        there = sorted(file.parent.name for file in shipped_folder().glob(f"*/{ABOUT}"))
        raise CheckpointError(
            f"{scenario}: no policies come with the package (they do for: {', '.join(there) or 'none'}); train some: "
            f"taichi-sim train --config {scenario}, or name them: --policy {KINDS}"
        )
    about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    found: dict[str, Path] = {}
    for team, of_team in about["teams"].items():
        file = folder / f"{team}{SUFFIX}"
        if not file.is_file() or hashed(file) != of_team["sha256"]:
            raise CheckpointError(f"{file}: missing, or not the file that {folder / ABOUT} tells of: install anew")
        found[team] = file
    return found


def shipped_policies(scenario: str) -> dict[str, Policy]:
    """The policies that come with the package for a scenario: team -> policy."""
    return {team: read_onnx(file) for team, file in shipped_files(scenario).items()}


def hashed(file: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()
