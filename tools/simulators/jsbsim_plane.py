"""JSBSim's c172p (a Cessna 172P; J. Berndt and others, LGPL), flown by demands of path angle, bank and airspeed.

All figures are those of the aircraft at full scale, SI, rad. The pilot is of our own, because that of JSBSim holds
altitude and heading alone. Its trims are JSBSim's, of level flight at SPEEDS, between which they are interpolated. The
elevator of a turn of load factor n is that of level flight at V / sqrt(n), where the angle of attack is the same. With
e = demand - actual:

    elevator  trim(V / sqrt n) - (V_0 / V) (k_gamma e_singamma + integral)     positive pitches down
    aileron   trim(V) + k_phi e_phi
    rudder    trim(V) + k_r (r - r_turn),  r_turn = (g / V) sin phi cos theta   positive yaws left
    throttle  trim(V_c) + k_V e_V + integral + k_climb sin gamma_c + k_n (n^2 - 1) (V_0 / V)^2

A bank whose turn needs more lift than the wing has at MARGIN times the stall's airspeed is not flown, and below FLOOR
the nose goes down, as our autopilot does it.
"""

import math
import os
from typing import Any

import numpy as np

from taichi_sim.config import ConfigError
from taichi_sim.kernels.conventions import GRAVITY

FOOT = 0.3048  # m
STEP = 1.0 / 120.0  # s, JSBSim's usual step, at most
SPEEDS = (28.0, 32.0, 36.0, 40.0, 45.0, 50.0, 55.0, 60.0, 64.0)  # m/s, of the trims: the slowest and fastest it finds
HEIGHT = 350.0  # m, of the trims; assumed
EQUATOR, MERIDIAN = 6378137.0, 6335439.3  # m, radii of curvature of WGS 84 on the equator: a, a (1 - e^2)
STALL, FLOOR, MARGIN = 26.0, 30.0, 1.2  # m/s, m/s, 1; assumed: 50 kt clean
V_0 = 48.5  # m/s, airspeed of the gains
# Gains of commands from -1 to 1 (throttle 0 to 1), assumed. Bank has the damping 0.8 behind the roll rate, which lags
# by 0.1 s: 1 / (4 0.8^2 0.1 s) over the 1.26 rad/s of full aileron. Full elevator turns the path by 0.7 rad/s.
K_GAMMA, K_GAMMA_INTEGRAL, INTEGRAL_MAX = 1.5, 0.3, 0.3  # 1, 1/s, of the command
K_PHI, K_R = 3.2, 1.0  # 1/rad, s/rad
K_V, K_V_INTEGRAL = 0.25, 0.03  # s/m, 1/m
K_CLIMB, K_N = 5.0, 0.15  # throttle per sin gamma: weight over full thrust; and for the drag of a turn
K_FLOOR = 0.05  # s/m, sine of the path angle per airspeed below FLOOR
SURFACES = (("elevator", "pitch"), ("aileron", "roll"), ("rudder", "yaw"))


def _simulation(dt: float) -> Any:
    os.environ.setdefault("JSBSIM_DEBUG", "0")  # it greets on stdout otherwise
    try:
        import jsbsim
    except ImportError as error:
        raise ConfigError(f"JSBSim cannot be imported ({error}): pip install jsbsim") from None
    there = jsbsim.FGFDMExec(None)
    there.set_debug_level(0)
    if not there.load_model("c172p"):
        raise ConfigError("jsbsim: this installation has no aircraft c172p")
    there.set_dt(dt)
    return there


def _begin(there: Any, speed: float, height: float, heading: float) -> list[float]:
    """Trim for level flight, on the equator; return the commands: elevator, aileron, rudder, throttle."""
    there["ic/lat-gc-deg"] = there["ic/long-gc-deg"] = there["ic/gamma-deg"] = 0.0
    there["ic/h-sl-ft"], there["ic/vt-fps"], there["ic/psi-true-rad"] = height / FOOT, speed / FOOT, heading
    there["fcs/mixture-cmd-norm"] = 1.0
    there.run_ic()
    there["propulsion/set-running"] = -1  # all engines
    try:
        there["simulation/do_simple_trim"] = 1  # all axes
    except Exception as error:  # jsbsim.TrimFailureError, of versions that have it
        raise ConfigError(f"jsbsim: its c172p finds no level flight at {speed:.3g} m/s ({error})") from None
    commands = [there[f"fcs/{name}-cmd-norm"] + there[f"fcs/{axis}-trim-cmd-norm"] for name, axis in SURFACES]
    for _, axis in SURFACES:
        there[f"fcs/{axis}-trim-cmd-norm"] = 0.0
    return [*commands, there["fcs/throttle-cmd-norm"]]


