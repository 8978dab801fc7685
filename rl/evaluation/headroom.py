"""Headroom: what can be done at all, and how much of it a policy takes.

Planning 32 episodes takes minutes, so that what an oracle and the classical controller made of them is kept beside the
scenario (configs/oracle/NAME.json). A policy is judged on the same episodes:

    headroom taken = (classical - learned) / (classical - oracle)

of any figure of the mission's judge; 0 is the classical controller's, 1 the oracle's.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.evaluation.episodes import judge_episodes
from rl.evaluation.intervals import Interval, paired
from rl.judge import Judge
from rl.learn.policy import ClassicalPolicy, Policy
from rl.planning.planner import Planner
from rl.scenario import Scenario
from taichi_sim.config.io import config_folder

EPISODES, SEED = 32, 4242
LEARNING = ("residual", "tracking_reward", "boat_reward", "aircraft_reward", "plan")  # keys that change no episode


class Bound(NamedTuple):
    """An oracle's and the classical controller's episodes of one team, which is alone with `beside`."""

    beside: tuple[str, ...]  # teams in the episodes, this one among them
    seed: int
    classical: dict[str, NDArray[np.float64]]  # as Judge.episodes gives them
    oracle: dict[str, NDArray[np.float64]]
    price: float  # s of computing a second of an episode

    @property
    def episodes(self) -> int:
        """How many there are."""
        return len(next(iter(self.oracle.values())))


def run_bound(
    config: Scenario, team: str, *, episodes: int = EPISODES, seed: int = SEED, source: Path | None = None,
    show_progress: bool = True,
) -> Bound:  # fmt: skip
    """Let the classical controller and an oracle do the same episodes."""
    beside = teams_beside(config, team)

    def judged(policy: Policy) -> dict[str, NDArray[np.float64]]:
        policies = {name: policy if name == team else ClassicalPolicy() for name in beside}
        return judge_episodes(
            config, policies, episodes=episodes, seed=seed, source=source, show_progress=show_progress
        ).episodes[team]

    oracle = Planner()
    classical = judged(ClassicalPolicy())
    return Bound(beside, seed, classical, judged(oracle), oracle.price)


def judge_all(
    bounds: Mapping[str, Bound], config: Scenario, policies: Mapping[str, Policy], source: Path | None = None
) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Policies on the episodes of the bounds of their teams: team -> numbers, as Judge.episodes gives them."""
    return {team: judge_like(bounds[team], config, team, of, source) for team, of in policies.items() if team in bounds}


def judge_like(bound: Bound, config: Scenario, team: str, policy: Policy, source: Path | None = None) -> Any:
    """A policy on the episodes of a bound, as Judge.episodes gives them."""
    policies = {name: policy if name == team else ClassicalPolicy() for name in bound.beside}
    return judge_episodes(
        config, policies, episodes=bound.episodes, seed=bound.seed, source=source, show_progress=False
    ).episodes[team]


def headroom(kind: type[Judge], learned: Mapping[str, Any], bound: Bound, times: int = 1) -> dict[str, Interval]:
    """Of each figure, the share of the way from the classical controller to the oracle that `learned` goes.

    `learned` may hold the bound's episodes several `times`, one after the other, by several policies.
    """

    def share(classical: Any, of_it: Any, oracle: Any) -> Any:
        with np.errstate(divide="ignore", invalid="ignore"):  # what is not finite is not known
            return np.divide(classical - of_it, classical - oracle)

    several = [{key: np.concatenate([x] * times) for key, x in of.items()} for of in (bound.classical, bound.oracle)]
    return paired(share, kind, several[0], learned, several[1], times=times)


def headroom_line(kind: type[Judge], team: str, bound: Bound) -> str:
    """The figures of a bound as a line to read."""
    one, other = kind.pooled(bound.classical), kind.pooled(bound.oracle)
    told = ", ".join(f"{key} {float(one[key]):.3g} -> {float(other[key]):.3g}" for key in kind.plotted)
    return f"{team}, {bound.episodes} episodes, classical -> oracle: {told}; {bound.price:.2f} s a second of life"


def teams_beside(config: Scenario, team: str) -> tuple[str, ...]:
    """The teams that are simulated with a planned one: all that its mission lets act on it, else itself alone."""
    return tuple(config.trained) if config.mission != "formation" else (team,)


# -- files -------------------------------------------------------------------------------------------------------------


def bound_file(config: Scenario) -> Path:
    """Where the bounds of a scenario are kept."""
    return config_folder() / "oracle" / f"{config.name}.json"


def digest(config: Scenario) -> str:
    """Tells scenarios apart whose episodes differ: what only learning reads does not count."""
    data = config.model_dump(mode="json", exclude={"stages", "seed", "evaluation"})
    for name in config.teams:
        for key in LEARNING:
            data.get(name, {}).pop(key, None)
    return hashlib.sha256(json.dumps(data, sort_keys=True, default=str).encode()).hexdigest()[:16]


def write_bounds(file: Path, config: Scenario, bounds: Mapping[str, Bound]) -> None:
    """Keep bounds, by team."""

    def plain(values: Mapping[str, NDArray[np.float64]]) -> dict[str, Any]:
        return {key: [round(float(x), 5) if np.isfinite(x) else None for x in array] for key, array in values.items()}

    teams = {
        team: {
            "beside": list(b.beside), "seed": b.seed, "price": round(b.price, 3),
            "classical": plain(b.classical), "oracle": plain(b.oracle),
        }
        for team, b in bounds.items()
    }  # fmt: skip
    file.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"scenario": config.name, "digest": digest(config), "teams": teams})
    file.write_text(text.replace('], "', '],\n"') + "\n", encoding="utf-8")


def read_bounds(config: Scenario, file: Path | None = None) -> dict[str, Bound]:
    """The kept bounds of a scenario, by team; none where there are none, or the episodes would be others."""
    file = file or bound_file(config)
    if not file.is_file():
        return {}
    data = json.loads(file.read_text(encoding="utf-8"))
    if data["digest"] != digest(config):
        return {}

    def arrays(values: Mapping[str, list[float | None]]) -> dict[str, NDArray[np.float64]]:
        return {key: np.array([np.nan if x is None else x for x in row]) for key, row in values.items()}

    return {
        team: Bound(tuple(b["beside"]), b["seed"], arrays(b["classical"]), arrays(b["oracle"]), b["price"])
        for team, b in data["teams"].items()
    }
