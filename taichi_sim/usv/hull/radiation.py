"""Radiation and diffraction of a hull: one of two kinds, chosen by the vehicle file.

`radiation = "constant"` (ConstantRadiation): the added mass of the vehicle file is inertia. Damping and added mass act
on the motion relative to the water, and so represent radiation and diffraction:

    (M_rb + M_a) nu_dot = ... + M_a nu_o_dot.

`radiation = "memory"` (DatabaseRadiation): both come from a boundary-element code:

    (M_rb + A_inf) nu_dot = ... + tau_D - mu

(Cummins 1962; Fossen 2021, sec. 5.4 and 6.3). A_inf and mu (memory.py) are radiation, tau_D is diffraction
(diffraction.py). The pressure on the panels stays nonlinear. Coriolis and Munk loads use the file's own added mass.
Damping is the file's, minus the radiation at the natural frequency in heave, roll and pitch, so that nothing counts
twice.

Two effects are not modelled. Forward speed does not change added mass, damping or diffraction: those of zero speed at
the wave frequency are used at any speed. The depth of the water does not change them either: a database has one depth.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIncompatibleMethodOverride=false

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.kernels.lanes import laned
from taichi_sim.kernels.rigid_body import linear, six, times
from taichi_sim.surroundings import Surroundings
from taichi_sim.usv.hull.database import HydroDatabase, hull_hash
from taichi_sim.usv.hull.diffraction import Diffraction, diffracted
from taichi_sim.usv.hull.geometry import HullGeometry, device_table
from taichi_sim.usv.hull.memory import Memory, radiate
from taichi_sim.usv.hull.params import Hull6DofParams
from taichi_sim.usv.vessel import Number

Array = NDArray[np.float64]
OSCILLATING = (2, 3, 4)  # heave, roll, pitch: the modes with a stiffness
ROUNDS = 30  # iterations for a natural frequency
DEEP_ENOUGH = 4.0  # draughts from which water counts as deep; assumed
DEPTH_RATIO = 1.25  # tolerated ratio of the water's depth to the database's, in either direction; assumed


class Radiation:
    """Contract of both kinds. The defaults have no load and no columns.

    Attributes:
        inertia: added mass that counts as inertia, beside M_rb, [6, 6].
        counted: linear damping that `memory` already includes, [6], N s/m, N m s.
        memory: memory of radiated waves.
        database: hydrodynamic database; None for constant radiation.
        columns: number of columns in the auxiliary state.
    """

    inertia: Array
    counted: Array = np.zeros(6)
    memory: Memory = Memory.none()
    database: HydroDatabase | None = None
    columns: int = 0

    def inertia_change(self, change: Sequence[Number]) -> Sequence[Number]:
        """Change of the diagonal [6] of `inertia` for a vehicle whose added mass differs from the file's by
        `change`.
        """
        return (0.0,) * 6

    def sea(self, around: Surroundings) -> Tensor | None:
        """Return the sea that `tables` depend on; None if they are the same for any sea.

        Raises:
            ConfigError: if the database is for another depth of water.
        """
        return None

    def tables(self, sea: Tensor | None) -> Mapping[str, Tensor]:
        """Tables for kernels: numbers of the memory's `filters`, and `diffraction` loads in a sea (zero without a
        sea).
        """
        return {"filters": laned(device_table(np.zeros(1))), "diffraction": laned(device_table(np.zeros((1, 1, 1))))}

    @ti.func
    def orbital_load(self, M_a: ti.template(), nu_o_dot):
        """Load (N, N m, about CO, b) of the water's orbital acceleration on the added mass M_a (rows)."""
        return nu_o_dot * 0.0

    @ti.func
    def diffraction_from(
        self, build: ti.template(), around: ti.template(), tables: ti.template(), e, n, tau, R, nu, L, change,
        load, rate, bend
    ):  # fmt: skip
        """Diffraction load, and its first and second rates of change, in the middle of the stretch of steps that
        contains step n.

        They are new at the beginning of a stretch; else they are those of the previous step. tau (s) is the time in the
        middle of step n. L is the hull's label there (water.at); its displacement changes by `change` (m) per step.
        """
        return load, rate, bend

    @ti.func
    def diffraction_load(self, n, load, rate, bend):
        """Load (N, N m, about CO, b) in the middle of step n, from load and rates in the middle of its stretch."""
        return load * 0.0

    @ti.func
    def memory_load(self, tables: ti.template(), states: ti.template(), e, i, R, nu, nu_dot, V_c):
        """Load (N, N m, about CO, b) of previously radiated waves in the middle of a step.

        The memory's states, in the auxiliary state in lanes, are advanced to the end of the step.
        """
        return nu * 0.0


