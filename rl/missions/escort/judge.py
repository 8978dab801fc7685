"""Measurements of an escort: arrival of the boats, errors after it, sightings and news of the vessel."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Self, cast

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

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
from rl.missions.escort.aircraft import EscortAircraft
from rl.missions.escort.boats import EscortBoats
from rl.missions.escort.config import EscortScenario
from rl.step import Step

SEEN_SHARE = 0.9  # success of aircraft: least share of the time after the first sighting with the vessel in view


class EscortJudge(ErrorJudge[Judged, EscortScenario]):
    """Measures boats (time of arrival, errors after it), aircraft (view of the vessel, gaps on the circle), and both
    teams (age of their estimate of the vessel, energy).
    """

    definitions = {
        "time_to_arrive_s": "time until the leader is within escort.arrival of the vessel, median of episodes (boats)",
        "time_to_arrive_p90_s": "90th percentile of the same; infinite (null) if more than a tenth never arrive",
        "mean_time_to_arrive_s": "mean of the same, an episode in which it never arrives counting in full length",
        "never_arrives": "share of episodes in which the leader never arrives",
        "leader_error_rms_m": "root mean square distance of the leader from its slot about the vessel, from "
        "evaluation.settle_after after its arrival on",
        "leader_error_p95_m": "95th percentile of the same distance",
        "follower_error_rms_m": "the same of the other boats, likewise after the leader's arrival",
        "follower_error_p95_m": "95th percentile of the same distance",
        **TEAM_ERROR,
        "in_camera": "share of the time after the leader's arrival (without boats: after 60 s) in which some camera "
        "has the vessel (aircraft)",
        "in_camera_always": "share of all time in which some camera has the vessel (aircraft)",
        "aware": "share of the time in which a vehicle of the team has heard of or seen the vessel within escort.stale",
        "gap_error_deg": "root mean square of half the difference of the gaps ahead and behind on the circle, after "
        "the arrival (aircraft)",
        "energy_per_metre_J": "propulsive work (boats: thrust times speed ahead; aircraft: thrust times airspeed) over "
        "the way over ground",
        "least_gap_m": "least clearance of any vehicle to an obstacle, the vessel or a team mate in an episode, median "
        "over episodes; at most sensing.detection_range",
        **COMMON,
        "success_rate": "fraction of episodes that ran their full time with no vehicle of the team ended, and in which "
        "boats: the leader arrived and the rms error of every boat after that stayed below evaluation.success_error; "
        f"aircraft: some camera had the vessel for {SEEN_SHARE:.0%} of the time after it was first seen",
    }
    told = MappingProxyType({"arrival_counted_s": "time to arrive (s)", **ErrorJudge.told})
    shares = (*ErrorJudge.shares, "never_arrives", "in_camera", "in_camera_always", "aware")
    plotted = ("mean_time_to_arrive_s", "leader_error_rms_m", "follower_error_rms_m", "in_camera",
               "collision_free_episodes", "success_rate")  # fmt: skip

    def __init__(self, mission: Judged, team: str):
        """Measure `team`."""
        super().__init__(mission, team)
        config = self.team.mission.config
        envs, vehicles = self.collided.shape
        self.boats = team == config.escort.boats
        self.arrival = np.full(envs, np.nan)
        self.first_seen = np.full(envs, np.nan)
        self.seen_after, self.after, self.seen, self.aware = (np.zeros(envs) for _ in range(4))
        self.seen_since, self.since = np.zeros(envs), np.zeros(envs)
        self.gaps, self.work, self.way = np.zeros(envs), np.zeros(envs), np.zeros(envs)
        self.gap = np.full(envs, np.inf)
        self.has_work = False

    @property
    def team(self) -> EscortBoats | EscortAircraft:
        """The team."""
        return cast(EscortBoats | EscortAircraft, self.mission.teams[self.name])

    def see(self, step: Step, number: int) -> None:
        """Take decision `number` (from 1) into account, until a vehicle of the team has ended."""
        team, config, alive = self.team, self.team.mission.config, ~self.failed
        dt, sail = config.decision_interval, config.escort.boats in self.mission.teams
        time = number * dt
        arrived = team.mission.arrived.cpu().numpy() if sail else np.full(len(alive), time > 60.0)
        new = alive & arrived & np.isnan(self.arrival)
        self.arrival[new] = time
        if self.boats:
            ready = alive & (time >= self.arrival + config.evaluation.settle_after)
            self.errors[number - 1, ready] = team.distance.cpu().numpy()[ready]
        else:
            aircraft = cast(EscortAircraft, team)
            sees = aircraft.sees.any(-1).cpu().numpy()
            self.first_seen[alive & sees & np.isnan(self.first_seen)] = time
            since = alive & ~np.isnan(self.first_seen)
            self.since[since] += 1
            self.seen_since[since] += sees[since]
            self.seen[alive] += sees[alive]
            self.after[alive & arrived] += 1
            self.seen_after[alive & arrived] += sees[alive & arrived]
            square = aircraft.gap_error.square().mean(-1).double().cpu().numpy()
            self.gaps[alive & arrived] += square[alive & arrived]
        age = team.tracking.of(self.name, team.tracking.age)
        self.aware[alive] += (age <= config.escort.stale).double().mean(-1).cpu().numpy()[alive]
        power = team.fleet.model.power(team.fleet)
        if power is not None:
            self.has_work = True
            self.work[alive] += dt * power.sum(-1).double().cpu().numpy()[alive]
            speed = team.fleet.velocity_n[..., :2].norm(dim=-1).sum(-1)
            self.way[alive] += dt * speed.double().cpu().numpy()[alive]
        gap = team.sensor.gap.amin(dim=1).double().cpu().numpy()
        self.gap[alive] = np.fmin(self.gap, gap)[alive]
        super().see(step, number)

    def series(self) -> dict[str, Tensor]:
        """Distance from the slot or the circle, clearance, and the age of what is known of the vessel."""
        team, tracking = self.team, self.team.tracking
        label = "distance from slot (m)" if self.boats else "distance from circle (m)"
        age = tracking.of(self.name, tracking.age).clamp(max=60.0)
        return {label: team.distance, "gap to anything (m)": team.sensor.gap, "age of the track (s)": age}

    @classmethod
    def episodes(cls, seen: Sequence[Self], config: EscortScenario) -> dict[str, NDArray[np.float64]]:
        """Add times, errors, shares of time, work and way to the numbers of each episode."""
        common = super().episodes(seen, config)
        errors = errors_of(seen)
        rms = rms_of(errors, (0,))
        get = {
            key: np.concatenate([getattr(j, key) for j in seen])
            for key in ("arrival", "seen_after", "after", "seen", "aware", "seen_since", "since", "gaps", "work", "way",
                        "gap", "failed")
        }  # fmt: skip
        length = config.episode_steps * config.decision_interval
        boats = bool(seen and seen[0].boats)
        if boats:
            good = np.isfinite(rms) & (rms < config.evaluation.success_error)
            success = ~get["failed"] & good.all(axis=1)
        else:
            success = ~get["failed"] & (get["seen_since"] >= SEEN_SHARE * np.maximum(get["since"], 1))
        none = np.full(len(success), np.nan)
        arrival = get["arrival"] if boats else none
        has_work = any(j.has_work for j in seen)
        return common | {
            "succeeded": success.astype(float),
            "arrival_counted_s": np.where(np.isnan(arrival), length, arrival) if boats else none,
            "never": np.isnan(arrival).astype(float) if boats else none,
            "after": get["after"],
            "seen_after": none if boats else get["seen_after"],
            "seen": none if boats else get["seen"],
            "aware": get["aware"],
            "gaps": none if boats else get["gaps"],
            "work": get["work"] if has_work else none,
            "way": get["way"],
            "least_gap_m": np.where(np.isfinite(get["gap"]), get["gap"], np.nan),
        }

    @classmethod
    def pooled(cls, episodes: Episodes) -> dict[str, NDArray[np.float64]]:
        """Compute the figures of sets of episodes; see `Judge.pooled`."""
        common = super().pooled(episodes)
        time = np.maximum(episodes["decisions"].sum(-1), 1)
        arrival = np.where(episodes["never"] == 1, np.inf, episodes["arrival_counted_s"])
        after = np.maximum(episodes["after"].sum(-1), 1e-9)
        return {
            "time_to_arrive_s": _finite(_quantile(arrival, 0.5)),
            "time_to_arrive_p90_s": _finite(_quantile(arrival, 0.9)),
            "mean_time_to_arrive_s": episodes["arrival_counted_s"].mean(-1),
            "never_arrives": episodes["never"].mean(-1),
            "leader_error_rms_m": over_time(episodes, "leader"),
            "follower_error_rms_m": over_time(episodes, "follower"),
            "team_error_m": team_error(episodes),
            "in_camera": episodes["seen_after"].sum(-1) / after,
            "in_camera_always": episodes["seen"].sum(-1) / time,
            "aware": episodes["aware"].sum(-1) / time,
            "gap_error_deg": np.degrees(np.sqrt(episodes["gaps"].sum(-1) / after)),
            "energy_per_metre_J": episodes["work"].sum(-1) / np.maximum(episodes["way"].sum(-1), 1e-9),
            "least_gap_m": median_of(episodes["least_gap_m"]),
            **{key: common[key] for key in (*COMMON, "success_rate")},
        }

    @classmethod
    def badness(cls, episodes: Episodes) -> NDArray[np.float64]:
        """Criteria of the worst episode: collided, failed, time of arrival, the larger of both errors."""
        error = np.nan_to_num(np.fmax(episodes["leader_error_rms_m"], episodes["follower_error_rms_m"]), nan=0.0)
        late = np.nan_to_num(episodes["arrival_counted_s"], nan=0.0)
        return np.stack(((episodes["collided"] > 0).astype(np.float64), episodes["failed"], late, error))

    @classmethod
    def loss(cls, episodes: Episodes, config: EscortScenario) -> NDArray[np.float64]:
        """Loss of each episode, a weighted sum of a collision, a failure, and terms of the team.

        Boats: the time to arrive as a share of the episode, and errors as shares of evaluation.success_error. Aircraft:
        the share of time in which no camera sees the vessel.
        """
        shares = cls.error_loss(episodes, config.evaluation.success_error)
        late = np.nan_to_num(episodes["arrival_counted_s"], nan=0.0) / config.episode_duration
        unseen = np.nan_to_num(1 - episodes["seen"] / np.maximum(episodes["decisions"], 1), nan=0.0)
        failed = COLLISION_LOSS * (episodes["collided"] > 0) + 2 * (1 - episodes["succeeded"])
        return failed + 4 * late + shares + 10 * unseen

    @classmethod
    def line(cls, figures: dict[str, float | None]) -> str:
        """The figures of one team as a readable line."""
        free, success = (100 * (figures[key] or 0.0) for key in ("collision_free_episodes", "success_rate"))
        parts = []
        if figures["mean_time_to_arrive_s"] is not None:
            median = figures["time_to_arrive_s"]
            parts.append("median never arrives" if median is None else f"arrival after {median:.0f} s")
            parts.append(f"never {100 * (figures['never_arrives'] or 0.0):.1f} %")
            for who in ("leader", "follower"):
                error = figures[f"{who}_error_rms_m"]
                parts.append(f"{who} error {'not measured' if error is None else f'{error:.2f} m rms'}")
        elif figures["in_camera"] is not None:
            parts.append(f"vessel in some camera {100 * figures['in_camera']:.1f} % of the time after arrival")
        return ", ".join((*parts, f"{free:.1f} % of episodes without collision", f"{success:.1f} % succeed"))


def _quantile(values: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """The quantile `share` over the last axis; NaN where there are no values."""
    if not values.shape[-1] or np.isnan(values).all():
        return np.full(values.shape[:-1], np.nan)
    return np.quantile(values, share, axis=-1, method="inverted_cdf")


def _finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Replace infinity by NaN."""
    return np.where(np.isfinite(values), values, np.nan)
