"""Other simulators on the same machine at the same time, if they are installed.

Each runs in a plain loop in calm water or still air, as its documentation shows.
"""

import statistics
import time
from collections.abc import Callable
from importlib import metadata
from typing import NamedTuple


class Peer(NamedTuple):
    """A simulator ready to run: `call` takes `steps` vehicle steps."""

    name: str
    version: str
    step: str
    call: Callable[[], object]
    steps: int


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:  # importable from a checkout
        return "unknown"


def otter() -> Peer:
    """PythonVehicleSimulator (T. I. Fossen), github.com/cybergalactic/PythonVehicleSimulator."""
    import numpy as np
    from python_vehicle_simulator.lib.gnc import attitudeEuler
    from python_vehicle_simulator.vehicles import otter as model

    vehicle, dt, steps = model("stepInput"), 0.02, 200

    def call() -> None:
        eta, nu, actual = np.zeros(6), vehicle.nu, vehicle.u_actual
        for i in range(steps):
            command = vehicle.stepInput(i * dt)
            nu, actual = vehicle.dynamics(eta, nu, actual, command, dt)
            eta = attitudeEuler(eta, nu, dt)

    return Peer(
        "PythonVehicleSimulator, otter",
        _version("python_vehicle_simulator"),
        "one 6-DOF Euler step, calm water",
        call,
        steps,
    )


def jsbsim_c172p() -> Peer:
    """JSBSim, pypi.org/project/jsbsim: the Cessna 172 at 90 kt, engine off."""
    import jsbsim

    aircraft, steps = jsbsim.FGFDMExec(None), 500
    aircraft.set_debug_level(0)
    aircraft.load_model("c172p")
    aircraft["ic/h-sl-ft"], aircraft["ic/vc-kts"] = 5000.0, 90.0
    aircraft.run_ic()

    def call() -> None:
        aircraft.reset_to_initial_conditions(0)
        for _ in range(steps):
            aircraft.run()

    return Peer("jsbsim, c172p", jsbsim.__version__, "one 6-DOF step, one core", call, steps)


def crazyflow_worlds() -> Peer:
    """crazyflow, pypi.org/project/crazyflow: 4096 hovering quadrotors on JAX."""
    import jax
    import numpy as np
    from crazyflow.control import Control
    from crazyflow.sim import Sim

    worlds, steps = 4096, 10
    sim = Sim(n_worlds=worlds, control=Control.attitude)
    sim.reset()
    command = np.zeros((worlds, 1, 4), dtype=np.float32)
    command[..., 3] = 0.3  # N

    def call() -> None:
        sim.reset()
        sim.attitude_control(command)
        sim.step(steps)
        jax.block_until_ready(sim.data)

    return Peer("crazyflow, 4096 worlds", _version("crazyflow"), "one 6-DOF quadrotor step", call, worlds * steps)


def rotorpy_quadrotor() -> Peer:
    """RotorPy, pypi.org/project/rotorpy: its Hummingbird at constant rotor speeds."""
    import numpy as np
    from rotorpy.vehicles.hummingbird_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    vehicle, dt, steps = Multirotor(quad_params), 0.02, 200
    command = {"cmd_motor_speeds": np.full(4, 500.0)}  # rad/s

    def call() -> None:
        state = vehicle.initial_state
        for _ in range(steps):
            state = vehicle.step(state, command, dt)

    return Peer("rotorpy, hummingbird", _version("rotorpy"), "one 6-DOF step, one core", call, steps)


PEERS = (otter, jsbsim_c172p, crazyflow_worlds, rotorpy_quadrotor)


def measure_peers(*, seconds: float, repetitions: int) -> list[dict]:
    """Time the installed simulators; return their speeds as records for JSON."""
    ready: list[Peer] = []
    for build in PEERS:
        try:
            ready.append(build())
        except ImportError:
            continue
    times: dict[str, list[float]] = {peer.name: [] for peer in ready}
    for peer in ready:
        peer.call()
    for _ in range(repetitions):
        for peer in ready:
            start, calls = time.perf_counter(), 0
            while calls == 0 or time.perf_counter() - start < seconds:
                peer.call()
                calls += 1
            times[peer.name].append((time.perf_counter() - start) / calls)
    return [
        {"name": p.name, "version": p.version, "step": p.step,
         "steps_per_s": p.steps / statistics.median(times[p.name])}
        for p in ready
    ]  # fmt: skip
