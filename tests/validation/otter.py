"""Checks of hull_6dof with linear restoring against tables of an independent code for the Otter.

The name of a table says the current (current_0.5mps_30deg: towards 30 degrees) and the shaft speeds commanded
(n100_n60: left and right, rad/s; n80: both); where its columns show others, they turn the propellers (shafts.py). The
initial state is the first row. Tolerances are metres and degrees for tracks, the largest magnitude of the column for
right-hand sides.
"""

# Kernels are another language inside Python syntax.
# pyright: reportArgumentType=false, reportInvalidTypeForm=false

from functools import cache

import numpy as np
import taichi as ti
import torch

from taichi_sim.bench import Bench, pack_state
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.usv.hull import motion as hull_motion
from taichi_sim.models.usv.hull.motion import CONTROLS
from taichi_sim.models.usv.hull.params import Hull6DofParams
from tests.validation.case import Case
from tests.validation.inputs import check_start
from tests.validation.otter_numbers import current, model, parameters, shaft_command
from tests.validation.shafts import SHAFTS, shaft_commands
from tests.validation.tables import Table, even_interval, read_csv

POSE = ("x", "y", "z", "phi", "theta", "psi")
NU = ("u", "v", "w", "p", "q", "r")
LARGEST_DT = 0.02  # s; a table's interval is cut into whole steps of at most this
DRIVEN_DT = 0.005  # s; of at most this where commands change between rows
RHS_TOLERANCE = {"f64": 1e-9, "f32": 2e-5}  # of each column's largest magnitude
TRACK_TOLERANCE = {"f64": 1e-3, "f32": 0.05}  # m
ANGLE_TOLERANCE = {"f64": 0.02, "f32": 0.5}  # deg
SPEED_TOLERANCE = {"f64": 1e-3, "f32": 0.01}  # m/s, rad/s
CROSS_FLOW_TOLERANCE = {"f64": 1e-8, "f32": 2e-6}  # of each column's largest magnitude
SIDEWAYS = ("y", "phi", "psi", "v", "p", "r")  # zero on a straight run


def rhs_samples(case: Case) -> None:
    """rhs_samples*.csv: random states and shaft speeds, and all 14 derivatives.

    Only a table with the columns n1c, n2c (commands) is of this vehicle. Pose and shaft rates are closed forms, the
    accelerations those of the model.
    """
    table = read_csv(case.path)
    if "n1c" not in table:
        return
    p = parameters(case)
    eta, nu, shaft, command = (_stack(table, names) for names in (POSE, NU, SHAFTS, ("n1c", "n2c")))
    ours = np.hstack([pose_rate(eta, nu), accelerations(p, eta, nu, shaft, current(case.path.stem)),
                      shaft_rate(p, shaft, command)])  # fmt: skip
    for kind, values in zip((*POSE, *NU, *SHAFTS), ours.T, strict=True):
        name = f"d_{kind}"
        scale = float(np.abs(table[name]).max()) or 1.0
        tolerance, resolution = RHS_TOLERANCE[case.precision], table.resolution(name)
        case.absolute(f"{name}, relative", values / scale, table[name] / scale, tolerance, resolution / scale)


def accelerations(p: Hull6DofParams, eta: np.ndarray, nu: np.ndarray, shaft: np.ndarray, flow=(0.0, 0.0)) -> np.ndarray:
    """nu_dot [n, 6] of the model at poses and velocities [n, 6] and shaft speeds [n, 2]; `flow`: current, m/s."""
    return model(p, LARGEST_DT).rhs(pack_state(eta, nu), shaft, flow)[:, 7:]


