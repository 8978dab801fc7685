"""The main job: train the stages of a scenario, evaluate them on unseen worlds, record and draw an episode."""

import time
from pathlib import Path
from typing import Any

from rl.learn.history import read_history
from rl.learn.policy import load_policy
from rl.learn.runner import HISTORY, history_seconds
from rl.learn.stages import train_stages
from rl.runs import folder as run_folder
from rl.runs.evaluation import check_measurable, evaluate, mission_class
from rl.runs.record import record_episode
from rl.scenario import Scenario
from taichi_sim.config import ConfigError
from taichi_sim.recording import write_recording

RECORDING, FIGURES = "episode.rrd", "figures"


def run_main_job(config: Scenario, out: Path, *, show_progress: bool = True) -> dict[str, Any]:
    """Train, evaluate, record and draw into the run folder `out`; return what summary.json holds.

    Raises:
        ConfigError: if the scenario has nothing to train or its episodes cannot be measured.
        KeyboardInterrupt: saying how to go on, with the work so far in checkpoints.
    """
    if not config.stages:
        raise ConfigError("stages: the scenario has none, so there is nothing to train")
    try:
        check_measurable(config)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    start = time.perf_counter() - sum(history_seconds(out / s.team / HISTORY) for s in config.stages.values())
    source = out / run_folder.CONFIG
    try:
        stages = train_stages(config, out, source=source, dumps=out / run_folder.DUMPS, show_progress=show_progress)
        policies = {team: load_policy(out, config, team) for team in config.trained}
        judged = config.evaluation
        evaluation = evaluate(
            config, policies, episodes=judged.episodes, seed=judged.seed, source=source, show_progress=show_progress
        )
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
    return summary


def report(evaluation: dict[str, Any], config: Scenario, source: Path | None = None) -> str:
    """An evaluation as lines to read."""
    judge = mission_class(config, source).Judge
    lines = [f"{evaluation['episodes']} episodes of unseen worlds, {evaluation['controller']}:"]
    lines += [f"  {team}: {judge.line(figures)}" for team, figures in evaluation["teams"].items()]
    return "\n".join(lines)
