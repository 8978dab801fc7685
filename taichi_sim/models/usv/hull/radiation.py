"""Radiation and diffraction of a hull: one of two kinds, chosen by the vehicle file.

`radiation = "constant"` (ConstantRadiation): the added mass of the vehicle file is inertia. Damping and added mass act
on the motion relative to the water, and so represent radiation and diffraction:

    (M_rb + M_a) nu_dot = ... + M_a nu_o_dot.

`radiation = "memory"` (DatabaseRadiation): both come from a boundary-element code:

    (M_rb + A_inf) nu_dot = ... + tau_D - mu

(Cummins 1962; Fossen 2021, sec. 5.4 and 6.3). A_inf and mu (radiation_memory.py) are radiation, tau_D is diffraction.
The pressure on the panels stays nonlinear. Coriolis and Munk loads use the file's own added mass. Damping is the
file's, minus the radiation at the natural frequency in heave, roll and pitch, so that nothing counts twice.

Two effects are not modelled. Forward speed does not change added mass, damping or diffraction: those of zero speed at
the wave frequency are used at any speed. The depth of the water does not change them either: a database has one depth.

The diffraction load per unit amplitude X(omega, heading), complex, about CO in b, is the database's excitation minus
the Froude-Krylov load on the simulator's own panels (`by_panels`). It is added to the pressure on the panels. For small
waves the sum is the database's excitation, however few panels there are; the nonlinearity of the undisturbed wave's
pressure remains. A component of amplitude a loads the hull by

    Re(a X(omega, beta) exp(i theta)),   theta: its phase at the hull's label, beta: its direction from the bow.

X is taken at the component's own frequency (the encounter frequency matters in radiation only). It is cubic in omega
and linear between equally spaced courses, to which the database is resampled by its Fourier series. Around a long hull
in short waves, X turns k L / 2 times. The number of courses is therefore chosen so that the error halfway between two
of them is at most OFF times the largest load (`courses_of`). For slower waves than those of the database, diffraction
goes as omega^2; for faster ones it fades to zero at FADED times the highest frequency.

In a control step the load is summed in equal stretches of time, of at most STRETCH of phase of waves at the hull's
highest resonance, whatever the physics step, together with its first and second rates of change. For shorter waves,
which hardly move the hull, the error is larger.

Mean drift is an option, by Newman's (1974) approximation of the slowly varying load of pairs of components i and j,

    sum_ij a_i a_j (D_i + D_j) / 2 cos(theta_i - theta_j) = C sum(a D cos theta) + S sum(a D sin theta),

    C + i S = sum(a exp(i theta)).

Its mean is sum a_i^2 D_i, where D(omega, beta) is the mean surge, sway and yaw load per squared amplitude.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIncompatibleMethodOverride=false, reportIndexIssue=false, reportInvalidTypeForm=false

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import taichi as ti
import torch
from numpy.typing import NDArray
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.kernels import fast_maths
from taichi_sim.kernels.conventions import AMPLITUDE, KX, KY, OMEGA
from taichi_sim.kernels.lanes import blocks, filled, laned, row_of, total, totals, variables
from taichi_sim.kernels.rigid_body import linear, six, times
from taichi_sim.models.usv.hull.database import HydroDatabase, hull_hash
from taichi_sim.models.usv.hull.geometry import HullGeometry, device_table
from taichi_sim.models.usv.hull.params import Hull6DofParams
from taichi_sim.models.usv.hull.radiation_memory import Memory, Modes
from taichi_sim.models.usv.vessel_base import Number
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea.gerstner import component

Array = NDArray[np.float64]
OSCILLATING = (2, 3, 4)  # heave, roll, pitch: the modes with a stiffness
ROUNDS = 30  # iterations for a natural frequency
DEEP_ENOUGH = 4.0  # draughts from which water counts as deep; assumed
DEPTH_RATIO = 1.25  # tolerated ratio of the water's depth to the database's, in either direction; assumed
FEWEST = 96  # courses of a table, at least
OFF = 0.03  # largest error halfway between two courses, over the largest load of a mode at a frequency
ABSENT = 1e-6  # smaller loads, over a mode's largest load at any frequency, are rounding errors
FADED = 1.3  # times the highest frequency of a database: no diffraction from there on
STRETCH = 0.9  # rad; the third term of the Taylor series, (STRETCH / 2)^3 / 6, is 1.5 % of the load
WHOLE = 1e-6  # of a stretch: a rest below it is rounding
TOP = 2.5  # default ratio of the highest frequency of a database to its highest resonance
WAVE, DRIFT = 12, 3  # numbers per entry: real and imaginary parts of six loads; three more with drift
POINTS = 4  # points of a cubic


def cubic(x: NDArray[np.float64], y: NDArray, at: NDArray[np.float64]) -> NDArray:
    """Interpolate the rows y [n, ...] at rising x [n] by cubics (Lagrange) through four rows; return [m, ...].

    The four rows are those nearest to each of `at` [m]; n is at least 4. Beyond the table the cubics extrapolate.
    """
    first = np.clip(np.searchsorted(x, at) - POINTS // 2, 0, len(x) - POINTS)
    out = np.zeros((len(at), *y.shape[1:]), dtype=np.result_type(y, np.float64))
    for i in range(POINTS):
        others = [first + j for j in range(POINTS) if j != i]
        weight = np.prod([(at - x[o]) / (x[first + i] - x[o]) for o in others], axis=0)
        out += weight.reshape(-1, *[1] * (y.ndim - 1)) * y[first + i]
    return out


class Diffraction:
    """Diffraction tables of one hull, for any sea."""

    def __init__(self, database: HydroDatabase, drift: bool):
        """Resample a database that has `by_panels`; `drift` adds mean drift."""
        assert database.by_panels is not None
        self.drifts = drift
        self.resonance = float(max(database.resonances or [database.omega[-1] / TOP]))
        given = database.excitation - database.by_panels
        if drift:
            assert database.drift is not None
            drifts = np.zeros((*database.drift.shape[:2], 6))
            drifts[..., [0, 1, 5]] = database.drift
            given = np.concatenate([given, drifts])
        self.courses = courses_of(database, given)  # equally spaced over the circle, from the bow on
        found = around(database, given, self.courses)
        left, mean = found[: len(database.omega)], found[len(database.omega) :]
        parts = [left.real, left.imag, *([mean.real[..., [0, 1, 5]]] if drift else [])]
        self.omega = database.omega
        # [n, courses, size]; its last bits depend on numpy's threads, and kernels have no such name (kept.py)
        self.resampled = np.concatenate(parts, axis=-1)
        self.size = int(self.resampled.shape[-1])  # values of a table entry (one frequency and course)

    def stretches(self, interval: float) -> int:
        """Number of sums of the load in a control step of `interval` (s)."""
        return max(1, math.ceil(interval * self.resonance / STRETCH - WHOLE))

    def of(self, sea: Tensor) -> Tensor:
        """Loads of the components of `sea` [sea, 8, component] (conventions.py), [sea * (courses + 1), size,
        component].

        They are for hulls with each of `courses` + 1 headings from north on, and include the amplitudes (drift: per
        amplitude).
        """
        rows = sea.detach().to("cpu", torch.float64).numpy()
        out = torch.empty((len(rows), self.courses + 1, self.size, rows.shape[2]), dtype=sea.dtype)
        for s, row in enumerate(rows):  # one by one, because the loads of all in double precision need much memory
            out[s] = torch.from_numpy(np.ascontiguousarray(np.moveaxis(self._by_heading(row), 0, 2)))
        return out.flatten(0, 1).to(sea.device)

    def _by_heading(self, row: NDArray) -> NDArray[np.float64]:
        """Loads [component, courses + 1, size] of the components [8, component] of one sea."""
        omega = row[OMEGA]
        found = cubic(self.omega, self.resampled, np.clip(omega, self.omega[0], self.omega[-1]))
        slow = np.minimum(omega / self.omega[0], 1.0) ** 2
        fade = np.clip((FADED - omega / self.omega[-1]) / (FADED - 1), 0.0, 1.0)
        found *= (slow * fade * row[AMPLITUDE])[:, None, None]
        course = np.arctan2(row[KY], row[KX])
        turn = np.exp(1j * course[:, None] * np.arange(self.courses // 2 + 1))[..., None]
        # from the component's own course on
        by_course = np.fft.irfft(np.fft.rfft(found, axis=1) * turn, self.courses, axis=1)
        return by_course[:, -np.arange(self.courses + 1) % self.courses]


def courses_of(database: HydroDatabase, loads: NDArray) -> int:
    """Smallest number of equal courses at which loads [n, m, 6], linear between courses, meet the tolerance OFF.

    It is at least FEWEST, and a multiple of the database's headings around the circle: if those are equally spaced,
    they are courses themselves.
    """
    headings = len(_whole(database, loads)[0])
    step = math.lcm(headings, 2)
    courses = math.ceil(FEWEST / step) * step
    while True:
        fine = around(database, loads, 2 * courses)
        here, halfway = fine[:, ::2], fine[:, 1::2]
        largest = np.abs(fine).max(axis=1)
        counts = largest > ABSENT * largest.max(axis=0)
        off = np.abs(halfway - (here + np.roll(here, -1, axis=1)) / 2).max(axis=1)
        if not np.any(off[counts] > OFF * largest[counts]):
            return courses
        courses += step


def around(database: HydroDatabase, loads: NDArray, courses: int) -> NDArray[np.complex128]:
    """Loads [n, m, 6] at a database's headings, converted to equal `courses` around the circle, [n, courses, 6]."""
    heading, whole = _whole(database, loads)
    beta, orders = np.deg2rad(heading), np.arange(-((len(heading) - 1) // 2), (len(heading) - 1) // 2 + 1)
    by_heading = whole.swapaxes(0, 1).reshape(len(beta), -1)
    series = np.linalg.pinv(np.exp(1j * np.outer(beta, orders))) @ by_heading
    course = np.arange(courses) * (math.tau / courses)
    values = np.asarray(np.exp(1j * np.outer(course, orders)) @ series, dtype=np.complex128)
    return values.reshape(courses, len(whole), 6).swapaxes(0, 1)


def _whole(database: HydroDatabase, loads: NDArray) -> tuple[NDArray, NDArray[np.complex128]]:
    """Headings (deg) around the whole circle, and the loads [n, m, 6] at them."""
    heading = database.heading_deg
    whole = np.asarray(loads, dtype=np.complex128)
    if database.symmetric:
        inner = (heading > 0) & (heading < 180)
        mirrored = whole[:, inner][:, ::-1] * np.array([1, -1, 1, -1, 1, -1])
        heading = np.concatenate([heading, 360 - heading[inner][::-1]])
        whole = np.concatenate([whole, mirrored], axis=1)
    elif heading[-1] >= 360:
        heading, whole = heading[:-1], whole[:, :-1]
    return heading, whole


@ti.func
def diffracted(
    diffraction: ti.template(), table: ti.template(), build: ti.template(), around: ti.template(),
    e, label, velocity, tau, psi
):  # fmt: skip
    """Diffraction load (N, N m, about CO, b) on a hull, and its first and second rates of change.

    The hull is at the label `label` [2] (m), moves with `velocity` [2] (m/s) and has the heading psi (rad), tau s after
    the beginning of a step. The drift counts as steady. `table` is Diffraction.of in lanes.
    """
    courses, drifts = ti.static(diffraction.courses, diffraction.drifts)
    s, none = around.env_sea[e], around.waves[0] * 0.0
    load, rate, bend = ti.static(variables(6, none), variables(6, none), variables(6, none))
    cosines, sines = none, none
    of_cosine, of_sine = ti.static(variables(DRIFT, none), variables(DRIFT, none))
    place = psi * ti.static(courses / math.tau)
    place -= ti.floor(place * ti.static(1 / courses)) * courses
    first = ti.min(ti.cast(place, ti.i32), courses - 1)
    share, n = place - first, s * ti.static(courses + 1) + first
    size, heading = ti.static(blocks(build.components), blocks(build.components) * diffraction.size)
    for c in range(ti.static(size)):
        a, kx, ky, omega = component(around.waves, build.components, s, c, (AMPLITUDE, KX, KY, OMEGA))
        here = row_of(n, heading) + c
        sine, cosine = fast_maths.sincos_short(around.turns[e, c] - omega * tau + kx * label[0] + ky * label[1])
        turn = kx * velocity[0] + ky * velocity[1] - omega  # rate of the phase, rad/s
        for j in ti.static(range(6)):
            real = between(table, here + ti.static(j * size), heading, share)
            imaginary = between(table, here + ti.static((6 + j) * size), heading, share)
            now = real * cosine - imaginary * sine
            load[j] += now
            rate[j] = rate[j] - turn * (real * sine + imaginary * cosine)
            bend[j] = bend[j] - turn * turn * now
        if ti.static(drifts):
            cosines += a * cosine
            sines += a * sine
            for j in ti.static(range(DRIFT)):
                mean = between(table, here + ti.static((WAVE + j) * size), heading, share)
                of_cosine[j] += mean * cosine
                of_sine[j] += mean * sine
    loads, rates, bends = totals(load), totals(rate), totals(bend)
    if ti.static(drifts):
        of_cosines, of_sines = totals(of_cosine), totals(of_sine)
        for j in ti.static(range(DRIFT)):
            loads[ti.static((0, 1, 5)[j])] += total(cosines) * of_cosines[j] + total(sines) * of_sines[j]
    return loads, rates, bends


@ti.func
def between(table: ti.template(), here, heading: ti.template(), share):
    """Entry `share` of the way from entry `here` to the same of the next heading, `heading` vectors ahead."""
    return table[here] + share * (table[here + heading] - table[here])


class FilterGroup(NamedTuple):
    """Filters that are coupled to the same modes of motion."""

    begin: int  # index of their first number
    first: int  # index of their first state; real parts, then imaginary parts
    size: int  # number of filters, padded with idle ones to whole vectors (lanes.py)
    modes: tuple[int, ...]


class Bank(NamedTuple):
    """Filters as a kernel processes them.

    The numbers of a group are, for all its filters each: real and imaginary part of 1 / (1 - p dt/2), then of b dt/2
    and of c for every mode.
    """

    groups: tuple[FilterGroup, ...]
    size: int  # number of states
    numbers: Array  # ends with zeros, so that it is never empty

    @classmethod
    def of(cls, filters: Modes, dt: float) -> "Bank":
        """Discretise filters for steps of dt (s)."""
        seen = (filters.enters != 0) | (filters.leaves != 0)
        groups, rows, first, begin = [], [], 0, 0
        for pattern in sorted({tuple(row) for row in seen.tolist()}):
            use = (seen == np.array(pattern)).all(axis=1)
            modes = tuple(int(mode) for mode in np.flatnonzero(pattern))
            gain, enters = 1 / (1 - filters.pole[use] * dt / 2), filters.enters[use] * dt / 2
            columns = [gain, *(x[:, mode] for mode in modes for x in (enters, filters.leaves[use]))]
            size = filled(len(gain))
            rows += [np.pad(part, (0, size - len(gain))) for column in columns for part in (column.real, column.imag)]
            groups.append(FilterGroup(begin, first, size, modes))
            begin, first = begin + 2 * len(columns) * size, first + 2 * size
        return cls(tuple(groups), first, np.concatenate([*rows, np.zeros(filled(1))]))


@ti.func
def radiate(bank: ti.template(), numbers: ti.template(), states: ti.template(), e, i, first: ti.template(), nu):
    """Load -mu (N, N m, about CO, b) in the middle of a step, where the velocity through the water is `nu`.

    The states of the filters are advanced to the end of the step. They lie in the auxiliary state from column `first`
    on. `numbers` are those of the `bank`, `states` is the auxiliary state, both in lanes.
    """
    load = ti.static(variables(6, numbers[0] * 0.0))
    for g in ti.static(range(len(bank.groups))):
        group, size = ti.static(bank.groups[g], blocks(bank.groups[g].size))
        for f in range(size):
            n = ti.static(blocks(group.begin)) + f
            real = ti.static(blocks(first + group.first)) + f
            x, y = states[e, i, real], states[e, i, real + size]
            a, b = x, y
            for c in ti.static(range(len(group.modes))):
                a += numbers[n + ti.static((4 * c + 2) * size)] * nu[group.modes[c]]
                b += numbers[n + ti.static((4 * c + 3) * size)] * nu[group.modes[c]]
            gain_re, gain_im = numbers[n], numbers[n + size]
            x_m, y_m = gain_re * a - gain_im * b, gain_re * b + gain_im * a
            for c in ti.static(range(len(group.modes))):
                leaves_re = numbers[n + ti.static((4 * c + 4) * size)]
                leaves_im = numbers[n + ti.static((4 * c + 5) * size)]
                load[group.modes[c]] += leaves_im * y_m - leaves_re * x_m
            states[e, i, real], states[e, i, real + size] = 2 * x_m - x, 2 * y_m - y
    return totals(load)


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

    def filter_table(self, dt: float) -> Tensor:
        """Numbers of the memory's filters for steps of dt (s), in lanes."""
        return laned(device_table(np.zeros(1)))

    def sea(self, around: Surroundings) -> Tensor | None:
        """Return the sea that `tables` depend on; None if they are the same for any sea."""
        return None

    def tables(self, sea: Tensor | None) -> Mapping[str, Tensor]:
        """Tables for kernels: `diffraction` loads in a sea (zero without a sea)."""
        return {"diffraction": laned(device_table(np.zeros(1)))}

    @ti.func
    def orbital_load(self, M_a: ti.template(), nu_o_dot):
        """Load (N, N m, about CO, b) of the water's orbital acceleration on the added mass M_a (rows)."""
        return nu_o_dot * 0.0

    @ti.func
    def diffraction_from(
        self, dt: ti.template(), build: ti.template(), around: ti.template(), tables: ti.template(), e, n, tau, R, nu,
        L, change, load, rate, bend
    ):  # fmt: skip
        """Diffraction load, and its first and second rates of change, in the middle of the stretch of steps that
        contains step n.

        They are new at the beginning of a stretch; else they are those of the previous step. tau (s) is the time in the
        middle of step n, nu the velocity and L the hull's label there (water.at), whose displacement changes by
        `change` (m) per step.
        """
        return load, rate, bend

    @ti.func
    def diffraction_load(self, dt: ti.template(), n, load, rate, bend):
        """Load (N, N m, about CO, b) in the middle of step n, from load and rates in the middle of its stretch."""
        return load * 0.0

    @ti.func
    def memory_load(self, dt: ti.template(), tables: ti.template(), states: ti.template(), e, i, R, nu, nu_dot, V_c):
        """Load (N, N m, about CO, b) of previously radiated waves in the middle of a step.

        The memory's states, in the auxiliary state in lanes, are advanced to the end of the step.
        """
        return nu * 0.0


@ti.data_oriented
class ConstantRadiation(Radiation):
    """Added mass and damping that are the same at every frequency."""

    def __init__(self, added_mass: Array):
        """Take an added mass [6, 6]."""
        self.inertia = added_mass

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
        """Read the database of `params`, for steps of `dt` (s); its columns in the auxiliary state begin at `first`."""
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
        self.filters, self.first = Bank.of(self.memory.modes, dt), first
        self.columns = self.filters.size
        self.diffraction = Diffraction(database, h.drift)
        self.substeps, self.stretches = substeps, min(self.diffraction.stretches(dt * substeps), substeps)

    def filter_table(self, dt: float) -> Tensor:
        """Numbers of the memory's filters for steps of dt (s), in lanes."""
        return laned(device_table(Bank.of(self.memory.modes, dt).numbers))

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
        """For a sea, diffraction."""
        return super().tables(sea) if sea is None else {"diffraction": laned(self.diffraction.of(sea)).flatten(0, -2)}

    @ti.func
    def diffraction_from(
        self, dt: ti.template(), build: ti.template(), around: ti.template(), tables: ti.template(), e, n, tau, R, nu,
        L, change, load, rate, bend
    ):  # fmt: skip
        """Sum over the components of the sea at the beginning of a stretch."""
        if n * ti.static(self.stretches) % ti.static(self.substeps) < ti.static(self.stretches):
            ahead = -self.since_middle(dt, n)
            velocity = (R @ linear(nu))[:2] + change * (1 / dt)
            load, rate, bend = diffracted(
                self.diffraction, tables.diffraction, build, around,
                e, L + ahead * velocity, velocity, tau + ahead, ti.atan2(R[1, 0], R[0, 0]) + ahead * nu[5],
            )  # fmt: skip
        return load, rate, bend

    @ti.func
    def since_middle(self, dt: ti.template(), n):
        """Time (s) in the middle of step n since the middle of its stretch."""
        stretch = n * ti.static(self.stretches) // ti.static(self.substeps)
        return (n + 0.5 - (stretch + 0.5) * ti.static(self.substeps / self.stretches)) * dt

    @ti.func
    def diffraction_load(self, dt: ti.template(), n, load, rate, bend):
        """Evaluate the Taylor series."""
        since = self.since_middle(dt, n)
        return load + since * (rate + 0.5 * since * bend)

    @ti.func
    def memory_load(self, dt: ti.template(), tables: ti.template(), states: ti.template(), e, i, R, nu, nu_dot, V_c):
        """Load for the velocity through the water in the middle of the step, predicted with the last step's nu_dot."""
        still = R.transpose() @ V_c
        middle = nu + 0.5 * dt * nu_dot - six(still, still * 0.0)
        return radiate(self.filters, tables.filters, states, e, i, self.first, middle)


def radiation_of(params: Hull6DofParams, geometry: HullGeometry, dt: float, substeps: int, first: int) -> Radiation:
    """Return the radiation model that a vehicle file selects; with linear restoring it is always the constant one.

    Arguments are those of DatabaseRadiation.
    """
    if params.restoring == "panels" and params.hydrodynamics.radiation == "memory":
        return DatabaseRadiation(params, geometry, dt, substeps, first)
    return ConstantRadiation(params.M_a)


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
