"""Checks of the seed paper's Unity vehicles against sequences of inputs (f64).

Masses, sizes and steps are in the file names, inputs in the columns, and the published factors in
params/unity_seed.toml (of the directory, else the copy here). Unity's axes are left-handed, y up: x is our
east, z our north, and pitch and roll turn the other way. The boats' tables hold motion in a plane with no
water: buoyancy and the torques about level axes are off.
"""

import math
import re
from pathlib import Path

import numpy as np
import torch

from taichi_sim.bench import Bench
from taichi_sim.kernels.conventions import QUATERNION
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.uav.unity_aircraft import INCREMENT, UnityAircraft, UnityAircraftParams
from taichi_sim.models.usv.unity_boat import UnityBoat, UnityBoatParams
from tests.validation.case import Case
from tests.validation.tables import Table, TableError, number, read_csv, read_toml

PARAMETERS = "unity_seed.toml"
SEQUENCE_TOLERANCE = 1e-4  # m, m/s, rad, rad/s
STEADY_TIME_CONSTANTS = 25.0  # e^-25 of the transient is left
ANY_SIZE = 1.0  # m, of a dimension that does not enter the check


def _parameters(case: Case) -> dict:
    """The published factors, from the reference directory or from the folder `params` beside it."""
    root = case.folder.root
    beside = (root.parent / "params" / PARAMETERS, Path(__file__).with_name(PARAMETERS))
    path = next(p for p in (*sorted(root.rglob(PARAMETERS)), *beside) if p.is_file())
    try:
        return read_toml(case.folder.use(path))
    except TableError as error:
        raise TableError(f"{path.name}: {error}") from None


def _put(bench: Bench, position, euler, velocity_n, rates=(0.0, 0.0, 0.0)) -> None:
    """Place the vehicle: position (m) and velocity (m/s) NED; roll, pitch, yaw (rad); body rates."""
    R_nb = torch_rotation_matrix(bench.put(euler=euler).state[0, 0, QUATERNION]).numpy()
    bench.put(position, euler, R_nb.T @ np.asarray(velocity_n), rates)


def _steps(table: Table, dt: float) -> tuple[np.ndarray, int]:
    """Physics steps from each row to the next, and their greatest common divisor."""
    exact = np.diff(table["t"]) / dt
    steps = np.rint(exact).astype(int)
    if steps.size == 0 or steps.min() < 1 or np.abs(exact - steps).max() > 0.01:
        raise TableError(f"column 't': rows are not a whole number of steps of {dt} s apart")
    return steps, math.gcd(*steps.tolist())


def _boat(factors: dict, dt: float, substeps: int, **given: float) -> UnityBoat:
    """A boat of the published factors; `given` overrides them."""
    numbers = {
        "height": ANY_SIZE,
        "force_factor": number(factors, "boat", "J_acceleration"),
        "yaw_factor": number(factors, "boat", "K_turning"),
        "pitch_factor": 0.0,
        "roll_factor": 0.0,
        "drag": number(factors, "boat", "script_drag_per_s"),
        "angular_drag": number(factors, "boat", "script_angular_drag_per_s"),
        "buoyancy_stiffness": 0.0,
        "buoyancy_damping": 0.0,
        "collision_radius": ANY_SIZE,
    }
    return UnityBoat(UnityBoatParams(**(numbers | given)), dt, substeps)


