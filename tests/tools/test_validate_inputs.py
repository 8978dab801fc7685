"""`tools/validate.py` tells wrong inputs from wrong physics, and reads all inputs that a table has."""

import json
import shutil

import numpy as np
import pytest
import torch
from folders import REFERENCE

from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from tests.validation import mavsim, otter
from tests.validation.case import Case, Folder
from tests.validation.otter_numbers import parameters
from tests.validation.registry import CHECKERS
from tests.validation.report import INPUTS, validate
from tests.validation.shafts import shaft_commands
from tests.validation.tables import Table, read_csv

MAVSIM = "mavsim_solution_code_elevator_doublet_A_dt0.01.csv"
WIND = np.array([4.0, -3.0, 0.0])  # m/s
LAG = 0.1  # s


def columns_of(name):
    """A reference table's columns by name, to be changed and written."""
    table = read_csv(REFERENCE / name)
    return {name: table[name] for name in table.header}


def write(file, columns):
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{value:.12g}" for value in row) for row in rows)]
    file.write_text("\n".join(lines) + "\n")


def in_wind(columns):
    """The same flight through air that moves: more velocity over ground, another track, all else alike."""
    euler = [torch.tensor(columns[c]) for c in ("phi", "theta", "psi")]
    R = torch_rotation_matrix(torch_quaternion_from_euler(*euler)).numpy()
    moved = columns | {c: columns[c] + w for c, w in zip("uvw", (WIND @ R).T, strict=True)}
    moved |= {c: columns[c] + w * columns["t"] for c, w in zip(("north", "east", "down"), WIND, strict=True)}
    return moved


def report_of(folder, *functions):
    """The report of the directory by the checkers that use `functions` (default: all)."""
    return validate(folder, [c for c in CHECKERS if not functions or c.function in functions])


# -- contradictions ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_wind_in_columns_is_flown_in(tmp_path):
    flight = in_wind(columns_of("aerosonde/elevator_doublet_A.csv"))
    told = {c: np.full(len(flight["t"]), w) for c, w in zip(("wn", "we", "wd"), WIND, strict=True)}
    write(tmp_path / "doublet_in_wind_A.csv", flight | told)
    report = report_of(tmp_path)
    assert len(report.checks) == 30 and not [check for check in report.checks if not check.passed]


@pytest.mark.parametrize(
    ("without", "named"), [((), "'Va' is 25 in row 2"), (("Va", "alpha", "beta"), "the positions go")]
)
def test_a_wind_that_is_not_told_is_a_missing_input(without, named, tmp_path):
    flight = in_wind(columns_of("aerosonde/elevator_doublet_A.csv"))
    if without:  # and velocities are relative to the air
        flight |= {c: columns_of("aerosonde/elevator_doublet_A.csv")[c] for c in "uvw"}
    write(tmp_path / "doublet_A.csv", {name: values for name, values in flight.items() if name not in without})
    report = report_of(tmp_path)
    assert [check.problem for check in report.checks] == [INPUTS] * 2  # once per precision, and nothing else
    assert all(named in check.quantity and "wn, we, wd" in check.quantity for check in report.checks)
    assert not report.passed
    assert "2 checks, 0 failed, 2 could not be made: inputs missing" in report.to_text()
    assert "FAIL" not in report.to_text()


@pytest.mark.parametrize(("u", "same"), [pytest.param(2.0, True, marks=pytest.mark.slow), (1.5, False)])
def test_the_state_beside_a_table_is_its_first_row(u, same, tmp_path):
    shutil.copy(REFERENCE / "otter" / "decay_surge_converged.csv", tmp_path)
    start = {"initial_state": {"u": u, "v": 0.0}}
    (tmp_path / "decay_surge.json").write_text(json.dumps(start))
    report = report_of(tmp_path, otter.trajectory)
    assert report.unchecked == []
    if same:
        assert report.passed and len(report.checks) > 20
    else:
        assert {check.problem for check in report.checks} == {INPUTS}
        assert "'u' begins at 2, 'initial_state' beside it at 1.5" in report.checks[0].quantity


# -- shaft speeds -----------------------------------------------------------------------------------------------


def shafts(command, interval, end):
    """A table of two shafts under `command` (t), by steps of 1 ms, and their speeds [step] every ms."""
    fine = np.arange(0.0, end, 1e-3)
    n, speeds = 0.0, [0.0]
    for t in fine:
        c = command(t + 0.5e-3)
        n = c + (n - c) * np.exp(-1e-3 / LAG)
        speeds.append(n)
    speeds = np.array(speeds)
    rows = speeds[:: round(interval * 1e3)]
    cells = zip(np.arange(len(rows)) * interval, rows, rows, strict=True)
    return Table(("t", "n1", "n2"), tuple(tuple(f"{value:.9g}" for value in row) for row in cells)), speeds


