"""Checks of the multirotor model against tables of an independent code (rotorpy) and closed forms.

Names say what a table holds: NAME_rhs_samples_V.csv, NAME_CASE_V_converged.csv, trims*.json (keys NAME_CASE_V),
closed_forms_NAME.json, ground_effect_NAME.csv, with the aircraft's NAME and the variant V: A without aerodynamics, B
with rotor drag, C with every term. The numbers are in params_NAME.json of the directory, else of the tests' copy;
series_meta.json beside a series may say its lags. Rotors are columns om1, om2, .. (rad/s) and their commands cmd1, ..,
in force from their row to the next.

Rotors of the tables have no angular momentum, and there is no ground but in ground_effect tables.
"""

import math
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from taichi_sim.bench import Bench
from taichi_sim.config.io import validate
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, POSITION, QUATERNION, STATE_SIZE, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.uav.multirotor.controller import allocation
from taichi_sim.models.uav.multirotor.multirotor_6dof import Multirotor6DOF
from taichi_sim.models.uav.multirotor.params import MultirotorParams
from taichi_sim.models.uav.multirotor.trim import MultirotorLinearModel, linear_modes, trim
from tests.probes import ground_ratios, rotor_rates
from tests.validation.case import Case
from tests.validation.inputs import check_way
from tests.validation.tables import (
    InputsMissingError,
    Table,
    TableError,
    even_interval,
    number,
    read_csv,
    read_json,
    records,
)

COPY = Path(__file__).resolve().parents[2] / "tests" / "data" / "reference" / "multirotor"
DT = 0.005  # s, of series
RHS_TOLERANCE = {"f64": 1e-9, "f32": 2e-5}  # of 1 + |value|
POSITION_TOLERANCE = {"f64": 2e-4, "f32": 5e-3}  # m
ANGLE_TOLERANCE = {"f64": 2e-4, "f32": 0.02}  # deg
ROTOR_TOLERANCE = {"f64": 0.01, "f32": 0.1}  # rad/s; rotor speeds of some tables are 2e-3 rad/s off the lag's solution
VELOCITY_TOLERANCE = {"f64": 2e-4, "f32": 5e-3}  # m/s
RATE_TOLERANCE = {"f64": 1e-4, "f32": 2e-3}  # rad/s
CLOSED, TERMINAL, STEPPED = 1e-9, 1e-6, 1e-6  # of closed forms; a speed after seconds of flight; a flight's steps
LINEAR = 1e-6  # of central differences
FINE = 1e-3  # s, step where a flight is compared with a closed form
AIR_DENSITY = 1.225  # kg/m^3
PLACE, SPEED, TURN, RATES = ("n", "e", "d"), ("u", "v", "w"), ("e0", "e1", "e2", "e3"), ("p", "q", "r")
STATE = (*PLACE, *TURN, *SPEED, *RATES)
TERMS_OF_C = ("k_z", "k_h", "k_flap")
ANY_BODY = {"size": [1.0, 1.0, 1.0], "below": 0.1, "collision_radius": 1.0}


def rhs_samples(case: Case) -> None:
    """NAME_rhs_samples_V.csv: random states, rotor speeds, commands and winds, and all derivatives."""
    table = read_csv(case.path)
    name, variant = _aircraft(case, case.path.stem), _variant(case.path.stem, r"_rhs_samples_([ABC])")
    p = parameters(case, name, variant)
    speeds, commands = _rotors(table, "om", p), _rotors(table, "cmd", p)
    states = np.stack([table[c] for c in STATE], axis=1)
    wind = np.stack([table[c] for c in ("wn", "we", "wd")], axis=1)
    ours = Multirotor6DOF(p, DT, 1).rhs(states, speeds, wind=wind)
    found = {f"d_{c}": values for c, values in zip(STATE, ours.T, strict=True)}
    found |= {f"d_om{k + 1}": rate for k, rate in enumerate(rotor_rates(p, speeds, commands).T)}
    turning = np.cross(states[:, ANGULAR_VELOCITY], states[:, VELOCITY])
    inertial = np.einsum("nij,nj->ni", _rotation(states), ours[:, VELOCITY] + turning)
    found |= dict(zip(("a_n", "a_e", "a_d"), inertial.T, strict=True))
    for column, values in found.items():
        if column in table:
            theirs = table[column]
            scale = 1 + np.abs(theirs)
            case.absolute(
                f"{column}, relative", values / scale, theirs / scale, RHS_TOLERANCE[case.precision],
                table.resolution(column) / scale,
            )  # fmt: skip


