"""Completes a hydrodynamic database for the simulator: adds the radiation memory, and the Froude-Krylov loads on the
simulator's own panels.
"""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from taichi_sim.applications.hydro.memory_fit import ENERGY, Pair, fit_memory
from taichi_sim.kernels.conventions import QUATERNION
from taichi_sim.models.usv.hull.database import HydroDatabase
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.hull.radiation import OSCILLATING, natural_frequency
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components, wavenumber

SMALL = 1e-4  # amplitude of the waves over the draught, so small that nonlinear terms vanish


def completed(
    database: HydroDatabase, hull: Hull6Dof, energy: float = ENERGY, *, quiet: bool = False
) -> tuple[HydroDatabase, tuple[Pair, ...]]:
    """Return the database with `by_panels` and `memory`, and the errors of the fit.

    It needs a Taichi program of f64.
    """
    fit = fit_memory(
        database.omega, database.added_mass, database.damping, database.added_mass_inf, energy,
        resonances=resonances(database, hull), symmetric=database.symmetric, quiet=quiet,
    )  # fmt: skip
    own = by_panels(database, hull)
    return replace(database, by_panels=own, memory=fit.memory, memory_inf=fit.added_mass_inf), fit.pairs


def resonances(database: HydroDatabase, hull: Hull6Dof) -> list[float | None]:
    """Natural frequencies (rad/s) of uncoupled heave, roll and pitch at the indices of their modes; None for other
    modes.
    """
    found: list[float | None] = [None] * 6
    stiffness = hull.geometry.hydrostatics.stiffness()
    for place, mode in enumerate(OSCILLATING):
        found[mode] = natural_frequency(database, mode, hull.params.M_rb[mode, mode], stiffness[place, place])
    return found


def by_panels(database: HydroDatabase, hull: Hull6Dof) -> NDArray[np.complex128]:
    """Froude-Krylov load per wave amplitude on the panels of `hull`, upright at its design waterline, [n, m, 6].

    Frequencies (n) and headings (m) are those of `database`.
    """
    omega, heading = np.meshgrid(database.omega, np.deg2rad(database.heading_deg), indexing="ij")
    omega, heading = omega.ravel()[:, None], heading.ravel()[:, None]
    amplitude = np.full_like(omega, SMALL * hull.draft)
    k = wavenumber(omega, database.depth)

    def load(amplitude: NDArray, phase: float) -> NDArray:
        components = Components(amplitude, k, omega, heading, np.full_like(omega, phase))
        sea = Sea(components, database.depth)
        own = torch.arange(len(omega), dtype=torch.int32, device=sea.table.device)
        around = Surroundings.of(sea, own, torch.zeros(len(omega), dtype=torch.float64, device=sea.table.device))
        state = torch.zeros((len(omega), 1, 13), dtype=sea.table.dtype, device=sea.table.device)
        state[..., QUATERNION.start] = 1.0
        return hull.pressure_load(state, around)[:, 0].double().cpu().numpy()

    calm = load(0 * amplitude, 0.0)
    real, imaginary = load(amplitude, 0.0) - calm, calm - load(amplitude, np.pi / 2)
    found = (real + 1j * imaginary) / amplitude
    return found.reshape(len(database.omega), len(database.heading_deg), 6)
