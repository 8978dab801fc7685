"""The boundary-element problem of one hull at one frequency, by capytaine, and its waves in the far field.

Linear potential flow at zero speed, with the time factor exp(-i omega t). The potential phi on the hull follows from
its normal velocity v_n (the normal points out of the hull into the water), by one of two methods:

    direct:   D phi = S v_n                     Green's theorem, as in WAMIT
    sources:  K sigma = v_n,  phi = S sigma     sources on the hull, capytaine's default

On the meshes of ships the direct method has a quarter of the error, and lids hardly shift its results
(docs/hydrodynamics.md). The problems are the six motions of unit velocity, and the scattering of waves from each
heading. The lids are those of panelling.py: the inner one is rigid, the one between hulls is damped
(capytaine_extensions.py).

Far away, the waves of a potential follow from Kochin's function

    H(theta) = 1/(4 pi) integral (phi_n e - phi e_n) dS,    e = f(z) exp(-i k (x cos theta + y sin theta)),

with f = cosh k(z + h) / cosh kh. They carry the power (omega / k) c2 |H|^2 dtheta in the sector dtheta; in deep water
c2 = 2 pi rho k^2. The damping of motions of unit velocity follows from the radiated energy, plus that which a damping
lid absorbs:

    B_ij = 2 (omega / k) c2 integral Re(H_i H_j*) dtheta + rho omega K epsilon integral Re(phi_i phi_j*) dS.

It is symmetric and never negative. Integrated pressures are so only in the limit of fine panels.

The mean drift of the freely floating hull in regular waves follows from momentum over a distant cylinder (Maruo 1960;
Newman 1967). H is of the waves scattered by the fixed hull plus those of its motions, per metre of the amplitude a of
waves that travel to beta:

    X = -a^2 (c1 cos beta Re H(beta) + c2 integral |H|^2 cos theta dtheta),  Y with sines,
    N = a^2/k (-c1 Im H'(beta) - c2 integral Im(H* H') dtheta),

with c1 = 2 pi rho omega in deep water. In depth h both c1 and c2 are larger by coth kh, and c2 is smaller by 1 + 2kh /
sinh 2kh. The drift includes the loads on a damping lid. There is no viscous damping: a roll that only potential damping
limits drifts too much at its resonance.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.hydro.wetted_surface import WettedSurface, area_vectors, cos_sin

if TYPE_CHECKING:
    from capytaine import FloatingBody

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]
PARITY = {  # of the normal velocities of the six motions, about the plane normal to an axis
    0: np.array([-1, 1, 1, 1, -1, -1]),
    1: np.array([1, -1, 1, -1, 1, -1]),
}
NO_PANELS = np.empty((0, 4, 3))
FEWEST_ANGLES = 180  # in integrals around the hull
ANGLES_PER_PHASE = 6  # angles per radian of k times the hull's radius


@dataclass(frozen=True)
class Tank:
    """A hull with lids in water, given on the positive sides of the hull's planes of symmetry."""

    hull: WettedSurface
    inner_lid: Array  # [n, 4, 3]
    gap_lid: Array  # [n, 4, 3]
    rho: float  # kg/m^3
    g: float  # m/s^2
    depth: float  # m; inf: deep water
    gap_damping: float  # epsilon of the gap lid; 0: no damping
    method: Literal["direct", "sources"] = "direct"

    @property
    def damping_lid(self) -> Array:
        """Panels [n, 4, 3] of the gap lid; empty if it has no damping."""
        return self.gap_lid if self.gap_damping else NO_PANELS

    @cached_property
    def body(self) -> "FloatingBody":
        """The hull with its lids as a body of capytaine."""
        from taichi_sim.applications.hydro.capytaine_extensions import as_body  # capytaine is heavy and optional

        return as_body(self.hull, np.concatenate([self.inner_lid, self.damping_lid]))

    @property
    def coupled(self) -> NDArray[np.bool_]:
        """Which pairs of motions [6, 6] the hull's symmetry allows to influence each other."""
        alike = [np.equal.outer(PARITY[axis], PARITY[axis]) for axis in self.hull.planes]
        return np.logical_and.reduce([np.ones((6, 6), dtype=bool), *alike])


class Solution(NamedTuple):
    """Results at one frequency, in the frame of wetted_surface.py, for n headings."""

    wavenumber: float  # rad/m
    added_mass: Array  # [6, 6]
    damping: Array  # [6, 6]
    froude_krylov: Complex  # [n, 6], per metre of amplitude
    diffraction: Complex  # [n, 6], per metre of amplitude
    potential: Complex  # [panel, 6 + n], of unit velocities and scattered waves, with images; 0 with sources
    flow: Complex  # [panel, 6 + n], normal velocity (or source) times area, with the flow from a damping lid
    points: Array  # [panel, 3], their positions
    area: Array  # [panel, 3], area vectors; zero on lids
    gap_potential: Complex  # [lid panel, 6 + n], on the damping lid and its images
    gap_area: Array  # [lid panel], m^2


