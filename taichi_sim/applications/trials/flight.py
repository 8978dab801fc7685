"""Trials of fixed-wing aircraft and multirotors: steady flight from their trims, modes from their linear models.

All flights are through still air, so a steady wind changes only figures over ground.
"""

import math
from functools import partial

import numpy as np

from taichi_sim.applications.trials.results import Curve, Outcome, Panel, TrialError
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.models.uav.fixed_wing.airframe_arrays import flight_envelope
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.models.uav.fixed_wing.trim import Trim, TrimError, linear_modes, trim
from taichi_sim.models.uav.multirotor import trim as hovering
from taichi_sim.models.uav.multirotor.airframe import induced_velocity, shaft_power
from taichi_sim.models.uav.multirotor.controller import allocation
from taichi_sim.models.uav.multirotor.params import MultirotorParams
from taichi_sim.vehicle import edge

SPEEDS = 17  # airspeeds at which climb, glide and turn are tried
BISECTIONS = 24
STEEPEST = 1.4  # rad, steepest climb and glide tried
THRUSTLESS = 1e-3  # thrust over weight that counts as none
WIDEST, TIGHTEST = 1e4, 1.0  # m, radii of turns tried
FASTEST = 100.0  # m/s, highest speed of a multirotor tried


_last = partial(edge, halvings=BISECTIONS)


# -- fixed wings -------------------------------------------------------------------------------------------------------


def _flies(p: FixedWingParams, Va: float, gamma: float = 0.0, radius: float | None = None) -> Trim | None:
    try:
        return trim(p, Va, gamma, turn_radius=radius)
    except TrimError:
        return None


def _airspeeds(p: FixedWingParams) -> np.ndarray:
    bounds = flight_envelope(p)
    return np.linspace(1.02 * bounds.stall, bounds.top, SPEEDS)


def stall(p: FixedWingParams) -> Outcome:
    """Stall speed, at which the wing's largest lift, elevator at zero, is the weight; lowest and highest speed of
    level trims.
    """
    out, bounds = Outcome("stall", "Stall and level flight"), flight_envelope(p)
    cruise = p.envelope.airspeed
    if _flies(p, cruise) is None:
        raise TrialError(f"no level flight at its cruise of {cruise:g} m/s")
    slowest = _last(cruise, 0.5 * bounds.stall, lambda v: _flies(p, v) is not None)
    fastest = _last(cruise, bounds.top, lambda v: _flies(p, v) is not None)
    out.add("level", 0, (
        ("stall speed", bounds.stall, "m/s"), ("greatest lift coefficient", bounds.C_L_max, ""),
        ("slowest level flight", slowest, "m/s"), ("fastest level flight", fastest, "m/s"),
        ("corner speed", bounds.corner, "m/s"),
    ))  # fmt: skip
    flown = [t for v in np.linspace(slowest, fastest, SPEEDS) if (t := _flies(p, float(v)))]
    out.curves.append(Curve("level", {
        "airspeed m/s": np.array([t.airspeed for t in flown]), "throttle 1": np.array([t.throttle for t in flown]),
        "alpha deg": np.degrees([t.alpha for t in flown]),
    }))  # fmt: skip
    out.panels = (
        Panel("Throttle", "airspeed m/s", "throttle 1"),
        Panel("Angle of attack", "airspeed m/s", "alpha deg"),
    )
    return out


def climb(p: FixedWingParams) -> Outcome:
    """Best rate and steepest angle of climb: the steepest trims over airspeed."""
    out = Outcome("climb", "Climb", panels=(Panel("Rate of climb", "airspeed m/s", "climb m/s"),))
    found = [(v, _last(0.0, STEEPEST, lambda g, v=v: _flies(p, v, g) is not None))
             for v in map(float, _airspeeds(p)) if _flies(p, v)]  # fmt: skip
    if not found:
        raise TrialError("no level flight at any airspeed")
    speeds, gamma = np.array(found).T
    rate = speeds * np.sin(gamma)
    best, steep = int(rate.argmax()), int(gamma.argmax())
    out.add("climb", 0, (
        ("best rate of climb", rate[best], "m/s"), ("airspeed of best rate", speeds[best], "m/s"),
        ("steepest climb", gamma[steep], "rad"), ("airspeed of steepest climb", speeds[steep], "m/s"),
    ))  # fmt: skip
    out.curves.append(Curve("climb", {"airspeed m/s": speeds, "climb m/s": rate, "gamma rad": gamma}))
    return out


def glide(p: FixedWingParams) -> Outcome:
    """Glide without thrust, as with the propeller feathered: flattest angle and least sink over airspeed."""
    out = Outcome("glide", "Glide", panels=(Panel("Sink", "airspeed m/s", "sink m/s"),))
    found = []

    def pulls(speed: float, gamma: float) -> bool:
        t = _flies(p, speed, gamma)
        return t is not None and t.thrust > 0

    for speed in map(float, _airspeeds(p)):
        if pulls(speed, 0.0):
            edge = _last(0.0, -STEEPEST, lambda g, v=speed: pulls(v, g))
            t = _flies(p, speed, edge)
            if t is not None and abs(t.thrust) < THRUSTLESS * p.physical.mass * GRAVITY:
                found.append((speed, edge))
    if not found:
        raise TrialError("no glide: at no airspeed does a descent need no thrust")
    speeds, gamma = np.array(found).T
    sink = -speeds * np.sin(gamma)
    flat, least = int(gamma.argmax()), int(sink.argmin())
    out.add("glide", 0, (
        ("glide ratio", -1.0 / math.tan(gamma[flat]), ""), ("flattest glide", -gamma[flat], "rad"),
        ("airspeed of flattest glide", speeds[flat], "m/s"), ("least sink", sink[least], "m/s"),
        ("airspeed of least sink", speeds[least], "m/s"),
    ))  # fmt: skip
    out.curves.append(Curve("glide", {"airspeed m/s": speeds, "sink m/s": sink, "gamma rad": gamma}))
    return out


