"""The piece of sea that follows a team, east-north-up, with the light baked into its colours.

Its grid (sea_grid.py) is held to whole cells of the world so that its points do not swim. Only the squares are the
simulated sea, not the rings around them. Most of a recording's bytes are here, so the whole patch moves with the waves
a few times a second, and in between only the water about each hull does.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.recording.episode import Array, Episode, TeamTrack
from taichi_sim.recording.sea_grid import FADE, SeaGrid

FRAME_S = 0.1  # the water about a hull moves this often: a hull heaves by half its draft in 0.2 s
WHOLE_S = 0.2  # the rest of it
ALOFT_S = 0.4  # all of it where there are no boats: nothing rides on the waves
INSIDE = 0.8  # of half its side: who stays within this much of a patch is on it
HULL_LENGTHS = 1.25  # how far from a boat the water is about its hull
MAX_FRAMES = 1200  # fewer per second in a longer episode
HORIZON_M = 4000.0  # half the side of the outer ring, at least
BATCH = 50  # frames sent at a time
ROUND_M, LEVEL = 1.0 / 64.0, 4.0  # heights and colours (of 255) are rounded to these, so that the file packs well
FADE_SHARE = 0.15  # of the side, inside the border: the light of the waves fades there

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


def frame_steps(time: Array, seconds: float = FRAME_S, most: int | None = None) -> tuple[NDArray[np.int64], int]:
    """Steps that have a frame, about every `seconds`, out of the clock `time` [T] (s); and which frames are whole.

    At `most` so many frames; every n-th, where all that is water moves, is whole: n is the second value.
    """
    step = float(np.median(np.diff(time))) if len(time) > 1 else seconds
    stride = max(1, round(seconds / step), 1 if most is None else -(-len(time) // most))
    return np.arange(0, len(time), stride), max(1, round(WHOLE_S / (stride * step)))


def patch_of(episode: Episode) -> dict[str, str]:
    """Team -> the team whose patch of sea its view shows.

    Boats that leave the patches of the teams before them have their own; aircraft see that of the first boats.
    """
    patches: dict[str, str] = {}
    leads = episode.afloat.name
    for team in sorted(episode.teams.values(), key=lambda team: team.name != leads):
        around = (lead for lead in dict.fromkeys(patches.values()) if _stays_on_patch(team, episode.teams[lead]))
        patches[team.name] = next(around, team.name) if team.on_water else leads
    return patches


def _stays_on_patch(team: TeamTrack, lead: TeamTrack) -> bool:
    """Whether the first of `team` is all the time within the patch of `lead`."""
    grid = SeaGrid.of(lead)
    away = np.abs(team.position_n[:, 0, :2] - _centres(lead, grid)).max()
    return bool(away <= INSIDE * grid.half_m)


def sea_frames(episode: Episode, team: TeamTrack, grid: SeaGrid) -> Iterator[SeaFrames]:
    """The patch that follows `team` over the episode, in batches."""
    time = np.asarray(episode.time_s, dtype=np.float64)
    steps, stride = frame_steps(time, FRAME_S if team.on_water else ALOFT_S, MAX_FRAMES)
    whole = np.arange(len(steps)) // stride * stride  # the frame in which all of the patch was moved
    centres = _centres(team, grid)[steps[whole]]
    crest = _crest(episode, grid, time[steps[:8]])
    squares = [_Square(episode, grid.coarse_line, crest, min(grid.parts, 2))]
    if grid.parts > 1:
        squares.append(_Square(episode, grid.fine_line, crest, 1))
    for start in range(0, len(steps), BATCH):
        frames = np.arange(start, min(start + BATCH, len(steps)))
        vertices, colours = [], []
        for frame in frames:
            for square in squares:
                square.move(centres[frame], int(steps[frame]), everywhere=bool(whole[frame] == frame))
            vertices.append(_vertices(episode, grid, squares))
            colours.append(_colours(grid, squares))
        origin = np.column_stack([centres[frames, 1], centres[frames, 0], np.zeros(len(frames))])
        shades = np.clip(np.stack(colours), 0.0, 255.0).astype(np.uint8)
        yield SeaFrames(steps[frames], origin.astype(np.float32), np.stack(vertices).astype(np.float32), shades)


class _Square:
    """The water on the points of one square, as it was last drawn."""

    def __init__(self, episode: Episode, line: Array, crest: float, between: int) -> None:
        """Wait for the first move.

        `crest` is a tall crest's height, m; slopes are taken over 2 / `between` cells.
        """
        self.episode, self.crest, self.between = episode, crest, between
        self.line = np.linspace(line[0], line[-1], between * (len(line) - 1) + 1)
        self.north, self.east = np.meshgrid(line, line, indexing="ij")
        self.up, self.light = np.zeros_like(self.north), np.zeros((*self.north.shape, 3))

    def move(self, centre: Array, step: int, *, everywhere: bool) -> None:
        """Heights (m) and light at `step` with the square about `centre` (north, east, m)."""
        north, east = np.meshgrid(self.line + centre[0], self.line + centre[1], indexing="ij")
        up = np.asarray(self.episode.elevation(north, east, float(self.episode.time_s[step])), dtype=np.float64)
        light = _light(up, self.line[1] - self.line[0], self.crest)
        up, light = up[:: self.between, :: self.between], light[:: self.between, :: self.between]
        moves = np.full(up.shape, everywhere)
        if not everywhere:
            for team in self.episode.teams.values():
                for n, e in team.position_n[step, :, :2] - centre if team.on_water else ():
                    moves |= np.hypot(self.north - n, self.east - e) < HULL_LENGTHS * team.size_m[0]
        self.up = np.where(moves, np.round(up / ROUND_M) * ROUND_M, self.up)
        self.light = np.where(moves[..., None], light, self.light)

    def points(self, up: Array) -> Array:
        """[N, 3] m, east, north and `up` [side, side] from the centre."""
        return np.stack([self.east, self.north, up], axis=-1).reshape(-1, 3)


def _vertices(episode: Episode, grid: SeaGrid, squares: list[_Square]) -> Array:
    """[N, 3] m, in the order of the grid's triangles."""
    coarse = squares[0].points(squares[0].up)
    fine = [square.points(square.up) for square in squares[1:]]
    far = max(2.0 * (episode.scene.area_m or 0.0), HORIZON_M) / grid.half_m
    rings = [coarse[grid.rim] * (share, share, 0.0) for share in (FADE, far)]
    return np.concatenate([coarse[grid.shown], *fine, *rings])


