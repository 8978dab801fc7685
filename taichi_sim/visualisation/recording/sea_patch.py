"""The piece of sea that follows a team, east-north-up.

It is a square of cells, finer ones in its middle around the vehicles, and two rings to the horizon: in the first one
the waves fade out, the second one is flat. The grid keeps to whole cells of the world, so that its points do not swim.
The squares are the simulated sea; the rings around them are not. The patch takes most of a recording's bytes, so a
point is sent again only when its error would be visible: when its height is off by more than a tolerance that grows
with the distance from the boats, or its colour by more than a few levels. The whole patch is checked a few times a
second; in between only the water around each hull is checked. Light is baked into the colours of its points, which fade
towards the horizon.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import HORIZONTAL
from taichi_sim.visualisation.recording.episode import Array, Episode, TeamTrack
from taichi_sim.visualisation.recording.rerun_stream import Stream

CELLS, CELLS_ALOFT = 20, 40  # coarse cells per side, around boats and below aircraft
MIN_HALF_M = 30.0  # half the side of the smallest patch
MAX_HALF_M = 160.0
FINE_CELLS = 32  # largest number of finer cells per side; at least two fit into a coarse one
FINE_LENGTHS, FINE_HALF_M = 0.5, 9.0  # margin of the finer square around the formation; its least half side
FINE_SHARE = 0.5  # side of a finer cell over a vehicle's length, if FINE_CELLS allows
FADE = 1.6  # outer radius of the first ring over half a side of the square
RINGS = 2
LEVEL = 4.0  # colours (0 to 255) are rounded to this, so that the file compresses well
FADE_SHARE = 0.15  # width of the border in which the light of the waves fades, over the side
SUN_ENU = np.array([-0.45, -0.35, 0.82]) / np.linalg.norm([-0.45, -0.35, 0.82])
DEEP = np.array([12.0, 62.0, 92.0])
CREST = np.array([58.0, 142.0, 158.0])
FOAM = np.array([222.0, 234.0, 236.0])
HAZE = np.array([168.0, 196.0, 214.0])  # the horizon, and the sky behind it
FRAME_S = 0.1  # interval of the water around a hull: a hull heaves by half its draft in 0.2 s
ALOFT_S = 0.4  # interval of a patch without boats, where nothing rides on the waves
INSIDE = 0.8  # a vehicle within this fraction of a patch's half side is on the patch
HULL_LENGTHS = 1.25  # boat lengths within which the water counts as around the hull, and has no tolerance
MAX_FRAMES = 1200  # longer episodes have fewer frames per second
HORIZON_M = 4000.0  # least half side of the outer ring
BATCH = 150  # frames sent at a time
ROUND_M = 1.0 / 64.0  # heights are rounded to this, so that the file compresses well
OFF, OFF_CRESTS = 0.025, 0.35  # tolerance of heights over the distance to the nearest hull; at most, over a tall crest
OFF_SHADE = 10.0  # tolerance of colours, of 255
SLACK = 1.0  # cells that a team may leave the centre before the patch moves, which sends every point again


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


def light(up: Array, cell: float, scale: float) -> Array:
    """Colours [side, side, 3] of elevations `up` [north, east], m; `scale` is a tall crest's height, m."""
    slope_n, slope_e = np.gradient(up, cell)
    normal = np.stack([-slope_e, -slope_n, np.ones_like(up)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    diffuse = np.clip(normal @ SUN_ENU, 0.0, 1.0) / SUN_ENU[2]
    height = np.clip(0.5 + 0.5 * up / scale, 0.0, 1.0)[..., None]
    colour = (DEEP + height * (CREST - DEEP)) * (0.2 + 0.8 * diffuse[..., None] ** 3)
    foam = np.clip(up / scale - 0.85, 0.0, 0.3)[..., None] / 0.3
    return colour + 0.6 * foam * (FOAM - colour)


def patch_colours(grid: SeaGrid, lights: list[Array]) -> Array:
    """Colours [N, 3] of the patch's points, in order, from the `lights` of its squares; they fade at the border."""
    flat = 0.5 * (DEEP + CREST)
    inside = np.minimum(np.arange(grid.cells + 1), np.arange(grid.cells, -1, -1)) / (FADE_SHARE * grid.cells)
    fade = np.clip(np.minimum(inside[:, None], inside), 0.0, 1.0)[..., None]
    coarse = flat + fade * (lights[0] - flat)
    fine = [one.reshape(-1, 3) for one in lights[1:]]
    rings = [np.broadcast_to(shade, (len(grid.rim), 3)) for shade in (flat, HAZE)]
    waves = np.concatenate([coarse.reshape(-1, 3)[grid.shown], *fine])
    return np.concatenate([flat + np.round((waves - flat) / LEVEL) * LEVEL, *rings])


class Cadence(NamedTuple):
    """The steps that have a frame: every `stride`-th; every `whole`-th frame updates the whole patch."""

    stride: int
    whole: int

    @classmethod
    def of(cls, time: Array, seconds: float = FRAME_S, most: int | None = None) -> "Cadence":
        """A frame about every `seconds` of the clock `time` [T] (s), but not more than `most` frames."""
        step = float(np.median(np.diff(time))) if len(time) > 1 else seconds
        stride = max(1, round(seconds / step), 1 if most is None else -(-len(time) // most))
        return cls(stride, 2 if stride * step < 0.75 * ALOFT_S else 1)

    def steps(self, stream: Stream) -> NDArray[np.int64]:
        """Steps of the part that have a frame."""
        return np.arange(-stream.first % self.stride, len(stream.ns), self.stride)

    def is_whole(self, stream: Stream, step: int) -> bool:
        """Whether the frame at `step` of the part is a whole one."""
        return (stream.first + step) // self.stride % self.whole == 0


@dataclass(frozen=True)
class SeaFrames:
    """Consecutive frames of the patch."""

    index: NDArray[np.int64]  # [F] step of each frame
    origin_enu: NDArray[np.float32]  # [F, 3] m, the patch's origin, on whole cells, far below
    vertices: NDArray[np.float32]  # [F, N, 3] m, east, north, up from the origin
    colours: NDArray[np.uint8]  # [F, N, 3]


def rounded(up: Array) -> Array:
    """Heights (m), rounded to ROUND_M."""
    return np.round(up / ROUND_M) * ROUND_M


def bias(height: float) -> float:
    """Offset (m) that is added to heights up to `height` (m).

    As float32 their sums differ in the last bytes only, which compresses better.
    """
    return 1.5 * 2.0 ** float(np.ceil(np.log2(4.0 * height)))


def patch_of(episode: Episode) -> dict[str, str]:
    """For each team, the name of the team whose patch of sea its view shows.

    Boats that leave the patches of the teams before them have their own; aircraft see the patch of the first boats.
    """
    patches: dict[str, str] = {}
    leads = episode.afloat.name
    for team in sorted(episode.teams.values(), key=lambda team: team.name != leads):
        around = (lead for lead in dict.fromkeys(patches.values()) if _stays_on_patch(team, episode.teams[lead]))
        patches[team.name] = next(around, team.name) if team.on_water else leads
    return patches


def _stays_on_patch(team: TeamTrack, lead: TeamTrack) -> bool:
    """Whether the first vehicle of `team` stays within the patch of `lead`."""
    away = np.abs(team.position_n[:, 0, :2] - _middle(lead)).max()
    return bool(away <= INSIDE * SeaGrid.of(lead).half_m)


def _middle(team: TeamTrack) -> Array:
    """Centre [T, 2] (north, east, m) between the first vehicle and the middle of all: followers usually trail."""
    places = team.places_n[:, team.company]
    middle = team.position_n[:, 0] + 0.5 * (places.mean(axis=1) - places[:, 0])
    return np.asarray(middle[:, HORIZONTAL], dtype=np.float64)


class SeaPatch:
    """The patch that follows a team, as it was drawn last."""

    def __init__(self, episode: Episode, team: TeamTrack) -> None:
        """Make the patch of the team `team` of an episode, or of its first part."""
        self.grid = grid = SeaGrid.of(episode.whole.teams[team.name])
        self.cadence = Cadence.of(episode.whole.time_s, FRAME_S if team.on_water else ALOFT_S, MAX_FRAMES)
        crest = _crest(episode, grid, episode.time_s[:: self.cadence.stride][:8])
        self._squares = [_Square(grid.coarse_line, crest, min(grid.parts, 2))]
        if grid.parts > 1:
            self._squares.append(_Square(grid.fine_line, crest, 1))
        self._far = max(2.0 * (episode.scene.area_m or 0.0), HORIZON_M) / grid.half_m
        self._bias = bias(crest)
        self._centre = np.full(2, np.nan)  # north, east, m; NaN before the first frame

    def frames(self, stream: Stream, episode: Episode, team: TeamTrack) -> Iterator[SeaFrames]:
        """Frames of the stream's part of the episode, in batches."""
        steps, middle = self.cadence.steps(stream), _middle(team)
        for start in range(0, len(steps), BATCH):
            index = steps[start : start + BATCH]
            vertices, colours, origin = [], [], []
            for step in index:
                whole = bool(np.isnan(self._centre[0])) or self.cadence.is_whole(stream, int(step))
                moved = whole and self._follow(middle[step])
                boats = np.array([  # north, east, length, m
                    (*place[:2], one.size_m[0])
                    for one in episode.teams.values() if one.on_water for place in one.position_n[step]
                ])  # fmt: skip
                for square in self._squares:
                    square.draw(episode, int(step), self._centre, boats, whole=whole, anew=moved)
                vertices.append(self._vertices())
                colours.append(patch_colours(self.grid, [square.light for square in self._squares]))
                origin.append((self._centre[1], self._centre[0], -self._bias))
            shades = np.clip(np.stack(colours), 0.0, 255.0).astype(np.uint8)
            yield SeaFrames(index, np.array(origin, np.float32), np.stack(vertices).astype(np.float32), shades)

    def _follow(self, middle: Array) -> bool:
        """Move the centre if the team's `middle` (north, east, m) has left it; return whether it moved.

        The new centre is ahead of the team, so that it rarely moves.
        """
        cell, old = self.grid.cell, self._centre
        begins, away = np.isnan(old), np.nan_to_num(middle - old)
        ahead = np.round((middle + np.sign(away) * SLACK * cell) / cell) * cell
        self._centre = np.where(begins | (np.abs(away) > SLACK * cell), ahead, old)
        return bool(np.any(self._centre != old))

    def _vertices(self) -> Array:
        """Points [N, 3] (m) in the order of the grid's triangles."""
        coarse, *fine = (square.points(self._bias) for square in self._squares)
        rings = [
            np.column_stack([coarse[self.grid.rim, :2] * share, np.full(len(self.grid.rim), self._bias)])
            for share in (FADE, self._far)
        ]
        return np.concatenate([coarse[self.grid.shown], *fine, *rings])


class _Square:
    """The water on the points of one square, as it was drawn last."""

    def __init__(self, line: Array, crest: float, between: int) -> None:
        """Make an empty square. `crest` is a tall crest's height, m; slopes are taken over 2 / `between` cells."""
        self.crest, self.between = crest, between
        self.line = np.linspace(line[0], line[-1], between * (len(line) - 1) + 1)
        self.north, self.east = np.meshgrid(line, line, indexing="ij")
        self.up, self.light = np.zeros_like(self.north), np.zeros((*self.north.shape, 3))

    def draw(self, episode: Episode, step: int, centre: Array, boats: Array, *, whole: bool, anew: bool) -> None:
        """Update heights (m) and colours at `step`, with the square centred at `centre` (north, east, m) among `boats`
        [B, 3].

        Unless `whole`, only the water around hulls is checked. With `anew` every point is drawn again.
        """
        time = float(episode.time_s[step])
        off = self._off(centre, boats)
        if not whole:
            at = off == 0.0
            if at.any():
                up = episode.elevation(self.north[at] + centre[0], self.east[at] + centre[1], time)
                self.up[at] = rounded(np.asarray(up, np.float64))
            return
        north, east = np.meshgrid(self.line + centre[0], self.line + centre[1], indexing="ij")
        up = np.asarray(episode.elevation(north, east, time), dtype=np.float64)
        shade = light(up, self.line[1] - self.line[0], self.crest)[:: self.between, :: self.between]
        up = rounded(up[:: self.between, :: self.between])
        self.up = np.where(anew | (np.abs(up - self.up) > off), up, self.up)
        changed = anew | (np.abs(shade - self.light).max(axis=-1) > OFF_SHADE)
        self.light = np.where(changed[..., None], shade, self.light)

    def _off(self, centre: Array, boats: Array) -> Array:
        """Changes of height [side, side] (m) up to which points stay as drawn; 0 at a hull."""
        most = OFF_CRESTS * self.crest
        if not len(boats):
            return np.full(self.north.shape, most)
        n, e, length = np.moveaxis(boats[:, None, None], -1, 0)
        away = np.hypot(self.north + centre[0] - n, self.east + centre[1] - e) - HULL_LENGTHS * length
        return np.clip(OFF * away.min(axis=0), 0.0, most)

    def points(self, bias: float) -> Array:
        """Points [N, 3] (m), east, north and up from the centre, `bias` below mean sea level."""
        return np.stack([self.east, self.north, self.up + bias], axis=-1).reshape(-1, 3)


def _crest(episode: Episode, grid: SeaGrid, times: Array) -> float:
    """Height (m) of a tall crest at the first `times`."""
    north, east = np.meshgrid(grid.coarse_line, grid.coarse_line, indexing="ij")
    heights = np.abs(np.stack([episode.elevation(north, east, float(t)) for t in times]))
    return max(float(np.quantile(heights, 0.99)), 0.15)