def turn(p: FixedWingParams) -> Outcome:
    """Steady level turns to the right: the tightest at each airspeed, within lift, thrust, bank and load factor."""
    out = Outcome("turn", "Level turn", panels=(Panel("Tightest radius", "airspeed m/s", "radius m"),))
    bounds, found = flight_envelope(p), []

    def allowed(speed: float, radius: float) -> bool:
        t = _flies(p, speed, 0.0, radius)
        return t is not None and 1 / math.cos(t.phi) <= bounds.n_max

    for speed in map(float, _airspeeds(p)):
        if allowed(speed, WIDEST):
            bend = _last(1 / WIDEST, 1 / TIGHTEST, lambda k, v=speed: allowed(v, 1 / k))
            found.append((speed, 1 / bend, speed * bend))
    if not found:
        raise TrialError("no level turn at any airspeed")
    speeds, radius, rate = np.array(found).T
    tight, quick = int(radius.argmin()), int(rate.argmax())
    out.add("right", 0, (
        ("tightest radius", radius[tight], "m"), ("airspeed of tightest turn", speeds[tight], "m/s"),
        ("greatest turn rate", rate[quick], "rad/s"), ("airspeed of greatest rate", speeds[quick], "m/s"),
        ("radius at cruise", float(np.interp(p.envelope.airspeed, speeds, radius)), "m"),
    ))  # fmt: skip
    out.curves.append(Curve("right", {"airspeed m/s": speeds, "radius m": radius, "rate rad/s": rate}))
    return out


def modes(p: FixedWingParams) -> Outcome:
    """Phugoid, short period and the lateral modes about level cruise, from eigenvalues."""
    out = Outcome("modes", "Natural modes at cruise")
    at = trim(p, p.envelope.airspeed)
    for name, mode in linear_modes(p, at).modes.items():
        values = [("time constant", mode.time_constant, "s")]
        if mode.oscillates:
            values += [("natural frequency", mode.frequency, "rad/s"), ("damping ratio", mode.damping, ""),
                       ("period", 2 * math.pi / abs(mode.eigenvalues[0].imag), "s")]  # fmt: skip
        out.add(name.replace("_", " "), 0, values)
    return out


# -- multirotors -------------------------------------------------------------------------------------------------------


def _hovers(p: MultirotorParams, ahead: float, climbing: float) -> hovering.MultirotorTrim | None:
    try:
        return hovering.trim(p, (ahead, 0.0, -climbing))
    except TrimError:
        return None


def hover(p: MultirotorParams) -> Outcome:
    """Hover: rotor speed, power, and endurance on a battery."""
    out, at, a = Outcome("hover", "Hover"), hovering.trim(p), allocation(p)  # pyright: ignore[reportArgumentType]
    ideal, shaft = a.weight * induced_velocity(p), shaft_power(p, at.omega)
    values = [
        ("thrust to weight", a.thrust_to_weight, ""),
        ("mean rotor speed", float(at.omega.mean()), "rad/s"),
        ("shaft power", shaft, "W"),
        ("figure of merit", ideal / shaft, ""),
    ]
    if p.battery is not None:
        b = p.battery
        taken = shaft / b.efficiency + b.avionics
        values.append(("endurance", b.charge * b.coulombs * 0.5 * (b.full + b.empty) / taken, "s"))
    out.add("hover", 0, values)
    return out


def rise(p: MultirotorParams) -> Outcome:
    """Vertical flight: the fastest climb that the rotors allow, and its power."""
    out = Outcome("climb", "Vertical climb", panels=(Panel("Power", "climb m/s", "power W"),))
    most = _last(0.0, FASTEST, lambda w: _hovers(p, 0.0, w) is not None)
    rates = np.linspace(0.0, most, SPEEDS)
    power = np.array([shaft_power(p, hovering.trim(p, (0.0, 0.0, -w)).omega) for w in rates])
    out.add("climb", 0, (("greatest rate of climb", most, "m/s"), ("power of it", power[-1], "W")))
    out.curves.append(Curve("climb", {"climb m/s": rates, "power W": power}))
    return out


def terminal(p: MultirotorParams) -> Outcome:
    """Level flight: terminal speed by the rotors and by the vehicle file, and the speeds of longest endurance and
    range.
    """
    out = Outcome("terminal", "Level flight", panels=(Panel("Power", "airspeed m/s", "power W"),))
    rotors = _last(0.0, FASTEST, lambda v: _hovers(p, v, 0.0) is not None)
    top = min(rotors, p.envelope.max_airspeed)
    speeds = np.linspace(0.0, top, 4 * SPEEDS)
    flown = [hovering.trim(p, (v, 0.0, 0.0)) for v in speeds]
    power = np.array([shaft_power(p, t.omega) for t in flown])
    per_metre = np.concatenate(([np.inf], power[1:] / speeds[1:]))
    out.add("level", 0, (
        ("terminal speed of the rotors", rotors, "m/s"), ("allowed speed", p.envelope.max_airspeed, "m/s"),
        ("tilt at the lesser", flown[-1].tilt, "rad"), ("airspeed of least power", speeds[power.argmin()], "m/s"),
        ("least power", power.min(), "W"), ("airspeed of furthest way", speeds[per_metre.argmin()], "m/s"),
        ("energy per metre of it", per_metre.min(), "J/m"),
    ))  # fmt: skip
    tilt = np.degrees([t.tilt for t in flown])
    out.curves.append(Curve("level", {"airspeed m/s": speeds, "power W": power, "tilt deg": tilt}))
    return out
