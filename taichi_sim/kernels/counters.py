"""Counter of random numbers: a clock, a seed, and a key for each environment.

Kernels draw counted random numbers (kernels/random.py) from (seed, stream, key, vehicle, clock). Two environments with
the same key draw the same numbers. Environments with different keys draw independent numbers.
"""

import torch
from torch import Tensor

from taichi_sim.kernels import runtime

FIRST_FORKED = 1 << 24  # first key of forks that draw noise of their own; above the number of any environment


class Noise:
    """Counter of one source of noise.

    Attributes:
        table: int32 [2 + env], the kernels' argument `count`: clock, seed, and the key of each environment, modulo
        2^32.
        keys: int32 [env], a live view; the key of an environment is its number unless it is a copy of another one.
        clock: number of steps so far.
        seed: seed of the random numbers.
    """

    STATE = ("keys",)
    SHARED = ("clock", "seed", "_head")

    def __init__(self, num_envs: int, seed: int = 0, clock: int = 0):
        """Begin a counter for `num_envs` environments."""
        self.table = torch.zeros(2 + num_envs, dtype=torch.int32, device=runtime.current().device)
        self._head, self.keys = self.table[:2], self.table[2:]
        self.keys.copy_(torch.arange(num_envs))
        self.restart(seed, clock)

    def restart(self, seed: int, clock: int = 0) -> None:
        """Start anew with another seed and the clock at `clock`."""
        self.seed, self.clock = seed, clock
        self._write()

    def tick(self, steps: int = 1) -> None:
        """Advance the clock by `steps` steps."""
        self.clock += steps
        self._write()

    def at(self, envs: Tensor) -> "Noise":
        """Return a copy of the counter for environments `envs` [n] alone."""
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
    """Return x modulo 2^32 in the range of int32; the random numbers are the same."""
    return (x + 2**31) % 2**32 - 2**31
