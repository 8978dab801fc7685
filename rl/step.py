"""What a decision of a mission gives back: why vehicles ended, and rewards."""

from collections.abc import Mapping
from functools import reduce
from operator import or_
from typing import NamedTuple

from torch import Tensor

from taichi_sim.config.base import number

COLLIDED, DIVERGED = "collided", "diverged"  # endings that other modules know, too


class Endings(dict[str, Tensor]):
    """Why a team's vehicles ended in a step: name -> bool [env, vehicle]. They are not changed afterwards; `any` joins
    them.
    """

    def __init__(self, flags: Mapping[str, Tensor]):
        """Store the flags."""
        super().__init__(flags)
        self.any = reduce(or_, self.values())


class Step(NamedTuple):
    """Result of one decision; dictionaries are keyed by team."""

    reward: dict[str, Tensor]  # [env, vehicle]
    endings: dict[str, Endings]  # [env, vehicle] flags
    terminated: Tensor  # [env]: some vehicle's episode ended by what happened
    truncated: Tensor  # [env]: time is up, and nothing happened

    def __repr__(self) -> str:
        """Mean reward and endings of each team, and how many environments are over."""
        teams = []
        for name, reward in self.reward.items():
            why = ", ".join(f"{int(flag.sum())} {ending}" for ending, flag in self.endings[name].items() if flag.any())
            teams.append(f"{name} is paid {float(reward.double().mean()):.3g} on average ({why or 'none ended'})")
        terminated, truncated = int(self.terminated.sum()), int(self.truncated.sum())
        over = f"{terminated} terminated, {truncated} truncated of {number(len(self.truncated), 'environment')}"
        return f"<Step: {'; '.join(teams)};\n {over}>"
