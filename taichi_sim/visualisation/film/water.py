"""The sea as a grid of points that are evenly spaced on the screen, from the horizon to the picture's lower edge.

A grid point labels a particle on the mean level, where a pixel's ray meets it. Gerstner waves
(taichi_sim/surroundings/sea/gerstner.py) move it from there, so that nothing needs inversion. Waves that are too short
for the spacing of neighbouring points are
left out: below about four points per wave, a component fades and adds to `rough`, the mean square slope of everything
left out. Positions are relative to the eye; phases at the eye are computed in f64.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportAttributeAccessIssue=false

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from taichi_sim.kernels import fast_maths
from taichi_sim.kernels.conventions import DOWN, EAST, GRAVITY, NORTH
from taichi_sim.visualisation.film.camera import Array, FilmCamera
from taichi_sim.visualisation.film.moment import Moment

CELL_PX = (5.0, 4.0)  # spacing across and down, px
FARTHEST_M = 12000.0
RESOLVED, GONE = 1.1, 2.2  # rad of phase between points, below which a wave is whole, and above which it is left out
POINT, NORMAL, CREST = slice(0, 3), slice(3, 6), 7  # columns of a point
COLUMNS = 8  # of a point: position 3 (m from the eye, n), normal 3, rough, height over that of a tall crest
MARGIN_PX = 2.0
CALM_M = 0.15  # crests lower than this are not tall
RIPPLES, RIPPLE_M, RIPPLE_SLOPE = 9, (0.5, 2.2), 0.022  # number, range of lengths (m), slope of each
A, KX, KY, PHASE, BX, BY = range(6)


class Water(NamedTuple):
    """A grid of points [rows * across, COLUMNS]."""

    points: NDArray[np.float32]
    across: int

    @property
    def rows(self) -> int:
        """Number of lines of points."""
        return len(self.points) // self.across


NO_WATER = Water(np.zeros((0, COLUMNS), np.float32), 1)


@ti.kernel
def _place(
    out: ti.types.ndarray(dtype=ti.f32, ndim=2), columns: ti.types.ndarray(dtype=ti.f32, ndim=1),
    rows: ti.types.ndarray(dtype=ti.f32, ndim=1), rays: ti.types.ndarray(dtype=ti.f32, ndim=2),
    waves: ti.types.ndarray(dtype=ti.f32, ndim=2), height: ti.f32, crest: ti.f32,
):  # fmt: skip
    """Write the sea where the rays meet it to `out` [row * column, COLUMNS].

    The ray through column x and row y (px) is rays[2] + x rays[0] + y rays[1]. The eye has the `height` (m) above mean
    sea level; `crest` (m) is the height of a tall crest.
    """
    across = columns.shape[0]
    right = ti.Vector([rays[0, 0], rays[0, 1], rays[0, 2]])
    down = ti.Vector([rays[1, 0], rays[1, 1], rays[1, 2]])
    ahead = ti.Vector([rays[2, 0], rays[2, 1], rays[2, 2]])
    for i in range(rows.shape[0] * across):
        r, c = i // across, i % across
        x, y = columns[c], rows[r]
        ray = ahead + x * right + y * down
        t = height / ray[2]
        place = t * ray
        # steps to the neighbours, m: along the level, so that the ray's length changes with its slope
        next_r, next_c = ti.min(r + 1, rows.shape[0] - 1), ti.min(c + 1, across - 1)
        dy = rows[next_r] - rows[ti.max(next_r - 1, 0)]
        dx = columns[next_c] - columns[ti.max(next_c - 1, 0)]
        to_right = dx * t * (right - ray * (right[2] / ray[2]))
        to_down = dy * t * (down - ray * (down[2] / ray[2]))
        zeta, sx, sy, zx, zy = 0.0, 0.0, 0.0, 0.0, 0.0
        jxx, jxy, jyy, rough = 1.0, 0.0, 1.0, 0.0
        for k in range(waves.shape[1]):
            kx, ky = waves[KX, k], waves[KY, k]
            apart = ti.max(ti.abs(kx * to_right[0] + ky * to_right[1]), ti.abs(kx * to_down[0] + ky * to_down[1]))
            share = ti.min(ti.max((GONE - apart) / (GONE - RESOLVED), 0.0), 1.0)
            sine, cosine = fast_maths.sincos_short(kx * place[0] + ky * place[1] + waves[PHASE, k])
            a, bx, by = share * waves[A, k], share * waves[BX, k], share * waves[BY, k]
            zeta += a * cosine
            sx += bx * sine
            sy += by * sine
            zx -= a * kx * sine
            zy -= a * ky * sine
            jxx -= bx * kx * cosine
            jxy -= bx * ky * cosine
            jyy -= by * ky * cosine
            steep = (1.0 - share) * waves[A, k]
            rough += 0.5 * steep * steep * (kx * kx + ky * ky)
        det = ti.max(jxx * jyy - jxy * jxy, 0.05)
        slope_n, slope_e = (zx * jyy - zy * jxy) / det, (zy * jxx - zx * jxy) / det
        inv = 1.0 / ti.sqrt(1.0 + slope_n * slope_n + slope_e * slope_e)
        out[i, 0], out[i, 1], out[i, 2] = place[0] - sx, place[1] - sy, place[2] - zeta
        out[i, 3], out[i, 4], out[i, 5] = -slope_n * inv, -slope_e * inv, -inv
        out[i, 6], out[i, 7] = rough, zeta / crest


def water_seen(camera: FilmCamera, size: tuple[int, int], moment: Moment) -> Water:
    """The part of the sea that a camera without roll sees in a picture of `size` (px).

    A sea whose components are unknown is sampled by its elevation.
    """
    wide, high = size
    height = -float(camera.eye_n[2])
    if height <= 0.0:
        return NO_WATER
    waves = np.zeros((6, 0)) if moment.waves is None else moment.waves
    crest = max(3.0 * float(np.sqrt(0.5 * np.sum(waves[A] ** 2))), CALM_M)  # three standard deviations
    rays = camera.axes * np.array([[1.0], [1.0], [camera.focal * high]]) / (camera.focal * high)
    rows = _rows(camera, high, height, crest)
    if len(rows) < 2:
        return NO_WATER
    wider = height / max(height - 1.5 * crest, 0.3 * height)
    half = 0.5 * wide * wider + MARGIN_PX
    columns = np.linspace(-half, half, int(np.ceil(2.0 * half / CELL_PX[0])) + 1)
    points = np.empty((len(rows) * len(columns), COLUMNS), np.float32)
    at_eye = np.concatenate([waves, _ripples(moment.time_s)], axis=1)
    at_eye[PHASE] = np.mod(at_eye[PHASE] + at_eye[KX] * camera.eye_n[0] + at_eye[KY] * camera.eye_n[1], 2.0 * np.pi)
    given = [np.ascontiguousarray(array, np.float32) for array in (columns, rows, rays, at_eye)]
    _place(points, *given, height, crest)  # pyright: ignore[reportCallIssue]
    water = Water(points, len(columns))
    if moment.waves is None:
        _sample(water, camera.eye_n, moment.elevation)
    return water


def _ripples(time_s: float) -> Array:
    """Waves [6, component] of a few mm, shorter than any sea's, that make water look like water; for pictures only."""
    number = np.arange(RIPPLES)
    k = 2.0 * np.pi / (RIPPLE_M[0] * (RIPPLE_M[1] / RIPPLE_M[0]) ** (number / (RIPPLES - 1)))
    turn = 2.4 * number  # rad: the golden angle spreads directions
    phase = 1.7 * number - np.sqrt(GRAVITY * k) * time_s
    return np.stack([RIPPLE_SLOPE / k, k * np.cos(turn), k * np.sin(turn), phase, 0.0 * k, 0.0 * k])


