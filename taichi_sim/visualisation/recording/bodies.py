"""The body of a vehicle in b: its model's own surface, else a boat, an airplane or a flying wing of its size.

Every part is a loft: a row of closed sections joined by quads and capped at both ends. Triangles do not share vertices,
so each keeps its own normal and colour and the body looks faceted. Proportions are drawn by eye; no physics uses them.

The surface of a hull is painted at the waterline. Faces that point straight up are decks. A hull model may replace a
deck by one rectangle of the same area, so decks are drawn again across the hull's open edge. The superstructure (bridge
deck, house, mast) follows from the hull's extent and shows its attitude.

Airplanes and flying wings are drawn from span, chord, length and height about the centre of mass. Wings are coloured
above and dark below, so that the bank is visible from either side.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import BELOW
from taichi_sim.visualisation.recording.episode import Airframe, Array, Body, Platform, TeamTrack
from taichi_sim.visualisation.recording.palette import Colour

DECK: Colour = (205, 192, 165)
HOUSE: Colour = (238, 238, 232)
GLASS: Colour = (38, 52, 66)
KEEL: Colour = (92, 40, 36)
METAL: Colour = (96, 100, 106)
PAD: Colour = (52, 74, 66)
UPWARD = 0.99  # a face is a deck if its unit normal has at least this upward component
GRID_M = 1e-5  # corners closer than this are the same
BOOT_TOP = 0.25  # height above the waterline at which the paint changes, over the freeboard
MIN_RISE = 0.22  # least height of the mast above the deck in lengths, so that the attitude is visible
CHORD = 0.17  # default chord of the wing over the length
BALANCE = 0.3  # share of the mean chord that lies ahead of the centre of mass
THICK_WING, THICK_TAIL = 0.14, 0.1  # thickness over chord
Station = tuple[float, float, float, float]
"""Section of a wing: place along the span, x of the leading edge, chord, offset across the span; m."""
LEVEL = 0.5  # least vertical component of the normal of a face that is visible from above or below


@dataclass(frozen=True)
class Mesh:
    """Triangles as three vertices each, in order."""

    vertices_b: NDArray[np.float32]  # [3 F, 3] m
    normals_b: NDArray[np.float32]  # [3 F, 3] unit, outward
    colours: NDArray[np.uint8]  # [3 F, 3]

    @staticmethod
    def join(*parts: "Mesh") -> "Mesh":
        """Several meshes as one."""
        return Mesh(
            np.concatenate([part.vertices_b for part in parts]),
            np.concatenate([part.normals_b for part in parts]),
            np.concatenate([part.colours for part in parts]),
        )


def loft(sections: NDArray[np.floating], colour: Colour) -> Mesh:
    """A solid through `sections` [S, K, 3] (m, body frame), each a closed ring of K points."""
    after = np.roll(sections, -1, axis=1)
    a, b, c, d = sections[:-1], after[:-1], after[1:], sections[1:]
    sides = [np.stack(corners, axis=-2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    faces = np.concatenate([*sides, lid(sections[0]), lid(sections[-1])])
    # outward is away from the middle of the piece between two sections, because a long solid may be bent
    core = 0.5 * (sections[:-1] + sections[1:]).mean(axis=1)
    bay = np.repeat(np.arange(len(core)), sections.shape[1])
    ends = np.repeat([0, len(core) - 1], sections.shape[1])
    core = core[np.concatenate([bay, bay, ends])]
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    area = np.linalg.norm(normal, axis=1)
    keep = area > 1e-9 * area.max()
    faces, normal = faces[keep], normal[keep] / area[keep, None]
    inward = np.sum(normal * (faces.mean(axis=1) - core[keep]), axis=1) < 0.0
    faces[inward] = faces[inward, ::-1]
    normal[inward] *= -1.0
    vertices = faces.reshape(-1, 3).astype(np.float32)
    return Mesh(
        vertices,
        np.repeat(normal, 3, axis=0).astype(np.float32),
        np.broadcast_to(np.array(colour, np.uint8), vertices.shape).copy(),
    )


def box(low: tuple[float, float, float], high: tuple[float, float, float], colour: Colour) -> Mesh:
    """An upright box between two corners, m, body frame."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = [(y0, z0), (y1, z0), (y1, z1), (y0, z1)]
    return loft(np.array([[(x, y, z) for y, z in ring] for x in (x0, x1)]), colour)


def walls(
    foot: tuple[float, float, float], top: tuple[float, float, float], z: float, rise: float,
    part: tuple[float, float], grow: float, colour: Colour,
) -> Mesh:  # fmt: skip
    """Return the walls of a deckhouse between two fractions `part` of its height `rise` (m), moved outward by `grow`
    (m).

    The walls lean in from `foot`, at the level z, to `top`; each is (aft end, fore end, half width), m.
    """
    rings = []
    for share in part:
        aft, fore, wide = (low + share * (high - low) for low, high in zip(foot, top, strict=True))
        aft, fore, wide, up = aft - grow, fore + grow, wide + grow, z - share * rise
        rings.append([(fore, -wide, up), (fore, wide, up), (aft, wide, up), (aft, -wide, up)])
    return loft(np.array(rings), colour)


