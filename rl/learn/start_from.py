"""Where a team's training begins: the weights that a stage's `start_from` names, and their layers that fit a network.

    start_from = "runs/calm"            a run's folder: the newest checkpoint of the team; or one checkpoint
    start_from = "pretrained"           the package's policy for this scenario; "pretrained/otter": for another
    start_from = "boats.onnx"           a policy that this package has exported

Exported policies, the package's among them, hold the actor alone: the critic and the exploration noise begin anew.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnx
import torch
from rsl_rl.models import MLPModel
from torch import Tensor

from rl.learn.policy import INTO_MEMORY, STD, CheckpointError, checkpoints, read_checkpoint
from rl.learn.policy_sources import SUFFIX, Network, shipped_files
from rl.scenario import PRETRAINED, Scenario
from taichi_sim.errors import refuse

STARTED = "started_from"  # in a checkpoint's infos: weights that may be of another network
MEMORY = "rnn."  # before the names of the weights of an actor's memory
NETWORK = "network."  # before the names of an exported actor's weights (export.py)


def starting_weights(config: Scenario, beside: Path) -> dict[str, dict]:
    """Checkpoints from which teams begin their training: team -> content, for stages with `start_from`.

    Files are relative to the working directory or to the folder `beside`.
    """
    weights: dict[str, dict] = {}
    for name, stage in config.stages.items():
        if stage.start_from is None:
            continue
        key, (kind, _, scenario) = f"stages.{name}.start_from = {stage.start_from!r}", stage.start_from.partition("/")
        place = next((p for p in (Path(stage.start_from), beside / stage.start_from) if p.exists()), None)
        lost = place is None and kind != PRETRAINED
        refuse(CheckpointError, (lost, f"{key}: no such run, checkpoint or {SUFFIX} file; {PRETRAINED}: the package's"))
        for team in stage.learners:
            if place is None:
                files = shipped_files(scenario or config.name)
                told = f"{key}: no policy of {team} comes with the package, but {', '.join(files)}"
                refuse(CheckpointError, (team not in files, told))
                found: dict[str, Any] = exported_weights(files[team])
            elif place.suffix == SUFFIX:
                found = exported_weights(place)
            else:
                saved = checkpoints(place / team) if place.is_dir() else [place]
                refuse(CheckpointError, (not saved, f"{key}: no trained {team} policy (no {team}/model_N.pt)"))
                found = read_checkpoint(saved[-1]) | {"iter": 0}
            infos = found.get("infos") or {}
            names = {what: infos[what] for what in ("observations", "actions") if what in infos}
            weights[team] = found | {"infos": names | {STARTED: stage.start_from}}
    return weights


def exported_weights(file: Path) -> dict[str, Any]:
    """An exported actor as the content of a checkpoint without critic and optimiser."""
    network = Network(file)
    found = {name.removeprefix(NETWORK): torch.from_numpy(onnx.numpy_helper.to_array(of).copy())
             for name, of in network.weights.items() if name.startswith(NETWORK)}  # fmt: skip
    if not found:
        raise CheckpointError(f"{file}: no network that this package has exported")
    infos = {what: list(names) for what, names in network.signature.items()}
    last = list(found.values())[-1]
    return {"actor_state_dict": found | {STD: torch.ones(len(last))}, "iter": 0, "infos": infos}


def fit_actor(
    actor: MLPModel, weights: Mapping[str, Tensor], before: Mapping[str, Sequence[str]],
    now: Mapping[str, Sequence[str]],
) -> str:  # fmt: skip
    """Write the first layers of `weights` that fit into `actor`; say which. Names `before` and `now` as of a signature.

    Observations of the same name keep their weights; the others begin at weight 0, so that at first the policy acts as
    if they were not there. Actions of the same name keep theirs; the others begin anew. A memory of as many units
    counts as the first layer.
    """
    own, taken = actor.state_dict(), []
    layers = [key.removesuffix(".weight") for key in own if key.endswith(".weight")]
    remembers = INTO_MEMORY in own
    if remembers:
        fits = all(key in weights and len(weights[key]) == len(own[key]) for key in own if key.startswith(MEMORY))
        old, new = weights.get(INTO_MEMORY) if fits else None, own[INTO_MEMORY]
        if columns := _shared("observations", True, old, 1, new.shape[1], before, now):
            into, out = map(list, zip(*columns, strict=True))
            for key in (key for key in own if key.startswith(MEMORY) and key != INTO_MEMORY):
                own[key].copy_(weights[key])
            new.zero_()[:, into] = weights[INTO_MEMORY][:, out].to(new)
            taken.append(f"memory ({len(columns)} of {new.shape[1]} observations)")
    for layer in layers if remembers == bool(taken) == (INTO_MEMORY in weights) else ():
        new, old = own[f"{layer}.weight"], weights.get(f"{layer}.weight")
        first = layer == layers[0] and not remembers
        rows = _shared("actions", layer == layers[-1], old, 0, len(new), before, now)
        columns = _shared("observations", first, old, 1, new.shape[1], before, now)
        if old is None or not rows or not columns:
            break
        if first:
            new.zero_()
        to, of = (torch.tensor(side) for side in zip(*rows, strict=True))
        into, out = (torch.tensor(side) for side in zip(*columns, strict=True))
        new[to[:, None], into] = old[of[:, None], out].to(new)
        own[f"{layer}.bias"][to] = weights[f"{layer}.bias"][of].to(new)
        of_all = f"{len(columns)} of {new.shape[1]} observations" * first
        of_all += f"{len(rows)} of {len(new)} actions" * (layer == layers[-1])
        taken.append(f"layer {len(taken) + 1 - remembers}" + (f" ({of_all})" if of_all else ""))
    names = set(now["observations"]) - set(before.get("observations", now["observations"]))
    told = [", ".join(taken) or "no layer: all begin anew"]
    told += [f"at weight 0: {', '.join(sorted(names))}"] * bool(names and taken)
    left = len(layers) + remembers - len(taken)
    told += [f"anew: {left} of {len(layers) + remembers} layers"] * bool(taken and left)
    return "; ".join(told)


def _shared(
    what: str, named: bool, old: Tensor | None, axis: int, size: int, before: Mapping[str, Sequence[str]],
    now: Mapping[str, Sequence[str]],
) -> list[tuple[int, int]]:  # fmt: skip
    """Pairs (number now, number before) of the rows or columns of a layer that both networks have; empty: it does not
    fit. Those that are `named` go by their names, if the weights have any.
    """
    if old is None:
        return []
    if named and len(before.get(what, ())) == old.shape[axis] and len(now[what]) == size:
        place = {name: k for k, name in enumerate(before[what])}
        return [(k, place[name]) for k, name in enumerate(now[what]) if name in place]
    return [(k, k) for k in range(size)] if old.shape[axis] == size else []
