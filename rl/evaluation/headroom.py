"""Headroom: how much better than the classical controller an oracle does, and the share of it that a policy takes.

Planning 32 episodes takes minutes. The episodes of the oracle and of the classical controller are therefore stored
beside the scenario (configs/oracle/NAME.json). A policy is judged on the same episodes:

    headroom taken = (classical - learned) / (classical - oracle)

for any figure of the mission's judge; 0 is the classical controller, 1 the oracle.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.evaluation.episodes import Trial, judge_episodes, judge_trials
from rl.evaluation.intervals import Interval, paired
from rl.judge import Judge
from rl.learn.policy import ClassicalPolicy
from rl.mission import Policy
from rl.planning.planner import Planner
from rl.scenario import Scenario
from taichi_sim.config.io import config_folder

Array = NDArray[np.float64]
EPISODES, SEED = 32, 4242
GONE = {
    "escort": {"escort": {"relay": False}},
    "landing": {"course": {"turn_deg": 60.0, "change": 0.8, "turn_rate_deg": 4.0}},
}
"""Mission, section -> keys that are no more, at the value that all episodes have now: digests keep them."""
NEWER = {"formation": {"obstacles": {"off_ways": False}}, "escort": {"escort": {"start_lift": math.inf}}}
"""Mission, section -> keys that are newer than the stored episodes, at the value that these have; digests lack them."""
LEARNING = ("residual", "terms", "plan")  # keys that change no episode


class Bound(NamedTuple):
    """Episodes of one team under an oracle and under its classical controller."""

    beside: tuple[str, ...]  # simulated teams, including this one
    seed: int
    classical: dict[str, Array]  # from Judge.episodes
    oracle: dict[str, Array]  # empty: not run yet
    price: float  # s of computation of the oracle for each second of an episode

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(next(iter(self.classical.values())))


def run_bound(
    config: Scenario, team: str, *, episodes: int = EPISODES, seed: int = SEED, source: Path | None = None,
    show_progress: bool = True, plan: bool = True,
) -> Bound:  # fmt: skip
    """Run the same episodes under the classical controller and, if `plan`, under an oracle."""
    beside, config = teams_beside(config, team), as_stored(config)

    def judged(policy: Policy) -> dict[str, Array]:
        policies = {name: policy if name == team else ClassicalPolicy() for name in beside}
        return judge_episodes(
            config, policies, episodes=episodes, seed=seed, source=source, show_progress=show_progress
        ).episodes[team]

    oracle = Planner()
    classical = judged(ClassicalPolicy())
    return Bound(beside, seed, classical, judged(oracle) if plan else {}, oracle.price)


def judge_on_bounds(
    bounds: Mapping[str, Bound], config: Scenario, policies: Mapping[str, Policy], source: Path | None = None,
    *, show_progress: bool = False,
) -> dict[str, dict[str, Array]]:  # fmt: skip
    """Run policies on the episodes of their teams' bounds: team -> numbers of each episode (Judge.episodes).

    Processes share the episodes: all of them must call this, and all but rank 0 get nothing.
    """
    teams = [team for team in policies if team in bounds]
    trials = [_trial(bounds[t], config, t, policies[t], source) for t in teams]
    outcomes = judge_trials(trials, show_progress=show_progress)
    found = {}
    for team, outcome in zip(teams, outcomes, strict=False):
        if isinstance(outcome, Exception):
            raise outcome
        found[team] = outcome.episodes[team]
    return found


def _trial(bound: Bound, config: Scenario, team: str, policy: Policy, source: Path | None) -> Trial:
    policies = {name: policy if name == team else ClassicalPolicy() for name in bound.beside}
    return Trial(as_stored(config), policies, bound.episodes, bound.seed, source=source)


def as_stored(config: Scenario) -> Scenario:
    """The scenario with the values of `NEWER`."""
    newer = NEWER.get(config.mission, {}).items()
    return config.model_copy(update={name: getattr(config, name).model_copy(update=keys) for name, keys in newer})


def with_keys_of_stored(config: Scenario, data: dict[str, Any]) -> dict[str, Any]:
    """The scenario's `data` with the keys that it had when episodes were stored: those `GONE`, none that is `NEWER`."""
    for section, keys in GONE.get(config.mission, {}).items():
        data[section] |= keys
    for section, keys in NEWER.get(config.mission, {}).items():
        data[section] = {key: value for key, value in data[section].items() if key not in keys}
    return data


