"""Simulators of others that move a team's vehicles in the place of our models (tools/transfer.py).

A simulator of your own derives from `Simulator`. The classes below say which numbers the vehicles have there.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import taichi as ti
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from taichi_sim.bench import pack_state
from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import GRAVITY, POSITION, QUATERNION, STATE_SIZE, VELOCITY
from taichi_sim.kernels.packs import FleetPack
from taichi_sim.kernels.rotation import rotation_matrix, torch_euler_from_quaternion
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import DEFLECTIONS, READINGS, STALL_TIME, TIME, FixedWing6DOF
from taichi_sim.models.uav.multirotor import instruments
from taichi_sim.models.uav.multirotor.controller import heading_rate, specific_thrust, velocity_wanted
from taichi_sim.models.uav.multirotor.multirotor_6dof import Multirotor6DOF
from taichi_sim.models.usv.hull import thruster_set
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Vehicle
from tools.simulators import jsbsim_plane

Array = NDArray[np.float64]
PUBLISHED = "https://github.com/cybergalactic/PythonVehicleSimulator"


class Simulator(ABC):
    """The contract of a simulator that moves vehicles in the place of our model. NED, b, SI, radians
    (taichi_sim/kernels/conventions.py).

    Attributes:
        model: our model of the vehicles.
    """

    def __init__(self, model: Vehicle, path: Path | None):
        """Prepare for a team of `model`; `path` is the --path of the command."""
        self.model = model

    @abstractmethod
    def advance(self, fleet: Fleet, around: Surroundings) -> Array:
        """Move the vehicles by one control step; return their states [env * vehicle, 13].

        `fleet` (taichi_sim/fleet.py) holds states and actions. A simulator may keep state of its own in `fleet.aux`,
        which our model resets at the beginning of an episode. `around.current` [env, 2] is the water's velocity, m/s.
        """


def exact_states(fleet: Fleet) -> torch.Tensor:
    """States [env * vehicle, 13] of `fleet` in float64, on the CPU; positions are the sum of all steps."""
    state = fleet.state.to(torch.float64, copy=True)
    state[..., POSITION] = fleet.position_exact
    return state.cpu().view(-1, STATE_SIZE)


class PythonVehicleSimulator(Simulator):
    """The Otter of T. I. Fossen's PythonVehicleSimulator (its class `otter`, MIT).

    It is stepped as in that program's main loop: Euler steps of 0.02 s, the attitude with the new velocities. Actions
    become shaft speeds as in our model.
    """

    STEP = 0.02  # s, step of its main.py
    MASS, LENGTH = 80.0, 2.0  # kg, m

    def __init__(self, model: Vehicle, path: Path | None):
        """See Simulator."""
        super().__init__(model, path)
        pair = isinstance(model, Hull6Dof) and model.control_names == ("shaft_left", "shaft_right")
        if not pair or (model.params.rigid_body.mass, model.params.length) != (self.MASS, self.LENGTH):
            raise ConfigError(
                f"PythonVehicleSimulator: of vehicles here it has the Otter alone (hull_6dof, two propellers, "
                f"{self.MASS:g} kg, {self.LENGTH:g} m)"
            )
        self.thrusters = model.thrusters
        self.otter, self.turn = published_otter(path)
        self.seconds = model.dt * model.substeps

    def advance(self, fleet: Fleet, around: Surroundings) -> Array:
        """See Simulator."""
        first = self.thrusters.first
        asked = fleet.state.new_empty((*fleet.state.shape[:2], 2))
        shaft_speeds(self.thrusters, fleet.pack, asked)
        command = asked.double().cpu().view(-1, 2).numpy()
        state = exact_states(fleet)
        euler = torch_euler_from_quaternion(state[:, QUATERNION])
        eta, nu = torch.cat((state[:, POSITION], euler), dim=1).numpy(), state[:, 7:].numpy().copy()
        shafts = fleet.aux[..., first : first + 2].double().reshape(-1, 2).cpu().numpy()
        current = around.current.double().cpu().repeat_interleave(fleet.count, dim=0).numpy()
        steps = max(round(self.seconds / self.STEP), 1)
        h = self.seconds / steps
        for n in range(len(eta)):
            self.otter.V_c, self.otter.beta_c = np.hypot(*current[n]), np.arctan2(current[n, 1], current[n, 0])
            for _ in range(steps):
                nu[n], shafts[n] = self.otter.dynamics(eta[n], nu[n], shafts[n], command[n], h)
                eta[n] = self.turn(eta[n], nu[n], h)
        fleet.aux[..., first : first + 2] = torch.from_numpy(shafts).view(asked.shape).to(fleet.aux)
        return pack_state(eta, nu)


class RotorPy(Simulator):
    """A multirotor of four rotors by RotorPy (S. Folk, J. Paulos, V. Kumar 2023, MIT), its class `Multirotor`.

    It has the numbers of the vehicle file. Our controller commands the rotors' speeds, anew in each substep from the
    state there, and RotorPy integrates (Runge-Kutta 4(5), adaptive). Different there: rotors have one time constant,
    the mean of ours; they have no gyroscopic moment; there is no ground effect. Its frames are ours turned by 180
    degrees about x: north-west-up, forward-left-up.
    """

    TURN = np.array([1.0, -1.0, -1.0])

    def __init__(self, model: Vehicle, path: Path | None):
        """See Simulator."""
        super().__init__(model, path)
        if not isinstance(model, Multirotor6DOF) or model.count != 4:
            raise ConfigError("rotorpy: it has multirotors of four rotors alone (multirotor_6dof)")
        if model.battery:
            raise ConfigError("rotorpy: it has no battery; leave out [battery]")
        try:
            from rotorpy.vehicles.multirotor import Multirotor
        except ImportError as error:
            raise ConfigError(f"RotorPy cannot be imported ({error}): pip install rotorpy") from None
        body, rotor, rotors = model.p.physical, model.p.rotor, model.p.rotors
        if any(mount.gain != 1.0 for mount in rotors):
            raise ConfigError("rotorpy: all of its rotors are sound: every gain must be 1")
        self.craft = Multirotor({
            "mass": body.mass, "Ixx": body.Jx, "Iyy": body.Jy, "Izz": body.Jz,
            "Ixy": body.Jxy, "Ixz": body.Jxz, "Iyz": -body.Jyz,  # entries of the matrix, in its frame
            **{f"c_D{axis}": c for axis, c in zip("xyz", body.drag, strict=True)},
            "num_rotors": model.count,
            "rotor_pos": {f"r{k + 1}": arm * self.TURN for k, arm in enumerate(model.p.arms)},
            "rotor_directions": np.array([-mount.yaw for mount in rotors]),
            "rotor_speed_min": rotor.omega_min, "rotor_speed_max": rotor.omega_max,
            "k_eta": rotor.k_f, "k_m": rotor.k_m, "k_d": rotor.k_d, "k_z": rotor.k_z, "k_h": rotor.k_h,
            "k_flap": rotor.k_flap, "tau_m": 0.5 * (rotor.tau_up + rotor.tau_down),
        })  # fmt: skip
        self.speeds = slice(instruments.SPEEDS, instruments.SPEEDS + model.count)

    def advance(self, fleet: Fleet, around: Surroundings) -> Array:
        """See Simulator."""
        model = self.model
        assert isinstance(model, Multirotor6DOF)
        rows, found = fleet.num_envs * fleet.count, np.empty((0, STATE_SIZE))
        wanted = fleet.state.new_empty((*fleet.state.shape[:2], model.count))
        state = exact_states(fleet).numpy()
        omega = fleet.aux[..., self.speeds].double().cpu().reshape(rows, -1).numpy().copy()
        for _ in range(model.substeps):
            fleet.state.copy_(torch.from_numpy(state).view(fleet.state.shape))
            rotor_speeds(model, fleet.pack, wanted)
            command = wanted.double().cpu().view(rows, -1).numpy()
            for n in range(rows):
                state[n], omega[n] = self._moved(state[n], omega[n], command[n], model.dt)
            found = state
        show_rotors(fleet, omega, found)
        return found

    def _moved(self, y: Array, omega: Array, command: Array, dt: float) -> tuple[Array, Array]:
        """State [13] and rotor speeds [rotor] after dt (s)."""
        turn, q = self.TURN, y[QUATERNION] * (1.0, *self.TURN)
        velocity = Rotation.from_quat([*q[1:], q[0]]).apply(y[7:10] * turn)
        there = {
            "x": y[POSITION] * turn, "v": velocity, "q": np.array([*q[1:], q[0]]), "w": y[10:13] * turn,
            "wind": np.zeros(3), "rotor_speeds": omega,
        }  # fmt: skip
        new = self.craft.step(there, {"cmd_motor_speeds": command}, dt)
        body = Rotation.from_quat(new["q"]).inv().apply(new["v"]) * turn
        q = np.array([new["q"][3], *new["q"][:3]]) * (1.0, *turn)
        return np.concatenate([new["x"] * turn, q, body, new["w"] * turn]), new["rotor_speeds"]


class JSBSim(Simulator):
    """JSBSim's c172p (jsbsim_plane.py) at the scale of our aircraft, as a dynamically similar model would fly.

    Lengths there are those here times the ratio of the spans, times and speeds those here times its square root
    (Froude). So the c172p has about the airspeeds, turns and climbs that the scenario asks for. Its mass, aerodynamics,
    engine and propeller are its own. Actions ask for what they ask of our autopilot: the sine of the path angle, the
    bank and the airspeed. A pilot of the c172p's own flies them. Its air is the standard atmosphere's, at the height
    there. It flies from the equator, over an ellipsoid that turns.
    """

    STALLED = 0.28  # rad, the end of its tables

    def __init__(self, model: Vehicle, path: Path | None):
        """See Simulator."""
        super().__init__(model, path)
        if not isinstance(model, FixedWing6DOF) or model.actions != "guidance":
            raise ConfigError(
                'jsbsim: it moves fixed wings alone (fixed_wing_6dof with autopilot.actions = "guidance")'
            )
        self.trims, self.limits = jsbsim_plane.Trims(), model.autopilot_limits
        self.length = self.trims.span / model.p.physical.b
        self.speed, seconds = math.sqrt(self.length), model.dt * model.substeps
        self.steps = max(math.ceil(seconds * self.speed / jsbsim_plane.STEP - 1e-9), 1)
        self.dt, self.seconds = seconds * self.speed / self.steps, seconds
        self.planes: dict[int, jsbsim_plane.Plane] = {}
        self.begun, self.left = np.zeros((0, 2)), np.zeros((0, STATE_SIZE))

    def advance(self, fleet: Fleet, around: Surroundings) -> Array:
        """See Simulator."""
        rows, limits = fleet.num_envs * fleet.count, self.limits
        state = fleet.state.double().cpu().view(rows, STATE_SIZE).numpy()
        if len(self.left) != rows:
            self.begun, self.left = np.zeros((rows, 2)), np.full((rows, STATE_SIZE), np.nan)
        actions = fleet.action.double().cpu().view(rows, -1).numpy()
        eta, nu, aux = np.empty((rows, 6)), np.empty((rows, 6)), np.empty((rows, 8))
        for n in range(rows):
            if not np.array_equal(state[n], self.left[n]):  # placed anew, in level flight
                self._begin(n, state[n])
            pitch, yaw, boost = actions[n].tolist()
            low, cruise, high = limits.speeds
            wanted = cruise + max(boost, 0.0) * (high - cruise) + min(boost, 0.0) * (cruise - low)
            plane = self.planes[n]
            plane.fly(pitch * limits.sin_pitch, yaw * limits.tan_bank, wanted * self.speed, self.steps)
            eta[n], nu[n], aux[n] = plane.eta, plane.nu, plane.deflections + plane.readings
        eta[:, :3] /= self.length
        eta[:, :2] += self.begun
        nu[:, :3] /= self.speed
        nu[:, 3:] *= self.speed
        aux[:, 4] /= self.speed
        found = pack_state(eta, nu)
        self.left = torch.from_numpy(found).to(fleet.state).double().cpu().numpy()  # as fleet.state will have it
        now, given = fleet.aux.view(rows, -1), torch.from_numpy(aux).to(fleet.aux)
        now[:, DEFLECTIONS : DEFLECTIONS + 4], now[:, READINGS : READINGS + 4] = given[:, :4], given[:, 4:]
        now[:, TIME] += self.seconds
        now[:, STALL_TIME] = (now[:, STALL_TIME] + self.seconds) * (given[:, 5] > self.STALLED)
        return found

    def _begin(self, n: int, state: Array) -> None:
        heading = float(torch_euler_from_quaternion(torch.from_numpy(state[QUATERNION]))[2])
        speed, height = float(np.linalg.norm(state[VELOCITY])) * self.speed, -state[2] * self.length
        self.planes[n] = jsbsim_plane.Plane(self.trims, self.dt, speed, height, heading)
        self.begun[n] = state[:2]


class Crazyflow(Simulator):
    """The Holybro X500 of crazyflow (M. Schuck, M. Rath and others 2025, MIT), fitted to flights of one.

    Its mass, drag, the lags of its thrust and of its own attitude controller are crazyflow's (`so_rpy_rotor_drag`), and
    so is the integrator, with its usual 500 steps a second. Our controller of velocities commands the specific thrust,
    anew in each substep from the state there: crazyflow gets the attitude and the share of the hover's thrust. Frames
    are RotorPy's. Speeds of rotors, which it does not have, are shown as those that hover shares ask for.
    """

    FREQUENCY = 500  # 1/s, crazyflow's default
    TURN = RotorPy.TURN

    def __init__(self, model: Vehicle, path: Path | None):
        """See Simulator."""
        super().__init__(model, path)
        like = isinstance(model, Multirotor6DOF) and model.count == 4 and model.actions == "velocity"
        if not like or abs(model.p.physical.mass - 2.06) > 0.01:
            raise ConfigError('crazyflow: of vehicles here it has the x500 alone, with control.actions = "velocity"')
        try:
            from crazyflow import Sim
            from crazyflow.control import Control
            from crazyflow.drones import Drone
            from crazyflow.dynamics import Dynamics
        except (ImportError, RuntimeError) as error:  # it needs that setting before anybody imports scipy
            raise ConfigError(
                f"crazyflow cannot be imported ({error}): pip install crazyflow, and set SCIPY_ARRAY_API=1"
            ) from None
        kinds = {"drone": Drone.hb_x500, "dynamics": Dynamics.so_rpy_rotor_drag, "control": Control.attitude}
        self.make = lambda rows: Sim(n_worlds=rows, freq=self.FREQUENCY, **kinds)
        self.there: Any = None
        self.steps = max(round(model.dt * self.FREQUENCY), 1)
        self.speeds = slice(instruments.SPEEDS, instruments.SPEEDS + model.count)

    def advance(self, fleet: Fleet, around: Surroundings) -> Array:
        """See Simulator."""
        model, rows, turn = self.model, fleet.num_envs * fleet.count, self.TURN
        assert isinstance(model, Multirotor6DOF)
        if self.there is None or self.there.n_worlds != rows:
            self.there = self.make(rows)
        sim, q_turn = self.there, np.array([1.0, *turn])
        weight = float(np.ravel(sim.data.params.mass)[0]) * GRAVITY
        factor = float(np.ravel(sim.data.params.cmd_f_coef)[0])  # thrust over its command
        hover = model.p.physical.mass * GRAVITY / (model.count * model.p.rotor.k_f)  # speed squared
        wanted = fleet.state.new_empty((*fleet.state.shape[:2], 5))
        state = exact_states(fleet).numpy()
        omega = fleet.aux[..., self.speeds].double().cpu().reshape(rows, -1).numpy()
        thrust = (omega**2).mean(axis=1) / hover * weight
        for _ in range(model.substeps):
            fleet.state.copy_(torch.from_numpy(state).view(fleet.state.shape))
            specific_thrusts(model, fleet.pack, wanted)
            c, nose = np.split(wanted.double().cpu().view(rows, -1).numpy(), [3], axis=1)
            R = Rotation.from_quat(state[:, [4, 5, 6, 3]])
            share = np.maximum((c * R.as_matrix()[:, :, 2]).sum(1), 0.0) / GRAVITY
            yaw = np.arctan2(nose[:, 1], nose[:, 0])
            level = Rotation.from_euler("z", -yaw[:, None]).apply(c / np.linalg.norm(c, axis=1, keepdims=True))
            attitude = np.stack([-np.arcsin(level[:, 1]), -np.arctan2(level[:, 0], level[:, 2]), -yaw], axis=1)
            command = np.column_stack([attitude, share * weight / factor])
            new = sim.data.states.replace(
                pos=_jax(state[:, :3] * turn), vel=_jax(R.apply(state[:, 7:10]) * turn),
                quat=_jax((state[:, 3:7] * q_turn)[:, [1, 2, 3, 0]]), ang_vel=_jax(state[:, 10:] * turn),
                rotor_vel=_jax(np.tile(thrust[:, None], 4)),
            )  # fmt: skip
            sim.data = sim.data.replace(states=new)
            sim.attitude_control(_jax(command))
            sim.step(self.steps)
            x, q, v, w, T = (
                np.asarray(getattr(sim.data.states, name), dtype=np.float64)[:, 0]
                for name in ("pos", "quat", "vel", "ang_vel", "rotor_vel")
            )
            thrust = T[:, 0]
            q = q[:, [3, 0, 1, 2]] * q_turn
            v_b = Rotation.from_quat(q[:, [1, 2, 3, 0]]).inv().apply(v * turn)
            state = np.hstack((x * turn, q, v_b, w * turn))
        show_rotors(fleet, np.tile(np.sqrt(np.maximum(thrust, 0.0) / weight * hover)[:, None], model.count), state)
        return state


def _jax(values: Array) -> Any:
    """Convert values [world, n] to an array [world, drone, n] of crazyflow."""
    import jax.numpy as jnp

    return jnp.asarray(values[:, None], dtype=jnp.float32)


def show_rotors(fleet: Fleet, omega: Array, state: Array) -> None:
    """Write what a multirotor's instruments show: speeds of its rotors [row, rotor], airspeed in still air, time."""
    count, shape = omega.shape[1], fleet.state.shape[:2]
    speed = np.linalg.norm(state[:, VELOCITY], axis=1)
    fleet.aux[..., instruments.SPEEDS : instruments.SPEEDS + count] = (
        torch.from_numpy(omega).view(*shape, count).to(fleet.aux)
    )
    fleet.aux[..., instruments.TIME] += fleet.model.dt * fleet.model.substeps
    fleet.aux[..., instruments.AIRSPEED] = torch.from_numpy(speed).view(shape).to(fleet.aux)


