"""Environments of a phase, written by hand."""

import torch

from rl.perception.due import GOES_ON, Due
from taichi_sim.kernels.random import Noise


def due(envs: int, which: int = GOES_ON, *, step: int = 0, noise: Noise | None = None) -> Due:
    """All of `envs` environments, `which` of due.py, after `step` decisions of their episodes."""
    draws = (noise or Noise(envs, 0)).table
    return Due(torch.full((envs,), which, dtype=torch.int32), envs, torch.full((envs,), step), draws)
