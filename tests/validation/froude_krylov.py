"""Checks of the kernel's wave pressure load on a box against closed forms and boundary-element figures.

The tables are z up and y to port, with moments about the centre of the waterplane and F(t) = Re(F exp(-i omega t)) for
eta = a cos(k (x cos b + y sin b) - omega t): ours is forward-right-down, so modes 2, 3, 5 and 6 and the direction turn
over. The load is read off the stepping kernel: a box without added mass and damping is let go for an instant, and its
mass times the velocity it gains is the impulse. One wave of a small amplitude per environment, once with its crest at
the origin (real part) and once a quarter period later (imaginary part); what a box gains without a wave is taken off.
"""

import numpy as np

from taichi_sim.bench import Bench
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components, wavenumber
from tests.validation.box import NO_LOADS, Box, box_of
from tests.validation.case import Case
from tests.validation.tables import TableError, read_csv

AMPLITUDE = 1e-3  # m: of a wave so low that second order does not count
PANELS = (40, 20, 10)  # along, across, up: panels of 0.1 m for waves of 2 m
INSTANT = 1e-6  # s: the waves hardly move, and in f64 enough digits are left
GYRATION = [1.0, 1.0, 1.0]  # m, any
TURN_OVER = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # ours to theirs
TOLERANCE = np.array([0.01, 0.01, 0.01, 0.02, 0.02, 0.02])  # of the mode's largest magnitude in the table
BEM_TOLERANCE = 0.02  # of the same; their panels are flat and finite too
MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")


def load(box: Box, omega: np.ndarray, direction: np.ndarray, depth: float | None) -> np.ndarray:
    """Complex Froude-Krylov load [row, 6] per unit amplitude (N/m, N) in the tables' conventions.

    omega [row] rad/s, direction [row] (rad, their sense), depth m or None.
    """
    rows = len(omega)
    k = wavenumber(omega, depth)
    one = np.ones(rows)
    # crest at the origin, a quarter period later, and no wave
    phase = np.concatenate([0 * one, -np.pi / 2 * one, 0 * one])[:, None]
    amplitude = AMPLITUDE * np.concatenate([one, one, 0 * one])[:, None]
    columns = [np.tile(v, 3)[:, None] for v in (k, omega, -direction)]
    sea = Sea(Components(amplitude, *columns, phase), depth)
    params = box.params(box.shape(*PANELS), GYRATION, NO_LOADS)
    bench = Bench(Hull6Dof(params, INSTANT, 1), sea=sea, envs=3 * rows)
    bench.step([0.0, 0.0])
    wrench = bench.read().nu @ params.M_rb / INSTANT  # M_rb is symmetric
    real, imaginary, still = wrench.reshape(3, rows, 6)
    return TURN_OVER * ((real - still) + 1j * (imaginary - still)) / AMPLITUDE


def closed_form(case: Case) -> None:
    """froude_krylov_box*.csv: real and imaginary part of six loads, deep and finite depth (f64)."""
    table = read_csv(case.path)
    box = box_of(case)
    depth = table["depth"]
    ours = np.empty((len(table), 6), dtype=complex)
    for d in np.unique(depth):
        rows = depth == d
        ours[rows] = load(box, table["omega"][rows], np.deg2rad(table["beta_deg"][rows]), None if d < 0 else float(d))
    for mode, name in enumerate(MODES):
        re, im = (table[f"F{mode + 1}_{part}"] for part in ("re", "im"))
        error = _relative(ours[:, mode].real, ours[:, mode].imag, re, im)
        case.absolute(f"{name}, relative", error, 0 * error, TOLERANCE[mode])


def _relative(real, imaginary, re, im) -> np.ndarray:
    """Errors of both parts [2, row] on the scale of the largest magnitude in the table, of 1 N where that is none."""
    scale = float(np.hypot(re, im).max())
    return np.stack([real - re, imaginary - im]) / max(scale, 1.0)


def excitation(case: Case) -> None:
    """box_*_excitation.csv: magnitudes of the Froude-Krylov part in the columns FK1_abs .. FK6_abs (f64)."""
    table = read_csv(case.path)
    ours = np.abs(load(box_of(case), table["omega"], np.deg2rad(table["heading_deg"]), None))
    found = [mode for mode in range(6) if f"FK{mode + 1}_abs" in table]
    if not found:
        raise TableError("no column FK1_abs .. FK6_abs")
    for mode in found:
        theirs = table[f"FK{mode + 1}_abs"]
        error = (ours[:, mode] - theirs) / max(float(theirs.max()), 1.0)
        case.absolute(f"{MODES[mode]} (Froude-Krylov), relative", error, 0 * error, BEM_TOLERANCE)
