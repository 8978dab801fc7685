"""`multirotor_6dof`: a team of multirotors (airframe.py) in wind, with rotors that lag and a controller.

One kernel launch per control step loads each aircraft's state once, makes substeps on local values, and stores the
state once. The controller (controller.py) runs at its own rate (uav/autopilot_rate.py). The air's velocity
(uav/local_air.py) is held over a substep, which is made in the frame of the air, so a steady wind is exact. Rotor
speeds are exact for the command held over a substep (airframe.py). What else is held over one, is as in its middle: the
sea and the deck below, the battery's voltage.

Near a deck (contact/between_teams.py) the ground effect includes the rotors' images in it, and a substep in which a
sole may touch consists of contact steps (deck_step.py). Far from decks the results are those of a world without decks.
"""

# Kernels are another language inside Python syntax.
# pyright: reportAttributeAccessIssue=false, reportInvalidTypeForm=false, reportIndexIssue=false
# pyright: reportArgumentType=false, reportOptionalMemberAccess=false

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import taichi as ti
import torch
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import abreast, lanes
from taichi_sim.kernels.abreast import group, put, some, taken, taken1, taken2
from taichi_sim.kernels.conventions import AMPLITUDE, DOWN
from taichi_sim.kernels.lanes import is_laned, lane_of
from taichi_sim.kernels.packs import AroundPack, Build, FleetPack, TouchPack, load_at, own_numbers
from taichi_sim.kernels.position import move, with_position
from taichi_sim.kernels.random import CLOCK, KEY, SEED
from taichi_sim.kernels.rotation import UPRIGHT, attitude_of, position_of, rates_of, store, velocity_of
from taichi_sim.models.contact import deck_motion
from taichi_sim.models.contact.leg_contact import SOLE_SIZE
from taichi_sim.models.uav import local_air
from taichi_sim.models.uav.aircraft import TrimError
from taichi_sim.models.uav.autopilot_rate import sampling
from taichi_sim.models.uav.fixed_wing.airframe import atan2, with_velocity
from taichi_sim.models.uav.multirotor import controller, deck_step, ground, rotors
from taichi_sim.models.uav.multirotor import instruments as at
from taichi_sim.models.uav.multirotor.airframe import derivatives, ground_ratios, induced_velocity, rk4
from taichi_sim.models.uav.multirotor.body_mesh import body_surface
from taichi_sim.models.uav.multirotor.params import MultirotorParams, multirotor_numbers, nominal_numbers, varying_keys
from taichi_sim.models.uav.multirotor.params import gains as rotor_gains
from taichi_sim.models.uav.multirotor.trim import largest_stable_dt, trim, trimmed
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea import gerstner
from taichi_sim.vehicle import Limits, Number, UnstableStepError, Vehicle, Waters, edge

LONGEST_OUTSIDE = 3.0  # s: a longer time outside the model's validity ends the episode; assumed
NEWTON_ITERATIONS = 5  # for the point of the sea below; exact to rounding in real seas (gerstner.invert_label)
BISECTIONS = 30


