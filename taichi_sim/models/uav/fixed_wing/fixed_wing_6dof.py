"""`fixed_wing_6dof`: a team of Beard-McLain aircraft (airframe.py) in wind, with actuators and an autopilot.

One kernel launch per control step loads each aircraft's state once, makes RK4 substeps on local values, and stores the
state once. The autopilot runs at its own rate (uav/autopilot_rate.py). Deflections, at their mean, and the air's
velocity (in
n: local_air.py) are held over a substep. The substep is made in the frame of the air, so a steady wind is exact.
Halving the substep removes three quarters of the error (test_order.py).

Functions outside the class take the model as `m`, whose gains, limits and actions are compiled in.
"""

# Kernels are another language inside Python syntax.
# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false, reportInvalidTypeForm=false

import math
from collections.abc import Mapping

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.fleet import Fleet
from taichi_sim.kernels import abreast, lanes
from taichi_sim.kernels.abreast import group, put, some, taken, taken1, taken2
from taichi_sim.kernels.conventions import DOWN, GRAVITY
from taichi_sim.kernels.packs import AroundPack, Build, FleetPack, load_at, own_numbers
from taichi_sim.kernels.position import move, with_position
from taichi_sim.kernels.random import CLOCK, KEY, SEED
from taichi_sim.kernels.rotation import attitude_of, position_of, rates_of, store, velocity_of
from taichi_sim.models.uav import local_air
from taichi_sim.models.uav.aircraft import STALL_TIME as STALL_TIME_NAME
from taichi_sim.models.uav.aircraft import Aircraft
from taichi_sim.models.uav.autopilot_rate import sampling
from taichi_sim.models.uav.fixed_wing import actuators, autopilot
from taichi_sim.models.uav.fixed_wing.airframe import aerodynamic_force, air_data, rk4, with_velocity
from taichi_sim.models.uav.fixed_wing.airframe_arrays import derivatives, stall_angles
from taichi_sim.models.uav.fixed_wing.autopilot import ACTION_NAMES, AutopilotParams
from taichi_sim.models.uav.fixed_wing.gains import gains, limits
from taichi_sim.models.uav.fixed_wing.params import VARYING, FixedWingNumbers, FixedWingParams, aircraft_numbers
from taichi_sim.models.uav.fixed_wing.trim import air_readings, largest_stable_dt, trim, trimmed
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.vehicle import Limits, Number, UnstableStepError

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


@ti.func
def demands(m: ti.template(), action, Va):
    """`autopilot.demands` of the actions [action]; zeros if the actions are deflections."""
    asked = ti.Vector([Va * 0.0] * 9)
    if ti.static(m.actions != "surfaces"):
        turn, boost = action[1], action[2]
        asked = autopilot.demands(m.gains, m.autopilot_limits, m.protected, turn, boost, Va)
    return asked


@ti.func
def commands(m: ti.template(), action, asked, R, y, met, pilot):
    """Commanded deflections (4), and the autopilot's state (integral of the throttle, height that is held).

    R is the attitude; y the state relative to the air, which moves with `met` (NED, m/s); asked = demands(..); pilot
    the autopilot's state before.
    """
    v_air, omega = velocity_of(y), rates_of(y)
    zero = 0.0 * y[0]
    command, state = ti.Vector([zero, zero, zero, zero]), pilot
    air = autopilot.flight(m.gains, R, v_air)
    if ti.static(m.actions == "surfaces"):
        command = deflections(m, action)
    else:
        sin_gamma = action[0] * m.autopilot_limits.sin_pitch
        if ti.static(m.actions == "altitude"):
            climb = action[0] * m.autopilot_limits.climb
            state[1] += m.sampled.interval * climb
            climb += m.gains.height * (state[1] + y[2])
            rising = -(R[2, 0] * v_air[0] + R[2, 1] * v_air[1] + R[2, 2] * v_air[2] + met[2])
            sin_gamma = autopilot.climb_to_fly(m.gains, m.autopilot_limits, climb, rising) * air[1]
        sine = autopilot.sine_of_pitch(m.gains, m.autopilot_limits, m.protected, air[0], asked[4], sin_gamma)
        surfaces = autopilot.surfaces(m.gains, asked, air, R, omega, sine)
        engine = autopilot.throttle(m.gains, asked, air[0], sine - asked[4], pilot[0], m.sampled.interval)
        state[0] = engine[1]
        command = ti.Vector([surfaces[0], surfaces[1], surfaces[2], engine[0]])
    if ti.static(m.protected):
        alpha = v_air[2] * air[1]
        command[0] = autopilot.protected_elevator(
            m.gains, m.autopilot_limits, command[0], air[0], air[2], alpha, omega[1]
        )
    return command, state


