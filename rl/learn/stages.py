"""Training stage by stage: each team learns while the teams of earlier stages act from their frozen policies."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from rl.learn.env import MissionEnv
from rl.learn.export import ONNX, TORCHSCRIPT, export_policy
from rl.learn.policy import TrainedPolicy, checkpoints, load_policy, read_checkpoint
from rl.learn.runner import HISTORY, StageRunner, history_seconds
from rl.missions import make_mission
from rl.scenario import Scenario, StageConfig
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
        policies[stage.team] = load_policy(out, config, stage.team)
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
    stage = config.stages[name]
    folder = out / stage.team
    saved = checkpoints(folder)
    done = read_checkpoint(saved[-1])["iter"] if saved else 0
    seed = derive_seed(config.seed, name, done)
    torch.manual_seed(seed)
    teams = tuple(t for t in config.teams if t == stage.team or t in policies)
    mission = make_mission(config, stage.num_envs, seed=derive_seed(config.seed, name), teams=teams, source=source)
    mission.reseed(seed)
    mission.world.dump_folder = dumps
    frozen = {t: policies[t] for t in mission.teams if t != stage.team}
    env = MissionEnv(mission, stage.team, frozen, scale=1 - stage.discount)
    runner = StageRunner(env, stage, folder)
    if saved:
        runner.load(str(saved[-1]))
    if done < stage.iterations:
        number = list(config.stages).index(name) + 1
        runner.train(show_progress=show_progress, label=f"stage {number}/{len(config.stages)} {name}")
    if done < stage.iterations or not all((folder / name).is_file() for name in (TORCHSCRIPT, ONNX)):
        export_policy(runner.alg.get_policy(), folder, runner.signature)
    return stage_result(folder, name, stage, env.num_envs)


def stage_result(folder: Path, name: str, stage: StageConfig, rows: int) -> dict[str, Any]:
    """This stage's line of summary.json; its time is that of all its iterations, interruptions left out."""
    steps = stage.iterations * rows * stage.steps_per_iteration
    seconds = history_seconds(folder / HISTORY)
    return {
        "name": name,
        "team": stage.team,
        "iterations": stage.iterations,
        "agent_steps": steps,
        "wall_time_s": round(seconds, 3),
        "agent_steps_per_s": round(steps / max(seconds, 1e-9), 1),
    }