def series(case: Case) -> None:
    """NAME_CASE_V_converged.csv with rotor columns: a flight from the first row, at our step."""
    table = read_csv(case.path)
    if any(c not in table for c in ("t", "om1", "cmd1", *STATE)):
        return
    name, variant = _aircraft(case, case.path.stem), _variant(case.path.stem, r"_([ABC])_converged")
    meta = _meta(case)
    p = parameters(case, name, variant, _lags(case, meta))
    states = np.stack([table[c] for c in STATE], axis=1)
    _check_start(table, meta)
    check_way(table, states[:, POSITION], np.einsum("nij,nj->ni", _rotation(states), states[:, VELOCITY]))
    wind = np.zeros((len(table), 3))
    if "wn" in table:
        wind = np.stack([table[c] for c in ("wn", "we", "wd")], axis=1)
    elif meta:
        wind[:] = meta.get("wind_NED", (0.0, 0.0, 0.0))
    ours, speeds = fly(p, states[0], _rotors(table, "om", p), _rotors(table, "cmd", p), wind, even_interval(table["t"]))
    columns = dict(zip(STATE, ours.T, strict=True)) | {f"om{k + 1}": x for k, x in enumerate(speeds.T)}
    for names, tolerance in (
        (PLACE, POSITION_TOLERANCE),
        (SPEED, VELOCITY_TOLERANCE),
        (RATES, RATE_TOLERANCE),
        ([f"om{k + 1}" for k in range(len(p.rotors))], ROTOR_TOLERANCE),
    ):
        for c in names:
            case.absolute(c, columns[c], table[c], tolerance[case.precision], table.resolution(c))
    away = np.rad2deg(_angle(ours[:, QUATERNION], states[:, QUATERNION]))
    case.absolute("attitude, deg", away, 0 * away, ANGLE_TOLERANCE[case.precision])


def fly(p: MultirotorParams, start, speeds, commands, wind, interval: float) -> tuple[np.ndarray, np.ndarray]:
    """States [row, 13] and rotor speeds [row, rotor] of a flight from the first of `speeds` [row, rotor], rotors
    commanded and wind blowing from row to row, which are `interval` s apart.
    """
    stride = max(1, math.ceil(interval / DT - 1e-9))
    model = Multirotor6DOF(p, interval / stride, stride)
    bench, first = Bench(model), model.aux_names.index(model.control_names[0])
    bench.state[0, 0] = torch.tensor(start)
    bench.fleet.update()
    bench.wind[:] = torch.tensor(wind[0])
    model.reset_aux(bench.aux, bench.state, bench.around)
    bench.aux[0, 0, first:] = torch.tensor(speeds[0])
    actions, states, turned = model.action(torch.tensor(commands)), [], []
    for row in range(len(commands)):
        states.append(bench.state[0, 0].double().numpy().copy())
        turned.append(bench.aux[0, 0, first:].double().numpy().copy())
        bench.wind[:] = torch.tensor(wind[row])
        if row + 1 < len(commands):
            bench.step(actions[row])
    return np.array(states), np.array(turned)


def trims(case: Case) -> None:
    """trims*.json: attitude and rotor speeds of steady flight in wind, by NAME_CASE_V."""
    data = read_json(case.path)
    for key, given in data.items() if isinstance(data, dict) else ():
        if isinstance(given, dict) and "rotor_speeds" in given:
            p = parameters(case, _aircraft(case, key), _variant(key, r"_([ABC])$"))
            ours = trim(p, given["ground_velocity_NED"], given["wind_NED"], number(given, "heading"))
            for name, value in (("phi", ours.phi), ("theta", ours.theta)):
                case.absolute(f"{key} {name}, rad", value, number(given, name), CLOSED)
            _close(case, f"{key} rotor speeds", ours.omega, given["rotor_speeds"])


