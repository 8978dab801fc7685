"""Which environments a phase of a step is for (rl/mission.py), and whether their episodes go on or begin."""

from typing import NamedTuple

from torch import Tensor

NOT_DUE, GOES_ON, BEGINS = range(3)


class Due(NamedTuple):
    """Environments of a phase, as kernels take them.

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
