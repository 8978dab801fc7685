"""The piece of sea that follows the formation, east-north-up, with the light baked into its colours.

A square of `CELLS` x `CELLS` cells, its grid held to whole cells of the world so that its points do not
swim; in its middle, where the vehicles are, a finer square, whose border keeps to the coarse edges so that
no gap opens; and around both two rings that carry the border out to the horizon: the first lets the waves
fade, the second is flat. Only the squares are the simulated sea.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.recording.episode import Array, Episode

CELLS = 40  # per side
MIN_HALF_M = 30.0  # half the side of the smallest patch
MAX_HALF_M = 160.0
FINE_CELLS = 48  # per side of the finer square, at most
FINE_LENGTHS = 3.0  # the finer square reaches this many vehicle lengths beyond the formation
FINE_SHARE = 0.2  # of a vehicle's length: a finer cell's side, where the cells last
FADE = 1.6  # the first ring, in half sides
FADE_CELLS = 6  # inside the border the light of the waves fades over these
FRAME_S = 0.1  # one sea frame this often: a hull heaves by half its draft in 0.2 s
ALOFT_FRAME_S = 0.4  # the same where there are no boats: nothing rides on the waves
MAX_FRAMES = 1200  # fewer per second in a longer episode, for a frame takes up to 50 kB
BATCH = 50  # frames sent at a time
ROUND_M = 1.0 / 128.0  # heights are rounded to this, so that the file packs well

SUN_ENU = np.array([-0.45, -0.35, 0.82]) / np.linalg.norm([-0.45, -0.35, 0.82])
DEEP = np.array([12.0, 62.0, 92.0])
CREST = np.array([58.0, 142.0, 158.0])
FOAM = np.array([222.0, 234.0, 236.0])
HAZE = np.array([168.0, 196.0, 214.0])  # the horizon, and the sky behind it


@dataclass(frozen=True)
class SeaFrames:
    """Some frames of the patch."""

    index: NDArray[np.int64]  # [F] step of each frame
    origin_enu: NDArray[np.float32]  # [F, 3] m, centre of the patch, on whole cells
    vertices: NDArray[np.float32]  # [F, N, 3] m, east, north, up from the centre
    colours: NDArray[np.uint8]  # [F, N, 3]


@dataclass(frozen=True)
class SeaGrid:
    """The patch's cells: those of the coarse square, and the finer ones that take the place of its middle."""

    cell: float  # m, side of a coarse cell
    middle: int  # coarse cells per side that are replaced; even, so that the centre is a point of both
    parts: int  # finer cells along a coarse one; 1: nothing is replaced

    @classmethod
    def of(cls, episode: Episode) -> "SeaGrid":
        """Cells that hold the formation with room to spare, and resolve the waves along a hull where they can."""
        team = episode.afloat
        aloft = not team.on_water
        height = -float(np.median(team.places_n[:, 0, 2])) if aloft else 0.0  # from where it is seen
        half = np.clip(0.75 * team.formation_radius_m + 16.0 + height, MIN_HALF_M, MAX_HALF_M)
        cell = float(np.ceil(2.0 * 2.0 * half / CELLS) / 2.0)
        reach = team.formation_radius_m + FINE_LENGTHS * team.size_m[0]
        middle = min(2 * int(np.ceil(reach / cell)), CELLS - 4)
        wanted = int(np.ceil(cell / (FINE_SHARE * team.size_m[0])))
        return cls(cell, middle, 1 if aloft else max(1, min(wanted, FINE_CELLS // middle)))

    @property
    def coarse_line(self) -> Array:
        """Coordinates [CELLS + 1] from the centre, m."""
        return self.cell * (np.arange(CELLS + 1) - CELLS / 2)

    @property
    def fine_line(self) -> Array:
        """Coordinates of the finer points, m; none if nothing is replaced."""
        count = self.middle * self.parts
        return self.cell / self.parts * (np.arange(count + 1) - count / 2) if self.parts > 1 else np.zeros(0)

    def triangles(self) -> NDArray[np.uint32]:
        """[N, 3] corners. Coarse points come first, row by row from the south, then the finer ones, then the rings."""
        first, fine = (CELLS + 1) ** 2, len(self.fine_line)
        outside = np.ones((CELLS, CELLS), dtype=bool)
        if fine:
            edge = (CELLS - self.middle) // 2
            outside[edge : CELLS - edge, edge : CELLS - edge] = False
        cells = [_cells(CELLS)[np.tile(outside.ravel(), 2)]]
        if fine:
            cells.append(first + _cells(fine - 1))
        inner = _rim()
        for ring in range(2):
            outer = first + fine**2 + ring * len(_rim()) + np.arange(len(_rim()))
            after = np.roll(inner, -1), np.roll(outer, -1)
            cells += [np.stack([inner, after[0], after[1]], axis=1), np.stack([inner, after[1], outer], axis=1)]
            inner = outer
        return np.concatenate(cells).astype(np.uint32)

    def keep_to_edges(self, up: Array) -> Array:
        """Heights `up` [finer points] with its border straight between coarse points."""
        at, corners = np.arange(len(up)), np.arange(0, len(up), self.parts)
        up = up.copy()
        for side in (up[0], up[-1], up[:, 0], up[:, -1]):  # views
            side[:] = np.interp(at, corners, side[corners])
        return up


def _cells(count: int) -> NDArray[np.int64]:
    """Triangles [2 count^2, 3] of a square of cells: all the lower ones, then all the upper ones."""
    side = count + 1
    corner = (np.arange(count)[:, None] * side + np.arange(count)).ravel()
    lower, upper = (corner, corner + 1, corner + side + 1), (corner, corner + side + 1, corner + side)
    return np.concatenate([np.stack(lower, axis=1), np.stack(upper, axis=1)])


def _rim() -> NDArray[np.int64]:
    """Indices of the coarse grid's border points, once around."""
    index = np.arange((CELLS + 1) ** 2).reshape(CELLS + 1, CELLS + 1)
    return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])


def _light(up: Array, cell: float, scale: float) -> Array:
    """Colours [side, side, 3] of elevations `up` [north, east], m; `scale` is a tall crest's height, m."""
    slope_n, slope_e = np.gradient(up, cell)
    normal = np.stack([-slope_e, -slope_n, np.ones_like(up)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    diffuse = np.clip(normal @ SUN_ENU, 0.0, 1.0) / SUN_ENU[2]
    height = np.clip(0.5 + 0.5 * up / scale, 0.0, 1.0)[..., None]
    colour = (DEEP + height * (CREST - DEEP)) * (0.2 + 0.8 * diffuse[..., None] ** 3)
    foam = np.clip(up / scale - 0.85, 0.0, 0.3)[..., None] / 0.3
    return colour + 0.6 * foam * (FOAM - colour)


def sea_frames(episode: Episode, grid: SeaGrid) -> Iterator[SeaFrames]:
    """The patch over the episode, in batches."""
    time = np.asarray(episode.time_s, dtype=np.float64)
    steps = frame_steps(time, FRAME_S if episode.afloat.on_water else ALOFT_FRAME_S)
    centres = _centres(episode, grid)
    squares = [line for line in (grid.coarse_line, grid.fine_line) if len(line)]
    scale = _crest(episode, grid, time[steps[:8]])
    rim = _rim()
    far = max(2.0 * (episode.scene.area_m or 0.0), 4000.0) / (0.5 * CELLS * grid.cell)
    flat = DEEP + 0.5 * (CREST - DEEP)
    fade = _fade()[:, None]
    haze = [np.broadcast_to(shade, (len(rim), 3)) for shade in (flat, HAZE)]
    for start in range(0, len(steps), BATCH):
        index = steps[start : start + BATCH]
        vertices, colours = [], []
        for place, now in zip(centres[index], time[index], strict=True):
            points, shades = [], []
            for line in squares:
                square, light = _square(episode, grid, line, place, float(now), scale)
                points.append(square)
                shades.append(light)
            shades[0] = flat + fade * (shades[0] - flat)
            border = points[0][rim]
            vertices.append(np.concatenate([*points, border * (FADE, FADE, 0.0), border * (far, far, 0.0)]))
            colours.append(np.concatenate([*shades, *haze]))
        origin = np.column_stack([centres[index, 1], centres[index, 0], np.zeros(len(index))])
        shades = np.clip(np.stack(colours), 0.0, 255.0).astype(np.uint8)
        yield SeaFrames(index, origin.astype(np.float32), np.stack(vertices).astype(np.float32), shades)


def _fade() -> Array:
    """[(CELLS + 1)^2] from 0 at the border of the coarse square to 1 a few cells inside: how much light shows there."""
    inside = np.minimum(np.arange(CELLS + 1), np.arange(CELLS, -1, -1)) / FADE_CELLS
    return np.clip(np.minimum(inside[:, None], inside), 0.0, 1.0).ravel()


def frame_steps(time: Array, frame_s: float = FRAME_S) -> NDArray[np.int64]:
    """Steps that have a frame of the sea, about every `frame_s`, out of the clock `time` [T], s."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else frame_s
    return np.arange(0, len(time), max(1, round(frame_s / step), -(-len(time) // MAX_FRAMES)))


def _centres(episode: Episode, grid: SeaGrid) -> Array:
    """[T, 2] north, east (m) on whole cells, between the first and the middle of all: followers mostly trail."""
    team = episode.afloat
    places = team.places_n[:, team.company]
    middle = team.position_n[:, 0] + 0.5 * (places.mean(axis=1) - places[:, 0])
    return np.round(np.asarray(middle[:, :2], dtype=np.float64) / grid.cell) * grid.cell


def _crest(episode: Episode, grid: SeaGrid, times: Array) -> float:
    """Height (m) of a tall crest at the first `times`."""
    north, east = np.meshgrid(grid.coarse_line, grid.coarse_line, indexing="ij")
    heights = np.abs(np.stack([episode.elevation(north, east, float(t)) for t in times]))
    return max(float(np.quantile(heights, 0.99)), 0.15)


def _square(
    episode: Episode, grid: SeaGrid, line: Array, place: Array, time: float, scale: float
) -> tuple[Array, Array]:
    """Points [N, 3] (east, north, up, m, from the centre) and colours of the square of `line` about `place`."""
    north, east = np.meshgrid(line, line, indexing="ij")
    up = np.asarray(episode.elevation(north + place[0], east + place[1], time), dtype=np.float64)
    up = np.round(up / ROUND_M) * ROUND_M
    light = _light(up, line[1] - line[0], scale)
    if len(line) == len(grid.fine_line):
        up = grid.keep_to_edges(up)
    return np.stack([east, north, up], axis=-1).reshape(-1, 3), light.reshape(-1, 3)
