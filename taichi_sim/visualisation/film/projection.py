"""Triangles, lines and the sea's grid on the screen: cut at the near plane, shaded, and sorted into bands.

`camera` holds the numbers of `numbers`; lengths on the screen are in samples; positions are in m from the eye, in n.
Colours are RGB from 0 to 1.

Water reflects the sky by Schlick's approximation of Fresnel's equations (Schlick 1994, 0.02 at normal incidence) and
shows its own colour in the rest. Waves too short for the grid make it rough (`rough`, mean square slope); without them
the far sea would be a mirror. Surfaces take sunlight by Lambert's law and skylight from above.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportGeneralTypeIssues=false

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from taichi.math import vec3

from taichi_sim.visualisation.film.camera import Array, FilmCamera
from taichi_sim.visualisation.film.primitives import Solids, Strokes
from taichi_sim.visualisation.film.water import COLUMNS
from taichi_sim.visualisation.recording.sea_patch import CREST, DEEP, FOAM, HAZE, SUN_ENU

SUN_NED = vec3(SUN_ENU[1], SUN_ENU[0], -SUN_ENU[2])  # towards the sun
HORIZON, ZENITH = vec3(*(HAZE / 255.0)), vec3(0.30, 0.50, 0.74)
WARM = vec3(1.0, 0.95, 0.82)  # colour of sunlight
ABYSS, SHALLOW, WHITE = (vec3(*(colour / 255.0)) for colour in (DEEP, CREST, FOAM))
F0 = 0.02  # reflectance of water at normal incidence
SHINE = 7  # doublings: the exponent of the sun's glitter is 2 ** SHINE
FOAM_FROM = 0.9  # height over that of a tall crest, above which there is foam
SAMPLES = 2  # samples along each side of a pixel
BAND = 16  # rows of samples that one thread fills
NEAR_M = 0.25  # smallest distance that is drawn
SOLID, STROKE, CORNER = 15, 11, 6  # numbers for a painted triangle, a stroke, and a point of the sea
SCREEN = 20
"""Numbers of a triangle on the screen: x, y (samples), 1 / distance of its corners from above; slopes of 1 / distance
along x and y; colour at the first corner, its slopes along x, and along y."""


@ti.func
def sky(ray: vec3):
    """Colour of the sky along the unit vector `ray`."""
    up = ti.max(-ray.z, 0.0)
    glow = ti.max(ray.dot(SUN_NED), 0.0)
    glow *= glow
    glow *= glow
    return ti.math.mix(HORIZON, ZENITH, ti.sqrt(up)) + 0.12 * glow * glow * WARM


@ti.func
def hazy(colour: vec3, distance, half):
    """`colour` seen through haze at `distance` (m); at the distance `half` (m) the haze gives half of the light."""
    far = distance * distance
    return ti.math.mix(colour, HORIZON, far / (far + half * half))


@ti.func
def water(ray: vec3, normal: vec3, rough, height):
    """Colour of the sea along the unit vector `ray`; `height` is 1 on a tall crest and -1 in a trough."""
    facing = ti.max(-ray.dot(normal), 0.0)
    facing = ti.sqrt(facing * facing + 0.35 * rough)
    graze = 1.0 - ti.min(facing, 1.0)
    g2 = graze * graze
    mirror = F0 + (1.0 - F0) * g2 * g2 * graze
    bounced = ray + 2.0 * ti.max(-ray.dot(normal), 0.0) * normal
    bounced.z = -ti.sqrt(bounced.z * bounced.z + 0.5 * rough)  # rough water mirrors the sky at a higher elevation
    bounced = bounced.normalized()
    glitter = ti.max(bounced.dot(SUN_NED), 0.0)
    for _ in ti.static(range(SHINE)):
        glitter *= glitter
    lit = ti.max(normal.dot(SUN_NED), 0.0)
    own = ti.math.mix(ABYSS, SHALLOW, ti.math.clamp(0.32 + 0.3 * height, 0.0, 1.0)) * (0.25 + 0.95 * lit * lit)
    foam = 0.3 * ti.math.clamp((height - FOAM_FROM) / 0.8, 0.0, 1.0)
    own = ti.math.mix(own, WHITE, foam)
    return ti.math.mix(own, sky(bounced), mirror) + 0.25 * glitter * WARM


@ti.func
def painted(colour: vec3, normal: vec3):
    """Colour of a dull surface in sunlight and skylight."""
    sun = ti.max(normal.dot(SUN_NED), 0.0)
    return colour * ((0.42 - 0.14 * normal.z) + 0.62 * sun * WARM)


@ti.func
def triple(values: ti.template(), k):
    """Three numbers from index k on."""
    return vec3(values[k], values[k + 1], values[k + 2])


@ti.func
def ahead(camera: ti.template(), p: vec3):
    """Distance of a point ahead of the eye, m."""
    return camera[6] * p.x + camera[7] * p.y + camera[8] * p.z


@ti.func
def corner(camera: ti.template(), p: vec3):
    """(column, row, 1 / distance) in samples of a point (m from the eye, n) that is ahead of the near plane."""
    w = 1.0 / ahead(camera, p)
    across, below = triple(camera, 0).dot(p), triple(camera, 3).dot(p)
    return vec3(camera[10] + camera[9] * across * w, camera[11] + camera[9] * below * w, w)


@ti.func
def above(a: vec3, b: vec3):
    """Whether a comes before b in order from the top."""
    return a.y < b.y or (a.y == b.y and a.x < b.x)


@ti.func
def keep(
    screen: ti.template(), bands: ti.template(), t, p: vec3, q: vec3, r: vec3, size,
    at_p: vec3, at_q: vec3, at_r: vec3,
):  # fmt: skip
    """Store triangle t for its bands, unless it is outside the picture or has no area; at_p is the colour at p."""
    bands[2 * t], bands[2 * t + 1] = 1, 0
    area = (q.x - p.x) * (r.y - p.y) - (r.x - p.x) * (q.y - p.y)
    a, b, c = p, q, r
    if above(b, a):
        a, b = b, a
    if above(c, b):
        b, c = c, b
    if above(b, a):
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
def hold(screen: ti.template(), bands: ti.template(), t, p: vec3, q: vec3, r: vec3, colour: vec3):
    """Store the corners and the colour of triangle t."""
    for n in ti.static(range(3)):
        k = t * SCREEN + n
        screen[k], screen[k + 3], screen[k + 6], screen[k + 9] = p[n], q[n], r[n], colour[n]
    bands[2 * t], bands[2 * t + 1] = 0, 0


@ti.func
def place_solid(screen: ti.template(), bands: ti.template(), camera: ti.template(), solids: ti.template(), f):
    """Cut painted triangle f at the near plane and store the remaining one or two triangles."""
    k = f * SOLID
    colour, normal = triple(solids, k + 9), triple(solids, k + 12)
    shines = normal.dot(normal) < 0.5
    if shines or normal.dot(triple(solids, k)) < 0.0:
        middle = (triple(solids, k) + triple(solids, k + 3) + triple(solids, k + 6)) / 3.0
        if not shines:
            colour = hazy(painted(colour, normal), middle.norm(), camera[13])
        ring = ti.Matrix([[0.0, 0.0, 0.0] for _ in range(4)])
        found = 0
        for side in range(3):
            here, there = triple(solids, k + 3 * side), triple(solids, k + 3 * ((side + 1) % 3))
            d0, d1 = ahead(camera, here) - NEAR_M, ahead(camera, there) - NEAR_M
            if d0 >= 0.0:
                ring[found, 0], ring[found, 1], ring[found, 2] = here.x, here.y, here.z
                found += 1
            if d0 * d1 < 0.0:
                cut = here + d0 / (d0 - d1) * (there - here)
                ring[found, 0], ring[found, 1], ring[found, 2] = cut.x, cut.y, cut.z
                found += 1
        a = corner(camera, vec3(ring[0, 0], ring[0, 1], ring[0, 2]))
        c = corner(camera, vec3(ring[2, 0], ring[2, 1], ring[2, 2]))
        for half in range(found - 2):
            n = 1 + 2 * half
            other = corner(camera, vec3(ring[n, 0], ring[n, 1], ring[n, 2]))
            hold(screen, bands, 2 * f + half, a, other, c, colour)


@ti.func
def place_stroke(screen: ti.template(), bands: ti.template(), camera: ti.template(), strokes: ti.template(), s, t):
    """Store stroke s as triangles t and t + 1; its width on the screen does not depend on the distance."""
    k = s * STROKE
    p, q, colour = triple(strokes, k), triple(strokes, k + 3), triple(strokes, k + 6)
    d0, d1 = ahead(camera, p) - NEAR_M, ahead(camera, q) - NEAR_M
    if d0 >= 0.0 or d1 >= 0.0:
        if d0 < 0.0:
            p = q + d1 / (d1 - d0) * (p - q)
        if d1 < 0.0:
            q = p + d0 / (d0 - d1) * (q - p)
        a, b = corner(camera, p), corner(camera, q)
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
        hold(screen, bands, t, a0, a1, b0, colour)
        hold(screen, bands, t + 1, a1, b1, b0, colour)


@ti.func
def place_point(flat: ti.template(), camera: ti.template(), sea: ti.template(), i):
    """Put point i of the sea's grid on the screen, with its colour."""
    k = COLUMNS * i
    place = triple(sea, k)
    away, at = place.norm(), corner(camera, place)
    lit = hazy(water(place / away, triple(sea, k + 3), sea[k + 6], sea[k + 7]), away, camera[13])
    for n in ti.static(range(3)):
        flat[CORNER * i + n], flat[CORNER * i + 3 + n] = at[n], lit[n]


