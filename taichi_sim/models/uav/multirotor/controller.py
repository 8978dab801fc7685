"""A multirotor's actions and control loops: velocity, acceleration, attitude, rates, rotors.

Actions, each in [-1, 1], by `control.actions`:

- "rotors": the speed of each rotor: omega_min, its speed in hover, omega_max at -1, 0, 1, linear on either side.
- "rates" (thrust, roll_rate, pitch_rate, yaw_rate): collective thrust is zero, the weight, the rotors' largest at
  -1, 0, 1; roll and pitch rates are fractions of max_rate_deg, the yaw rate of yaw_rate_deg.
- "velocity" (forward, right, down, yaw_rate): velocity over ground in the heading frame, which is level and turned by
  the held heading psi_c; the nose follows psi_c. Forward and right are fractions of `speed`, down of `descent` and, if
  negative, of `climb`; the rate of psi_c is a fraction of yaw_rate_deg.

The loops are in the order of PX4 and ArduPilot, with feedback alone:

    a_c = K_v (v_c - v) + I_v + turning x v_c       n, m/s^2; the last term because v_c turns with psi_c
    c = g down - a_c,  T = m c . z_b                specific thrust; its direction is the one that z_b should have
    omega_c = K_a sqrt(2 / (1 + e_z)) (-e_y, e_x, 0) + psi_dot down_b,   e = c / |c| in b
    psi_dot = psi_dot_c + K_psi sin(psi_c - psi),   psi_c integrates psi_dot_c and stays within FARTHEST of psi
    M = J (K_r (omega_c - omega) + I_r) + omega x J omega

T and M become thrusts of the rotors by the pseudo-inverse of their geometry. With the thrust f_i of rotor i at r_i, up,
(T, M_x, M_y, M_z) = B f, B_i = (1, -r_iy, r_ix, s_i k_m / k_f); f = B^+ (T, M) has the least sum of squares. The loops
know the nominal rotors, whose gains are all 1. Where the rotors cannot give everything, roll and pitch have priority:
their moments are scaled until some collective thrust fits them, the collective is moved into the range that then fits,
and yaw takes what is left.

The attitude error is that of the thrust's direction, 2 sin(angle / 2);
heading does not enter it. c is limited to max_tilt_deg, to CLIMB_SHARE of the largest thrust and at least LEAST_LIFT of
the weight, vertical before horizontal. What limits cut off decays from the integrals with the loop's own time constant.

On a deck, with at least IDLE_FROM of `descent` commanded: with one sole down all rotors together carry EASED of the
weight, with all soles down they turn at omega_min, and the integrals are zero. This is how switches in the legs would
work: loops that hold a position against the wind would topple the aircraft over the sole that is down.

Gains follow from the aircraft's own model: its rotors' lag and the controller's interval. Each loop is closed around
the one before. An integrator behind an inner loop of lag T has the damping zeta with the gain 1 / (4 zeta^2 T): rates
behind the rotors, attitude behind rates, velocity behind attitude. The rotors' lag is the mean of tau_up and tau_down,
since half of them speed up while the others slow down, plus half an interval, since a command is held. Yaw and climb
get fractions of the gains of attitude, because their thrust is limited: yaw by the rotors' torque, climb by their
thrust. Integrals compensate steady loads: drag of rotors above the centre of gravity, wind, a payload.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import taichi as ti

from taichi_sim.config import ConfigError
from taichi_sim.kernels.abreast import some
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.rigid_body import cross
from taichi_sim.models.uav.multirotor.airframe import inertia_times
from taichi_sim.models.uav.multirotor.params import MultirotorParams

AXES = ("thrust", "roll", "pitch", "yaw")
REACHED = 1e-6  # largest residual of a least-squares solution for a unit of thrust or moment
SMALLEST = 1e-9  # N: a thrust below it does not bound a scale
RATE_ACTIONS = ("thrust", "roll_rate", "pitch_rate", "yaw_rate")
VELOCITY_ACTIONS = ("forward", "right", "down", "yaw_rate")
CLIMB_SHARE = 0.9  # share of the rotors' largest thrust for following velocities; the rest is for attitude
LEAST_LIFT = 0.3  # least vertical thrust over the weight
UPRIGHT = 1e-3  # least 1 + e_z: keeps the rates of an aircraft that is upside down finite
FARTHEST = 0.5  # sine of the largest angle between the held heading and the nose
IDLE_FROM = 0.5  # fraction of `descent` from which rotors ease off on a deck; assumed
EASED = 0.5  # share of the weight that the rotors carry until all soles are down; assumed
NOSE = 1e-6  # least horizontal part of the nose's direction: straight up or down there is no heading
ZETA = 0.8  # damping of every loop: overshoot of 1.5 %
INTEGRAL = 8.0  # square of a loop's gain over the gain of its integral: costs 7 deg of phase at crossover
FREQUENCIES = np.geomspace(1e-2, 1e3, 20001)  # rad/s, grid for the bandwidths
HALF_POWER = 1 / math.sqrt(2)


class RotorAllocation(NamedTuple):
    """Thrusts f = P (T, M_x, M_y, M_z), and the thrusts and speeds in hover."""

    P: tuple[tuple[float, ...], ...]  # [rotor][4], 1 and 1/m
    weight: float  # N
    hover: tuple[float, ...]  # rotor speeds, rad/s
    thrust_to_weight: float  # of all rotors at omega_max, 1
    shares: tuple[float, float]  # least and largest share of a rotor in a collective thrust


def effectiveness(craft: MultirotorParams) -> np.ndarray:
    """B [4, rotor]: thrust and moments (about the centre of gravity, b) per unit of thrust of each rotor."""
    arms, lever = craft.arms, craft.rotor.k_m / craft.rotor.k_f
    yaw = [mount.yaw * lever for mount in craft.rotors]
    return np.stack((np.ones(len(arms)), -arms[:, 1], arms[:, 0], np.array(yaw)))


@cache
def allocation(craft: MultirotorParams) -> RotorAllocation:
    """The allocation of a vehicle file's rotors."""
    weight, rotor = craft.physical.mass * GRAVITY, craft.rotor
    greatest = rotor.k_f * rotor.omega_max**2
    ratio = sum(mount.gain for mount in craft.rotors) * greatest / weight
    if ratio <= 1:
        raise ConfigError(
            f"rotors: thrust to weight is {ratio:.3g}: all rotors at omega_max = {rotor.omega_max:g} rad/s lift "
            f"{ratio * weight:.4g} N of {weight:.4g} N; it must be above 1"
        )
    B = effectiveness(craft)
    P = np.linalg.pinv(B, rcond=1e-9)
    missing = [axis for k, axis in enumerate(AXES) if abs(B @ P[:, k] - np.eye(4)[k]).max() > REACHED]
    moments = [axis for axis in missing if axis != "thrust"]
    if missing:
        raise ConfigError(
            f"rotors: they cannot {', '.join(moments) or 'lift without turning'}: {_why(moments)}; thrust and three "
            "moments must be independent"
        )
    thrust = P[:, 0] * weight
    least = rotor.k_f * rotor.omega_min**2
    for k, f in enumerate(thrust):
        if not least <= f <= greatest or f <= 0:
            raise ConfigError(
                f"rotors.{k}: hover asks it for {f:.4g} N, and it gives {least:.4g} to {greatest:.4g} N: the centre of "
                "gravity is too far from the rotors' middle"
            )
    speeds = tuple(float(x) for x in np.sqrt(thrust / rotor.k_f))
    shares = float(P[:, 0].min()), float(P[:, 0].max())
    return RotorAllocation(tuple(tuple(float(x) for x in row) for row in P), weight, speeds, float(ratio), shares)


