"""Steady straight flight of a multirotor: attitude and rotor speeds at a given velocity through the air and heading.

`trimmed` begins a flight in it, in any wind, with instruments and controller settled in it.

Six accelerations are zero. The thrust balances weight and all other forces, so its direction gives the attitude and its
size the collective thrust. The moments of rotor drag and flapping require differences between rotors (controller.py).
Forces and moments depend only weakly on attitude and rotor speeds, so a fixed-point iteration converges.

Of the small motions about it there are the linear model, its modes, and the longest stable step of RK4.
"""

# Kernels are another language inside Python syntax.
# pyright: reportAttributeAccessIssue=false, reportGeneralTypeIssues=false, reportIndexIssue=false, reportInvalidTypeForm=false
# pyright: reportOptionalCall=false

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import taichi as ti
import torch
from torch import Tensor

from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import put, taken, taken2
from taichi_sim.kernels.conventions import GRAVITY, QUATERNION, STATE_SIZE, VELOCITY
from taichi_sim.kernels.rigid_body import cross
from taichi_sim.kernels.rotation import (
    attitude_of,
    quaternion_from_euler,
    torch_quaternion_from_euler,
    torch_rotation_matrix,
    velocity_of,
)
from taichi_sim.kernels.runtime import array2, array3
from taichi_sim.models.uav.aircraft import TrimError
from taichi_sim.models.uav.fixed_wing.trim import Mode, StableStep, in_body, jacobian, level_attitude, rk4_limit
from taichi_sim.models.uav.local_air import wind_at
from taichi_sim.models.uav.multirotor import instruments as at
from taichi_sim.models.uav.multirotor.airframe import inverse_inertia_times, loads, rhs
from taichi_sim.models.uav.multirotor.controller import allocation
from taichi_sim.models.uav.multirotor.params import MultirotorParams, gains, nominal_numbers
from taichi_sim.models.uav.multirotor.rotors import arm
from taichi_sim.surroundings.around_vehicles import Surroundings

ITERATIONS = 60
RESIDUAL = {"f64": 1e-9, "f32": 1e-4}  # largest residual of a trim, m/s^2 and rad/s^2
ENOUGH = {"f64": 1e-13, "f32": 1e-6}  # residual at which the search ends, m/s^2 and rad/s^2
BEYOND, FLATTEST = 2.0, 0.1  # bounds of the search: largest speed over omega_max, least vertical thrust over weight
LEVEL = 1e-6  # level part of the bow's direction below which it has no heading
PHI, THETA, LEFT, SPEEDS = range(4)
"""Columns of a solution: roll, pitch (rad), what is left of the accelerations (m/s^2, rad/s^2), rotor speeds (rad/s).
"""
STATES = ("u", "v", "w", "p", "q", "r", "phi", "theta")
PLANES = {"pitch": ("u", "q", "theta"), "roll": ("v", "p", "phi"), "heave": ("w",), "yaw": ("r",)}
SLOWEST = 1e-9  # 1/s: a smaller eigenvalue is zero within rounding


@dataclass(frozen=True)
class MultirotorTrim:
    """Steady flight of a multirotor; angles in rad."""

    velocity_air: np.ndarray  # [3], n, m/s
    phi: float
    theta: float
    heading: float
    omega: np.ndarray  # [rotor], rad/s
    state: np.ndarray  # [13], at the origin, moving over ground

    @property
    def tilt(self) -> float:
        """Angle between thrust and vertical, rad."""
        return math.acos(math.cos(self.phi) * math.cos(self.theta))


