"""Judging controllers on episodes never trained on: other worlds, seas and starts than any that was trained on.

Every environment runs one episode; what is measured is the mission's (rl/judge.py). Policies run on one thread, so that
the result does not depend on the number of threads.
"""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from rl.learn.policy import Policy
from rl.mission import Mission
from rl.missions import find_mission
from rl.scenario import Scenario
from rl.seeds import derive_seed

CHUNK = 256  # episodes simulated at once


def evaluate(
    config: Scenario,
    policies: Mapping[str, Policy],
    *,
    episodes: int,
    seed: int,
    controller: str = "policy",
    source: Path | None = None,
    show_progress: bool = True,
) -> dict[str, Any]:
    """Run `episodes` episodes of the teams in `policies` and summarise them; the mission's judge defines the keys.

    Raises:
        ValueError: if an episode is too short for anything to be measured.
    """
    check_measurable(config)
    kind = mission_class(config, source)
    seen: dict[str, list[Any]] = {name: [] for name in policies}
    total = -(-episodes // CHUNK) * config.episode_steps
    with one_thread(), tqdm(total=total, desc="evaluate", unit="step", disable=not show_progress) as bar:
        for first in range(0, episodes, CHUNK):
            mission = one_episode_each(config, tuple(policies), min(CHUNK, episodes - first), seed, source, first)
            for name, judge in run_episodes(mission, policies, bar).items():
                seen[name].append(judge)
    return {
        "controller": controller,
        "scenario": config.name,
        "seed": seed,
        "episodes": episodes,
        "teams": {name: kind.Judge.figures(chunks, config) for name, chunks in seen.items()},
    }


def mission_class(config: Scenario, source: Path | None) -> type[Mission]:
    """The class of a scenario's mission."""
    return find_mission(config.mission, [source.parent] if source else [])


def one_episode_each(
    config: Scenario, teams: Sequence[str], episodes: int, seed: int, source: Path | None, first: int = 0
) -> Any:
    """A mission of `episodes` environments, each at the start of an episode of its own world and sea."""
    kind = mission_class(config, source)
    chunk = kind.one_each(config, min(episodes, CHUNK))
    mission = kind(chunk, episodes, seed=derive_seed(seed, "evaluation", first), teams=teams, source=source)
    mission.begin_each()
    return mission


def check_measurable(config: Scenario) -> None:
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


def run_episodes(mission: Any, policies: Mapping[str, Policy], bar: tqdm | None = None) -> dict[str, Any]:
    """One episode in every environment of `mission`, freshly reset: its judge of each team."""
    judges = {name: mission.Judge(mission, name) for name in mission.teams}
    for number in range(1, mission.config.episode_steps + 1):
        step = mission.step({name: policies[name](team) for name, team in mission.teams.items()})
        for judge in judges.values():
            judge.see(step, number)
        if bar is not None:
            bar.update(1)
    return judges
