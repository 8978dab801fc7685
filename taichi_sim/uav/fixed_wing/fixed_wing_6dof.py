"""`fixed_wing_6dof`: a team of Beard-McLain aircraft (fixed_wing.py) in wind, with actuators and an autopilot.

One kernel launch per control step: each aircraft's state is loaded once, goes through RK4 substeps on local values,
and is stored once. Deflections and the air's velocity (in n: local_air.py) are held over a substep, which is made in
the frame of the air: so a steady wind is exact, the motion relative to the air is that in still air.
"""

import math

import taichi as ti
import torch

from taichi_sim.air import Wind
from taichi_sim.config import ConfigError
from taichi_sim.conventions import GRAVITY, VELOCITY
from taichi_sim.kinematics import store
from taichi_sim.surroundings import Surroundings
from taichi_sim.uav.fixed_wing import actuators, autopilot, local_air
from taichi_sim.uav.fixed_wing.airframe import FixedWingParams, aerodynamic_force, air_data
from taichi_sim.uav.fixed_wing.autopilot import ACTION_NAMES, AutopilotParams
from taichi_sim.uav.fixed_wing.equations import stall_angles
from taichi_sim.uav.fixed_wing.gains import gains, limits
from taichi_sim.uav.fixed_wing.modes import largest_stable_dt
from taichi_sim.uav.fixed_wing.motion import attitude, rk4, velocity, with_velocity
from taichi_sim.uav.fixed_wing.start import air_readings, trimmed
from taichi_sim.uav.fixed_wing.trim import trim

AUX = (
    ("elevator", "aileron", "rudder", "throttle")
    + ("airspeed", "alpha", "beta", "load_factor", "wind_north", "wind_east", "wind_down", "stall_time", "time")
    + ("turbulence_u", "turbulence_v1", "turbulence_v2", "turbulence_w1", "turbulence_w2")
    + ("throttle_integral", "height_demand")
)
READINGS, WIND, STALL_TIME, TIME, TURBULENCE, PILOT = 4, 8, 11, 12, 13, 18  # first columns of each