@ti.func
def steady_flight(craft: ti.template(), v_n, nose):
    """Steady flight at v_n through the air (n, m/s) with the nose towards the level unit vector `nose`.

    Returns the body's down axis (n), the specific thrust (m/s^2, n), the moment of the thrusts (N m, b), the rotor
    speeds (rad/s), and what is left of the accelerations (m/s^2, rad/s^2). Rotor speeds may lie outside the rotors'
    range; where there is no steady flight the result is finite, and much is left.
    """
    p, a = ti.static(nominal_numbers(craft), allocation(craft))
    N = ti.static(len(craft.rotors))
    gain = ti.static(gains(p, N))
    down = ti.Vector([v_n[0] * 0.0, v_n[0] * 0.0, v_n[0] * 0.0 + 1.0])
    still, ones = ti.Vector([v_n[0] * 0.0, v_n[0] * 0.0, v_n[0] * 0.0]), ti.Vector([v_n[0] * 0.0 + 1.0] * N)
    z, c, thrust = down, GRAVITY * down, ones
    omega, balance, left = ones, still, v_n[0] * 0.0
    for k in ti.static(range(N)):
        omega[k] = a.hover[k]
        thrust[k] = p.k_f * omega[k] * omega[k]
    most = p.k_f * ti.static((BEYOND * craft.rotor.omega_max) ** 2)
    for _ in range(ITERATIONS):
        x = ahead(z, nose)
        y = cross(z, x)
        v_b = ti.Vector([x.dot(v_n), y.dot(v_n), z.dot(v_n)])
        force, moment = loads(craft, p, v_b, still, omega, ones)
        T, turning = v_n[0] * 0.0, still
        for k in ti.static(range(N)):
            lift = gain[k] * thrust[k]
            T += lift
            turning += cross(arm(craft, p, k), ti.Vector([v_n[0] * 0.0, v_n[0] * 0.0, -lift]))
            turning[2] += ti.static(craft.rotors[k].yaw) * p.k_m * omega[k] * omega[k] * gain[k]
        rest = force[0] * x + force[1] * y + (force[2] + T) * z
        wanted = rest * p.inverse_mass + GRAVITY * down
        left = ti.sqrt((wanted - T * p.inverse_mass * z).norm_sqr())
        left = ti.max(left, ti.sqrt(moment.norm_sqr()) * ti.max(p.inverse_00, ti.max(p.inverse_11, p.inverse_22)))
        c, balance = wanted, turning - moment
        if left < ti.static(ENOUGH[runtime.current().precision]):
            break
        c[2] = ti.max(c[2], ti.static(FLATTEST * GRAVITY))
        size = ti.sqrt(c.dot(c))
        z = c / size
        change = size / p.inverse_mass - T
        for k in ti.static(range(N)):
            step = ti.static(a.P[k][0]) * change
            for b in ti.static(range(3)):
                step -= ti.static(a.P[k][1 + b]) * moment[b]
            thrust[k] = ti.max(ti.min(thrust[k] + step, most), 0.0)
            omega[k] = ti.sqrt(thrust[k] / p.k_f)
    return z, c, balance, omega, left


@ti.func
def ahead(z, nose):
    """The body's axis ahead (n) of a body whose axis down is z, its nose above or below the level vector `nose`."""
    x = z[2] * nose
    x[2] -= z.dot(nose)
    return x / ti.sqrt(x.dot(x))


@ti.func
def roll_and_pitch(z, nose):
    """Roll and pitch (rad) of that body."""
    return ti.atan2(cross(z, ahead(z, nose))[2], z[2]), ti.atan2(z.dot(nose), z[2])


@ti.kernel
def solve(craft: ti.template(), air: array2, out: array2):
    """Write the solutions [n, SPEEDS + rotor] of steady flight at `air` [n, 5].

    The columns of `air` are the velocity through the air (n, m/s), and cosine and sine of the heading.
    """
    for row in range(air.shape[0]):
        asked = taken2(air, row, 5)
        nose = ti.Vector([asked[3], asked[4], asked[0] * 0.0])
        z, _, _, omega, left = steady_flight(craft, ti.Vector([asked[0], asked[1], asked[2]]), nose)
        out[row, PHI], out[row, THETA] = roll_and_pitch(z, nose)
        out[row, LEFT] = left
        for k in ti.static(range(len(craft.rotors))):
            out[row, SPEEDS + k] = omega[k]


def _charged(craft: MultirotorParams) -> tuple[float, float]:
    """Charge (0 to 1) and voltage (V) of the battery at the beginning, zero without."""
    return (0.0, 0.0) if craft.battery is None else (craft.battery.charge, craft.battery.full)


