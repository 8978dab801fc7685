"""A multirotor's forces, its equations of motion, and one step of them: rotors (rotors.py), fuselage drag, weight.

NED world, forward-right-down body about the centre of gravity, quaternion body to world. Drag acts at the centre of
gravity, -|v_r| diag(drag) v_r. With the rotors' angular momentum h about b's z (rotors.py), Newton and Euler in body
axes:

    m (v' + omega x v) = F + m g down,   J omega' = M - omega x (J omega) - omega x h - h'.

A step uses the classical Runge-Kutta method in the frame that moves with the air. At its stages the rotors' speeds
follow their exact solution for the held command, so a lag as short as half a step costs neither accuracy nor stability.

`craft` is a MultirotorParams. It provides the parameters that never vary; kernels compile them in. `p` holds the
numbers that may vary (params.py), either compiled in or loaded for each environment. `derivatives` and the functions
below it treat many states at once, with the numbers of the vehicle file.
"""

# Kernels are another language inside Python syntax.
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportInvalidTypeForm=false

import math

import numpy as np
import taichi as ti

from taichi_sim.kernels.abreast import taken2
from taichi_sim.kernels.conventions import GRAVITY, STATE_SIZE
from taichi_sim.kernels.rigid_body import cross, is_nothing, quaternion_rate
from taichi_sim.kernels.rotation import attitude_of, quaternion_of, rates_of, velocity_of
from taichi_sim.kernels.runtime import array2
from taichi_sim.models.uav.multirotor import ground, rotors
from taichi_sim.models.uav.multirotor.params import MultirotorParams, nominal_numbers


@ti.func
def inertia_times(p: ti.template(), x):
    """J x, of the inertia J and a vector x in b."""
    y = ti.Vector([p.Jx * x[0], p.Jy * x[1], p.Jz * x[2]])
    if ti.static(not (is_nothing(p.Jxy) and is_nothing(p.Jxz) and is_nothing(p.Jyz))):
        y -= ti.Vector([p.Jxy * x[1] + p.Jxz * x[2], p.Jxy * x[0] + p.Jyz * x[2], p.Jxz * x[0] + p.Jyz * x[1]])
    return y


@ti.func
def inverse_inertia_times(p: ti.template(), x):
    """J^-1 x, of the inertia J and a vector x in b."""
    y = ti.Vector([p.inverse_00 * x[0], p.inverse_11 * x[1], p.inverse_22 * x[2]])
    if ti.static(not (is_nothing(p.inverse_01) and is_nothing(p.inverse_02) and is_nothing(p.inverse_12))):
        y += ti.Vector(
            [
                p.inverse_01 * x[1] + p.inverse_02 * x[2],
                p.inverse_01 * x[0] + p.inverse_12 * x[2],
                p.inverse_02 * x[0] + p.inverse_12 * x[1],
            ]
        )
    return y


@ti.func
def loads(craft: ti.template(), p: ti.template(), v_r, omega_b, omega, ratio):
    """Force (N) and moment (N m) in b of rotors and air, without weight and the rotors' angular momentum."""
    force, moment = rotors.rotor_loads(craft, p, v_r, omega_b, omega, ratio)
    speed = ti.sqrt(v_r.dot(v_r))
    force -= speed * ti.Vector([p.drag_0 * v_r[0], p.drag_1 * v_r[1], p.drag_2 * v_r[2]])
    return force, moment


@ti.func
def ground_ratios(craft: ti.template(), p: ti.template(), kind: ti.template(), R, v_r, omega, below):
    """Thrust of each rotor [rotor] over that in free air, over water or a deck (`below`); ones over NOTHING."""
    ratio = omega * 0.0 + 1.0
    down_b, speed2 = ti.Vector([R[2, 0], R[2, 1], R[2, 2]]), v_r[0] * v_r[0] + v_r[1] * v_r[1]
    if ti.static(kind == ground.SEA):
        h = ground.heights_over(craft, p, down_b, below)
        ratio = ground.thrust_ratios(craft, p, h, ratio, omega, speed2)
    if ti.static(kind == ground.DECK):
        h = ground.heights_over(craft, p, down_b, below[0])
        for k in ti.static(range(len(craft.rotors))):
            ratio[k] = below[1 + k]
        ratio = ground.thrust_ratios(craft, p, h, ratio, omega, speed2)
        for k in ti.static(range(len(craft.rotors))):
            upwash = 1.0 - 1.0 / ratio[k] + below[ti.static(1 + len(craft.rotors)) + k]
            ratio[k] = 1.0 / (1.0 - ti.min(upwash, ground.LARGEST))
    return ratio