def closed_forms(case: Case) -> None:
    """closed_forms_NAME.json: hover, linear model in hover, terminal velocities, tilt against wind, collective step."""
    data, name = read_json(case.path), _aircraft(case, case.path.stem.removeprefix("closed_forms_"))
    craft = {variant: parameters(case, name, variant) for variant in "ABC"}
    for key, check in (
        ("hover", lambda given: _hover(case, craft["B"], given)),
        ("small_motion_rates_at_hover", lambda given: _small_motions(case, craft["B"], given)),
        ("open_loop_modes_at_hover_variant_B", lambda given: _modes(case, craft["B"], given)),
        ("terminal_velocity_variant_C_level", lambda given: _terminal(case, craft["C"], given)),
        ("hover_against_headwind_variant_B", lambda given: _headwind(case, craft["B"], given)),
        ("collective_step_10pct_variant_A", lambda given: _collective(case, craft["A"], given)),
    ):
        if key in data:
            check(data[key])
    if not case.checks:
        raise TableError("none of its keys is known")


def ground_effect(case: Case) -> None:
    """ground_effect_NAME.csv: thrust over that in free air of one rotor, and of four, over their height."""
    table, name = read_csv(case.path), _aircraft(case, case.path.stem.removeprefix("ground_effect_"))
    p = parameters(case, name, "A")
    one = p.model_copy(update={"rotors": p.rotors[:1]})
    for column, craft in (("CB_single", one), ("images_quad_Kb0", p)):
        if column in table:
            heights = np.repeat(table["z"][:, None], len(craft.rotors), axis=1)
            ours = ground_ratios(craft, heights, 1.0, np.full(len(craft.rotors), allocation(p).hover[0]))
            rounded = table.resolution(column) + table.resolution("z") / table["z"]
            for k in range(len(craft.rotors)):
                case.absolute(f"{column}, rotor {k + 1}", ours[:, k], table[column], CLOSED, rounded)


# -- closed forms ------------------------------------------------------------------------------------------------------


def _close(case: Case, quantity: str, ours, theirs, tolerance: float = CLOSED) -> None:
    """Compare on the scale of each value."""
    ours, theirs = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    scale = np.where(theirs == 0, 1.0, np.abs(theirs))
    case.absolute(quantity, ours / scale, theirs / scale, tolerance)


def _hover(case: Case, p: MultirotorParams, given: dict) -> None:
    a, rotor = allocation(p), p.rotor
    _close(case, "hover: rotor speed", a.hover, np.full(len(a.hover), number(given, "omega")))
    _close(case, "hover: thrust to weight", a.thrust_to_weight, number(given, "thrust_to_weight"))
    _close(case, "hover: thrust of a rotor", rotor.k_f * rotor.omega_max**2, number(given, "max_thrust_per_rotor_N"))
    induced = Multirotor6DOF(p, DT, 1).induced
    _close(case, "hover: induced velocity", induced, number(given, "disc_induced_velocity_rho1_225"))


def _linear(p: MultirotorParams) -> MultirotorLinearModel:
    return linear_modes(p, trim(p))


def _small_motions(case: Case, p: MultirotorParams, given: dict) -> None:
    model = _linear(p)
    roll, yaw = np.abs(model.B[[3, 5]]).sum(axis=1)
    for name, ours in (
        ("horizontal_velocity_decay_1_s", -model.A[0, 0]),
        ("roll_acc_per_rad_s_of_mix", roll),
        ("yaw_acc_per_rad_s_of_mix", yaw),
        ("pitch_acc_per_m_s_headwind", model.A[4, 0]),
    ):
        if name in given:
            _close(case, name, ours, number(given, name), LINEAR)


def _modes(case: Case, p: MultirotorParams, given: dict) -> None:
    A = _linear(p).block(("u", "q", "theta"))
    case.relative("linear model of u, q, theta", A, np.array(given["A"]))
    ours, theirs = (sorted(x, key=lambda z: (z.real, z.imag)) for x in (
        np.linalg.eigvals(A).tolist(), [complex(*pair) for pair in given["eigenvalues"]]))  # fmt: skip
    away = np.abs(np.array(ours) - np.array(theirs))
    case.absolute("eigenvalues, 1/s", away, 0 * away, LINEAR)


