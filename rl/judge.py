"""Measurements of an evaluation, and the definition of each figure.

An environment runs one episode. When one vehicle of a team ends, measuring stops for the whole team; other teams go
on. Sums use NumPy in float64, so that the result does not depend on the number of threads.

    see (each decision) -> episodes: numbers of each episode -> pooled: figures of any set of episodes -> figures

Intervals come from `pooled` over resampled episodes (rl/evaluation/intervals.py). A figure that a mission's judge adds
to `episodes` and `pooled` therefore gets an interval in evaluations, sweeps and reports without more code.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar, Generic, Protocol, Self, SupportsFloat, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rl.scenario import Scenario
from rl.step import Step
from rl.team import Team

C = TypeVar("C", bound=Scenario)

COMMON = {
    "collisions_per_hour": "vehicles that hit an obstacle or a team mate, per hour of the team's operation",
    "collision_free_episodes": "fraction of episodes in which no vehicle of the team collided",
    "action_change_rms": "root mean square change of a vehicle's action from one decision to the next, as a share of "
    "its range (0: all are held, 1: each goes from end to end every time), over actions, vehicles, time and episodes",
}

TEAM_ERROR = {
    "team_error_m": "root mean square distance of the team's vehicles from their slots in an episode, "
    "mean over episodes"
}

SHARES = ("collision_free_episodes", "success_rate")  # figures between 0 and 1 that every episode counts in

Episodes = Mapping[str, NDArray[np.float64]]
"""Numbers of episodes by name: [episode], or [..., episode] for many sets of episodes; NaN: not measured."""


COLLISION_LOSS = 20.0  # loss of an episode with a collision; assumed
ACTION_RANGE = 2.0  # actions reach from -1 to 1


class Judged(Protocol):
    """What a judge reads of a mission (rl/mission.py)."""

    num_envs: int

    @property
    def config(self) -> Scenario:
        """The scenario."""
        ...

    @property
    def teams(self) -> Mapping[str, Team]:
        """Name -> team."""
        ...


M = TypeVar("M", bound=Judged)


class Judge(Generic[M, C]):
    """Measures one team through a chunk of episodes; a mission derives its own judge and adds figures.

    A mission in which an episode can succeed names `success_rate` in its definitions.

    Class attributes: `definitions`, figure -> its definition, in the order in which they are printed; `plotted`, the
    figures that sweeps and checkups plot; `shares`, those between 0 and 1; `signed`, those that may be negative;
    `told`, numbers of an episode that reports show over its conditions, with their label; `goals`, the endings that are
    what a vehicle was to do.
    """

    definitions: ClassVar[dict[str, str]] = {
        "reward_per_step": "mean reward of the team's vehicles, over time and episodes",
        **COMMON,
    }
    plotted: ClassVar[tuple[str, ...]] = ("reward_per_step", "collision_free_episodes")
    shares: ClassVar[tuple[str, ...]] = SHARES
    signed: ClassVar[tuple[str, ...]] = ("reward_per_step", "least_gap_m", "energy_per_metre_J")
    told: ClassVar[Mapping[str, str]] = MappingProxyType({})
    goals: ClassVar[tuple[str, ...]] = ()

    def __init__(self, mission: M, team: str):
        """Measure `team` of a mission; every environment is at the start of an episode."""
        self.mission, self.name = mission, team
        envs, vehicles = mission.num_envs, mission.teams[team].fleet.count
        self.collided = np.zeros((envs, vehicles), dtype=bool)
        self.failed = np.zeros(envs, dtype=bool)
        self.reward = np.zeros(envs)
        self.measured = np.zeros(envs)
        self.action_changes = np.zeros(envs)

    def __getstate__(self) -> dict[str, object]:
        """The measurements, for transfer to another process; the mission itself is left out."""
        return {key: value for key, value in self.__dict__.items() if key != "mission"}

    def see(self, step: Step, number: int) -> None:
        """Take decision `number` (from 1) into account."""
        alive, ended = ~self.failed, step.endings[self.name]
        self.reward[alive] += step.reward[self.name].double().mean(dim=1).cpu().numpy()[alive]
        self.measured[alive] += 1
        if number > 1:  # the first decision has no predecessor
            team = self.mission.teams[self.name]
            change = (team.action - team.previous_action).double() / ACTION_RANGE
            self.action_changes[alive] += change.square().mean(dim=(1, 2)).cpu().numpy()[alive]
        if "collided" in ended:
            self.collided[alive] |= ended["collided"].cpu().numpy()[alive]
        self.failed |= ended.any.any(dim=1).cpu().numpy() & alive

    def series(self) -> dict[str, Tensor]:
        """Values now that a report plots over time: a label with its unit -> [env, vehicle]."""
        return {}

    @classmethod
    def episodes(cls, seen: Sequence[Self], config: C) -> dict[str, NDArray[np.float64]]:
        """Collect numbers of each episode over all chunks of one team, [episode]: the input of `pooled`."""
        collided, failed, reward, measured, changes = (
            np.concatenate([getattr(judge, name) for judge in seen])
            for name in ("collided", "failed", "reward", "measured", "action_changes")
        )
        return {
            "collided": collided.sum(axis=1).astype(float),  # vehicles
            "failed": failed.astype(float),
            "succeeded": (~failed).astype(float),
            "reward": reward,  # mean over vehicles, sum over decisions
            "decisions": measured,
            "hours": measured * config.decision_interval / 3600,
            "action_changes": changes,  # squared shares of the range: mean over vehicles, sum over changes
        }

    @classmethod
    def pooled(cls, episodes: Episodes) -> dict[str, NDArray[np.float64]]:
        """Compute figures [...] of sets of episodes, whose numbers (see `episodes`) are [..., episode]."""
        return {
            "reward_per_step": episodes["reward"].sum(-1) / np.maximum(episodes["decisions"].sum(-1), 1),
            "collisions_per_hour": episodes["collided"].sum(-1) / episodes["hours"].sum(-1),
            "collision_free_episodes": (episodes["collided"] == 0).mean(-1),
            "action_change_rms": _change_of(episodes),
            "success_rate": episodes["succeeded"].mean(-1),
        }

    @classmethod
    def badness(cls, episodes: Episodes) -> NDArray[np.float64]:
        """Criteria [criterion, episode] by which the worst episode is found, in order of weight; larger is worse."""
        collided, paid = (episodes["collided"] > 0).astype(np.float64), episodes["reward"] / episodes["decisions"]
        return np.stack((collided, episodes["failed"], -paid))

    @classmethod
    def loss(cls, episodes: Episodes, config: C) -> NDArray[np.float64]:
        """[episode], the loss that tuning a controller minimises (rl/runs/tune.py)."""
        paid = episodes["reward"] / np.maximum(episodes["decisions"], 1)
        return COLLISION_LOSS * (episodes["collided"] > 0) + (1 - episodes["succeeded"]) - paid

    @classmethod
    def figures(cls, seen: Sequence[Self], config: C) -> dict[str, float | None]:
        """The figures of `definitions` over all chunks of one team; None where nothing was measured."""
        pooled = cls.pooled(cls.episodes(seen, config))
        return {key: finite(value) for key, value in pooled.items() if key in cls.definitions}

    @classmethod
    def line(cls, figures: dict[str, float | None]) -> str:
        """The figures of one team as a readable line."""
        return ", ".join(f"{key} {value:.3g}" for key, value in figures.items() if value is not None)


class ErrorJudge(Judge[M, C]):
    """Measures the distances of vehicles from their slots, too; vehicle 0 leads.

    errors: [step, env, vehicle] m, NaN where not measured; a mission's judge writes them.
    """

    told = MappingProxyType({f"{who}_error_rms_m": f"{who} error (m, rms)" for who in ("follower", "leader")})

    def __init__(self, mission: M, team: str):
        """Measure `team`."""
        super().__init__(mission, team)
        self.errors = np.full((mission.config.episode_steps, *self.collided.shape), np.nan)

    @classmethod
    def episodes(cls, seen: Sequence[Self], config: C) -> dict[str, NDArray[np.float64]]:
        """Add rms errors (m) of leader and followers, and the time measured (vehicle-seconds), to the numbers."""
        errors = errors_of(seen)
        time = np.isfinite(errors).sum(axis=0) * config.decision_interval
        return super().episodes(seen, config) | {
            "leader_error_rms_m": rms_of(errors, (0,))[:, 0],
            "follower_error_rms_m": rms_of(errors[:, :, 1:], (0, 2)),
            "leader_s": time[:, 0],
            "follower_s": time[:, 1:].sum(axis=1),
        }

    @classmethod
    def figures(cls, seen: Sequence[Self], config: C) -> dict[str, float | None]:
        """The figures of `definitions`; percentiles have no interval, because they need every single error."""
        errors, pooled = errors_of(seen), super().figures(seen, config)
        pooled |= {"leader_error_p95_m": p95(errors[:, :, 0]), "follower_error_p95_m": p95(errors[:, :, 1:])}
        return {key: pooled[key] for key in cls.definitions}

    @staticmethod
    def error_loss(episodes: Episodes, success_error: float) -> NDArray[np.float64]:
        """[episode], errors of leader and followers as shares of `success_error` (m), each limited to 4, added."""
        errors = [np.nan_to_num(episodes[f"{who}_error_rms_m"], nan=0.0) for who in ("leader", "follower")]
        return (np.fmin(errors[0], 4 * success_error) + np.fmin(errors[1], 4 * success_error)) / success_error


def _change_of(episodes: Episodes) -> NDArray[np.float64]:
    """Rms [...] change of an action; NaN for episodes of one decision and for evaluations older than this figure."""
    if "action_changes" not in episodes:
        return np.full(episodes["collided"].shape[:-1], np.nan)
    changes = np.maximum(episodes["decisions"] - 1, 0).sum(-1)
    squares = episodes["action_changes"].sum(-1) / np.maximum(changes, 1)
    return np.sqrt(np.where(changes > 0, squares, np.nan))


def finite(value: SupportsFloat) -> float | None:
    """A number, or None for one that is not finite."""
    return float(value) if np.isfinite(float(value)) else None


def errors_of(seen: Sequence[ErrorJudge]) -> NDArray[np.float64]:
    """Errors [step, episode, vehicle] of all chunks."""
    return np.concatenate([j.errors for j in seen], axis=1)


def rms_of(errors: NDArray[np.float64], axes: tuple[int, ...]) -> NDArray[np.float64]:
    """Root mean square over `axes`, of finite values; NaN where there is none."""
    finite = np.isfinite(errors)
    count = finite.sum(axis=axes)
    squares = (np.where(finite, errors, 0.0) ** 2).sum(axis=axes)
    return np.sqrt(np.where(count > 0, squares / np.maximum(count, 1), np.nan))


def over_time(episodes: Episodes, who: str) -> NDArray[np.float64]:
    """Rms [...] of episodes [..., episode], weighted by their duration; NaN where none was measured."""
    time = episodes[f"{who}_s"]
    squares = (np.where(time > 0, episodes[f"{who}_error_rms_m"], 0.0) ** 2 * time).sum(-1)
    total = time.sum(-1)
    return np.sqrt(np.where(total > 0, squares / np.maximum(total, 1e-300), np.nan))


def team_error(episodes: Episodes) -> NDArray[np.float64]:
    """Mean [...] over episodes [..., episode] of the rms error of all vehicles; NaN where none was measured."""
    squares, time = np.zeros_like(episodes["leader_s"]), np.zeros_like(episodes["leader_s"])
    for who in ("leader", "follower"):
        own = episodes[f"{who}_s"]
        squares = squares + np.where(own > 0, episodes[f"{who}_error_rms_m"], 0.0) ** 2 * own
        time = time + own
    measured = (time > 0).sum(-1)
    total = np.sqrt(squares / np.maximum(time, 1e-300)).sum(-1)
    return np.where(measured > 0, total / np.maximum(measured, 1), np.nan)


def median_of(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median over the last axis, without NaN; NaN where there are no values."""
    count = np.isfinite(values).sum(-1, keepdims=True)
    ordered = np.sort(values, axis=-1)  # NaN come last
    low, high = (np.maximum(count - 1, 0) // 2, np.maximum(count, 1) // 2)
    middle = [np.take_along_axis(ordered, np.minimum(k, values.shape[-1] - 1), -1) for k in (low, high)]
    return np.where(count > 0, 0.5 * (middle[0] + middle[1]), np.nan).squeeze(-1)


def p95(errors: NDArray[np.float64]) -> float | None:
    """95th percentile of the finite values; None if there is none."""
    values = errors[np.isfinite(errors)]
    return finite(np.percentile(values, 95)) if values.size else None
