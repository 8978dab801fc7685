"""Diffraction load of each component of the sea.

The load per unit amplitude X(omega, heading), complex, about CO in b, is the database's excitation minus the
Froude-Krylov load on the simulator's own panels (`by_panels`). It is added to the pressure on the panels. For small
waves the sum is the database's excitation, however few panels there are; the nonlinearity of the undisturbed wave's
pressure remains. A component of amplitude a loads the hull by

    Re(a X(omega, beta) exp(i theta)),   theta: its phase at the hull's label, beta: its direction from the bow.

X is taken at the component's own frequency (the encounter frequency matters in radiation only). It is cubic in omega
and linear between equally spaced courses, to which the database is resampled by its Fourier series. Around a long hull
in short waves, X turns k L / 2 times. The number of courses is therefore chosen so that the error halfway between two
of them is at most OFF times the largest load (`courses_of`). For slower waves than those of the database, diffraction
goes as omega^2; for faster ones it fades to zero at FADED times the highest frequency.

In a control step the load is summed once per STRETCH of phase of waves at the hull's highest resonance, together with
its first and second rates of change. For shorter waves, which hardly move the hull, the error is larger.

Mean drift is an option, by Newman's (1974) approximation of the slowly varying load of pairs of components i and j,

    sum_ij a_i a_j (D_i + D_j) / 2 cos(theta_i - theta_j) = C sum(a D cos theta) + S sum(a D sin theta),

    C + i S = sum(a exp(i theta)).

Its mean is sum a_i^2 D_i, where D(omega, beta) is the mean surge, sway and yaw load per squared amplitude.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import math

import numpy as np
import taichi as ti
import torch
from numpy.typing import NDArray
from torch import Tensor

from taichi_sim.conventions import AMPLITUDE, KX, KY, OMEGA
from taichi_sim.kernels import fast
from taichi_sim.kernels.lanes import blocks, total, totals, variables
from taichi_sim.usv.hull.database import HydroDatabase

FEWEST = 96  # courses of a table, at least
OFF = 0.03  # largest error halfway between two courses, over the largest load of a mode at a frequency
ABSENT = 1e-6  # smaller loads, over a mode's largest load at any frequency, are rounding errors
FADED = 1.3  # times the highest frequency of a database: no diffraction from there on
STRETCH = 0.9  # rad; the third term of the Taylor series, (STRETCH / 2)^3 / 6, is 1.5 % of the load
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
            given = np.concatenate([given, _six(database.drift)])
        self.courses = courses_of(database, given)  # equally spaced over the circle, from the bow on
        found = around(database, given, self.courses)
        left, mean = found[: len(database.omega)], found[len(database.omega) :]
        parts = [left.real, left.imag, *([mean.real[..., [0, 1, 5]]] if drift else [])]
        self.omega, self.table = database.omega, np.concatenate(parts, axis=-1)  # [n, courses, size]

    def stretch(self, dt: float) -> int:
        """Number of steps of dt (s) for which the load is summed once."""
        return max(1, int(STRETCH / (self.resonance * dt)))

    @property
    def size(self) -> int:
        """Numbers per entry."""
        return int(self.table.shape[-1])

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
        found = cubic(self.omega, self.table, np.clip(omega, self.omega[0], self.omega[-1]))
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
    series = np.linalg.lstsq(np.exp(1j * np.outer(beta, orders)), by_heading, rcond=None)
    course = np.arange(courses) * (math.tau / courses)
    values = np.asarray(np.exp(1j * np.outer(course, orders)) @ series[0], dtype=np.complex128)
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


def _six(drift: NDArray) -> NDArray:
    """Surge, sway and yaw drift [n, m, 3] as six loads."""
    whole = np.zeros((*drift.shape[:2], 6))
    whole[..., [0, 1, 5]] = drift
    return whole


@ti.func
def diffracted(
    diffraction: ti.template(), table: ti.template(), build: ti.template(), around: ti.template(),
    e, label, velocity, tau, psi
):  # fmt: skip
    """Diffraction load (N, N m, about CO, b) on a hull, and its first and second rates of change.

    The hull is at the label `label` [2] (m), moves with `velocity` [2] (m/s) and has the heading psi (rad), tau s after
    the beginning of a step. The drift counts as steady. `table` is Diffraction.of in lanes.
    """
    sea, courses, drifts = ti.static(around.waves, diffraction.courses, diffraction.drifts)
    s = around.env_sea[e]
    none = sea[s, AMPLITUDE, 0] * 0.0
    load, rate, bend = ti.static(variables(6, none), variables(6, none), variables(6, none))
    cosines, sines = none, none
    of_cosine, of_sine = ti.static(variables(DRIFT, none), variables(DRIFT, none))
    place = psi * ti.static(courses / math.tau)
    place -= ti.floor(place * ti.static(1 / courses)) * courses
    first = ti.min(ti.cast(place, ti.i32), courses - 1)
    share, n = place - first, s * ti.static(courses + 1) + first
    for c in range(ti.static(blocks(build.components))):
        kx, ky, omega = sea[s, KX, c], sea[s, KY, c], sea[s, OMEGA, c]
        sine, cosine = fast.sincos_short(kx * label[0] + ky * label[1] + around.turns[e, c] - omega * tau)
        turn = kx * velocity[0] + ky * velocity[1] - omega  # rate of the phase, rad/s
        for j in ti.static(range(6)):
            real, imaginary = between(table, n, j, c, share), between(table, n, 6 + j, c, share)
            now = real * cosine - imaginary * sine
            load[j] += now
            rate[j] = rate[j] - turn * (real * sine + imaginary * cosine)
            bend[j] = bend[j] - turn * turn * now
        if ti.static(drifts):
            amplitude = sea[s, AMPLITUDE, c]
            cosines += amplitude * cosine
            sines += amplitude * sine
            for j in ti.static(range(DRIFT)):
                mean = between(table, n, WAVE + j, c, share)
                of_cosine[j] += mean * cosine
                of_sine[j] += mean * sine
    loads, rates, bends = totals(load), totals(rate), totals(bend)
    if ti.static(drifts):
        of_cosines, of_sines = totals(of_cosine), totals(of_sine)
        for j in ti.static(range(DRIFT)):
            loads[ti.static((0, 1, 5)[j])] += total(cosines) * of_cosines[j] + total(sines) * of_sines[j]
    return loads, rates, bends


@ti.func
def between(table: ti.template(), n, row: ti.template(), c, share):
    """Entry `row` at a heading that lies `share` of the way from the n-th heading to the next."""
    return table[n, row, c] + share * (table[n + 1, row, c] - table[n, row, c])