@ti.kernel
def begin_flight(craft: ti.template(), state: array3, wind: array3, tilted: array3, aux: array3):
    """Write how vehicles at `state` [n, vehicle, 13] in `wind` [n, vehicle, 3] (NED, m/s) begin a steady flight.

    `tilted` gets their states, with the velocities over ground and the headings of `state`; `aux` gets instruments and
    controllers that are settled in that flight. The first step draws the turbulence.
    """
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        y, air = taken(state, e, i, 0, STATE_SIZE), taken(wind, e, i, 0, 3)
        p = ti.static(nominal_numbers(craft))
        R = attitude_of(y)
        v_n, nose = R @ velocity_of(y), ti.Vector([y[0] * 0.0 + 1.0, y[0] * 0.0, y[0] * 0.0])
        level = ti.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0])
        if level > LEVEL:
            nose[0], nose[1] = R[0, 0] / level, R[1, 0] / level
        z, specific, moment, omega, _ = steady_flight(craft, v_n - air, nose)
        x = ahead(z, nose)
        y_axis = cross(z, x)
        roll, pitch = roll_and_pitch(z, nose)
        q = quaternion_from_euler(roll, pitch, ti.atan2(nose[1], nose[0]))
        put(tilted, e, i, 0, [y[0], y[1], y[2], q[0], q[1], q[2], q[3]])
        put(tilted, e, i, 7, [x.dot(v_n), y_axis.dot(v_n), z.dot(v_n), 0.0, 0.0, 0.0])
        for k in range(aux.shape[2]):
            aux[e, i, k] = 0.0
        size = ti.sqrt(specific.norm_sqr())
        aux[e, i, at.THRUST], aux[e, i, at.GROUND] = size / p.inverse_mass, 1.0
        aux[e, i, at.AIRSPEED] = ti.sqrt((v_n - air).norm_sqr())
        aux[e, i, at.TILT] = ti.acos(ti.max(ti.min(specific[2] / size, 1.0), -1.0))
        aux[e, i, at.HEADING], aux[e, i, at.HEADING + 1] = nose[0], nose[1]
        turning = inverse_inertia_times(p, moment)
        for b in ti.static(range(3)):
            aux[e, i, at.WIND + b] = air[b]
            aux[e, i, at.VELOCITY_WANTED + b], aux[e, i, at.VELOCITY_N + b] = v_n[b], v_n[b]
            aux[e, i, at.INTEGRALS + b] = turning[b]
            aux[e, i, at.INTEGRALS + 3 + b] = ti.static(GRAVITY if b == 2 else 0.0) - specific[b]
        charge, voltage = ti.static(_charged(craft))
        aux[e, i, at.CHARGE], aux[e, i, at.VOLTAGE] = charge, voltage
        for k in ti.static(range(len(craft.rotors))):
            speed = ti.min(omega[k], ti.static(craft.rotor.omega_max))
            aux[e, i, at.SPEEDS + k] = ti.max(speed, ti.static(craft.rotor.omega_min))


_begin = runtime.Launcher(begin_flight, few=runtime.LARGE)


def trim(
    craft: MultirotorParams, velocity_n=(0.0, 0.0, 0.0), wind=(0.0, 0.0, 0.0), heading: float = 0.0
) -> MultirotorTrim:
    """Steady flight over ground at velocity_n (NED, m/s) in a steady `wind` (NED, m/s), the nose at `heading` (rad)."""
    ground, blown = (np.asarray(x, dtype=np.float64) for x in (velocity_n, wind))
    air = np.array([[*(ground - blown), math.cos(heading), math.sin(heading)]])
    out = np.empty((1, SPEEDS + len(craft.rotors)))
    solve(craft, air, out)
    row, fast = out[0], float(np.linalg.norm(air[0, :3]))
    omega, rotor = row[SPEEDS:].copy(), craft.rotor
    left = row[LEFT]
    if not left < RESIDUAL[runtime.current().precision]:
        raise TrimError(f"no steady flight at {fast:g} m/s through the air: {left:.3g} m/s^2 or rad/s^2 are left")
    if omega.max() > rotor.omega_max or omega.min() < rotor.omega_min:
        worst = int(np.argmax(omega)) if omega.max() > rotor.omega_max else int(np.argmin(omega))
        raise TrimError(
            f"no steady flight at {fast:g} m/s through the air: rotors.{worst} would have to turn at "
            f"{omega[worst]:.4g} rad/s, of {rotor.omega_min:g} to {rotor.omega_max:g}"
        )
    phi, theta = float(row[PHI]), float(row[THETA])
    state = np.zeros(STATE_SIZE)
    q = torch_quaternion_from_euler(*(torch.tensor(x, dtype=torch.float64) for x in (phi, theta, heading)))
    state[QUATERNION] = q.numpy()
    state[VELOCITY] = torch_rotation_matrix(q).numpy().T @ ground
    return MultirotorTrim(air[0, :3], phi, theta, heading, omega, state)