def _colours(grid: SeaGrid, squares: list[_Square]) -> Array:
    """[N, 3] likewise: the light of the waves fades towards the border."""
    flat = 0.5 * (DEEP + CREST)
    inside = np.minimum(np.arange(grid.cells + 1), np.arange(grid.cells, -1, -1)) / (FADE_SHARE * grid.cells)
    fade = np.clip(np.minimum(inside[:, None], inside), 0.0, 1.0)[..., None]
    coarse = flat + fade * (squares[0].light - flat)
    fine = [square.light.reshape(-1, 3) for square in squares[1:]]
    rings = [np.broadcast_to(shade, (len(grid.rim), 3)) for shade in (flat, HAZE)]
    waves = np.concatenate([coarse.reshape(-1, 3)[grid.shown], *fine])
    return np.concatenate([flat + np.round((waves - flat) / LEVEL) * LEVEL, *rings])


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


def _centres(team: TeamTrack, grid: SeaGrid) -> Array:
    """[T, 2] north, east (m) on whole cells, between the first and the middle of all: followers mostly trail."""
    places = team.places_n[:, team.company]
    middle = team.position_n[:, 0] + 0.5 * (places.mean(axis=1) - places[:, 0])
    return np.round(np.asarray(middle[:, :2], dtype=np.float64) / grid.cell) * grid.cell


def _crest(episode: Episode, grid: SeaGrid, times: Array) -> float:
    """Height (m) of a tall crest at the first `times`."""
    north, east = np.meshgrid(grid.coarse_line, grid.coarse_line, indexing="ij")
    heights = np.abs(np.stack([episode.elevation(north, east, float(t)) for t in times]))
    return max(float(np.quantile(heights, 0.99)), 0.15)
