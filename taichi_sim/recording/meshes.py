"""Triangle meshes in the body frame b (x forward, y right, z down), and a boat whose origin is the reference point.

Every part is a loft: a row of closed sections joined by quads and capped at both ends. Triangles do not
share vertices, so each keeps its own normal and colour and the body looks faceted.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from taichi_sim.recording.palette import Colour

DECK: Colour = (205, 192, 165)
HOUSE: Colour = (238, 238, 232)
GLASS: Colour = (38, 52, 66)
KEEL: Colour = (92, 40, 36)
METAL: Colour = (96, 100, 106)
PAD: Colour = (52, 74, 66)


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
    caps = []
    for ring in (sections[0], sections[-1]):
        hub = np.broadcast_to(ring.mean(axis=0), ring.shape)
        caps.append(np.stack([hub, ring, np.roll(ring, -1, axis=0)], axis=1))
    faces = np.concatenate(sides + caps)
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


def boat(size_m: tuple[float, float, float], colour: Colour) -> Mesh:
    """A hull with a deckhouse and a mast. The third size is the hull's depth; the waterline is at half of it."""
    length, beam, depth = size_m
    x = length * np.array([-0.5, -0.3, 0.0, 0.25, 0.4, 0.5])
    half_deck = 0.5 * beam * np.array([0.86, 0.97, 1.0, 0.86, 0.5, 0.03])
    half_keel = 0.5 * beam * np.array([0.58, 0.66, 0.66, 0.42, 0.16, 0.01])
    z_deck = -0.5 * depth * np.array([1.0, 1.0, 1.04, 1.2, 1.4, 1.6])
    z_keel = 0.5 * depth * np.array([0.8, 1.0, 1.0, 0.95, 0.6, -0.2])

    def hull(top: NDArray[np.floating], bottom: NDArray[np.floating], shade: Colour) -> Mesh:
        """The hull between two levels given as fractions from keel (0) to deck (1)."""
        rings = []
        for level in (bottom, top):
            half = half_keel + level * (half_deck - half_keel)
            z = z_keel + level * (z_deck - z_keel)
            rings += [np.stack([x, -half, z], 1), np.stack([x, half, z], 1)]
        port_low, right_low, port_high, right_high = rings
        return loft(np.stack([port_high, right_high, right_low, port_low], axis=1), shade)

    whole = np.ones_like(x)
    house = 0.17 * length
    sole = -0.52 * depth
    front, back, half = 0.14 * length, -0.24 * length, 0.31 * beam
    top_front, top_back, top_half = 0.05 * length, -0.22 * length, 0.26 * beam

    def cabin(low: float, high: float, grow: float, shade: Colour) -> Mesh:
        """The deckhouse between two fractions of its height, its walls leaning in."""
        rings = []
        for part in (low, high):
            fore = front + part * (top_front - front) + grow
            aft = back + part * (top_back - back) - grow
            wide = half + part * (top_half - half) + grow
            z = sole - part * house
            rings.append([(fore, -wide, z), (fore, wide, z), (aft, wide, z), (aft, -wide, z)])
        return loft(np.array(rings), shade)

    mast = 0.012 * length
    return Mesh.join(
        hull(0.38 * whole, 0.0 * whole, KEEL),
        hull(whole, 0.38 * whole, colour),
        hull(1.03 * whole, whole, DECK),
        cabin(0.0, 1.0, 0.0, HOUSE),
        cabin(0.5, 0.85, 0.004 * length, GLASS),
        cabin(1.0, 1.12, 0.012 * length, colour),
        box((-0.1 * length - mast, -mast, sole - 2.1 * house), (-0.1 * length + mast, mast, sole - house), METAL),
        box(
            (-0.115 * length, -0.2 * beam, sole - 1.75 * house),
            (-0.085 * length, 0.2 * beam, sole - 1.65 * house),
            METAL,
        ),
    )