@ti.func
def deflections(m: ti.template(), action):
    """Deflections that the actions command directly.

    Each goes from its lower limit at -1 through its value in cruise at 0 to its upper limit at 1, linear on either
    side.
    """
    command = ti.Vector([action[0], action[1], action[2], action[3]])
    for k in ti.static(range(4)):
        neutral, lower, upper = ti.static(m.neutral[k], m.p.actuators.lower[k], m.p.actuators.upper[k])
        up, down = ti.max(command[k], 0.0), ti.min(command[k], 0.0)
        command[k] = neutral + up * ti.static(upper - neutral) + down * ti.static(neutral - lower)
    return command


@ti.data_oriented
class FixedWing6DOF(Aircraft):
    """Steps a team of aircraft in place; `AUX` lists its auxiliary state.

    Controllers know the nominal aircraft: trim, gains, limits and stall angles are those of `design`, even where an
    aircraft's own parameters differ.

    Attributes:
        action_names: names of the actions: (pitch, yaw, boost) by default (autopilot.py). Actions that are deflections
            go from the lower limit at -1 through the value in cruise at 0 to the upper limit at 1, linear on either
            side.
        cruise: the trim at cruising airspeed.
        neutral: the controls of `cruise`.
        stall_angles: angles of attack of the inverted and the upright stall, rad.
        gains, autopilot_limits: those of the autopilot.
        sampled: when it reads its instruments.
        draws: draws of turbulence in a control step.
    """

    Params = FixedWingParams
    control_names = ("elevator", "aileron", "rudder", "throttle")  # rad, and a fraction of full throttle
    aux_names, aux_size = AUX, len(AUX)
    varying = VARYING
    signals = SIGNALS
    air = WIND_NAMES

    def __init__(self, params: FixedWingParams, dt: float, substeps: int, design: FixedWingParams | None = None):
        """Take the parameters `params`, the step dt (s) and the substeps of a control step.

        `design` is the nominal aircraft, for which trim and autopilot are computed; default `params`. A model with
        other `params` then flies like an aircraft of `design` whose parameters `Fleet.set_numbers` has changed.
        """
        super().__init__(params, dt, substeps)
        self.p, plan = params, design or params
        self.cruise = trim(plan, plan.envelope.airspeed)
        self.neutral = tuple(float(x) for x in self.cruise.controls)
        limit = largest_stable_dt(plan, self.cruise)
        self.longest_step = limit.dt
        if dt > limit.dt:
            raise UnstableStepError(f"dt = {dt} s: {limit.reason}; the largest stable dt is {limit.dt:.3g} s")
        self.stall_angles = stall_angles(plan)
        pilot = plan.autopilot or AutopilotParams()
        self.protected = plan.autopilot is not None and pilot.protection
        self.actions = "surfaces" if plan.autopilot is None else pilot.actions
        self.action_names, self.free_step = ACTION_NAMES[self.actions], self.actions == "surfaces"
        self.autopilot_limits = limits(plan, pilot)
        self.gains = gains(plan, self.cruise, self.autopilot_limits, 1.0 / pilot.rate_hz)
        held = self.actions == "surfaces" and not self.protected  # the same command throughout a control step
        self.sampled = sampling(0.0 if held else pilot.rate_hz, dt, substeps)
        self.draws = local_air.draws(dt * substeps)

    @property
    def limits(self) -> Limits:
        """Airspeeds at boost -1, 0, 1, and the turning radius at cruise in the steepest bank."""
        radius = self.cruise.airspeed**2 / (GRAVITY * self.autopilot_limits.tan_bank)
        return Limits(self.autopilot_limits.speeds, radius)

    def power(self, fleet: Fleet) -> Tensor | None:
        """Propulsive power [env, vehicle], thrust times airspeed, W.

        Air and propeller are those of the vehicle file, times `gain` where that varies.
        """
        Va, delta = fleet.reading("airspeed").contiguous(), fleet.reading("throttle").contiguous()
        out = torch.empty_like(Va)
        actuators.propeller_power(out, Va, delta, self.p.propeller, self.constants.rho)
        if fleet.varied:
            return out * fleet.vary.get("propeller.gain", self.p.propeller.gain)
        return out * self.p.propeller.gain

    @property
    def airframe(self) -> tuple[float, bool]:
        """Mean chord (m), and whether there is a tail. An aircraft without rudder counts as a flying wing."""
        return self.p.physical.c, self.p.lateral.has_rudder

    def own(self, values: Mapping[str, Number]) -> FixedWingNumbers:
        """The numbers of the kernel for `values`, by the keys of `varying`."""
        return aircraft_numbers(self.p, values, self.dt)

    # -- for controllers --------------------------------------------------------------------------------------------

    def action(self, controls: Tensor) -> Tensor:
        """Actions [.., 4] that command `controls` [.., 4]: elevator, aileron, rudder (rad), throttle."""
        neutral, lower, upper = (
            torch.tensor(x, dtype=torch.float64, device=controls.device)
            for x in (self.neutral, self.p.actuators.lower, self.p.actuators.upper)
        )
        away = controls.double() - neutral
        return (away / torch.where(away > 0, upper - neutral, neutral - lower)).to(controls.dtype)

    def turn(self, course_error: Tensor, speed) -> Tensor:
        """The `yaw` action that corrects a course error (rad, wanted minus actual) at a ground speed (m/s).

        chi_dot = g tan(phi) / V_g. The same holds for a heading error and the airspeed, if a rudder keeps the sideslip
        small.
        """
        error = torch.remainder(course_error + math.pi, 2 * math.pi) - math.pi
        return (self.gains.course / (GRAVITY * self.autopilot_limits.tan_bank) * speed * error).clamp(-1.0, 1.0)

    def climb(self, height_error: Tensor, airspeed) -> Tensor:
        """The `pitch` action that corrects a height error (m, wanted minus actual) at an airspeed (m/s)."""
        m = self.autopilot_limits
        most = min(m.climb / m.speeds[1], m.sin_pitch)
        return (self.gains.height * height_error / airspeed).clamp(-most, most) / m.sin_pitch

    # -- beginning -------------------------------------------------------------------------------------------------

    def settle(self, state: Tensor, surface: Tensor, around: Surroundings) -> Tensor:
        """States in steady level flight at cruising airspeed in the mean wind, at positions and headings of `state`."""
        return trimmed(state, self.cruise, around)

    def reset_aux(self, aux: Tensor, state: Tensor, around: Surroundings) -> None:
        """Set deflections to cruise, instruments to the mean wind, and the height to hold to the present one.

        The first step draws the turbulence.
        """
        aux.zero_()
        wind = local_air.wind_at(state, around)
        aux[..., DEFLECTIONS : DEFLECTIONS + 4] = torch.tensor(self.neutral, dtype=aux.dtype, device=aux.device)
        aux[..., READINGS : READINGS + 3] = air_readings(state, wind)
        aux[..., WIND : WIND + 3] = wind
        aux[..., LOAD_FACTOR] = 1.0
        aux[..., HEIGHT_DEMAND] = -state[..., DOWN]

    # -- moving ----------------------------------------------------------------------------------------------------

    def build(self, fleet: Fleet, around: Surroundings) -> Build:
        """What the kernel is compiled for: the kind of air. The sea does not matter."""
        air = local_air.local_air(around.air, uneven=around.turbulence is not None)
        return Build(varied=fleet.varied, loaded=fleet.loaded, air=air, width=lanes.width())

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance one control step."""
        with abreast.vectors():
            fleet.launch(self._step, fleet.pack, around.pack, self.build(fleet, around))

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13]; the current has no effect."""
        out = torch.empty_like(state)
        derivatives(self.p, state, controls, wind, load, out)
        return out

    @ti.kernel
    def _step(self, fleet: FleetPack, around: AroundPack, build: ti.template()):
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for g in range((fleet.state.shape[0] * fleet.state.shape[1] + build.width - 1) // build.width):
            e, i = group(build.width, g * build.width, fleet.state.shape[0], fleet.state.shape[1])
            self.advance(own_numbers(self, build, fleet.numbers, e, i), build, fleet, around, e, i)

    @ti.func
    def advance(self, p: ti.template(), build: ti.template(), fleet: ti.template(), around: ti.template(), e, i):
        """Advance vehicle i of environment e by one control step: load its state, step it, store it.

        e and i may be those of a group (abreast.py).
        """
        clock, seed, env = around.count[CLOCK], around.count[SEED], taken1(around.count, e, KEY)
        y, delta, eddies, pilot = self.stored(fleet, e, i)
        tau = load_at(build, fleet.load, e, i)
        time, wind_10 = taken(fleet.aux, e, i, TIME, 1)[0], taken2(around.wind, e, 3)
        action = taken(fleet.action, e, i, 0, ti.static(len(self.action_names)))
        begins = time == 0.0
        if some(begins):
            drawn = local_air.initial_turbulence(build.air, seed, clock, self.draws, env, i)
            eddies = ti.select(begins, drawn, eddies)
        shear, W20 = around.air[0], local_air.wind_at_20_feet(build.air, around, wind_10, e)
        v_mean = attitude_of(y) @ velocity_of(y) - local_air.mean_wind(build.air, wind_10, shear, y)
        apart = p.dt * ti.static(self.substeps / self.draws)
        f = local_air.turbulence_filter(build.air, v_mean.norm(), -y[2], W20, apart)
        gust = local_air.turbulence_now(build.air, eddies, f)
        last, met = gust, local_air.velocity_at(build.air, wind_10, shear, gust, v_mean, y, time)
        y = with_velocity(y, velocity_of(y) - attitude_of(y).transpose() @ met)
        start, way, rate = position_of(y), 0.0 * met, 0.0 * y
        asked, command = demands(self, action, velocity_of(y).norm()), 0.0 * delta
        for n in range(self.substeps):
            R = attitude_of(y)
            if n % ti.static(self.sampled.every) == 0:
                now, air = y, met
                if ti.static(not build.air.steady):
                    air = local_air.velocity_at(build.air, wind_10, shear, gust, v_mean, y, time)
                    now = with_velocity(y, velocity_of(y) + R.transpose() @ (met - air))
                if ti.static(self.sampled.ahead > 0.0):
                    now += ti.static(self.sampled.ahead) * rate
                command, pilot = commands(self, action, asked, attitude_of(now), now, air, pilot)
            delta, held = actuators.advance(self.p.actuators, p, delta, command)
            if ti.static(not build.air.steady):
                mean, eddies, last, gust = local_air.turbulence_over(
                    build.air, self.substeps, self.draws, n, eddies, last, gust, f, seed, clock, env, i
                )
                middle = position_of(y) + (0.5 * p.dt) * (R @ velocity_of(y) + met)
                new = local_air.velocity_at(build.air, wind_10, shear, mean, v_mean, middle, time + 0.5 * p.dt)
                y = with_velocity(y, velocity_of(y) + R.transpose() @ (met - new))
                met = new
            before = with_position(y, 0.0 * way)
            y = rk4(self.p, p, before, held, tau, p.dt)
            if ti.static(self.sampled.ahead > 0.0):
                rate = (1.0 / p.dt) * (with_position(y, position_of(y) + p.dt * met) - before)
            way += position_of(y) + p.dt * met
            y = with_position(y, start + way)
            time += p.dt
        if ti.static(not build.air.steady):
            new = local_air.velocity_at(build.air, wind_10, shear, gust, v_mean, y, time)
            y = with_velocity(y, velocity_of(y) + attitude_of(y).transpose() @ (met - new))
            met = new
        self.save(p, fleet, e, i, start, way, y, met, delta)
        put(fleet.aux, e, i, TIME, [time, eddies[0], eddies[1], eddies[2], eddies[3], eddies[4], pilot[0], pilot[1]])

    @ti.func
    def stored(self, fleet: ti.template(), e, i):
        """State (13), deflections (4), turbulence (5) and the autopilot's state (2) of vehicle i of environment e."""
        y, delta = taken(fleet.state, e, i, 0, 13), taken(fleet.aux, e, i, DEFLECTIONS, 4)
        return y, delta, taken(fleet.aux, e, i, TURBULENCE, 5), taken(fleet.aux, e, i, INTEGRAL, 2)

    @ti.func
    def save(self, p: ti.template(), fleet: ti.template(), e, i, start, way, y, met, delta):
        """Store state y, `way` from `start` and relative to the air that moves with `met`, with its derived values and
        instruments.
        """
        R = attitude_of(y)
        readings = self.readings(p, y, delta)
        v = velocity_of(y) + R.transpose() @ met
        store(fleet.derived, e, i, R, R @ v)
        move(fleet, e, i, start, way, [y[3], y[4], y[5], y[6], v[0], v[1], v[2], y[10], y[11], y[12]])
        stalled = (readings[1] > self.stall_angles[1]) | (readings[1] < self.stall_angles[0])
        stall = taken(fleet.aux, e, i, STALL_TIME, 1)[0] + p.dt * ti.static(float(self.substeps))
        put(fleet.aux, e, i, DEFLECTIONS, [delta[0], delta[1], delta[2], delta[3]])
        put(fleet.aux, e, i, READINGS, [readings[0], readings[1], readings[2], readings[3]])
        put(fleet.aux, e, i, WIND, [met[0], met[1], met[2], ti.select(stalled, stall, 0.0)])

    @ti.func
    def readings(self, p: ti.template(), y, delta):
        """Airspeed (m/s), alpha, beta (rad) and load factor of a state y relative to the air."""
        air = air_data(velocity_of(y))
        force = aerodynamic_force(self.p, p, air, rates_of(y), delta)
        return ti.Vector([air[0], air[1], air[2], -force[2] * p.inverse_mass / GRAVITY])
