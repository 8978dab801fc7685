"""The body of a vehicle: its model's own surface, else a boat, an airplane or a flying wing of its size, in b.

Airplanes and flying wings are drawn from span, chord, length and height about the centre of mass. Wings are coloured
above and dark below, so that the bank is visible from either side. The proportions of tail and fuselage are drawn by
eye; no physics uses them.
"""

import numpy as np

from taichi_sim.recording.episode import Airframe, Body, TeamTrack
from taichi_sim.recording.meshes import GLASS, HOUSE, KEEL, METAL, Mesh, boat, box, loft
from taichi_sim.recording.palette import Colour
from taichi_sim.recording.vessel import flat_shaded, normals, vessel

CHORD = 0.17  # default chord of the wing over the length
BALANCE = 0.3  # share of the mean chord that lies ahead of the centre of mass
THICK_WING, THICK_TAIL = 0.14, 0.1  # thickness over chord

Station = tuple[float, float, float, float]
"""Section of a wing: place along the span, x of the leading edge, chord, offset across the span; m."""
LEVEL = 0.5  # least vertical component of the normal of a face that is visible from above or below


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
    return Mesh.join(
        _tube(
            [stern, -0.25 * length, 0.0, 0.25 * length, nose],
            [0.2 * radius, 0.5 * radius, radius, radius, 0.7 * radius],
            HOUSE,
        ),
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
    return Mesh.join(
        *panels,
        *tips,
        _tube(
            [stern, lead - 0.5 * root, lead, lead + 0.3 * radius],
            [0.4 * radius, radius, 0.7 * radius, 0.1 * radius],
            colour,
        ),
        _propeller(stern - 0.2 * radius, 2.2 * radius),
    )


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
