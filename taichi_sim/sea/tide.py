"""Tidal current: the sum of a few harmonic constituents along one direction.

    u(t) = sum_i A_i cos(omega_i t - phase_i),

with the speeds omega_i of the constituents (config/current.py) and t the world's time: phases are those at its
beginning, without the nodal corrections of a year's prediction. It is rectilinear: the ebb flows against the flood.
"""

import math

import torch
from torch import Tensor

from taichi_sim.config import TideConfig
from taichi_sim.config.current import CONSTITUENTS
from taichi_sim.kernels import runtime


class Tide:
    """A tidal current."""

    def __init__(self, config: TideConfig):
        """Of a configuration."""
        run, parts = runtime.current(), list(config.constituents.items())

        def column(values) -> Tensor:
            return torch.tensor(list(values), dtype=torch.float64, device=run.device)

        self._omega = column(math.radians(CONSTITUENTS[name]) / 3600.0 for name, _ in parts)
        self._amplitude = column(part.amplitude for _, part in parts)
        self._phase = column(math.radians(part.phase_deg) for _, part in parts)
        heading = math.radians(config.direction_deg)
        self._along = column((math.cos(heading), math.sin(heading)))

    def at(self, time: Tensor) -> Tensor:
        """Velocity [env, 2] (north, east, m/s), run precision, at times [env] float64, s."""
        speed = (self._amplitude * torch.cos(time.unsqueeze(1) * self._omega - self._phase)).sum(dim=1, keepdim=True)
        return (speed * self._along).to(runtime.current().torch_dtype)
