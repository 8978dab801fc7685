"""The piece of sea that follows the formation, east-north-up, with the light baked into its colours.

A square of `CELLS` x `CELLS` cells, its grid held to whole cells of the world so that its points do not
swim, and around it two rings that carry its border out to the horizon: the first lets the waves fade,
the second is flat. Only the square is the simulated sea.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.recording.episode import Array, Episode

CELLS = 40  # per side
MIN_HALF_M = 30.0  # half the side of the smallest patch
MAX_HALF_M = 160.0
FADE = 1.6  # the first ring, in half sides
FRAME_S = 0.2  # one sea frame this often
BATCH = 50  # frames sent at a time
ROUND_M = 1.0 / 64.0  # heights are rounded to this, so that the file packs well

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


def cell_size(episode: Episode) -> float:
    """Side of a cell, m: the patch holds the formation with room to spare."""
    half = np.clip(0.75 * episode.afloat.formation_radius_m + 16.0, MIN_HALF_M, MAX_HALF_M)
    return float(np.ceil(2.0 * 2.0 * half / CELLS) / 2.0)


def sea_triangles() -> NDArray[np.uint32]:
    """[N, 3] corners, patch and rings. The grid's points come first, row by row from the south."""
    side = CELLS + 1
    corner = (np.arange(CELLS)[:, None] * side + np.arange(CELLS)).ravel()
    cells = [(corner, corner + 1, corner + side + 1), (corner, corner + side + 1, corner + side)]
    rim = _rim()
    inner = rim
    for ring in range(2):
        outer = side * side + ring * len(rim) + np.arange(len(rim))
        cells += [(inner, np.roll(inner, -1), np.roll(outer, -1)), (inner, np.roll(outer, -1), outer)]
        inner = outer
    return np.concatenate([np.stack(cell, axis=1) for cell in cells]).astype(np.uint32)


def _rim() -> NDArray[np.int64]:
    """Indices of the grid's border points, once around."""
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


def sea_frames(episode: Episode) -> Iterator[SeaFrames]:
    """The patch over the episode, in batches."""
    time = np.asarray(episode.time_s, dtype=np.float64)
    # midway between the leader and the middle of the slots, for the followers mostly trail
    team = episode.afloat
    middle = team.position_n[:, 0] + 0.5 * (team.slot_n.mean(axis=1) - team.slot_n[:, 0])
    step = float(np.median(np.diff(time))) if len(time) > 1 else FRAME_S
    steps = np.arange(0, len(time), max(1, round(FRAME_S / step)))
    cell = cell_size(episode)
    line = cell * (np.arange(CELLS + 1) - CELLS / 2)
    north, east = np.meshgrid(line, line, indexing="ij")
    rim = _rim()
    far = max(2.0 * episode.scene.area_m, 4000.0) / (0.5 * CELLS * cell)
    heights = np.abs(np.stack([episode.elevation(north, east, float(t)) for t in time[steps[:8]]]))
    scale = max(float(np.quantile(heights, 0.99)), 0.15)
    flat = DEEP + 0.5 * (CREST - DEEP)
    for start in range(0, len(steps), BATCH):
        index = steps[start : start + BATCH]
        centre = np.round(middle[index, :2] / cell) * cell
        vertices = np.empty((len(index), (CELLS + 1) ** 2 + 2 * len(rim), 3), np.float32)
        colours = np.empty(vertices.shape, np.uint8)
        for frame, (place, now) in enumerate(zip(centre, time[index], strict=True)):
            up = np.asarray(episode.elevation(north + place[0], east + place[1], float(now)))
            up = np.round(up.astype(np.float64) / ROUND_M) * ROUND_M
            patch = np.stack([east, north, up], axis=-1).reshape(-1, 3)
            light = _light(up, cell, scale).reshape(-1, 3)
            border = patch[rim]
            vertices[frame] = np.concatenate([patch, border * (FADE, FADE, 0.0), border * (far, far, 0.0)])
            haze = [np.broadcast_to(shade, border.shape) for shade in (flat, HAZE)]
            colours[frame] = np.clip(np.concatenate([light, *haze]), 0.0, 255.0).astype(np.uint8)
        origin = np.stack([centre[:, 1], centre[:, 0], np.zeros(len(index))], axis=1).astype(np.float32)
        yield SeaFrames(index, origin, vertices, colours)
