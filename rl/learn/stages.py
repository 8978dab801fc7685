"""Training stage by stage: each team learns while the teams of earlier stages act from their frozen policies.

A team may be trained by several stages. Its folder holds one history: iterations, progress.csv and checkpoints of a
later stage go on from the earlier one's.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from rl.learn.env import MissionEnv
from rl.learn.export import ONNX, TORCHSCRIPT, export_policy
from rl.learn.policy import CheckpointError, TrainedPolicy, checkpoints, load_policy, read_checkpoint
from rl.learn.runner import HISTORY, StageRunner, spent
from rl.missions import make_mission
from rl.scenario import Scenario, at_stage
from rl.seeds import derive_seed


def train_stages(
    config: Scenario,
    out: Path,
    *,
    source: Path | None = None,
    dumps: Path | None = None,
    show_progress: bool = True,
) -> list[dict[str, Any]]:
    """Train every stage that `out` does not hold finished, continuing from checkpoints; return their results.

    `source` is the scenario's file, beside which its vehicles are looked for; environments that leave the physical are
    written to the folder `dumps` (taichi_sim/dump.py).
    """
    results, policies = [], {}
    for name, stage in config.stages.items():
        (out / stage.team).mkdir(parents=True, exist_ok=True)
        results.append(train_stage(config, out, name, policies, source, dumps, show_progress))
        ended = config.iterations_before(name) + stage.iterations
        policies[stage.team] = load_policy(out, config, stage.team, ended)
    return results


def train_stage(
    config: Scenario,
    out: Path,
    name: str,
    policies: Mapping[str, TrainedPolicy],
    source: Path | None,
    dumps: Path | None,
    show_progress: bool,
) -> dict[str, Any]:
    """Train the stage `name` to its last iteration and export its policy; return its line of summary.json."""
    stage, first = config.stages[name], config.iterations_before(name)
    folder, last = out / stage.team, first + stage.iterations
    saved = checkpoints(folder)
    done = read_checkpoint(saved[-1])["iter"] if saved else 0
    if done >= last and exported(folder):
        return stage_result(folder, name, config)
    seed = derive_seed(config.seed, name, done)
    torch.manual_seed(seed)
    teams = tuple(t for t in config.teams if t == stage.team or t in policies)
    here = at_stage(config, name)
    mission = make_mission(here, stage.num_envs, seed=derive_seed(config.seed, name), teams=teams, source=source)
    mission.reseed(seed)
    mission.world.dump_folder = dumps
    frozen = {t: policies[t] for t in mission.teams if t != stage.team}
    env = MissionEnv(mission, stage.team, frozen, scale=1 - stage.discount)
    runner = StageRunner(env, stage, folder, first)
    if saved:
        runner.load(str(saved[-1]))
    if done < last:
        number = list(config.stages).index(name) + 1
        runner.train(show_progress=show_progress, label=f"stage {number}/{len(config.stages)} {name}")
    export_policy(runner.alg.get_policy(), folder, runner.signature)
    return stage_result(folder, name, config)


def exported(folder: Path) -> bool:
    """Whether the policy in a team's folder has been exported."""
    return all((folder / name).is_file() for name in (TORCHSCRIPT, ONNX))


def starting_weights(config: Scenario, beside: Path) -> dict[str, dict[str, Any]]:
    """Checkpoints that the training of teams begins with, by team: of stages whose `start_from` names one.

    It is a run's folder (the team's newest) or a checkpoint, from here or from the folder `beside`.

    Raises:
        CheckpointError: if there is none, or it is unusable.
    """
    weights = {}
    for name, stage in config.stages.items():
        if stage.start_from is None:
            continue
        told = f"stages.{name}.start_from = {stage.start_from!r}"
        place = next((p for p in (Path(stage.start_from), beside / stage.start_from) if p.exists()), None)
        if place is None:
            raise CheckpointError(f"{told}: no such run or checkpoint")
        saved = checkpoints(place / stage.team) if place.is_dir() else [place]
        if not saved:
            raise CheckpointError(f"{told}: no trained {stage.team} policy (no {stage.team}/model_N.pt)")
        weights[stage.team] = read_checkpoint(saved[-1]) | {"iter": 0}
    return weights


def stage_result(folder: Path, name: str, config: Scenario) -> dict[str, Any]:
    """This stage's line of summary.json; its time is that of all its iterations, interruptions left out."""
    stage, first = config.stages[name], config.iterations_before(name)
    before, after = spent(folder / HISTORY, first), spent(folder / HISTORY, first + stage.iterations)
    seconds, steps = after.seconds - before.seconds, after.agent_steps - before.agent_steps
    return {
        "name": name,
        "team": stage.team,
        "iterations": stage.iterations,
        "agent_steps": steps,
        "wall_time_s": round(seconds, 3),
        "agent_steps_per_s": round(steps / max(seconds, 1e-9), 1),
    }
