"""A multirotor's equations (airframe.py) over many states at once, from its vehicle file alone.

Modes and `Vehicle.rhs` are computed with them.
"""

# Kernels are another language inside Python syntax.
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false, reportGeneralTypeIssues=false

import math

import numpy as np
import taichi as ti

from taichi_sim.conventions import STATE_SIZE
from taichi_sim.kernels.abreast import taken2
from taichi_sim.kernels.rotation import attitude_of, velocity_of
from taichi_sim.kernels.runtime import array2
from taichi_sim.uav.multirotor import airframe, ground, rotors
from taichi_sim.uav.multirotor.controller import allocation
from taichi_sim.uav.multirotor.params import MultirotorParams, nominal_numbers


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
        d = airframe.derivative(
            craft, ti.static(nominal_numbers(craft)), kind, y, R, v_r, speed, 0.0 * speed, -y[2], tau
        )
        for k in ti.static(range(STATE_SIZE)):
            out[n, k] = d[k]


def rhs(craft: MultirotorParams, state, omega) -> np.ndarray:
    """Derivative [n, 13] float64 of states [n, 13] in still air, far from ground; rotors at omega [n, rotor], rad/s."""
    state, omega = (np.ascontiguousarray(x, dtype=np.float64) for x in (state, omega))
    out, none = np.empty_like(state), np.zeros((len(state), 6))
    derivatives(craft, False, state, omega, none, none, out)
    return out


@ti.kernel
def _rates(craft: ti.template(), omega: array2, command: array2, out: array2):
    for n in range(omega.shape[0]):
        speed = taken2(omega, n, ti.static(len(craft.rotors)))
        asked = taken2(command, n, ti.static(len(craft.rotors)))
        held = rotors.clipped(craft, asked, craft.rotor.omega_max)
        rate = rotors.acceleration(craft, ti.static(nominal_numbers(craft)), speed, held)
        for k in ti.static(range(len(craft.rotors))):
            out[n, k] = rate[k]


def rotor_rates(craft: MultirotorParams, omega, command) -> np.ndarray:
    """Rates [n, rotor] (rad/s^2) of rotors at omega [n, rotor] with commands `command` [n, rotor] (rad/s)."""
    omega, command = (np.ascontiguousarray(x, dtype=np.float64) for x in (omega, command))
    out = np.empty_like(omega)
    _rates(craft, omega, command, out)
    return out


@ti.kernel
def _ratios(craft: ti.template(), heights: array2, weights: array2, omega: array2, speed: array2, out: array2):
    for n in range(heights.shape[0]):
        h = taken2(heights, n, ti.static(len(craft.rotors)))
        w = taken2(weights, n, ti.static(len(craft.rotors)))
        turning = taken2(omega, n, ti.static(len(craft.rotors)))
        p = ti.static(nominal_numbers(craft))
        ratio = ground.thrust_ratios(craft, p, h, w, turning, speed[n, 0] * speed[n, 0])
        for k in ti.static(range(len(craft.rotors))):
            out[n, k] = ratio[k]


def ground_ratios(craft: MultirotorParams, heights, weights, omega, speed=0.0) -> np.ndarray:
    """Thrust over that in free air [n, rotor] of rotors at `heights` [n, rotor] (m) over a ground of `weights`
    [n, rotor].

    Weights are from 0 to 1 (ground.py); omega [n, rotor] are the speeds (rad/s), `speed` the airspeed across the axes
    (m/s).
    """
    heights = np.ascontiguousarray(np.atleast_2d(heights), dtype=np.float64)
    weights, omega = (
        np.ascontiguousarray(np.broadcast_to(x, heights.shape), dtype=np.float64) for x in (weights, omega)
    )
    fast, out = np.full((len(heights), 1), float(speed)), np.empty_like(heights)
    _ratios(craft, heights, weights, omega, fast, out)
    return out


def shaft_power(craft: MultirotorParams, omega: np.ndarray) -> float:
    """Shaft power (W) of rotors at speeds omega [rotor] (rad/s)."""
    return float(sum(mount.gain * craft.rotor.k_m * w**3 for mount, w in zip(craft.rotors, omega, strict=True)))


def induced_velocity(craft: MultirotorParams) -> float:
    """Velocity (m/s) of the air through the rotors' discs in hover, by momentum theory."""
    area = math.pi * craft.rotor.radius**2 * len(craft.rotors)
    weight = allocation(craft).weight  # pyright: ignore[reportArgumentType]
    return math.sqrt(weight / (2 * craft.physical.rho * area))
