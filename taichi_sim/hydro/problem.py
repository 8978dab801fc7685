"""The boundary-element problem of one hull at one frequency: linear potential flow at zero speed.

With capytaine's Green function of the water's surface and waves exp(-i omega t), the potential phi on the hull follows
from its normal velocity v_n (normal out of the hull, into the water), as the tank's method says:

    direct:   D phi = S v_n                     Green's theorem, as in WAMIT
    sources:  K sigma = v_n,  phi = S sigma     sources on the hull, capytaine's default

On the meshes of ships the direct one errs a quarter as much, and lids hardly shift it (docs/hydrodynamics.md).
Right-hand sides are the six motions of unit velocity and the scattering of the waves of
each heading. Planes of symmetry divide potentials into even and odd ones, whose matrices are sums and differences over
the images: half the unknowns twice, or a quarter four times.

Lids are lids.py's: the inner one is rigid. On the damping lid the surface's condition is

    phi_z = K (1 + i epsilon) phi,    K = omega^2 / g,

in place of phi_z = K phi (Chen 2004, "fairly perfect fluid"), one epsilon for all frequencies: friction epsilon omega
on the vertical motion, as that of eddies grows with velocity. Both methods have the undamped condition built in: the
lid adds i epsilon K S phi.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.hydro.frames import cos_sin
from taichi_sim.hydro.surface import Surface, area_vectors, mirrored

Array = NDArray[np.float64]
Complex = NDArray[Any]  # complex128
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
    gap_damping: float  # epsilon of the gap lid; 0: none
    method: Literal["direct", "sources"] = "direct"

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
    potential: Complex  # [panel, 6 + n] of unit velocities and of the scattered waves, images too; none with sources
    flow: Complex  # [panel, 6 + n] normal velocity, or sources, times area, and what a damping lid sends out
    points: Array  # [panel, 3] where they are
    area: Array  # [panel, 3] area vectors, zero on lids
    gap_potential: Complex  # [lid panel, 6 + n] on the damping lid and its images
    gap_area: Array  # [lid panel] m^2


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
    """Loads and potentials at `omega` (rad/s); at infinity only the added mass has a meaning, and lids are left out."""
    import scipy.linalg
    from capytaine import Delhommeau  # heavy, and optional

    endless = not np.isfinite(omega)
    layout = _layout(tank, lids=not endless)
    k = np.inf if endless else dispersion(omega, tank.depth, tank.g)
    damping = 0.0 if endless else tank.gap_damping * omega**2 / tank.g  # epsilon K
    blocks = _blocks(tank, layout, k, green or Delhommeau())
    n, gap, area = layout.hull, layout.gap, np.linalg.norm(layout.area, axis=1)[:, None]
    unit = layout.area / area
    headings = np.empty(0) if endless else np.asarray(heading_deg, dtype=float)
    waves = [incident(tank, omega, k, headings, points) for points in layout.centres] if len(headings) else []
    motions = generalised_normals(layout.centres[0], unit)[:n]
    radiation, diffraction = np.zeros((6, 6), dtype=complex), np.zeros((len(headings), 6), dtype=complex)
    potential = np.zeros((len(tank.images), len(area), 6 + len(headings)), dtype=complex)
    flow = np.zeros_like(potential)
    weights = motions * area[:n] * len(tank.images)  # the images' loads are the same
    for character in tank.characters:
        signs = [image_sign(character, image) for image in tank.images]
        S, D = (np.sum([sign * block[i] for sign, block in zip(signs, blocks, strict=True)], axis=0) for i in (0, 1))
        modes = [m for m in range(6) if all(PARITY[a][m] == sign for a, sign in character.items())]
        columns = [*modes, *range(6, 6 + len(headings))]
        v = np.zeros((len(area), len(columns)), dtype=complex)  # normal velocity, on the gap lid that of the damping
        v[:n, : len(modes)] = motions[:, modes]
        if waves:
            v[:, len(modes) :] = _scattering(waves, signs, tank.images, unit, n, gap, damping)
        D = D.astype(complex)
        if tank.method == "direct":
            D[:, gap] = 1j * damping * S[:, gap]
        else:
            D[gap] = 1j * damping * S[gap]
        D[gap, gap] += np.eye(gap.stop - gap.start)
        right = S @ v if tank.method == "direct" else v
        phi = scipy.linalg.lu_solve(scipy.linalg.lu_factor(D, overwrite_a=True, check_finite=False), right)
        if tank.method == "sources":
            v, phi = phi, S @ phi
        radiation[np.ix_(modes, modes)] = -tank.rho * weights[:, modes].T @ phi[:n, : len(modes)]
        if waves:
            diffraction[:, modes] = (-1j * omega * tank.rho * weights[:, modes].T @ phi[:n, len(modes) :]).T
        if tank.method == "direct":
            v[gap] -= 1j * damping * phi[gap]
        for image, sign in enumerate(signs):
            potential[image][:, columns] += sign * phi
            flow[image][:, columns] += sign * v * area
    areas = np.concatenate([layout.area * [-1.0 if a in image else 1.0 for a in range(3)] for image in tank.images])
    on_hull = np.tile(np.arange(len(area)) < n, len(tank.images))
    of_gap = potential[:, gap].reshape(-1, potential.shape[-1])
    gap_area = np.tile(area[gap, 0], len(tank.images))
    if tank.method == "sources":
        potential[:] = 0.0
    return Solution(
        radiation.real, np.zeros((6, 6)) if endless else omega * radiation.imag,
        _froude_krylov(tank, omega, k, headings), diffraction,
        potential.reshape(-1, potential.shape[-1]), flow.reshape(-1, flow.shape[-1]),
        np.concatenate(layout.centres), areas * on_hull[:, None], of_gap, gap_area,
    )  # fmt: skip


class _Layout(NamedTuple):
    """Panels of the hull's positive sides, then of the inner lid, then of the gap lid."""

    panels: Array  # [n, 4, 3]
    hull: int  # how many are the hull's
    gap: slice  # which are the gap lid's
    area: Array  # [n, 3]
    centres: list[Array]  # [n, 3] of the panels, and of each image of them


