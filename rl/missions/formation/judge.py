"""What an evaluation measures of a formation: errors after the start has settled, collisions, success."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from rl.judge import COMMON, Judge


class FormationJudge(Judge):
    """Keeps the distance of every vehicle from its slot: errors [step, env, vehicle] in m, NaN where not measured."""

    definitions = {
        "leader_error_rms_m": "root mean square distance of the leader from its target, over time and episodes",
        "leader_error_p95_m": "95th percentile of the same distance",
        "follower_error_rms_m": "root mean square distance of followers from their slots (null without followers)",
        "follower_error_p95_m": "95th percentile of the same distance",
        **COMMON,
        "success_rate": "fraction of episodes that ran their full time with no vehicle of the team lost, crashed, "
        "collided or out of the area, and in which the rms error of every vehicle stayed below "
        "evaluation.success_error",
    }

    def __init__(self, mission: Any, team: str):
        """Watch `team`."""
        super().__init__(mission, team)
        self.errors = np.full((mission.config.episode_steps, *self.collided.shape), np.nan)

    def see(self, step: Any, number: int) -> None:
        """Errors count until a vehicle of the team has ended, and in the step in which it did."""
        alive, config = ~self.failed, self.mission.config
        if number * config.decision_interval > config.evaluation.settle:
            self.errors[number - 1, alive] = self.mission.teams[self.name].distance.cpu().numpy()[alive]
        super().see(step, number)

    @classmethod
    def figures(cls, seen: Sequence[Any], config: Any) -> dict[str, float | None]:
        """The figures of `definitions`."""
        errors = np.concatenate([j.errors for j in seen], axis=1)
        failed = np.concatenate([j.failed for j in seen])
        common = super().figures(seen, config)
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
            **{key: common[key] for key in COMMON},
            "success_rate": float(success.mean()),
        }

    @classmethod
    def line(cls, figures: dict[str, float | None]) -> str:
        """The figures of one team as a line to read."""
        leader, followers = (
            "not measured" if figures[f"{who}_error_rms_m"] is None else f"{figures[f'{who}_error_rms_m']:.2f} m rms"
            for who in ("leader", "follower")
        )
        free, success = (100 * (figures[key] or 0.0) for key in ("collision_free_episodes", "success_rate"))
        return (
            f"leader error {leader}, followers {followers}, {free:.1f} % of episodes without collision, "
            f"{success:.1f} % succeed"
        )


def _rms(errors: np.ndarray) -> float | None:
    values = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def _p95(errors: np.ndarray) -> float | None:
    values = errors[np.isfinite(errors)]
    return float(np.percentile(values, 95)) if values.size else None
