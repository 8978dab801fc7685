"""Other simulators, if they are installed, and ours, at the same error of 1 % (docs/step.md).

Each moves under random commands of its own, new every 0.2 s, in calm water or still air, and counts as exact at a much
shorter step of its own. What it gives is compared at the step at which its motion errs by 1 %: simulated seconds of one
vehicle in a second of one core. Those that can step many vehicles at once step `MANY`.
"""

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager
from functools import partial
from importlib import metadata
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from taichi_sim.applications.trials.step_error import HEIGHT, INTERVAL, StepSetting, errors_of, motion, step_for
from taichi_sim.bench import Bench
from taichi_sim.kernels import runtime
from taichi_sim.models.catalogue import load_vehicle

Array = NDArray[np.float64]
MANY = 4096  # vehicles at once
SECONDS, ROWS, SEED = 20.0, 4, 1  # of a motion; how many motions; of the commands
STEPS = tuple(INTERVAL / n for n in (200, 80, 40, 20, 10, 8, 5, 4, 2, 1))  # s
FINE = INTERVAL / 800  # s, counts as exact
FEET = 0.3048  # m


class Contestant(NamedTuple):
    """A simulator of one vehicle."""

    name: str
    version: str
    motion: Callable[[float], Array]
    """Velocities and position [n, row, 9] at the end of each command, with a step (s)."""
    rate: Callable[[float, float], float]
    """Steps of one vehicle in a second, with a step (s), measured for as long as told (s)."""


def commands(width: int) -> Array:
    """Random commands [n, row, width] in [-1, 1], one every `INTERVAL`."""
    return np.random.default_rng(SEED).uniform(-1.0, 1.0, (round(SECONDS / INTERVAL), ROWS, width))


def per_second(call: Callable[[], object], steps: int, seconds: float) -> float:
    """Steps in a second of a `call` that takes so many."""
    for _ in range(2):  # what JAX returns from the first call may have other types, for which it compiles again
        call()
    start, calls = time.perf_counter(), 0
    while calls == 0 or time.perf_counter() - start < seconds:
        call()
        calls += 1
    return calls * steps / (time.perf_counter() - start)


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:  # importable from a checkout
        return "unknown"


# -- ours --------------------------------------------------------------------------------------------------------------


def ours(vehicle: str) -> Contestant:
    """A vehicle of the package, stepped in double precision for the error and in single precision for the rate."""

    def moved(dt: float) -> Array:
        runtime.init(precision="f64", threads=1)
        return motion(StepSetting(vehicle, SECONDS, calm=True), dt)

    def rate(dt: float, seconds: float) -> float:
        runtime.init(threads=1)
        substeps = round(INTERVAL / dt)
        model = load_vehicle(vehicle, INTERVAL / substeps, substeps)
        bench = Bench(model, envs=MANY)
        flies = model.medium == "air"
        ahead = model.limits.speeds[1] if flies else 0.0
        bench.put((0.0, 0.0, -HEIGHT if flies else 0.0), velocity_b=(ahead, 0.0, 0.0), settle=True)
        action = 0.3 * torch.rand((MANY, 1, len(model.action_names)))
        return per_second(partial(bench.step, action), substeps * MANY, seconds)

    return Contestant(f"taichi-sim, {vehicle}", _version("taichi-sim"), moved, rate)


# -- peers -------------------------------------------------------------------------------------------------------------


def python_vehicle_simulator() -> Contestant:
    """The Otter of PythonVehicleSimulator (T. I. Fossen), github.com/cybergalactic/PythonVehicleSimulator."""
    from python_vehicle_simulator.lib.gnc import attitudeEuler
    from python_vehicle_simulator.vehicles import otter as model

    vehicle, asked = model("stepInput"), 100.0 * commands(2)  # rad/s

    def moved(dt: float) -> Array:
        found = np.zeros((*asked.shape[:2], 9))
        for row in range(ROWS):
            eta, nu, shafts = np.zeros(6), np.zeros(6), np.zeros(2)
            for k, command in enumerate(asked[:, row]):
                for _ in range(round(INTERVAL / dt)):
                    nu, shafts = vehicle.dynamics(eta, nu, shafts, command, dt)
                    eta = attitudeEuler(eta, nu, dt)
                found[k, row] = np.concatenate((nu, eta[:3]))
        return found

    def rate(dt: float, seconds: float) -> float:
        def call() -> None:
            eta, nu, shafts = np.zeros(6), np.zeros(6), np.zeros(2)
            for _ in range(200):
                nu, shafts = vehicle.dynamics(eta, nu, shafts, asked[0, 0], dt)
                eta = attitudeEuler(eta, nu, dt)

        return per_second(call, 200, seconds)

    return Contestant("PythonVehicleSimulator, otter", _version("python_vehicle_simulator"), moved, rate)


