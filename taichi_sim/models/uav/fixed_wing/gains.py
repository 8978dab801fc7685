"""The autopilot's gains, from the aircraft's own model: trims, linear model in cruise, actuators.

Each loop is closed around the one before (Beard & McLain 2012, ch. 6). With tau the servo's lag and half an interval
between commands,

- roll rate: a_phi2 / (s + a_phi1) and the servo, made critically damped by k_p;
- an integrator behind an inner loop of lag T has damping zeta with the gain 1 / (4 zeta^2 T): roll angle behind roll
  rate, course behind roll angle, height behind pitch and heave, airspeed behind pitch and throttle;
- pitch rate: k_q gives the short period the damping zeta, and compensates the servo's attenuation at that frequency;
- pitch: at frequencies below the short period elevator gives the pitch rate M_delta Z_w / omega^2 (heave lets it turn),
  so k_theta sets the crossover frequency of that loop;
- yaw rate: k_r gives the Dutch roll the damping zeta.

All gains go as 1 / V, which keeps the bandwidths of the loops. The trims are least squares, exact in cruise.
test_autopilot.py computes the damping with all loops and servos together: the least of the shipped
Aerosonde's modes is 0.33.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.errors import named
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.uav.fixed_wing.airframe_arrays import lift_curve, stall_angles
from taichi_sim.models.uav.fixed_wing.autopilot import AutopilotGains, AutopilotLimits, AutopilotParams
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.fixed_wing.trim import Trim, TrimError, linear_modes, trim
from taichi_sim.vehicle import edge

ZETA = 0.8  # damping of every loop but roll rate: overshoot of 1.5 %
PITCH_SEPARATION = 4.0  # frequency of the short period over the crossover of the pitch loop
CLIMB_GAIN = 1.0  # gain of the climb-rate loop: it halves the lag and the response to vertical gusts
STALL_SPEED_FACTOR = 1.3  # least airspeed over the stall airspeed, as in a landing approach (14 CFR 23.73, 1996)
FLOOR = 0.9  # floor of the airspeed, below which the nose goes down, over the least demand
THROTTLE_RESERVE = 0.05  # throttle left unused at the largest airspeed in level flight and in the steepest climb
ALPHA_MARGIN = 0.15  # margin to the stall's angle of attack, as a fraction of it, for overshoot
SPEEDS, CLIMBS, BANKS = 5, (-0.1, 0.1), (0.5, 1.0)  # grid of the trims: airspeeds, rad, over the largest bank
BISECTIONS = 7


def speed_range(p: FixedWingParams, pilot: AutopilotParams) -> tuple[float, float, float]:
    """Least, cruise and largest airspeed (m/s) that can be demanded."""
    stall, cruise = stall_airspeed(p), p.envelope.airspeed
    slowest = min(STALL_SPEED_FACTOR * stall, cruise)
    least = pilot.min_airspeed or -_largest(lambda x: trim(p, -x), -cruise, -slowest)
    if not stall < least <= cruise:
        raise ConfigError(
            f"autopilot.min_airspeed = {least:g}: must lie between the stall at {stall:.3g} m/s and cruise at "
            f"{cruise:g} m/s"
        )
    with named(f"autopilot.min_airspeed = {least:g}: ", ConfigError, TrimError):
        trim(p, least)
    return least, cruise, _largest(lambda V: trim(p, V), cruise, p.envelope.max_airspeed)


def stall_airspeed(p: FixedWingParams) -> float:
    """Airspeed (m/s) at which the wing's largest lift carries the weight."""
    body, C_L = p.physical, float(lift_curve(p, stall_angles(p)[1:])[0])
    return math.sqrt(2 * body.mass * GRAVITY / (body.rho * body.S * C_L))


def limits(p: FixedWingParams, pilot: AutopilotParams) -> AutopilotLimits:
    """Limits within which the autopilot keeps the aircraft."""
    bank, lon, body = math.radians(pilot.max_bank_deg), p.longitudinal, p.physical
    if 1 / math.cos(bank) > p.envelope.n_max:
        raise ConfigError(
            f"autopilot.max_bank_deg = {pilot.max_bank_deg:g}: a level turn is {1 / math.cos(bank):.3g} g, "
            f"above n_max = {p.envelope.n_max:g}"
        )
    speeds = speed_range(p, pilot)
    max_pitch = math.radians(pilot.max_pitch_deg)
    climb = _largest(lambda gamma: trim(p, speeds[1], gamma), 0.0, max_pitch)
    low, high = stall_angles(p)
    pressure = 0.5 * body.rho * speeds[1] ** 2 * body.S
    return AutopilotLimits(
        speeds=speeds,
        stall=stall_airspeed(p),
        floor=FLOOR * speeds[0],
        top=p.envelope.max_airspeed,
        tan_bank=math.tan(bank),
        sin_pitch=math.sin(max_pitch),
        climb=speeds[1] * math.sin(climb),
        alpha_low=(1 - ALPHA_MARGIN) * low,
        alpha_high=(1 - ALPHA_MARGIN) * high,
        alpha_zero_lift=-lon.C_L_0 / lon.C_L_alpha,
        alpha_per_n=body.mass * GRAVITY / (pressure * lon.C_L_alpha),
        elevator_zero=-lon.C_m_0 / lon.C_m_delta_e,
        elevator_per_alpha=-lon.C_m_alpha / lon.C_m_delta_e,
        n_low=p.envelope.n_min,
        n_high=p.envelope.n_max,
    )


