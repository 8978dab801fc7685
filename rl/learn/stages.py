"""Training stage by stage: each team learns while the teams of earlier stages act from their frozen policies."""

from pathlib import Path
from typing import Any

import torch

from rl.learn.env import FormationEnv
from rl.learn.export import ONNX, TORCHSCRIPT, export_policy
from rl.learn.policy import TrainedPolicy, checkpoints, load_policy, read_checkpoint
from rl.learn.runner import HISTORY, StageRunner, history_seconds
from rl.missions.formation.mission import FormationTask
from rl.runs import folder as run_folder
from rl.seeds import derive_seed
from taichi_sim.config import ScenarioConfig, StageConfig
from taichi_sim.conventions import TEAMS


def train_stages(config: ScenarioConfig, out: Path, *, show_progress: bool = True) -> list[dict[str, Any]]:
    """Train every stage that `out` does not hold finished, continuing from checkpoints; return their results."""
    results, policies = [], {}
    for number, (name, stage) in enumerate(config.stages.items(), start=1):
        folder = out / stage.team
        folder.mkdir(parents=True, exist_ok=True)
        label = f"stage {number}/{len(config.stages)} {name}"
        results.append(train_stage(config, out, name, stage, policies, label, show_progress))
        policies[stage.team] = load_policy(out, config, stage.team)
    return results


def train_stage(
    config: ScenarioConfig,
    out: Path,
    name: str,
    stage: StageConfig,
    policies: dict[str, TrainedPolicy],
    label: str,
    show_progress: bool,
) -> dict[str, Any]:
    """Train one stage to its last iteration and export its policy; return its line of summary.json."""
    folder = out / stage.team
    saved = checkpoints(folder)
    done = read_checkpoint(saved[-1])["iter"] if saved else 0
    seed = derive_seed(config.seed, name, done)
    torch.manual_seed(seed)
    teams = tuple(t for t in TEAMS if t == stage.team or t in policies)
    task = FormationTask(
        config, stage.num_envs, seed=derive_seed(config.seed, name), teams=teams, source=out / run_folder.CONFIG
    )
    task.reseed(seed)
    task.world.dump_folder = out / run_folder.DUMPS
    env = FormationEnv(task, stage.team, {t: policies[t] for t in teams if t != stage.team})
    runner = StageRunner(env, stage, folder)
    if saved:
        runner.load(str(saved[-1]))
    if done < stage.iterations:
        runner.train(show_progress=show_progress, label=label)
    if done < stage.iterations or not all((folder / name).is_file() for name in (TORCHSCRIPT, ONNX)):
        export_policy(runner.alg.get_policy(), folder)
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