def _why(missing: list[str]) -> str:
    """The reason why the rotors cannot turn the aircraft about the `missing` axes, as text."""
    if missing == ["yaw"]:
        return "all turn the same way, or those of each way are balanced against roll and pitch"
    return "their hubs lie in one line, or there are too few"


@ti.func
def allocate(a: ti.template(), T, M, low, high):
    """Thrusts [rotor] (N), each from `low` to `high`, for a collective thrust T (N) and moments M (N m, b).

    Also returns the fractions of the moments that these thrusts give: about roll and pitch, and about yaw.
    """
    N = ti.static(len(a.P))
    turn, yaw = ti.Vector([T * 0.0 for _ in ti.static(range(N))]), ti.Vector([T * 0.0 for _ in ti.static(range(N))])
    for k in ti.static(range(N)):
        turn[k] = ti.static(a.P[k][1]) * M[0] + ti.static(a.P[k][2]) * M[1]
        yaw[k] = ti.static(a.P[k][3]) * M[2]
    # T between `least` and `most` fits the turn; without a turn, between `least_0` and `most_0`
    least, most = (low - turn[0]) * ti.static(1.0 / a.P[0][0]), (high - turn[0]) * ti.static(1.0 / a.P[0][0])
    for k in ti.static(range(1, N)):
        least = ti.max(least, (low - turn[k]) * ti.static(1.0 / a.P[k][0]))
        most = ti.min(most, (high - turn[k]) * ti.static(1.0 / a.P[k][0]))
    scale = T * 0.0 + 1.0
    beyond = least > most
    if some(beyond):
        free = high * ti.static(1.0 / a.shares[1]) - low * ti.static(1.0 / a.shares[0])
        free = ti.max(free, 0.0)
        # the gap between them is convex in the scale, so no larger scale fits
        scale = ti.select(beyond, free / ti.select(beyond, free + least - most, 1.0), 1.0)
        least, most = -1e30 + 0.0 * T, 1e30 + 0.0 * T
        for k in ti.static(range(N)):
            turn[k] *= scale
            least = ti.max(least, (low - turn[k]) * ti.static(1.0 / a.P[k][0]))
            most = ti.min(most, (high - turn[k]) * ti.static(1.0 / a.P[k][0]))
    collective = ti.max(ti.min(T, most), least)
    f, part = turn, T * 0.0 + 1.0
    for k in ti.static(range(N)):
        f[k] = turn[k] + ti.static(a.P[k][0]) * collective
        room = ti.select(yaw[k] > 0.0, high - f[k], f[k] - low)
        part = ti.min(part, ti.max(room, 0.0) / ti.max(ti.abs(yaw[k]), SMALLEST))
    for k in ti.static(range(N)):
        f[k] = ti.max(ti.min(f[k] + part * yaw[k], high), low)
    return f, scale, part