@pytest.mark.parametrize(
    ("command", "error"),
    [
        (lambda t: 80.0, 1e-5),
        (lambda t: (90.0, 60.0, -40.0)[int(t // 2.0)], 1e-4),  # held from rows on
        (lambda t: (90.0, 60.0, -40.0)[int((t + 0.25) // 2.2)], 1e-4),  # changed between rows
        (lambda t: 60 + 30 * np.cos(7.0 * (t // 0.5) ** 2), 1e-4),  # another at every row
        (lambda t: 80 + 15 * np.sin(0.5 * t), 0.7),  # smooth after a start from rest
    ],
)
def test_shafts_turn_as_in_the_table(command, error, tmp_path):
    """The commands read from rows every 0.5 s drive a shaft along its own speeds, rad/s."""
    table, speeds = shafts(command, 0.5, 6.0)
    steps, n, worst = 50, 0.0, 0.0
    commands = shaft_commands(table, None, LAG, steps)
    parts = 0.5 / commands.shape[1]
    for k, c in enumerate(commands[..., 0].ravel()):
        n = c + (n - c) * np.exp(-parts / LAG)
        worst = max(worst, abs(n - speeds[round((k + 1) * parts * 1e3)]))
    assert worst < error


@pytest.mark.slow
def test_a_run_follows_the_shaft_speeds_of_its_columns(tmp_path, f64):
    """A hull whose propellers turn by 80 + 15 sin and 70 + 10 cos, stepped by our right-hand side in 20 ms."""
    p = parameters(Case(Folder(tmp_path), tmp_path / "any_converged.csv", "f64"))

    def speeds(t):
        return np.array([80 + 15 * np.sin(0.7 * t), 70 + 10 * np.cos(0.5 * t)])

    def slope(t, y):
        nu_dot = otter.accelerations(p, y[None, :6], y[None, 6:], speeds(t)[None])[0]
        return np.concatenate((otter.pose_rate(y[None, :6], y[None, 6:])[0], nu_dot))

    h, y, rows = 0.02, np.eye(12)[6], []
    for step in range(151):
        t = step * h
        if step % 5 == 0:
            rows.append((t, *y, *speeds(t)))
        k1 = slope(t, y)
        k2 = slope(t + h / 2, y + h / 2 * k1)
        k3 = slope(t + h / 2, y + h / 2 * k2)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(t + h, y + h * k3))
    names = ("t", *otter.POSE, *otter.NU, "n1", "n2")
    write(tmp_path / "weaving_n80_converged.csv", dict(zip(names, np.array(rows).T, strict=True)))
    report = report_of(tmp_path, otter.trajectory)
    assert len(report.checks) == 24 and not [check for check in report.checks if not check.passed]


# -- the course's solution code ----------------------------------------------------------------------------------


def copy_mavsim(folder, **renamed):
    columns = columns_of(f"aerosonde/{MAVSIM}")
    write(folder / MAVSIM, {renamed.get(name, name): values for name, values in columns.items()})
    return columns


def test_its_flight_needs_controls(tmp_path):
    copy_mavsim(tmp_path)
    (check,) = report_of(tmp_path).checks
    assert check.problem == INPUTS and "no elevator_doublet_A.csv beside" in check.quantity


@pytest.mark.slow
def test_columns_may_have_the_courses_names(tmp_path):
    """pn, pe, pd; Euler angles instead of a quaternion; controls in columns of the table itself."""
    columns = columns_of(f"aerosonde/{MAVSIM}")
    e0, e1, e2, e3 = (columns.pop(f"e{k}") for k in range(4))
    columns["phi"] = np.arctan2(2 * (e0 * e1 + e2 * e3), 1 - 2 * (e1**2 + e2**2))
    columns["theta"] = np.arcsin(2 * (e0 * e2 - e3 * e1))
    columns["psi"] = np.arctan2(2 * (e0 * e3 + e1 * e2), 1 - 2 * (e2**2 + e3**2))
    other = columns_of("aerosonde/elevator_doublet_A.csv")
    columns |= {f"delta_{c[0]}": other[c] for c in ("elevator", "aileron", "rudder", "throttle")}
    renamed = {"t": "time", "north": "pn", "east": "pe", "down": "pd"}
    write(tmp_path / MAVSIM, {renamed.get(name, name): values for name, values in columns.items()})
    report = report_of(tmp_path)
    assert {check.quantity for check in report.checks} >= {"north", "theta", "q"}
    assert not [check for check in report.checks if not check.passed]


@pytest.mark.slow
def test_a_wrong_equation_shows_in_its_flight(tmp_path):
    """One part in a thousand of C_m_q, as params/aerosonde.toml of the directory has it."""
    copy_mavsim(tmp_path)
    shutil.copy(REFERENCE / "aerosonde" / "elevator_doublet_A.csv", tmp_path)
    text = (REFERENCE / "params" / "aerosonde.toml").read_text()
    (tmp_path / "aerosonde.toml").write_text(text.replace("C_m_q = -38.21", "C_m_q = -38.25"))
    failed = {check.quantity for check in report_of(tmp_path, mavsim.solution_code).checks if not check.passed}
    assert {"w", "q", "e2"} <= failed and not failed & {"v", "p", "r"}


def test_its_forces_are_compared_where_a_table_has_them(tmp_path):
    """Random states with fx .. Mz: those of the derivatives beside them, fx = m (u_dot + q w - r v)."""
    table = columns_of("aerosonde/rhs_samples_A.csv")
    m = 11.0  # kg
    p, q, r, u, v, w = (table[c] for c in "pqruvw")
    forces = {"fx": m * (table["d_u"] + q * w - r * v), "fy": m * (table["d_v"] + r * u - p * w)}
    forces["fz"] = m * (table["d_w"] + p * v - q * u)
    states = {name: values for name, values in table.items() if not name.startswith("d_")}
    write(tmp_path / "mavsim_solution_code_forces_A.csv", states | forces)
    report = report_of(tmp_path)
    assert report.passed and {check.quantity[:2] for check in report.checks} == {"fx", "fy", "fz"}