class Trims:
    """JSBSim's trims of level flight, shared by all aircraft."""

    def __init__(self):
        """Trim JSBSim's aircraft at each of SPEEDS."""
        there = _simulation(STEP)
        self.span: float = there["metrics/bw-ft"] * FOOT
        self.commands = np.array([_begin(there, speed, HEIGHT, 0.0) for speed in SPEEDS]).T

    def at(self, which: int, speed: float) -> float:
        """Elevator, aileron, rudder or throttle (0 to 3) at an airspeed, m/s."""
        return float(np.interp(speed, SPEEDS, self.commands[which]))


class Plane:
    """One aircraft and its pilot.

    Attributes:
        there: JSBSim's FGFDMExec.
    """

    def __init__(self, trims: Trims, dt: float, speed: float, height: float, heading: float):
        """Begin in level flight at an airspeed (m/s) and a height above the sea (m), with steps of dt (s)."""
        self.trims, self.dt, self.there = trims, dt, _simulation(dt)
        _begin(self.there, speed, height, heading)
        self.climb_integral = self.throttle_integral = 0.0

    def fly(self, sin_gamma: float, tan_bank: float, speed: float, steps: int) -> None:
        """Make steps under demands: sine of the path angle, tangent of the bank (right wing down), airspeed (m/s)."""
        for _ in range(steps):
            self._command(sin_gamma, tan_bank, speed)
            self.there.run()

    def _command(self, sin_gamma: float, tan_bank: float, wanted: float) -> None:
        there, trim, dt = self.there, self.trims.at, self.dt
        V = there["velocities/vt-fps"] * FOOT
        phi, theta, r = there["attitude/phi-rad"], there["attitude/theta-rad"], there["velocities/r-rad_sec"]
        most = math.sqrt(max((V / (MARGIN * STALL)) ** 4 - 1.0, 0.0))
        bank = math.atan(min(max(tan_bank, -most), most))
        n, slow, ratio = 1.0 / math.cos(bank), max(V, SPEEDS[0]), V_0 / max(V, SPEEDS[0])
        sin_gamma += K_FLOOR * min(V - FLOOR, 0.0)
        error = sin_gamma - there["velocities/h-dot-fps"] * FOOT / slow
        held = self.climb_integral + dt * K_GAMMA_INTEGRAL * error
        self.climb_integral = min(max(held, -INTEGRAL_MAX), INTEGRAL_MAX)
        turn = GRAVITY / slow * math.sin(phi) * math.cos(theta)
        there["fcs/elevator-cmd-norm"] = trim(0, slow / math.sqrt(n)) - ratio * (K_GAMMA * error + self.climb_integral)
        there["fcs/aileron-cmd-norm"] = trim(1, V) + K_PHI * (bank - phi)  # JSBSim clips
        there["fcs/rudder-cmd-norm"] = trim(2, V) + K_R * (r - turn)
        asked = trim(3, wanted) + K_V * (wanted - V) + self.throttle_integral
        asked += K_CLIMB * sin_gamma + K_N * (n * n - 1.0) * ratio**2
        given = min(max(asked, 0.0), 1.0)
        self.throttle_integral += dt * K_V_INTEGRAL * (wanted - V + (given - asked) / K_V)
        there["fcs/throttle-cmd-norm"] = given

    @property
    def eta(self) -> list[float]:
        """North and east of the start, down from the sea (m); roll, pitch, heading (rad)."""
        there = self.there
        up = there["position/h-sl-meters"]
        north = (MERIDIAN + up) * there["position/lat-geod-rad"]
        east = (EQUATOR + up) * there["position/long-gc-rad"]
        return [north, east, -up, *(there[f"attitude/{k}-rad"] for k in ("phi", "theta", "psi"))]

    @property
    def nu(self) -> list[float]:
        """u, v, w (m/s); p, q, r (rad/s)."""
        there = self.there
        return [
            *(there[f"velocities/{k}-fps"] * FOOT for k in "uvw"),
            *(there[f"velocities/{k}-rad_sec"] for k in "pqr"),
        ]

    @property
    def deflections(self) -> list[float]:
        """Elevator, aileron, rudder (rad; positive as ours: down, right, left), throttle."""
        there = self.there
        surfaces = [there[f"fcs/{k}-pos-rad"] for k in ("elevator", "left-aileron", "rudder")]
        return [*surfaces, there["fcs/throttle-pos-norm"]]

    @property
    def readings(self) -> list[float]:
        """Airspeed (m/s), angles of attack and sideslip (rad), load factor."""
        there = self.there
        return [there["velocities/vt-fps"] * FOOT, there["aero/alpha-rad"], there["aero/beta-rad"],
                there["accelerations/Nz"]]  # fmt: skip