def headroom(kind: type[Judge], learned: Mapping[str, Array], bound: Bound, times: int = 1) -> dict[str, Interval]:
    """The share of the headroom that `learned` takes, for each figure.

    With `times` > 1, `learned` holds the bound's episodes that many times, one policy after the other.
    """

    def share(classical: Array, learned: Array, oracle: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):  # a figure that is not finite counts as not measured
            return np.divide(classical - learned, classical - oracle)

    several = [{key: np.concatenate([x] * times) for key, x in of.items()} for of in (bound.classical, bound.oracle)]
    return paired(share, kind, several[0], learned, several[1], times=times)


def headroom_line(kind: type[Judge], team: str, bound: Bound) -> str:
    """The figures of a bound as one readable line."""
    levels = [kind.pooled(of) for of in (bound.classical, bound.oracle) if of]
    figures = (f"{key} {' -> '.join(f'{float(of[key]):.3g}' for of in levels)}" for key in kind.plotted)
    told = f"{team}, {bound.episodes} episodes, classical{' -> oracle' * (len(levels) - 1)}: {', '.join(figures)}"
    return told + f"; {bound.price:.2f} s of computation for each second" * (len(levels) - 1)


def teams_beside(config: Scenario, team: str) -> tuple[str, ...]:
    """The teams that are simulated with a planned one: all teams that can act on it, or itself alone."""
    return tuple(config.trained) if config.mission != "formation" else (team,)


def simulated(config: Scenario, team: str) -> tuple[str, ...]:
    """The same, and the teams of scripts, which always take part."""
    return (*teams_beside(config, team), *config.scripted)


# -- files -------------------------------------------------------------------------------------------------------------


def bound_file(config: Scenario) -> Path:
    """The file that stores the bounds of a scenario."""
    return config_folder() / "oracle" / f"{config.name}.json"


def digest(config: Scenario, team: str) -> str:
    """A hash that differs between scenarios whose episodes of a team differ; keys that are not given or that only
    learning reads do not count, nor do teams that are not simulated with it.
    """
    beside = simulated(config, team)
    left_out = {"stages", "seed", "evaluation", "replaced"} | {name for name in config.teams if name not in beside}
    data = config.model_dump(mode="json", exclude_none=True, exclude=left_out)
    for name in beside:
        for key in LEARNING:
            data.get(name, {}).pop(key, None)
    data = with_keys_of_stored(config, data)
    return hashlib.sha256(json.dumps(data, sort_keys=True, default=str).encode()).hexdigest()[:16]


def write_bounds(file: Path, config: Scenario, bounds: Mapping[str, Bound]) -> None:
    """Write the bounds of each team."""

    def plain(values: Mapping[str, Array]) -> dict[str, list[float | None]]:
        return {key: [round(float(x), 5) if np.isfinite(x) else None for x in array] for key, array in values.items()}

    teams = {
        team: {
            "digest": digest(config, team), "beside": list(b.beside), "seed": b.seed, "price": round(b.price, 3),
            "classical": plain(b.classical), "oracle": plain(b.oracle),
        }
        for team, b in bounds.items()
    }  # fmt: skip
    file.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"scenario": config.name, "teams": teams})
    file.write_text(text.replace('], "', '],\n"') + "\n", encoding="utf-8")


def read_bounds(config: Scenario, file: Path | None = None) -> dict[str, Bound]:
    """The stored bounds of a scenario by team, those in which an oracle has run; see `read_levels`."""
    return {team: bound for team, bound in read_levels(config, file).items() if bound.oracle}


def read_levels(config: Scenario, file: Path | None = None) -> dict[str, Bound]:
    """All that `write_bounds` stored for a scenario, by team, without teams whose episodes have changed."""
    file = file or bound_file(config)
    if not file.is_file():
        return {}
    data = json.loads(file.read_text(encoding="utf-8"))

    def arrays(values: Mapping[str, list[float | None]]) -> dict[str, Array]:
        return {key: np.array([np.nan if x is None else x for x in row]) for key, row in values.items()}

    return {
        team: Bound(tuple(b["beside"]), b["seed"], arrays(b["classical"]), arrays(b["oracle"]), b["price"])
        for team, b in data["teams"].items()
        if b.get("digest") == digest(config, team)
    }