@ti.data_oriented
class FixedWing6DOF:
    """Steps a team of aircraft in place.

    Auxiliary state [env, vehicle, 20], named by `aux_names`: deflections of the actuators (rad; throttle 0 to 1); as
    of the last step, airspeed (m/s), angles of attack and sideslip (rad), load factor n_z (lift upward and normal to
    the nose over weight, 1), velocity of the air met (NED, m/s), and how long the wing has been stalled (s; 0 if it is
    not); time since the start (s); states of the turbulence; the autopilot's integral and the height it holds (m).

    Attributes:
        action_names: what is commanded: (pitch, yaw, boost) by default (autopilot.py).
        speed_range: airspeeds (m/s) at boost -1, 0, 1. min_turn_radius: m, at cruise in the steepest bank.
        gains, limits: of the autopilot.
    """

    team = "uav"
    aux_names = AUX
    aux_size = len(aux_names)
    signals = {  # plots of a recording: unit and columns of aux_names
        "airspeed": ("m/s", ("airspeed",)),
        "air angles": ("rad", ("alpha", "beta")),
        "load factor": ("", ("load_factor",)),
        "deflections": ("rad", ("elevator", "aileron", "rudder")),
        "throttle": ("", ("throttle",)),
        "air met": ("m/s", ("wind_north", "wind_east", "wind_down")),
    }
    air = ("wind_north", "wind_east", "wind_down")  # what a recording draws as wind
    Params = FixedWingParams

    def __init__(self, params: FixedWingParams, dt: float, substeps: int):
        """Bake the numbers of `params`, the step dt (s) and the substeps of a control step into the kernel.

        Raises:
            ConfigError: if the aircraft cannot trim at its cruising airspeed, its autopilot is asked for what the
                aircraft cannot fly, or dt is too long for its modes.
        """
        self.params = self.p = params
        self.dt, self.substeps = dt, substeps
        self.cruise = trim(params, params.envelope.airspeed)
        self.neutral = tuple(float(x) for x in self.cruise.controls)
        limit = largest_stable_dt(params, self.cruise)
        if dt > limit.dt:
            raise ConfigError(f"dt = {dt} s: {limit.reason}; the largest stable dt is {limit.dt:.3g} s")
        self.stall_angles = stall_angles(params)
        pilot = params.autopilot or AutopilotParams()
        self.protected = params.autopilot is not None and pilot.protection
        self.actions = "surfaces" if params.autopilot is None else pilot.actions
        self.action_names = ACTION_NAMES[self.actions]
        self.limits = limits(params, pilot)
        self.gains = gains(params, self.cruise, self.limits, dt)
        self.speed_range = self.limits.speeds
        self.min_turn_radius = self.cruise.airspeed**2 / (GRAVITY * self.limits.tan_bank)

    @property
    def airframe(self) -> tuple[float, bool]:
        """What a recording draws: mean chord (m), and whether there is a tail: a flying wing is one without rudder."""
        return self.p.physical.c, self.p.lateral.has_rudder

    def step(self, team, action: torch.Tensor, around: Surroundings) -> None:
        """Advance one control step. `action` [env, vehicle, 3] in [-1, 1] are the autopilot's demands (autopilot.py).
        If the actions are the surfaces, [env, vehicle, 4]: each deflection from its lower limit by its value in cruise
        at 0 to its upper limit, linear on either side.
        """
        air = local_air.local_air(around.air)
        shear, w20, w20_factor = local_air.wind_numbers(around.air)
        count = _as_i32(around.clock), _as_i32(around.seed), around.first_env
        self._step(air, team.state, team.derived, team.aux, action, around.wind, shear, w20, w20_factor, *count)

    def action(self, controls: torch.Tensor) -> torch.Tensor:
        """Actions [.., 4] that command `controls` [.., 4]: elevator, aileron, rudder (rad), throttle."""
        neutral, lower, upper = (
            torch.tensor(x, dtype=torch.float64) for x in (self.neutral, self.p.actuators.lower, self.p.actuators.upper)
        )
        away = controls.double() - neutral
        return (away / torch.where(away > 0, upper - neutral, neutral - lower)).to(controls.dtype)

    def turn(self, course_error: torch.Tensor, speed) -> torch.Tensor:
        """The `yaw` action that takes an error of the course (rad, wanted less actual) away, at a ground speed (m/s):
        chi_dot = g tan(phi) / V_g. Or of the heading, at an airspeed, where a rudder keeps the nose from swinging.
        """
        error = torch.remainder(course_error + math.pi, 2 * math.pi) - math.pi
        return (self.gains.course / (GRAVITY * self.limits.tan_bank) * speed * error).clamp(-1.0, 1.0)

    def climb(self, height_error: torch.Tensor, airspeed) -> torch.Tensor:
        """The `pitch` action that takes a height error (m, wanted less actual) away, at an airspeed (m/s)."""
        most = min(self.limits.climb / self.limits.speeds[1], self.limits.sin_pitch)
        sine = (self.gains.height * height_error / airspeed).clamp(-most, most)
        return sine / self.limits.sin_pitch

    def prepare(self, state: torch.Tensor, wind: torch.Tensor, air: Wind | None = None) -> torch.Tensor:
        """Placed states [n, vehicle, 13] in steady flight: level, at cruising airspeed in the mean `wind` [n, 3] (NED,
        m/s, 10 m above the sea, with the profile of `air`), heading as placed; position is kept.
        """
        return trimmed(state, self.cruise, wind, air)

    def measure_air(self, aux: torch.Tensor, state: torch.Tensor, wind: torch.Tensor) -> None:
        """Write what the instruments show before the first step in a mean wind [.., 3] (NED, m/s) where they are."""
        aux[..., READINGS : READINGS + 3] = air_readings(state, wind)
        aux[..., WIND : WIND + 3] = wind

    def reset_aux(self, aux: torch.Tensor, state: torch.Tensor) -> None:
        """Auxiliary state [.., 20] of vehicles put at `state` [.., 13]: deflections of cruise, still air, this height
        held. The turbulence around them is drawn in their first step.
        """
        aux.zero_()
        aux[..., :READINGS] = torch.tensor(self.neutral, dtype=aux.dtype, device=aux.device)
        self.measure_air(aux, state, torch.zeros_like(state[..., :3]))
        aux[..., 7] = 1.0
        aux[..., PILOT + 1] = -state[..., 2]

    @ti.kernel
    def _step(
        self,
        air: ti.template(),
        state: ti.types.ndarray(ndim=3),
        derived: ti.types.ndarray(ndim=3),
        aux: ti.types.ndarray(ndim=3),
        action: ti.types.ndarray(ndim=3),
        wind: ti.types.ndarray(ndim=2),
        shear: float,
        w20: float,
        w20_factor: float,
        clock: int,
        seed: int,
        first_env: int,
    ):
        for e, i in ti.ndrange(state.shape[0], state.shape[1]):
            y, delta, gust, pilot = self.load(state, aux, e, i)
            time, wind_10 = aux[e, i, TIME], ti.Vector([wind[e, 0], wind[e, 1], wind[e, 2]])
            if time == 0.0:
                gust = local_air.initial_turbulence(air, seed, clock, self.substeps, first_env + e, i)
            W20 = w20 + w20_factor * ti.sqrt(wind_10[0] * wind_10[0] + wind_10[1] * wind_10[1])
            v_mean = attitude(y) @ velocity(y) - local_air.mean_wind(air, wind_10, shear, y)
            f = local_air.turbulence_filter(air, v_mean.norm(), -y[2], W20, self.dt)
            met = local_air.velocity_at(air, wind_10, shear, gust, f, v_mean, y, time)
            y = with_velocity(y, velocity(y) - attitude(y).transpose() @ met)
            asked = self.demands(action, e, i, velocity(y).norm())
            for n in range(self.substeps):
                R = attitude(y)
                command, pilot = self.commands(action, e, i, asked, R, y, met, pilot)
                delta, held = actuators.advance(self.p.actuators, self.dt, delta, command)
                if ti.static(air.gusty):
                    ahead = local_air.gust_ahead(air, y, R @ velocity(y) + met, time, self.dt)
                    y, met = with_velocity(y, velocity(y) - R.transpose() @ ahead), met + ahead
                y = rk4(self.p, y, held, self.dt)
                for k in ti.static(range(3)):
                    y[k] += self.dt * met[k]
                time += self.dt
                if ti.static(not air.steady):
                    count = clock * ti.static(self.substeps + 1) + n
                    gust = local_air.turbulence_step(air, gust, f, seed, count, first_env + e, i)
                    new = local_air.velocity_at(air, wind_10, shear, gust, f, v_mean, y, time)
                    y = with_velocity(y, velocity(y) + attitude(y).transpose() @ (met - new))
                    met = new
            self.save(state, derived, aux, e, i, y, met, delta)
            for k in ti.static(range(5)):
                aux[e, i, TURBULENCE + k] = gust[k]
            aux[e, i, TIME], aux[e, i, PILOT], aux[e, i, PILOT + 1] = time, pilot[0], pilot[1]

    @ti.func
    def load(self, state: ti.template(), aux: ti.template(), e, i):
        """State (13), deflections (4), turbulence (5) and the autopilot's state (2) of vehicle i of environment e."""
        y = ti.Vector([state[e, i, k] for k in ti.static(range(13))])
        delta = ti.Vector([aux[e, i, k] for k in ti.static(range(4))])
        gust = ti.Vector([aux[e, i, TURBULENCE + k] for k in ti.static(range(5))])
        return y, delta, gust, ti.Vector([aux[e, i, PILOT], aux[e, i, PILOT + 1]])

    @ti.func
    def save(self, state: ti.template(), derived: ti.template(), aux: ti.template(), e, i, y, met, delta):
        """Store the state y, whose velocity is relative to the air that moves with `met`, and all that is read off."""
        R = attitude(y)
        readings = self.readings(y, delta)
        v = velocity(y) + R.transpose() @ met
        store(derived, e, i, R, R @ v)
        for k in ti.static(range(13)):
            state[e, i, k] = y[k]
        for k in ti.static(range(3)):
            state[e, i, VELOCITY.start + k] = v[k]
            aux[e, i, WIND + k] = met[k]
        for k in ti.static(range(4)):
            aux[e, i, k], aux[e, i, READINGS + k] = delta[k], readings[k]
        stalled = readings[1] > self.stall_angles[1] or readings[1] < self.stall_angles[0]
        aux[e, i, STALL_TIME] = ti.select(stalled, aux[e, i, STALL_TIME] + self.dt * self.substeps, 0.0)

    @ti.func
    def demands(self, action: ti.template(), e, i, Va):
        """`autopilot.demands` of vehicle i of environment e; nothing if its surfaces are commanded."""
        asked = ti.Vector([Va * 0.0] * 9)
        if ti.static(self.actions != "surfaces"):
            asked = autopilot.demands(self.gains, self.limits, self.protected, action[e, i, 1], action[e, i, 2], Va)
        return asked

    @ti.func
    def commands(self, action: ti.template(), e, i, asked, R, y, met, pilot):
        """Commanded deflections, and the autopilot's own state, at attitude R and the state y relative to the air."""
        v_air, omega = velocity(y), ti.Vector([y[10], y[11], y[12]])
        command, state = ti.Vector([0.0, 0.0, 0.0, 0.0]), pilot
        air = autopilot.flight(self.gains, R, v_air)
        if ti.static(self.actions == "surfaces"):
            command = self.deflections(action, e, i)
        else:
            sin_gamma = action[e, i, 0] * self.limits.sin_pitch
            if ti.static(self.actions == "altitude"):
                climb = action[e, i, 0] * self.limits.climb
                state[1] += self.dt * climb
                climb += self.gains.height * (state[1] + y[2])
                rising = -(R[2, 0] * v_air[0] + R[2, 1] * v_air[1] + R[2, 2] * v_air[2] + met[2])
                sin_gamma = autopilot.climb_to_fly(self.gains, self.limits, climb, rising) * air[1]
            sine = autopilot.sine_of_pitch(self.gains, self.limits, self.protected, air[0], asked[4], sin_gamma)
            surfaces = autopilot.surfaces(self.gains, asked, air, R, omega, sine)
            engine = autopilot.throttle(self.gains, asked, air[0], sine - asked[4], pilot[0], self.dt)
            state[0] = engine[1]
            command = ti.Vector([surfaces[0], surfaces[1], surfaces[2], engine[0]])
        if ti.static(self.protected):
            command[0] = autopilot.protected_elevator(
                self.gains, self.limits, command[0], air[0], air[2], v_air[2] * air[1], omega[1]
            )
        return command, state

    @ti.func
    def deflections(self, action: ti.template(), e, i):
        """The deflections that the actions command themselves."""
        command = ti.Vector([action[e, i, 0], action[e, i, 1], action[e, i, 2], action[e, i, 3]])
        for k in ti.static(range(4)):
            neutral, lower, upper = ti.static(self.neutral[k], self.p.actuators.lower[k], self.p.actuators.upper[k])
            up, down = ti.max(command[k], 0.0), ti.min(command[k], 0.0)
            command[k] = neutral + up * ti.static(upper - neutral) + down * ti.static(neutral - lower)
        return command

    @ti.func
    def readings(self, y, delta):
        """Airspeed (m/s), alpha, beta (rad), load factor of a state y relative to the air."""
        air = air_data(velocity(y))
        omega = ti.Vector([y[10], y[11], y[12]])
        force = aerodynamic_force(self.p.longitudinal, self.p.lateral, self.p.physical, air, omega, delta)
        return ti.Vector([air[0], air[1], air[2], -force[2] * ti.static(1.0 / (self.p.physical.mass * GRAVITY))])


def _as_i32(x: int) -> int:
    """x modulo 2^32, between -2^31 and 2^31: what random numbers make of it is the same."""
    return (x + 2**31) % 2**32 - 2**31
