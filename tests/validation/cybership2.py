"""Checks of manoeuvring_3dof against tables of CyberShip II: right-hand sides, trajectories, steady motion.

Parameters come from cybership2.toml (of the directory, or of the folder `params` beside it; else the shipped vehicle
file), forces from the file's name ("turn_tau_1_0_0.3": X, Y, N; "surge_step_tau2": X; none: zero), and the initial
state from the first row. Trajectories are held to metres and degrees, right-hand sides to the table's largest value.
"""

import re
from functools import cache
from typing import Any

import numpy as np
import torch

from taichi_sim.bench import Bench, pack_state
from taichi_sim.config.io import config_folder
from taichi_sim.models.usv.manoeuvring_3dof import Manoeuvring3dof, Manoeuvring3dofParams
from tests.validation.case import Case
from tests.validation.inputs import check_start
from tests.validation.tables import TableError, number, read_csv, read_json, read_toml

PARAMETERS = "cybership2.toml"
LARGEST_DT = 0.02  # s; a table's interval is cut into whole steps of at most this
RHS_TOLERANCE = {"f64": 1e-9, "f32": 2e-5}  # of each column's largest value
TRACK_TOLERANCE = {"f64": 1e-3, "f32": 0.05}  # m
HEADING_TOLERANCE = {"f64": 0.02, "f32": 0.5}  # degrees
SPEED_TOLERANCE = {"f64": 1e-3, "f32": 1e-2}  # of the largest speed or rate
STEADY_TOLERANCE = {"f64": 1e-5, "f32": 1e-3}  # of the largest value
SETTLING_TIME = 600.0  # s, tens of time constants of the slowest mode
ROUNDING = 1e-3  # of an interval, by which evenly spaced times may differ as printed
ANY_SIZE = 1.0  # m, of a dimension that does not enter the check

DAMPING = ("Xu", "Xuu", "Xuuu", "Yv", "Yvv", "Yrv", "Yr", "Yvr", "Yrr", "Nv", "Nvv", "Nrv", "Nr", "Nvr", "Nrr")
ADDED_MASS = ("Xudot", "Yvdot", "Yrdot", "Nvdot", "Nrdot")


def _parameters(case: Case) -> dict[str, Any]:
    """Numbers of the vehicle by the names of Manoeuvring3dofParams."""
    root = case.folder.root
    found = (*sorted(root.rglob(PARAMETERS)), root.parent / "params" / PARAMETERS)
    path = next((p for p in found if p.is_file()), config_folder() / "vehicles" / PARAMETERS)
    data = read_toml(case.folder.use(path))
    if "model" in data:  # a vehicle file
        return {key: value for key, value in data.items() if key != "model"}
    main = {"length": "length_m", "beam": "beam_m", "mass": "mass_kg", "I_z": "Iz_kgm2", "x_g": "xg_m"}
    try:
        values = {ours: number(data, "main", theirs) for ours, theirs in main.items()}
        for section, names in (("damping", DAMPING), ("added_mass", ADDED_MASS)):
            values |= {f"{name[0]}_{name[1:]}": number(data, section, name) for name in names}
    except TableError as error:
        raise TableError(f"{path.name}: {error}") from None
    return values | {"height": ANY_SIZE, "collision_radius": ANY_SIZE}


@cache
def _model(params: Manoeuvring3dofParams, duration: float) -> Manoeuvring3dof:
    """A model whose control step is `duration` (s); one compiled kernel for all that ask for the same."""
    substeps = int(np.ceil(duration / LARGEST_DT - 1e-6))
    return Manoeuvring3dof(params, duration / substeps, substeps)


