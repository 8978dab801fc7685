"""What every vehicle is told of the world around it: sea, current and wind, one row per environment."""

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from taichi_sim import runtime
from taichi_sim.air import Wind
from taichi_sim.packs import AroundPack
from taichi_sim.sea.queries import elevations
from taichi_sim.sea.sea import DEEP, Sea


@dataclass(eq=False)
class Surroundings:
    """Tables and per-environment values of one control step; float tensors have the run's precision.

    The tensors are written in place from step to step, never replaced: what a kernel has been bound to stays.
    """

    sea: Tensor  # [sea, 8, component], rows as in conventions.py
    env_sea: Tensor  # int32 [env], the realisation of each environment
    phase: Tensor  # [env, component], phase - omega t at the beginning of the step, rad (Sea.phases)
    current: Tensor  # [env, 2], north and east velocity of the water at the surface, m/s
    wind: Tensor  # [env, 3], velocity of the air 10 m above the sea, NED, m/s (where it blows to)
    depth: float = DEEP  # of the water, m; negative is deep
    air: Wind | None = None  # profile over height, turbulence and gusts; None is a steady, uniform wind
    clock: int = 0  # control steps since the world was made, through all episodes: counts the random numbers
    seed: int = 0  # of the random numbers
    first_env: int = 0  # number, among the random numbers, of the first environment: not 0 in a replay
    turbulence: Tensor | None = None  # [env], factor of the turbulence's intensity; None is 1 everywhere
    _count: Tensor = field(init=False, repr=False)
    _pack: runtime.Packed = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Begin to count."""
        self._count = torch.zeros(3, dtype=torch.int32, device=self.sea.device)
        numbers = (0.0, 0.0, 0.0) if self.air is None else self.air.numbers
        air = torch.tensor(numbers, dtype=self.sea.dtype, device=self.sea.device)
        self._pack = runtime.Packed(
            AroundPack, sea=self.sea, env_sea=self.env_sea, phase=self.phase, current=self.current, wind=self.wind,
            air=air, turbulence=air if self.turbulence is None else self.turbulence, count=self._count,
        )  # fmt: skip
        self.tick(0)

    @classmethod
    def of(cls, sea: Sea, env_sea: Tensor, time: Tensor) -> "Surroundings":
        """A sea without current or wind; env_sea int32 [env], time float64 [env], s."""
        calm = torch.zeros((env_sea.shape[0], 5), dtype=sea.table.dtype, device=sea.table.device)
        current, wind = calm[:, :2].contiguous(), calm[:, 2:].contiguous()
        depth = DEEP if sea.depth is None else sea.depth
        return cls(sea.table, env_sea, sea.phases(env_sea, time), current, wind, depth)

    def tick(self, steps: int = 1) -> None:
        """Count `steps` control steps."""
        self.clock += steps
        for i, number in enumerate((self.clock, self.seed, self.first_env)):
            self._count[i] = as_i32(number)

    @property
    def pack(self) -> Any:
        """What kernels take: an AroundPack, the same object from step to step."""
        return self._pack()

    def elevation(self, points: Tensor) -> Tensor:
        """Elevation of the sea (m, up) [env, point] at points [env, point, 2] (north, east, m), now."""
        envs, each = points.shape[:2]
        rows = torch.arange(envs, dtype=torch.int32, device=points.device).repeat_interleave(each)
        flat = points.reshape(-1, 2).to(self.sea.dtype).contiguous()
        return elevations(self.sea, flat, rows, self.env_sea, self.phase).view(envs, each)


def as_i32(x: int) -> int:
    """x modulo 2^32, between -2^31 and 2^31: what random numbers make of it is the same."""
    return (x + 2**31) % 2**32 - 2**31