@ti.data_oriented
class Multirotor6DOF(Vehicle):
    """Steps a team of multirotors in place. controller.py explains the actions, instruments.py lists the auxiliary
    state.

    Controllers know the nominal aircraft: allocation, gains and limits are those of `design`, even where an aircraft's
    own parameters differ.

    Attributes:
        allocation: that of the rotors.
        gains, demands: those of the controller.
        sampled: when it reads its instruments.
        draws: draws of turbulence in a control step.
        bandwidths: those of the control loops, rad/s.
        induced: velocity of the air through the rotors in hover, m/s.
    """

    Params = MultirotorParams
    medium = "air"
    ending_names = ("ditched", "struck", "outside_model")
    air = at.WIND_NAMES

    def __init__(self, params: MultirotorParams, dt: float, substeps: int, design: MultirotorParams | None = None):
        """Take the parameters `params`, the step dt (s) and the substeps of a control step.

        `design` is the nominal aircraft, for which the controller is computed; default `params`. A model with other
        `params` then flies like an aircraft of `design` whose parameters `Fleet.set_numbers` has changed.
        """
        super().__init__(params, dt, substeps)
        self.p = params
        self.plan = plan = design or params
        self.reach = ground.REACH * params.rotor.radius + max(params.size)
        self.legs, self.deck_reach = params.legs, self.reach
        self.interval = dt * substeps
        self.over_decks = ground.DECK if params.ground_effect else ground.NOTHING
        self.sole_numbers = SOLE_SIZE * len(params.legs.points) if params.legs else 0
        self.allocation = controller.allocation(plan)
        self.actions = plan.control.actions
        self.demands = controller.demands(plan, self.allocation)
        pilot = plan.control.rate_hz
        self.gains = controller.gains(plan, 1.0 / pilot)
        self.sampled = sampling(0.0 if self.actions == "rotors" else pilot, dt, substeps)
        self.draws = local_air.draws(self.interval)
        lag, lead = controller.lag(plan, 1.0 / pilot), controller.lead(plan, self.allocation)
        self.bandwidths = controller.bandwidths(self.gains, lag, lead)
        self.board = nominal_numbers(plan)
        self.count, self.battery = len(params.rotors), params.battery is not None
        self.control_names = at.rotor_names(plan)
        actions = {"rates": controller.RATE_ACTIONS, "velocity": controller.VELOCITY_ACTIONS}
        self.action_names = actions.get(self.actions, self.control_names)
        self.aux_names = at.aux_names(plan)
        self.aux_size = len(self.aux_names)
        self.varying = varying_keys(plan)
        self.signals = at.signals(plan, self.bandwidths)
        self.induced = induced_velocity(plan)
        limit = largest_stable_dt(plan, self._fastest())
        self.longest_step, self.free_step = limit.dt, self.actions == "rotors"
        if dt > limit.dt:
            raise UnstableStepError(f"dt = {dt} s: {limit.reason}; the largest stable dt is {limit.dt:.3g} s")
        body = params.physical
        self.contact_steps = params.legs.steps(dt, body.mass, body.cg, body.inertia) if params.legs else 1

    def _fastest(self):
        """The trim at the largest airspeed."""
        most = self.plan.envelope.max_airspeed
        steepest = math.radians(self.plan.control.max_tilt_deg)

        def possible(speed: float) -> bool:
            try:
                return trim(self.plan, (speed, 0.0, 0.0)).tilt <= steepest
            except TrimError:
                return False

        if (held := edge(0.0, most, possible, BISECTIONS)) < most:
            raise ConfigError(
                f"envelope.max_airspeed = {most:g}: the rotors hold {held:.3g} m/s at most within max_tilt_deg = "
                f"{self.plan.control.max_tilt_deg:g}"
            )
        return trim(self.plan, (most, 0.0, 0.0))

    # -- what it is ------------------------------------------------------------------------------------------------

    @property
    def limits(self) -> Limits:
        """Airspeeds in hover, in cruise and at most."""
        return Limits((0.0, self.plan.envelope.airspeed, self.plan.envelope.max_airspeed), 0.0)

    def body(self) -> tuple[np.ndarray, np.ndarray]:
        """Surface of hub, arms, rotors' discs and legs: vertices [N, 3] (m, b) and triangles [F, 3]."""
        return body_surface(self.plan)

    def power(self, fleet: Fleet) -> Tensor | None:
        """Shaft power of the rotors [env, vehicle], torque times speed, W."""
        return fleet.reading("shaft_power")

    def endings(self, fleet: Fleet, world: Waters) -> dict[str, Tensor]:
        """Endings [env, vehicle] of an episode.

        `ditched`: feet or rotors have touched the water, a crest included. `struck`: a rotor has touched a deck.
        `outside_model`: for longer than `LONGEST_OUTSIDE` the aircraft has been upside down, faster than max_airspeed,
        or sinking through its own wake (docs/multirotor.md).
        """
        upright = fleet.derived[..., UPRIGHT].abs()
        side = 0.5 * max(self.size[:2]) * torch.sqrt((1.0 - upright.square()).clamp(min=0.0))
        height = -fleet.state[..., DOWN] - self.plan.body.below * upright - side
        outside = fleet.reading(at.OUTSIDE_TIME) > LONGEST_OUTSIDE
        struck = fleet.never if fleet.touch is None else fleet.touch.struck.squeeze(-1) > 0
        ditched = height <= world.elevation_below(fleet, height)
        return {"ditched": ditched, "struck": struck, "outside_model": outside}

    def soles(self, fleet: Fleet) -> Tensor:
        """Soles of the legs from each vehicle's own centre of gravity, m, b."""
        own = fleet.own
        cg = torch.stack([torch.as_tensor(x, dtype=torch.float64) for x in (own.cg_0, own.cg_1, own.cg_2)], dim=-1)
        return super().soles(fleet).to(cg) - (cg if fleet.varied else cg.view(1, 1, 3)).unsqueeze(-2)

    def own(self, values: Mapping[str, Number]) -> Any:
        """The numbers of the kernel for `values`, by the keys of `varying`."""
        return multirotor_numbers(self.p, values, self.dt)

    def action(self, speeds: Tensor) -> Tensor:
        """Actions [.., rotor] that command the rotor `speeds` [.., rotor] (rad/s), for actions "rotors"."""
        rotor, hover = self.plan.rotor, torch.tensor(self.allocation.hover, dtype=torch.float64)
        away = speeds.double() - hover
        return (away / torch.where(away > 0, rotor.omega_max - hover, hover - rotor.omega_min)).to(speeds.dtype)

    # -- beginning -------------------------------------------------------------------------------------------------

    def settle(self, state: Tensor, surface: Tensor, around: Surroundings) -> Tensor:
        """States in steady flight in the mean wind, with positions, headings and velocities over ground of `state`."""
        return trimmed(self.plan, state, around)[0]

    def reset_aux(self, aux: Tensor, state: Tensor, around: Surroundings) -> None:
        """Set rotors and controller to steady flight at `state`."""
        aux.copy_(trimmed(self.plan, state, around)[1])

    # -- moving ----------------------------------------------------------------------------------------------------

    def build(self, fleet: Fleet, around: Surroundings) -> Build:
        """What the kernel is compiled for: the kind of air, and the sea if there is ground effect over it."""
        air = local_air.local_air(around.air, uneven=around.turbulence is not None)
        components = around.sea.shape[2] if self.p.ground_effect else 1
        decked = fleet.touch is not None
        return Build(
            components, varied=fleet.varied, loaded=fleet.loaded, air=air, decked=decked,
            width=1 if decked else lanes.width(),
        )  # fmt: skip

    def step(self, fleet: Fleet, around: Surroundings) -> None:
        """Advance one control step."""
        if fleet.touch is None:
            with abreast.vectors():
                fleet.launch(self._step, fleet.pack, around.pack, self.build(fleet, around))
        else:
            launched = fleet.pack, around.pack, fleet.touch.pack(), self.build(fleet, around)
            fleet.launch(self._step_by_decks, *launched, plain=True)  # compiles in 5 s in place of a minute

    def equations(self, state: Tensor, controls: Tensor, current: Tensor, wind: Tensor, load: Tensor) -> Tensor:
        """d(state)/dt [n, 13] with the rotors held at their speeds; the current has no effect."""
        out = torch.empty_like(state)
        derivatives(self.p, self.p.ground_effect, state, controls, wind, load, out)
        return out

    @ti.kernel
    def _step(self, fleet: FleetPack, around: AroundPack, build: ti.template()):
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for g in range((fleet.state.shape[0] * fleet.state.shape[1] + build.width - 1) // build.width):
            e, i = group(build.width, g * build.width, fleet.state.shape[0], fleet.state.shape[1])
            self.advance(own_numbers(self, build, fleet.numbers, e, i), build, fleet, around, fleet, e, i)

    @ti.kernel
    def _step_by_decks(self, fleet: FleetPack, around: AroundPack, touch: TouchPack, build: ti.template()):
        ti.loop_config(serialize=build.serial, block_dim=build.block)
        for e, i in ti.ndrange(fleet.state.shape[0], fleet.state.shape[1]):
            self.advance(own_numbers(self, build, fleet.numbers, e, i), build, fleet, around, touch, e, i)

    @ti.func
    def advance(
        self, p: ti.template(), build: ti.template(), fleet: ti.template(), around: ti.template(),
        touch: ti.template(), e, i,
    ):  # fmt: skip
        """Advance vehicle i of environment e by one control step: load its state, step it, store it.

        e and i may be those of a group (abreast.py).

        `touch` is used if the build is `decked`.
        """
        clock, seed, env = around.count[CLOCK], around.count[SEED], taken1(around.count, e, KEY)
        y, omega = taken(fleet.state, e, i, 0, 13), taken(fleet.aux, e, i, at.SPEEDS, self.count)
        eddies, held = taken(fleet.aux, e, i, at.TURBULENCE, 5), taken(fleet.aux, e, i, at.INTEGRALS, 8)
        time, charge = taken(fleet.aux, e, i, at.TIME, 1)[0], taken(fleet.aux, e, i, at.CHARGE, 1)[0]
        tau, wind_10 = load_at(build, fleet.load, e, i), taken2(around.wind, e, 3)
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
        sea, rise = self.water_below(p.dt, build, around, e, y)
        y = with_velocity(y, velocity_of(y) - attitude_of(y).transpose() @ met)
        start, still = position_of(y), velocity_of(y) * 0.0
        way, rates, toward, voltage = still, still, still, time * 0.0
        wanted, rate = omega * 0.0, y * 0.0
        sea_weight, deck_upwash = omega * 0.0 + 1.0, omega * 0.0  # of each rotor, over a deck
        body = ti.Vector([time * 0.0 for _ in ti.static(range(deck_step.BODY_SIZE))])
        soles = ti.Vector([time * 0.0 for _ in ti.static(range(max(self.sole_numbers, 1)))])
        by_deck, pressed, struck, landed, blow = 0, 0, 0, 0, time * 0.0
        if ti.static(build.decked):
            by_deck, pressed = int(touch.way[e, i, deck_motion.WHICH]), int(touch.pressing[e, i, deck_motion.PRESSED])
            for k in ti.static(range(self.sole_numbers)):
                soles[k] = touch.soles[e, i, k]
        for n in range(self.substeps):
            R = attitude_of(y)
            v_n = R @ velocity_of(y) + met
            most = time * 0.0 + self.plan.rotor.omega_max
            if ti.static(self.battery):
                voltage, current = rotors.battery_terminal(self.p.battery, charge, rotors.shaft_power(self.p, p, omega))
                most *= ti.min(voltage * ti.static(1.0 / self.p.battery.nominal), 1.0)
            if ti.static(build.decked and self.sole_numbers > 0):
                landed = deck_step.soles_down(soles, ti.static(self.sole_numbers // SOLE_SIZE))
            if n % ti.static(self.sampled.every) == 0:
                now, moving = y, v_n
                if ti.static(self.sampled.ahead > 0.0):
                    now += ti.static(self.sampled.ahead) * rate
                    moving = attitude_of(now) @ velocity_of(now) + met
                wanted, held, rates, toward = self.commanded(action, now, attitude_of(now), moving, held, most, landed)
            command = rotors.clipped(self.p, wanted, most)
            if ti.static(self.battery):  # the command, and the charge at the end, are for the load in the middle
                middle = command + (omega - command) * rotors.lag_left(self.p, p, omega, command)
                voltage, current = rotors.battery_terminal(
                    self.p.battery, charge, rotors.shaft_power(self.p, p, middle)
                )
                most = self.plan.rotor.omega_max * ti.min(voltage * ti.static(1.0 / self.p.battery.nominal), 1.0)
                command = rotors.clipped(self.p, wanted, most)
                charge = ti.max(charge - current * (p.dt / self.p.battery.coulombs), 0.0)
            if ti.static(not build.air.steady):
                mean, eddies, last, gust = local_air.turbulence_over(
                    build.air, self.substeps, self.draws, n, eddies, last, gust, f, seed, clock, env, i
                )
                place = position_of(y) + (0.5 * p.dt) * v_n
                new = local_air.velocity_at(build.air, wind_10, shear, mean, v_mean, place, time + 0.5 * p.dt)
                y = with_velocity(y, velocity_of(y) + R.transpose() @ (met - new))
                met = new
            before = with_position(y, still)
            sea += 0.5 * rise
            if ti.static(build.decked):
                flies = 1
                if by_deck > 0:
                    begun, across2 = n * ti.static(self.dt), y[7] * y[7] + y[8] * y[8]
                    then = deck_step.ahead_of(y, v_n, ti.static(0.5 * self.dt))
                    height, inside, hit = deck_step.rotors_over(
                        self.p, p, touch.way, e, i, then, begun + ti.static(0.5 * self.dt), self.interval, body
                    )
                    struck = ti.max(struck, hit)
                    if ti.static(self.p.ground_effect):
                        sea_weight, deck_upwash = deck_step.deck_ground(self.p, p, height, inside, omega, across2)
                    soon = deck_step.touches_soon(
                        self.p, p, touch.way, e, i, y, v_n, begun, self.interval, body, self.dt
                    )
                    if soon > 0 or pressed > 0:
                        flies = 0
                        below = ground.beneath(-y[2] - sea, sea_weight, deck_upwash)
                        ratio = ground_ratios(self.p, p, self.over_decks, R, velocity_of(y), omega, below)
                        y, omega, soles, body, blow = deck_step.land(
                            self.p, p, self.contact_steps, self.dt, self.interval, touch.way, e, i, y, met, omega,
                            command, tau, ratio, soles, body, begun, blow,
                        )  # fmt: skip
                        way += position_of(y)
                if flies > 0:
                    below = ground.beneath(-y[2] - sea, sea_weight, deck_upwash)
                    y, omega = rk4(self.p, p, self.over_decks, before, omega, command, below, tau, p.dt)
                    way += position_of(y) + p.dt * met
            else:
                below = -y[2] - sea
                y, omega = rk4(self.p, p, self.p.ground_effect, before, omega, command, below, tau, p.dt)
                way += position_of(y) + p.dt * met
            if ti.static(self.sampled.ahead > 0.0):
                rate = (1.0 / p.dt) * (with_position(y, still) - before)
            y = with_position(y, start + way)
            sea += 0.5 * rise
            time += p.dt
        if ti.static(not build.air.steady):
            new = local_air.velocity_at(build.air, wind_10, shear, gust, v_mean, y, time)
            y = with_velocity(y, velocity_of(y) + attitude_of(y).transpose() @ (met - new))
            met = new
        if ti.static(build.decked):
            touch.blow[e, i, 0] = blow
            if by_deck > 0:
                deck_step.remember(touch, self.interval, e, i, soles, body, struck)
            below = ground.beneath(-y[2] - sea, sea_weight, deck_upwash)
            self.save(p, self.over_decks, fleet, e, i, start, way, y, met, omega, below)
        else:
            self.save(p, self.p.ground_effect, fleet, e, i, start, way, y, met, omega, -y[2] - sea)
        put(fleet.aux, e, i, at.TIME, [time, voltage, charge, rates[0], rates[1], rates[2]])
        put(fleet.aux, e, i, at.VELOCITY_WANTED, [toward[0], toward[1], toward[2]])
        put(fleet.aux, e, i, at.TURBULENCE, [eddies[0], eddies[1], eddies[2], eddies[3], eddies[4]])
        put(fleet.aux, e, i, at.INTEGRALS, [held[0], held[1], held[2], held[3], held[4], held[5], held[6], held[7]])

    @ti.func
    def commanded(self, action, y, R, v_n, held, most, landed):
        """Rotor speeds (rad/s) that the actions command at the state y, which moves over ground with v_n (n, m/s).

        Also returns the controller's state (8: integrals, held heading) at its next reading, and the body rates (rad/s)
        and velocity (n, m/s) demanded. landed: number of soles on a deck.
        """
        dt = ti.static(self.sampled.interval)
        command = ti.Vector([y[0] * 0.0 for _ in ti.static(range(self.count))])
        omega_b, new = rates_of(y), held
        rates, toward = omega_b, v_n
        if ti.static(self.actions == "rotors"):
            for k in ti.static(range(self.count)):
                a, hover = action[k], ti.static(self.allocation.hover[k])
                up = ti.static(self.plan.rotor.omega_max) - hover
                down = hover - ti.static(self.plan.rotor.omega_min)
                command[k] = hover + ti.max(a, 0.0) * up + ti.min(a, 0.0) * down
        else:
            T = y[0] * 0.0
            if ti.static(self.actions == "rates"):
                push = action[0]
                ratio = ti.static(self.allocation.thrust_to_weight - 1.0)
                T = ti.static(self.allocation.weight) * (1.0 + ti.max(push, 0.0) * ratio + ti.min(push, 0.0))
                rates = ti.Vector(
                    [self.demands.rate * action[1], self.demands.rate * action[2], self.demands.yaw_rate * action[3]]
                )
            else:
                nose = ti.Vector([held[6], held[7]])
                toward = controller.velocity_wanted(self.demands, action, nose[0], nose[1])
                slow = ti.Vector([held[3], held[4], held[5]])
                turn = self.demands.yaw_rate * action[3]
                c, slow = controller.specific_thrust(self.gains, self.demands, toward, v_n, turn, slow, dt)
                rate, nose = controller.heading_rate(self.gains, R, turn, nose, dt)
                rates = controller.rates_toward(self.gains, self.demands, R, c, rate)
                new[6], new[7] = nose[0], nose[1]
                z = ti.Vector([R[0, 2], R[1, 2], R[2, 2]])
                T = ti.static(self.plan.physical.mass) * ti.max(c.dot(z), 0.0)
                for k in ti.static(range(3)):
                    new[3 + k] = slow[k]
            k_f = ti.static(self.plan.rotor.k_f)
            low, high = ti.static(self.plan.rotor.k_f * self.plan.rotor.omega_min**2), k_f * most * most
            fast = ti.Vector([held[0], held[1], held[2]])
            thrust, fast = controller.rotor_thrusts(
                self.allocation, self.gains, self.board, T, rates, omega_b, fast, low, high, dt
            )
            for k in ti.static(range(3)):
                new[k] = fast[k]
            for k in ti.static(range(self.count)):
                command[k] = ti.sqrt(thrust[k] * ti.static(1.0 / self.plan.rotor.k_f))
            if ti.static(self.actions == "velocity" and not is_laned(y[0])):  # groups fly far from decks
                if landed > 0 and action[2] >= controller.IDLE_FROM:
                    for k in ti.static(range(self.count)):
                        command[k] = ti.static(controller.EASED**0.5) * ti.static(self.allocation.hover[k])
                        if landed == ti.static(self.sole_numbers // SOLE_SIZE):
                            command[k] = y[0] * 0.0 + self.plan.rotor.omega_min
                    for k in ti.static(range(6)):
                        new[k] = 0.0
                    new[6], new[7] = held[6], held[7]
        return command, new, rates, toward

    @ti.func
    def water_below(self, dt: ti.template(), build: ti.template(), around: ti.template(), e, y):
        """Elevation (m, up) of the sea below y, and its rise in a substep; any value does above the ground effect."""
        if ti.static(is_laned(e)):
            now, rise = y[0] * 0.0, y[0] * 0.0
            if ti.static(self.p.ground_effect):
                v_n = attitude_of(y) @ velocity_of(y)
                for lane in range(lanes.WIDTH):
                    place = ti.Vector([y[0][lane], y[1][lane], y[2][lane]])
                    speed = ti.Vector([v_n[0][lane], v_n[1][lane]])
                    now[lane], rise[lane] = self.water_at(lane_of(dt, lane), build, around, e[lane], place, speed)
            return now, rise
        else:
            v_n = attitude_of(y) @ velocity_of(y)
            return self.water_at(dt, build, around, e, position_of(y), ti.Vector([v_n[0], v_n[1]]))

    @ti.func
    def water_at(self, dt: ti.template(), build: ti.template(), around: ti.template(), e, y, v_n):
        """`water_below` of one vehicle at y (m) that moves over ground with v_n (n, m/s)."""
        now, rise = y[0] * 0.0, y[0] * 0.0
        if ti.static(self.p.ground_effect):
            s, crest = around.env_sea[e], y[0] * 0.0
            for c in range(build.components):
                crest += around.sea[s, AMPLITUDE, c]
            if -y[2] < crest + self.reach:
                interval = dt * ti.static(float(self.substeps))
                now = self.elevation(build, around, e, s, y[0], y[1], y[0] * 0.0)
                there = ti.Vector([y[0] + interval * v_n[0], y[1] + interval * v_n[1]])
                rise = self.elevation(build, around, e, s, there[0], there[1], y[0] * 0.0 + interval) - now
                rise *= ti.static(1.0 / self.substeps)
        return now, rise

    @ti.func
    def elevation(self, build: ti.template(), around: ti.template(), e, s, north, east, time):
        """Elevation (m, up) of sea s at a point (m), `time` (s) after the beginning of the step."""
        L = gerstner.invert_label(
            around.sea, around.phase, build.components, s, e, north, east, time, NEWTON_ITERATIONS
        )
        return gerstner.elevation_at_label(around.sea, around.phase, build.components, s, e, L[0], L[1], time)

    @ti.func
    def save(
        self, p: ti.template(), kind: ti.template(), fleet: ti.template(), e, i, start, way, y, met, omega, below,
    ):  # fmt: skip
        """Store state y, `way` from `start`, with its derived values and instruments; its velocity is relative to the
        air, which moves with `met`.

        kind, below: what is below (ground.py).
        """
        R, v_r = attitude_of(y), velocity_of(y)
        v = v_r + R.transpose() @ met
        v_n = R @ v
        store(fleet.derived, e, i, R, v_n)
        ratio = ground_ratios(self.p, p, kind, R, v_r, omega, below)
        thrust, near = y[0] * 0.0, y[0] * 0.0
        gain = ti.static(rotor_gains(p, self.count))
        for k in ti.static(range(self.count)):
            thrust += p.k_f * gain[k] * omega[k] * omega[k] * ratio[k]
            near += ti.static(1.0 / self.count) * ratio[k]
            put(fleet.aux, e, i, at.SPEEDS + k, [omega[k]])
        move(fleet, e, i, start, way, [y[3], y[4], y[5], y[6], v[0], v[1], v[2], y[10], y[11], y[12]])
        airspeed, power = v_r.norm(), rotors.shaft_power(self.p, p, omega)
        tilt = atan2(ti.sqrt(R[2, 0] * R[2, 0] + R[2, 1] * R[2, 1]), R[2, 2])
        sinking = v_r[2] > self.induced
        outside = sinking | (R[2, 2] < 0.0) | (airspeed > self.plan.envelope.max_airspeed)
        since = taken(fleet.aux, e, i, at.OUTSIDE, 1)[0] + p.dt * ti.static(float(self.substeps))
        put(fleet.aux, e, i, at.THRUST, [thrust, power, near, airspeed, tilt])
        put(fleet.aux, e, i, at.WIND, [met[0], met[1], met[2], ti.select(outside, since, 0.0)])
        put(fleet.aux, e, i, at.RATES, [y[10], y[11], y[12]])
        put(fleet.aux, e, i, at.VELOCITY_N, [v_n[0], v_n[1], v_n[2]])
