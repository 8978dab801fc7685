"""Checks of the fixed-wing equations against what the solution code of Beard and McLain's course (mavsim) computed.

mavsim_solution_code_*.csv with a column of times is a flight by that code's own integrator, which is repeated here on
our equations: forces and moments, weight included, are held over a step and the rigid body is stepped by the
classical Runge-Kutta method, so that what differs is the physics. Without times a table holds random states, with
derivatives (d_u ..) or forces and moments (fx .. Mz). The name gives the variant (_A, _B) and a flight's step (dt0.01).
Controls are columns, in force from their row to the next, or else those of the flight of the same name beside it
(elevator_doublet_A.csv of mavsim_solution_code_elevator_doublet_A_dt0.01.csv). Columns may have any name of NAMES.
"""

import re

import numpy as np
import torch

from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, POSITION, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_euler_from_quaternion, torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.uav.fixed_wing.airframe_arrays import loads
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from tests.validation.aerosonde import CONTROLS, DT, EULER, ORDER, in_a_vacuum, rigid_body, scaled, variant
from tests.validation.aerosonde_numbers import parameters
from tests.validation.case import Case
from tests.validation.inputs import check_air, check_start, check_way, wind_of
from tests.validation.tables import UNEVEN, InputsMissingError, Table, TableError, even_interval, read_csv

PLACE_TOLERANCE, MOTION_TOLERANCE = 1e-5, 1e-6  # m; m/s, rad/s, 1, rad: by the same integrator, from printed inputs
PREFIX = "mavsim_solution_code_"
PLACE, SPEED, TURN, RATES = ("north", "east", "down"), ("u", "v", "w"), ("e0", "e1", "e2", "e3"), ("p", "q", "r")
LOADS = ("fx", "fy", "fz", "Mx", "My", "Mz")
AIR = ("wn", "we", "wd")
NAMES = {  # of each quantity, what a table may call it
    "t": ("t", "time"),
    "north": ("north", "pn", "n"), "east": ("east", "pe", "e"), "down": ("down", "pd", "d"),
    "elevator": ("elevator", "delta_e", "elev"), "aileron": ("aileron", "delta_a", "ail"),
    "rudder": ("rudder", "delta_r", "rud"), "throttle": ("throttle", "delta_t", "thr"),
    "wn": ("wn", "w_n"), "we": ("we", "w_e"), "wd": ("wd", "w_d"),
    "fx": ("fx", "f_x"), "fy": ("fy", "f_y"), "fz": ("fz", "f_z"),
    "Mx": ("Mx", "ell"), "My": ("My",), "Mz": ("Mz",),
}  # fmt: skip


def solution_code(case: Case) -> None:
    """mavsim_solution_code_*.csv; see the module."""
    table = _renamed(read_csv(case.path))
    (flight if "t" in table else samples)(case, table, parameters(case, variant(case)))


def flight(case: Case, table: Table, p: FixedWingParams) -> None:
    """A flight from the first row, repeated by the integrator that made it."""
    check_start(case, table, (*PLACE, *SPEED, *(TURN if TURN[0] in table else EULER), *RATES))
    states, controls, wind = _states(table), _controls(case, table), wind_of(case, table)
    check_air(table, _relative(states, wind))
    check_way(table, states[:, POSITION], np.einsum("nij,nj->ni", _rotation(states), states[:, VELOCITY]))
    found = re.search(r"_dt(\d+(?:\.\d+)?)", case.path.stem)
    interval = even_interval(table["t"])
    dt = float(found[1]) if found else interval
    steps = round(interval / dt)
    if steps < 1 or abs(interval / dt - steps) > UNEVEN:
        raise TableError(f"column 't': rows are not a whole number of steps of {dt} s apart")
    airless, y, ours = in_a_vacuum(p), states[0], [states[0]]
    for row in range(len(table) - 1):
        for _ in range(steps):
            y = _held_step(airless, y, _loads(p, y[None], controls[row : row + 1], wind[row : row + 1])[0], dt)
        ours.append(y)
    _compare(case, table, np.array(ours))


def samples(case: Case, table: Table, p: FixedWingParams) -> None:
    """Derivatives, or forces and moments, at random states."""
    states, controls, wind = _states(table), _controls(case, table), wind_of(case, table)
    check_air(table, _relative(states, wind))
    names = (*PLACE, *SPEED, *TURN, *RATES)
    slopes = dict(zip(names, FixedWing6DOF(p, DT, 1).rhs(states, controls, wind=wind)[:, ORDER].T, strict=True))
    forces = dict(zip(LOADS, _loads(p, states, controls, wind).T, strict=True))
    ours = {f"d_{name}": values for name, values in slopes.items()} | forces
    there = [name for name in ours if name in table]
    if not there:
        raise TableError(f"no column of {', '.join(ours)}")
    for name in there:
        scaled(case, name, ours[name], table[name], table.resolution(name))