def pose_rate(eta: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Rates [n, 6] of position (m/s) and roll, pitch, yaw (rad/s): R_nb v and T(phi, theta) omega."""
    R = torch_rotation_matrix(torch.from_numpy(pack_state(eta, nu)[:, 3:7])).numpy()
    s, c, t = np.sin(eta[:, 3]), np.cos(eta[:, 3]), np.tan(eta[:, 4])
    p, q, r = nu[:, 3:].T
    level = s * q + c * r
    angles = np.stack([p + level * t, c * q - s * r, level / np.cos(eta[:, 4])], axis=1)
    return np.hstack([np.einsum("nij,nj->ni", R, nu[:, :3]), angles])


def shaft_rate(p: Hull6DofParams, shaft: np.ndarray, command: np.ndarray) -> np.ndarray:
    """First-order lag of shaft speeds [n, 2] within their limits, rad/s^2."""
    t = p.thrusters
    assert t is not None
    return (command - np.clip(shaft, t.n_min, t.n_max)) / t.lag


def trajectory(case: Case) -> None:
    """*_converged.csv with columns t, x .. r, n1, n2: a track, attitude and velocities along it.

    A run that begins without any motion to the side and has equal shaft speeds must stay symmetric.
    """
    table = read_csv(case.path)
    if any(name not in table for name in ("t", *POSE, *NU, *SHAFTS)):
        return
    ours = fly(case, table)
    for name in POSE[:3]:
        case.absolute(f"{name}, m", ours[name], table[name], TRACK_TOLERANCE[case.precision], table.resolution(name))
    for name in POSE[3:]:
        resolution = np.rad2deg(table.resolution(name))
        away = turned_deg(ours[name], table[name])
        case.absolute(f"{name}, deg", away, 0 * away, ANGLE_TOLERANCE[case.precision], resolution)
    for name in NU:
        case.absolute(name, ours[name], table[name], SPEED_TOLERANCE[case.precision], table.resolution(name))
    if not any(table[name].any() for name in SIDEWAYS):
        sideways = np.stack([ours[name] for name in SIDEWAYS])
        case.absolute("motion to the side of a straight run", sideways, 0 * sideways, 0.0)


def coarse_trajectory(case: Case, dt: float) -> None:
    """*_euler_dt*.csv: another integrator at that step. Ours is to be at least as near to *_converged.csv.

    Declines a table without a converged one beside it.
    """
    beside = case.path.with_name(case.path.name.split("_euler_dt")[0] + "_converged.csv")
    if not beside.is_file():
        return
    table, converged = read_csv(case.path), read_csv(case.folder.use(beside))
    if any(name not in table for name in ("t", *POSE, *NU, *SHAFTS)) or len(table) != len(converged):
        return
    ours = fly(case, converged, dt)
    theirs = {name: table[name] for name in POSE}
    for what, names in (("position", POSE[:3]), ("attitude", POSE[3:])):
        errors = [_distance(run, converged, names) for run in (ours, theirs)]
        case.absolute(f"our {what} error at the same step, over the table's", errors[0] / errors[1], 0.0, 1.0)


def _distance(run: dict[str, np.ndarray], converged: Table, names: tuple[str, ...]) -> float:
    """Largest distance over the run, m, or turn, rad."""
    gaps = [run[name] - converged[name] for name in names]
    if names == POSE[3:]:
        gaps = [np.deg2rad(turned_deg(gap, 0.0)) for gap in gaps]
    return float(np.linalg.norm(gaps, axis=0).max())


def turned_deg(ours, table) -> np.ndarray:
    """Difference of angles (rad) in degrees, whole turns apart."""
    return (np.rad2deg(ours - table) + 180) % 360 - 180


def fly(case: Case, table: Table, dt: float = LARGEST_DT) -> dict[str, np.ndarray]:
    """The run of a table: our x .. r at its times, from its first row, its shafts turning as in the table, by steps of
    at most `dt` (s).
    """
    interval = even_interval(table["t"])
    steps = int(np.ceil(interval / dt - 1e-6))
    p = parameters(case)
    assert p.thrusters is not None
    check_start(case, table, (*POSE, *NU, *SHAFTS))
    name = case.path.stem.split("_euler")[0].removesuffix("_converged")
    parts = int(np.ceil(interval / min(dt, DRIVEN_DT) - 1e-6))
    commands = shaft_commands(table, shaft_command(name), p.thrusters.lag, parts)
    calls = commands.shape[1]  # of the model, from row to row
    steps = steps if calls == 1 else parts
    bench = Bench(model(p, round(interval / steps, 9), steps // calls))
    bench.current[:] = torch.tensor(current(name))
    place(bench, [table[n][0] for n in POSE], [table[n][0] for n in NU])
    set_shafts(bench, [table[n][0] for n in SHAFTS])
    rows = []
    for row in range(len(table)):
        motion = bench.read()
        rows.append(np.concatenate((motion.position[0], motion.euler[0], motion.nu[0])))
        if row < len(table) - 1:
            for command in commands[row]:
                bench.step(as_action(p, command))
    return dict(zip((*POSE, *NU), np.array(rows).T, strict=True))


def place(bench: Bench, eta, nu=(0.0,) * 6) -> None:
    """Put the vessels at a pose eta [6] (m, rad) with a velocity nu [6]."""
    bench.put(eta[:3], eta[3:], nu[:3], nu[3:])


def set_shafts(bench: Bench, speeds) -> None:
    """Start with these shaft speeds (rad/s)."""
    bench.aux[:, 0, CONTROLS : CONTROLS + 2] = torch.tensor(speeds)


def as_action(p: Hull6DofParams, command) -> np.ndarray:
    """The action of commanded shaft speeds (rad/s)."""
    assert p.thrusters is not None
    command = np.asarray(command, dtype=np.float64)
    return command / np.where(command > 0, p.thrusters.n_max, -p.thrusters.n_min)


def _stack(table: Table, names: tuple[str, ...]) -> np.ndarray:
    return np.stack([table[name] for name in names], axis=1)


def cross_flow(case: Case) -> None:
    """crossflow_drag_samples*.csv: sway force and yaw moment of the strip integral."""
    table = read_csv(case.path)
    run = runtime.current()
    motion = torch.as_tensor(_stack(table, ("v_r", "r")), dtype=run.torch_dtype, device=run.device)
    out = torch.zeros_like(motion)
    _cross_flow_kernel()(parameters(case).hydrodynamics, motion, out)
    for name, values in zip(("Y_N", "N_Nm"), out.double().cpu().numpy().T, strict=True):
        scale = float(np.abs(table[name]).max()) or 1.0
        resolution = table.resolution(name) / scale
        tolerance = CROSS_FLOW_TOLERANCE[case.precision]
        case.absolute(f"{name}, relative", values / scale, table[name] / scale, tolerance, resolution)


@cache
def _cross_flow_kernel():
    @ti.kernel
    def kernel(h: ti.template(), motion: ti.types.ndarray(ndim=2), out: ti.types.ndarray(ndim=2)):
        for i in range(motion.shape[0]):
            YN = hull_motion.cross_flow(h, motion[i, 0], motion[i, 1])
            out[i, 0], out[i, 1] = YN[0], YN[1]

    return kernel