def solve(tank: Tank, omega: float, heading_deg: Array) -> Solution:
    """Solve for loads and potentials at a finite `omega` (rad/s).

    Loads are sums over the panels' area vectors, which close the hull exactly. capytaine's areas of twisted panels do
    not; on the Otter this makes 0.5 % of the loads.
    """
    from capytaine import BEMSolver, DiffractionProblem, RadiationProblem
    from capytaine.bem.airy_waves import airy_waves_potential, airy_waves_pressure

    from taichi_sim.applications.hydro.capytaine_extensions import DampedEngine

    body, direct, lid = tank.body, tank.method == "direct", len(tank.damping_lid)
    mesh, hull, images = body.mesh_including_lid, body.hull_mask, 2 ** len(tank.hull.planes)
    damping = tank.gap_damping * omega**2 / tank.g  # epsilon K
    gap = np.tile(np.arange(mesh.nb_faces // images) >= mesh.nb_faces // images - lid, images)
    case = {"body": body, "omega": omega, "water_depth": tank.depth, "rho": tank.rho, "g": tank.g}
    motions = [RadiationProblem(radiating_dof=dof, **case) for dof in body.dofs]
    waves = [DiffractionProblem(wave_direction=angle, **case) for angle in np.deg2rad(heading_deg)]
    for wave in waves:
        wave.boundary_condition[gap] = -1j * damping * airy_waves_potential(mesh.faces_centers[gap], wave)
    solver = BEMSolver(engine=DampedEngine(lid, damping, direct), method="direct" if direct else "indirect")
    found = [solver.solve(problem, _check_wavelength=False) for problem in (*motions, *waves)]
    unit = np.repeat([1j / omega, 1.0], [6, len(waves)])  # capytaine's motions have unit amplitude
    phi = unit * np.stack([of.potential for of in found], axis=1)
    sent = [of.problem.boundary_condition if direct else of.sources for of in found]
    flow = unit * np.stack(sent, axis=1)
    if direct:
        flow[gap] -= 1j * damping * phi[gap]
    area = area_vectors(mesh.merged().as_array_of_faces())
    weights = generalised_normals(mesh.faces_centers, area)[hull]
    incident = [airy_waves_pressure(mesh.faces_centers[hull], wave) for wave in waves]
    radiation = np.where(tank.coupled, -tank.rho * weights.T @ phi[hull, :6], 0.0)
    return Solution(
        motions[0].wavenumber,
        radiation.real,
        omega * radiation.imag,
        -np.reshape(incident, (-1, len(weights))) @ weights,
        -1j * omega * tank.rho * phi[hull, 6:].T @ weights,
        phi if direct else np.zeros_like(phi),
        flow * np.linalg.norm(area, axis=1)[:, None],
        mesh.faces_centers,
        area * hull[:, None],
        phi[gap],
        np.linalg.norm(area[gap], axis=1),
    )


def added_mass_limit(tank: Tank, omega: float) -> Array:
    """Added mass [6, 6] in the limit of `omega` = 0 or infinity, of the hull without lids.

    The surface is a rigid lid at 0 (a mirror of the hull), and without pressure at infinity.
    """
    from capytaine import BEMSolver, RadiationProblem

    from taichi_sim.applications.hydro.capytaine_extensions import as_body

    body = as_body(tank.hull, NO_PANELS)
    solver = BEMSolver(method="direct" if tank.method == "direct" else "indirect")
    case = {"body": body, "omega": omega, "water_depth": tank.depth, "rho": tank.rho, "g": tank.g}
    found = [solver.solve(RadiationProblem(radiating_dof=dof, **case), _check_wavelength=False) for dof in body.dofs]
    pressure = np.stack([of.pressure / of.omega / of.omega for of in found], axis=1)  # for unit acceleration
    weights = generalised_normals(body.mesh.faces_centers, tank.hull.area)
    return np.where(tank.coupled, -weights.T @ pressure.real, 0.0)


def generalised_normals(centre: Array, area: Array) -> Array:
    """Area vectors and their moments about CO, [n, 6]."""
    return np.concatenate([area, np.cross(centre, area)], axis=1)


def kochin(solution: Solution, depth: float, angle: Array) -> tuple[Complex, Complex]:
    """H [angle, 6 + heading] of motions of unit velocity and of scattered waves, and its derivative by the angle."""
    k, (x, y, z) = solution.wavenumber, solution.points.T
    n_x, n_y, n_z = solution.area.T
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    cosh, sinh = attenuation(k, z, depth)
    wave = np.exp(-1j * k * (x * c + y * s))
    turn, normal, normal_turn = -1j * k * (y * c - x * s), n_x * c + n_y * s, n_y * c - n_x * s
    e = cosh * wave
    e_n = (-1j * k * cosh * normal + k * sinh * n_z) * wave
    e_n_turned = turn * e_n - 1j * k * cosh * normal_turn * wave
    H = e @ solution.flow - e_n @ solution.potential
    H_turned = (turn * e) @ solution.flow - e_n_turned @ solution.potential
    return H / (4 * np.pi), H_turned / (4 * np.pi)


def attenuation(k: float, z: Array, depth: float) -> tuple[Array, Array]:
    """cosh k(z+h) / cosh kh and sinh k(z+h) / cosh kh."""
    if k * depth > 20:
        return np.exp(k * z), np.exp(k * z)
    return np.cosh(k * (z + depth)) / np.cosh(k * depth), np.sinh(k * (z + depth)) / np.cosh(k * depth)


def fewest_angles(solution: Solution) -> int:
    """Number of angles for integrals around the hull."""
    radius = np.linalg.norm(solution.points[:, :2], axis=1).max()
    return max(FEWEST_ANGLES, int(np.ceil(ANGLES_PER_PHASE * solution.wavenumber * radius)))


def weight(tank: Tank, omega: float, k: float) -> float:
    """c2: momentum (N) that waves of |H| = 1 carry away per radian."""
    shallow = 1.0 if k * tank.depth > 20 else 1 / (1 + 2 * k * tank.depth / np.sinh(2 * k * tank.depth))
    return float(2 * np.pi * tank.rho * tank.g * k**3 / omega**2 * shallow)


def radiated_damping(tank: Tank, solution: Solution, omega: float) -> Array:
    """Damping B [6, 6]; entries that symmetry forbids stay zero."""
    k, n = solution.wavenumber, fewest_angles(solution)
    H = kochin(solution, tank.depth, 2 * np.pi * np.arange(n) / n)[0][:, :6]
    waves = 2 * omega / k * weight(tank, omega, k) * 2 * np.pi / n * (H.conj().T @ H).real
    phi = solution.gap_potential[:, :6]
    lid = tank.rho * tank.gap_damping * omega**3 / tank.g * (phi.conj().T @ (phi * solution.gap_area[:, None])).real
    return np.where(solution.damping == 0.0, 0.0, waves + lid)


def response(solution: Solution, M: Array, C: Array, omega: float) -> Complex:
    """Motions [heading, 6] per metre of wave amplitude: m, rad/m."""
    Z = -(omega**2) * (M + solution.added_mass) - 1j * omega * solution.damping + C
    return np.linalg.solve(Z, (solution.froude_krylov + solution.diffraction).T).T


def mean_drift(tank: Tank, solution: Solution, motion: Complex, omega: float, heading_deg: Array) -> Array:
    """Mean surge and sway force (N/m^2) and yaw moment (N/m) per squared wave amplitude, [heading, 3]."""
    k, n = solution.wavenumber, fewest_angles(solution)
    around = 2 * np.pi * np.arange(n) / n
    velocity = -1j * omega * motion.T  # [6, heading]; the solution has potentials of unit velocity

    def total(angle: Array) -> tuple[Complex, Complex]:
        """H and its derivative [angle, heading] of all waves from the free hull."""
        of = kochin(solution, tank.depth, angle)
        H, H_turned = (1j * (h[:, :6] @ velocity + h[:, 6:]) for h in of)
        return H, H_turned

    H, H_turned = total(around)
    ahead, ahead_turned = (np.diagonal(h) for h in total(np.deg2rad(heading_deg)))
    c1 = 2 * np.pi * tank.rho * tank.g * k / omega
    c2 = weight(tank, omega, k)
    c, s = cos_sin(heading_deg)
    step = 2 * np.pi / n
    X = -c1 * c * ahead.imag - c2 * step * np.cos(around) @ np.abs(H) ** 2
    Y = -c1 * s * ahead.imag - c2 * step * np.sin(around) @ np.abs(H) ** 2
    N = (c1 * ahead_turned.real - c2 * step * (H.conj() * H_turned).imag.sum(axis=0)) / k
    return np.stack([X, Y, N], axis=1)
