"""One decision of a mission (rl/mission.py): what it takes and gives back, and which environments a phase is for."""

from collections.abc import Mapping
from functools import reduce
from operator import or_
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.config.base import number

COLLIDED, DIVERGED = "collided", "diverged"  # endings that other modules know, too
NOT_DUE, GOES_ON, BEGINS = range(3)


class Due(NamedTuple):
    """The environments that a phase applies to, as kernels take them.

    Attributes:
        which: int32 [env], `NOT_DUE`, `GOES_ON` after a step, or `BEGINS` as an episode begins.
        count: how many are due; a few are handled on the calling thread.
        steps: int64 [env], decisions since the episode began.
        draws: int32 [2 + env], the counter of random numbers (taichi_sim/kernels/random.py).
    """

    which: Tensor
    count: int
    steps: Tensor
    draws: Tensor

    @property
    def goes_on(self) -> Tensor:
        """Where an episode goes on, bool [env]."""
        return self.which == GOES_ON

    @property
    def begins(self) -> Tensor:
        """Where an episode begins, bool [env]."""
        return self.which == BEGINS


class VehicleActions(NamedTuple):
    """Actions of the vehicle model itself, in place of a policy's: a classical controller's, a planner's, a test's."""

    values: Tensor | ArrayLike  # [env, vehicle, `Vehicle.action_names`] in [-1, 1]


class Endings(dict[str, Tensor]):
    """Why a team's vehicles ended in a step: name -> bool [env, vehicle]. They are not changed afterwards; `any` joins
    them.
    """

    def __init__(self, flags: Mapping[str, Tensor]):
        """Store the flags."""
        super().__init__(flags)
        self.any = reduce(or_, self.values())

    def why(self) -> NDArray[np.object_]:
        """The name of what ended each vehicle [env, vehicle], None where nothing did."""
        names = np.full(tuple(self.any.shape), None)
        for name, flags in self.items():
            names[flags.cpu().numpy()] = name
        return names


class Step(NamedTuple):
    """Result of one decision; dictionaries are keyed by team."""

    reward: dict[str, Tensor]  # [env, vehicle]
    endings: dict[str, Endings]  # [env, vehicle] flags
    terminated: Tensor  # [env]: some vehicle's episode ended by what happened
    truncated: Tensor  # [env]: time is up, and nothing happened
    observations: dict[str, Tensor] = {}  # [env, vehicle, n], for the next decision
    last: dict[str, Tensor] | None = None  # [env, vehicle, n], as episodes end; None: none has ended

    @property
    def over(self) -> Tensor:
        """Where the episode is over, bool [env]."""
        return self.terminated | self.truncated

    def __repr__(self) -> str:
        """Mean reward and endings of each team, and how many environments are over."""
        teams = []
        for name, reward in self.reward.items():
            why = ", ".join(f"{int(flag.sum())} {ending}" for ending, flag in self.endings[name].items() if flag.any())
            teams.append(f"{name} is paid {float(reward.double().mean()):.3g} on average ({why or 'none ended'})")
        terminated, truncated = int(self.terminated.sum()), int(self.truncated.sum())
        over = f"{terminated} terminated, {truncated} truncated of {number(len(self.truncated), 'environment')}"
        return f"<Step: {'; '.join(teams)};\n {over}>"
