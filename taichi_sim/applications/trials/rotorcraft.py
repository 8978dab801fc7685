"""Tables and plots of a multirotor for tools/aircraft.py: hover, trims over airspeed, modes, control loops."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.models.uav.aircraft import TrimError
from taichi_sim.models.uav.fixed_wing.trim import Mode, StableStep
from taichi_sim.models.uav.multirotor.airframe import induced_velocity, shaft_power
from taichi_sim.models.uav.multirotor.controller import allocation, bandwidths, gains, lag, lead
from taichi_sim.models.uav.multirotor.params import MultirotorParams
from taichi_sim.models.uav.multirotor.trim import MultirotorTrim, largest_stable_dt, linear_modes, trim

MODEL = "multirotor_6dof"
ROWS = 11  # airspeeds of the trim table
POINTS = 60  # points of a curve
STEP = 0.02  # s, step for which the controller's gains are printed
SECONDS_PER_MINUTE = 60.0
POWER, TILT, HOVER = "#0072B2", "#D55E00", "#22313F"


def flight(p: MultirotorParams, airspeed: float, gamma: float) -> MultirotorTrim:
    """Straight flight at an airspeed (m/s), climbing by gamma (rad), in still air, nose forward."""
    return trim(p, (airspeed * math.cos(gamma), 0.0, -airspeed * math.sin(gamma)))


def hover_table(p: MultirotorParams) -> str:
    """Text on hover: rotor speeds, induced velocity, power, figure of merit and, with a battery, endurance."""
    a, v = allocation(p), induced_velocity(p)  # pyright: ignore[reportArgumentType]
    ideal, shaft = a.weight * v, shaft_power(p, trim(p).omega)
    speeds = ", ".join(f"{w:.1f}" for w in a.hover)
    lines = [
        f"rotors at {speeds} rad/s, of {p.rotor.omega_max:g}; thrust to weight {a.thrust_to_weight:.3f}",
        f"induced velocity {v:.3f} m/s; power from the shafts {shaft:.1f} W, ideal {ideal:.1f} W: figure of merit "
        f"{ideal / shaft:.3f}",
    ]
    if p.battery is not None:
        b = p.battery
        taken = shaft / b.efficiency + b.avionics
        seconds = b.charge * b.coulombs * 0.5 * (b.full + b.empty) / taken
        lines.append(f"{taken:.1f} W from the battery: about {seconds / SECONDS_PER_MINUTE:.1f} min")
    return "\n".join(lines)


def trim_table(p: MultirotorParams, gamma: float) -> str:
    """Trims up to the largest airspeed; the line of an airspeed without trim gives the reason."""
    lines = [f"{'m/s':>7}{'roll':>9}{'pitch':>9}{'slowest':>10}{'fastest rotor':>15}{'shaft power':>13}"]
    for speed in np.linspace(0.0, p.envelope.max_airspeed, ROWS):
        try:
            t = flight(p, float(speed), gamma)
        except TrimError as error:
            lines.append(f"{speed:7.2f}   {str(error).split(': ', 1)[1]}")
            continue
        phi, theta = np.degrees([t.phi, t.theta]) + 0.0
        power = shaft_power(p, t.omega)
        lines.append(f"{speed:7.2f}{phi:9.3f}{theta:9.3f}{t.omega.min():10.2f}{t.omega.max():15.2f}{power:13.1f}")
    return "\n".join(lines)


def mode_table(modes: Iterable[Mode], step: StableStep) -> str:
    """Frequency, damping and time constant of each mode, and the largest stable step."""
    lines = [f"{'mode':14}{'rad/s':>10}{'damping':>10}{'period s':>10}{'time constant s':>17}"]
    for mode in modes:
        if mode.oscillates:
            period = 2 * math.pi / abs(mode.eigenvalues[0].imag)
            figures = f"{mode.frequency:10.4f}{mode.damping:10.4f}{period:10.3f}{mode.time_constant:17.3f}"
        else:
            figures = f"{'-':>10}{'-':>10}{'-':>10}{mode.time_constant:17.3f}"
        lines.append(f"{mode.name:14}{figures}{'  grows' if mode.time_constant < 0 else ''}")
    return "\n".join([*lines, f"largest stable step {step.dt:.4f} s: {step.reason}"])


def loop_table(p: MultirotorParams) -> str:
    """Gains and bandwidths of the controller's loops."""
    g, T = gains(p, STEP), lag(p, STEP)
    b = bandwidths(g, T, lead(p, allocation(p)))  # pyright: ignore[reportArgumentType]
    rows = (
        ("roll, pitch rate", g.rate, g.rate_integral, b.rate),
        ("yaw rate", g.yaw_rate, g.yaw_rate_integral, b.yaw_rate),
        ("attitude", g.attitude, 0.0, b.attitude),
        ("velocity", g.velocity, g.velocity_integral, b.velocity),
        ("climb", g.climb, g.climb_integral, b.climb),
    )
    lines = [f"{'loop':18}{'gain 1/s':>10}{'integral 1/s2':>15}{'bandwidth rad/s':>17}{'Hz':>8}"]
    lines += [f"{n:18}{k:10.3f}{i:15.3f}{w:17.2f}{w / (2 * math.pi):8.2f}" for n, k, i, w in rows]
    return "\n".join([*lines, f"lag from command to thrust {T:.4f} s: rotors, and half a step"])