@dataclass(frozen=True)
class ControllerGains:
    """Gains of the loops: 1/s, those of integrals 1/s^2."""

    rate: float  # roll and pitch
    rate_integral: float
    yaw_rate: float
    yaw_rate_integral: float
    attitude: float
    heading: float
    velocity: float
    velocity_integral: float
    climb: float
    climb_integral: float


@dataclass(frozen=True)
class Demands:
    """Speeds and rates that an action of 1 commands, and limits of the commands."""

    speed: float  # m/s
    climb: float
    descent: float
    yaw_rate: float  # rad/s
    rate: float
    tan_tilt: float
    most: float  # largest specific thrust, m/s^2
    least: float  # its least vertical part, m/s^2


@ti.func
def velocity_wanted(d: ti.template(), action, c, s):
    """Velocity (m/s, n) that the actions demand, at the cosine c and sine s of the held heading."""
    forward, right, down = d.speed * action[0], d.speed * action[1], action[2]
    fall = ti.max(down, 0.0) * d.descent + ti.min(down, 0.0) * d.climb
    return ti.Vector([c * forward - s * right, s * forward + c * right, fall])


@ti.func
def specific_thrust(g: ti.template(), d: ti.template(), v_c, v, turning, integral, dt: ti.template()):
    """Specific thrust c (m/s^2, n) that brings the velocity v (m/s, n) to v_c, and the integral (m/s^2) an interval dt
    (s) later.

    v_c turns at `turning` (rad/s).
    """
    error = v_c - v
    wanted = ti.Vector(
        [
            turning * v_c[1] - g.velocity * error[0] - integral[0],
            -turning * v_c[0] - g.velocity * error[1] - integral[1],
            GRAVITY - g.climb * error[2] - integral[2],
        ]
    )
    down = ti.max(ti.min(wanted[2], d.most), d.least)
    level = ti.min(d.tan_tilt * down, ti.sqrt(ti.max(ti.static(d.most**2) - down * down, 0.0)))
    size = ti.sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1])
    share = ti.min(1.0, level / ti.max(size, 1e-9))
    c = ti.Vector([share * wanted[0], share * wanted[1], down])
    new = integral
    for k in ti.static(range(2)):
        unwind = ti.static(g.velocity_integral / g.velocity)
        new[k] += dt * (g.velocity_integral * error[k] + unwind * (wanted[k] - c[k]))
    new[2] += dt * (g.climb_integral * error[2] + ti.static(g.climb_integral / g.climb) * (wanted[2] - c[2]))
    return c, new