@ti.data_oriented
class ConstantRadiation(Radiation):
    """Added mass and damping that are the same at every frequency."""

    def __init__(self, added_mass: Sequence[float]):
        """Take a diagonal added mass [6]."""
        self.inertia = np.diag(added_mass)

    def inertia_change(self, change: Sequence[Number]) -> Sequence[Number]:
        """Return the whole change."""
        return change

    @ti.func
    def orbital_load(self, M_a: ti.template(), nu_o_dot):
        """M_a nu_o_dot."""
        return times(M_a, nu_o_dot)


@ti.data_oriented
class DatabaseRadiation(Radiation):
    """Radiation with memory, and diffraction, from a boundary-element database."""

    def __init__(self, params: Hull6DofParams, geometry: HullGeometry, dt: float, substeps: int, first: int):
        """Read the database of `params`, for steps of `dt` (s); its columns in the auxiliary state begin at `first`.

        Raises:
            ConfigError: if the database is of another hull, or lacks a table that is needed.
        """
        h, file = params.hydrodynamics, Path(str(params.hydrodynamics.database))
        database, own = HydroDatabase.read(file), hull_hash(geometry.panels)
        if database.hull != own:
            raise ConfigError(
                f"hydrodynamics.database = {file.name!r} is of another hull (its hash is {database.hull}, this hull's "
                f"{own}): make it anew with tools/hydrodynamics.py"
            )
        if database.by_panels is None or (h.drift and database.drift is None):
            lacks = "the panels' own excitation" if database.by_panels is None else "mean drift"
            raise ConfigError(f"{file}: has no table of {lacks}: make it anew with tools/hydrodynamics.py")
        if database.memory is None:
            raise ConfigError(f"{file}: the database has no memory: make it anew with tools/hydrodynamics.py")
        self.database, self.memory, self.draft = database, database.memory, geometry.panels.draft
        self.inertia = database.added_mass_inf if database.memory_inf is None else database.memory_inf
        self.counted = counted_damping(database, self.memory, params.M_rb, geometry.hydrostatics.stiffness())
        self.filters, self.first, self.dt = self.memory.modes.bank(dt), first, dt
        self.columns = self.filters.size
        self.diffraction = Diffraction(database, h.drift)
        self.stretch = min(self.diffraction.stretch(dt), substeps)  # steps for which diffraction is summed once

    def sea(self, around: Surroundings) -> Tensor:
        """Return the sea of `around`, on which diffraction depends."""
        assert self.database is not None
        ours, water = self.database.depth, around.depth if around.depth > 0 else None
        if ours is None:
            fits = water is None or water >= DEEP_ENOUGH * self.draft
        else:
            fits = water is not None and 1 / DEPTH_RATIO <= water / ours <= DEPTH_RATIO
        if not fits:
            of_water = "deep" if water is None else f"{water:g} m deep"
            of_data = "deep water" if ours is None else f"water of {ours:g} m"
            raise ConfigError(
                f"sea.depth: the water is {of_water}, the hydrodynamic database of the hull is of {of_data}. (Water "
                f"is deep from {DEEP_ENOUGH:g} draughts, {DEEP_ENOUGH * self.draft:.3g} m, on; other depths may differ "
                'by 25 %.) Make one with tools/hydrodynamics.py --depth, or set hydrodynamics.radiation = "constant"'
            )
        return around.sea

    def tables(self, sea: Tensor | None) -> Mapping[str, Tensor]:
        """Filters and, for a sea, diffraction."""
        tables = {**super().tables(sea), "filters": laned(device_table(self.filters.numbers))}
        return tables if sea is None else {**tables, "diffraction": laned(self.diffraction.of(sea))}

    @ti.func
    def diffraction_from(
        self, build: ti.template(), around: ti.template(), tables: ti.template(), e, n, tau, R, nu, L, change,
        load, rate, bend
    ):  # fmt: skip
        """Sum over the components of the sea at the beginning of a stretch."""
        if n % ti.static(self.stretch) == 0:
            ahead = ti.static(0.5 * (self.stretch - 1) * self.dt)
            velocity = (R @ linear(nu))[:2] + change * ti.static(1 / self.dt)
            load, rate, bend = diffracted(
                self.diffraction, tables.diffraction, build, around,
                e, L + ahead * velocity, velocity, tau + ahead, ti.atan2(R[1, 0], R[0, 0]),
            )  # fmt: skip
        return load, rate, bend

    @ti.func
    def diffraction_load(self, n, load, rate, bend):
        """Evaluate the Taylor series."""
        since = (n % ti.static(self.stretch) - ti.static(0.5 * (self.stretch - 1))) * ti.static(self.dt)
        return load + since * (rate + 0.5 * since * bend)

    @ti.func
    def memory_load(self, tables: ti.template(), states: ti.template(), e, i, R, nu, nu_dot, V_c):
        """Load for the velocity through the water in the middle of the step, predicted with the last step's nu_dot."""
        still = R.transpose() @ V_c
        middle = nu + ti.static(0.5 * self.dt) * nu_dot - six(still, still * 0.0)
        return radiate(self.filters, tables.filters, states, e, i, self.first, middle)


