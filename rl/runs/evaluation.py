"""Judging controllers on episodes never trained on: other worlds, seas and starts than any that was trained on.

Every environment runs one episode; what is measured is the mission's (rl/judge.py). Policies run on one thread, so that
the result does not depend on the number of threads. What an episode is depends on all that are run beside it: it is run
again by running its whole chunk again.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rl.judge import Judge
from rl.learn.policy import Policy
from rl.mission import Mission
from rl.missions import find_mission
from rl.runs.log import Crash, Excerpt, Log
from rl.scenario import Scenario
from rl.seeds import derive_seed
from taichi_sim import runtime
from taichi_sim.config import ConfigError

CHUNK = 256  # episodes simulated at once
SHOWN = ("worst", "median")  # the episodes that a report shows and that can be recorded


class Outcome(NamedTuple):
    """What an evaluation brought."""

    result: dict[str, Any]  # what `evaluate` returns
    episodes: dict[str, dict[str, NDArray[np.float64]]]  # team -> name -> [episode], see Judge.episodes
    shown: dict[str, Excerpt]  # by the names in SHOWN
    crashes: list[Crash]


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
        ConfigError: if an episode is too short for anything to be measured.
    """
    return judge_episodes(
        config,
        policies,
        episodes=episodes,
        seed=seed,
        controller=controller,
        source=source,
        show_progress=show_progress,
    ).result


def judge_episodes(
    config: Scenario,
    policies: Mapping[str, Policy],
    *,
    episodes: int,
    seed: int,
    controller: str = "policy",
    source: Path | None = None,
    show_progress: bool = True,
    look: bool = False,
) -> Outcome:
    """The same, with the numbers of each episode; with `look`, also what a report shows of some of them."""
    check_measurable(config)
    kind = mission_class(config, source).Judge
    seen: dict[str, list[Any]] = {name: [] for name in policies}
    crashes: list[Crash] = []
    log: Log | None = None
    total = -(-episodes // CHUNK) * config.episode_steps
    with runtime.torch_at_rest(), tqdm(total=total, desc="evaluate", unit="step", disable=not show_progress) as bar:
        for first in range(0, episodes, CHUNK):
            mission = one_episode_each(config, tuple(policies), min(CHUNK, episodes - first), seed, source, first)
            log = Log(mission, first) if look else None
            for name, judge in run_episodes(mission, policies, bar, log).items():
                seen[name].append(judge)
            crashes += log.crashes(len(crashes)) if log else []
    of_each = {name: kind.episodes(chunks, config) for name, chunks in seen.items()}
    chosen = choose(kind, of_each)
    shown = {}
    if log:  # of the last chunk; an episode of another is run again
        for name, episode in chosen.items():
            there = log if episode >= log.first else _log_again(config, policies, episodes, seed, source, episode)
            shown[name] = there.excerpt(episode - there.first)
    result = {
        "controller": controller,
        "scenario": config.name,
        "seed": seed,
        "episodes": episodes,
        "teams": {name: kind.figures(chunks, config) for name, chunks in seen.items()},
        **{f"{name}_episode": episode for name, episode in chosen.items()},
    }
    return Outcome(result, of_each, shown, crashes)


def choose(kind: type[Judge], episodes: Mapping[str, Any]) -> dict[str, int]:
    """Numbers of the worst and of the median episode, of all teams together."""
    bad = np.maximum.reduce([kind.badness(of_team) for of_team in episodes.values()])
    order = np.lexsort(bad[::-1])
    return {"worst": int(order[-1]), "median": int(order[(len(order) - 1) // 2])}


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


def chunk_with(
    config: Scenario, teams: Sequence[str], episodes: int, seed: int, source: Path | None, episode: int
) -> tuple[Any, int]:
    """The mission in which an evaluation of `episodes` ran number `episode`, at its start; the number of its first."""
    first = episode - episode % CHUNK
    return one_episode_each(config, teams, min(CHUNK, episodes - first), seed, source, first), first


def _log_again(
    config: Scenario, policies: Mapping[str, Policy], episodes: int, seed: int, source: Path | None, episode: int
) -> Log:
    with runtime.torch_at_rest():
        mission, first = chunk_with(config, tuple(policies), episodes, seed, source, episode)
        log = Log(mission, first)
        run_episodes(mission, policies, log=log)
    return log


def check_measurable(config: Scenario) -> None:
    """Refuse a scenario whose episodes end before measuring begins.

    Raises:
        ConfigError: naming both keys.
    """
    if config.episode_duration <= config.evaluation.settle:
        raise ConfigError(
            f"episode_duration = {config.episode_duration} s must exceed evaluation.settle = "
            f"{config.evaluation.settle} s: errors are measured only after it"
        )


def run_episodes(
    mission: Any, policies: Mapping[str, Policy], bar: tqdm | None = None, log: Log | None = None
) -> dict[str, Any]:
    """One episode in every environment of `mission`, freshly reset: its judge of each team."""
    judges = {name: mission.Judge(mission, name) for name in mission.teams}
    for number in range(1, mission.config.episode_steps + 1):
        step = mission.step({name: policies[name](team) for name, team in mission.teams.items()})
        if log is not None:
            log.see(judges, step, number)
        for judge in judges.values():
            judge.see(step, number)
        if bar is not None:
            bar.update(1)
    return judges
