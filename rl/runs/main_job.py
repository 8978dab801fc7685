"""The main job: train a scenario's stages, evaluate them on held-out episodes, record and draw an episode."""

import tempfile
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from rl.evaluation.checkups import check_stage
from rl.evaluation.episode_recording import record_episode
from rl.evaluation.episodes import (
    CHUNK,
    Trial,
    check_measurable,
    judge_trials,
    mission_class,
    one_episode_each,
    run_episodes,
)
from rl.evaluation.headroom import judge_on_bounds, read_bounds
from rl.evaluation.report import write_report
from rl.evaluation.store import FILM, save_evaluation, save_headroom
from rl.learn.env import Watch
from rl.learn.history import HISTORY, spent, team_history
from rl.learn.policy import UNTRAINED, load_policy, policies_of
from rl.learn.policy_sources import given_policies
from rl.learn.stages import Observers, train_stages
from rl.mission import Policy
from rl.runs import folder as run_folder
from rl.runs import ranks
from rl.runs.folder import EvaluationResult, Summary
from rl.scenario import Scenario, derive_seed
from rl.team import ControllerError
from taichi_sim.config import ConfigError
from taichi_sim.config.arguments import ActionError
from taichi_sim.config.io import replacing
from taichi_sim.kernels import runtime
from taichi_sim.visualisation.film.files import write_film
from taichi_sim.visualisation.recording import Episode
from taichi_sim.visualisation.recording.rrd import write_recording

RECORDING, FIGURES = "episode.rrd", "figures"
FILM_SIZE, FILM_FPS, FILM_S = (720, 450), 8.0, 10.0  # of the film: px, pictures/s, length in s


def run_main_job(
    config: Scenario, out: Path, *, show_progress: bool = True, watch: Watch | None = None, logger: str = "tensorboard",
    evaluated: bool = True,
) -> Summary | None:  # fmt: skip
    """Train, evaluate, record and draw the scenario of the run folder `out`; return the content of summary.json.

    All processes read the vehicles and modules of `out`, because objects of these modules pass between them. Only rank
    0 writes there; the others return None. `watch` is called after each training step. `logger` is "tensorboard",
    "wandb" or "none". Unless it is to be `evaluated`, it ends with training, and None is returned.

    Raises:
        KeyboardInterrupt: on Ctrl-C, after a checkpoint; the message says how to continue.
    """
    if not config.stages:
        raise ConfigError("stages: the scenario has none: there is nothing to train")
    check_measurable(config)
    source = out / run_folder.CONFIG
    start = time.perf_counter() - sum(spent(out / team / HISTORY).seconds for team in config.trained)
    checkup = partial(check_stage, config, out, source=source, events=logger != "none", show_progress=show_progress)
    try:
        stages = train_stages(
            config, out, source=source, dumps=out / run_folder.DUMPS, judged=partial(_loss, config, source),
            show_progress=show_progress, observers=Observers(logger, watch, checkup if evaluated else None),
        )  # fmt: skip
        if not evaluated:
            return None
        policies: dict[str, Policy] = ranks.broadcast(lambda: {t: load_policy(out, config, t) for t in config.trained})
        policies |= given_policies(config)
        evaluation = _evaluate(config, policies, out, source, show_progress)
        _picture(config, policies, out, source, show_progress)
        if evaluation is None:  # not rank 0
            return None
        summary: Summary = {
            "scenario": config.name,
            "seed": config.seed,
            "wall_time_s": round(time.perf_counter() - start, 3),
            "processes": ranks.here().count,
            "stages": stages,
            "evaluation": evaluation,
        }
        run_folder.write_json(out / run_folder.SUMMARY, summary)
        write_report([out])
    except KeyboardInterrupt as interrupt:
        message = f"checkpoints are in {out}; continue with: {run_folder.resuming(out)}"
        raise type(interrupt)(message) from None
    return summary


