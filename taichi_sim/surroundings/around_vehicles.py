"""Surroundings of every vehicle: sea, current and wind, one row per environment."""

from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from taichi_sim.kernels import lanes, runtime
from taichi_sim.kernels.conventions import OMEGA, K
from taichi_sim.kernels.packs import AroundPack
from taichi_sim.kernels.random import Noise
from taichi_sim.state.memory import Remembers
from taichi_sim.surroundings.air import Wind
from taichi_sim.surroundings.sea.query_kernels import elevations
from taichi_sim.surroundings.sea.sea import DEEP, Sea

NO_WAVE = 1e-12  # rad/m, rad/s, nonzero for divisions: k and omega of components that pad the last lanes


@dataclass(eq=False)
class Surroundings(Remembers):
    """Tables and per-environment values of one control step; float tensors have the run's precision.

    The tensors are written in place from step to step and never replaced, so kernels stay bound to them.
    """

    sea: Tensor  # [sea, 8, component], rows as in conventions.py
    env_sea: Tensor  # int32 [env], the realisation of each environment
    phase: Tensor  # [env, component], phase - omega t at the beginning of the step, rad (Sea.phases)
    current: Tensor  # [env, 2], north and east velocity of the water at the surface, m/s
    wind: Tensor  # [env, 3], velocity of the air 10 m above the sea, NED, m/s (where it blows to)
    depth: float = DEEP  # depth of the water, m; negative is deep
    air: Wind | None = None  # profile over height, turbulence and gusts; None is a steady, uniform wind
    noise: Noise | None = None  # counts the random numbers: control steps since the world was made; None: seed 0
    turbulence: Tensor | None = None  # [env], factor of the turbulence's intensity; None is 1 everywhere
    _pack: runtime.Packed = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Pack the arguments of kernels."""
        self.current, self.wind = self.remember(self.current), self.remember(self.wind)
        if self.noise is None:
            self.noise = Noise(self.env_sea.shape[0])
        numbers = (0.0, 0.0, 0.0) if self.air is None else self.air.numbers
        air = torch.tensor(numbers, dtype=self.sea.dtype, device=self.sea.device)
        self._pack = runtime.Packed(
            AroundPack, sea=self.sea, env_sea=self.env_sea, phase=self.phase, current=self.current, wind=self.wind,
            air=air, turbulence=air if self.turbulence is None else self.turbulence, count=self.noise.table,
            waves=_filled_up(self.sea).flatten(0, -2), turns=lanes.laned(self.phase),
        )  # fmt: skip

    @classmethod
    def of(cls, sea: Sea, env_sea: Tensor, time: Tensor) -> "Surroundings":
        """A sea without current or wind; env_sea int32 [env], time float64 [env], s."""
        calm = torch.zeros((env_sea.shape[0], 5), dtype=sea.table.dtype, device=sea.table.device)
        current, wind = calm[:, :2].contiguous(), calm[:, 2:].contiguous()
        depth = DEEP if sea.depth is None else sea.depth
        return cls(sea.table, env_sea, sea.phases(env_sea, time), current, wind, depth)

    def part(self, envs: Tensor, phase: Tensor) -> "Surroundings":
        """Return a copy of the rows of environments `envs` [n], with the phases `phase` [n, component]."""
        assert self.noise is not None
        return replace(
            self, env_sea=self.env_sea[envs], phase=phase, current=self.current[envs], wind=self.wind[envs],
            noise=self.noise.at(envs), turbulence=None if self.turbulence is None else self.turbulence[envs],
        )  # fmt: skip

    def renew(self, whole: "Surroundings", envs: Tensor, phase: Tensor) -> None:
        """Write `whole.part(envs, phase)` in place; of the same number of environments as this one."""
        assert self.noise is not None and whole.noise is not None
        self.phase.copy_(phase)
        for name in ("env_sea", "current", "wind"):
            torch.index_select(getattr(whole, name), 0, envs, out=getattr(self, name))
        if self.turbulence is not None and whole.turbulence is not None:
            torch.index_select(whole.turbulence, 0, envs, out=self.turbulence)
        self.noise.renew(whole.noise, envs)

    @property
    def pack(self) -> Any:
        """The AroundPack for kernels; the same object from step to step."""
        if self.sea.shape[2] % lanes.width():  # padding makes copies
            for name, values in (("waves", self.sea), ("turns", self.phase)):
                self._pack.members[name].view(*values.shape[:-1], -1)[..., : values.shape[-1]] = values
        return self._pack()

    def elevation(self, points: Tensor) -> Tensor:
        """Present elevation of the sea (m, up) [env, point] at points [env, point, 2] (north, east, m)."""
        envs, each = points.shape[:2]
        rows = torch.arange(envs, dtype=torch.int32, device=points.device).repeat_interleave(each)
        flat = points.reshape(-1, 2).to(self.sea.dtype).contiguous()
        return elevations(self.sea, flat, rows, self.env_sea, self.phase).view(envs, each)


def _filled_up(sea: Tensor) -> Tensor:
    """The sea, padded to whole lanes (lanes.py) by components without amplitude: a calm sea stays exactly calm."""
    waves = lanes.laned(sea)
    if sea.shape[2] % lanes.width():
        waves.flatten(-2)[:, (K, OMEGA), sea.shape[2] :] = NO_WAVE
    return waves
