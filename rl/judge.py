"""What an evaluation measures of a mission, and how each figure is defined.

Every environment runs one episode. A team one of whose vehicles has ended is measured no further, while the others go
on. All sums are NumPy's, in float64, so that the result does not depend on the number of threads.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

COMMON = {
    "collisions_per_hour": "vehicles that hit an obstacle or a team mate, per hour of the team's operation",
    "collision_free_episodes": "fraction of episodes in which no vehicle of the team collided",
}


class Judge:
    """Watches one team through a chunk of episodes; a mission derives its own and adds figures.

    Class attributes: `definitions`, figure -> what it means, in the order in which they are told.
    """

    definitions: ClassVar[dict[str, str]] = {
        "reward_per_step": "mean reward of the team's vehicles, over time and episodes",
        **COMMON,
        "success_rate": "fraction of episodes that ran their full time with no vehicle of the team ended",
    }

    def __init__(self, mission: Any, team: str):
        """Watch `team` of a mission at the start of an episode in every environment."""
        self.mission, self.name = mission, team
        envs, vehicles = mission.num_envs, mission.teams[team].fleet.count
        self.collided = np.zeros((envs, vehicles), dtype=bool)
        self.failed = np.zeros(envs, dtype=bool)
        self.reward = np.zeros(envs)
        self.measured = np.zeros(envs)
        self.hours = 0.0

    def see(self, step: Any, number: int) -> None:
        """Take decision `number` (from 1) into account."""
        alive, ended = ~self.failed, step.endings[self.name]
        self.hours += float(alive.sum()) * self.mission.config.decision_interval / 3600
        self.reward[alive] += step.reward[self.name].double().mean(dim=1).cpu().numpy()[alive]
        self.measured[alive] += 1
        if "collided" in ended:
            self.collided[alive] |= ended["collided"].cpu().numpy()[alive]
        self.failed |= ended.any.any(dim=1).cpu().numpy() & alive

    @classmethod
    def figures(cls, seen: Sequence[Any], config: Any) -> dict[str, float | None]:
        """The figures of `definitions` over all chunks of one team."""
        collided, failed = np.concatenate([j.collided for j in seen]), np.concatenate([j.failed for j in seen])
        reward = np.concatenate([j.reward for j in seen]).sum() / max(
            np.concatenate([j.measured for j in seen]).sum(), 1
        )
        return {
            "reward_per_step": float(reward),
            "collisions_per_hour": float(collided.sum() / sum(j.hours for j in seen)),
            "collision_free_episodes": float(1 - collided.any(axis=1).mean()),
            "success_rate": float(1 - failed.mean()),
        }

    @classmethod
    def line(cls, figures: dict[str, float | None]) -> str:
        """The figures of one team as a line to read."""
        return ", ".join(f"{key} {value:.3g}" for key, value in figures.items() if value is not None)