def _picture(
    config: Scenario, policies: Mapping[str, Policy], out: Path, source: Path | None, show_progress: bool
) -> None:
    """Record and film an episode of the untrained (if kept) and of the trained teams; draw it and the training.

    The film shows what is not measured at the episode's start and as much again, or all of it if all is measured.
    Processes share the work; rank 0 films and writes.
    """
    place, teams = ranks.here(), {"trained": dict(policies)}
    if untrained := ranks.broadcast(lambda: _untrained(config, out)):
        teams = {"untrained": {**policies, **untrained}} | teams
    drawing = (len(teams) - 1) % place.count  # the rank that records the trained teams
    own: dict[str, Episode] = {}

    def record() -> dict[str, Episode]:
        for caption, of in list(teams.items())[place.rank :: place.count]:
            own[caption] = record_episode(config, of, seed=config.evaluation.seed, source=source,
                                          show_progress=show_progress and place.first)  # fmt: skip
        return own

    def draw() -> dict[str, bytes]:
        if place.first:
            write_recording(shown, out / RECORDING)
            until = 2.0 * config.evaluation.settle or config.episode_duration
            write_film(shown, out / FILM, size=FILM_SIZE, fps=FILM_FPS, speed=until / FILM_S, until=until)
        if place.rank != drawing:
            return {}
        with tempfile.TemporaryDirectory() as folder:
            mission_class(config, source).draw_figures(Path(folder), histories, own["trained"], config)
            return {file.name: file.read_bytes() for file in Path(folder).iterdir()}

    shown = {caption: episode for of_rank in ranks.gather(record) for caption, episode in of_rank.items()}
    histories = ranks.broadcast(lambda: {team: team_history(out / team) for team in config.trained})
    for figures in ranks.gather(draw):
        for name, content in figures.items():
            with replacing(out / FIGURES / name) as part:
                part.write_bytes(content)


def _untrained(config: Scenario, out: Path) -> dict[str, Policy] | None:
    """The trained teams' policies before their training, if they were kept."""
    kept = all((out / team / UNTRAINED).is_file() for team in config.trained)
    return policies_of("untrained", out, config) if kept else None


def _loss(config: Scenario, source: Path | None, policies: Mapping[str, Policy]) -> float:
    """Loss of the teams (Judge.loss) on episodes used neither for training nor for evaluation."""
    judge, seed = mission_class(config, source).Judge, derive_seed(config.seed, "better")
    with runtime.torch_at_rest():
        policies = {**given_policies(config), **policies}
        teams = {name: policies[name] for name in config.teams if name in policies}
        mission = one_episode_each(config, tuple(teams), min(config.evaluation.episodes, CHUNK), seed, source)
        seen = run_episodes(mission, teams)
    return float(sum(judge.loss(judge.episodes([of], config), config).mean() for of in seen.values()))


def _evaluate(
    config: Scenario, policies: Mapping[str, Policy], out: Path, source: Path | None, show_progress: bool
) -> EvaluationResult | None:
    """Evaluate policies and classical controllers, store both in the run's folder, return the policies' result."""
    rivals = policies_of("classical", out, config)
    trials = [
        Trial(config, {team: of[team] for team in config.acting}, config.evaluation.episodes, config.evaluation.seed,
              controller, source)
        for controller, of in (("policy", policies), ("classical", rivals))
    ]  # fmt: skip
    cannot = (ControllerError, ActionError)  # some vehicles have no classical controller, or one that fails
    outcomes = judge_trials(trials, cannot=cannot, show_progress=show_progress, excerpts=True)
    for outcome in outcomes:
        if not isinstance(outcome, Exception):
            save_evaluation(out, outcome)
    if bounds := ranks.broadcast(lambda: read_bounds(config)):
        judged = judge_on_bounds(bounds, config, policies, source)
        if ranks.here().first:
            save_headroom(out, judged)
    learned = outcomes[0] if outcomes else None
    if isinstance(learned, Exception):
        raise learned
    return None if learned is None else learned.result