def _largest(fly: Callable[[float], Trim], low: float, high: float) -> float:
    """The largest number between `low` and `high` for which `fly` finds a trim that leaves the throttle its reserve."""

    def possible(x: float) -> bool:
        try:
            return fly(x).throttle <= 1 - THROTTLE_RESERVE
        except TrimError:
            return False

    return edge(low, high, possible, BISECTIONS)


def behind(lag: float) -> float:
    """Gain (1/s) of an integrator behind a loop of this lag (s)."""
    return 1 / (4 * ZETA**2 * lag)


def gains(p: FixedWingParams, cruise: Trim, m: AutopilotLimits, interval: float) -> AutopilotGains:
    """Gains of an autopilot that commands every `interval` (s), from the linear model in `cruise` and the trims."""
    model, V = linear_modes(p, cruise), cruise.airspeed
    tau, motor = p.actuators.time_constant + interval / 2, p.actuators.throttle_time_constant + interval / 2

    a1, a2 = -model.A_lat[1, 1], model.B_lat[1, 0]
    roll_rate = max((1 + tau * a1) ** 2 / (4 * tau) - a1, 0.0) / a2
    damped = a1 + a2 * roll_rate
    roll = behind((1 + tau * a1) / damped)

    A, M_delta = model.A_lon, model.B_lon[2, 0]
    Z, stiffness = -A[1, 1], A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    if stiffness <= 0:
        raise ConfigError(
            f"the aircraft is unstable in pitch at {V:g} m/s, and the autopilot needs one that is stable: "
            f"C_m_alpha = {p.longitudinal.C_m_alpha:g} and C_m_q = {p.longitudinal.C_m_q:g}"
        )
    omega = math.sqrt(stiffness)
    added = max(2 * ZETA * omega + A[1, 1] + A[2, 2], 0.0)
    pitch_rate = added * (1 + (tau * omega) ** 2) / M_delta
    pitch = omega / PITCH_SEPARATION
    plant = M_delta * Z / (omega**2 + M_delta * pitch_rate * Z)

    yaw_rate = 0.0
    if p.lateral.has_rudder and "dutch_roll" in model.modes:
        mode = model.modes["dutch_roll"]
        wanted = max(2 * (ZETA - mode.damping) * mode.frequency, 0.0)
        yaw_rate = wanted * (1 + (tau * mode.frequency) ** 2) / model.B_lat[2, 1]

    speed = behind(motor + 1 / pitch)
    a_V1, a_V2 = -A[0, 0], model.B_lon[0, 1]
    loops = {
        "airspeed": V,
        "roll": roll * damped / a2,
        "roll_rate": roll_rate,
        "pitch": pitch / plant,
        "pitch_rate": pitch_rate,
        "yaw_rate": yaw_rate,
        "throttle_airspeed": max(2 * ZETA * speed - a_V1, 0.0) / a_V2,
        "throttle_integral": speed**2 / a_V2,
        "climb": CLIMB_GAIN,
        "height": behind((1 / pitch + 1 / Z) / (1 + CLIMB_GAIN)),
        "course": behind(1 / roll),
        "pitch_airspeed": speed / GRAVITY,
    }
    numbers: dict[str, Any] = {name: float(value) for name, value in loops.items()}
    return AutopilotGains(**_fits([cruise, *_trims(p, m)], V), **numbers)


def _trims(p: FixedWingParams, m: AutopilotLimits) -> Iterator[Trim]:
    """Steady flights within the limits, without those that need more than full throttle."""
    for V in np.linspace(m.speeds[0], m.speeds[2], SPEEDS):
        turns = [GRAVITY / V * part * m.tan_bank * side for part in BANKS for side in (-1, 1)]
        flights = [(0.0, 0.0), *((gamma, 0.0) for gamma in CLIMBS), *((0.0, rate) for rate in turns)]
        for gamma, rate in flights:
            try:
                yield trim(p, float(V), gamma, turn_rate=rate)
            except TrimError:
                continue


def _fits(trims: list[Trim], V_0: float) -> dict[str, Any]:
    """Polynomials of `AutopilotGains`: least squares over the trims, exact for the first of them."""
    V, phi, gamma, alpha = (np.array([getattr(t, k) for t in trims]) for k in ("airspeed", "phi", "gamma", "alpha"))
    elevator, aileron, rudder, given = np.stack([t.controls for t in trims], axis=1)
    v, n, climb = V / V_0, 1 / np.cos(phi), np.sin(gamma)
    x = 1 / v**2

    def fit(values: np.ndarray, *features: np.ndarray) -> tuple[float, ...]:
        F = np.stack(features, axis=1)
        slopes = np.linalg.lstsq(F - F[0], values - values[0], rcond=None)[0]
        return float(values[0] - F[0] @ slopes), *slopes.tolist()

    return {
        "alpha": fit(alpha, x * n),
        "elevator": fit(elevator, x * n, x * (n - 1 / n)),
        "aileron": fit(aileron, x, x * np.sin(phi)),
        "rudder": fit(rudder, x, x * np.sin(phi)),
        "throttle": fit(given, v, v**2, x * (n**2 - 1), climb, climb * v),
    }
