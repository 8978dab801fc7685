"""Measurements of landings: how they ended, how long they took, how the aircraft touched down."""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Self, cast

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rl.judge import Episodes, Judge, Judged
from rl.missions.landing.aircraft import Aircraft
from rl.missions.landing.config import LandingScenario
from rl.step import Step

OUTCOMES = ("landed", "hard", "toppled", "slid", "ditched", "struck", "late", "lost")
"""How an aircraft's episode ends; lost: outside its model, or no finite state."""
NONE = -1


class LandingJudge(Judge[Judged, LandingScenario]):
    """Measures outcomes and touchdowns of aircraft [env, aircraft]."""

    shares = ("success_rate", *OUTCOMES[1:])
    told = MappingProxyType({
        "time_s": "time to land (s)", "error_m": "off the middle (m)", "speed_m_s": "speed of the touch (m/s)",
    })  # fmt: skip
    goals = ("landed",)
    definitions = {
        "success_rate": "fraction of aircraft that landed: all soles on the deck for landing.stand without a break, "
        "and none of the ends below before",
        "hard": "fraction that touched the deck faster than landing.hard_speed along its normal, or tilted more than "
        "landing.hard_tilt_deg to it",
        "toppled": "fraction that tilted more than landing.toppled_tilt_deg to the deck after a touch",
        "slid": "fraction that drifted more than landing.drift on the deck",
        "ditched": "fraction that met the water",
        "struck": "fraction one of whose rotors met a deck",
        "late": "fraction that had not landed when the episode was over",
        "lost": "fraction that left the envelope of their model",
        "time_to_land_s": "time from the beginning to the first touch, median of those that landed",
        "time_to_land_p95_s": "95th percentile of the same",
        "touch_error_m": "distance from the deck's middle along the deck at the first touch, median of those that "
        "touched",
        "touch_error_p95_m": "95th percentile of the same",
        "touch_speed_m_s": "greatest speed of a sole that comes down, along the deck's normal, median of those "
        "that touched",
        "touch_speed_p95_m_s": "95th percentile of the same",
        "aborts": "times an aircraft was below 1 m and then rose above 2.5 m over the deck, mean of an episode",
        "energy_kJ": "work of the rotors' shafts until the end of the episode, mean",
        "action_change_rms": Judge.definitions["action_change_rms"],
        "reward_per_step": Judge.definitions["reward_per_step"],
    }
    plotted = ("success_rate", "time_to_land_s", "touch_error_p95_m", "touch_speed_p95_m_s")

    def __init__(self, mission: Judged, team: str):
        """Watch `team`."""
        super().__init__(mission, team)
        shape = self.collided.shape
        self.outcome = np.full(shape, NONE)
        self.time, self.error, self.speed = (np.full(shape, np.nan) for _ in range(3))
        self.aborts, self.work = np.zeros(shape), np.zeros(shape)

    @property
    def team(self) -> Aircraft:
        """The aircraft."""
        return cast(Aircraft, self.mission.teams[self.name])

    def see(self, step: Step, number: int) -> None:
        """Take decision `number` (from 1) into account; an aircraft counts until its episode ends."""
        team, dt, alive = self.team, self.mission.config.decision_interval, self.outcome == NONE
        touching = team.touching.cpu().numpy() & alive
        self.time[touching] = number * dt
        self.error[touching] = team.touch_error.double().cpu().numpy()[touching]
        touched = team.touched.cpu().numpy() & alive
        self.speed[touched] = team.touch_speed.double().cpu().numpy()[touched]
        self.aborts[alive] = team.aborts.cpu().numpy()[alive]
        power = team.model.power(team.fleet)
        assert power is not None
        self.work[alive] += dt * power.double().cpu().numpy()[alive]
        for key, flag in step.endings[self.name].items():
            code = OUTCOMES.index(key) if key in OUTCOMES else OUTCOMES.index("lost")
            self.outcome[flag.cpu().numpy() & (self.outcome == NONE)] = code
        super().see(step, number)

    def series(self) -> dict[str, Tensor]:
        """Heights and distances of aircraft."""
        team = self.team
        level = team.offset[..., :2].norm(dim=-1)
        return {"height above the deck (m)": team.height, "distance from its middle (m)": level}

    @classmethod
    def episodes(cls, seen: Sequence[Self], config: LandingScenario) -> dict[str, NDArray[np.float64]]:
        """Add outcomes and touchdowns (means over aircraft) to the numbers of each episode."""
        get = {
            key: np.concatenate([getattr(j, key) for j in seen])
            for key in ("outcome", "time", "error", "speed", "aborts", "work")
        }
        outcome = np.where(get["outcome"] == NONE, OUTCOMES.index("late"), get["outcome"])
        found = {name: (outcome == k).mean(axis=1).astype(float) for k, name in enumerate(OUTCOMES)}
        return super().episodes(seen, config) | {
            **found,
            "succeeded": found["landed"],
            "time_s": _mean(np.where(outcome == 0, get["time"], np.nan)),
            "error_m": _mean(get["error"]),
            "speed_m_s": _mean(get["speed"]),
            "aborts": get["aborts"].mean(axis=1),
            "work_kJ": get["work"].mean(axis=1) / 1e3,
        }

    @classmethod
    def pooled(cls, episodes: Episodes) -> dict[str, NDArray[np.float64]]:
        """Compute the figures of sets of episodes; see `Judge.pooled`."""
        common = super().pooled(episodes)
        figures = {name: episodes[name].mean(-1) for name in OUTCOMES[1:]}
        for name, key in (("time_to_land", "time_s"), ("touch_error", "error_m"), ("touch_speed", "speed_m_s")):
            unit = key.removeprefix("time").removeprefix("error").removeprefix("speed")
            figures[f"{name}{unit}"] = _quantile(episodes[key], 0.5)
            figures[f"{name}_p95{unit}"] = _quantile(episodes[key], 0.95)
        figures |= {
            "success_rate": episodes["succeeded"].mean(-1),
            "aborts": episodes["aborts"].mean(-1),
            "energy_kJ": episodes["work_kJ"].mean(-1),
            "action_change_rms": common["action_change_rms"],
            "reward_per_step": common["reward_per_step"],
        }
        return {key: figures[key] for key in cls.definitions}

    @classmethod
    def badness(cls, episodes: Episodes) -> NDArray[np.float64]:
        """Criteria of the worst episode: not landed, touchdown speed, touchdown error, time to land."""
        bad = (1 - episodes["succeeded"], episodes["speed_m_s"], episodes["error_m"], episodes["time_s"])
        return np.stack([np.nan_to_num(of, nan=0.0) for of in bad])

    @classmethod
    def loss(cls, episodes: Episodes, config: LandingScenario) -> NDArray[np.float64]:
        """Loss of an episode: 10 if not landed, plus time to land and touchdown error."""
        late = np.nan_to_num(episodes["time_s"], nan=config.episode_duration) / config.episode_duration
        off = np.nan_to_num(episodes["error_m"], nan=0.0)
        return 10 * (1 - episodes["succeeded"]) + late + off

    @classmethod
    def line(cls, figures: dict[str, float | None]) -> str:
        """The figures of one team as a line to read."""
        told = [f"{100 * (figures['success_rate'] or 0.0):.1f} % land"]
        if figures["time_to_land_s"] is not None:
            told.append(f"after {figures['time_to_land_s']:.1f} s (p95 {figures['time_to_land_p95_s']:.1f} s)")
        if figures["touch_error_m"] is not None:
            told.append(f"{figures['touch_error_m']:.2f} m off (p95 {figures['touch_error_p95_m']:.2f} m)")
            told.append(f"at {figures['touch_speed_m_s']:.2f} m/s (p95 {figures['touch_speed_p95_m_s']:.2f} m/s)")
        failed = [f"{100 * (figures[name] or 0.0):.1f} % {name}" for name in OUTCOMES[1:] if figures[name]]
        return ", ".join((*told, *failed))


def _mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of each episode over the aircraft with a finite number; NaN without any."""
    count = np.isfinite(values).sum(axis=1)
    return np.where(count > 0, np.nansum(values, axis=1) / np.maximum(count, 1), np.nan)


def _quantile(values: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """Quantile over the last axis by linear interpolation, NaN ignored; NaN where all are."""
    count = np.isfinite(values).sum(-1)
    ordered = np.sort(values, axis=-1)  # NaN come last
    at = share * (np.maximum(count, 1) - 1)
    low = np.floor(at).astype(int)
    high = np.minimum(low + 1, np.maximum(count, 1) - 1)
    a, b = (np.take_along_axis(ordered, k[..., None], -1).squeeze(-1) for k in (low, high))
    return np.where(count > 0, a + (at - low) * (b - a), np.nan)
