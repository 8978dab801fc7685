"""The boundary-element problem of one hull at one frequency: linear potential flow at zero speed.

Sources of strength sigma on the hull and its lids, and capytaine's Green function of the water's surface:

    potential phi = S sigma,    normal velocity = K sigma  (normal out of the hull, into the water),

for waves exp(-i omega t). Right-hand sides are the six motions of unit velocity and the scattering of the waves of each
heading. Planes of symmetry divide sources into even and odd ones, whose matrices are sums and differences over the
images: half the unknowns twice, or a quarter four times.

Lids are lids.py's: the inner one is rigid (no normal velocity). On the damping lid the surface's condition is

    phi_z = K (1 + i epsilon) phi,    K = omega^2 / g,

in place of phi_z = K phi (Chen 2004, "fairly perfect fluid"; Rayleigh's friction mu = epsilon omega on the vertical
motion of the surface). As S has the undamped condition built in, the lid's sources are sigma = -i epsilon K phi.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro.frames import cos_sin
from hydro.surface import Surface, area_vectors, mirrored

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
PARITY = {  # of the six motions' normal velocities, in the plane normal to an axis
    0: np.array([-1, 1, 1, 1, -1, -1]),
    1: np.array([1, -1, 1, -1, 1, -1]),
}


@dataclass(frozen=True)
class Tank:
    """A hull with its lids in water; positive sides of the hull's planes of symmetry."""

    hull: Surface
    inner_lid: Array  # [n, 4, 3]
    gap_lid: Array  # [n, 4, 3]
    rho: float  # kg/m^3
    g: float  # m/s^2
    depth: float  # m; inf is deep
    friction: float  # mu of the gap lid, 1/s

    @cached_property
    def images(self) -> list[tuple[int, ...]]:
        """Axes that are turned over, of the hull itself and of each image."""
        planes = self.hull.planes
        return [tuple(a for a, on in zip(planes, choice, strict=True) if on)
                for choice in product((False, True), repeat=len(planes))]  # fmt: skip

    @cached_property
    def characters(self) -> list[dict[int, int]]:
        """Each symmetry of solutions: sign in each plane's image."""
        planes = self.hull.planes
        return [dict(zip(planes, signs, strict=True)) for signs in product((1, -1), repeat=len(planes))]


class Solution(NamedTuple):
    """Of one frequency, in the frame of surface.py; n headings."""

    added_mass: Array  # [6, 6]
    damping: Array  # [6, 6]
    froude_krylov: Complex  # [n, 6] per metre of amplitude
    diffraction: Complex  # [n, 6]
    sources: Complex  # [panel, 6 + n] strength times area of all panels and images: motions of unit velocity, waves
    points: Array  # [panel, 3] where they are


def dispersion(omega: float, depth: float, g: float) -> float:
    """Wavenumber, rad/m, by Newton's method."""
    k = deep = omega**2 / g
    if np.isfinite(depth):
        k = deep / np.sqrt(np.tanh(deep * depth))
        for _ in range(50):
            t = np.tanh(k * depth)
            k -= (k * t - deep) / (t + k * depth * (1 - t * t))
    return float(k)


def image_sign(character: dict[int, int], image: tuple[int, ...]) -> int:
    """Of sources on an image, for those on the hull itself."""
    return int(np.prod([character[axis] for axis in image]))


def generalised_normals(centre: Array, area: Array) -> Array:
    """Area vectors and their moments about CO [n, 6]."""
    return np.concatenate([area, np.cross(centre, area)], axis=1)


def attenuation(k: float, z: Array, depth: float) -> tuple[Array, Array]:
    """cosh k(z+h) / cosh kh, and the same with sinh."""
    if k * depth > 20:
        return np.exp(k * z), np.exp(k * z)
    return np.cosh(k * (z + depth)) / np.cosh(k * depth), np.sinh(k * (z + depth)) / np.cosh(k * depth)


def incident(tank: Tank, omega: float, k: float, heading_deg: Array, points: Array) -> tuple[Complex, Complex]:
    """Potential [point, heading] and velocity [point, heading, 3] of waves of unit amplitude, crest at CO at t = 0."""
    c, s = cos_sin(heading_deg)
    wave = np.exp(1j * k * (points[:, :1] * c + points[:, 1:2] * s))
    cosh, sinh = attenuation(k, points[:, 2:], tank.depth)
    phi = -1j * tank.g / omega * cosh * wave
    return phi, np.stack([1j * k * c * phi, 1j * k * s * phi, -1j * tank.g * k / omega * sinh * wave], axis=-1)