class Runner:
    """One vessel under a constant force in calm water, and its state as plain numbers."""

    def __init__(self, parameters: dict[str, Any], tau: tuple[float, float, float]):
        """Put the vessel at rest at the origin under `tau` (N, N, N m), which are its actions."""
        limits = dict.fromkeys(("surge_force_max", "sway_force_max", "yaw_moment_max"), 1.0)
        options = limits | {"actions": "surge_sway_yaw", "time_constant": 0.0}
        self.params = Manoeuvring3dofParams(**(parameters | options))
        self.tau = tau
        self.benches: dict[float, Bench] = {}  # by the length of their control step, s
        self.put(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def put(self, x: float, y: float, psi: float, u: float, v: float, r: float) -> None:
        """Place the vessel (m, rad) with a body velocity (m/s, rad/s)."""
        self.state = torch.from_numpy(pack_state([x, y, 0, 0, 0, psi], [u, v, 0, 0, 0, r]))[:, None]

    def run(self, duration: float) -> None:
        """Advance by `duration` (s), to the nearest nanosecond, in one control step."""
        duration = round(duration, 9)
        if duration not in self.benches:
            self.benches[duration] = Bench(_model(self.params, duration))
        bench = self.benches[duration]
        bench.state.copy_(self.state)  # actuators without lag, in calm water: the state is all there is
        self.state = bench.step(self.tau).state.clone()

    def read(self) -> tuple[float, ...]:
        """x, y (m), psi (rad, in (-pi, pi]), u, v (m/s), r (rad/s)."""
        s = self.state[0, 0].double().tolist()
        return s[0], s[1], 2 * float(np.arctan2(s[6], s[3])), s[7], s[8], s[12]


def _forces(name: str) -> tuple[float, float, float]:
    """X, Y, N in a file's or case's name after "tau": one number is X; no "tau" is none."""
    number_ = r"-?\d+(?:\.\d+)?"
    found = re.search(rf"tau_?({number_}(?:_{number_})*)", name)
    if found is None:
        return 0.0, 0.0, 0.0
    values = [float(text) for text in found[1].split("_")]
    if len(values) == 1:
        return values[0], 0.0, 0.0
    if len(values) != 3:
        raise TableError(f"{name}: forces after 'tau' must be X, or X_Y_N")
    return values[0], values[1], values[2]


def rhs_samples(case: Case) -> None:
    """rhs_samples*.csv: eta_dot and nu_dot at random states and forces.

    Only a table with a column tauX is of this vehicle: others have other inputs.
    """
    table = read_csv(case.path)
    if "tauX" not in table:
        return
    eta, nu = np.zeros((2, len(table), 6))
    for k, pose, velocity in zip((0, 1, 5), ("x", "y", "psi"), ("u", "v", "r"), strict=True):
        eta[:, k], nu[:, k] = table[pose], table[velocity]
    tau = np.column_stack([table[c] for c in ("tauX", "tauY", "tauN")])
    states = pack_state(eta, nu)
    rates = _model(Runner(_parameters(case), (0.0, 0.0, 0.0)).params, LARGEST_DT).rhs(states, tau)
    psi_dot = 2 * (states[:, 3] * rates[:, 6] - states[:, 6] * rates[:, 3])
    ours = (rates[:, 0], rates[:, 1], psi_dot, rates[:, 7], rates[:, 8], rates[:, 12])
    for name, values in zip(("d_x", "d_y", "d_psi", "d_u", "d_v", "d_r"), ours, strict=True):
        _scaled(case, name, values, table[name], RHS_TOLERANCE, table.resolution(name))


def trajectory(case: Case) -> None:
    """surge_decay*.csv, surge_step_tau*.csv, turn_tau*.csv, sway_yaw_decay*.csv: motion under constant forces."""
    table = read_csv(case.path)
    columns = {name: table[name] for name in ("x", "y", "psi", "u", "v", "r")}
    check_start(case, table, tuple(columns))
    runner = Runner(_parameters(case), _forces(case.path.stem))
    intervals = _intervals(table["t"])
    runner.put(*(values[0] for values in columns.values()))
    rows = [runner.read()]
    for interval in intervals:
        runner.run(interval)
        rows.append(runner.read())
    ours = dict(zip(columns, np.array(rows).T, strict=True))
    for name in ("x", "y"):
        tolerance = TRACK_TOLERANCE[case.precision]
        case.absolute(f"{name}, m", ours[name], columns[name], tolerance, table.resolution(name))
    turned = (np.rad2deg(ours["psi"] - columns["psi"]) + 180) % 360 - 180
    resolution = np.rad2deg(table.resolution("psi"))
    case.absolute("psi, deg", turned, 0 * turned, HEADING_TOLERANCE[case.precision], resolution)
    for name in ("u", "v", "r"):
        _scaled(case, name, ours[name], columns[name], SPEED_TOLERANCE, table.resolution(name))


def _intervals(t: np.ndarray) -> np.ndarray:
    """Times (s) from row to row; all alike where they differ only by the rounding of the table."""
    intervals = np.diff(t)
    if intervals.size == 0 or intervals.min() <= 0:
        raise TableError("column 't': times must increase")
    return np.full_like(intervals, intervals.mean()) if np.ptp(intervals) < ROUNDING * intervals.mean() else intervals


def summary(case: Case) -> None:
    """summary*.json: speeds that forces in surge settle at, steady turns, speeds and distances of a surge decay.

    Only a summary with `steady_surge`, speeds by force, is of this vehicle.
    """
    data = read_json(case.path)
    speeds = data.get("steady_surge") if isinstance(data, dict) else None
    if not isinstance(speeds, dict):
        return
    parameters = _parameters(case)
    settled = [_settle(parameters, (float(force), 0.0, 0.0))[0] for force in speeds]
    _scaled(case, "steady_surge", settled, [number(speeds, key) for key in speeds], STEADY_TOLERANCE)
    for key, facts in data.items():
        if key.startswith("turn_tau"):
            u, v, r = _settle(parameters, _forces(key))
            U = float(np.hypot(u, v))
            for name, value in {"u": u, "v": v, "r": r, "U": U, "R": U / abs(r)}.items():
                _scaled(case, f"{key}: {name}", [value], [number(facts, name)], STEADY_TOLERANCE)
        elif found := re.fullmatch(r"surge_decay_u(\d+(?:\.\d+)?)", key):
            _surge_decay(case, parameters, float(found[1]), key, facts)


def _settle(parameters: dict[str, Any], tau: tuple[float, float, float]) -> tuple[float, ...]:
    """u, v (m/s), r (rad/s) that constant forces end at, from rest."""
    runner = Runner(parameters, tau)
    runner.run(SETTLING_TIME)
    return runner.read()[3:]


def _surge_decay(case: Case, parameters: dict[str, Any], u: float, key: str, facts: dict[str, Any]) -> None:
    """Speeds (u_at_10s) and distances (x_at_60s) of a run that starts at u (m/s) without force."""
    runner = Runner(parameters, (0.0, 0.0, 0.0))
    for name in facts:
        if found := re.fullmatch(r"([ux])_at_(\d+(?:\.\d+)?)s", name):
            runner.put(0.0, 0.0, 0.0, u, 0.0, 0.0)
            runner.run(float(found[2]))
            ours = runner.read()[{"x": 0, "u": 3}[found[1]]]
            _scaled(case, f"{key}: {name}", [ours], [number(facts, name)], STEADY_TOLERANCE)


def _scaled(case: Case, name: str, ours, table, tolerance: dict[str, float], resolution=0.0) -> None:
    """Compare on the scale of the table's largest magnitude, or as it is where all the table is zero."""
    scale = float(np.max(np.abs(table))) or 1.0
    ours, table, resolution = (np.asarray(a, dtype=np.float64) / scale for a in (ours, table, resolution))
    case.absolute(name, ours, table, tolerance[case.precision], resolution)
