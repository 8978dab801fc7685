"""Training stage by stage: one team learns while the teams of earlier stages act by their frozen policies.

Several stages may train one team; they share a folder with one history of iterations, progress.csv and checkpoints.
Several teams may learn in one stage (env.py). A stage with `keep = "better"` is compared with the policies before it.
"""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch

from rl.learn.env import Learner, MissionEnv, Watch
from rl.learn.export import ONNX, TORCHSCRIPT, export_policy
from rl.learn.history import HISTORY, spent
from rl.learn.joint_learner import JointLearner
from rl.learn.policy import (
    Policy,
    TrainedPolicy,
    checkpoints,
    load_policy,
    read_checkpoint,
    write_checkpoint,
)
from rl.learn.policy_sources import given_policies
from rl.learn.results import Batch, StageResult, Verdict
from rl.learn.runner import StageRunner
from rl.missions import make_mission
from rl.runs import ranks
from rl.scenario import Scenario, StageConfig, at_stage, derive_seed

Judged = Callable[[Mapping[str, TrainedPolicy]], float]
"""Loss of a set of policies, team -> policy; it decides whether a stage with `keep = "better"` is kept."""


class Observers(NamedTuple):
    """What follows a training and changes nothing of it."""

    logger: str = "tensorboard"  # or "wandb", "none"
    watch: Watch | None = None
    ended: Callable[[str], None] | None = None  # called with each stage's name at its end, by every process


NOBODY = Observers()


def train_stages(
    config: Scenario, out: Path, *, source: Path | None = None, dumps: Path | None = None, judged: Judged | None = None,
    show_progress: bool = True, observers: Observers = NOBODY,
) -> list[StageResult]:  # fmt: skip
    """Train every stage that is not finished in `out`, from its last checkpoint; return the stages' results.

    With several processes, each has its share of a stage's environments; rank 0 alone reads and writes what this leaves
    in `out`.

    Vehicle files lie beside the scenario's file `source`. `dumps` is a folder for environments whose state stopped
    being finite (taichi_sim/state/divergence_dump.py). Without `judged`, every stage is kept.
    """
    policies: dict[str, TrainedPolicy] = {}
    for name in config.stages:
        changed = train_stage(config, out, name, policies, source, dumps, show_progress, observers)
        policies |= ranks.broadcast(partial(_ended, config, out, name, policies, judged, changed))
        if observers.ended is not None:
            observers.ended(name)
    return ranks.broadcast(lambda: [stage_result(out, name, config) for name in config.stages])


def _ended(
    config: Scenario, out: Path, name: str, others: Mapping[str, TrainedPolicy], judged: Judged | None, changed: bool,
) -> dict[str, TrainedPolicy]:  # fmt: skip
    """The policies to use after a finished stage; new ones are exported."""
    stage = config.stages[name]
    ended = {team: config.iterations_before(name, team) + stage.iterations for team in stage.learners}
    now = {team: load_policy(out, config, team, ended[team]) for team in stage.learners}
    if stage.keep == "better" and judged is not None:
        last = read_checkpoint(out / stage.team / f"model_{ended[stage.team]}.pt")
        if "verdict" not in (last.get("infos") or {}):
            now, changed = _better(config, out, name, others, now, judged), True
    for team in stage.learners:
        if changed or not all((out / team / name).is_file() for name in (TORCHSCRIPT, ONNX)):
            export_policy(now[team].actor, out / team, now[team].signature)
    return now