def _terminal(case: Case, p: MultirotorParams, given: list[dict]) -> None:
    hover, model = np.array(allocation(p).hover), Multirotor6DOF(p, DT, 1)
    for row in given:
        part = number(row, "rotor_fraction_of_hover")
        state = np.zeros((1, STATE_SIZE))
        state[0, 3], state[0, 9] = 1.0, number(row, "v_down")
        case.absolute(f"terminal at {part:g} of hover, m/s^2", model.rhs(state, part * hover)[0, 9], 0.0, CLOSED)
        if "v_after_3s_from_rest" in row:
            still, stopped = np.eye(1, STATE_SIZE, 3)[0], np.zeros((601, len(hover)))
            states, _ = fly(p, still, stopped, stopped, np.zeros((601, 3)), DT)
            _close(case, "speed after 3 s", states[-1, 9], number(row, "v_after_3s_from_rest"), TERMINAL)
            _close(case, "fall in 3 s", states[-1, 2], number(row, "drop_after_3s"), TERMINAL)


def _headwind(case: Case, p: MultirotorParams, given: dict) -> None:
    level = p.physical.model_copy(update={"cg": (0.0, 0.0, p.rotors[0].position[2])})
    flat = p.model_copy(update={"physical": level})
    for row in records(given, "cases"):
        wind = number(row, "headwind")
        ours = trim(flat, wind=(-wind, 0.0, 0.0))
        _close(case, f"headwind {wind:g} m/s, rotors level with the mass: theta", ours.theta, number(row, "theta_rad"))
        each = np.full(len(ours.omega), number(row, "omega_each"))
        _close(case, f"headwind {wind:g} m/s, rotors level with the mass: speeds", ours.omega, each)
        high = row.get("with_rotor_height")
        if isinstance(high, dict):
            ours = trim(p, wind=(-wind, 0.0, 0.0))
            _close(case, f"headwind {wind:g} m/s, rotors as they are: theta", ours.theta, number(high, "theta_rad"))
            _close(case, f"headwind {wind:g} m/s, rotors as they are: speeds", ours.omega, high["omega"])


def _collective(case: Case, p: MultirotorParams, given: dict) -> None:
    hover, rows = np.array(allocation(p).hover), records(given, "cases")
    last = max(number(row, "t_after_step") for row in rows)
    steps = round(last / FINE) + 1
    start = np.eye(1, STATE_SIZE, 3)[0]
    command = np.tile(1.1 * hover, (steps, 1))
    states, speeds = fly(p, start, np.tile(hover, (steps, 1)), command, np.zeros((steps, 3)), FINE)
    for row in rows:
        t = number(row, "t_after_step")
        at = round(t / FINE)
        _close(case, f"collective step, {t:g} s: rotor speed", speeds[at], np.full(len(hover), number(row, "omega")))
        case.absolute(f"collective step, {t:g} s: m/s", states[at, 9], number(row, "v_down"), STEPPED)


# -- numbers and columns ---------------------------------------------------------------------------------------------


def parameters(case: Case, name: str, variant: str, lags: dict[str, float] | None = None) -> MultirotorParams:
    """The aircraft of params_NAME.json as `variant`, with other time constants if `lags` are given (s)."""
    root, file = case.folder.root, f"params_{name}.json"
    path = next((p for p in (*sorted(root.rglob(file)), root.parent / "multirotor" / file, COPY / file) if p.is_file()),
                root / file)  # fmt: skip
    return _parameters(case.folder.use(path), variant, tuple(sorted((lags or {}).items())))


