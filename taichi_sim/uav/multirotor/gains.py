"""The controller's gains, from the aircraft's own model: its rotors' lag and the step.

Each loop is closed around the one before. An integrator behind an inner loop of lag T has the damping zeta with the
gain 1 / (4 zeta^2 T): rates behind the rotors, attitude behind rates, velocity behind attitude. The rotors' lag is the
mean of tau_up and tau_down, since half of them speed up while the others slow down, plus half a step, since a command
is held. Yaw and climb get fractions of the gains of attitude, because their thrust is limited: yaw by the rotors'
torque, climb by their thrust. Integrals compensate steady loads: drag of rotors above the centre of gravity, wind, a
payload.

Bandwidths are those of the linear chain with all of this in it: the frequency above which less than 1 / sqrt 2 of a
command arrives.
"""

import math
from typing import NamedTuple

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.conventions import GRAVITY
from taichi_sim.uav.multirotor.allocation import RotorAllocation
from taichi_sim.uav.multirotor.controller import CLIMB_SHARE, LEAST_LIFT, ControllerGains, Demands
from taichi_sim.uav.multirotor.params import MultirotorParams

ZETA = 0.8  # damping of every loop: overshoot of 1.5 %
INTEGRAL = 8.0  # square of a loop's gain over the gain of its integral: costs 7 deg of phase at crossover
FREQUENCIES = np.geomspace(1e-2, 1e3, 20001)  # rad/s, grid for the bandwidths
HALF_POWER = 1 / math.sqrt(2)


class Bandwidths(NamedTuple):
    """Bandwidths of the closed loops, rad/s."""

    rate: float  # roll and pitch
    yaw_rate: float
    attitude: float
    velocity: float
    climb: float


def lag(craft: MultirotorParams, dt: float) -> float:
    """Time from a command to thrust, s: the rotors' lag and half a step dt (s)."""
    return 0.5 * (craft.rotor.tau_up + craft.rotor.tau_down + dt)


def lead(craft: MultirotorParams, a: RotorAllocation) -> float:
    """Time constant (s) by which the rotors' inertia leads the yaw moment of their drag, in hover: J_r / (2 k_m omega).

    A rotor that speeds up turns the airframe at once.
    """
    return craft.rotor.J_r / (2 * craft.rotor.k_m * sum(a.hover) / len(a.hover))


def gains(craft: MultirotorParams, dt: float) -> ControllerGains:
    """Gains of the controller of the nominal aircraft, for commands every dt (s)."""
    behind = 1 / (4 * ZETA**2)
    rate = behind / lag(craft, dt)
    attitude = behind * rate
    velocity = behind * attitude
    return ControllerGains(
        rate=rate,
        rate_integral=rate**2 / INTEGRAL,
        yaw_rate=attitude,
        yaw_rate_integral=attitude**2 / INTEGRAL,
        attitude=attitude,
        heading=velocity,
        velocity=velocity,
        velocity_integral=velocity**2 / INTEGRAL,
        climb=attitude,
        climb_integral=attitude**2 / INTEGRAL,
    )


def demands(craft: MultirotorParams, a: RotorAllocation) -> Demands:
    """Demands of actions of 1.

    Raises:
        ConfigError: for demands beyond the rotors or the envelope.
    """
    c, most = craft.control, CLIMB_SHARE * a.thrust_to_weight
    if c.speed > craft.envelope.max_airspeed:
        raise ConfigError(
            f"control.speed = {c.speed:g}: must not be above envelope.max_airspeed = {craft.envelope.max_airspeed:g}"
        )
    if most <= 1:
        raise ConfigError(
            f"rotors: thrust to weight is {a.thrust_to_weight:.3g}: a controller needs more than {1 / CLIMB_SHARE:.3g}"
        )
    return Demands(
        speed=c.speed,
        climb=c.climb,
        descent=c.descent,
        yaw_rate=math.radians(c.yaw_rate_deg),
        rate=math.radians(c.max_rate_deg),
        tan_tilt=math.tan(math.radians(c.max_tilt_deg)),
        most=most * GRAVITY,
        least=LEAST_LIFT * GRAVITY,
    )


def bandwidths(g: ControllerGains, T: float, z: float) -> Bandwidths:
    """Bandwidths of the loops with gains g, behind the lag T (s), with the lead z (s) in yaw."""
    s = 1j * FREQUENCIES

    def closed(open_loop: np.ndarray) -> np.ndarray:
        return open_loop / (1 + open_loop)

    def end(loop: np.ndarray) -> float:
        return float(FREQUENCIES[np.argmax(np.abs(loop) < HALF_POWER)])

    rate = closed((g.rate + g.rate_integral / s) / (s * (1 + T * s)))
    yaw = closed((g.yaw_rate + g.yaw_rate_integral / s) * (1 + z * s) / (s * (1 + T * s)))
    attitude = closed(g.attitude / s * rate)
    velocity = closed((g.velocity + g.velocity_integral / s) / s * attitude)
    climb = closed((g.climb + g.climb_integral / s) / (s * (1 + T * s)))
    return Bandwidths(*(end(loop) for loop in (rate, yaw, attitude, velocity, climb)))
