"""Checks of hull_6dof with linear restoring against steady states, modes and turning figures of the Otter."""

import re
from typing import Any

import numpy as np

from taichi_sim.bench import Bench
from taichi_sim.models.usv.hull.params import Hull6DofParams
from tests.validation.case import Case
from tests.validation.otter import LARGEST_DT, accelerations, as_action, place, pose_rate, set_shafts
from tests.validation.otter_numbers import model, parameters, shaft_command
from tests.validation.tables import number, numbers, read_csv, read_json, records

STEP = 1e-5  # of central differences, m, rad, m/s, rad/s
NEWTON_STEPS = 12
STEADY_TOLERANCE = 1e-6  # m/s, m, rad
EIGENVALUE_TOLERANCE = 1e-4  # 1/s: |v| v has no second derivative at rest
MATRIX_TOLERANCE = 1e-8  # of the matrix's largest entry
ANGLE_STEADY_DEG = 1e-4  # deg
TURN_TOLERANCE = 1e-4  # of the value
TACTICAL_TOLERANCE = 2e-3  # m, s
SETTLING_TIME = 300.0  # s, tens of time constants of the slowest motion
TACTICAL_TIME = 60.0  # s, longer than half a turn
NOTHING = 1e-6  # 1/s, below which an eigenvalue belongs to position and heading, which nothing restores


def rate(p: Hull6DofParams, eta: np.ndarray, nu: np.ndarray, shaft: np.ndarray) -> np.ndarray:
    """d(eta, nu)/dt [n, 12] at held shaft speeds [n, 2]."""
    return np.hstack([pose_rate(eta, nu), accelerations(p, eta, nu, shaft)])


def linearise(p: Hull6DofParams, state: np.ndarray, n: float) -> np.ndarray:
    """Jacobian [12, 12] of `rate` about a state [12] at shaft speeds n (rad/s), by central differences."""
    points = np.concatenate([state + STEP * np.eye(12), state - STEP * np.eye(12)])
    rates = rate(p, points[:, :6], points[:, 6:], np.full((24, 2), n))
    return (rates[:12] - rates[12:]).T / (2 * STEP)


def _newton(residual, x: np.ndarray) -> np.ndarray:
    """Root of `residual` [n, k] -> [n, k] near x [k]."""
    for _ in range(NEWTON_STEPS):
        k = len(x)
        points = np.concatenate([x[None], x + STEP * np.eye(k), x - STEP * np.eye(k)])
        values = residual(points)
        jacobian = (values[1 : k + 1] - values[k + 1 :]).T / (2 * STEP)
        x = x - np.linalg.solve(jacobian, values[0])
    return x


