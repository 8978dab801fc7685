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
from taichi_sim.uav.multirotor import airframe
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


def shaft_power(craft: MultirotorParams, omega: np.ndarray) -> float:
    """Shaft power (W) of rotors at speeds omega [rotor] (rad/s)."""
    return float(sum(mount.gain * craft.rotor.k_m * w**3 for mount, w in zip(craft.rotors, omega, strict=True)))


def induced_velocity(craft: MultirotorParams) -> float:
    """Velocity (m/s) of the air through the rotors' discs in hover, by momentum theory."""
    area = math.pi * craft.rotor.radius**2 * len(craft.rotors)
    weight = allocation(craft).weight  # pyright: ignore[reportArgumentType]
    return math.sqrt(weight / (2 * craft.physical.rho * area))
