"""Checks of the fixed-wing model against tables of an independent code for the Aerosonde.

The numbers are in params/aerosonde.toml (of the directory, else the folder beside it, else the copy of the tests);
the variant, A as published or B with parasitic drag, is a letter in the table's name (or the key's first letter).
Trajectories bring their own controls, which are in force from their row to the next.
"""

import math
import re

import numpy as np
import torch

from taichi_sim.bench import Bench
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, POSITION, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_quaternion_from_euler, torch_rotation_matrix
from taichi_sim.models.uav.fixed_wing.airframe_arrays import loads
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.fixed_wing.trim import Trim, linear_modes, trim
from tests.validation.aerosonde_numbers import parameters
from tests.validation.case import Case
from tests.validation.inputs import check_air, check_start, check_way, wind_of
from tests.validation.tables import Table, TableError, number, read_csv, read_json, records

DT = 0.02  # s, of the trajectories we fly
RHS_TOLERANCE = {"f64": 1e-9, "f32": 2e-5}  # of each column's largest magnitude
POSITION_TOLERANCE = {"f64": 1e-3, "f32": 0.1}  # m
ANGLE_TOLERANCE = {"f64": 0.01, "f32": 0.2}  # deg
VELOCITY_TOLERANCE = {"f64": 1e-3, "f32": 0.1}  # m/s
RATE_TOLERANCE = {"f64": 1e-3, "f32": 1e-2}  # rad/s
TRIM_TOLERANCE = 1e-5  # rad, 1
FREQUENCY_TOLERANCE, DAMPING_TOLERANCE = 1e-3, 5e-3  # of the value
VACUUM = 1e-30  # density of the air, kg/m^3, in which nothing but a load from outside is felt
PRINTED_TOLERANCE = 1e-8  # of numbers printed with eight decimals, absolute
EULER, AIR_DATA = ("phi", "theta", "psi"), ("Va", "alpha", "beta")
STATE = ("n", "e", "d", "u", "v", "w", "e0", "e1", "e2", "e3", "p", "q", "r")
CONTROLS = ("elevator", "aileron", "rudder", "throttle")
SHORT_CONTROLS = ("elev", "ail", "rud", "thr")
# Our order of the state (position, quaternion, velocity, rates) in theirs (position, velocity, quaternion, rates).
ORDER = [0, 1, 2, 7, 8, 9, 3, 4, 5, 6, 10, 11, 12]


def variant(case: Case) -> str:
    """The variant's letter, a word of its own in the table's name."""
    found = re.findall(r"(?<=_)[AB](?=[_.])", case.path.name)
    if len(found) != 1:
        raise TableError("the name has no variant: _A or _B")
    return found[0]


def rhs_samples(case: Case) -> None:
    """rhs_samples_[AB]*.csv: random states and controls (and winds), and all derivatives."""
    table = read_csv(case.path)
    state = _states(np.stack([table[c] for c in STATE], axis=1))
    controls = np.stack([table[c] for c in SHORT_CONTROLS], axis=1)
    model = FixedWing6DOF(parameters(case, variant(case)), DT, 1)
    ours = model.rhs(state, controls, wind=wind_of(case, table))[:, ORDER]
    for name, values in zip(STATE, ours.T, strict=True):
        scaled(case, f"d_{name}", values, table[f"d_{name}"], table.resolution(f"d_{name}"))


def scaled(case: Case, name: str, ours, theirs, resolution=0.0) -> None:
    """Compare on the scale of the table's largest magnitude, as right-hand sides are."""
    scale = float(np.abs(theirs).max()) or 1.0
    tolerance = RHS_TOLERANCE[case.precision]
    case.absolute(f"{name}, relative", ours / scale, theirs / scale, tolerance, resolution / scale)