SIMULATORS: Mapping[str, type[Simulator]] = {
    "python_vehicle_simulator": PythonVehicleSimulator,
    "rotorpy": RotorPy,
    "jsbsim": JSBSim,
    "crazyflow": Crazyflow,
}


@ti.kernel
def rotor_speeds(model: ti.template(), fleet: FleetPack, out: ti.types.ndarray(ndim=3)):
    """Write the rotor speeds [env, vehicle, rotor] (rad/s) that the controllers of a team of multirotors command, and
    advance the controllers by a substep.
    """
    for e, i in ti.ndrange(out.shape[0], out.shape[1]):
        y = ti.Vector([fleet.state[e, i, k] for k in ti.static(range(STATE_SIZE))])
        held = ti.Vector([fleet.aux[e, i, instruments.INTEGRALS + k] for k in ti.static(range(8))])
        R = rotation_matrix(ti.Vector([y[3], y[4], y[5], y[6]]))
        v_n, most = R @ ti.Vector([y[7], y[8], y[9]]), y[0] * 0.0 + ti.static(model.plan.rotor.omega_max)
        asked = ti.Vector([fleet.action[e, i, k] for k in ti.static(range(len(model.action_names)))])
        command, held, _rates, _toward = model.commanded(asked, y, R, v_n, held, most, 0)
        for k in ti.static(range(model.count)):
            out[e, i, k] = command[k]
        for k in ti.static(range(8)):
            fleet.aux[e, i, instruments.INTEGRALS + k] = held[k]