def boat(size_m: tuple[float, float, float], colour: Colour) -> Mesh:
    """A hull with a deckhouse and a mast. The third size is the hull's depth; the waterline is at half of it."""
    length, beam, depth = size_m
    x = length * np.array([-0.5, -0.3, 0.0, 0.25, 0.4, 0.5])
    half_deck = 0.5 * beam * np.array([0.86, 0.97, 1.0, 0.86, 0.5, 0.03])
    half_keel = 0.5 * beam * np.array([0.58, 0.66, 0.66, 0.42, 0.16, 0.01])
    z_deck = -0.5 * depth * np.array([1.0, 1.0, 1.04, 1.2, 1.4, 1.6])
    z_keel = 0.5 * depth * np.array([0.8, 1.0, 1.0, 0.95, 0.6, -0.2])

    def hull(bottom: float, top: float, shade: Colour) -> Mesh:
        """The hull between two levels given as fractions from keel (0) to deck (1)."""
        rings = []
        for level in (bottom, top):
            half = half_keel + level * (half_deck - half_keel)
            z = z_keel + level * (z_deck - z_keel)
            rings += [np.stack([x, -half, z], 1), np.stack([x, half, z], 1)]
        port_low, right_low, port_high, right_high = rings
        return loft(np.stack([port_high, right_high, right_low, port_low], axis=1), shade)

    house, sole, mast = 0.17 * length, -0.52 * depth, 0.012 * length
    yard = (-0.115 * length, -0.2 * beam, sole - 1.75 * house), (-0.085 * length, 0.2 * beam, sole - 1.65 * house)
    foot, top = (-0.24 * length, 0.14 * length, 0.31 * beam), (-0.22 * length, 0.05 * length, 0.26 * beam)
    return Mesh.join(
        hull(0.0, 0.38, KEEL),
        hull(0.38, 1.0, colour),
        hull(1.0, 1.03, DECK),
        walls(foot, top, sole, house, (0.0, 1.0), 0.0, HOUSE),
        walls(foot, top, sole, house, (0.5, 0.85), 0.004 * length, GLASS),
        walls(foot, top, sole, house, (1.0, 1.12), 0.012 * length, colour),
        box((-0.1 * length - mast, -mast, sole - 2.1 * house), (-0.1 * length + mast, mast, sole - house), METAL),
        box(*yard, METAL),
    )


def vessel(body: Body, size_m: tuple[float, float, float], colour: Colour, platform: Platform | None = None) -> Mesh:
    """The hull in `colour` with a dark bottom, decks, a house and a mast; parts above a landing deck are left out."""
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


def _slab(outline: list[tuple[float, float]], top: float, bottom: float, colour: Colour) -> Mesh:
    """A flat plate with the outline (x, y) between two levels z, m."""
    return loft(np.array([[(x, y, z) for x, y in outline] for z in (bottom, top)]), colour)


def _house(x: tuple[float, float], half: float, foot: float, rise: float, colour: Colour) -> list[Mesh]:
    """A house from x[0] to x[1] with a raked front, windows around it and a roof in the vehicle's colour."""
    aft, fore = x
    below, top, edge = (aft, fore, half), (aft, fore - 0.55 * rise, 0.9 * half), 0.02 * (fore - aft)
    looks = (((0.0, 1.0), 0.0, HOUSE), ((0.45, 0.82), 0.4 * edge, GLASS), ((1.0, 1.12), edge, colour))
    return [walls(below, top, foot, rise, *look) for look in looks]


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


def aircraft(size_m: tuple[float, float, float], airframe: Airframe | None, colour: Colour) -> Mesh:
    """Mesh of an aircraft; size_m is length, span, height. Without `airframe`, an airplane of default proportions."""
    airframe = airframe or Airframe(chord=CHORD * size_m[0], tail=True)
    return (_airplane if airframe.tail else _flying_wing)(size_m, airframe.chord, colour)


def _wing(stations: list[Station], thick: float, over: Colour, under: Colour, upright: bool = False) -> Mesh:
    """A wing of lens-shaped sections, coloured `over` above the chord and `under` below; `upright` makes a fin."""
    halves = []
    for bulge, shade in zip((-0.5, 0.5) if upright else (-0.6, 0.4), (over, under), strict=True):
        sections = []
        for along, lead, chord, off in stations:
            points = [(lead + x * chord, off + z * thick * chord) for x, z in ((0.0, 0.0), (-0.3, bulge), (-1.0, 0.0))]
            sections.append([(x, z, -along) if upright else (x, along, z) for x, z in points])
        halves.append(loft(np.array(sections), shade))
    return Mesh.join(*halves)


def _tube(x: list[float], r: list[float], shade: Colour) -> Mesh:
    """A tube of round sections with radii r at stations x."""
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    sections = [[(xi, ri * np.cos(a), ri * np.sin(a)) for a in angle] for xi, ri in zip(x, r, strict=True)]
    return loft(np.array(sections), shade)