def _layout(tank: Tank, lids: bool) -> _Layout:
    none = np.empty((0, 4, 3))
    inner, gap = (tank.inner_lid, tank.gap_lid if tank.gap_damping else none) if lids else (none, none)
    panels = np.concatenate([tank.hull.panels, inner, gap])
    centres = [as_mesh(_image(panels, image)).faces_centers for image in tank.images]
    last = slice(len(panels) - len(gap), len(panels))
    return _Layout(panels, len(tank.hull), last, area_vectors(panels), centres)


def _blocks(tank: Tank, layout: _Layout, k: float, green: Any) -> list[tuple[Any, Any]]:
    """S and D (or K) of the panels, at the panels themselves and at each image."""
    mesh = as_mesh(layout.panels)
    return [
        green.evaluate(
            as_mesh(_image(layout.panels, image)), mesh, free_surface=0.0, water_depth=tank.depth, wavenumber=k,
            adjoint_double_layer=tank.method == "sources", diagonal_term_in_double_layer=not image,
        )
        for image in tank.images
    ]  # fmt: skip


def _scattering(waves, signs, images, unit: Array, n_hull: int, gap: slice, damping: float) -> Complex:
    """Normal velocities [panel, heading] of one symmetry with which hull and damping lid answer the waves."""
    total = np.zeros((len(unit), waves[0][0].shape[1]), dtype=complex)
    for (phi, velocity), sign, image in zip(waves, signs, images, strict=True):
        normal = unit.copy()
        normal[:, list(image)] *= -1
        part = -np.einsum("phc,pc->ph", velocity, normal)
        part[n_hull : gap.start] = 0.0
        part[gap] = -1j * damping * phi[gap]
        total += sign * part
    return total / len(images)


def _froude_krylov(tank: Tank, omega: float, k: float, headings: Array) -> Complex:
    """Loads [heading, 6] of the undisturbed waves' pressure on all panels."""
    if not len(headings):
        return np.zeros((0, 6), dtype=complex)
    mesh, area = as_mesh(tank.hull.whole), tank.hull.area
    phi, _ = incident(tank, omega, k, headings, mesh.faces_centers)
    return (-1j * omega * tank.rho * phi).T @ generalised_normals(mesh.faces_centers, area)


def _image(panels: Array, image: tuple[int, ...]) -> Array:
    for axis in image:
        panels = mirrored(panels, axis)
    return panels


def as_mesh(panels: Array) -> Any:
    """Panels as capytaine takes them."""
    from capytaine.meshes.meshes import Mesh

    faces = np.arange(4 * len(panels)).reshape(-1, 4)
    three = (panels[:, 2] == panels[:, 3]).all(axis=1)
    faces[three, 3] = faces[three, 2]
    return Mesh(panels.reshape(-1, 3), faces, auto_clean=False, auto_check=False)
