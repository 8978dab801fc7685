"""Measurements of station keeping: how near place and heading were kept, and whether the boat went alongside."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Self, cast

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rl.judge import COMMON, Episodes, Judge, Judged, rms_of
from rl.missions.station.config import StationScenario
from rl.missions.station.team import Boat
from rl.step import Step

ERRORS = ("error_rms_m", "heading_error_rms_deg")


class StationJudge(Judge[Judged, StationScenario]):
    """Measures distance from the place (m), error of the heading (deg) and clearance to the quay (m).

    rows: those three [3, step, env], NaN after an ending.
    """

    definitions = {
        "kept_share": "share of the time on station, from evaluation.settle to station.hold, in which place and "
        "heading are kept to station.near and station.near_deg; after an early ending neither is",
        "error_rms_m": "root mean square distance from the place then",
        "heading_error_rms_deg": "root mean square error of the heading then",
        "docked": "fraction of episodes in which the boat lay alongside, within station.near and station.near_deg, for "
        "evaluation.success_share of the last station.stand, and never touched the quay",
        "least_gap_m": "least clearance to the quay in an episode, mean",
        "action_change_rms": COMMON["action_change_rms"],
        "success_rate": "fraction of episodes with a kept_share of evaluation.success_share that docked",
        "reward_per_step": Judge.definitions["reward_per_step"],
    }
    plotted = ("kept_share", "error_rms_m", "docked", "success_rate")
    shares = ("kept_share", "docked", "success_rate")
    told = MappingProxyType({"error_rms_m": "off the place (m, rms)", "kept_share": "share of time kept"})

    def __init__(self, mission: Judged, team: str):
        """Measure `team`."""
        super().__init__(mission, team)
        self.rows = np.full((3, mission.config.episode_steps, mission.num_envs), np.nan)

    def see(self, step: Step, number: int) -> None:
        """Take decision `number` (from 1) into account."""
        now, alive = np.stack([value[:, 0].double().cpu().numpy() for value in self.series().values()]), ~self.failed
        self.rows[:, number - 1, alive] = now[:, alive]
        super().see(step, number)

    def series(self) -> dict[str, Tensor]:
        """The three measurements now."""
        team = cast(Boat, self.mission.teams[self.name])
        return {
            "distance from the place (m)": team.distance, "heading error (deg)": team.error[..., 2].rad2deg(),
            "gap to the quay (m)": team.gap,
        }  # fmt: skip

    @classmethod
    def episodes(cls, seen: Sequence[Self], config: StationScenario) -> dict[str, NDArray[np.float64]]:
        """Numbers of each episode."""
        s, common = config.station, super().episodes(seen, config)
        off, turn, gap = np.concatenate([j.rows for j in seen], axis=2)
        kept = (off < s.near) & (np.abs(turn) < s.near_deg)
        settle, hold, stand = (round(t / config.decision_interval) for t in (config.evaluation.settle, s.hold, s.stand))
        share = kept[settle:hold].mean(axis=0)
        alongside = kept & (gap < s.clear + s.near)
        docked = (common["failed"] == 0) & (alongside[-stand:].mean(axis=0) >= config.evaluation.success_share)
        return common | {
            "kept_share": share,
            "docked": docked.astype(float),
            "succeeded": (docked & (share >= config.evaluation.success_share)).astype(float),
            **{key: rms_of(value[settle:hold], (0,)) for key, value in zip(ERRORS, (off, turn), strict=True)},
            "least_gap_m": np.fmin.reduce(gap, axis=0),
            "on": np.isfinite(off[settle:hold]).sum(axis=0).astype(float),
        }

    @classmethod
    def pooled(cls, episodes: Episodes) -> dict[str, NDArray[np.float64]]:
        """Figures of sets of episodes; errors are weighted by time."""
        common, on = super().pooled(episodes), episodes["on"]
        squares = {key: (np.nan_to_num(episodes[key]) ** 2 * on).sum(-1) for key in ERRORS}
        time = np.where(on.sum(-1) > 0, on.sum(-1), np.nan)
        rms = {key: np.sqrt(value / time) for key, value in squares.items()}
        means = {key: episodes[key].mean(-1) for key in ("kept_share", "docked", "least_gap_m")}
        return {key: (common | rms | means)[key] for key in cls.definitions}

    @classmethod
    def badness(cls, episodes: Episodes) -> NDArray[np.float64]:
        """Criteria of the worst episode: failed, time not kept, not docked."""
        return np.stack((episodes["failed"], 1 - episodes["kept_share"], 1 - episodes["docked"]))

    @classmethod
    def loss(cls, episodes: Episodes, config: StationScenario) -> NDArray[np.float64]:
        """Loss of an episode: time not kept, error over station.near, not docked, failed."""
        error = np.fmin(np.nan_to_num(episodes["error_rms_m"] / config.station.near, nan=4.0), 4.0)
        return 5 * (1 - episodes["kept_share"]) + error + (1 - episodes["docked"]) + 4 * episodes["failed"]

    @classmethod
    def line(cls, figures: dict[str, float | None]) -> str:
        """The figures as a readable line."""
        kept, docked = (100 * (figures[key] or 0.0) for key in ("kept_share", "docked"))
        error, turn = (figures[key] for key in ERRORS)
        off = "not measured" if error is None or turn is None else f"{error:.2f} m and {turn:.1f} deg rms"
        return f"kept {kept:.1f} % of the time, {off}, {docked:.1f} % dock"
