"""Measurements of encounters: collisions, gaps, scores after Woerner, delay, wrong sides.

A score judges one encounter, from the latch of its role to the nearest approach (pairs.py), which must have passed; an
episode that ends before it has no score. It is after K. Woerner (2016),
Multi-contact protocol-constrained collision avoidance for autonomous marine vehicles (thesis, MIT), and K. Woerner,
M. Benjamin, M. Novitzky & J. Leonard (2019), Quantifying protocol evaluation for autonomous collision avoidance,
Autonomous Robots 43, 967-991. Ours differ: gaps are between hulls, and angles have the signs below. With r the least
gap, a our bearing from the other and b its bearing from us there (to starboard positive), cut(x) = min(|x|, 90 deg):

    S_r = 1 (r >= clear), 1 - 0.4 (clear - r) / (clear - near), 0.6 r / near (r < near)
    S_T = (1 - cos cut(a)) (1 - cos cut(b)),   S = (S_r + S_T) / 2
    P_delay = (range at the latch - at the first manoeuvre) / (at the latch - at the nearest approach), 1 without one
    P_na = (30 deg - change of course) / 20 deg, times (0.5 - share of speed given up) / 0.3, each from 0 to 1
    S_14 = (1 - 0.6 [no turn to starboard] - 0.2 P_delay - (1 - ((1 - sin a) / 2)^2 ((1 - sin b) / 2)^2)) (1 - P_na)
    S_16 = S (1 - P_delay) (1 - P_na),   S_15 = S_16 - 0.5 [-25 < a < 165 deg],   S_13 = S_16 - 0.3 [|a| < 45 deg]
    S_17 = S (1 - (early change - 10 deg) / 20 deg), times 0.7 with a turn to port

each limited to [0, 1]; S_14 is of head-on encounters, S_15 of crossings in which the own ship gives way, S_13 of
those in which it overtakes, S_17 of all in which it stands on.
"""

from collections.abc import Sequence
from types import MappingProxyType
from typing import Self, cast

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from rl.judge import COMMON, Episodes, Judge, Judged
from rl.missions.encounter.config import EncounterConfig, EncounterScenario
from rl.missions.encounter.pairs import ACTS, DEG, Pair, Role
from rl.missions.encounter.team import OwnShips
from rl.step import Step

RULES = {
    "rule_14": (Role.HEAD_ON,), "rule_15": (Role.GIVE_WAY,), "rule_13": (Role.OVERTAKING,),
    "rule_17": (Role.STAND_ON, Role.OVERTAKEN),
}  # fmt: skip
GIVES = (Role.HEAD_ON, Role.GIVE_WAY, Role.OVERTAKING)
SOLD = 20.0  # loss of an episode with a collision; assumed


