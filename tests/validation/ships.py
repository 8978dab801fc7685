"""Checks of hydrodynamic databases against another boundary-element code's tables of ships.

Tables are z up and y to port with exp(-i omega t), moments about the origin on the waterline, headings where waves
travel to, 90 to port: NAME_added_mass_damping.csv, NAME_excitation.csv, NAME_drift.csv, NAME_rao.csv, NAME_meta.json.
Ours is the database NAME.hydro.json beside the table, or the one shipped with the vehicle NAME; else one computed on
NAME_half_hull_panels.csv (remembering.py). It is asked at the table's frequencies, between its own ones by cubics.

Scales: a diagonal entry's largest in its column; a coupled one's geometric mean of the two diagonals' largest (small
couplings of a ship nearly alike fore and aft are the least certain figures of both codes); a load's largest in its
column.

Judged are frequencies below the first at which water inside the hull, a box of its length, beam and draught, would
slosh ("irregular frequencies"): k = pi sqrt(1/L^2 + 1/B^2), omega^2 = g k coth(k T). Tables of codes run without a lid
jump from there on; ours have one. Mean drift is judged at SHORT periods in head and beam seas: longer ones hang on
motions, and the published FPSO's are integrated pressures that do not vanish in long waves (docs/hydrodynamics.md).

Published motions may have linear damping beside radiation (`B_external_linear` of NAME_meta.json, [6, 6] in the table's
frame, most often of roll): ours get the same.
"""

import re
from typing import Any

import numpy as np

from taichi_sim.models.usv.hull.database import HydroDatabase
from taichi_sim.models.usv.hull.radiation import cubic
from tests.validation.case import Case
from tests.validation.regular import motions
from tests.validation.remembering import database_of, external_damping, hull_of, matrix, slowest_decay
from tests.validation.tables import Table, TableError, read_csv, read_json

TURN = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # ours to theirs
MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # waves to starboard to waves to port
BEM_TOLERANCE, DRIFT_TOLERANCE, RAO_TOLERANCE = 0.03, 0.15, 0.05
SHORT = (6.0, 7.5)  # s, of the drift that is judged
SHOWN = (5.0, 30.0)  # s, of RAO
HEAD, BEAM = 180.0, 90.0  # deg
SAME = 1e-4  # of a frequency
MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")


def added_mass_damping(case: Case) -> None:
    """*_added_mass_damping.csv: every column A11, B24 ... it has."""
    table = read_csv(case.path)
    found = database_of(case, _name(case))
    omega = table["omega"]
    judged = omega < _sloshing(case)
    ours = {"A": _at(found, found.added_mass, omega), "B": _at(found, found.damping, omega)}
    for name in table.header:
        match = re.fullmatch(r"([AB])([1-6])([1-6])", name)
        if not match:
            continue
        kind, i, j = match[1], int(match[2]) - 1, int(match[3]) - 1
        scale = np.sqrt(np.prod([np.abs(table[f"{kind}{m + 1}{m + 1}"]).max() for m in (i, j)]))
        values = (ours[kind] * TURN[:, None] * TURN)[:, i, j]
        case.absolute(f"{name}, of the largest", (values / scale)[judged], (table[name] / scale)[judged], BEM_TOLERANCE)


def excitation(case: Case) -> None:
    """*_excitation.csv: complex load of each mode."""
    table = read_csv(case.path)
    found = database_of(case, _name(case))
    judged = table["omega"] < _sloshing(case)
    ours = _loads(found, found.excitation, table) * TURN * MIRROR
    for mode in range(6):
        theirs = table[f"X{mode + 1}_abs"] * np.exp(1j * np.deg2rad(table[f"X{mode + 1}_phase_deg"]))
        scale = np.abs(theirs[judged]).max()
        error = np.abs(ours[:, mode] - theirs)[judged] / scale
        case.absolute(f"{MODES[mode]} load, of the largest", error, 0 * error, BEM_TOLERANCE)


def drift(case: Case) -> None:
    """*_drift.csv: surge in head seas and sway in beam seas, at short periods."""
    table = read_csv(case.path)
    found = database_of(case, _name(case))
    if found.drift is None:
        return
    period = 2 * np.pi / table["omega"]
    ours = _loads(found, found.drift, table) * (TURN * MIRROR)[[0, 1, 5]]
    for name, column, heading in (("F1", 0, HEAD), ("F2", 1, BEAM)):
        use = (table["heading_deg"] == heading) & (period >= SHORT[0]) & (period <= SHORT[1])
        if use.any():
            error = ours[use, column] / table[name][use] - 1
            case.absolute(f"{name} at {heading:g} deg, relative", error, 0 * error, DRIFT_TOLERANCE)


