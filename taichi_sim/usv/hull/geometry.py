"""The tables of numbers that a hull's kernel reads: panels, wave lines, gauge, deck; from its mesh, once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from taichi_sim.usv.hull.gauge import Gauge
from taichi_sim.usv.hull.hydrostatics import Hydrostatics, Strips
from taichi_sim.usv.hull.mesh import HullShape, Panels, mesh
from taichi_sim.usv.hull.pressure import ACROSS, AHEAD, PANEL_ROWS, STRIPS, WRENCH, WRENCH_ROWS
from taichi_sim.usv.hull.wave_lines import WaveLines, wave_lines

Array = NDArray[np.float64]
PIECES = 8  # of a panel each way, as a waterplane


@dataclass(frozen=True)
class HullGeometry:
    """A hull as its kernel sees it."""

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
    def panel_table(self) -> Array:
        """[PANEL_ROWS, N]: see pressure.py."""
        strips = Strips.of(self.panels, STRIPS)
        (c1, c2), (u1, u2) = strips.centre, strips.up
        table = np.zeros((PANEL_ROWS, len(self.panels)))
        table[:ACROSS] = np.concatenate([c1 + c2, c2 - c1, u1 + u2, u2 - u1], axis=1).T / 2
        table[ACROSS], table[AHEAD] = self.lines.across, self.lines.ahead
        table[WRENCH:] = [strip[:, m, j] for strip in strips.wrench for m, j in WRENCH_ROWS]
        return table

    @cached_property
    def line_table(self) -> Array:
        """[pair, 9]: first point of either line of a pair, and their common step, m, b."""
        a, b = self.lines.start[::2], self.lines.start[1::2]
        return np.concatenate([a, b, self.lines.step[::2]], axis=1)

    @cached_property
    def deck_corners(self) -> Array:
        """[corner, 3] points of the deck edge that reach farthest in one of eight directions: the lowest is one."""
        deck, angle = self.panels.deck, np.arange(8) * np.pi / 4
        reach = deck[:, :2] @ np.stack([np.cos(angle), np.sin(angle)])
        return deck[np.unique(reach.argmax(axis=0))]


def _gauge(panels: Panels) -> Gauge:
    """The waterplane as the panels that face down show it, each cut into PIECES x PIECES."""
    facing = panels.area[:, 2] > 0
    edges = panels.centre, panels.along, panels.up, panels.twist
    centre, along, up, twist = (v[facing, None, None, :2] for v in edges)
    middle = (2 * np.arange(PIECES) + 1) / PIECES - 1
    s, t = middle[:, None, None], middle[None, :, None]
    point, ds, dt = centre + s * along + t * up + s * t * twist, along + t * twist, up + s * twist
    area = np.abs(ds[..., 0] * dt[..., 1] - ds[..., 1] * dt[..., 0])
    half_size = (np.abs(ds) + np.abs(dt)) / PIECES
    return Gauge.of(point.reshape(-1, 2), area.ravel(), half_size.reshape(-1, 2), float(panels.draft))
