"""Two extensions of capytaine: meshes whose images keep the order of corners, and a damping lid.

On the damping lid the free-surface condition is

    phi_z = K (1 + i epsilon) phi,    K = omega^2 / g,

instead of phi_z = K phi (Chen 2004, "fairly perfect fluid"), with one epsilon for all frequencies. It is a friction
epsilon omega on the vertical motion; like that of eddies, it grows with velocity. The Green function contains the
undamped condition. The lid therefore adds i epsilon K S phi to Green's theorem (direct), or to the equation of the
sources.
"""

import numpy as np
from capytaine import FloatingBody, Mesh, ReflectionSymmetricMesh, rigid_body_dofs
from capytaine.bem.engines import DefaultMatrixEngine
from numpy.typing import NDArray

from taichi_sim.applications.hydro.wetted_surface import WettedSurface, mirrored

MIRRORS = {0: "yOz", 1: "xOz"}  # capytaine's name of the plane normal to an axis


class DampedEngine(DefaultMatrixEngine):
    """Engine whose matrices include a damping lid: the last `lid` panels of each image."""

    def __init__(self, lid: int, damping: float, direct: bool):
        """Set the number of `lid` panels, `damping` = epsilon K (1/m), and whether capytaine's method is `direct`."""
        super().__init__()
        self._lid, self._damping, self._direct = slice(-lid, None) if lid else slice(0), damping, direct

    def _build_matrices_with_symmetries(self, mesh1, mesh2, **water):
        S, D = super()._build_matrices_with_symmetries(mesh1, mesh2, **water)
        blocks = getattr(S, "blocks", [S]), getattr(D, "blocks", [D])  # influence of one part on each image
        where = (slice(None), self._lid) if self._direct else (self._lid, slice(None))
        for of_s, of_d in zip(*blocks, strict=True):
            of_d[where] = 1j * self._damping * of_s[where]
        np.einsum("ii->i", blocks[1][0][self._lid, self._lid])[:] += 1.0
        return S, D


class MirroredMesh(ReflectionSymmetricMesh):
    """A symmetric mesh whose images keep the first corner of each panel; no panel is removed.

    capytaine's own images begin with another corner, so that the centres of twisted panels would not be symmetric.
    """

    def __init__(self, panels: NDArray[np.float64], planes: tuple[int, ...]):
        """Take panels [n, 4, 3] on the positive sides of `planes`."""
        *inner, axis = planes
        super().__init__(as_mesh(panels, tuple(inner)), plane=MIRRORS[axis])
        self.other_half = as_mesh(mirrored(panels, axis), tuple(inner))
        self._whole = as_mesh(WettedSurface(panels, planes).whole)

    def merged(self, name=None):
        """Return all panels in one mesh."""
        return self._whole


def as_mesh(panels: NDArray[np.float64], planes: tuple[int, ...] = ()) -> Mesh | MirroredMesh:
    """Convert panels [n, 4, 3] on the positive sides of `planes` to capytaine's mesh."""
    if planes:
        return MirroredMesh(panels, planes)
    faces = np.arange(4 * len(panels)).reshape(-1, 4)
    three = (panels[:, 2] == panels[:, 3]).all(axis=1)
    faces[three, 3] = faces[three, 2]
    return Mesh(panels.reshape(-1, 3), faces, auto_clean=False, auto_check=False)


def as_body(hull: WettedSurface, lids: NDArray[np.float64]) -> FloatingBody:
    """Convert the hull to capytaine's rigid body about CO; in each image, panels of lids [n, 4, 3] follow those of
    the hull.
    """
    body = FloatingBody(as_mesh(hull.panels, hull.planes), rigid_body_dofs(rotation_center=(0.0, 0.0, 0.0)))
    body.mesh_including_lid = as_mesh(np.concatenate([hull.panels, lids]), hull.planes)
    body.hull_mask = np.tile(np.arange(len(hull) + len(lids)) < len(hull), 2 ** len(hull.planes))
    return body