@ti.kernel
def specific_thrusts(model: ti.template(), fleet: FleetPack, out: ti.types.ndarray(ndim=3)):
    """Write the specific thrust (n, m/s^2, along the rotors' pull reversed) and the cosine and sine of the heading
    [env, vehicle, 5] that the controllers of velocities of multirotors command, and advance them by a substep.
    """
    for e, i in ti.ndrange(out.shape[0], out.shape[1]):
        y = ti.Vector([fleet.state[e, i, k] for k in ti.static(range(STATE_SIZE))])
        held = ti.Vector([fleet.aux[e, i, instruments.INTEGRALS + k] for k in ti.static(range(8))])
        R = rotation_matrix(ti.Vector([y[3], y[4], y[5], y[6]]))
        v_n, slow = R @ ti.Vector([y[7], y[8], y[9]]), ti.Vector([held[3], held[4], held[5]])
        asked = ti.Vector([fleet.action[e, i, k] for k in ti.static(range(4))])
        toward = velocity_wanted(model.demands, asked, held[6], held[7])
        turn = model.demands.yaw_rate * asked[3]
        c, slow = specific_thrust(model.gains, model.demands, toward, v_n, turn, slow, model.dt)
        _rate, nose = heading_rate(model.gains, R, turn, ti.Vector([held[6], held[7]]), model.dt)
        for k in ti.static(range(3)):
            out[e, i, k] = c[k]
            fleet.aux[e, i, instruments.INTEGRALS + 3 + k] = slow[k]
        for k in ti.static(range(2)):
            out[e, i, 3 + k] = nose[k]
            fleet.aux[e, i, instruments.INTEGRALS + 6 + k] = nose[k]