def draw(p: MultirotorParams, gamma: float, title: str, file: Path) -> None:
    """Write a figure of power and tilt over airspeed to `file`."""
    from taichi_sim.visualisation.plotting import dress, new_figure

    flown = []
    for speed in np.linspace(0.0, p.envelope.max_airspeed, POINTS):
        try:
            t = flight(p, float(speed), gamma)
        except TrimError:
            break
        flown.append((float(speed), shaft_power(p, t.omega), math.degrees(t.tilt), t.omega.max()))
    speed, power, tilt, fastest = np.array(flown).T
    figure = new_figure(8.0, 6.0, title)
    upper, lower = figure.subplots(2, sharex=True)
    upper.plot(speed, power, color=POWER)
    upper.plot(speed[:1], power[:1], "o", color=HOVER)
    upper.annotate(f"hover {power[0]:.0f} W", (speed[0], power[0]), (6, 6), textcoords="offset points", fontsize=9)
    dress(upper, "power that the rotors take from their shafts", "", "W")
    lower.plot(speed, tilt, color=TILT, label="tilt, deg")
    lower.plot(speed, 100 * fastest / p.rotor.omega_max, color=POWER, label="fastest rotor, % of omega_max")
    dress(lower, "tilt and rotors", "airspeed, m/s", "deg, %")
    lower.legend(loc="center left", frameon=False)
    figure.savefig(file, dpi=150)


def report(name: str, p: MultirotorParams, airspeed: float | None, climb_deg: float, out: Path | None) -> str:
    """Text with all tables; the figure is written to `out`."""
    gamma, speed = math.radians(climb_deg), airspeed or 0.0
    if not math.isfinite(speed) or speed < 0:
        raise ConfigError(f"--airspeed {speed:g}: must not be negative")
    parts = [f"{name}: hover", hover_table(p)]
    parts += [f"\ntrim, climb {climb_deg:g} deg; angles in deg, rotors in rad/s, power in W", trim_table(p, gamma)]
    step = largest_stable_dt(p, flight(p, p.envelope.max_airspeed, 0.0))
    modes = mode_table(linear_modes(p, flight(p, speed, gamma)).modes, step)
    parts += [f"\nmodes at {speed:g} m/s, rotors held", modes]
    parts += [f"\nloops of the controller, stepped by {STEP:g} s", loop_table(p)]
    if out:
        draw(p, gamma, name, out)
    return "\n".join(parts)