def train_stage(
    config: Scenario, out: Path, name: str, policies: Mapping[str, TrainedPolicy], source: Path | None,
    dumps: Path | None, show_progress: bool, observers: Observers,
) -> bool:  # fmt: skip
    """Train the stage `name` to its last iteration; return False if it was finished already."""
    stage, first, place = config.stages[name], config.iterations_before(name), ranks.here()
    done = ranks.broadcast(partial(_completed, out, stage))
    if done >= first + stage.iterations:
        return False
    rank = (place.rank,) if place.rank else ()  # each rank has its own worlds, seas, starts and exploration
    seed = derive_seed(config.seed, name, done, *rank)
    torch.manual_seed(seed)
    frozen: dict[str, Policy] = {**given_policies(config), **policies}
    acting = frozen if stage.acting is None else stage.acting
    teams = tuple(t for t in config.teams if t in stage.learners or t in acting)
    here = at_stage(config, name)
    envs, worlds = ranks.envs_each(stage.num_envs), derive_seed(config.seed, name, *rank)
    mission = make_mission(here, envs, seed=worlds, teams=teams, source=source)
    mission.reseed(seed)
    mission.world.dump_folder = dumps

    def runner_of(team: str, others: Mapping[str, Policy | None]) -> StageRunner:
        env = MissionEnv(mission, team, others, scale=1 - stage.discount)
        begun = config.iterations_before(name, team)
        runner = StageRunner(env, stage, out / team, begun, observers.logger)
        begins = out / team / f"model_{done - first + begun}.pt"
        if done - first + begun or ranks.broadcast(begins.is_file):
            runner.load(str(begins))
        return runner

    others: dict[str, Policy | None] = {t: frozen.get(t) for t in teams}
    joint = [JointLearner(runner_of(t, {o: others[o] for o in teams if o != t})) for t in stage.joint]
    others |= {learner.env.team: learner for learner in joint}
    runner = runner_of(stage.team, {o: others[o] for o in teams if o != stage.team})
    runner.env.joint, runner.logger.joint = list[Learner](joint), joint
    runner.env.watch = observers.watch
    number = list(config.stages).index(name) + 1
    runner.train(show_progress=show_progress and place.first, label=f"stage {number}/{len(config.stages)} {name}")
    return True


def _completed(out: Path, stage: StageConfig) -> int:
    """Completed iterations in the newest checkpoint of a stage's team."""
    for team in stage.learners:
        (out / team).mkdir(parents=True, exist_ok=True)
    saved = checkpoints(out / stage.team)
    return read_checkpoint(saved[-1])["iter"] if saved else 0


def _better(
    config: Scenario, out: Path, name: str, others: Mapping[str, TrainedPolicy], now: Mapping[str, TrainedPolicy],
    judged: Judged,
) -> dict[str, TrainedPolicy]:  # fmt: skip
    """The policies with the lower loss: those that the stage has trained, or those before it.

    The decision and the chosen weights go into the stage's last checkpoints.
    """
    stage, kept = config.stages[name], dict(now)
    first = {team: config.iterations_before(name, team) for team in now}
    before = {team: load_policy(out, config, team, first[team]) for team in now}
    losses = judged({**others, **before}), judged({**others, **now})
    better = losses[1] < losses[0]
    for team in (*stage.joint, stage.team):  # the driving team last: its verdict then implies the others'
        last = out / team / f"model_{first[team] + stage.iterations}.pt"
        content = read_checkpoint(last)
        if not better:
            earlier = read_checkpoint(out / team / f"model_{first[team]}.pt")
            content |= {key: value for key, value in earlier.items() if key not in ("iter", "infos")}
            kept[team] = before[team]
        verdict = {"kept": better, "loss_before": losses[0], "loss": losses[1]}
        content["infos"] = {**(content.get("infos") or {}), "verdict": verdict}
        write_checkpoint(content, last)
    return kept


def stage_result(out: Path, name: str, config: Scenario) -> StageResult:
    """The stage's entry of summary.json; its time excludes interruptions."""
    stage, steps = config.stages[name], 0
    for team in reversed(stage.learners):  # the driving team last: the time is its own
        first, file = config.iterations_before(name, team), out / team / HISTORY
        before, after = spent(file, first), spent(file, first + stage.iterations)
        steps += after.agent_steps - before.agent_steps
        seconds = after.seconds - before.seconds
    result: StageResult = {
        "name": name, "team": stage.team, "iterations": stage.iterations, "agent_steps": steps,
        "wall_time_s": round(seconds, 3), "agent_steps_per_s": round(steps / max(seconds, 1e-9), 1),
    }  # fmt: skip
    infos = read_checkpoint(out / stage.team / f"model_{first + stage.iterations}.pt").get("infos") or {}
    verdict: Verdict | None = infos.get("verdict")
    batches: list[Batch] = infos.get("batches") or [{}]
    latest = batches[-1]
    if "processes" in latest and "environments" in latest:
        result["processes"], result["environments"] = latest["processes"], latest["environments"]
    if len(batches) > 1:
        result["batches"] = batches  # it was resumed with another number of processes or environments
    if stage.joint:
        result["joint"] = list(stage.joint)
    if verdict:
        result["verdict"] = verdict
    return result
