"""Names of a fixed-wing aircraft's auxiliary state: its instruments, and what it carries from step to step."""

from taichi_sim.uav.aircraft import STALL_TIME as STALL_TIME_NAME

AUX = (
    ("elevator", "aileron", "rudder", "throttle")
    + ("airspeed", "alpha", "beta", "load_factor", "wind_north", "wind_east", "wind_down", STALL_TIME_NAME, "time")
    + ("turbulence_u", "turbulence_v1", "turbulence_v2", "turbulence_w1", "turbulence_w2")
    + ("throttle_integral", "height_demand")
)
"""Deflections of the actuators (rad; throttle 0 to 1); as of the last step, airspeed (m/s), angles of attack and of
sideslip (rad), load factor n_z (lift upward and normal to the nose over weight, 1), velocity of the air met (NED, m/s),
and how long the wing has been stalled (s; 0 if it is not); time since the start (s); states of the turbulence; the
autopilot's integral and the height it holds (m)."""

WIND_NAMES = ("wind_north", "wind_east", "wind_down")
DEFLECTIONS, READINGS, LOAD_FACTOR, WIND, STALL_TIME, TIME, TURBULENCE, INTEGRAL, HEIGHT_DEMAND = (
    AUX.index(name)
    for name in ("elevator", "airspeed", "load_factor", WIND_NAMES[0], STALL_TIME_NAME, "time", "turbulence_u",
                 "throttle_integral", "height_demand")
)  # fmt: skip
"""Columns of aux. DEFLECTIONS and READINGS begin 4 columns, WIND 3, TURBULENCE 5; the others are single columns."""

SIGNALS = {
    "airspeed": ("m/s", ("airspeed",)),
    "air angles": ("rad", ("alpha", "beta")),
    "load factor": ("", ("load_factor",)),
    "deflections": ("rad", ("elevator", "aileron", "rudder")),
    "throttle": ("", ("throttle",)),
    "air met": ("m/s", WIND_NAMES),
}
"""Plots of a recording: title -> (unit, columns)."""