def _level(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """eta and nu [n, 6] of states without motion to the side, x [n, 4] = z, theta, u, w."""
    eta, nu = np.zeros((2, len(x), 6))
    eta[:, 2], eta[:, 4], nu[:, 0], nu[:, 2] = x.T
    return eta, nu


def rest(p: Hull6DofParams) -> np.ndarray:
    """z (m), theta (rad) at which the hull accelerates neither in heave nor in pitch, without velocity or thrust."""

    def residual(x):
        eta, nu = _level(np.hstack([x, 0 * x]))
        return accelerations(p, eta, nu, np.zeros((len(x), 2)))[:, (2, 4)]

    return _newton(residual, np.zeros(2))


def steady(p: Hull6DofParams, n: float) -> np.ndarray:
    """z (m), theta (rad), u, w (m/s) of the steady straight run at shaft speeds n (rad/s)."""

    def residual(x):
        rates = rate(p, *_level(x), np.full((len(x), 2), n))
        return rates[:, (2, 6, 8, 10)]

    return _newton(residual, np.array([*rest(p), closed_form_speed(p, n), 0.0]))


def closed_form_speed(p: Hull6DofParams, n: float) -> float:
    """Speed at which thrust equals the damping in surge alone, m/s."""
    assert p.thrusters is not None
    return 2 * p.thrusters.k_positive * n * n / p.hydrodynamics.linear[0]


def straight(case: Case) -> None:
    """steady_straight_vs_n*.csv: steady state and largest eigenvalue against the shaft speed (f64)."""
    table = read_csv(case.path)
    p = parameters(case)
    n = table["n_rad_s"]
    found = np.array([steady(p, value) for value in n])
    state = np.zeros((len(n), 12))
    state[:, 2], state[:, 4], state[:, 6], state[:, 8] = found.T
    largest = [_largest(linearise(p, row, value)) for row, value in zip(state, n, strict=True)]
    closed = np.array([closed_form_speed(p, value) for value in n])
    for name, ours in (
        ("u_closed_form", closed),
        ("u_model", found[:, 2]),
        ("w_model", found[:, 3]),
        ("z", found[:, 0]),
    ):
        name = next((c for c in table.header if c.startswith(name)), name)
        case.absolute(name, ours, table[name], STEADY_TOLERANCE, table.resolution(name))
    case.absolute(
        "theta_deg", np.rad2deg(found[:, 1]), table["theta_deg"], ANGLE_STEADY_DEG, table.resolution("theta_deg")
    )
    name = "max_real_eigenvalue_1_s"
    case.absolute(name, np.array(largest), table[name], EIGENVALUE_TOLERANCE, table.resolution(name))


def _largest(A: np.ndarray) -> float:
    """Largest real part of the eigenvalues but those of position and heading."""
    values = np.linalg.eigvals(A)
    return float(values[np.abs(values) > NOTHING].real.max())


def summary(case: Case) -> None:
    """summary*.json: matrices, rest, natural periods, modes, steady turns, tactical figures (f64).

    Only a summary with `matrices` is of this vehicle.
    """
    data = read_json(case.path)
    if not isinstance(data, dict) or "matrices" not in data:
        return
    p = parameters(case)
    _matrices(case, p, data["matrices"])
    z, theta = rest(p)
    case.absolute("rest_equilibrium", [z, 0.0, theta], data["rest_equilibrium_z_phi_theta"], STEADY_TOLERANCE)
    rows = records(data, "steady_surge_speed_vs_n")
    speeds = [closed_form_speed(p, n) for n in numbers(rows, "n_rad_s")]
    case.relative("steady_surge_speed_vs_n", speeds, numbers(rows, "u_m_s"))
    M, G = np.diag(p.M_rb + p.M_a)[2:5], np.diag(restoring(p))[2:5]
    case.relative("natural periods", 2 * np.pi * np.sqrt(M / G), data["uncoupled_natural_periods_s_heave_roll_pitch"])
    for key, value in data.items():
        if key.startswith("eigenvalues"):
            _modes(case, p, key, value)
        elif key.endswith("_steady"):
            _turn(case, p, key, value)
        elif key.endswith("_tactical"):
            _tactical(case, p, key, value)


def restoring(p: Hull6DofParams) -> np.ndarray:
    """G [6, 6] about CO."""
    assert p.linear is not None
    G = np.zeros((6, 6))
    G[2, 2], G[3, 3], G[4, 4] = p.linear.G33, p.linear.G44, p.linear.G55
    G[2, 4] = G[4, 2] = p.linear.G35
    return G


def _matrices(case: Case, p: Hull6DofParams, given: dict[str, Any]) -> None:
    ours = {
        "M": p.M_rb + p.M_a,
        "MA": p.M_a,
        "MRB": p.M_rb,
        "G": restoring(p),
        "D_linear": np.diag(p.hydrodynamics.linear),
    }
    for name in sorted(set(ours) & set(given)):
        theirs = np.array(given[name])
        scale = np.abs(theirs).max()
        case.absolute(f"{name}, relative", ours[name] / scale, theirs / scale, MATRIX_TOLERANCE)


def _modes(case: Case, p: Hull6DofParams, key: str, given: list[list[float]]) -> None:
    """Eigenvalues about the attitude of rest, at the closed-form speed of the shaft speed in the key (none: zero)."""
    n = (shaft_command(key) or (0.0, 0.0))[0]
    state = np.zeros(12)
    state[2], state[4] = rest(p)
    state[6] = closed_form_speed(p, n)
    ours, theirs = np.linalg.eigvals(linearise(p, state, n)), np.array(given) @ [1, 1j]
    gap = [np.abs(ours - value).min() for value in theirs]
    case.absolute(key, gap, np.zeros(len(gap)), EIGENVALUE_TOLERANCE)


def _turn(case: Case, p: Hull6DofParams, key: str, given: dict[str, float]) -> None:
    """A turn from rest under held shaft speeds, when it has become steady."""
    steps = 500
    bench = Bench(model(p, LARGEST_DT, steps))
    place(bench, _pose(*rest(p)))
    bench.step(as_action(p, shaft_command(key)), round(SETTLING_TIME / LARGEST_DT / steps))
    motion = bench.read()
    u, v, _, _, _, r = motion.nu[0]
    U = float(np.hypot(u, v))
    ours = {"U": U, "u": u, "v": v, "r": r, "radius": U / abs(r), "phi": motion.euler[0, 0],
            "theta": motion.euler[0, 1], "z": motion.position[0, 2]}  # fmt: skip
    for name in sorted(set(ours) & set(given)):
        value = number(given, name)
        case.absolute(f"{key}: {name}, relative", ours[name] / value, 1.0, TURN_TOLERANCE)


def _pose(z: float, theta: float) -> np.ndarray:
    return np.array([0.0, 0.0, z, 0.0, theta, 0.0])


def _tactical(case: Case, p: Hull6DofParams, key: str, given: dict[str, float]) -> None:
    """Advance, transfer, tactical diameter (m) and times (s) of a turn out of a straight run."""
    origin = re.search(r"from_n(\d+(?:\.\d+)?)", key)
    n = float(origin[1]) if origin else 0.0
    t, track, heading = turn_from(p, n, shaft_command(key) or (0.0, 0.0))
    ours = {}
    for turn in (90, 180):
        at = np.interp(np.deg2rad(turn), np.abs(heading), t)
        ours[f"t{turn}"] = at
        x, y = (np.interp(at, t, track[:, i]) for i in (0, 1))
        ours |= {"advance": x, "transfer": abs(y)} if turn == 90 else {"tactical_diameter": abs(y)}
    for name in ours:
        if name in given:
            case.absolute(f"{key}: {name}", ours[name], number(given, name), TACTICAL_TOLERANCE)


def turn_from(p: Hull6DofParams, n: float, command: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [k], track [k, 2] (m) and heading [k] (rad, unwrapped) of a turn out of a straight run at n (rad/s)."""
    bench = Bench(model(p, LARGEST_DT, 2))
    place(bench, _pose(*rest(p)), [closed_form_speed(p, n), 0, 0, 0, 0, 0])
    set_shafts(bench, [n, n])
    rows = []
    steps = round(TACTICAL_TIME / (2 * LARGEST_DT))
    for _ in range(steps + 1):
        motion = bench.read()
        rows.append([*motion.position[0, :2], motion.euler[0, 2]])
        bench.step(as_action(p, command))
    track = np.array(rows)
    return 2 * LARGEST_DT * np.arange(steps + 1), track[:, :2], np.unwrap(track[:, 2])