def solve(tank: Tank, omega: float, heading_deg: Array, green: Any = None) -> Solution:
    """Loads and sources at `omega` (rad/s); at infinity only the added mass has a meaning, and lids are left out."""
    import scipy.linalg
    from capytaine import Delhommeau  # heavy, and optional

    green = green or Delhommeau()
    endless = not np.isfinite(omega)
    none = np.empty((0, 4, 3))
    inner, gap = (none, none) if endless else (tank.inner_lid, tank.gap_lid if tank.friction else none)
    panels = np.concatenate([tank.hull.panels, inner, gap])
    n_hull, n_gap = len(tank.hull), len(gap)
    in_gap = slice(len(panels) - n_gap, len(panels))
    k = np.inf if endless else dispersion(omega, tank.depth, tank.g)
    mesh, sides = _mesh(panels), [_mesh(_image(panels, image)) for image in tank.images]
    blocks = [
        green.evaluate(side, mesh, free_surface=0.0, water_depth=tank.depth, wavenumber=k,
                       diagonal_term_in_double_layer=not image)
        for side, image in zip(sides, tank.images, strict=True)
    ]  # fmt: skip
    centre, area = mesh.faces_centers, area_vectors(panels)
    unit = area / np.linalg.norm(area, axis=1)[:, None]
    motions = generalised_normals(centre, unit)
    motions[n_hull:] = 0.0
    headings = np.empty(0) if endless else np.asarray(heading_deg, dtype=float)
    waves = [incident(tank, omega, k, headings, side.faces_centers) for side in sides] if len(headings) else []
    damping = 0.0 if endless else tank.friction * omega / tank.g  # epsilon K
    radiation, diffraction = np.zeros((6, 6), dtype=complex), np.zeros((len(headings), 6), dtype=complex)
    sources = np.zeros((len(tank.images), len(panels), 6 + len(headings)), dtype=complex)
    weights = generalised_normals(centre, area)[:n_hull]
    for character in tank.characters:
        signs = [image_sign(character, image) for image in tank.images]
        S, K = (sum(sign * block[i] for sign, block in zip(signs, blocks, strict=True)) for i in (0, 1))
        modes = [m for m in range(6) if all(PARITY[a][m] == sign for a, sign in character.items())]
        right = np.concatenate([motions[:, modes].astype(complex), np.zeros((len(panels), len(headings)))], axis=1)
        if waves:
            right[:, len(modes):] = _scattering(waves, signs, tank.images, unit, n_hull, in_gap, damping)
        K = K.astype(complex)
        if n_gap:
            K[in_gap] = 1j * damping * S[in_gap]
            K[in_gap, in_gap] += np.eye(n_gap)
        sigma = scipy.linalg.lu_solve(scipy.linalg.lu_factor(K, overwrite_a=True, check_finite=False), right)
        phi = S[:n_hull] @ sigma
        own = weights[:, modes].T * len(tank.images)  # the images' loads are the same
        radiation[np.ix_(modes, modes)] = -tank.rho * own @ phi[:, : len(modes)]
        diffraction[:, modes] = (-1j * omega * tank.rho * own @ phi[:, len(modes):]).T if waves else 0.0
        columns = [*modes, *range(6, 6 + len(headings))]
        for image, sign in enumerate(signs):
            sources[image][:, columns] += sign * sigma * np.linalg.norm(area, axis=1)[:, None]
    every_point = np.concatenate([side.faces_centers for side in sides])
    return Solution(
        radiation.real, np.zeros((6, 6)) if endless else omega * radiation.imag,
        _froude_krylov(tank, omega, k, headings), diffraction,
        sources.reshape(-1, sources.shape[-1]), every_point,
    )  # fmt: skip


def _scattering(waves, signs, images, unit: Array, n_hull: int, in_gap: slice, damping: float) -> Complex:
    """Right-hand sides [panel, heading] of one symmetry: what the hull and the damping lid do to the waves."""
    total = np.zeros((len(unit), waves[0][0].shape[1]), dtype=complex)
    for (phi, velocity), sign, image in zip(waves, signs, images, strict=True):
        normal = unit.copy()
        normal[:, list(image)] *= -1
        part = -np.einsum("phc,pc->ph", velocity, normal)
        part[n_hull : in_gap.start] = 0.0
        part[in_gap] = -1j * damping * phi[in_gap]
        total += sign * part
    return total / len(images)


def _froude_krylov(tank: Tank, omega: float, k: float, headings: Array) -> Complex:
    """Loads [heading, 6] of the undisturbed waves' pressure on all panels."""
    if not len(headings):
        return np.zeros((0, 6), dtype=complex)
    mesh, area = _mesh(tank.hull.whole), tank.hull.area
    phi, _ = incident(tank, omega, k, headings, mesh.faces_centers)
    return (-1j * omega * tank.rho * phi).T @ generalised_normals(mesh.faces_centers, area)


def _image(panels: Array, image: tuple[int, ...]) -> Array:
    for axis in image:
        panels = mirrored(panels, axis)
    return panels


def _mesh(panels: Array):
    """Panels as capytaine takes them."""
    from capytaine.meshes.meshes import Mesh

    faces = np.arange(4 * len(panels)).reshape(-1, 4)
    three = (panels[:, 2] == panels[:, 3]).all(axis=1)
    faces[three, 3] = faces[three, 2]
    return Mesh(panels.reshape(-1, 3), faces, auto_clean=False, auto_check=False)
