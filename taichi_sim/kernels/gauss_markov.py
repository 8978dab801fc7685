"""Slow random part of a current or a wind: one first-order Gauss-Markov process for each horizontal component.

The step is the exact solution for any dt (Gelb 1974, Applied Optimal Estimation, sec. 3.8):

    v(t + dt) = phi v(t) + std sqrt(1 - phi^2) xi,   phi = exp(-dt / T),   xi standard normal.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math

import numpy as np
import taichi as ti
import torch
from torch import Tensor

from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import SLOW_VARIATION, Noise, normal6
from taichi_sim.kernels.runtime import array1, array2, whole1

WALK = 60.0  # ns per environment, approximate


@ti.kernel
def _walk(value: array2, numbers: array1, count: whole1, serial: ti.template()):
    ti.loop_config(serialize=serial)
    for e in range(value.shape[0]):
        z = normal6(count[1], SLOW_VARIATION, count[2 + e], 0, count[0])
        for a in ti.static(range(2)):
            value[e, a] = numbers[0] * value[e, a] + numbers[1] * z[a]


class SlowVariation:
    """The two processes of each environment.

    Attributes:
        value: north and east, [env, 2], m/s, in run precision; written in place.
        varies: whether `std` is above 0.
    """

    STATE = ("value", "_noise")
    SHARED = ("_generator",)

    def __init__(self, num_envs: int, std: float, time_constant: float, *, seed: int, stream: int):
        """Begin at zero. `std` m/s, `time_constant` s; `stream` separates the random numbers from other uses."""
        run = runtime.current()
        self.varies, self._std, self._time, self._stream = std > 0, std, time_constant, stream
        self.value = torch.zeros((num_envs, 2), dtype=run.torch_dtype, device=run.device)
        self._numbers, self._step = self.value.new_zeros(2), 0.0
        self._noise = Noise(num_envs)
        self._generator = torch.Generator(device=run.device)
        self._launch, self._serial = runtime.Launcher(_walk), runtime.few(num_envs, WALK)
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Make later draws depend on `seed` alone."""
        drawn = int(np.random.SeedSequence([seed, self._stream]).generate_state(1)[0])
        self._generator.manual_seed(drawn)
        self._noise.restart(drawn)

    def begin(self, envs: Tensor) -> None:
        """Draw environments `envs` (indices [n], int64) from the stationary distribution."""
        if self.varies:
            shape, device = (len(envs), 2), self.value.device
            normal = torch.randn(shape, generator=self._generator, dtype=self.value.dtype, device=device)
            self.value[envs] = self._std * normal

    def advance(self, dt: float) -> None:
        """Advance by `dt` (s), exactly."""
        if self.varies:
            if dt != self._step:
                decay = -dt / self._time
                self._step, self._numbers[0] = dt, math.exp(decay)
                self._numbers[1] = self._std * math.sqrt(-math.expm1(2 * decay))
            self._noise.tick()
            self._launch(self.value, self._numbers, self._noise.table, self._serial)
