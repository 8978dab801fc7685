"""A boat drawn from its hull's surface: painted at the waterline, with decks and superstructure that show its attitude.

Faces that point straight up are decks. A hull model may replace a deck by one rectangle of the same area, so decks are
drawn again across the hull's open edge. The superstructure (bridge deck, house, mast) follows from the hull's extent;
no physics uses it.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.conventions import BELOW
from taichi_sim.recording.episode import Array, Body, Platform
from taichi_sim.recording.meshes import DECK, GLASS, HOUSE, KEEL, METAL, PAD, Mesh, box, loft
from taichi_sim.recording.palette import Colour

UPWARD = 0.99  # a face is a deck if its unit normal has at least this upward component
GRID_M = 1e-5  # corners closer than this are the same
BOOT_TOP = 0.25  # height above the waterline at which the paint changes, over the freeboard
MIN_RISE = 0.22  # least height of the mast above the deck in lengths, so that the attitude is visible


def vessel(body: Body, size_m: tuple[float, float, float], colour: Colour, platform: Platform | None = None) -> Mesh:
    """The hull in `colour` with a dark bottom, decks, a house and a mast.

    Args:
        body: the hull's surface.
        size_m: length, beam, height.
        colour: of the hull.
        platform: a landing deck; parts above it are left out.
    """
    sides, rims = shell(body)
    low, high = sides.reshape(-1, 3).min(axis=0), sides.reshape(-1, 3).max(axis=0)
    paint_z = BOOT_TOP * min(low[2], 0.0)
    parts = [flat_shaded(below(sides, paint_z), KEEL), flat_shaded(above(sides, paint_z), colour)]
    rise = max(size_m[2] - (high[2] - low[2]), MIN_RISE * size_m[0])
    twin = len(rims) > 1
    parts += [flat_shaded(lid(rim), colour if twin else DECK) for rim in rims]
    gap = 2.0 * min(float(np.abs(rim[:, 1]).min()) for rim in rims) if twin else 0.0
    fit = _bridge if twin else _deckhouse
    fitted = [*fit(low, high, gap, rise, colour), *_mast(low, high, rise, twin, colour)]
    if platform is not None:
        fitted = [part for part in fitted if not _in_the_way(part, platform)] + _landing_deck(platform, low[2])
    return Mesh.join(*parts, *fitted)


# -- the hull's surface ------------------------------------------------------------------------------------------------


def shell(body: Body) -> tuple[Array, list[Array]]:
    """The hull without its decks: triangles [F, 3, 3] (m, b), and the rings [K, 3] around its openings."""
    faces = np.asarray(body.vertices_b, dtype=np.float64)[body.triangles]
    sides = faces[-normals(faces)[:, 2] < UPWARD]
    return sides, open_loops(sides)


def flat_shaded(faces: Array, colour: Colour) -> Mesh:
    """Triangles [F, 3, 3] (m, b), counter-clockwise from outside, each with its own normal."""
    vertices = faces.reshape(-1, 3).astype(np.float32)
    shade = np.broadcast_to(np.array(colour, np.uint8), vertices.shape).copy()
    return Mesh(vertices, np.repeat(normals(faces), 3, axis=0).astype(np.float32), shade)


def normals(faces: Array) -> Array:
    """Unit normals [F, 3]; zero for a face without area."""
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)


def above(faces: Array, z: float) -> Array:
    """The part of triangles [F, 3, 3] above the level z (down, m)."""
    return _cut(faces, z - faces[..., BELOW])


def below(faces: Array, z: float) -> Array:
    """The part of triangles [F, 3, 3] below the level z (down, m)."""
    return _cut(faces, faces[..., BELOW] - z)


def _cut(faces: Array, inside: Array) -> Array:
    """The parts of triangles [F, 3, 3] where `inside` [F, 3], linear on each, is positive; order is kept."""
    kept = []
    for corners, side in zip(faces, inside, strict=True):
        ring = []
        for here in range(3):
            there = (here + 1) % 3
            if side[here] >= 0.0:
                ring.append(corners[here])
            if side[here] * side[there] < 0.0:
                share = side[here] / (side[here] - side[there])
                ring.append(corners[here] + share * (corners[there] - corners[here]))
        kept += [(ring[0], ring[k], ring[k + 1]) for k in range(1, len(ring) - 1)]
    return np.array(kept).reshape(-1, 3, 3)


def open_loops(faces: Array) -> list[Array]:
    """Rings [K, 3] around the openings of a surface of triangles [F, 3, 3], ordered as a lid's seen from outside."""
    place: dict[tuple[int, ...], Array] = {}
    edges: set[tuple] = set()
    for corners in faces:
        keys = [tuple(np.rint(corner / GRID_M).astype(int).tolist()) for corner in corners]
        place.update(zip(keys, corners, strict=True))
        for a, b in ((0, 1), (1, 2), (2, 0)):
            if keys[a] == keys[b]:
                continue
            if (keys[b], keys[a]) in edges:
                edges.remove((keys[b], keys[a]))
            else:
                edges.add((keys[a], keys[b]))
    following = {b: a for a, b in edges}  # the edges of a lid run opposite to those of the faces
    rings = []
    while following:
        start, here = following.popitem()
        ring = [start]
        while here != start and here in following:
            ring.append(here)
            here = following.pop(here)
        rings.append(np.array([place[key] for key in ring]))
    return [ring for ring in rings if len(ring) > 2]


