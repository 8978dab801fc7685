"""A software rasteriser: triangles, lines and the sea's grid to pixels, with a depth buffer, on the CPU's cores.

Everything becomes triangles on the screen, cut at the near plane and shaded (shade.py): a colour that is linear over
the triangle. They are sorted into bands of rows, and each band is filled by one thread in the order of the triangles, so
that a picture is the same bits on any number of threads. A pixel is the mean of SAMPLES x SAMPLES samples. A sample is
64 bits: above, those of 1 / distance, which rise with it; below, the number of the triangle. Edges are followed from
their upper to their lower end in either triangle, so that neighbours leave no gap.

Taichi compiles one kernel for all sizes of pictures. Its arrays have one axis: with more, an access costs twice as much.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportAttributeAccessIssue=false

from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from taichi.math import vec3

from taichi_sim import runtime
from taichi_sim.film import shade
from taichi_sim.film.camera import Array, Camera
from taichi_sim.film.water import COLUMNS, NO_WATER, Water

SAMPLES = 2  # along each side of a pixel
BAND = 8  # rows of samples that one thread fills
NEAR_M = 0.25  # nothing nearer is drawn, nor farther than FAR_M
FAR_M = 3e5
SOLID, STROKE, CORNER = 15, 11, 6  # numbers of a painted triangle, of a stroke, and of a point of the sea on the screen
SCREEN = 20
"""Numbers of a triangle on the screen: x, y (samples), 1 / distance of its corners from above; slopes of 1 / distance
along x and y; colour at the first corner, its slopes along x, and along y."""


class Solids(NamedTuple):
    """Painted triangles, one colour and one normal each."""

    corners_n: NDArray[np.floating]  # [F, 3, 3] m
    normals_n: NDArray[np.floating]  # [F, 3] unit, outward; zero: it shines, and is seen from both sides
    colours: NDArray[np.uint8]  # [F, 3]


class Strokes(NamedTuple):
    """Straight pieces of lines; one without length is a square dot."""

    ends_n: NDArray[np.floating]  # [S, 2, 3] m
    colours: NDArray[np.uint8]  # [S, 3]
    width_px: NDArray[np.floating]  # [S]
    lift_m: NDArray[np.floating]  # [S] waves up to this height do not hide what lies on the mean level of the sea


NO_SOLIDS = Solids(np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
NO_STROKES = Strokes(np.zeros((0, 2, 3)), np.zeros((0, 3), np.uint8), np.zeros(0), np.zeros(0))
_floats = ti.types.ndarray(dtype=ti.f32, ndim=1)
_whole = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.func
def _triple(values: ti.template(), k):
    """Three numbers from the k-th on."""
    return vec3(values[k], values[k + 1], values[k + 2])


@ti.func
def _ahead(camera: ti.template(), p: vec3):
    """How far ahead of the eye a place is, m."""
    return camera[6] * p.x + camera[7] * p.y + camera[8] * p.z


@ti.func
def _corner(camera: ti.template(), p: vec3):
    """(column, row, 1 / distance) in samples of a place (m from the eye, n) that is ahead of the near plane."""
    w = 1.0 / _ahead(camera, p)
    across, below = _triple(camera, 0).dot(p), _triple(camera, 3).dot(p)
    return vec3(camera[10] + camera[9] * across * w, camera[11] + camera[9] * below * w, w)


@ti.func
def _above(a: vec3, b: vec3):
    """Whether a comes before b, from above."""
    return a.y < b.y or (a.y == b.y and a.x < b.x)


@ti.func
def _keep(
    screen: ti.template(), bands: ti.template(), t, p: vec3, q: vec3, r: vec3, size,
    at_p: vec3, at_q: vec3, at_r: vec3,
):  # fmt: skip
    """Store triangle t, unless it is outside the picture or has no area; at_p is the colour at p."""
    area = (q.x - p.x) * (r.y - p.y) - (r.x - p.x) * (q.y - p.y)
    a, b, c = p, q, r
    if _above(b, a):
        a, b = b, a
    if _above(c, b):
        b, c = c, b
    if _above(b, a):
        a, b = b, a
    first = ti.cast(ti.ceil(ti.min(ti.max(a.y - 0.5, 0.0), size[1])), ti.i32)
    last = ti.cast(ti.ceil(ti.max(ti.min(c.y - 0.5, size[1]), 0.0)), ti.i32)
    seen = first < last and ti.abs(area) > 1e-6
    if seen and ti.max(a.x, ti.max(b.x, c.x)) > 0.0 and ti.min(a.x, ti.min(b.x, c.x)) < size[0]:
        inv, k = 1.0 / area, t * SCREEN
        for n in ti.static(range(3)):
            screen[k + n], screen[k + 3 + n], screen[k + 6 + n] = a[n], b[n], c[n]
        along, down = vec3(q.z - p.z, q.x - p.x, q.y - p.y), vec3(r.z - p.z, r.x - p.x, r.y - p.y)
        screen[k + 9] = (along.x * down.z - down.x * along.z) * inv
        screen[k + 10] = (down.x * along.y - along.x * down.y) * inv
        by_x = ((at_q - at_p) * down.z - (at_r - at_p) * along.z) * inv
        by_y = ((at_r - at_p) * along.y - (at_q - at_p) * down.y) * inv
        colour = at_p + (a.x - p.x) * by_x + (a.y - p.y) * by_y
        for n in ti.static(range(3)):
            screen[k + 11 + n], screen[k + 14 + n], screen[k + 17 + n] = colour[n], by_x[n], by_y[n]
        bands[2 * t], bands[2 * t + 1] = first // BAND, (last - 1) // BAND


@ti.func
def _place_solid(screen: ti.template(), bands: ti.template(), camera: ti.template(), solids: ti.template(), f, size):
    """Cut painted triangle f at the near plane, and store what is left: up to two triangles."""
    k = f * SOLID
    colour, normal = _triple(solids, k + 9), _triple(solids, k + 12)
    shines = normal.dot(normal) < 0.5
    if shines or normal.dot(_triple(solids, k)) < 0.0:
        middle = (_triple(solids, k) + _triple(solids, k + 3) + _triple(solids, k + 6)) / 3.0
        if not shines:
            colour = shade.hazy(shade.painted(colour, normal), middle.norm(), camera[13])
        ring = ti.Matrix([[0.0, 0.0, 0.0] for _ in range(4)])
        found = 0
        for side in ti.static(range(3)):
            here, there = _triple(solids, k + 3 * side), _triple(solids, k + 3 * ((side + 1) % 3))
            d0, d1 = _ahead(camera, here) - NEAR_M, _ahead(camera, there) - NEAR_M
            cut = here + d0 / (d0 - d1 if d0 * d1 < 0.0 else 1.0) * (there - here)
            for n in ti.static(range(4)):
                if d0 >= 0.0 and found == n:
                    ring[n, 0], ring[n, 1], ring[n, 2] = here.x, here.y, here.z
            found += d0 >= 0.0
            for n in ti.static(range(4)):
                if d0 * d1 < 0.0 and found == n:
                    ring[n, 0], ring[n, 1], ring[n, 2] = cut.x, cut.y, cut.z
            found += d0 * d1 < 0.0
        a = _corner(camera, vec3(ring[0, 0], ring[0, 1], ring[0, 2]))
        c = _corner(camera, vec3(ring[2, 0], ring[2, 1], ring[2, 2]))
        for half in range(found - 2):
            n = 1 + 2 * half
            other = _corner(camera, vec3(ring[n, 0], ring[n, 1], ring[n, 2]))
            _keep(screen, bands, 2 * f + half, a, other, c, size, colour, colour, colour)


@ti.func
def _place_stroke(
    screen: ti.template(), bands: ti.template(), camera: ti.template(), strokes: ti.template(), s, t, size
):
    """Store stroke s as triangles t and t + 1, as wide on the screen wherever it is."""
    k = s * STROKE
    p, q, colour = _triple(strokes, k), _triple(strokes, k + 3), _triple(strokes, k + 6)
    d0, d1 = _ahead(camera, p) - NEAR_M, _ahead(camera, q) - NEAR_M
    if d0 >= 0.0 or d1 >= 0.0:
        if d0 < 0.0:
            p = q + d1 / (d1 - d0) * (p - q)
        if d1 < 0.0:
            q = p + d0 / (d0 - d1) * (q - p)
        a, b = _corner(camera, p), _corner(camera, q)
        way, half = ti.Vector([b.x - a.x, b.y - a.y]), strokes[k + 9]
        length = way.norm()
        along = ti.Vector([half, 0.0])
        aside = ti.Vector([0.0, half])
        if length > 1e-3:
            along = 0.5 * half / length * way  # pieces of a strip overlap a little
            aside = half / length * ti.Vector([-way[1], way[0]])
        nearer = 1.0 / ti.max(1.0 - strokes[k + 10] / ti.max(camera[12], 1e-3), 0.1)
        z0, z1 = a.z * nearer, b.z * nearer
        a0 = vec3(a.x - along[0] + aside[0], a.y - along[1] + aside[1], z0)
        a1 = vec3(a.x - along[0] - aside[0], a.y - along[1] - aside[1], z0)
        b0 = vec3(b.x + along[0] + aside[0], b.y + along[1] + aside[1], z1)
        b1 = vec3(b.x + along[0] - aside[0], b.y + along[1] - aside[1], z1)
        _keep(screen, bands, t, a0, a1, b0, size, colour, colour, colour)
        _keep(screen, bands, t + 1, a1, b1, b0, size, colour, colour, colour)


@ti.func
def _bits(z, t):
    """A sample: 1 / distance `z`, triangle `t`."""
    return ti.cast(ti.bit_cast(ti.cast(z, ti.f32), ti.i32), ti.i64) << 32 | ti.cast(t, ti.i64)


@ti.func
def _fill(samples: ti.template(), room, screen: ti.template(), t, top, bottom, wide, high):
    """Write triangle t into the samples, from `room` on, of rows `top` to `bottom` wherever it is the nearest so far."""
    k = t * SCREEN
    a, b, c = _triple(screen, k), _triple(screen, k + 3), _triple(screen, k + 6)
    by_x, by_y = screen[k + 9], screen[k + 10]
    least, most = ti.min(a.z, ti.min(b.z, c.z)), ti.max(a.z, ti.max(b.z, c.z))
    long_side = (c.x - a.x) / (c.y - a.y)
    upper, lower = (b.x - a.x) / ti.max(b.y - a.y, 1e-12), (c.x - b.x) / ti.max(c.y - b.y, 1e-12)
    y0 = ti.max(ti.cast(ti.ceil(ti.max(a.y - 0.5, 0.0)), ti.i32), top)
    y1 = ti.min(ti.cast(ti.ceil(ti.min(c.y - 0.5, high)), ti.i32), bottom)
    right = ti.cast(wide, ti.f32)
    for y in range(y0, y1):
        middle = ti.cast(y, ti.f32) + 0.5
        one = a.x + (middle - a.y) * long_side
        two = a.x + (middle - a.y) * upper if middle < b.y else b.x + (middle - b.y) * lower
        x0 = ti.cast(ti.ceil(ti.min(ti.max(ti.min(one, two) - 0.5, 0.0), right)), ti.i32)
        x1 = ti.cast(ti.ceil(ti.max(ti.min(ti.max(one, two) - 0.5, right), 0.0)), ti.i32)
        base, line = a.z + (middle - a.y) * by_y + (0.5 - a.x) * by_x, room + (y - top) * wide
        for x in range(x0, x1):
            z = ti.min(ti.max(base + ti.cast(x, ti.f32) * by_x, least), most)
            samples[line + x] = ti.max(samples[line + x], _bits(z, t))


@ti.func
def _colour(screen: ti.template(), t, sx, sy):
    """Of triangle t at a sample."""
    k = t * SCREEN
    x, y = sx - screen[k], sy - screen[k + 1]
    return _triple(screen, k + 11) + x * _triple(screen, k + 14) + y * _triple(screen, k + 17)


@ti.func
def _sky(camera: ti.template(), sx, sy):
    """Of the sky at a sample."""
    u, v = (sx - camera[10]) / camera[9], (sy - camera[11]) / camera[9]
    return shade.sky((_triple(camera, 6) + u * _triple(camera, 0) + v * _triple(camera, 3)).normalized())


@ti.func
def _resolve(
    picture: ti.template(), samples: ti.template(), room, screen: ti.template(), camera: ti.template(),
    pieces, triangles, top, bottom, wide,
):  # fmt: skip
    """Write the pixels of a band: the mean of their samples' colours."""
    across = wide // SAMPLES
    for row in range(top // SAMPLES, bottom // SAMPLES):
        for column in range(across):
            y, x = SAMPLES * row, SAMPLES * column
            k = room + (y - top) * wide + x
            first = ti.cast(samples[k], ti.i32)
            water, same = first >= pieces and first < triangles, True
            for n in ti.static(range(1, SAMPLES * SAMPLES)):
                other = ti.cast(samples[k + n // SAMPLES * wide + n % SAMPLES], ti.i32)
                water = water and other >= pieces and other < triangles
                same = same and other == first
            whole = water or same  # one shade serves for all of the pixel
            colour, kept, last = vec3(0.0), vec3(0.0), -1
            for n in range(1 if whole else SAMPLES * SAMPLES):
                down, right = n // SAMPLES, n % SAMPLES
                t = ti.cast(samples[k + down * wide + right], ti.i32)
                if t != last:
                    last = t
                    sx, sy = ti.cast(x + right, ti.f32) + 0.5, ti.cast(y + down, ti.f32) + 0.5
                    if t < triangles:
                        kept = _colour(screen, t, sx, sy)
                    else:
                        kept = _sky(camera, sx, sy)
                colour += kept
            colour *= 255.0 if whole else ti.static(255.0 / SAMPLES**2)
            for c in ti.static(range(3)):
                picture[3 * (row * across + column) + c] = ti.cast(ti.math.clamp(colour[c] + 0.5, 0.0, 255.0), ti.u8)


@ti.kernel
def _draw(
    picture: ti.types.ndarray(dtype=ti.u8, ndim=1),
    samples: ti.types.ndarray(dtype=ti.i64, ndim=1),
    screen: _floats, bands: _whole, starts: _whole, order: _whole,
    camera: _floats, solids: _floats, strokes: _floats, sea: _floats, flat: _floats,
    wide: ti.i32, high: ti.i32, across: ti.i32,
):  # fmt: skip
    """Fill `picture`; wide, high are samples, `across` the points in a line of the sea's grid. See Raster.draw."""
    size = ti.Vector([ti.cast(wide, ti.f32), ti.cast(high, ti.f32)])
    count, lines = solids.shape[0] // SOLID, strokes.shape[0] // STROKE
    pieces, cells = 2 * (count + lines), across - 1
    triangles = pieces + 2 * cells * (sea.shape[0] // COLUMNS // across - 1)
    for t in range(triangles):
        bands[2 * t], bands[2 * t + 1] = 1, 0
    for f in range(count):
        _place_solid(screen, bands, camera, solids, f, size)
    for s in range(lines):
        _place_stroke(screen, bands, camera, strokes, s, 2 * (count + s), size)
    for i in range(sea.shape[0] // COLUMNS):
        place, k = _triple(sea, COLUMNS * i), COLUMNS * i
        away, at = place.norm(), _corner(camera, place)
        lit = shade.hazy(shade.water(place / away, _triple(sea, k + 3), sea[k + 6], sea[k + 7]), away, camera[13])
        for n in ti.static(range(3)):
            flat[CORNER * i + n], flat[CORNER * i + 3 + n] = at[n], lit[n]
    for i in range(triangles - pieces):
        k = CORNER * (i // 2 // cells * across + i // 2 % cells)
        m, n = k + CORNER, k + CORNER * across
        o = k if i % 2 == 0 else n + CORNER
        _keep(
            screen, bands, pieces + i, _triple(flat, o), _triple(flat, m), _triple(flat, n), size,
            _triple(flat, o + 3), _triple(flat, m + 3), _triple(flat, n + 3),
        )  # fmt: skip
    # which triangles each band has, in order: starts[b + 2] counts, then starts[b + 1] is where the next one goes
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
    workers = samples.shape[0] // (BAND * wide)
    ti.loop_config(block_dim=1)
    for worker in range(workers):  # each has room for one band, which stays in its core's cache
        room, nothing = worker * BAND * wide, _bits(1.0 / FAR_M, triangles)
        for turn in range((starts.shape[0] - 2 - worker + workers - 1) // workers):
            b = worker + turn * workers
            top, bottom = b * BAND, ti.min(b * BAND + BAND, high)
            for i in range(room, room + BAND * wide):
                samples[i] = nothing
            for n in range(starts[b], ti.min(starts[b + 1], order.shape[0])):
                _fill(samples, room, screen, order[n], top, bottom, wide, high)
            _resolve(picture, samples, room, screen, camera, pieces, triangles, top, bottom, wide)


class Raster:
    """Draws pictures of one size, its buffers kept from one to the next."""

    def __init__(self, wide: int, high: int):
        """For pictures of `wide` x `high` pixels."""
        self.size = (wide, high)
        self._starts = np.zeros(-(-SAMPLES * high // BAND) + 2, np.int32)
        self._screen, self._bands, self._order = np.empty(0, np.float32), np.empty(0, np.int32), np.empty(0, np.int32)

    def draw(self, camera: Camera, solids: Solids, strokes: Strokes, water: Water = NO_WATER) -> NDArray[np.uint8]:
        """A picture [high, wide, 3] of what is given, in front of the sky."""
        wide, high = self.size
        workers = max(1, min(runtime.current().threads, high * SAMPLES // BAND))
        samples = np.empty(workers * BAND * SAMPLES * wide, np.int64)
        triangles = 2 * (len(solids.colours) + len(strokes.colours))
        triangles += 2 * max(water.rows - 1, 0) * (water.across - 1)
        if 2 * triangles > len(self._bands):
            self._screen = np.empty(int(1.3 * triangles) * SCREEN, np.float32)
            self._bands = np.empty(int(1.3 * triangles) * 2, np.int32)
            self._order = np.empty(max(len(self._order), len(self._bands)), np.int32)
        picture = np.empty(high * wide * 3, np.uint8)
        arrays = (
            _numbers(camera, wide, high), _solids(solids, camera.eye_n), _strokes(strokes, camera.eye_n),
            water.points.ravel(), np.empty(len(water.points) * CORNER, np.float32),
        )  # fmt: skip
        while True:
            _draw(picture, samples, self._screen, self._bands, self._starts, self._order, *arrays,
                  SAMPLES * wide, SAMPLES * high, water.across)  # fmt: skip
            if self._starts[-1] <= len(self._order):
                return picture.reshape(high, wide, 3)
            self._order = np.empty(int(1.3 * self._starts[-1]), np.int32)  # triangles were in more bands than expected


def _numbers(camera: Camera, wide: int, high: int) -> NDArray[np.float32]:
    """[14] axes, focal length and middle in samples, height of the eye (m), distance of haze (m)."""
    high, wide = SAMPLES * high, SAMPLES * wide
    inner = (camera.focal * high, 0.5 * wide, 0.5 * high, -camera.eye_n[2], camera.haze_m)
    return np.concatenate([camera.axes.ravel(), inner]).astype(np.float32)


def _solids(solids: Solids, eye_n: Array) -> NDArray[np.float32]:
    """[F * SOLID] corners from the eye (m), colour, normal."""
    corners = (solids.corners_n - eye_n).reshape(-1, 9)
    return np.concatenate([corners, solids.colours / 255.0, solids.normals_n], axis=1).astype(np.float32).ravel()


def _strokes(strokes: Strokes, eye_n: Array) -> NDArray[np.float32]:
    """[S * STROKE] ends from the eye (m), colour, half the width (samples), lift (m)."""
    ends = (strokes.ends_n - eye_n).reshape(-1, 6)
    half = 0.5 * SAMPLES * strokes.width_px
    parts = (ends, strokes.colours / 255.0, half[:, None], strokes.lift_m[:, None])
    return np.concatenate(parts, axis=1).astype(np.float32).ravel()