def trimmed(craft: MultirotorParams, state: Tensor, around: Surroundings) -> tuple[Tensor, Tensor]:
    """How vehicles begin a flight in the mean wind at places, headings, velocities over ground of `state`.

    Returns:
        Their states [n, vehicle, 13], tilted into the wind, and their auxiliary states [n, vehicle, ..] (`at`).
    """
    tilted, aux = torch.empty_like(state), state.new_empty((*state.shape[:2], at.SPEEDS + len(craft.rotors)))
    _begin.once(craft, state.contiguous(), wind_at(state, around).contiguous(), tilted, aux)
    return tilted, aux


@dataclass(frozen=True)
class MultirotorLinearModel:
    """x' = A x + B omega about a trim, rotors held at their speeds; x = STATES (m/s, rad/s, rad), omega in rad/s."""

    A: np.ndarray  # [8, 8]
    B: np.ndarray  # [8, rotor]
    modes: tuple[Mode, ...]  # named for the motion that dominates the eigenvector (PLANES), fast ones first

    def block(self, states: tuple[str, ...]) -> np.ndarray:
        """The part of A for the given states alone."""
        at = [STATES.index(name) for name in states]
        return self.A[np.ix_(at, at)]


def linear_modes(craft: MultirotorParams, trim: MultirotorTrim) -> MultirotorLinearModel:
    """The linear model about `trim` in still air, by central differences."""
    R_b = level_attitude(np.array([trim.phi]), np.array([trim.theta]))
    v = _in_body(trim.velocity_air, trim.heading, R_b)
    x = np.concatenate((v, np.zeros(3), [trim.phi, trim.theta], trim.omega))
    J = jacobian(partial(rhs, craft), x).T
    A = J[:, : len(STATES)]
    return MultirotorLinearModel(A, J[:, len(STATES) :], _modes(A))


def _in_body(velocity_n: np.ndarray, heading: float, q: np.ndarray) -> np.ndarray:
    """A velocity (n), turned by -heading, in the axes of attitude q [1, 4], whose heading is zero."""
    c, s = np.cos(heading), np.sin(heading)
    level = np.array([c * velocity_n[0] + s * velocity_n[1], c * velocity_n[1] - s * velocity_n[0], velocity_n[2]])
    return in_body(level, q[0])


def _modes(A: np.ndarray) -> tuple[Mode, ...]:
    """One mode for each real eigenvalue and each conjugate pair."""
    values, vectors = np.linalg.eig(A)
    found = []
    for value, vector in zip(values.tolist(), vectors.T, strict=True):
        if value.imag < 0:
            continue  # its conjugate stands for both
        share = {name: sum(abs(vector[STATES.index(s)]) ** 2 for s in states) for name, states in PLANES.items()}
        pair = (value, value.conjugate()) if value.imag > 0 else (value,)
        found.append(Mode(max(share, key=lambda name: share[name]), pair))
    return tuple(sorted(found, key=lambda mode: -mode.frequency))


def largest_stable_dt(craft: MultirotorParams, fastest: MultirotorTrim) -> StableStep:
    """The longest step of RK4 that is stable for all damped modes about the trim at the largest airspeed.

    Rotors do not limit it.
    """
    damped = [m for m in linear_modes(craft, fastest).modes if m.eigenvalues[0].real < -SLOWEST]
    if not damped:
        return StableStep(np.inf, "nothing is damped")
    limits = [(min(rk4_limit(x) for x in mode.eigenvalues), mode) for mode in damped]
    dt, mode = min(limits, key=lambda item: item[0])
    eigenvalue, speed = mode.eigenvalues[0], np.linalg.norm(fastest.velocity_air)
    return StableStep(
        dt, f"RK4 holds the mode {mode.name} ({eigenvalue.real:.3g} 1/s at {speed:g} m/s) up to {dt:.3g} s"
    )