@ti.func
def settle(screen: ti.template(), bands: ti.template(), flat: ti.template(), t, pieces, across, size):
    """Sort triangle t into bands: a held one, or, from index `pieces` on, half a cell of the sea's grid."""
    p, q, r, at_p, at_q, at_r = vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0)
    there = True
    if t < pieces:
        k = t * SCREEN
        p, q, r, at_p = triple(screen, k), triple(screen, k + 3), triple(screen, k + 6), triple(screen, k + 9)
        at_q, at_r = at_p, at_p
        there = bands[2 * t] <= bands[2 * t + 1]
    else:
        i = t - pieces
        k = CORNER * (i // 2 // (across - 1) * across + i // 2 % (across - 1))
        m, n = k + CORNER, k + CORNER * across
        o = k if i % 2 == 0 else n + CORNER
        p, q, r = triple(flat, o), triple(flat, m), triple(flat, n)
        at_p, at_q, at_r = triple(flat, o + 3), triple(flat, m + 3), triple(flat, n + 3)
    if there:
        keep(screen, bands, t, p, q, r, size, at_p, at_q, at_r)


def numbers(camera: FilmCamera, wide: int, high: int) -> NDArray[np.float32]:
    """Camera as numbers [14]: axes, focal length and middle in samples, height of the eye (m), distance of haze (m)."""
    high, wide = SAMPLES * high, SAMPLES * wide
    inner = (camera.focal * high, 0.5 * wide, 0.5 * high, -camera.eye_n[2], camera.haze_m)
    return np.concatenate([camera.axes.ravel(), inner]).astype(np.float32)


def solid_numbers(solids: Solids, eye_n: Array) -> NDArray[np.float32]:
    """Solids as numbers [F * SOLID]: corners from the eye (m), colour, normal."""
    corners = (solids.corners_n - eye_n).reshape(-1, 9)
    return np.concatenate([corners, solids.colours / 255.0, solids.normals_n], axis=1).astype(np.float32).ravel()


def stroke_numbers(strokes: Strokes, eye_n: Array) -> NDArray[np.float32]:
    """Pack strokes into numbers [S * STROKE]: ends relative to the eye (m), colour, half width (samples), lift (m)."""
    ends = (strokes.ends_n - eye_n).reshape(-1, 6)
    half = 0.5 * SAMPLES * strokes.width_px
    parts = (ends, strokes.colours / 255.0, half[:, None], strokes.lift_m[:, None])
    return np.concatenate(parts, axis=1).astype(np.float32).ravel()