class EncounterJudge(Judge[Judged, EncounterScenario]):
    """Measures encounters of the own ships."""

    definitions = {
        "success_rate": "fraction of episodes without a collision, in which no gap was below encounter.near, and "
        "nobody was lost",
        **COMMON,
        "near_misses": "fraction of episodes in which a gap was below encounter.near",
        "least_gap_m": "least gap to any hull in an episode, 5th percentile of episodes",
        "fault": "1 - score + delay, the figure of the benchmark's tasks",
        "score": "mean score after Woerner of all encounters whose nearest approach has passed",
        **{f"{rule}_score": f"the same of {rule.replace('_', ' ')}" for rule in RULES},
        "delay": "share of the planned way along the route that was not made good, mean",
        "wrong_side": "share of head-on and give-way encounters in which the first manoeuvre is a turn to port of 10 "
        "degrees",
        "early": "share of stand-on encounters with a change of course of more than 10 degrees before the middle stage",
        "unseen": "share of encounters in which the own ship gives way with no change of course of 10 degrees nor of "
        "a fifth of the speed",
        "across_rms_m": "root mean square distance from the route",
        "reward_per_step": Judge.definitions["reward_per_step"],
    }
    plotted = ("collision_free_episodes", "near_misses", "score", "delay")
    shares = ("collision_free_episodes", "success_rate", "near_misses", "wrong_side", "early", "unseen")
    told = MappingProxyType({"least_gap_m": "least gap (m)", "score": "score", "delay": "delay (share)"})

    def __init__(self, mission: Judged, team: str):
        """Watch `team`."""
        super().__init__(mission, team)
        self.pairs = self.team.pairs.table.cpu().numpy().copy()
        self.made, self.off = np.zeros(mission.num_envs), np.zeros(mission.num_envs)

    @property
    def team(self) -> OwnShips:
        """The own ships."""
        return cast(OwnShips, self.mission.teams[self.name])

    def see(self, step: Step, number: int) -> None:
        """Take decision `number` (from 1) into account."""
        alive, team = ~self.failed, self.team
        self.pairs[alive] = team.pairs.table.cpu().numpy()[alive]
        self.made[alive] += (team.along / team.part.speed).double().mean(1).cpu().numpy()[alive]
        self.off[alive] += team.across.double().square().mean(1).cpu().numpy()[alive]
        super().see(step, number)

    def series(self) -> dict[str, Tensor]:
        """Gaps and offsets."""
        team = self.team
        return {
            "gap to the nearest hull (m)": team.pairs.gap.clamp(max=team.part.corridor),
            "offset of course (deg)": team.offsets[..., 0] / DEG, "distance from the route (m)": team.across,
        }  # fmt: skip

    @classmethod
    def episodes(cls, seen: Sequence[Self], config: EncounterScenario) -> dict[str, NDArray[np.float64]]:
        """Add gaps, sums of scores and counts of each rule, delay and manoeuvres."""
        pairs, made, off = (np.concatenate([getattr(j, key) for j in seen]) for key in ("pairs", "made", "off"))
        found, near = super().episodes(seen, config), config.encounter.near
        least = pairs[..., Pair.LEAST].min(axis=(1, 2)).astype(np.float64)
        passed = (pairs[..., Pair.GAP] > pairs[..., Pair.NEAR]) | (pairs[..., Pair.NEAR] <= 0)
        kind, score = pairs[..., Pair.KIND] * passed, scores(pairs.astype(np.float64), config.encounter)
        count = {rule: np.isin(kind, roles) for rule, roles in RULES.items()}
        gives = np.isin(kind, GIVES)
        sided = np.isin(kind, (Role.HEAD_ON, Role.GIVE_WAY))
        acted = pairs[..., Pair.ACTED] > 0
        flags = {
            "wrong": sided & (pairs[..., Pair.FIRST] < -ACTS), "sided": sided,
            "hasty": count["rule_17"] & (pairs[..., Pair.EARLY] > ACTS), "stood": count["rule_17"],
            "silent": gives & ~acted, "gave": gives,
        }  # fmt: skip
        found |= {name: flag.sum(axis=(1, 2)).astype(float) for name, flag in flags.items()}
        for rule, of in count.items():
            found |= {f"{rule}_sum": np.where(of, score, 0.0).sum(axis=(1, 2)), f"{rule}_n": of.sum(axis=(1, 2)) * 1.0}
        total, number = (sum(found[f"{rule}_{of}"] for rule in RULES) for of in ("sum", "n"))
        return found | {
            "least_gap_m": least, "near_miss": (least < near) * 1.0,
            "succeeded": found["succeeded"] * (least >= near),
            "score": np.where(number > 0, total / np.maximum(number, 1), np.nan),
            "delay": 1.0 - made / np.maximum(found["decisions"], 1), "off": off,
        }  # fmt: skip

    @classmethod
    def pooled(cls, episodes: Episodes) -> dict[str, NDArray[np.float64]]:
        """Compute the figures of sets of episodes."""

        def share(part: str, whole: str) -> NDArray[np.float64]:
            n = episodes[whole].sum(-1)
            return np.where(n > 0, episodes[part].sum(-1) / np.maximum(n, 1), np.nan)

        number = sum(episodes[f"{rule}_n"].sum(-1) for rule in RULES)
        total = sum(episodes[f"{rule}_sum"].sum(-1) for rule in RULES)
        score, delay = np.where(number > 0, total / np.maximum(number, 1), np.nan), episodes["delay"].mean(-1)
        figures = super().pooled(episodes) | {
            "near_misses": episodes["near_miss"].mean(-1),
            "least_gap_m": np.quantile(episodes["least_gap_m"], 0.05, axis=-1),
            "fault": 1 - score + delay, "score": score,
            **{f"{rule}_score": share(f"{rule}_sum", f"{rule}_n") for rule in RULES},
            "delay": delay, "wrong_side": share("wrong", "sided"),
            "early": share("hasty", "stood"), "unseen": share("silent", "gave"),
            "across_rms_m": np.sqrt(episodes["off"].sum(-1) / np.maximum(episodes["decisions"].sum(-1), 1)),
        }  # fmt: skip
        return {key: figures[key] for key in cls.definitions}

    @classmethod
    def badness(cls, episodes: Episodes) -> NDArray[np.float64]:
        """Criteria of the worst episode: collided, least gap, score."""
        return np.stack((episodes["collided"], -episodes["least_gap_m"], -np.nan_to_num(episodes["score"], nan=1.0)))

    @classmethod
    def loss(cls, episodes: Episodes, config: EncounterScenario) -> NDArray[np.float64]:
        """Loss of an episode: of collisions, near misses, gaps below `clear`, rules, wrong sides and delay."""
        part = config.encounter
        short = np.clip(1.0 - episodes["least_gap_m"] / part.clear, 0.0, 1.0)
        rules = (1 - np.nan_to_num(episodes["score"], nan=1.0)) + episodes["wrong"]
        return SOLD * episodes["collided"] + 5 * episodes["near_miss"] + 2 * short + 2 * rules + 5 * episodes["delay"]

    @classmethod
    def line(cls, figures: dict[str, float | None]) -> str:
        """The figures of one team as a line to read."""
        parts = (
            ("collision_free_episodes", "{:.2%} without a collision"), ("near_misses", "{:.2%} near misses"),
            ("least_gap_m", "least gap {:.1f} m (5th percentile)"), ("score", "score {:.2f}"),
            ("delay", "{:.1%} delay"), ("wrong_side", "{:.1%} on the wrong side"),
        )  # fmt: skip
        told = ((text, figures.get(key)) for key, text in parts)
        return ", ".join(text.format(value) for text, value in told if value is not None)


