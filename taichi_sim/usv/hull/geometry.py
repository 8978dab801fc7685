"""Everything that follows from a hull's shape: panels, wave lines, gauge, hydrostatics and deck; computed once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from taichi_sim.conventions import AHEAD, STARBOARD
from taichi_sim.kernels import runtime
from taichi_sim.usv.hull.gauge import Gauge
from taichi_sim.usv.hull.hydrostatics import Hydrostatics
from taichi_sim.usv.hull.mesh import HullShape, Panels, mesh
from taichi_sim.usv.hull.wave_lines import WaveLines, wave_lines

Array = NDArray[np.float64]
PIECES = 8  # divisions of a panel in each direction, for the waterplane


@dataclass(frozen=True)
class HullGeometry:
    """Geometry of one hull, in b."""

    panels: Panels
    lines: WaveLines
    gauge: Gauge
    hydrostatics: Hydrostatics

    @classmethod
    def of(cls, shape: HullShape, mass: float, cg: tuple[float, float, float]) -> "HullGeometry":
        """Mesh `shape` and prepare its tables; mass (kg) and cg (m, b) are those of the loaded hull."""
        panels = mesh(shape)
        return cls(panels, wave_lines(panels), _gauge(panels), Hydrostatics(panels, mass, cg))

    @cached_property
    def deck_corners(self) -> Array:
        """Points [corner, 3] of the deck edge that are the outermost in any of eight directions; the lowest point
        is one of them.
        """
        deck, angle = self.panels.deck, np.arange(8) * np.pi / 4
        reach = deck[:, :2] @ np.stack([np.cos(angle), np.sin(angle)])
        return deck[np.unique(reach.argmax(axis=0))]


def device_table(values: NDArray) -> Tensor:
    """Convert real numbers to a tensor for kernels, in run precision and on the run's device."""
    run = runtime.current()
    return torch.as_tensor(np.ascontiguousarray(values), dtype=run.torch_dtype, device=run.device)


def _gauge(panels: Panels) -> Gauge:
    """Gauge of the waterplane that the downward-facing panels show, each cut into PIECES x PIECES."""
    facing = panels.area[:, 2] > 0
    edges = panels.centre, panels.along, panels.up, panels.twist
    centre, along, up, twist = (v[facing, None, None, :2] for v in edges)
    middle = (2 * np.arange(PIECES) + 1) / PIECES - 1
    s, t = middle[:, None, None], middle[None, :, None]
    point, ds, dt = centre + s * along + t * up + s * t * twist, along + t * twist, up + s * twist
    area = np.abs(ds[..., AHEAD] * dt[..., STARBOARD] - ds[..., STARBOARD] * dt[..., AHEAD])
    half_size = (np.abs(ds) + np.abs(dt)) / PIECES
    return Gauge.of(point.reshape(-1, 2), area.ravel(), half_size.reshape(-1, 2), float(panels.draft))
