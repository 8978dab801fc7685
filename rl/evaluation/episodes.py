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

from rl import processes
from rl.evaluation.episode_log import MOST, Crash, Excerpt, Log
from rl.judge import Judge
from rl.learn.policy import Policy
from rl.mission import Mission
from rl.missions import find_mission
from rl.scenario import Scenario
from rl.seeds import derive_seed
from taichi_sim.config import ConfigError
from taichi_sim.kernels import runtime

CHUNK = 256  # episodes simulated at once
LOGS = 2  # chunks whose log is kept, should an episode of theirs be shown
SHOWN = ("worst", "median")  # the episodes that a report shows and that can be recorded


class Trial(NamedTuple):
    """Episodes of one seed under one controller."""

    config: Scenario
    policies: Mapping[str, Policy]  # of the teams that are judged
    episodes: int
    seed: int
    controller: str = "policy"
    source: Path | None = None

    @property
    def chunks(self) -> range:
        """Numbers of the first episode of each chunk."""
        return range(0, self.episodes, CHUNK)

    def mission(self, first: int) -> Any:
        """The mission of a chunk, at its start."""
        count = min(CHUNK, self.episodes - first)
        return one_episode_each(self.config, tuple(self.policies), count, self.seed, self.source, first)


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
        config, policies, episodes=episodes, seed=seed, controller=controller, source=source,
        show_progress=show_progress,
    ).result  # fmt: skip


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
    """The same, with the numbers of each episode; with `look`, also what a report shows of some of them.

    In a process alone; for several see `judge_trials`.
    """
    trial = Trial(config, policies, episodes, seed, controller, source)
    outcome = judge_trials([trial], show_progress=show_progress, look=look)[0]
    if isinstance(outcome, Exception):
        raise outcome
    return outcome


class _Part(NamedTuple):
    """What a chunk of a trial brought."""

    judges: dict[str, Judge]
    crashes: list[Crash]
    cannot: Exception | None = None


def judge_trials(
    trials: Sequence[Trial],
    *,
    cannot: tuple[type[Exception], ...] = (),
    show_progress: bool = True,
    look: bool = False,
) -> list[Outcome | Exception]:
    """Outcomes of several trials, in their order; in the place of one that cannot be, the error, if `cannot` names it.

    Chunks of episodes are shared out over processes (rl/processes): the outcomes are known to rank 0, the same to
    the bit as of a process alone, and the others get an empty list.
    """
    for trial in trials:
        check_measurable(trial.config)
    place = processes.here()
    units = [(number, first) for number, trial in enumerate(trials) for first in trial.chunks]
    own = units[place.rank :: place.count]
    total = sum(trials[number].config.episode_steps for number, _ in own)
    logs: dict[tuple[int, int], Log] = {}
    shown = show_progress and place.first
    with runtime.torch_at_rest(), tqdm(total=total, desc="evaluate", unit="step", disable=not shown) as bar:

        def run_all() -> dict[tuple[int, int], _Part]:
            return {unit: _run_part(trials[unit[0]], unit, cannot, bar, logs if look else None) for unit in own}

        parts = {unit: part for of_rank in processes.of_all(run_all) for unit, part in of_rank.items()}
    found = [_pool(trial, [parts[n, first] for first in trial.chunks]) for n, trial in enumerate(trials) if parts]
    if look:
        chosen = processes.told(lambda: [{} if isinstance(of, Exception) else _chosen(of) for of in found])
        wanted = [(n, name, episode) for n, of_it in enumerate(chosen) for name, episode in of_it.items()]
        mine = [of for of in wanted if (of[0], of[2] - of[2] % CHUNK) in own]
        seen = processes.of_all(lambda: [(n, name, _excerpt(trials[n], n, at, logs)) for n, name, at in mine])
        for n, name, excerpt in (of for of_rank in seen for of in of_rank):
            of_it = found[n]
            assert isinstance(of_it, Outcome)
            of_it.shown[name] = excerpt
    return found


def _run_part(
    trial: Trial,
    unit: tuple[int, int],
    cannot: tuple[type[Exception], ...],
    bar: tqdm,
    logs: dict[tuple[int, int], Log] | None,
) -> _Part:
    """Run a chunk; the logs of the last few are kept."""
    try:
        mission = trial.mission(unit[1])
        log = None if logs is None else Log(mission, unit[1])
        judges = run_episodes(mission, trial.policies, bar, log)
    except cannot as error:
        return _Part({}, [], error)
    if log is None or logs is None:
        return _Part(judges, [])
    logs[unit] = log
    while len(logs) > LOGS:
        del logs[next(iter(logs))]
    return _Part(judges, log.crashes())


def _pool(trial: Trial, parts: Sequence[_Part]) -> Outcome | Exception:
    """The outcome of a trial from those of its chunks; as yet without what is shown."""
    if wrong := next((part.cannot for part in parts if part.cannot is not None), None):
        return wrong
    kind = mission_class(trial.config, trial.source).Judge
    seen = {name: [part.judges[name] for part in parts] for name in trial.policies}
    of_each = {name: kind.episodes(chunks, trial.config) for name, chunks in seen.items()}
    result = {
        "controller": trial.controller,
        "scenario": trial.config.name,
        "seed": trial.seed,
        "episodes": trial.episodes,
        "teams": {name: kind.figures(chunks, trial.config) for name, chunks in seen.items()},
        **{f"{name}_episode": episode for name, episode in choose(kind, of_each).items()},
    }
    return Outcome(result, of_each, {}, [crash for part in parts for crash in part.crashes][:MOST])


def _chosen(outcome: Outcome) -> dict[str, int]:
    """Numbers of the episodes that a report shows."""
    return {name: outcome.result[f"{name}_episode"] for name in SHOWN}


def _excerpt(trial: Trial, number: int, episode: int, logs: Mapping[tuple[int, int], Log]) -> Excerpt:
    """An episode of trial `number`, from the log of its chunk, which is run again if that is not kept."""
    first = episode - episode % CHUNK
    log = logs.get((number, first))
    if log is None:
        with runtime.torch_at_rest():
            mission = trial.mission(first)
            log = Log(mission, first)
            run_episodes(mission, trial.policies, log=log)
    return log.excerpt(episode - first)


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
