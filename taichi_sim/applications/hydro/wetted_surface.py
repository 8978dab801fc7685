"""Wetted surface of a hull as flat panels, its integrals (volume, waterplane, centre of buoyancy, stiffness), and
frames.

The frame of all of taichi_sim/applications/hydro is that of the boundary-element code: x forward, y to port, z up,
origin CO on the design waterline. The vehicle's frame (forward-right-down) is half a turn about x from it, so sway,
heave, pitch, yaw and the heading change sign. `turned_matrix` and `turned_load` convert in both directions. A panel has
four corners, ordered so that the right-hand normal points out of the hull. The last two corners of a triangle are the
same point.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
X, Y, Z = 0, 1, 2  # components of points and area vectors
TURN = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # signs of a load or motion in the other frame
TURN_HORIZONTAL = np.array([1.0, -1.0, -1.0])  # signs of surge, sway and yaw in the other frame
PLANES = {1: "port and starboard", 0: "fore and aft"}  # axis normal to a plane of symmetry -> halves that are alike


@dataclass(frozen=True)
class WettedSurface:
    """Panels [n, 4, 3] (m) of a wetted hull, or of its part on the positive sides of `planes`."""

    panels: Array
    planes: tuple[int, ...] = ()  # axes along which the other half is the mirror image

    def __len__(self) -> int:
        """Number of panels, without images."""
        return len(self.panels)

    @cached_property
    def whole(self) -> Array:
        """Panels [n, 4, 3] with images."""
        panels = self.panels
        for axis in self.planes:
            panels = np.concatenate([panels, mirrored(panels, axis)])
        return panels

    @cached_property
    def area(self) -> Array:
        """Area vectors [n, 3] of all panels, out of the hull, m^2."""
        return area_vectors(self.whole)

    @cached_property
    def edge(self) -> Array:
        """Longest edge of each panel [n], without images, m."""
        return np.linalg.norm(np.roll(self.panels, -1, axis=1) - self.panels, axis=2).max(axis=1)

    @cached_property
    def volume(self) -> float:
        """Displaced volume, m^3."""
        return float(self.integral(lambda x: x[..., Z])[2])

    @cached_property
    def centre_of_buoyancy(self) -> Array:
        """Centroid of the displaced volume [3], m."""
        x, y = (-self.integral(lambda p, a=a: p[..., a] * p[..., Z])[2] for a in (X, Y))
        z = self.integral(lambda p: p[..., Z] ** 2 / 2)[2]
        return np.array([-x, -y, z]) / self.volume

    @cached_property
    def waterplane(self) -> dict[str, float]:
        """Area A (m^2) of the waterplane, and its integrals of x, y (m^3) and xx, yy, xy (m^4)."""
        of = {
            "A": lambda p: np.ones(p.shape[:-1]), "x": lambda p: p[..., X], "y": lambda p: p[..., Y],
            "xx": lambda p: p[..., X] ** 2, "yy": lambda p: p[..., Y] ** 2, "xy": lambda p: p[..., X] * p[..., Y],
        }  # fmt: skip
        return {name: float(-self.integral(f)[2]) for name, f in of.items()}

    def stiffness(self, mass: float, cg: Array, rho: float, g: float) -> Array:
        """Stiffness C [6, 6] about CO (N/m, N, N m) of the water and of `mass` (kg) at `cg` (m) (Fossen 2011, sec.
        4.2).
        """
        w, V, B = self.waterplane, self.volume, self.centre_of_buoyancy
        C = np.zeros((6, 6))
        C[2, 2], C[2, 3], C[2, 4] = w["A"], w["y"], -w["x"]
        C[3, 3], C[3, 4], C[4, 4] = w["yy"] + V * B[2], -w["xy"], w["xx"] + V * B[2]
        C[3, 5], C[4, 5] = -V * B[0], -V * B[1]
        C *= rho * g
        C[3, 3] -= mass * g * cg[2]
        C[4, 4] -= mass * g * cg[2]
        C[3, 5] += mass * g * cg[0]
        C[4, 5] += mass * g * cg[1]
        upper = np.triu(C)
        upper[2, 4] = C[2, 4]
        C = upper + np.triu(upper, 1).T
        C[5] = 0.0  # yaw meets no restoring moment
        C[np.abs(C) < 1e-9 * np.abs(C).max()] = 0.0
        return C

    def integral(self, f) -> Array:
        """Integral [3] of f n dS over all panels; exact for quadratic f on flat panels, of warped ones the mean of both
        diagonals.
        """
        a, b, c, d = np.moveaxis(self.whole, 1, 0)
        total = np.zeros(3)
        for p, q, r in ((a, b, c), (a, c, d), (a, b, d), (b, c, d)):
            area = np.cross(q - p, r - p) / 4
            mean = (f((p + q) / 2) + f((q + r) / 2) + f((r + p) / 2)) / 3
            total += (mean[:, None] * area).sum(axis=0)
        return total


def area_vectors(panels: Array) -> Array:
    """Area vectors [n, 3] of panels [n, 4, 3], out of the hull, m^2."""
    return 0.5 * np.cross(panels[:, 2] - panels[:, 0], panels[:, 3] - panels[:, 1])


def as_triangles(panels: Array, short: float) -> Array:
    """Convert panels [n, 4, 3] with an edge shorter than `short` (m) to triangles (last corner doubled)."""
    length = np.linalg.norm(np.roll(panels, -1, axis=1) - panels, axis=2)  # of the edge after each corner
    order = (length.argmin(axis=1)[:, None] + [2, 3, 0, 1]) % 4
    three = np.take_along_axis(panels, order[..., None], axis=1)
    three[:, 3] = three[:, 2]
    return np.where((length.min(axis=1) < short)[:, None, None], three, panels)


def mirrored(panels: Array, axis: int) -> Array:
    """Mirror images of panels in the plane through CO normal to `axis`; normals stay outward."""
    image = panels.copy()
    image[..., axis] *= -1
    return reverse(image)


def reverse(panels: Array) -> Array:
    """Panels [n, 4, 3] with corners in reverse order; triangles keep their doubled corner last."""
    three = (panels[:, 2] == panels[:, 3]).all(axis=1)
    return np.where(three[:, None, None], panels[:, [1, 0, 2, 3]], panels[:, [0, 3, 2, 1]])


def turned_matrix(matrix):
    """Convert A, B or C [..., 6, 6] to the other frame."""
    return matrix * TURN[:, None] * TURN


def turned_load(load):
    """Convert a load [..., 6] to the other frame."""
    return load * TURN


def cos_sin(degrees):
    """Cosine and sine of angles (deg) with exact zeros at multiples of 90 deg."""
    angle = np.deg2rad(degrees)
    return tuple(np.where(np.abs(v) < 1e-15, 0.0, v) for v in (np.cos(angle), np.sin(angle)))
