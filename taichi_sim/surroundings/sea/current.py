"""Current: mean velocity of the water, tide, slow random part, and profile over depth.

The mean is steady or follows a file over time (config/series.py). A tide is added to it:

    u(t) = sum_i A_i cos(omega_i t - phase_i)

along one direction, so that the ebb runs against the flood. omega_i are the speeds of the harmonic constituents
(config/sea.py), t is the world's time. The phases are those at the beginning of that time, without the nodal
corrections of a yearly prediction. The random part is a first-order Gauss-Markov process (kernels/random.py).

Over depth d the current is uniform, or decreases as (1 - d / depth)^(1/7), the tidal profile of DNV-RP-C205 (2010),
sec. 4.1.4.
"""

import math
from collections.abc import Iterable

import torch

from taichi_sim.config import ConfigError, CurrentConfig, TideConfig
from taichi_sim.config.sea import CONSTITUENTS
from taichi_sim.config.series import Series, read_series
from taichi_sim.kernels import runtime
from taichi_sim.kernels.random import SlowVariation
from taichi_sim.state.memory import Remembers

POWER = 1 / 7  # exponent of the tidal profile
STREAM = 0xC0  # separates the current's random numbers from those of the waves of the same seed


class Tide:
    """Tidal current along one direction (see the module's docstring)."""

    def __init__(self, config: TideConfig):
        """Read direction, amplitudes and phases from a configuration."""
        run, parts = runtime.current(), list(config.constituents.items())

        def column(values: Iterable[float]) -> torch.Tensor:
            return torch.tensor(list(values), dtype=torch.float64, device=run.device)

        self._omega = column(math.radians(CONSTITUENTS[name]) / 3600.0 for name, _ in parts)
        self._amplitude = column(part.amplitude for _, part in parts)
        self._phase = column(math.radians(part.phase_deg) for _, part in parts)
        heading = math.radians(config.direction_deg)
        self._along = column((math.cos(heading), math.sin(heading)))

    def at(self, time: torch.Tensor) -> torch.Tensor:
        """Velocity [env, 2] (north, east, m/s; run precision) at times [env] (float64, s)."""
        speed = (self._amplitude * torch.cos(time.unsqueeze(1) * self._omega - self._phase)).sum(dim=1, keepdim=True)
        return (speed * self._along).to(runtime.current().torch_dtype)


class Current(Remembers):
    """Current of every environment.

    Attributes:
        velocity: velocity at the surface, [env, 2], north and east, m/s, in run precision. It is written in place and
            never replaced.
    """

    def __init__(self, config: CurrentConfig | None, num_envs: int, seed: int, depth: float | None = None):
        """Draw the current of each environment.

        Args:
            config: configuration of the current; None for still water.
            num_envs: number of environments.
            seed: seed of the run.
            depth: depth of the water, m; None for deep water. A power profile needs it.
        """
        run = runtime.current()
        self.config, self.depth = config or CurrentConfig(), depth
        if self.config.profile == "power" and depth is None:
            raise ConfigError("sea.current.profile = 'power' needs sea.depth, in m")
        heading, speed = math.radians(self.config.direction_deg), self.config.speed
        mean = [speed * math.cos(heading), speed * math.sin(heading)]
        self._mean = self.remember(torch.tensor(mean, dtype=run.torch_dtype, device=run.device).repeat(num_envs, 1))
        self._series = Series(*read_series(self.config.series)) if self.config.series else None
        self._tide = Tide(self.config.tide) if self.config.tide else None
        self._steady = self.remember(self._mean.clone())  # the steady part of the mean
        std, time_constant = self.config.std, self.config.time_constant
        self._variation = self.remember(SlowVariation(num_envs, std, time_constant, seed=seed, stream=STREAM))
        self.velocity = self.remember(self._mean.clone())
        everywhere = torch.arange(num_envs, device=run.device)
        self.follow(everywhere, torch.zeros(num_envs, dtype=torch.float64, device=run.device))
        self.reset(everywhere)

    def reseed(self, seed: int) -> None:
        """Make later draws depend on `seed` alone."""
        self._variation.reseed(seed)

    @property
    def steady(self) -> torch.Tensor:
        """Mean current [env, 2] as `set_mean` takes it: without tide and slow variation."""
        return self._steady

    def set_mean(self, envs: torch.Tensor, mean: torch.Tensor) -> None:
        """Set the mean current of environments `envs` [n] to `mean` [n, 2] (m/s); the random part stays."""
        self._steady[envs] = mean
        self._set(envs, mean)

    def follow(self, envs: torch.Tensor, time: torch.Tensor) -> None:
        """Set the mean current of `envs` [n] from series and tide at their times [n] (s); a steady mean stays."""
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
        """Advance the random part by dt (s), exactly; a current without one stays."""
        if self._variation.varies:
            self._variation.advance(dt)
            torch.add(self._mean, self._variation.value, out=self.velocity)

    def mean_factor(self, draft: float) -> float:
        """Ratio of the mean current over depths 0 to `draft` (m) to the current at the surface."""
        if self.config.profile == "uniform" or draft == 0:
            return 1.0
        assert self.depth is not None
        x = draft / self.depth
        if x > 1:
            raise ConfigError(f"a draft of {draft:g} m does not float in water of sea.depth = {self.depth:g} m")
        # (1 - (1 - x)^(8/7)) / (8/7 x), written without cancellation at small x
        power = 1 + POWER
        return -math.expm1(power * math.log1p(-x)) / (power * x) if x < 1 else 1 / power