def _rows(camera: FilmCamera, high: int, height: float, crest: float) -> Array:
    """Rows (px below the centre) of the grid, from far away to below the picture, since crests rise into it."""
    focal, (_, down, forward) = camera.focal * high, camera.axes
    top = max(-0.5 * high - MARGIN_PX, focal * (height / FARTHEST_M - forward[2]) / down[2] if down[2] > 1e-6 else -1e9)
    low = 0.5 * high
    steep = forward[2] + low / focal * down[2]  # sine, times the ray's length, of the lowest ray
    if steep <= 0.0:
        return np.zeros(0)
    t = max(height - 1.5 * crest, 0.3 * height) / steep  # where the ray meets a crest
    under = t * (forward + low / focal * down) + np.array([0.0, 0.0, height - t * steep])
    low = max(low, focal * float(under @ down) / max(float(under @ forward), 1e-3)) + MARGIN_PX
    return np.linspace(top, low, max(int(np.ceil((low - top) / CELL_PX[1])) + 1, 2))


def _sample(water: Water, eye_n: Array, elevation: Callable[[Array, Array], Array]) -> None:
    """Heights of a sea whose components are unknown, with normals from neighbouring points."""
    points = water.points.reshape(water.rows, water.across, COLUMNS)
    up = np.asarray(elevation(points[..., NORTH] + eye_n[NORTH], points[..., EAST] + eye_n[EAST]), dtype=np.float32)
    points[..., DOWN] -= up
    crest = max(3.0 * float(up.std()), CALM_M)
    points[..., CREST] = up / crest
    across, along = np.gradient(points[..., POINT], axis=1), np.gradient(points[..., POINT], axis=0)
    normal = np.cross(across, along)
    normal *= -np.sign(normal[..., DOWN:]) / np.linalg.norm(normal, axis=-1, keepdims=True)
    points[..., NORMAL] = normal
