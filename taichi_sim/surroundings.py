"""What every vehicle kernel is told about the world around its team: sea, current and wind, one row per environment."""

from typing import NamedTuple

import torch
from torch import Tensor

from taichi_sim.air import Wind
from taichi_sim.sea.sea import DEEP, Sea


class Surroundings(NamedTuple):
    """Tables and per-environment values of one control step; float tensors have the run's precision."""

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

    @classmethod
    def of(cls, sea: Sea, env_sea: Tensor, time: Tensor) -> "Surroundings":
        """A sea without current or wind; env_sea int32 [env], time float64 [env], s."""
        calm = torch.zeros((env_sea.shape[0], 5), dtype=sea.table.dtype, device=sea.table.device)
        current, wind = calm[:, :2].contiguous(), calm[:, 2:].contiguous()
        depth = DEEP if sea.depth is None else sea.depth
        return cls(sea.table, env_sea, sea.phases(env_sea, time), current, wind, depth)