def radiation_of(params: Hull6DofParams, geometry: HullGeometry, dt: float, substeps: int, first: int) -> Radiation:
    """Return the kind of radiation that a vehicle file selects; linear restoring has constant radiation.

    Arguments are those of DatabaseRadiation.

    Raises:
        ConfigError: for a database that cannot be used.
    """
    if params.restoring == "panels" and params.hydrodynamics.radiation == "memory":
        return DatabaseRadiation(params, geometry, dt, substeps, first)
    return ConstantRadiation(params.hydrodynamics.added_mass)


def counted_damping(database: HydroDatabase, memory: Memory, M_rb: Array, stiffness: Array) -> Array:
    """Damping [6] of heave, roll and pitch in the memory, at the natural frequencies.

    These are the database's or, if it has none, those of a hull with M_rb [6, 6] and `stiffness` [3, 3] about CO.
    """
    counted, known = np.zeros(6), database.resonances
    for place, mode in enumerate(OSCILLATING):  # known frequencies are the design's, whatever load a vehicle carries
        omega = known[place] if known else None
        omega = omega or natural_frequency(database, mode, M_rb[mode, mode], stiffness[place, place])
        counted[mode] = max(float(memory.damps(omega)[0, mode, mode]), 0.0)
    return counted


def natural_frequency(database: HydroDatabase, mode: int, mass: float, stiffness: float) -> float:
    """Natural frequency omega (rad/s) of one uncoupled mode, from omega^2 (mass + A(omega)) = stiffness."""
    added = database.added_mass[:, mode, mode]
    omega = np.sqrt(stiffness / (mass + added.mean()))
    for _ in range(ROUNDS):
        omega = 0.5 * omega + 0.5 * np.sqrt(stiffness / (mass + np.interp(omega, database.omega, added)))
    return float(omega)