def _renamed(table: Table) -> Table:
    """The table with our names of its columns."""
    ours = {other: name for name, others in NAMES.items() for other in others}
    ours |= {f"d_{other}": f"d_{name}" for other, name in ours.items()}
    return Table(tuple(ours.get(re.split(r"[(=]", cell)[0], cell) for cell in table.header), table.rows)


def _states(table: Table) -> np.ndarray:
    """Our states [row, 13]; attitude by quaternion or by Euler angles."""
    columns = [table[c] for c in (*PLACE, *SPEED)]
    if TURN[0] in table:
        turn = [table[c] for c in TURN]
    else:
        turn = [*torch_quaternion_from_euler(*(torch.tensor(table[c]) for c in EULER)).T.numpy()]
    states = np.empty((len(table), 13))
    states[:, ORDER] = np.stack([*columns, *turn, *(table[c] for c in RATES)], axis=1)
    return states


def _controls(case: Case, table: Table) -> np.ndarray:
    """Elevator, aileron, rudder, throttle [row, 4] of the table, or of the flight beside it at the same times."""
    if all(name in table for name in CONTROLS):
        return np.stack([table[name] for name in CONTROLS], axis=1)
    name = re.sub(r"_dt\d+(\.\d+)?$", "", case.path.stem.removeprefix(PREFIX)) + ".csv"
    path = case.path.with_name(name)
    if "t" not in table or not path.is_file():
        raise InputsMissingError(f"inputs missing: no columns {', '.join(CONTROLS)}, and no {name} beside the table")
    other = _renamed(read_csv(case.folder.use(path)))
    row = np.searchsorted(other["t"], table["t"] + UNEVEN * even_interval(table["t"]), side="right") - 1
    if row.min() < 0 or table["t"][-1] > other["t"][-1] + even_interval(other["t"]):
        raise InputsMissingError(f"inputs missing: {name} has no controls at some of the times")
    return np.stack([other[c] for c in CONTROLS], axis=1)[row]


def _rotation(states: np.ndarray) -> np.ndarray:
    return torch_rotation_matrix(torch.tensor(states[..., QUATERNION])).numpy()


def _relative(states: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """Velocity relative to the air (m/s, b) [.., 3]."""
    return states[..., VELOCITY] - np.einsum("...ji,...j->...i", _rotation(states), wind)


def _loads(p: FixedWingParams, states: np.ndarray, controls: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """Forces (N), weight included, and moments (N m) [row, 6] in b."""
    found = loads(p, _relative(states, wind), states[..., ANGULAR_VELOCITY], controls)[:, :6]
    found[:, :3] += p.physical.mass * GRAVITY * _rotation(states)[:, 2]
    return found


def _held_step(airless: FixedWing6DOF, y: np.ndarray, load: np.ndarray, dt: float) -> np.ndarray:
    """State [13] after a Runge-Kutta step under a `load` [6] that is held, force (N), weight included, and moment."""
    k1 = rigid_body(airless, y, load)
    k2 = rigid_body(airless, y + dt / 2 * k1, load)
    k3 = rigid_body(airless, y + dt / 2 * k2, load)
    k4 = rigid_body(airless, y + dt * k3, load)
    new = y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    new[QUATERNION] /= np.linalg.norm(new[QUATERNION])
    return new


def _compare(case: Case, table: Table, ours: np.ndarray) -> None:
    """States [row, 13] with the table's columns; attitude in the table's own form."""
    q = ours[:, QUATERNION]
    if TURN[0] in table:
        same = np.sign(np.einsum("ij,ij->i", q, np.stack([table[c] for c in TURN], axis=1)))
        turn = dict(zip(TURN, same * q.T, strict=True))  # q and -q are one attitude
    else:
        angles = torch_euler_from_quaternion(torch.tensor(q)).numpy().T
        whole = [2 * np.pi * np.round((table[c] - a) / (2 * np.pi)) for c, a in zip(EULER, angles, strict=True)]
        turn = {c: a + w for c, a, w in zip(EULER, angles, whole, strict=True)}
    moving = zip((*PLACE, *SPEED, *RATES), ours[:, [0, 1, 2, 7, 8, 9, 10, 11, 12]].T, strict=True)
    for name, values in (dict(moving) | turn).items():
        tolerance = PLACE_TOLERANCE if name in PLACE else MOTION_TOLERANCE
        case.absolute(name, values, table[name], tolerance, table.resolution(name))