@cache
def _parameters(path: Path, variant: str, lags: tuple[tuple[str, float], ...]) -> MultirotorParams:
    data = read_json(path)
    used = data.get("used") if isinstance(data, dict) else None
    if not isinstance(used, dict):
        raise TableError(f"{path.name}: key 'used' is missing")
    if number(used, "g", "value") != GRAVITY:
        raise TableError(f"{path.name}: gravity is not {GRAVITY} m/s^2")
    J = np.array(used["inertia_about_com_FRD"]["value"])
    extra = data.get("variant_C_only", {}) if variant == "C" else {}
    rotor = {
        "radius": number(used, "rotor_radius", "value"),
        "k_f": number(used, "thrust_coefficient_k", "value"),
        "k_m": number(used, "yaw_coefficient_km", "value"),
        "k_d": number(used, "rotor_drag_kd", "value") if variant != "A" else 0.0,
        **{key: number(extra, key, "value") for key in TERMS_OF_C if extra},
        **{key: number(used, key, "value") for key in ("omega_min", "omega_max", "tau_up", "tau_down")},
    } | dict(lags)
    places, spins = used["rotor_positions_from_com_FRD"]["value"], used["rotor_spin_seen_from_above"]["value"]
    numbers: dict[str, Any] = {
        "physical": {
            "mass": number(used, "mass", "value"),
            **{f"J{axis}": float(J[k, k]) for k, axis in enumerate("xyz")},
            **{f"J{'xyz'[a]}{'xyz'[b]}": -float(J[a, b]) for a, b in ((0, 1), (0, 2), (1, 2))},
            "cg": [0.0, 0.0, 0.0],
            "drag": extra["c_D"]["value"] if extra else [0.0, 0.0, 0.0],
            "rho": AIR_DENSITY,
        },
        "rotor": rotor,
        "rotors": [{"position": place, "spin": spin} for place, spin in zip(places, spins, strict=True)],
        "envelope": {"airspeed": 1.0, "max_airspeed": 1.0},
        "control": {"actions": "rotors", "speed": 1.0},
        "body": ANY_BODY,
        "ground_effect": False,
    }
    return validate(MultirotorParams, numbers, str(path))


def _aircraft(case: Case, text: str) -> str:
    """The aircraft with which `text` begins: the longest NAME of the params_NAME.json that there are."""
    files = (*case.folder.root.rglob("params_*.json"), *COPY.glob("params_*.json"))
    known = [file.stem.removeprefix("params_") for file in files]
    found = [name for name in known if text == name or text.startswith(f"{name}_")]
    return max(found, key=len) if found else text.split("_")[0]


def _variant(text: str, pattern: str) -> str:
    """The variant's letter where `pattern` has it.

    Raises:
        TableError: if it is not there.
    """
    found = re.search(pattern, text)
    if not found:
        raise TableError(f"{text}: the name has no variant: A, B or C")
    return found[1]


def _rotors(table: Table, prefix: str, p: MultirotorParams) -> np.ndarray:
    """Columns om1, om2, .. or cmd1, .. [row, rotor]."""
    return np.stack([table[f"{prefix}{k + 1}"] for k in range(len(p.rotors))], axis=1)


def _meta(case: Case) -> dict[str, Any]:
    """What series_meta.json beside the series says of it; empty where it says nothing."""
    path = case.path.with_name("series_meta.json")
    data = read_json(case.folder.use(path)) if path.is_file() else {}
    found = data.get(case.path.name) if isinstance(data, dict) else None
    return found if isinstance(found, dict) else {}


def _lags(case: Case, meta: dict[str, Any]) -> dict[str, float]:
    """Time constants of a series that are not those of its aircraft, s."""
    lags = {key: number(meta, key) for key in ("tau_up", "tau_down") if key in meta}
    named = re.search(r"_equal_lag_(\d+(?:\.\d+)?)", case.path.stem)
    return lags or ({key: float(named[1]) for key in ("tau_up", "tau_down")} if named else {})


def _check_start(table: Table, meta: dict[str, Any]) -> None:
    """Refuse a first row that is not the initial state which the meta file has.

    Raises:
        InputsMissingError: naming the column.
    """
    given = meta.get("initial_state")
    for name, expected in given.items() if isinstance(given, dict) else ():
        if name in table and abs(table[name][0] - expected) > 1e-6 * (1 + abs(expected)) + table.resolution(name)[0]:
            raise InputsMissingError(
                f"inputs missing: column {name!r} begins at {table[name][0]:g}, 'initial_state' beside it at "
                f"{expected:g}"
            )


def _rotation(states: np.ndarray) -> np.ndarray:
    return torch_rotation_matrix(torch.tensor(states[..., QUATERNION])).numpy()


def _angle(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angle [row] (rad) between attitudes [row, 4]; q and -q are one."""
    same = np.sign(np.einsum("ij,ij->i", one, other))[:, None]
    return 4 * np.arcsin(np.minimum(0.5 * np.linalg.norm(one - same * other, axis=1), 1.0))
