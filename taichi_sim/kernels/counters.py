"""Counters of random numbers: a clock, a seed, and a key for each environment.

Kernels draw counted random numbers (kernels/random.py) from (seed, stream, key, vehicle, clock). Two environments with
one key draw the same numbers; with keys of their own they draw independent ones.
"""

import torch
from torch import Tensor

from taichi_sim.kernels import runtime

FIRST_FORKED = 1 << 24  # keys of copies that draw their own noise begin here: beyond any environment's own number


class Noise:
    """The counter of one source of noise.

    Attributes:
        table: int32 [2 + env], what kernels take as `count`: clock, seed, and the key of each environment, modulo 2^32.
        keys: int32 [env], a live view; an environment's number unless it is a copy of another one.
        clock: steps counted so far. seed: of the numbers.
    """

    STATE = ("keys",)
    SHARED = ("clock", "seed", "_head")

    def __init__(self, num_envs: int, seed: int = 0, clock: int = 0):
        """Count for `num_envs` environments."""
        self.table = torch.zeros(2 + num_envs, dtype=torch.int32, device=runtime.current().device)
        self._head, self.keys = self.table[:2], self.table[2:]
        self.keys.copy_(torch.arange(num_envs))
        self.restart(seed, clock)

    def restart(self, seed: int, clock: int = 0) -> None:
        """Start anew from another seed, with the clock at `clock`."""
        self.seed, self.clock = seed, clock
        self._write()

    def tick(self, steps: int = 1) -> None:
        """Advance the clock by `steps` steps."""
        self.clock += steps
        self._write()

    def at(self, envs: Tensor) -> "Noise":
        """A copy of the counter for environments `envs` [n] alone."""
        part = Noise(len(envs))
        part.renew(self, envs)
        return part

    def renew(self, whole: "Noise", envs: Tensor) -> None:
        """Write `whole.at(envs)` in place; of the same number of environments as this one."""
        self.keys.copy_(whole.keys[envs])
        self.restart(whole.seed, whole.clock)

    def _write(self) -> None:
        self._head[0], self._head[1] = as_i32(self.clock), as_i32(self.seed)


def as_i32(x: int) -> int:
    """x modulo 2^32, between -2^31 and 2^31: what random numbers make of it is the same."""
    return (x + 2**31) % 2**32 - 2**31