def boat_sequence(case: Case, mass: float, length: float, beam: float, dt: float) -> None:
    """boat_m*_L*_B*_script_dt*.csv: position, velocity, heading, yaw rate along a sequence of inputs."""
    table = read_csv(case.path)
    steps, stride = _steps(table, dt)
    bench = Bench(_boat(_parameters(case), dt, stride, mass=mass, length=length, beam=beam))
    columns = {c: table[c] for c in ("x", "z_fwd", "vx", "vz", "yaw_rate_rad_s")}
    yaw = np.deg2rad(table["yaw_deg"])
    v_in, h_in = table["vertical_input"], table["horizontal_input"]
    _put(
        bench,
        (columns["z_fwd"][0], columns["x"][0], 0.0),
        (0.0, 0.0, yaw[0]),
        (columns["vz"][0], columns["vx"][0], 0.0),
        (0.0, 0.0, columns["yaw_rate_rad_s"][0]),
    )
    ours = []
    for row in range(len(table)):
        p, v = bench.position, bench.velocity
        ours.append((p[1], p[0], v[1], v[0], bench.read().nu[0, 5], bench.euler[2]))
        if row < len(steps):
            bench.step([2 * v_in[row] - 1, h_in[row]], steps[row] // stride)
    *motion, heading = np.array(ours).T
    for name, values in zip(columns, motion, strict=True):
        case.absolute(name, values, columns[name], SEQUENCE_TOLERANCE, table.resolution(name))
    _angle(case, table, "yaw_deg", heading)


def aircraft_sequence(case: Case, dt: float) -> None:
    """aircraft*_script_dt*.csv: position, velocity, angles, increments of the public script's aircraft."""
    table = read_csv(case.path)
    steps, stride = _steps(table, dt)
    model = _aircraft(_parameters(case), dt, stride)
    bench = Bench(model)
    names = ("x", "y_up", "z_fwd", "vx", "vy", "vz", "smooth_pitch", "smooth_yaw", "smooth_roll")
    columns = {c: table[c] for c in names}
    first = {c: values[0] for c, values in columns.items()}
    start = [sign * np.deg2rad(table[c][0]) for sign, c in ((-1, "roll_deg"), (-1, "pitch_deg"), (1, "yaw_deg"))]
    _put(bench, (first["z_fwd"], first["x"], -first["y_up"]), start, (first["vz"], first["vx"], -first["vy"]))
    increments = [-first["smooth_roll"], -first["smooth_pitch"], first["smooth_yaw"]]
    bench.aux[0, 0, INCREMENT : INCREMENT + 3] = torch.tensor(increments, dtype=torch.float64)
    boost = [model.boost_action(model.p.boost_max if b > 0 else model.p.boost_min) for b in table["act_boost"]]
    actions = np.stack((-table["act_pitch"], table["act_yaw"], boost), axis=1)
    ours, angles = [], []
    for row in range(len(table)):
        p, v = bench.position, bench.velocity
        s = {name: float(bench.fleet.reading(name)) for name in model.aux_names}
        increments = (-s["pitch_increment"], s["yaw_increment"], -s["roll_increment"])
        ours.append((p[1], -p[2], p[0], v[1], -v[2], v[0], *increments))
        angles.append((-s["pitch"], s["yaw"], -s["roll"]))
        if row < len(steps):
            bench.step(actions[row].tolist(), steps[row] // stride)
    for name, values in zip(columns, np.array(ours).T, strict=True):
        case.absolute(name, values, columns[name], SEQUENCE_TOLERANCE, table.resolution(name))
    for name, values in zip(("pitch_deg", "yaw_deg", "roll_deg"), np.array(angles).T, strict=True):
        _angle(case, table, name, values)


def _aircraft(factors: dict, dt: float, substeps: int) -> UnityAircraft:
    """The public script's aircraft (its boost is 1 or the multiplier; its roll levels at exactly no yaw)."""
    keys = {
        "mass": "rigidbody_mass_kg",
        "thrust": "thrust_N",
        "boost_max": "boost_multiplier",
        "drag": "rigidbody_drag_per_s",
        "pitch_speed_deg": "pitch_speed_deg_s",
        "yaw_speed_deg": "yaw_speed_deg_s",
        "roll_speed_deg": "roll_speed_deg_s",
        "smooth_rate": "smooth_rate_per_s",
        "max_pitch_deg": "max_pitch_deg",
        "max_roll_deg": "max_roll_deg",
    }
    size = dict.fromkeys(("length", "span", "height", "collision_radius"), ANY_SIZE)
    numbers = {ours: number(factors, "aircraft", theirs) for ours, theirs in keys.items()}
    params = UnityAircraftParams(**numbers, **size, thrust_factor=1.0, boost_min=1.0, roll_rule="script")
    return UnityAircraft(params, dt, substeps)


def _angle(case: Case, table: Table, name: str, ours: np.ndarray) -> None:
    """Compare an angle (rad) with a column in degrees, whole turns apart."""
    difference = ours - np.deg2rad(table[name])
    wrapped = (difference + np.pi) % (2 * np.pi) - np.pi
    resolution = np.deg2rad(table.resolution(name))
    case.absolute(f"{name}, rad", wrapped, np.zeros(len(table)), SEQUENCE_TOLERANCE, resolution)


def boat_steady_state(case: Case) -> None:
    """boat_steady_state_by_mass*.csv: terminal speed and yaw rate, time constant, of boats that we run."""
    table = read_csv(case.path)
    factors = _parameters(case)
    dt = number(factors, "aircraft", "fixed_dt_s")
    J, K = (_in_header(table, rf"{name}(?=[\d.])") for name in ("v_terminal_J", "yaw_rate_terminal_K"))
    rows = zip(*(table[c] for c in ("mass", "collider_L", "collider_B", "drag", "angular_drag")), strict=True)
    figures = np.array([_terminal(factors, dt, J[1], K[1], row) for row in rows]).T
    case.columns(
        case.elementwise,
        table,
        {J[0]: figures[0], K[0]: figures[1], "turn_radius": figures[0] / figures[1]}
        | {"surge_time_constant_s": figures[2], "I_yaw_box": figures[3]},
    )


def _in_header(table: Table, pattern: str) -> tuple[str, float]:
    """The column whose name starts with `pattern`, and the number that follows in the name."""
    for name in table.header:
        found = re.match(pattern + r"(\d+(?:\.\d+)?)", name)
        if found:
            return name, float(found[1])
    raise TableError(f"no column matches {pattern!r} and a number; there are {', '.join(table.header)}")


def _terminal(factors: dict, dt: float, J: float, K: float, row: tuple[float, ...]) -> tuple[float, ...]:
    """Terminal speed of a straight run, terminal yaw rate, terminal speed / first acceleration, inertia."""
    mass, length, beam, drag, angular_drag = row
    given = {"mass": mass, "length": length, "beam": beam, "drag": drag, "angular_drag": angular_drag}
    steps = math.ceil(STEADY_TIME_CONSTANTS / min(drag, angular_drag) / dt)
    first = Bench(_boat(factors, dt, 1, force_factor=J, yaw_factor=K, **given)).step([1.0, 0.0])
    acceleration = first.velocity[0] / dt
    whole = _boat(factors, dt, steps, force_factor=J, yaw_factor=K, **given)
    speed, turning = Bench(whole).step([1.0, 0.0]).velocity[0], Bench(whole).step([-1.0, 1.0])
    return speed, turning.read().nu[0, 5], speed / acceleration, whole.params.inertia[2]
