"""Points and triangles of the sea patch: a square of cells, finer ones in its middle, and two rings to the horizon.

The finer square is around the vehicles. In the first ring the waves fade out; the second ring is flat.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.recording.episode import Array, TeamTrack

CELLS, CELLS_ALOFT = 20, 40  # coarse cells per side, around boats and below aircraft
MIN_HALF_M = 30.0  # half the side of the smallest patch
MAX_HALF_M = 160.0
FINE_CELLS = 32  # largest number of finer cells per side; at least two fit into a coarse one
FINE_LENGTHS, FINE_HALF_M = 0.5, 9.0  # margin of the finer square around the formation; its least half side
FINE_SHARE = 0.5  # side of a finer cell over a vehicle's length, if FINE_CELLS allows
FADE = 1.6  # outer radius of the first ring over half a side of the square
RINGS = 2


@dataclass(frozen=True)
class SeaGrid:
    """Cells of the patch: a coarse square, in which finer cells replace the middle."""

    cells: int  # coarse cells per side
    cell: float  # m, side of a coarse cell
    middle: int  # replaced coarse cells per side; even, so that the centre is a point of both squares
    parts: int  # finer cells along a coarse one; 1: no cell is replaced

    @classmethod
    def of(cls, team: TeamTrack) -> "SeaGrid":
        """A grid that holds the formation with room to spare and, if cells allow, resolves the waves along a hull."""
        cells = CELLS if team.on_water else CELLS_ALOFT
        height = 0.0 if team.on_water else -float(np.median(team.places_n[:, 0, 2]))  # height of the eye over the sea
        half = np.clip(0.75 * team.formation_radius_m + 16.0 + height, MIN_HALF_M, MAX_HALF_M)
        cell = float(np.ceil(2.0 * 2.0 * half / cells) / 2.0)
        reach = max(team.formation_radius_m + FINE_LENGTHS * team.size_m[0], FINE_HALF_M)
        middle = min(2 * int(np.ceil(reach / cell)), cells - 4)
        wanted = int(np.ceil(cell / (FINE_SHARE * team.size_m[0])))
        return cls(cells, cell, middle, max(2, min(wanted, FINE_CELLS // middle)) if team.on_water else 1)

    @property
    def half_m(self) -> float:
        """Half the side of the square that moves with the waves, m."""
        return 0.5 * self.cells * self.cell

    @property
    def coarse_line(self) -> Array:
        """Coordinates [cells + 1] from the centre, m."""
        return self.cell * (np.arange(self.cells + 1) - self.cells / 2)

    @property
    def fine_line(self) -> Array:
        """Coordinates of the finer points from the centre, m; empty if no cell is replaced."""
        count = self.middle * self.parts
        return self.cell / self.parts * (np.arange(count + 1) - count / 2) if self.parts > 1 else np.zeros(0)

    @property
    def shown(self) -> NDArray[np.bool_]:
        """Mask [(cells + 1)^2] of the coarse points in the mesh: all but those in the finer square."""
        shown = np.ones((self.cells + 1, self.cells + 1), dtype=bool)
        if self.parts > 1:
            shown[self._edge : self.cells - self._edge + 1, self._edge : self.cells - self._edge + 1] = False
        return shown.ravel()

    @property
    def _edge(self) -> int:
        """Coarse cells between the border and the finer square."""
        return (self.cells - self.middle) // 2

    @property
    def rim(self) -> NDArray[np.int64]:
        """Indices of the coarse square's border points, once around."""
        index = np.arange((self.cells + 1) ** 2).reshape(self.cells + 1, self.cells + 1)
        return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])

    def triangles(self) -> NDArray[np.uint32]:
        """Corners [N, 3] of the triangles, counter-clockwise from above.

        The coarse points in the mesh come first, row by row from the south, then the finer ones, then the rings.
        """
        number = np.cumsum(self.shown) - 1
        first, side = number[-1] + 1, len(self.fine_line)
        square = number.reshape(self.cells + 1, self.cells + 1)
        outside = np.ones((self.cells, self.cells), dtype=bool)
        parts = []
        if side:
            fine, edge = first + np.arange(side**2).reshape(side, side), self._edge
            square[edge : self.cells - edge + 1, edge : self.cells - edge + 1] = fine[:: self.parts, :: self.parts]
            outside[edge - 1 : self.cells - edge + 1, edge - 1 : self.cells - edge + 1] = False
            for corner in (edge - 1, self.cells - edge):
                outside[corner, [edge - 1, self.cells - edge]] = True
            parts += [first + _cells(side - 1), *(self._seam(np.rot90(square, k), np.rot90(fine, k)) for k in range(4))]
        parts.append(number[_cells(self.cells)[np.tile(outside.ravel(), 2)]])
        inner = number[self.rim]
        for ring in range(RINGS):
            outer = first + side**2 + ring * len(inner) + np.arange(len(inner))
            after = np.roll(inner, -1), np.roll(outer, -1)
            parts += [np.stack([inner, after[1], after[0]], axis=1), np.stack([inner, outer, after[1]], axis=1)]
            inner = outer
        return np.concatenate(parts).astype(np.uint32)

    def _seam(self, square: NDArray[np.int64], fine: NDArray[np.int64]) -> NDArray[np.int64]:
        """Triangles [N, 3] of the coarse cells south of the finer square: fans to all its border points, no gaps."""
        far, near = square[self._edge - 1, self._edge : self.cells - self._edge + 1], fine[0]
        fans = np.stack([np.repeat(far[:-1], self.parts), near[1:], near[:-1]], axis=1)
        return np.concatenate([fans, np.stack([far[:-1], far[1:], near[self.parts :: self.parts]], axis=1)])


def _cells(count: int) -> NDArray[np.int64]:
    """Triangles [2 count^2, 3] of a square of cells: all lower ones, then all upper ones."""
    side = count + 1
    corner = (np.arange(count)[:, None] * side + np.arange(count)).ravel()
    lower, upper = (corner, corner + 1, corner + side + 1), (corner, corner + side + 1, corner + side)
    return np.concatenate([np.stack(lower, axis=1), np.stack(upper, axis=1)])
