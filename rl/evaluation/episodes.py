"""Evaluation of controllers on held-out episodes: worlds, seas and starts that no training has used.

Every environment runs one episode, and the mission's judge measures it (rl/judge.py). Policies run on one
thread, so that the result does not depend on the number of threads. An episode depends on the whole chunk that runs
beside it: repeating one episode means running its chunk again.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rl.evaluation.conditions import Conditions, conditions_of
from rl.evaluation.episode_log import MAX_CRASHES, Crash, End, EpisodeLog, Excerpt
from rl.judge import Episodes, Judge
from rl.mission import Mission, Policy
from rl.missions import find_mission
from rl.runs import ranks
from rl.runs.folder import EvaluationResult
from rl.scenario import Scenario, derive_seed
from rl.step import Step
from taichi_sim.config import ConfigError
from taichi_sim.kernels import runtime

CHUNK = 256  # episodes simulated at once
LOGS = 2  # chunks whose log stays in memory, in case a report shows one of their episodes
SHOWN = ("worst", "median")  # episodes that a report shows and a recording can repeat


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
        """The number of the first episode of each chunk."""
        return range(0, self.episodes, CHUNK)

    def chunk_of(self, episode: int) -> int:
        """The number of the first episode in the chunk of `episode`."""
        return episode - episode % CHUNK

    def mission(self, first: int) -> Mission:
        """The mission of the chunk that begins with episode `first`, at its start."""
        count = min(CHUNK, self.episodes - first)
        return one_episode_each(self.config, tuple(self.policies), count, self.seed, self.source, first)


class Watcher(Protocol):
    """What sees the decisions of a chunk of episodes, before its judges do."""

    def see(self, judges: Mapping[str, Judge], step: Step, number: int) -> None:
        """Take decision `number` (from 1) into account."""
        ...


Watch = Callable[[Mission, int], Watcher]
"""What sees the chunk of a mission at its start, whose environment 0 is the episode of this number."""


class EvaluationOutcome(NamedTuple):
    """The result of an evaluation."""

    result: EvaluationResult  # a summary
    episodes: dict[str, dict[str, NDArray[np.float64]]]  # team -> name -> [episode], see Judge.episodes
    shown: dict[str, Excerpt]  # a name in SHOWN -> its episode
    crashes: list[Crash]
    conditions: Conditions  # [episode]
    ends: list[End]  # of vehicles, by episode and time; kept with `excerpts`


def judge_episodes(
    config: Scenario,
    policies: Mapping[str, Policy],
    *,
    episodes: int,
    seed: int,
    controller: str = "policy",
    source: Path | None = None,
    show_progress: bool = True,
    excerpts: bool = False,
) -> EvaluationOutcome:
    """Run `episodes` episodes of the teams in `policies`; `excerpts` also keeps those that a report shows.

    The mission's judge defines the keys of the result. It runs in one process; `judge_trials` uses several.
    """
    trial = Trial(config, policies, episodes, seed, controller, source)
    with ranks.alone():
        outcome = judge_trials([trial], show_progress=show_progress, excerpts=excerpts)[0]
    if isinstance(outcome, Exception):
        raise outcome
    return outcome


class _Part(NamedTuple):
    """The result of one chunk of a trial."""

    judges: dict[str, Judge]
    conditions: Conditions
    crashes: list[Crash]
    ends: list[End]
    cannot: Exception | None = None


@runtime.loop.as_for_many()
def judge_trials(
    trials: Sequence[Trial],
    *,
    cannot: tuple[type[Exception], ...] = (),
    show_progress: bool = True,
    excerpts: bool = False,
    watch: Watch | None = None,
) -> list[EvaluationOutcome | Exception]:
    """Run several trials and return their outcomes in order, or the error of a trial if `cannot` lists its type.

    `watch` sees the chunks of this process.

    Processes share the chunks. Rank 0 gets the outcomes, with the same bits as in a single process; the
    other ranks get an empty list.
    """
    for trial in trials:
        check_measurable(trial.config)
    place = ranks.here()
    units = [(number, first) for number, trial in enumerate(trials) for first in trial.chunks]
    own = units[place.rank :: place.count]
    total = sum(trials[number].config.episode_steps for number, _ in own)
    logs: dict[tuple[int, int], EpisodeLog] = {}
    shown = show_progress and place.first
    with runtime.torch_at_rest(), tqdm(total=total, desc="evaluate", unit="step", disable=not shown) as bar:

        def run_all() -> dict[tuple[int, int], _Part]:
            return {
                unit: _run_part(trials[unit[0]], unit, cannot, bar, logs if excerpts else None, watch) for unit in own
            }

        parts = {unit: part for of_rank in ranks.gather(run_all) for unit, part in of_rank.items()}
    outcomes = [_pool(trial, [parts[n, first] for first in trial.chunks]) for n, trial in enumerate(trials) if parts]
    if excerpts:
        chosen = ranks.broadcast(
            lambda: [{} if isinstance(o, Exception) else shown_numbers(o.result) for o in outcomes]
        )
        shown_episodes = [(n, name, episode) for n, of_trial in enumerate(chosen) for name, episode in of_trial.items()]
        mine = [(n, name, episode) for n, name, episode in shown_episodes if (n, trials[n].chunk_of(episode)) in own]
        gathered = ranks.gather(lambda: [(n, name, _excerpt(trials[n], n, at, logs)) for n, name, at in mine])
        for n, name, excerpt in (item for of_rank in gathered for item in of_rank):
            outcome = outcomes[n]
            assert isinstance(outcome, EvaluationOutcome)
            outcome.shown[name] = excerpt
    return outcomes


def _run_part(
    trial: Trial,
    unit: tuple[int, int],
    cannot: tuple[type[Exception], ...],
    bar: tqdm,
    logs: dict[tuple[int, int], EpisodeLog] | None,
    watch: Watch | None,
) -> _Part:
    """Run a chunk; `logs` keeps the logs of the last few chunks."""
    try:
        mission = trial.mission(unit[1])
        log, conditions = None if logs is None else EpisodeLog(mission, unit[1]), conditions_of(mission)
        watchers = [] if log is None else [log]
        judges = run_episodes(
            mission, trial.policies, bar, watchers + ([] if watch is None else [watch(mission, unit[1])])
        )
    except cannot as error:
        return _Part({}, {}, [], [], error)
    if log is None or logs is None:
        return _Part(judges, conditions, [], [])
    logs[unit] = log
    while len(logs) > LOGS:
        del logs[next(iter(logs))]
    return _Part(judges, conditions, log.crashes(), log.ends())


def _pool(trial: Trial, parts: Sequence[_Part]) -> EvaluationOutcome | Exception:
    """Combine the chunks of a trial into its outcome, without excerpts."""
    if wrong := next((part.cannot for part in parts if part.cannot is not None), None):
        return wrong
    kind = mission_class(trial.config, trial.source).Judge
    seen = {name: [part.judges[name] for part in parts] for name in trial.policies}
    of_each = {name: kind.episodes(chunks, trial.config) for name, chunks in seen.items()}
    chosen = choose(kind, of_each)
    result: EvaluationResult = {
        "controller": trial.controller,
        "scenario": trial.config.name,
        "seed": trial.seed,
        "episodes": trial.episodes,
        "teams": {name: kind.figures(chunks, trial.config) for name, chunks in seen.items()},
        "worst_episode": chosen["worst"],
        "median_episode": chosen["median"],
    }
    conditions = {key: np.concatenate([part.conditions[key] for part in parts]) for key in parts[0].conditions}
    crashes = [crash for part in parts for crash in part.crashes][:MAX_CRASHES]
    return EvaluationOutcome(result, of_each, {}, crashes, conditions, [end for part in parts for end in part.ends])


def shown_numbers(result: EvaluationResult) -> dict[str, int]:
    """Indices of the episodes that a report shows, by their names in SHOWN."""
    return {"worst": result["worst_episode"], "median": result["median_episode"]}


def _excerpt(trial: Trial, number: int, episode: int, logs: Mapping[tuple[int, int], EpisodeLog]) -> Excerpt:
    """One episode of trial `number` from the log of its chunk; without that log, the chunk runs again."""
    first = trial.chunk_of(episode)
    log = logs.get((number, first))
    if log is None:
        with runtime.torch_at_rest():
            mission = trial.mission(first)
            log = EpisodeLog(mission, first)
            run_episodes(mission, trial.policies, watchers=[log])
    return log.excerpt(episode - first)


def choose(kind: type[Judge], episodes: Mapping[str, Episodes]) -> dict[str, int]:
    """Indices of the worst and of the median episode over all teams."""
    order = in_order(kind, episodes)
    return {"worst": int(order[0]), "median": int(order[len(order) // 2])}


def in_order(kind: type[Judge], episodes: Mapping[str, Episodes]) -> NDArray[np.int64]:
    """Indices of all episodes, the worst first, over all teams."""
    bad = np.maximum.reduce([kind.badness(of_team) for of_team in episodes.values()])
    return np.lexsort(bad[::-1])[::-1]


def mission_class(config: Scenario, source: Path | None) -> type[Mission]:
    """The class of a scenario's mission."""
    return find_mission(config.mission, [source.parent] if source else [])


