"""Measurements of a formation: errors after the start has settled, gaps, collisions, success."""

import math
from collections.abc import Sequence
from typing import Self, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rl.guidance.course.obstacles import BOTTOM, EAST, NORTH, RADIUS, TOP
from rl.judge import (
    COLLISION_LOSS,
    COMMON,
    TEAM_ERROR,
    Episodes,
    ErrorJudge,
    Judged,
    errors_of,
    median_of,
    over_time,
    rms_of,
    team_error,
)
from rl.missions.formation.config import FormationScenario
from rl.missions.formation.team import TeamTask
from rl.step import Step


class FormationJudge(ErrorJudge[Judged, FormationScenario]):
    """Measures errors, evasions, and `gap` [env], the team's least clearance (m) so far; inf before any."""

    definitions = {
        "leader_error_rms_m": "root mean square distance of the leader from its target, over time and episodes",
        "leader_error_p95_m": "95th percentile of the same distance",
        "cross_track_rms_m": "root mean square distance of the leader from its track, at the target's course",
        "follower_error_rms_m": "root mean square distance of followers from their slots (null without followers)",
        "follower_error_p95_m": "95th percentile of the same distance",
        **TEAM_ERROR,
        "evasions_per_hour": "times that a vehicle's slot went through an obstacle, so that it had to be left, per "
        "hour of vehicle time",
        "least_gap_m": "least clearance of any vehicle to an obstacle or a team mate in an episode, median over "
        "episodes; at most sensing.detection_range, negative in contact",
        **COMMON,
        "success_rate": "fraction of episodes that ran their full time with no vehicle of the team lost, crashed, "
        "collided or out of the area, and in which the rms error of every vehicle stayed below "
        "evaluation.success_error",
    }
    plotted = ("leader_error_rms_m", "follower_error_rms_m", "collision_free_episodes", "success_rate")

    def __init__(self, mission: Judged, team: str):
        """Measure `team`."""
        super().__init__(mission, team)
        self.gap = np.full(len(self.failed), np.inf)
        self.across = np.full(self.errors.shape[:2], np.nan)  # cross-track error of the leader [step, env], m
        self.evasions = np.zeros(len(self.failed))
        self._blocked = self._blocked_now()

    @property
    def team(self) -> TeamTask:
        """The team."""
        return cast(TeamTask, self.mission.teams[self.name])

    def _blocked_now(self) -> NDArray[np.bool_]:
        """Whether the slot of each vehicle is in an obstacle [env, vehicle]."""
        return (slot_clearance(self.team) < 0).cpu().numpy()

    def see(self, step: Step, number: int) -> None:
        """Take decision `number` (from 1) into account.

        Errors and gaps count up to the step in which a vehicle of the team ends.
        """
        alive, config, team = ~self.failed, self.mission.config, self.team
        if number * config.decision_interval > config.evaluation.settle:
            self.errors[number - 1, alive] = team.distance.cpu().numpy()[alive]
            self.across[number - 1, alive] = self._across().double().cpu().numpy()[alive]
            gap = team.sensor.gap.amin(dim=1).double().cpu().numpy()
            self.gap[alive] = np.fmin(self.gap, gap)[alive]
        blocked = self._blocked_now()
        self.evasions[alive] += (blocked & ~self._blocked).sum(axis=1)[alive]
        self._blocked = blocked
        super().see(step, number)

    def _across(self) -> Tensor:
        """The leader's error across its track [env], m."""
        team = self.team
        north, east = team.now.error[:, 0, :2].unbind(-1)
        return team.target.cos[:, 0] * east - team.target.sin[:, 0] * north

    def series(self) -> dict[str, Tensor]:
        """Distance from the slot and clearance."""
        team = self.team
        return {"distance from slot (m)": team.distance, "gap to anything (m)": team.sensor.gap}

    @classmethod
    def episodes(cls, seen: Sequence[Self], config: FormationScenario) -> dict[str, NDArray[np.float64]]:
        """Add success, the least gap (m), evasions and vehicle-hours to the numbers of each episode."""
        errors = errors_of(seen)
        measured = np.isfinite(errors)
        rms = rms_of(errors, (0,))
        failed = np.concatenate([j.failed for j in seen])
        success = ~failed & measured[-1].all(axis=1) & (rms < config.evaluation.success_error).all(axis=1)
        gap = np.concatenate([j.gap for j in seen])
        return super().episodes(seen, config) | {
            "succeeded": success.astype(float),
            "across_error_rms_m": rms_of(np.concatenate([j.across for j in seen], axis=1), (0,)),
            "least_gap_m": np.where(np.isfinite(gap), gap, np.nan),
            "evasions": np.concatenate([j.evasions for j in seen]),
            "vehicle_hours": np.concatenate([j.measured * j.collided.shape[1] for j in seen])
            * (config.decision_interval / 3600),
        }

    @classmethod
    def pooled(cls, episodes: Episodes) -> dict[str, NDArray[np.float64]]:
        """Compute the figures of sets of episodes; errors are root mean squares, weighted by time."""
        common = super().pooled(episodes)
        errors = {f"{who}_error_rms_m": over_time(episodes, who) for who in ("leader", "follower")}
        across = episodes.get("across_error_rms_m", np.full(episodes["leader_s"].shape, np.nan))  # None stored before
        return {
            **errors,
            "cross_track_rms_m": over_time({"x_s": episodes["leader_s"], "x_error_rms_m": across}, "x"),
            "team_error_m": team_error(episodes),
            "evasions_per_hour": episodes["evasions"].sum(-1) / np.maximum(episodes["vehicle_hours"].sum(-1), 1e-12),
            "least_gap_m": median_of(episodes["least_gap_m"]),
            **{key: common[key] for key in (*COMMON, "success_rate")},
        }

    @classmethod
    def badness(cls, episodes: Episodes) -> NDArray[np.float64]:
        """Criteria of the worst episode: collided, failed, the larger of both errors (infinite if not measured)."""
        error = np.fmax(episodes["leader_error_rms_m"], episodes["follower_error_rms_m"])
        error = np.where(np.isnan(error), np.inf, error)
        return np.stack(((episodes["collided"] > 0).astype(np.float64), episodes["failed"], error))

    @classmethod
    def loss(cls, episodes: Episodes, config: FormationScenario) -> NDArray[np.float64]:
        """Loss of each episode: collided, failed, both errors as shares (4 at most) of evaluation.success_error."""
        shares = cls.error_loss(episodes, config.evaluation.success_error)
        return COLLISION_LOSS * (episodes["collided"] > 0) + 2 * (1 - episodes["succeeded"]) + 2 * shares

    @classmethod
    def line(cls, figures: dict[str, float | None]) -> str:
        """The figures of one team as a readable line."""
        leader, followers = (
            "not measured" if figures[f"{who}_error_rms_m"] is None else f"{figures[f'{who}_error_rms_m']:.2f} m rms"
            for who in ("leader", "follower")
        )
        free, success = (100 * (figures[key] or 0.0) for key in ("collision_free_episodes", "success_rate"))
        return (
            f"leader error {leader}, followers {followers}, {free:.1f} % of episodes without collision, "
            f"{success:.1f} % succeed"
        )


def slot_clearance(team: TeamTask) -> Tensor:
    """Clearance (m) [env, vehicle] of each vehicle, if it were in its slot, to the side of the nearest obstacle.

    Obstacles that it would pass above or below do not count.
    """
    mission, slot, radius = team.mission, team.now.slot, team.radius
    height = -slot[..., 2:] if team.axes == 3 else torch.zeros_like(slot[..., 2:])
    stands, moves = mission.obstacles[mission.env_world].unsqueeze(1), mission.bodies.table.unsqueeze(1)
    north, east, size, top = stands.unbind(-1)
    bodies: list[tuple[Tensor | float, ...]] = [(north, east, size, -math.inf, top)]
    if mission.bodies.present:
        bodies.append(tuple(moves[..., row, :] for row in (NORTH, EAST, RADIUS, BOTTOM, TOP)))
    nearest = torch.full_like(team.distance, math.inf)
    for north, east, size, bottom, top in bodies:
        beside = torch.hypot(north - slot[..., :1], east - slot[..., 1:2]) - size - radius
        passed = (height - radius > top) | (height + radius < bottom)
        nearest = torch.minimum(nearest, beside.masked_fill(passed, math.inf).amin(-1))
    return nearest
