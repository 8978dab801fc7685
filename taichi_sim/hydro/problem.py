"""The boundary-element problem of one hull at one frequency: linear potential flow at zero speed, by capytaine.

The time factor is exp(-i omega t). The potential phi on the hull follows from its normal velocity v_n (the normal
points out of the hull into the water), by one of two methods:

    direct:   D phi = S v_n                     Green's theorem, as in WAMIT
    sources:  K sigma = v_n,  phi = S sigma     sources on the hull, capytaine's default

On the meshes of ships the direct method has a quarter of the error, and lids hardly shift its results
(docs/hydrodynamics.md). The problems are the six motions of unit velocity, and the scattering of waves from each
heading. The lids are those of panels.py: the inner one is rigid, the one between hulls is damped (engine.py).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.hydro.surface import WettedSurface, area_vectors

if TYPE_CHECKING:
    from capytaine import FloatingBody

Array = NDArray[np.float64]
Complex = NDArray[np.complexfloating]
PARITY = {  # of the normal velocities of the six motions, about the plane normal to an axis
    0: np.array([-1, 1, 1, 1, -1, -1]),
    1: np.array([1, -1, 1, -1, 1, -1]),
}
NO_PANELS = np.empty((0, 4, 3))


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
        from taichi_sim.hydro.engine import as_body  # capytaine is heavy and optional

        return as_body(self.hull, np.concatenate([self.inner_lid, self.damping_lid]))

    @property
    def coupled(self) -> NDArray[np.bool_]:
        """Which pairs of motions [6, 6] the hull's symmetry allows to influence each other."""
        alike = [np.equal.outer(PARITY[axis], PARITY[axis]) for axis in self.hull.planes]
        return np.logical_and.reduce([np.ones((6, 6), dtype=bool), *alike])


class Solution(NamedTuple):
    """Results at one frequency, in the frame of surface.py, for n headings."""

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

    from taichi_sim.hydro.engine import DampedEngine

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


def added_mass_inf(tank: Tank) -> Array:
    """Added mass [6, 6] at infinite frequency, of the hull without lids."""
    from capytaine import BEMSolver, RadiationProblem

    from taichi_sim.hydro.engine import as_body

    body = as_body(tank.hull, NO_PANELS)
    solver = BEMSolver(method="direct" if tank.method == "direct" else "indirect")
    case = {"body": body, "omega": np.inf, "water_depth": tank.depth, "rho": tank.rho, "g": tank.g}
    found = [solver.solve(RadiationProblem(radiating_dof=dof, **case), _check_wavelength=False) for dof in body.dofs]
    pressure = np.stack([of.pressure / of.omega / of.omega for of in found], axis=1)  # for unit acceleration
    weights = generalised_normals(body.mesh.faces_centers, tank.hull.area)
    return np.where(tank.coupled, -weights.T @ pressure.real, 0.0)


def generalised_normals(centre: Array, area: Array) -> Array:
    """Area vectors and their moments about CO, [n, 6]."""
    return np.concatenate([area, np.cross(centre, area)], axis=1)
