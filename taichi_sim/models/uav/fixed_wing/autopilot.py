"""Autopilot of a fixed-wing aircraft: successive loop closure (Beard & McLain 2012, ch. 6), with envelope protection.

Attitude errors are differences of sines, so no angle is computed: sin(phi_c - phi), sin theta_c - sin theta.

    aileron   trim + s (k_phi sin(phi_c - phi) - k_p p)
    elevator  trim + s (k_theta (sin theta_c - sin theta) - k_q theta_dot)
    rudder    trim - s k_r (r - r_turn),  r_turn = (g / Va) sin phi cos theta: yaw rate of a coordinated turn
    throttle  trim + k_V (V_c - Va) + integral

s = V_0 / Va keeps the bandwidths of the loops constant over airspeed. k_theta, k_q and k_r are negative, because
positive elevator pitches down and positive rudder yaws left. The trims are fits to steady climbs and turns (gains.py).
In a turn they are those of the demanded bank, so neither height nor sideslip waits for an error. Only the throttle has
an integrator; what the throttle's limits cut off is unwound from it. In the other loops the plant integrates.

Demands are in [-1, 1]. The turn demand is lateral acceleration, g tan phi, as a fraction of that in the steepest bank;
the heading rate is (g / Va) tan phi. The airspeed demand is the least, cruise and largest airspeed at -1, 0, 1. The
third demand is either `pitch`, sin theta above that of level flight as a fraction of sin max_pitch, or `climb`, a
fraction of the largest climb rate, which also moves the height that is held.

Protection works by feedback, so its limits can be exceeded a little. Under full stick held in calm air the bank settles
some 15 % above max_bank_deg (the roll loop has no integrator), and the airspeed half a metre per second below its
floor. Stick that reverses every second takes the Aerosonde to 11.8 m/s (floor 15.3, stall 11.3), never into a stall.
The Zagi, whose ailerons without a rudder excite its Dutch roll, stalls for up to half a second in two flights of five.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from dataclasses import dataclass
from typing import Annotated, Literal

import taichi as ti
from pydantic import Field

from taichi_sim.config import Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.fast_maths import at_most

Actions = Literal["guidance", "altitude", "surfaces"]
ACTION_NAMES = {
    "guidance": ("pitch", "yaw", "boost"),
    "altitude": ("climb", "yaw", "boost"),
    "surfaces": ("elevator", "aileron", "rudder", "throttle"),
}
STALL_MARGIN = 1.2  # the bank is limited so that the largest lift stays this multiple of the lift in the turn
SLOW = 0.5  # fraction of V_0: below this airspeed the gains grow no more


class AutopilotParams(Strict):
    """`[autopilot]` of a vehicle file. Without it the actions are deflections of the surfaces, without protection."""

    actions: Actions = "guidance"
    protection: bool = True  # of angle of attack, load factor, airspeed and bank
    max_bank_deg: Annotated[float, Field(gt=0, lt=80), Plausible(5.0, 80.0, "deg")] = 45.0
    # largest difference from the pitch of level flight
    max_pitch_deg: Annotated[float, Field(gt=0, le=45), Plausible(2.0, 45.0, "deg")] = 20.0
    # readings of its instruments a second, ArduPlane's default
    rate_hz: Annotated[float, Field(gt=0, le=1000), Plausible(5.0, 1000.0, "Hz")] = 50.0
    # least airspeed demand, m/s; omitted: 1.3 times the stall airspeed
    min_airspeed: Annotated[Positive, Plausible(0.3, 1.0, "m/s", of="envelope.airspeed")] | None = None


@dataclass(frozen=True)
class AutopilotGains:
    """Gains and trims of the autopilot, all computed by gains.py. Units: surfaces and angles rad, rates rad/s, throttle
    1.

    Trims, with v = V / V_0, x = 1 / v^2 and load factor n:

        alpha             alpha[0] + alpha[1] x n
        elevator          elevator[0] + x (elevator[1] n + elevator[2] (n - 1 / n))
        aileron, rudder   c[0] + x (c[1] + c[2] sin phi)
        throttle          throttle[:4] . (1, v, v^2, x (n^2 - 1)) + sin gamma (throttle[4] + throttle[5] v)
    """

    airspeed: float  # V_0, m/s
    roll: float
    roll_rate: float
    pitch: float
    pitch_rate: float
    yaw_rate: float
    throttle_airspeed: float  # s/m
    throttle_integral: float  # 1/m
    climb: float  # change of the commanded climb rate per error of the climb rate over ground, 1
    height: float  # climb rate per height error, 1/s
    course: float  # course rate per course error, 1/s
    pitch_airspeed: float  # sine of pitch per m/s of airspeed outside its range, s/m
    alpha: tuple[float, ...]
    elevator: tuple[float, ...]
    aileron: tuple[float, ...]
    rudder: tuple[float, ...]
    throttle: tuple[float, ...]


@dataclass(frozen=True)
class AutopilotLimits:
    """Limits within which the autopilot keeps the aircraft."""

    speeds: tuple[float, float, float]  # least, cruise and largest airspeed demand, m/s
    stall: float  # airspeed at n = 1, m/s
    floor: float  # airspeed below which the nose goes down, m/s
    top: float  # airspeed above which the nose goes up, m/s
    tan_bank: float
    sin_pitch: float  # largest difference from the sine of pitch in level flight
    climb: float  # m/s
    alpha_low: float  # rad
    alpha_high: float
    alpha_zero_lift: float  # alpha at load factor n is alpha_zero_lift + alpha_per_n x n
    alpha_per_n: float
    elevator_zero: float  # elevator that holds alpha: elevator_zero + elevator_per_alpha alpha, rad
    elevator_per_alpha: float
    n_low: float
    n_high: float


@ti.func
def demands(g: ti.template(), m: ti.template(), protection: ti.template(), turn, boost, Va):
    """Demands of a control step, from its actions and the airspeed Va at its beginning (m/s).

    Returns (sin phi_c, cos phi_c, V_c, factor of x in the elevator's trim, sine of pitch in level flight, aileron,
    rudder, throttle, throttle per sin gamma).
    """
    t = turn * m.tan_bank
    if ti.static(protection):
        n = Va * Va * ti.static(1.0 / (STALL_MARGIN * m.stall**2))
        most = ti.sqrt(ti.max(n * n - 1.0, 0.0))
        t = ti.max(at_most(t, most), -most)
    n = ti.sqrt(1.0 + t * t)
    cosine = 1.0 / n
    sine = t * cosine
    low, cruise, high = ti.static(m.speeds)
    V = cruise + ti.max(boost, 0.0) * ti.static(high - cruise) + ti.min(boost, 0.0) * ti.static(cruise - low)
    v = V * ti.static(1.0 / g.airspeed)
    x = 1.0 / (v * v)
    throttle = g.throttle[0] + v * (g.throttle[1] + v * g.throttle[2]) + g.throttle[3] * x * (n * n - 1.0)
    return ti.Vector(
        [
            sine,
            cosine,
            V,
            g.elevator[1] * n + g.elevator[2] * (n - cosine),
            g.alpha[0] * cosine + g.alpha[1] * x,
            g.aileron[0] + x * (g.aileron[1] + g.aileron[2] * sine),
            g.rudder[0] + x * (g.rudder[1] + g.rudder[2] * sine),
            throttle,
            g.throttle[4] + g.throttle[5] * v,
        ]
    )


@ti.func
def flight(g: ti.template(), R, v_air):
    """(Va, 1 / Va, s, sin phi, cos phi, cos theta) of attitude R and velocity v_air relative to the air, in b."""
    Va = ti.sqrt(v_air.dot(v_air))
    inv = 1.0 / ti.max(Va, ti.static(SLOW * g.airspeed))
    cos_theta = ti.sqrt(R[2, 1] * R[2, 1] + R[2, 2] * R[2, 2] + 1e-12)
    upright = 1.0 / cos_theta
    return ti.Vector([Va, inv, g.airspeed * inv, R[2, 1] * upright, R[2, 2] * upright, cos_theta])


@ti.func
def climb_to_fly(g: ti.template(), m: ti.template(), wanted, actual):
    """Climb rate through the air (m/s) to command, within limits, for `wanted` and `actual` ones over ground."""
    climb = ti.max(ti.min(wanted, m.climb), -m.climb)
    return climb + g.climb * (climb - actual)


@ti.func
def sine_of_pitch(g: ti.template(), m: ti.template(), protection: ti.template(), Va, level, sin_gamma):
    """sin theta_c of a climb by gamma; with protection, nose down below the airspeed floor and up above the top."""
    wanted = sin_gamma
    if ti.static(protection):
        outside = ti.min(Va - m.floor, 0.0) + ti.max(Va - m.top, 0.0)
        wanted = wanted + g.pitch_airspeed * outside
    return level + ti.max(ti.min(wanted, m.sin_pitch), -m.sin_pitch)


@ti.func
def surfaces(g: ti.template(), d, air, R, omega, sin_theta_c):
    """Elevator, aileron, rudder (rad) that meet demands d at attitude R and rates omega (rad/s); air = flight(..)."""
    inv, s, sine, cosine = air[1], air[2], air[3], air[4]
    theta_dot = omega[1] * cosine - omega[2] * sine
    r_turn = GRAVITY * inv * R[2, 1]
    roll_error = d[0] * cosine - d[1] * sine
    elevator = g.elevator[0] + s * (s * d[3] + g.pitch * (sin_theta_c + R[2, 0]) - g.pitch_rate * theta_dot)
    aileron = d[5] + s * (g.roll * roll_error - g.roll_rate * omega[0])
    rudder = d[6] - s * g.yaw_rate * (omega[2] - r_turn)
    return ti.Vector([elevator, aileron, rudder])


@ti.func
def protected_elevator(g: ti.template(), m: ti.template(), elevator, Va, s, alpha, q):
    """`elevator` (rad), limited so that the angle of attack (rad) returns between the bounds that stall and load factor
    set.

    At a bound the elevator is that of static trim; beyond it there is more, and damping of q (rad/s). Below the floor
    of airspeed Va the upper bound is lower, so that the nose falls before the wing stalls.
    """
    x = s * s
    high = ti.min(m.alpha_high, m.alpha_zero_lift + ti.static(m.alpha_per_n * m.n_high) * x)
    high += g.pitch_airspeed * ti.min(Va - m.floor, 0.0)
    low = ti.max(m.alpha_low, m.alpha_zero_lift + ti.static(m.alpha_per_n * m.n_low) * x)
    damping = -g.pitch_rate * s * q
    least = m.elevator_zero + m.elevator_per_alpha * (2.0 * high - alpha) + damping
    most = m.elevator_zero + m.elevator_per_alpha * (2.0 * low - alpha) + damping
    return ti.max(ti.min(elevator, most), least)


@ti.func
def throttle(g: ti.template(), d, Va, sin_gamma, integral, dt: ti.template()):
    """(throttle, integral) one interval dt (s) later.

    What the throttle's limits cut off decays from the integral with the time constant of the loop.
    """
    error = d[2] - Va
    wanted = d[7] + d[8] * sin_gamma + g.throttle_airspeed * error + integral
    given = ti.max(ti.min(wanted, 1.0), 0.0)
    unwind = ti.static(g.throttle_integral / g.throttle_airspeed)
    return ti.Vector([given, integral + dt * (g.throttle_integral * error + unwind * (given - wanted))])