def scores(pairs: NDArray[np.float64], part: EncounterConfig) -> NDArray[np.float64]:
    """The score of each pair [.., Pair], by its rule; see the module."""
    get = {column: pairs[..., column] for column in Pair if column != Pair.SIZE}
    r, a, b = get[Pair.NEAR], get[Pair.CONTACT], get[Pair.BEARING]
    above = 1.0 - 0.4 * (part.clear - r) / (part.clear - part.near)
    S_r = np.where(r >= part.clear, 1.0, np.where(r >= part.near, above, 0.6 * r / part.near))
    half = np.pi / 2
    S_T = (1 - np.cos(np.minimum(np.abs(a), half))) * (1 - np.cos(np.minimum(np.abs(b), half)))
    S = 0.5 * (S_r + S_T)
    way = np.maximum(get[Pair.RANGE] - get[Pair.NEAR_RANGE], 1.0)
    late = np.clip((get[Pair.RANGE] - get[Pair.ACTED]) / way, 0.0, 1.0)
    late = np.where(get[Pair.ACTED] > 0, late, 1.0)
    turn = np.maximum(get[Pair.STARBOARD], get[Pair.PORT])
    unseen = np.clip((30 * DEG - turn) / (20 * DEG), 0, 1) * np.clip((0.5 - get[Pair.SLOWED]) / 0.3, 0, 1)
    no_starboard = get[Pair.STARBOARD] < ACTS
    port_to_port = ((1 - np.sin(a)) / 2) ** 2 * ((1 - np.sin(b)) / 2) ** 2
    S_14 = (1 - 0.6 * no_starboard - 0.2 * late - (1 - port_to_port)) * (1 - unseen)
    S_16 = S * (1 - late) * (1 - unseen)
    S_15 = S_16 - 0.5 * ((a > -25 * DEG) & (a < 165 * DEG))
    S_13 = S_16 - 0.3 * (np.abs(a) < 45 * DEG)
    S_17 = S * (1 - np.clip((get[Pair.EARLY] - ACTS) / (20 * DEG), 0, 1)) * np.where(get[Pair.FIRST] < -ACTS, 0.7, 1.0)
    chosen = np.select(
        [get[Pair.KIND] == int(Role.HEAD_ON), get[Pair.KIND] == int(Role.GIVE_WAY),
         get[Pair.KIND] == int(Role.OVERTAKING)], [S_14, S_15, S_13], S_17,
    )  # fmt: skip
    return np.clip(chosen, 0.0, 1.0)