def trajectory(case: Case) -> None:
    """*_[AB].csv with columns t, north ..: flight from the first row with each row's controls (and wind: wn, we, wd)
    until the next.
    """
    table = read_csv(case.path)
    check_start(case, table, ("north", "east", "down", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r"))
    wind = wind_of(case, table)
    R, v = rotation(table), np.stack([table[c] for c in ("u", "v", "w")], axis=1)
    check_air(table, v - np.einsum("nji,nj->ni", R, wind))
    place = np.stack([table[c] for c in ("north", "east", "down")], axis=1)
    check_way(table, place, np.einsum("nij,nj->ni", R, v))
    exact = np.diff(table["t"]) / DT
    steps = np.rint(exact).astype(int)
    if steps.size == 0 or steps.min() < 1 or np.abs(exact - steps).max() > 0.01:
        raise TableError(f"column 't': rows are not a whole number of steps of {DT} s apart")
    stride = math.gcd(*steps.tolist())
    flight = Flight(FixedWing6DOF(parameters(case, variant(case)), DT, stride), table, wind)
    columns = flight.fly(steps // stride)
    tolerances = (
        (("north", "east", "down"), POSITION_TOLERANCE),
        (("u", "v", "w", "Va"), VELOCITY_TOLERANCE),
        (("p", "q", "r"), RATE_TOLERANCE),
    )
    for names, tolerance in tolerances:
        for name in names:
            if name in table or name not in AIR_DATA:
                case.absolute(name, columns[name], table[name], tolerance[case.precision], table.resolution(name))
    for name in (*EULER, *(c for c in AIR_DATA[1:] if c in table)):
        away = np.rad2deg((columns[name] - table[name] + np.pi) % (2 * np.pi) - np.pi)
        resolution = np.rad2deg(table.resolution(name))
        case.absolute(f"{name}, deg", away, np.zeros(len(table)), ANGLE_TOLERANCE[case.precision], resolution)


def rotation(table: Table) -> np.ndarray:
    """R_nb [row, 3, 3] of columns phi, theta, psi."""
    return torch_rotation_matrix(torch_quaternion_from_euler(*(torch.tensor(table[c]) for c in EULER))).numpy()


class Flight:
    """One aircraft that begins at a table's first row."""

    def __init__(self, model: FixedWing6DOF, table: Table, wind: np.ndarray):
        """Put it there, in a `wind` [row, 3] (NED, m/s) that blows from its row to the next."""
        self.model, self.table, self.wind = model, table, torch.tensor(wind)
        self.bench = Bench(model)
        self.bench.wind[:] = self.wind[0]
        place, angles, v, omega = (
            [table[c][0] for c in names]
            for names in (("north", "east", "down"), EULER, ("u", "v", "w"), ("p", "q", "r"))
        )
        self.bench.put(place, angles, v, omega)

    def fly(self, calls: np.ndarray) -> dict[str, np.ndarray]:
        """Quantities at every row; `calls` [row - 1] control steps from each row to the next."""
        actions = self.model.action(torch.tensor(np.stack([self.table[c] for c in CONTROLS], axis=1)))
        rows = [self._read(self.wind[0])]
        for row, times in enumerate(calls):
            self.bench.wind[:] = self.wind[row]
            self.bench.step(actions[row], int(times))
            rows.append(self._read(self.wind[row + 1]))
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}

    def _read(self, wind: torch.Tensor) -> dict[str, float]:
        state = self.bench.state[0, 0].double().cpu()
        v_r = state[VELOCITY] - torch_rotation_matrix(state[QUATERNION]).T @ wind
        u, v, w = v_r.tolist()
        names = ("north", "east", "down", "u", "v", "w", "p", "q", "r", "phi", "theta", "psi")
        motion = torch.cat((state[POSITION], state[VELOCITY], state[ANGULAR_VELOCITY])).tolist()
        air = {"Va": float(v_r.norm()), "alpha": math.atan2(w, u), "beta": math.atan2(v, math.hypot(u, w))}
        return dict(zip(names, (*motion, *self.bench.euler), strict=True)) | air


def trim_and_modes(case: Case) -> None:
    """trim_and_modes*.json: trims, linear models and modes of the variants; keys begin with A_ or B_."""
    data = read_json(case.path)
    keys = [key for key in data if re.match(r"[AB]_", key)] if isinstance(data, dict) else []
    if not keys:
        raise TableError("no key begins with A_ or B_")
    for key in keys:
        p = parameters(case, key[0])
        given = data[key]["trim"]
        gamma = math.radians(number(given, "gamma_deg"))
        found = trim(p, number(given, "Va"), gamma, turn_radius=given["R_turn"])
        _check_trim(case, key[0], found, given)
        model = linear_modes(p, found)
        for name, ours in (("A_lon_u_w_q_theta", model.A_lon), ("B_lon_elev_thr", model.B_lon),
                           ("A_lat_v_p_r_phi", model.A_lat), ("B_lat_ail_rud", model.B_lat)):  # fmt: skip
            case.relative(f"{key[0]} {name}", ours, np.array(data[key][name]))
        for name, mode in data[key]["modes"].items():
            _check_mode(case, f"{key[0]} {name}", model.modes[name], mode)


def _check_trim(case: Case, label: str, found: Trim, given: dict) -> None:
    pairs = {"alpha_rad": found.alpha, "phi_rad": found.phi, "theta_rad": found.theta, "elevator": found.elevator}
    pairs |= {"aileron": found.aileron, "rudder": found.rudder, "throttle": found.throttle}
    for name, value in pairs.items():
        case.absolute(f"{label} trim {name}", value, number(given, name), TRIM_TOLERANCE)
    for name, value in (("thrust_N", found.thrust), ("prop_torque_Nm", found.torque)):
        case.elementwise(f"{label} trim {name}", value, number(given, name))


def _check_mode(case: Case, label: str, mode, given: dict) -> None:
    if isinstance(given["eig"], list):
        case.absolute(f"{label} frequency, relative", mode.frequency / number(given, "wn"), 1.0, FREQUENCY_TOLERANCE)
        case.absolute(f"{label} damping, relative", mode.damping / number(given, "zeta"), 1.0, DAMPING_TOLERANCE)
    else:
        ratio = mode.eigenvalues[0].real / number(given, "eig")
        case.absolute(f"{label} eigenvalue, relative", ratio, 1.0, FREQUENCY_TOLERANCE)


def published_checks(case: Case) -> None:
    """published_checks_chap3_chap4*.json: numbers printed in mavsim_public's check files (variant A)."""
    data = read_json(case.path)
    p = parameters(case, "A")
    airless = in_a_vacuum(p)
    for n, row in enumerate(records(data, "chap3"), 1):
        state = _states(row["state"])
        ours = rigid_body(airless, state, np.array(row["forces_moments"], dtype=np.float64))[ORDER]
        # a quaternion that is not a unit one turns into a rotation in more than one way: not its position
        unit = abs(np.linalg.norm(state[QUATERNION]) - 1) < PRINTED_TOLERANCE
        first = 0 if unit else 3
        case.absolute(f"chap3 case {n}", ours[first:], np.array(row["xdot"])[first:], PRINTED_TOLERANCE)
    for row in records(data, "chap4"):
        _published_loads(case, airless, p, row, data)


def _states(theirs) -> np.ndarray:
    """Our states [.., 13] of theirs."""
    theirs = np.asarray(theirs, dtype=np.float64)
    ours = np.empty_like(theirs)
    ours[..., ORDER] = theirs
    return ours


def _published_loads(case: Case, airless: FixedWing6DOF, p: FixedWingParams, row: dict, data: dict) -> None:
    """Thrust and torque, forces and moments with gravity, or derivatives: whatever `row` has."""
    name = row["name"]
    if name == "prop":
        T, Q = loads(p, [number(row, "Va"), 0.0, 0.0], 0.0, [0.0, 0.0, 0.0, number(row, "throttle")])[0, 6:]
        case.elementwise("chap4 prop T, Q", np.array([T, Q]), np.array([row["T"], row["Q"]]))
        return
    same = next(r for r in data["chap4"] if r["name"] == "case2") if isinstance(row["state"], str) else row
    state, delta = _states(same["state"]), np.array(same["delta"], dtype=np.float64)
    v_r = state[VELOCITY] - np.array(row.get("gust_body", (0.0, 0.0, 0.0)))
    if "air_data_override" in row:
        v_r = np.array([number(row, "air_data_override", "Va"), 0.0, 0.0])
    found = loads(p, v_r, state[ANGULAR_VELOCITY], delta)[0]
    R = torch_rotation_matrix(torch.tensor(state[QUATERNION])).numpy()
    weight = np.concatenate((p.physical.mass * GRAVITY * R[2], np.zeros(3)))
    theirs = np.array(row.get("fm", row.get("fm_with_book_beta")), dtype=np.float64)
    case.relative(f"chap4 {name} forces and moments", found[:6] + weight, theirs)
    if "xdot_3_to_12" in row:
        ours = rigid_body(airless, state, found[:6] + weight)[ORDER][3:]
        case.relative(f"chap4 {name} derivative", ours, np.array(row["xdot_3_to_12"]))


def in_a_vacuum(p: FixedWingParams) -> FixedWing6DOF:
    """The aircraft where it feels nothing but its weight and a load from outside."""
    rarefied = p.model_copy(update={"physical": p.physical.model_copy(update={"rho": VACUUM})})
    return FixedWing6DOF(rarefied, DT, 1, design=p)


def rigid_body(airless: FixedWing6DOF, state: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Derivative [13] of the aircraft in a vacuum under `load` [6], force (N, gravity included) and moment (N m), in
    b.
    """
    R = torch_rotation_matrix(torch.tensor(state[QUATERNION])).numpy()
    weight = np.concatenate((airless.p.physical.mass * GRAVITY * R[2], np.zeros(3)))
    return airless.rhs(state, np.zeros(len(CONTROLS)), load=load - weight)[0]
