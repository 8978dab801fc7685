"""Names of a multirotor's auxiliary state: its instruments, and what it carries from step to step."""

from taichi_sim.models.uav.multirotor.controller import Bandwidths
from taichi_sim.models.uav.multirotor.params import MultirotorParams

WIND_NAMES = ("wind_north", "wind_east", "wind_down")
OUTSIDE_TIME = "outside_time"
READINGS = (
    ("thrust", "shaft_power", "ground_effect", "airspeed", "tilt")
    + WIND_NAMES
    + (OUTSIDE_TIME, "time", "voltage", "charge")
    + ("roll_rate_wanted", "pitch_rate_wanted", "yaw_rate_wanted", "roll_rate", "pitch_rate", "yaw_rate")
    + ("north_wanted", "east_wanted", "down_wanted", "north_velocity", "east_velocity", "down_velocity")
)
"""As of the last step: thrust of all rotors (N), power from their shafts (W), mean ratio of their thrust to that in
free air, airspeed (m/s), tilt (rad), velocity of the air met (NED, m/s); how long it has been where the model does not
hold (s; 0 if it is not), time since the start (s), voltage (V) and charge (0 to 1) of the battery, zero without; body
rates wanted and actual (rad/s), velocity wanted and actual (NED, m/s), as far as the actions command them.
"""
HIDDEN = (
    ("turbulence_u", "turbulence_v1", "turbulence_v2", "turbulence_w1", "turbulence_w2")
    + ("roll_integral", "pitch_integral", "yaw_integral", "north_integral", "east_integral", "down_integral")
    + ("heading_cos", "heading_sin")
)  # fmt: skip
"""States of the turbulence, integrals of the controller (rad/s^2, m/s^2), heading that it holds."""

(THRUST, POWER, GROUND, AIRSPEED, TILT, WIND, OUTSIDE, TIME, VOLTAGE, CHARGE, RATES_WANTED, RATES, VELOCITY_WANTED,
 VELOCITY_N) = (
    READINGS.index(name)
    for name in ("thrust", "shaft_power", "ground_effect", "airspeed", "tilt", WIND_NAMES[0], OUTSIDE_TIME, "time",
                 "voltage", "charge", "roll_rate_wanted", "roll_rate", "north_wanted", "north_velocity")
)  # fmt: skip
"""Columns: single, or the first of three."""
TURBULENCE, INTEGRALS, HEADING = (
    len(READINGS) + HIDDEN.index(name) for name in ("turbulence_u", "roll_integral", "heading_cos")
)
SPEEDS = len(READINGS) + len(HIDDEN)  # the first rotor's column


def rotor_names(craft: MultirotorParams) -> tuple[str, ...]:
    """Names of the instruments that show the rotors' speeds, rad/s."""
    return tuple(f"rotor_{k + 1}" for k in range(len(craft.rotors)))


def aux_names(craft: MultirotorParams) -> tuple[str, ...]:
    """Names of all columns."""
    return (*READINGS, *HIDDEN, *rotor_names(craft))


def signals(craft: MultirotorParams, loops: Bandwidths) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Plots of a recording: title -> (unit, columns). Titles of closed loops include the bandwidth."""
    found = {
        "rotor speeds": ("rad/s", rotor_names(craft)),
        "thrust": ("N", ("thrust",)),
        "shaft power": ("W", ("shaft_power",)),
        "thrust over that in free air": ("", ("ground_effect",)),
        "airspeed": ("m/s", ("airspeed",)),
        "tilt": ("rad", ("tilt",)),
        "air met": ("m/s", WIND_NAMES),
    }
    if craft.battery is not None:
        found |= {"voltage": ("V", ("voltage",)), "charge": ("", ("charge",))}
    if craft.control.actions != "rotors":
        for axis, bandwidth in (("roll", loops.rate), ("pitch", loops.rate), ("yaw", loops.yaw_rate)):
            name = f"{axis} rate, loop of {bandwidth:.3g} rad/s"
            found[name] = ("rad/s", (f"{axis}_rate_wanted", f"{axis}_rate"))
    if craft.control.actions == "velocity":
        for axis, bandwidth in (("north", loops.velocity), ("east", loops.velocity), ("down", loops.climb)):
            name = f"{axis} velocity, loop of {bandwidth:.3g} rad/s"
            found[name] = ("m/s", (f"{axis}_wanted", f"{axis}_velocity"))
    return found
