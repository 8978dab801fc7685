"""A multirotor's surface for pictures: a hub with a nose, an arm and a disc for each rotor, legs. Physics ignores
it.
"""

import numpy as np
from numpy.typing import NDArray

from taichi_sim.models.uav.multirotor.params import MultirotorParams

CORNERS = 16  # corners of a rotor's disc
THICK_DISC, THICK_ARM, THICK_LEG = 0.05, 0.1, 0.06  # half heights and half widths over the rotor's radius
HUB = (0.42, 0.3, 0.16)  # half length, half width and half height of the hub over the mean arm
NOSE = 0.5  # length of the nose over the hub's half length
LEG = 0.4  # position of a leg along its arm, as a fraction

Surface = tuple[NDArray[np.float64], NDArray[np.int64]]


def body_surface(craft: MultirotorParams) -> Surface:
    """Vertices [N, 3] (m, b, from the centre of gravity) and triangles [F, 3], counter-clockwise from outside."""
    arms, R = craft.arms, craft.rotor.radius
    reach = float(np.linalg.norm(arms[:, :2], axis=1).mean())
    half = reach * np.array(HUB)
    parts = [_box(-half, half), _nose(half)]
    level = float(arms[:, 2].mean())
    for arm in arms:
        parts += [_beam(np.array([0.0, 0.0, min(level, 0.0)]), arm, THICK_ARM * R), _disc(arm, R)]
        foot = LEG * arm * (1.0, 1.0, 0.0)
        parts.append(_beam(foot, foot + (0.0, 0.0, craft.body.below), THICK_LEG * R))
    return _joined(parts)


def _joined(parts: list[Surface]) -> Surface:
    """Several surfaces as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [triangles + start for start, (_, triangles) in zip(first, parts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def _prism(low: NDArray[np.float64], high: NDArray[np.float64]) -> Surface:
    """The surface between two rings [K, 3] of as many corners; `high` is where the normal of `low` points."""
    K = len(low)
    here = np.arange(K)
    after = (here + 1) % K
    sides = np.concatenate((np.stack((here, after, K + after), 1), np.stack((here, K + after, K + here), 1)))
    fan = np.arange(1, K - 1)
    ends = (np.stack((0 * fan, fan + 1, fan), 1), K + np.stack((0 * fan, fan, fan + 1), 1))
    return np.concatenate((low, high)), np.concatenate((sides, *ends))


def _box(low: NDArray[np.float64], high: NDArray[np.float64]) -> Surface:
    """An upright box between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    ring = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    return _prism(np.column_stack((ring, np.full(4, z0))), np.column_stack((ring, np.full(4, z1))))


def _nose(half: NDArray[np.float64]) -> Surface:
    """A wedge ahead of the hub, so that a picture tells front from rear."""
    x, y, z = half
    tip = (1.0 + NOSE) * x
    low = np.array([(x, -y, z), (x, y, z), (tip, 0.1 * y, 0.3 * z), (tip, -0.1 * y, 0.3 * z)])
    high = np.array([(x, -y, -z), (x, y, -z), (tip, 0.1 * y, -0.3 * z), (tip, -0.1 * y, -0.3 * z)])
    return _prism(low, high)


def _beam(start: NDArray[np.float64], end: NDArray[np.float64], half: float) -> Surface:
    """A square beam between two points."""
    along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
    side = np.cross(along, (0.0, 0.0, 1.0) if abs(along[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    up = np.cross(along, side)
    ring = half * np.stack((-side - up, side - up, side + up, up - side))
    return _prism(start + ring, end + ring)


def _disc(hub: NDArray[np.float64], R: float) -> Surface:
    """A rotor's horizontal disc."""
    angle = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
    ring = R * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(CORNERS)))
    half = np.array([0.0, 0.0, THICK_DISC * R])
    return _prism(hub + ring - half, hub + ring + half)
