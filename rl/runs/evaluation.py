"""Judging controllers on episodes never trained on: other tracks, obstacles, seas and starts.

Every environment runs one episode. Errors are measured after the first `settle` seconds; a team one of whose vehicles
has ended is measured no further, while the other team goes on: the teams do not touch each other.
All sums are NumPy's, in float64, and policies run on one thread, so that the result does not depend on the number of
threads.
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from rl.learn.policy import Policy
from rl.missions.formation.mission import FormationTask
from rl.seeds import derive_seed
from taichi_sim.config import ScenarioConfig

CHUNK = 256  # episodes simulated at once


@dataclass
class TeamRecord:
    """What one team did in a chunk of episodes."""

    errors: np.ndarray  # [step, env, vehicle] m, NaN where not measured
    collided: np.ndarray  # [env, vehicle]
    failed: np.ndarray  # [env]
    hours: float  # of operation


def evaluation_config(config: ScenarioConfig, episodes: int) -> ScenarioConfig:
    """The scenario with one world and one sea per episode of a chunk."""
    n = min(episodes, CHUNK)
    return config.model_copy(
        update={
            "track": config.track.model_copy(update={"worlds": n}),
            "sea": config.sea.model_copy(update={"realisations": n}),
        }
    )


def evaluate(
    config: ScenarioConfig,
    policies: Mapping[str, Policy],
    *,
    episodes: int,
    seed: int,
    controller: str = "policy",
    source: Path | None = None,
    show_progress: bool = True,
) -> dict[str, Any]:
    """Run `episodes` episodes of the teams in `policies` and summarise them; see DEFINITIONS for the keys.

    Raises:
        ValueError: if an episode is too short for anything to be measured.
    """
    check_measurable(config)
    records: dict[str, list[TeamRecord]] = {name: [] for name in policies}
    total = -(-episodes // CHUNK) * config.episode_steps
    with one_thread(), tqdm(total=total, desc="evaluate", unit="step", disable=not show_progress) as bar:
        for first in range(0, episodes, CHUNK):
            n = min(CHUNK, episodes - first)
            task = one_episode_each(config, tuple(policies), n, seed, source, first)
            for name, record in run_episodes(task, policies, bar).items():
                records[name].append(record)
    return {
        "controller": controller,
        "scenario": config.name,
        "seed": seed,
        "episodes": episodes,
        "teams": {name: summarise(chunks, config) for name, chunks in records.items()},
    }


def one_episode_each(
    config: ScenarioConfig, teams: Sequence[str], episodes: int, seed: int, source: Path | None, first: int = 0
) -> FormationTask:
    """A task of `episodes` environments, each at the start of an episode of its own world and sea."""
    task = FormationTask(
        evaluation_config(config, episodes),
        episodes,
        seed=derive_seed(seed, "evaluation", first),
        teams=teams,
        source=source,
    )
    task.reset(worlds=torch.arange(episodes), starts=torch.zeros(episodes, dtype=torch.int64))
    return task


def check_measurable(config: ScenarioConfig) -> None:
    """Refuse a scenario whose episodes end before measuring begins."""
    if config.episode_duration <= config.evaluation.settle:
        raise ValueError(
            f"episode_duration = {config.episode_duration} s must exceed evaluation.settle = "
            f"{config.evaluation.settle} s: errors are measured only after it"
        )


@contextlib.contextmanager
def one_thread():
    """Run torch on one thread: matrix products are then the same bits whatever the machine's setting."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def run_episodes(task: FormationTask, policies: Mapping[str, Policy], bar: tqdm | None = None) -> dict[str, TeamRecord]:
    """One episode in every environment of `task`, freshly reset."""
    steps, config = task.config.episode_steps, task.config
    running = {name: np.ones(task.num_envs, dtype=bool) for name in task.teams}
    records = {
        name: TeamRecord(
            errors=np.full((steps, *team.distance.shape), np.nan),
            collided=np.zeros(team.distance.shape, dtype=bool),
            failed=np.zeros(task.num_envs, dtype=bool),
            hours=0.0,
        )
        for name, team in task.teams.items()
    }
    for i in range(steps):
        step = task.step({name: policies[name](team) for name, team in task.teams.items()})
        for name, record in records.items():
            alive, ended = running[name], step.endings[name]
            record.hours += float(alive.sum()) * config.decision_interval / 3600
            if (i + 1) * config.decision_interval > config.evaluation.settle:
                record.errors[i, alive] = task.teams[name].distance.cpu().numpy()[alive]
            record.collided[alive] |= ended.collided.cpu().numpy()[alive]
            record.failed[alive] |= ended.any.any(dim=1).cpu().numpy()[alive]
            alive &= ~record.failed
        if bar is not None:
            bar.update(1)
    return records


def summarise(records: list[TeamRecord], config: ScenarioConfig) -> dict[str, float | None]:
    """The figures of DEFINITIONS over all chunks of one team."""
    errors = np.concatenate([r.errors for r in records], axis=1)
    collided = np.concatenate([r.collided for r in records])
    failed = np.concatenate([r.failed for r in records])
    hours = sum(r.hours for r in records)
    with np.errstate(invalid="ignore", divide="ignore"):
        measured = np.isfinite(errors)
        squares = np.where(measured, errors, 0.0) ** 2
        rms = np.sqrt(squares.sum(axis=0) / np.maximum(measured.sum(axis=0), 1))
        success = ~failed & measured[-1].all(axis=1) & (rms < config.evaluation.success_error).all(axis=1)
    leader, followers = errors[:, :, 0], errors[:, :, 1:]
    return {
        "leader_error_rms_m": _rms(leader),
        "leader_error_p95_m": _p95(leader),
        "follower_error_rms_m": _rms(followers),
        "follower_error_p95_m": _p95(followers),
        "collisions_per_hour": float(collided.sum() / hours),
        "collision_free_episodes": float(1 - collided.any(axis=1).mean()),
        "success_rate": float(success.mean()),
    }


def _rms(errors: np.ndarray) -> float | None:
    values = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def _p95(errors: np.ndarray) -> float | None:
    values = errors[np.isfinite(errors)]
    return float(np.percentile(values, 95)) if values.size else None
