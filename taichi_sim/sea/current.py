"""Current: the water's mean velocity, a tide, a slow random part, and its profile over depth.

The mean is steady, or of a file over time (series.py); a tide (tide.py) is added to it. The random part is a
first-order Gauss-Markov process (kernels/gauss_markov.py).

Below the surface the current is uniform or falls with depth d as (1 - d / depth)^(1/7), the tidal profile of
DNV-RP-C205 (2010), sec. 4.1.4.
"""

import math

import torch

from taichi_sim.config import ConfigError, CurrentConfig
from taichi_sim.config.series import Series, read_series
from taichi_sim.kernels import runtime
from taichi_sim.kernels.gauss_markov import SlowVariation
from taichi_sim.sea.tide import Tide

POWER = 1 / 7  # of the tidal profile
FASTEST = 10.0  # m/s, of a series
STREAM = 0xC0  # keeps the current's random numbers apart from those of the waves of the same seed


class Current:
    """The current of every environment.

    Attributes:
        velocity: [env, 2], north and east, m/s, at the surface, run precision; written in place, never replaced.
    """

    STATE = ("velocity", "_mean", "_steady", "_variation")

    def __init__(self, config: CurrentConfig | None, num_envs: int, seed: int, depth: float | None = None):
        """Draw the current of each environment.

        Args:
            config: of the current, None for still water. num_envs: environments. seed: of the run.
            depth: of the water in m, None for deep; a power profile needs it.

        Raises:
            ConfigError: for a power profile in deep water.
        """
        run = runtime.current()
        self.config, self.depth = config or CurrentConfig(), depth
        if self.config.profile == "power" and depth is None:
            raise ConfigError("sea.current.profile = 'power' needs sea.depth, in m")
        heading, speed = math.radians(self.config.direction_deg), self.config.speed
        mean = [speed * math.cos(heading), speed * math.sin(heading)]
        self._mean = torch.tensor(mean, dtype=run.torch_dtype, device=run.device).repeat(num_envs, 1)
        self._series = Series(*read_series(self.config.series, fastest=FASTEST)) if self.config.series else None
        self._tide = Tide(self.config.tide) if self.config.tide else None
        self._steady = self._mean.clone()  # the part of the mean that no time changes
        std, time_constant = self.config.std, self.config.time_constant
        self._variation = SlowVariation(num_envs, std, time_constant, seed=seed, stream=STREAM)
        self.velocity = self._mean.clone()
        everywhere = torch.arange(num_envs, device=run.device)
        self.follow(everywhere, torch.zeros(num_envs, dtype=torch.float64, device=run.device))
        self.reset(everywhere)

    def reseed(self, seed: int) -> None:
        """Make later draws depend on `seed` alone."""
        self._variation.reseed(seed)

    def set_mean(self, envs: torch.Tensor, mean: torch.Tensor) -> None:
        """From now on environments `envs` [n] have the means `mean` [n, 2] (m/s); what the random part is stays."""
        self._steady[envs] = mean
        self._set(envs, mean)

    def follow(self, envs: torch.Tensor, time: torch.Tensor) -> None:
        """Have the means of `envs` [n] be those of their times [n] (float64, s); nothing to do for a steady current."""
        if self._series is None and self._tide is None:
            return
        mean = self._steady[envs] if self._series is None else self._series.at(time)
        self._set(envs, mean if self._tide is None else mean + self._tide.at(time))

    def _set(self, envs: torch.Tensor, mean: torch.Tensor) -> None:
        self._mean[envs] = mean
        self.velocity[envs] = mean + self._variation.value[envs]

    def reset(self, envs: torch.Tensor) -> None:
        """Draw the current of environments `envs` (indices [n], int64) anew from its stationary distribution."""
        self._variation.begin(envs)
        self.velocity[envs] = self._mean[envs] + self._variation.value[envs]

    def advance(self, dt: float) -> None:
        """Step the random part by dt (s), exactly; nothing to do for a steady current."""
        if self._variation.varies:
            self._variation.advance(dt)
            torch.add(self._mean, self._variation.value, out=self.velocity)

    def mean_factor(self, draft: float) -> float:
        """Mean of the current over depths 0 to `draft` (m) as a fraction of the current at the surface.

        Raises:
            ConfigError: if the draft is deeper than the water of a power profile.
        """
        if self.config.profile == "uniform" or draft == 0:
            return 1.0
        assert self.depth is not None
        x = draft / self.depth
        if x > 1:
            raise ConfigError(f"a draft of {draft:g} m does not float in water of sea.depth = {self.depth:g} m")
        # (1 - (1 - x)^(8/7)) / (8/7 x), without cancellation at small x
        power = 1 + POWER
        return -math.expm1(power * math.log1p(-x)) / (power * x) if x < 1 else 1 / power