@ti.kernel
def shaft_speeds(thrusters: ti.template(), fleet: FleetPack, out: ti.types.ndarray(ndim=3)):
    """Write the controls [env, vehicle, control] that the actions of a team of hulls command."""
    for e, i in ti.ndrange(out.shape[0], out.shape[1]):
        now = thruster_set.controls_at(thrusters, fleet.aux, e, i)
        command = thruster_set.commanded(thrusters, None, fleet.action, e, i, now)
        for c in ti.static(range(len(thrusters.control_names))):
            out[e, i, c] = command[c]


def published_otter(path: Path | None) -> tuple[Any, Any]:
    """PythonVehicleSimulator's Otter and its attitudeEuler, as installed, or from a checkout at `path`."""
    folders = [] if path is None else [folder for folder in (path, path / "src") if _holds(folder)]
    if path is not None and not folders:
        raise ConfigError(f"--path {path}: there is no python_vehicle_simulator: name a checkout of {PUBLISHED}")
    sys.path[:0] = map(str, folders[:1])
    try:
        from python_vehicle_simulator.lib.gnc import attitudeEuler
        from python_vehicle_simulator.vehicles.otter import otter
    except ImportError as error:
        raise ConfigError(
            f"PythonVehicleSimulator cannot be imported ({error}). It is on no package index: git clone {PUBLISHED}, "
            "and name that folder by --path"
        ) from None
    finally:
        del sys.path[: len(folders[:1])]
    return otter(), attitudeEuler


def _holds(folder: Path) -> bool:
    return (folder / "python_vehicle_simulator").is_dir()