def jsbsim_c172p() -> Contestant:
    """JSBSim, pypi.org/project/jsbsim: the Cessna 172 at 90 kt, engine off, a sixth of its deflections."""
    import jsbsim

    asked = commands(3) / 6
    surfaces = ("fcs/elevator-cmd-norm", "fcs/aileron-cmd-norm", "fcs/rudder-cmd-norm")
    told = [f"velocities/{name}" for name in ("u-fps", "v-fps", "w-fps", "p-rad_sec", "q-rad_sec", "r-rad_sec")]

    def begun(dt: float) -> Any:
        aircraft = jsbsim.FGFDMExec(None)
        aircraft.set_debug_level(0)
        aircraft.set_dt(dt)
        aircraft.load_model("c172p")
        aircraft["ic/h-sl-ft"], aircraft["ic/vc-kts"] = 5000.0, 90.0
        aircraft.run_ic()
        return aircraft

    def moved(dt: float) -> Array:
        found = np.zeros((*asked.shape[:2], 9))
        for row in range(ROWS):
            aircraft = begun(dt)
            for k, command in enumerate(asked[:, row]):
                for name, value in zip(surfaces, command, strict=True):
                    aircraft[name] = value
                for _ in range(round(INTERVAL / dt)):
                    aircraft.run()
                found[k, row, :6] = [aircraft[name] for name in told]
                found[k, row, 6:] = FEET * np.array([
                    aircraft["position/distance-from-start-lat-mt"] / FEET,
                    aircraft["position/distance-from-start-lon-mt"] / FEET, -aircraft["position/h-sl-ft"],
                ])  # fmt: skip
        return found

    def rate(dt: float, seconds: float) -> float:
        aircraft = begun(dt)

        def call() -> None:
            aircraft.reset_to_initial_conditions(0)
            for _ in range(500):
                aircraft.run()

        return per_second(call, 500, seconds)

    return Contestant("JSBSim, c172p", jsbsim.__version__, moved, rate)


def crazyflow_x500() -> Contestant:
    """crazyflow, pypi.org/project/crazyflow: the Holybro X500 on JAX, whose attitude is commanded, by RK4 (the default,
    Euler, errs by 1 % at 0.003 s).
    """
    os.environ.setdefault("SCIPY_ARRAY_API", "1")
    import jax
    from crazyflow import Sim
    from crazyflow.control import Control
    from crazyflow.drones import Drone
    from crazyflow.dynamics import Dynamics
    from crazyflow.sim.integration import Integrator

    asked = commands(4) * (0.2, 0.2, 0.2, 0.1)  # roll, pitch, yaw (rad), thrust over that of hover, less 1

    def begun(rows: int, dt: float) -> Any:
        freq, kinds = round(1 / dt), {"drone": Drone.hb_x500, "dynamics": Dynamics.so_rpy_rotor_drag}
        kinds |= {"control": Control.attitude, "integrator": Integrator.rk4}
        sim = Sim(n_worlds=rows, freq=freq, attitude_freq=freq, **kinds)
        states = sim.data.states
        sim.data = sim.data.replace(states=states.replace(pos=states.pos.at[..., 2].set(HEIGHT)))
        return sim

    def ordered(sim: Any, command: Array) -> None:
        factor = float(np.ravel(sim.data.params.cmd_f_coef)[0])  # thrust over its command
        hover = 9.81 * float(np.ravel(sim.data.params.mass)[0]) / factor
        thrust = hover * (1.0 + command[:, 3:])
        sim.attitude_control(np.concatenate((command[:, :3], thrust), axis=1)[:, None].astype(np.float32))

    def moved(dt: float) -> Array:
        sim, found = begun(ROWS, dt), np.zeros((*asked.shape[:2], 9))
        for k, command in enumerate(asked):
            ordered(sim, command)
            sim.step(round(INTERVAL / dt))
            now = sim.data.states
            found[k] = np.concatenate([np.asarray(x)[:, 0] for x in (now.vel, now.ang_vel, now.pos)], axis=-1)
        return found

    def rate(dt: float, seconds: float) -> float:
        sim, steps = begun(MANY, dt), round(INTERVAL / dt)
        draw, each = np.random.default_rng(SEED), asked.reshape(-1, 4)

        def call() -> None:
            ordered(sim, draw.choice(each, MANY))
            sim.step(steps)
            jax.block_until_ready(sim.data)

        return per_second(call, MANY * steps, seconds)

    return Contestant("crazyflow, X500", _version("crazyflow"), moved, rate)


RIVALS = ((python_vehicle_simulator, "otter"), (jsbsim_c172p, "aerosonde"), (crazyflow_x500, "x500"))


@contextmanager
def one_core() -> Iterator[None]:
    """Within this context, this thread and those that it starts run on one core; the Taichi program is as before
    afterwards.
    """
    cores, was = os.sched_getaffinity(0), runtime.current()
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
        runtime.init(was.arch, was.precision, was.threads)  # type: ignore[arg-type]


def measure_peers(*, seconds: float, show_progress: bool = False) -> list[dict[str, Any]]:
    """Compare the installed simulators with ours; return records for JSON."""
    pairs: list[Sequence[Contestant]] = []
    with one_core(), tempfile.TemporaryDirectory() as folder, chdir(folder):  # MuJoCo writes a log where it runs
        for build, vehicle in RIVALS:
            try:
                pairs.append((build(), ours(vehicle)))
            except (ImportError, RuntimeError):  # crazyflow needs its setting before anybody imports SciPy
                continue
        everybody = [one for pair in pairs for one in pair]
        records = []
        for one in tqdm(everybody, desc="peers", unit="simulator", disable=not show_progress):
            found = errors_of(one.motion, STEPS, FINE, one.name)
            step = step_for(found)
            steps = math.nan if math.isnan(step) else one.rate(step, seconds)
            records.append({
                "name": one.name, "version": one.version, "step_s": step, "steps_per_s": steps,
                "vehicle_seconds_per_s": step * steps, "errors": {e.dt: e.total for e in found},
            })  # fmt: skip
    return records