def response(case: Case) -> None:
    """*_rao.csv: motions that follow from the database with mass, stiffness and added damping of NAME_meta.json, and
    those of the simulator's hull, run in time.
    """
    table = read_csv(case.path)
    found = database_of(case, _name(case))
    meta = read_json(case.folder.use(case.path.with_name(f"{_name(case)}_meta.json")))
    ours = motions_of(found, meta, table)
    period = 2 * np.pi / table["omega"]
    use = (period >= SHOWN[0]) & (period <= SHOWN[1])
    in_time = np.zeros_like(ours)
    model, found = hull_of(case, _name(case))
    heading = -np.deg2rad(table["heading_deg"])[use]
    in_time[use] = motions(model, table["omega"][use], heading, slowest_decay(model, found)) * TURN
    for how, values in (("database", ours), ("run in time", in_time)):
        for mode, name in enumerate(MODES):
            theirs = table[f"{name}_abs"] * np.exp(1j * np.deg2rad(table[f"{name}_phase_deg"]))
            error = np.abs(values[:, mode] - theirs)[use] / np.abs(theirs[use]).max()
            case.absolute(f"{name}, {how}, of the peak", error, 0 * error, RAO_TOLERANCE)


def motions_of(found: HydroDatabase, meta: Any, table: Table) -> np.ndarray:
    """Complex amplitudes [row, 6], in the table's frame, that a database makes with M, C and, where it is said, the
    damping that was added (`B_external_linear`) of a ship's meta file: (-w^2 (M + A) - i w (B + B_ext) + C) eta = X.
    """
    M, C, added = matrix(meta, "M"), matrix(meta, "C"), external_damping(meta)
    omega = np.unique(table["omega"])
    A, B = (_at(found, x, omega) * TURN[:, None] * TURN for x in (found.added_mass, found.damping))
    loads = _loads(found, found.excitation, table) * TURN * MIRROR
    ours = np.zeros_like(loads)
    for i, w in enumerate(omega):
        rows = table["omega"] == w
        ours[rows] = np.linalg.solve(-(w**2) * (M + A[i]) - 1j * w * (B[i] + added) + C, loads[rows].T).T
    return ours


def _name(case: Case) -> str:
    """Of the ship."""
    return re.sub(r"_(added_mass_damping|excitation|drift|rao)\.csv$", "", case.path.name)


def _sloshing(case: Case) -> float:
    """The first irregular frequency of a box round the hull, rad/s; without its panels, none."""
    path = case.path.with_name(f"{_name(case)}_half_hull_panels.csv")
    if not path.is_file():
        return np.inf
    corners = np.loadtxt(case.folder.use(path), delimiter=",", skiprows=1).reshape(-1, 3)
    length, half_beam, draught = np.ptp(corners, axis=0)
    k = np.pi * np.hypot(1 / length, 1 / (2 * half_beam))
    return float(np.sqrt(9.81 * k / np.tanh(k * draught)))


def _at(found: HydroDatabase, values: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Values [n, ...] of the database at frequencies [m]."""
    if omega.min() < found.omega[0] * (1 - SAME) or omega.max() > found.omega[-1] * (1 + SAME):
        raise TableError(
            f"the database reaches from {found.omega[0]:g} to {found.omega[-1]:g} rad/s, "
            f"the table from {omega.min():g} to {omega.max():g}"
        )
    near = np.abs(found.omega - omega[:, None]).argmin(axis=1)
    exact = np.abs(found.omega[near] / omega - 1) < SAME
    out = np.asarray(values)[near]
    if not exact.all():
        out = out.copy()
        out[~exact] = cubic(found.omega, np.asarray(values), omega[~exact])
    return out


def _loads(found: HydroDatabase, values: np.ndarray, table: Table) -> np.ndarray:
    """Values [n, heading, ...] at the rows of a table."""
    omega, row = np.unique(table["omega"], return_inverse=True)
    heading = table["heading_deg"]
    near = np.abs(found.heading_deg - heading[:, None]).argmin(axis=1)
    if np.abs(found.heading_deg[near] - heading).max() > SAME:
        missing = np.setdiff1d(heading, found.heading_deg)
        raise TableError(f"the database has no heading of {', '.join(f'{h:g}' for h in missing)} deg")
    return _at(found, values, omega)[row, near]