def _propeller(x: float, radius: float) -> Mesh:
    """Two vertical blades at station x."""
    thick = 0.05 * radius
    return box((x - thick, -2.0 * thick, -radius), (x + thick, 2.0 * thick, radius), METAL)


def _airplane(size_m: tuple[float, float, float], chord: float, colour: Colour) -> Mesh:
    """A high wing, a fuselage, a tail, a fin and a propeller in front."""
    length, span, height = size_m
    radius, nose, stern = 0.062 * length, 0.388 * length, -0.55 * length
    half, tail_half, tail = 0.5 * span, 0.16 * span, 0.8 * chord
    fin = max(height - radius, 0.16 * length)
    root, tip = -0.9 * radius, -0.9 * radius - 0.025 * span  # dihedral: the tips are higher
    lead = BALANCE * chord
    kink = (0.7 * half, lead - 0.04 * chord, 1.0 * chord, root + 0.7 * (tip - root))
    panels, tips = [], []
    for side in (-1.0, 1.0):
        at = (side * kink[0], *kink[1:])
        panels.append(_wing([(0.0, lead, 1.1 * chord, root), at], THICK_WING, HOUSE, KEEL))
        tips.append(_wing([at, (side * half, lead - 0.2 * chord, 0.7 * chord, tip)], THICK_WING, colour, KEEL))
    ends = [(side * tail_half, stern + 0.8 * tail, 0.8 * tail, -0.2 * radius) for side in (-1.0, 1.0)]
    tailplane = [ends[0], (0.0, stern + tail, tail, -0.2 * radius), ends[1]]
    upright = [(0.0, stern + 1.3 * tail, 1.3 * tail, 0.0), (fin, stern + 0.7 * tail, 0.7 * tail, 0.0)]
    stations = [stern, -0.25 * length, 0.0, 0.25 * length, nose]
    return Mesh.join(
        _tube(stations, [0.2 * radius, 0.5 * radius, radius, radius, 0.7 * radius], HOUSE),
        _tube([nose, nose + 0.6 * radius, nose + radius], [0.7 * radius, 0.45 * radius, 0.06 * radius], colour),
        _propeller(nose + 0.45 * radius, 2.4 * radius),
        box((0.08 * length, -0.7 * radius, -1.2 * radius), (0.24 * length, 0.7 * radius, -0.7 * radius), GLASS),
        *panels,
        *tips,
        _wing(tailplane, THICK_TAIL, colour, KEEL),
        _wing(upright, THICK_TAIL, colour, colour, upright=True),
    )


def _flying_wing(size_m: tuple[float, float, float], chord: float, colour: Colour) -> Mesh:
    """A swept wing with winglets, of the given length; a pod and a propeller behind."""
    length, span, height = size_m
    half, root, tip = 0.5 * span, 1.2 * chord, 0.8 * chord
    sweep = max(length - tip, 0.0)  # of the leading edge from root to tip, m
    lead = 0.5 * sweep + BALANCE * chord  # the mean chord is half way to the tip
    panels, tips = [], []
    for side in (-1.0, 1.0):
        at = (side * 0.7 * half, lead - 0.7 * sweep, root + 0.7 * (tip - root), 0.0)
        end = (side * half, lead - sweep, tip, 0.0)
        panels.append(_wing([(0.0, lead, root, 0.0), at], THICK_WING, HOUSE, KEEL))
        tips.append(_wing([at, end], THICK_WING, colour, KEEL))
        winglet = [(0.0, lead - sweep, tip, side * half), (height, lead - sweep - 0.5 * tip, 0.5 * tip, side * half)]
        tips.append(_wing(winglet, THICK_TAIL, colour, colour, upright=True))
    radius, stern = 0.16 * root, lead - root
    stations = [stern, lead - 0.5 * root, lead, lead + 0.3 * radius]
    pod = _tube(stations, [0.4 * radius, radius, 0.7 * radius, 0.1 * radius], colour)
    return Mesh.join(*panels, *tips, pod, _propeller(stern - 0.2 * radius, 2.2 * radius))


def body_mesh(team: TeamTrack, colour: Colour) -> Mesh:
    """Mesh of a vehicle of `team`, in its colour."""
    if team.body is None:
        return boat(team.size_m, colour) if team.on_water else aircraft(team.size_m, team.airframe, colour)
    return vessel(team.body, team.size_m, colour, team.deck) if team.on_water else _flown(team.body, colour)


def _flown(body: Body, colour: Colour) -> Mesh:
    """Mesh of an aircraft's surface, in its colour from above and dark from below, so that a bank is visible."""
    faces = np.asarray(body.vertices_b, dtype=np.float64)[body.triangles]
    down = normals(faces)[:, 2]
    over, under = down < -LEVEL, down > LEVEL
    shades = ((over, colour), (under, KEEL), (~(over | under), METAL))
    return Mesh.join(*(flat_shaded(faces[which], shade) for which, shade in shades))
