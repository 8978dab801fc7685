"""The main job: train the stages of a scenario, evaluate them on unseen worlds, record and draw an episode."""

import contextlib
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rl.learn.env import Watch
from rl.learn.history import read_history
from rl.learn.policy import Policy, load_policy, policies_of
from rl.learn.runner import HISTORY, spent
from rl.learn.stages import train_stages
from rl.mission import ControllerError
from rl.runs import folder as run_folder
from rl.runs.evaluation import (
    CHUNK,
    check_measurable,
    judge_episodes,
    mission_class,
    one_episode_each,
    run_episodes,
)
from rl.runs.kept import keep
from rl.runs.record import record_episode
from rl.runs.report import write_report
from rl.scenario import Scenario
from rl.seeds import derive_seed
from taichi_sim import runtime
from taichi_sim.config import ConfigError
from taichi_sim.recording import write_recording
from taichi_sim.world import ActionError

RECORDING, FIGURES = "episode.rrd", "figures"


def run_main_job(
    config: Scenario, out: Path, *, show_progress: bool = True, watch: Watch | None = None
) -> dict[str, Any]:
    """Train, evaluate, record and draw into the run folder `out`; return what summary.json holds. `watch` is told of
    each step of the training.

    Raises:
        ConfigError: if the scenario has nothing to train or its episodes cannot be measured.
        KeyboardInterrupt: saying how to go on, with the work so far in checkpoints.
    """
    if not config.stages:
        raise ConfigError("stages: the scenario has none, so there is nothing to train")
    check_measurable(config)
    start = time.perf_counter() - sum(spent(out / team / HISTORY).seconds for team in config.trained)
    source = out / run_folder.CONFIG
    try:
        stages = train_stages(
            config, out, source=source, dumps=out / run_folder.DUMPS, judged=partial(_loss, config, source),
            show_progress=show_progress, watch=watch,
        )  # fmt: skip
        policies = {team: load_policy(out, config, team) for team in config.trained}
        judged = config.evaluation
        evaluation = _evaluate(config, policies, out, show_progress)
        with contextlib.suppress(ControllerError, ActionError):  # not every vehicle has one that can
            _evaluate(config, policies_of("classical", out, config), out, show_progress, "classical")
        episode = record_episode(config, policies, seed=judged.seed, source=source, show_progress=show_progress)
        write_recording(episode, out / RECORDING)
        histories = {team: read_history(out / team / HISTORY) for team in policies}
        mission_class(config, source).draw_figures(out / FIGURES, histories, episode, config)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"checkpoints are in {out}; continue with --out {out} --resume") from None
    summary = {
        "scenario": config.name,
        "seed": config.seed,
        "wall_time_s": round(time.perf_counter() - start, 3),
        "stages": stages,
        "evaluation": evaluation,
    }
    run_folder.write_json(out / run_folder.SUMMARY, summary)
    write_report([out])
    return summary


def _loss(config: Scenario, source: Path, policies: Mapping[str, Policy]) -> float:
    """How badly teams do together (Judge.loss), on episodes that no policy is trained on and no evaluation is of."""
    judge, seed = mission_class(config, source).Judge, derive_seed(config.seed, "better")
    with runtime.torch_at_rest():
        teams = {name: policies[name] for name in config.teams if name in policies}
        mission = one_episode_each(config, tuple(teams), min(config.evaluation.episodes, CHUNK), seed, source)
        seen = run_episodes(mission, teams)
    return float(sum(judge.loss(judge.episodes([of], config), config).mean() for of in seen.values()))


def _evaluate(
    config: Scenario, policies: Mapping[str, Policy], out: Path, show_progress: bool, controller: str = "policy"
) -> dict[str, Any]:
    """The scenario's own evaluation, kept in the run's folder."""
    outcome = judge_episodes(
        config,
        {team: policies[team] for team in config.trained},
        episodes=config.evaluation.episodes,
        seed=config.evaluation.seed,
        controller=controller,
        source=out / run_folder.CONFIG,
        show_progress=show_progress,
        look=True,
    )
    keep(out, outcome)
    return outcome.result


def report(evaluation: dict[str, Any], config: Scenario, source: Path | None = None) -> str:
    """An evaluation as lines to read."""
    judge = mission_class(config, source).Judge
    lines = [f"{evaluation['episodes']} episodes of unseen worlds, {evaluation['controller']}:"]
    lines += [f"  {team}: {judge.line(figures)}" for team, figures in evaluation["teams"].items()]
    return "\n".join(lines)