def lid(ring: Array) -> Array:
    """Triangles [K, 3, 3] from the centre of a ring [K, 3]."""
    hub = np.broadcast_to(ring.mean(axis=0), ring.shape)
    return np.stack([hub, ring, np.roll(ring, -1, axis=0)], axis=1)


# -- the superstructure ------------------------------------------------------------------------------------------------


def _slab(outline: list[tuple[float, float]], top: float, bottom: float, colour: Colour) -> Mesh:
    """A flat plate with the outline (x, y) between two levels z, m."""
    return loft(np.array([[(x, y, z) for x, y in outline] for z in (bottom, top)]), colour)


def _house(x: tuple[float, float], half: float, foot: float, rise: float, colour: Colour) -> list[Mesh]:
    """A house from x[0] to x[1] with a raked front, windows around it and a roof in the vehicle's colour."""
    aft, fore = x
    rake = 0.55 * rise

    def walls(low: float, high: float, grow: float, shade: Colour) -> Mesh:
        rings: list[list[tuple[float, float, float]]] = []
        for part in (low, high):
            wide, front, z = half * (1 - 0.1 * part) + grow, fore - rake * part + grow, foot - rise * part
            rings.append([(front, -wide, z), (front, wide, z), (aft - grow, wide, z), (aft - grow, -wide, z)])
        return loft(np.array(rings), shade)

    edge = 0.02 * (fore - aft)
    return [walls(0.0, 1.0, 0.0, HOUSE), walls(0.45, 0.82, 0.4 * edge, GLASS), walls(1.0, 1.12, edge, colour)]


def _bridge(low: NDArray, high: NDArray, gap: float, rise: float, colour: Colour) -> list[Mesh]:
    """Cross beams between two hulls, a pointed plate, and a house on it."""
    length, deck = high[0] - low[0], low[2]
    thick, half = 0.016 * length, 0.5 * gap + 0.12 * (high[1] - 0.5 * gap)
    x = low[0] + length * np.array([0.16, 0.62, 0.84])
    plate = [(x[0], -half), (x[1], -half), (x[2], 0.0), (x[1], half), (x[0], half)]
    beams = [
        box(
            (low[0] + at * length - 1.2 * thick, 0.86 * low[1], deck - 1.2 * thick),
            (low[0] + at * length + 1.2 * thick, 0.86 * high[1], deck),
            METAL,
        )
        for at in (0.22, 0.6)
    ]
    top = deck - 2.2 * thick
    house = _house((low[0] + 0.24 * length, low[0] + 0.58 * length), 0.62 * half, top, 0.36 * rise, colour)
    return [*beams, _slab(plate, top, deck - 1.2 * thick, DECK), *house]


def _in_the_way(part: Mesh, platform: Platform) -> bool:
    """Whether a part reaches above the platform within its outline."""
    low, high = part.vertices_b.min(axis=0), part.vertices_b.max(axis=0)
    centre, half = np.array(platform.centre_b), np.array(platform.half_m)
    beside = (low[:2] > centre[:2] + half) | (high[:2] < centre[:2] - half)
    return bool(low[2] < centre[2] and not beside.any())


def _landing_deck(platform: Platform, foot: float) -> list[Mesh]:
    """A pad with a cross, on four posts that stand at the level `foot` (z, m)."""
    (x, y, z), (a, b) = platform.centre_b, platform.half_m
    thick, arm = 0.06 * min(a, b), 0.1 * min(a, b)
    parts = [box((x - a, y - b, z), (x + a, y + b, z + thick), PAD)]
    for long, wide in ((0.7 * min(a, b), arm), (arm, 0.7 * min(a, b))):
        parts.append(box((x - long, y - wide, z - 0.1 * thick), (x + long, y + wide, z), HOUSE))
    if foot > z + thick:
        for i, k in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            at = (x + 0.9 * i * a, y + 0.9 * k * b)
            post = ((at[0] - thick, at[1] - thick, z + thick), (at[0] + thick, at[1] + thick, foot))
            parts.append(box(*post, METAL))
    return parts


def _deckhouse(low: NDArray, high: NDArray, gap: float, rise: float, colour: Colour) -> list[Mesh]:
    """A house in the stern of a single hull, and a mark on deck that points forward."""
    length, beam, deck = high[0] - low[0], high[1] - low[1], low[2]
    x, half = low[0] + length * np.array([0.62, 0.9]), 0.3 * beam
    mark = _slab([(x[0], -half), (x[1], 0.0), (x[0], half)], deck - 0.012 * length, deck, colour)
    house = _house((low[0] + 0.12 * length, low[0] + 0.42 * length), 0.32 * beam, deck, 0.5 * rise, colour)
    return [mark, *house]


def _mast(low: NDArray, high: NDArray, rise: float, twin: bool, colour: Colour) -> list[Mesh]:
    """A mast with a yard and a lantern on top."""
    length, beam, deck = high[0] - low[0], high[1] - low[1], low[2]
    x, thick = low[0] + (0.32 if twin else 0.22) * length, 0.009 * length
    top, yard, lamp = deck - rise, deck - 0.8 * rise, 2.2 * thick
    return [
        box((x - thick, -thick, top), (x + thick, thick, deck), METAL),
        box((x - thick, -0.17 * beam, yard - thick), (x + thick, 0.17 * beam, yard + thick), METAL),
        box((x - lamp, -lamp, top - 2.0 * lamp), (x + lamp, lamp, top), colour),
    ]