@ti.func
def heading_rate(g: ti.template(), R, turn, held, dt: ti.template()):
    """Heading rate (rad/s) for the commanded `turn` (rad/s), and the held heading (cosine, sine) after dt (s)."""
    inv = 1.0 / ti.sqrt(R[0, 0] * R[0, 0] + R[1, 0] * R[1, 0] + NOSE * NOSE)
    c, s = R[0, 0] * inv, R[1, 0] * inv
    ahead, beside = held[0] * c + held[1] * s, held[1] * c - held[0] * s
    kept = ti.static((1.0 - FARTHEST**2) ** 0.5)
    far = ahead < kept
    farthest = ti.select(beside < 0.0, -FARTHEST, FARTHEST)
    ahead, beside = ti.select(far, kept, ahead), ti.select(far, farthest, beside)
    rate = turn + g.heading * beside
    ahead, beside = ahead - dt * turn * beside, beside + dt * turn * ahead
    grown = 1.0 / ti.sqrt(ahead * ahead + beside * beside)
    ahead, beside = grown * ahead, grown * beside
    return rate, ti.Vector([ahead * c - beside * s, ahead * s + beside * c])


@ti.func
def rates_toward(g: ti.template(), d: ti.template(), R, c, turn):
    """Body rates (rad/s) that turn the thrust toward the direction of c (n), and the heading at `turn` (rad/s)."""
    e = (R.transpose() @ c) / ti.sqrt(c.dot(c))
    k = g.attitude * ti.sqrt(2.0 / ti.max(1.0 + e[2], UPRIGHT))
    p = ti.max(ti.min(-k * e[1], d.rate), -d.rate)
    q = ti.max(ti.min(k * e[0], d.rate), -d.rate)
    return ti.Vector([p + turn * R[2, 0], q + turn * R[2, 1], turn * R[2, 2]])


@ti.func
def rotor_thrusts(
    a: ti.template(), g: ti.template(), body: ti.template(), T, wanted, omega, integral, low, high, dt: ti.template()
):
    """Thrusts [rotor] (N) for a collective thrust T (N) and body rates `wanted` (rad/s) at rates omega (rad/s).

    Also returns the integral (rad/s^2) an interval dt (s) later. `body` are the numbers of the nominal aircraft.
    """
    error = wanted - omega
    alpha = ti.Vector([g.rate * error[0], g.rate * error[1], g.yaw_rate * error[2]]) + integral
    M = inertia_times(body, alpha) + cross(omega, inertia_times(body, omega))
    f, turned, yawed = allocate(a, T, M, low, high)
    new = integral
    for k in ti.static(range(2)):
        cut = ti.static(g.rate_integral / g.rate) * (turned - 1.0) * alpha[k]
        new[k] += dt * (g.rate_integral * error[k] + cut)
    cut = ti.static(g.yaw_rate_integral / g.yaw_rate) * (yawed - 1.0) * alpha[2]
    new[2] += dt * (g.yaw_rate_integral * error[2] + cut)
    return f, new


class Bandwidths(NamedTuple):
    """Bandwidths of the closed loops, rad/s: above them less than 1 / sqrt 2 of a command arrives.

    They are those of the linear chain with lags, lead and integrals in it.
    """

    rate: float  # roll and pitch
    yaw_rate: float
    attitude: float
    velocity: float
    climb: float


def lag(craft: MultirotorParams, dt: float) -> float:
    """Time from a command to thrust, s: the rotors' lag and half an interval dt (s) between commands."""
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
    """The speeds and rates that an action of 1 commands, and the limits of the commands."""
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