def told(evaluation: EvaluationResult, config: Scenario, source: Path | None = None) -> str:
    """An evaluation as lines to read."""
    judge = mission_class(config, source).Judge
    lines = [f"{evaluation['episodes']} held-out episodes, {evaluation['controller']}:"]
    lines += [f"  {team}: {judge.line(figures)}" for team, figures in evaluation["teams"].items()]
    return "\n".join(lines)


def one_episode_each(
    config: Scenario, teams: Sequence[str], episodes: int, seed: int, source: Path | None, first: int = 0
) -> Mission:
    """A mission of `episodes` environments, each at the start of an episode of its own world and sea."""
    kind = mission_class(config, source)
    chunk = kind.one_each(config, min(episodes, CHUNK))
    mission = kind(chunk, episodes, seed=derive_seed(seed, "evaluation", first), teams=teams, source=source)
    mission.begin_each()
    for team in mission.teams.values():
        team.check()
    return mission


def check_measurable(config: Scenario) -> None:
    """Refuse a scenario whose episodes end before measuring begins."""
    if config.episode_duration <= config.evaluation.settle:
        raise ConfigError(
            f"episode_duration = {config.episode_duration} s must exceed evaluation.settle = "
            f"{config.evaluation.settle} s: errors are measured only after it"
        )


def run_episodes(
    mission: Mission, policies: Mapping[str, Policy], bar: tqdm | None = None, watchers: Sequence[Watcher] = ()
) -> dict[str, Judge]:
    """Run one episode in every environment of a freshly reset mission; return the judge of each team."""
    judges = {name: mission.Judge(mission, name) for name in mission.teams}
    for number in range(1, mission.config.episode_steps + 1):
        step = mission.step({name: policies[name] for name in mission.teams}, begin=False, observe=())
        for watcher in watchers:
            watcher.see(judges, step, number)
        for judge in judges.values():
            judge.see(step, number)
        if bar is not None:
            bar.update(1)
    return judges