@ti.func
def rigid_body(p: ti.template(), y, R, force, moment):
    """Derivative [13] of state y (conventions.py) under gravity, force (N) and moment (N m) in b; R = R_nb of y."""
    v, omega_b = velocity_of(y), rates_of(y)
    v_n = R @ v
    a = force * p.inverse_mass + GRAVITY * ti.Vector([R[2, 0], R[2, 1], R[2, 2]]) - cross(omega_b, v)
    alpha = inverse_inertia_times(p, moment - cross(omega_b, inertia_times(p, omega_b)))
    q_dot = quaternion_rate(quaternion_of(y), omega_b)
    return ti.Vector(
        [v_n[0], v_n[1], v_n[2], q_dot[0], q_dot[1], q_dot[2], q_dot[3], a[0], a[1], a[2], alpha[0], alpha[1], alpha[2]]
    )


@ti.func
def derivative(craft: ti.template(), p: ti.template(), kind: ti.template(), y, R, v_r, omega, rate, below, tau):
    """Derivative [13] of state y with attitude R, which moves with v_r (m/s, b) through the air.

    omega and rate are the rotors' speeds and their rates [rotor]; below describes what is below (ground.py); tau (6) is
    the load from outside.
    """
    omega_b = rates_of(y)
    ratio = ground_ratios(craft, p, kind, R, v_r, omega, below)
    force, moment = loads(craft, p, v_r, omega_b, omega, ratio)
    if ti.static(not is_nothing(p.J_r)):
        moment += rotors.spin_moment(craft, p, omega_b, omega, rate)
    force += ti.Vector([tau[0], tau[1], tau[2]])
    moment += ti.Vector([tau[3], tau[4], tau[5]])
    return rigid_body(p, y, R, force, moment)


@ti.func
def rk4(craft: ti.template(), p: ti.template(), kind: ti.template(), y, omega, command, below, tau, dt: ti.template()):
    """State and rotor speeds [rotor] (rad/s) in still air after a step dt (s), with the load tau and the command held.

    kind, below: what is below the centre of gravity at the beginning of the step (ground.py).
    """
    left = rotors.lag_left(craft, p, omega, command)
    away, start = omega - command, y
    k, new, speed = 0.0 * y, y, omega
    for stage in range(4):  # a loop, not four copies: compiled in a quarter of the time
        ahead = ti.select(stage == 0, 0.0, ti.select(stage == 3, dt, 0.5 * dt))
        weight = ti.select(stage == 0 or stage == 3, dt / 6.0, dt / 3.0)
        if stage == 1 or stage == 3:
            away *= left
        speed = command + away
        at = start + ahead * k
        rate = rotors.acceleration(craft, p, speed, command)
        there = ground.lowered(kind, below, start[2] - at[2])
        k = derivative(craft, p, kind, at, attitude_of(at), velocity_of(at), speed, rate, there, tau)
        new += weight * k
    # one Newton step of 1/|q| suffices: |q| - 1 is as small as the method's error per step
    norm2 = new[3] * new[3] + new[4] * new[4] + new[5] * new[5] + new[6] * new[6]
    for c in ti.static(range(3, 7)):
        new[c] *= 1.5 - 0.5 * norm2
    return new, speed


@ti.kernel
def derivatives(
    craft: ti.template(), kind: ti.template(), state: array2, omega: array2, wind: array2, load: array2, out: array2
):
    """Write derivatives [n, 13] of states [n, 13], with the vehicle file's numbers and rotors held at omega [n, rotor]
    (rad/s).

    `kind` (ground.py) says what is below: calm water or nothing.
    """
    for n in range(state.shape[0]):
        y = taken2(state, n, STATE_SIZE)
        speed = taken2(omega, n, ti.static(len(craft.rotors)))
        tau = taken2(load, n, 6)
        R = attitude_of(y)
        v_r = velocity_of(y) - R.transpose() @ taken2(wind, n, 3)
        d = derivative(craft, ti.static(nominal_numbers(craft)), kind, y, R, v_r, speed, 0.0 * speed, -y[2], tau)
        for k in ti.static(range(STATE_SIZE)):
            out[n, k] = d[k]


def rhs(craft: MultirotorParams, state, omega) -> np.ndarray:
    """Derivative [n, 13] float64 of states [n, 13] in still air, far from ground; rotors at omega [n, rotor], rad/s."""
    state, omega = (np.ascontiguousarray(x, dtype=np.float64) for x in (state, omega))
    out, none = np.empty_like(state), np.zeros((len(state), 6))
    derivatives(craft, False, state, omega, none, none, out)
    return out


def shaft_power(craft: MultirotorParams, omega: np.ndarray) -> float:
    """Shaft power (W) of rotors at speeds omega [rotor] (rad/s)."""
    return float(sum(mount.gain * craft.rotor.k_m * w**3 for mount, w in zip(craft.rotors, omega, strict=True)))


def induced_velocity(craft: MultirotorParams) -> float:
    """Velocity (m/s) of the air through the rotors' discs in hover, by momentum theory."""
    area = math.pi * craft.rotor.radius**2 * len(craft.rotors)
    return math.sqrt(craft.physical.mass * GRAVITY / (2 * craft.physical.rho * area))
