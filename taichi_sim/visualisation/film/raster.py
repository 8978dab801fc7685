"""A software rasteriser: draws triangles, lines and the sea's grid to pixels with a depth buffer on the CPU's cores.

Everything becomes triangles on the screen (projection.py) with linearly varying colours. Triangles are sorted into
bands of rows, and one thread fills each band, so a picture has the same bits on any number of threads. A pixel is the
mean of SAMPLES x SAMPLES samples. Sea and sky, whose colours change slowly, have one sample in the pixel's centre,
behind the others. A sample is 64 bits: the upper ones are the bits of 1 / distance, which increase with it; the lower
ones are the number of the triangle. Both triangles at an edge follow it from its upper to its lower end, so they leave
no gap.

Taichi compiles one kernel for all sizes of pictures. Its arrays have one axis, because access to arrays with more axes
costs twice as much.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportGeneralTypeIssues=false

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from taichi.math import vec3

from taichi_sim.kernels import runtime
from taichi_sim.kernels.runtime import whole1
from taichi_sim.visualisation.film.camera import FilmCamera
from taichi_sim.visualisation.film.primitives import Solids, Strokes
from taichi_sim.visualisation.film.projection import (
    BAND,
    CORNER,
    SAMPLES,
    SCREEN,
    SOLID,
    STROKE,
    numbers,
    place_point,
    place_solid,
    place_stroke,
    settle,
    sky,
    solid_numbers,
    stroke_numbers,
    triple,
)
from taichi_sim.visualisation.film.water import COLUMNS, NO_WATER, Water

FAR_M = 3e5  # largest distance that is drawn
FLOATS, WHOLE = ti.types.ndarray(dtype=ti.f32, ndim=1), whole1


@ti.func
def _bits(z, t):
    """A sample of triangle `t` with 1 / distance `z`."""
    return ti.cast(ti.bit_cast(ti.cast(z, ti.f32), ti.i32), ti.i64) << 32 | ti.cast(t, ti.i64)


@ti.func
def _fill(samples: ti.template(), room, screen: ti.template(), t, top, bottom, wide, grain: ti.template()):
    """Write triangle t into the samples of rows `top` to `bottom` (from index `room` on) where it is the nearest so
    far.

    `grain` is the spacing of samples each way; `top`, `bottom` and `wide` count them.
    """
    k = t * SCREEN
    a, b, c = triple(screen, k), triple(screen, k + 3), triple(screen, k + 6)
    by_x, by_y = screen[k + 9], screen[k + 10]
    least, most = ti.min(a.z, ti.min(b.z, c.z)), ti.max(a.z, ti.max(b.z, c.z))
    long_side = (c.x - a.x) / (c.y - a.y)
    upper, lower = (b.x - a.x) / ti.max(b.y - a.y, 1e-12), (c.x - b.x) / ti.max(c.y - b.y, 1e-12)
    finer = ti.static(1.0 / grain)
    y0 = ti.max(ti.cast(ti.ceil(ti.max(a.y * finer - 0.5, 0.0)), ti.i32), top)
    y1 = ti.min(ti.cast(ti.ceil(ti.min(c.y * finer - 0.5, ti.cast(bottom, ti.f32))), ti.i32), bottom)
    right = ti.cast(wide, ti.f32)
    for y in range(y0, y1):
        middle = (ti.cast(y, ti.f32) + 0.5) * grain
        one = a.x + (middle - a.y) * long_side
        two = a.x + (middle - a.y) * upper if middle < b.y else b.x + (middle - b.y) * lower
        x0 = ti.cast(ti.ceil(ti.min(ti.max(ti.min(one, two) * finer - 0.5, 0.0), right)), ti.i32)
        x1 = ti.cast(ti.ceil(ti.max(ti.min(ti.max(one, two) * finer - 0.5, right), 0.0)), ti.i32)
        base, line = a.z + (middle - a.y) * by_y + (0.5 * grain - a.x) * by_x, room + (y - top) * wide
        for x in range(x0, x1):
            z = ti.min(ti.max(base + ti.cast(x, ti.f32) * (grain * by_x), least), most)
            samples[line + x] = ti.max(samples[line + x], _bits(z, t))


@ti.func
def _painted(screen: ti.template(), t):
    """Colour of triangle t, constant over it."""
    return triple(screen, t * SCREEN + 11)


@ti.func
def _colour(screen: ti.template(), t, sx, sy):
    """Colour of triangle t at a sample."""
    k = t * SCREEN
    x, y = sx - screen[k], sy - screen[k + 1]
    return triple(screen, k + 11) + x * triple(screen, k + 14) + y * triple(screen, k + 17)


@ti.func
def _sky(camera: ti.template(), sx, sy):
    """Colour of the sky at a sample."""
    u, v = (sx - camera[10]) / camera[9], (sy - camera[11]) / camera[9]
    return sky((triple(camera, 6) + u * triple(camera, 0) + v * triple(camera, 3)).normalized())


@ti.func
def _resolve(
    picture: ti.template(), samples: ti.template(), room, behind, screen: ti.template(), camera: ti.template(),
    triangles, top, bottom, across,
):  # fmt: skip
    """Write the pixels of rows `top` to `bottom`: the mean of the samples, or the background."""
    wide = SAMPLES * across
    for row in range(top, bottom):
        for column in range(across):
            k = room + (row - top) * SAMPLES * wide + SAMPLES * column
            front, far = samples[k], samples[behind + (row - top) * across + column]
            for n in ti.static(range(1, SAMPLES * SAMPLES)):
                front = ti.max(front, samples[k + n // SAMPLES * wide + n % SAMPLES])
            t = ti.cast(far, ti.i32)
            sx, sy = SAMPLES * (ti.cast(column, ti.f32) + 0.5), SAMPLES * (ti.cast(row, ti.f32) + 0.5)
            colour = vec3(0.0)
            if t < triangles:
                colour = _colour(screen, t, sx, sy)
            else:
                colour = _sky(camera, sx, sy)
            if front > far:
                back = colour
                colour = vec3(0.0)
                for n in ti.static(range(SAMPLES * SAMPLES)):
                    here = samples[k + n // SAMPLES * wide + n % SAMPLES]
                    if here > far:
                        colour += _painted(screen, ti.cast(here, ti.i32))
                    else:
                        colour += back
                colour /= SAMPLES**2
            lit, pixel = ti.math.clamp(255.0 * colour + 0.5, 0.0, 255.0), 3 * (row * across + column)
            for c in ti.static(range(3)):
                picture[pixel + c] = ti.cast(lit[c], ti.u8)


@ti.kernel
def _draw(
    picture: ti.types.ndarray(dtype=ti.u8, ndim=1),
    samples: ti.types.ndarray(dtype=ti.i64, ndim=1),
    screen: FLOATS, bands: WHOLE, starts: WHOLE, order: WHOLE,
    camera: FLOATS, solids: FLOATS, strokes: FLOATS, sea: FLOATS, flat: FLOATS,
    wide: ti.i32, high: ti.i32, points: ti.i32,
):  # fmt: skip
    """Fill `picture`; wide, high are samples, `points` those in a line of the sea's grid. See Raster.draw."""
    size = ti.Vector([ti.cast(wide, ti.f32), ti.cast(high, ti.f32)])
    count, lines = solids.shape[0] // SOLID, strokes.shape[0] // STROKE
    pieces = 2 * (count + lines)
    triangles = pieces + 2 * (points - 1) * (sea.shape[0] // COLUMNS // points - 1)
    for t in range(pieces):
        bands[2 * t], bands[2 * t + 1] = 1, 0
    for f in range(count):
        place_solid(screen, bands, camera, solids, f)
    for s in range(lines):
        place_stroke(screen, bands, camera, strokes, s, 2 * (count + s))
    for i in range(sea.shape[0] // COLUMNS):
        place_point(flat, camera, sea, i)
    for t in range(triangles):
        settle(screen, bands, flat, t, pieces, points, size)
    # sorts triangles into bands: starts[b + 2] counts them, then starts[b + 1] is the next free position
    ti.loop_config(serialize=True)
    for b in range(starts.shape[0]):
        starts[b] = 0
    ti.loop_config(serialize=True)
    for t in range(triangles):
        for b in range(bands[2 * t], bands[2 * t + 1] + 1):
            starts[b + 2] += 1
    ti.loop_config(serialize=True)
    for b in range(1, starts.shape[0]):
        starts[b] += starts[b - 1]
    ti.loop_config(serialize=True)
    for t in range(triangles):
        for b in range(bands[2 * t], bands[2 * t + 1] + 1):
            if starts[b + 1] < order.shape[0]:
                order[starts[b + 1]] = t
            starts[b + 1] += 1
    across = wide // SAMPLES
    own = ti.static(BAND // SAMPLES) * (SAMPLES * wide + across)
    workers = samples.shape[0] // own
    ti.loop_config(block_dim=1)
    for worker in range(workers):  # each worker has a buffer of one band, which stays in its core's cache
        room = worker * own
        behind, nothing = room + BAND * wide, _bits(1.0 / FAR_M, triangles)
        for turn in range((starts.shape[0] - 2 - worker + workers - 1) // workers):
            b = worker + turn * workers
            top, bottom = b * BAND, ti.min(b * BAND + BAND, high)
            first, last = top // SAMPLES, bottom // SAMPLES
            for i in range(room, behind):
                samples[i] = 0
            for i in range(behind, room + own):
                samples[i] = nothing
            for n in range(starts[b], ti.min(starts[b + 1], order.shape[0])):
                if order[n] < pieces:
                    _fill(samples, room, screen, order[n], top, bottom, wide, 1)
                else:
                    _fill(samples, behind, screen, order[n], first, last, across, SAMPLES)
            _resolve(picture, samples, room, behind, screen, camera, triangles, first, last, across)


class Raster:
    """Draws pictures of one size and reuses its buffers."""

    def __init__(self, wide: int, high: int):
        """Prepare buffers for pictures of `wide` x `high` pixels."""
        self.size = (wide, high)
        self._starts = np.zeros(-(-SAMPLES * high // BAND) + 2, np.int32)
        self._screen, self._bands, self._order = np.empty(0, np.float32), np.empty(0, np.int32), np.empty(0, np.int32)

    def draw(self, camera: FilmCamera, solids: Solids, strokes: Strokes, water: Water = NO_WATER) -> NDArray[np.uint8]:
        """A picture [height, width, 3] of solids, strokes and water in front of the sky."""
        wide, high = self.size
        run, bands = runtime.current(), len(self._starts) - 2
        workers = min(run.threads, bands) if run.arch == "cpu" else bands
        samples = np.empty(workers * BAND * wide // SAMPLES * (SAMPLES**2 + 1), np.int64)
        triangles = 2 * (len(solids.colours) + len(strokes.colours))
        triangles += 2 * max(water.rows - 1, 0) * (water.across - 1)
        if 2 * triangles > len(self._bands):
            self._screen = np.empty(int(1.3 * triangles) * SCREEN, np.float32)
            self._bands = np.empty(int(1.3 * triangles) * 2, np.int32)
            self._order = np.empty(max(len(self._order), len(self._bands)), np.int32)
        picture = np.empty(high * wide * 3, np.uint8)
        arrays = (
            numbers(camera, wide, high), solid_numbers(solids, camera.eye_n), stroke_numbers(strokes, camera.eye_n),
            water.points.ravel(), np.empty(len(water.points) * CORNER, np.float32),
        )  # fmt: skip
        while True:
            _draw(picture, samples, self._screen, self._bands, self._starts, self._order, *arrays,
                  SAMPLES * wide, SAMPLES * high, water.across)  # fmt: skip
            if self._starts[-1] <= len(self._order):
                return picture.reshape(high, wide, 3)
            self._order = np.empty(int(1.3 * self._starts[-1]), np.int32)  # triangles were in more bands than expected
