"""What aircraft on a circle about the vessel measure, know and observe, a kernel each; their classical controller.

The gap error of an aircraft is half the difference between the gaps ahead and behind it on the circle, rad; 0 where
no other aircraft is known. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportOptionalCall=false, reportIndexIssue=false

import math
from typing import NamedTuple, Protocol, cast

import taichi as ti
from torch import Tensor

from rl.guidance.avoidance import SlotController
from rl.guidance.controllers.fixed_wing_6dof import (
    CHANGE,
    FixedWing6DofController,
    FixedWing6DofGains,
    FlightCommand,
    velocity_through_air,
)
from rl.guidance.controllers.laws import cross, limited
from rl.guidance.knowledge import Knowledge, TeamKernel
from rl.guidance.knowledge import KnownPack as TeamPack
from rl.guidance.observations import (
    MEANINGS,
    RATE_SCALE,
    SPEED_SCALE,
    air_columns,
    columns,
    put,
    put_air,
    put_reference,
    put_squashed,
    squash,
)
from rl.guidance.targets_and_errors import COS, COURSE, EAST, NORTH, SIN, SPEED, own_frame
from rl.guidance.targets_and_errors import V as VELOCITY
from rl.missions.escort.boats import AGE_SCALE, SIGMA_SCALE
from rl.missions.escort.config import OrbitConfig
from rl.missions.escort.host import EscortHost
from rl.missions.escort.tracking import SharedTracking
from rl.perception.radio import Message
from rl.perception.sightings import Sighting
from rl.step import NOT_DUE, Due
from taichi_sim.config import Positive
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import rotation, runtime
from taichi_sim.kernels.abreast import taken, taken2
from taichi_sim.kernels.conventions import DOWN, ROLL_RATE, SURGE
from taichi_sim.kernels.packs import values_at
from taichi_sim.kernels.runtime import array1, array2, array3, array4, whole1
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF

HEARD_OF = 5.0  # s: older messages of other aircraft are ignored; assumed
LEAST_SHARE = 0.2  # of the airspeed, the least speed relative to the centre; assumed
BOATS_HEARD_OF = 20.0  # s: likewise of boats; assumed
CIRCLE_SCALE, FAR_SCALE, SLOW_SCALE = 20.0, 200.0, 2.0  # m, m, m/s, at which a squashed observation is 1/2
TWO_PI = 2 * math.pi
RADIUS, TURN, RANGE = range(3)  # columns of `numbers`: of the circle, m; 1 clockwise, else -1; of the radio, m

ErrorsPack = ti.types.argpack(distance=array2, gap_error=array2, in_range=array2)
TruePack = ti.types.argpack(state=array3, boats=array3, vessel=array2, down=array1, numbers=array1)
KnownPack = ti.types.argpack(
    target=array3, centre_velocity=array3, gap_error=array2, height_error=array2, boats=array3, farthest=array3
)
HeardPack = ti.types.argpack(state=array3, targets=array3, heard=array4, down=array1, numbers=array1)
OwnPack = ti.types.argpack(state=array3, derived=array3, aux=array3, targets=array3, signals=array3)
TracksPack = ti.types.argpack(sightings=array4, age=array2, sigma=array2, radius=array1)


class CirclingTeam(Protocol):
    """What is read, and written, of the team of aircraft (aircraft.py); tensors are [env, aircraft, ...]."""

    fleet: Fleet
    orbit: OrbitConfig
    down: Tensor  # [aircraft] height of the circles, m
    distance: Tensor
    gap_error: Tensor
    in_range: Tensor
    tracking: SharedTracking
    mission: EscortHost

    @property
    def reference_width(self) -> int:
        """Width of what a residual policy corrects."""
        ...


class CircleView(Knowledge, Protocol):
    """What aircraft know of their circle; tensors are [env, aircraft, ...]."""

    orbit: OrbitConfig
    gap_error: Tensor
    height_error: Tensor
    centre_velocity: Tensor

    @property
    def centre(self) -> Tensor:
        """Place of the vessel, [.., 2], m."""
        ...

    @property
    def boats(self) -> tuple[Tensor, Tensor]:
        """Mean place of the boats heard, distance to the farthest, m."""
        ...


class CirclingForm(NamedTuple):
    """Compile-time parameters of the kernels."""

    first: int  # number of the first aircraft among all observers
    boats: tuple[int, int]  # the first boat among them, and the first after them that is none


OBSERVED = MEANINGS | {
    "vessel": "unit vector to the vessel as known, body",
    "vessel_distance": f"m, squashed by {FAR_SCALE:g}",
    "vessel_velocity": f"along and across the tangent of the circle, m/s, squashed by {SLOW_SCALE:g}",
    "circle": f"distance outside the circle and height error, m, squashed by {CIRCLE_SCALE:g}",
    "gap": "half the difference of the gaps ahead and behind on the circle, rad, over pi",
    "view": "1 if its camera has the vessel now",
    "track_age": f"age of what is known of the vessel, s, squashed by {AGE_SCALE:g}",
    "track_sigma": f"standard deviation of its place, m, squashed by {SIGMA_SCALE:g}",
    "boats": "unit vector to the boats' middle, body; 0: none heard",
    "boats_distance": f"distance of it, and of the farthest boat from it, m, squashed by {FAR_SCALE:g}",
}
"""Terms of aircraft on a circle; see rl.guidance.observations.MEANINGS."""


class CirclingTerms(NamedTuple):
    """Compile-time parameters of the observations."""

    first: int
    signals: int
    actions: int
    residual: int  # numbers of "reference"
    air: tuple[int, ...]  # columns of `aux`: airspeed; velocity of the air, north, east, down
    speeds: tuple[float, ...]  # airspeeds: lowest, cruise, highest, m/s
    axes: int = 3
    at: tuple[int, ...] = ()  # the column in which each term begins

    @property
    def widths(self) -> dict[str, int]:
        """Width of each term, in order."""
        terms = {"velocity": 3, "down": 3, "rates": 3, "vessel": 3, "vessel_distance": 1, "vessel_velocity": 2}
        terms |= {"circle": 2, "gap": 1, "view": 1, "track_age": 1, "track_sigma": 1, "boats": 3, "boats_distance": 2}
        terms |= {"surroundings": self.signals, "previous_action": self.actions}
        if self.air:
            terms |= {"airspeed": 1, "wind": 3}
        return terms | {"reference": self.residual} if self.residual else terms


@ti.func
def on_from(own, angle, turn):
    """Angle (rad) from `own` on to `angle` in the direction of flight, in [0, 2 pi)."""
    x = turn * (angle - own)
    return x - TWO_PI * ti.floor(x / TWO_PI)


@ti.func
def between(nearest, farthest):
    """Gap error (rad) by the angles on to the nearest and the farthest other aircraft; 0 if `farthest` is -1 (none)."""
    return ti.select(farthest < 0, 0.0, 0.5 * (nearest - (TWO_PI - farthest)))


@ti.kernel
def _measure(out: ErrorsPack, true: TruePack, which: whole1, form: ti.template()):
    """Write errors from the circle about the true vessel, and the share of boats within radio range."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(true.state.shape[0], true.state.shape[1]):
        if which[e] != NOT_DUE:
            turn = true.numbers[TURN]
            place = ti.Vector([true.state[e, i, a] for a in ti.static(range(3))])
            x, y = place[0] - true.vessel[e, NORTH], place[1] - true.vessel[e, EAST]
            off, high = ti.sqrt(x * x + y * y) - true.numbers[RADIUS], place[2] - true.down[i]
            out.distance[e, i] = ti.sqrt(off * off + high * high)
            own, nearest, farthest = ti.atan2(y, x), x * 0.0 + TWO_PI, x * 0.0 - 1.0
            for j in range(true.state.shape[1]):
                if j != i:
                    to = taken(true.state, e, j, NORTH, 2) - taken2(true.vessel, e, 2)
                    angle = ti.atan2(to[1], to[0])
                    ahead = on_from(own, angle, turn)
                    nearest, farthest = ti.min(nearest, ahead), ti.max(farthest, ahead)
            out.gap_error[e, i] = between(nearest, farthest)
            if ti.static(form.boats[1] > form.boats[0]):
                near = x * 0.0
                for b in range(true.boats.shape[1]):
                    dx, dy = true.boats[e, b, NORTH] - place[0], true.boats[e, b, EAST] - place[1]
                    if ti.sqrt(dx * dx + dy * dy + place[2] * place[2]) < true.numbers[RANGE]:
                        near += 1.0
                out.in_range[e, i] = near / true.boats.shape[1]


@ti.kernel
def _listen(out: KnownPack, of: HeardPack, which: whole1, form: ti.template()):
    """Write what each aircraft knows: the vessel by its own estimate, the others by the messages that it has heard."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(of.state.shape[0], of.state.shape[1]):
        if which[e] != NOT_DUE:
            o, age, turn = ti.static(form.first) + i, of.heard.shape[3] - 1, of.numbers[TURN]
            north, east = of.targets[e, o, NORTH], of.targets[e, o, EAST]
            for a in ti.static(range(2)):
                out.centre_velocity[e, i, a] = of.targets[e, o, SPEED] * of.targets[e, o, COS + a]
            own = ti.atan2(of.state[e, i, EAST] - east, of.state[e, i, NORTH] - north)
            course = own + turn * ti.static(0.25 * TWO_PI)
            out.target[e, i, NORTH], out.target[e, i, EAST], out.target[e, i, COURSE] = north, east, course
            out.target[e, i, COS], out.target[e, i, SIN] = ti.cos(course), ti.sin(course)
            out.height_error[e, i] = of.down[i] - of.state[e, i, DOWN]
            nearest, last = own * 0.0 + TWO_PI, own * 0.0 - 1.0
            for j in range(of.state.shape[1]):
                k = ti.static(form.first) + j
                old = of.heard[e, o, k, age]
                if j != i and old < HEARD_OF:
                    x = of.heard[e, o, k, NORTH] + old * of.heard[e, o, k, Message.V_NORTH] - north
                    y = of.heard[e, o, k, EAST] + old * of.heard[e, o, k, ti.static(Message.V_NORTH + 1)] - east
                    ahead = on_from(own, ti.atan2(y, x), turn)
                    nearest, last = ti.min(nearest, ahead), ti.max(last, ahead)
            out.gap_error[e, i] = between(nearest, last)
            if ti.static(form.boats[1] > form.boats[0]):
                mean, count, most = ti.Vector([own * 0.0, own * 0.0]), own * 0.0, own * 0.0
                for k in range(ti.static(form.boats[0]), ti.static(form.boats[1])):
                    if of.heard[e, o, k, age] < BOATS_HEARD_OF:
                        there = ti.Vector([of.heard[e, o, k, NORTH], of.heard[e, o, k, EAST]])
                        count, mean = count + 1.0, mean + there
                        most = ti.max(most, (there - taken(of.state, e, i, NORTH, 2)).norm())
                for a in ti.static(range(2)):
                    out.boats[e, i, a] = mean[a] / ti.max(count, 1.0)
                out.farthest[e, i, 0] = most


@ti.kernel
def _observe(
    out: array3, known: KnownPack, seen: OwnPack, tracks: TracksPack,
    action: array3, reference: array3, form: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(out.shape[0], out.shape[1]):
        o = ti.static(form.first) + i
        put_squashed(out, e, i, form.at.velocity, 3, seen.state, SURGE, SPEED_SCALE)
        put(out, e, i, form.at.down, 3, seen.derived, rotation.DOWN.start)
        for a in ti.static(range(3)):
            out[e, i, form.at.rates + a] = seen.state[e, i, ROLL_RATE + a] * ti.static(1 / RATE_SCALE)
        place = ti.Vector([seen.state[e, i, a] for a in ti.static(range(3))])
        to = ti.Vector([seen.targets[e, o, NORTH], seen.targets[e, o, EAST], 0.0]) - place
        put_direction(out, e, i, form.at.vessel, seen, to)
        out[e, i, form.at.vessel_distance] = squash(to.norm(), FAR_SCALE)
        c, s = known.target[e, i, COS], known.target[e, i, SIN]
        x, y = known.centre_velocity[e, i, NORTH], known.centre_velocity[e, i, EAST]
        out[e, i, form.at.vessel_velocity] = squash(c * x + s * y, SLOW_SCALE)
        out[e, i, ti.static(form.at.vessel_velocity + 1)] = squash(c * y - s * x, SLOW_SCALE)
        off = ti.sqrt(to[0] * to[0] + to[1] * to[1]) - tracks.radius[0]
        out[e, i, form.at.circle] = squash(off, CIRCLE_SCALE)
        out[e, i, ti.static(form.at.circle + 1)] = squash(known.height_error[e, i], CIRCLE_SCALE)
        out[e, i, form.at.gap] = known.gap_error[e, i] * ti.static(1 / math.pi)
        out[e, i, form.at.view] = ti.select(tracks.sightings[e, o, 0, Sighting.VARIANCE] > 0, 1.0, 0.0)
        out[e, i, form.at.track_age] = squash(tracks.age[e, o], AGE_SCALE)
        out[e, i, form.at.track_sigma] = squash(tracks.sigma[e, o], SIGMA_SCALE)
        widest, group = known.farthest[e, i, 0], place * 0.0
        if widest > 0:
            group = ti.Vector([known.boats[e, i, NORTH], known.boats[e, i, EAST], 0.0]) - place
        put_direction(out, e, i, form.at.boats, seen, group)
        out[e, i, form.at.boats_distance] = squash(group.norm(), FAR_SCALE)
        out[e, i, ti.static(form.at.boats_distance + 1)] = squash(widest, FAR_SCALE)
        put(out, e, i, form.at.surroundings, form.signals, seen.signals, 0)
        put(out, e, i, form.at.previous_action, form.actions, action, 0)
        if ti.static(len(form.air) > 0):
            put_air(out, e, i, seen, form)
        if ti.static(form.residual > 0):
            put_reference(out, e, i, form.at.reference, form.residual, reference, seen.derived)


@ti.func
def put_direction(out: ti.template(), e, i, at: ti.template(), seen: ti.template(), to):
    """Write the direction of `to` (m, NED) in the own frame; shorter vectors than 1 m as they are."""
    own = own_frame(seen.derived, e, i, 3, to / ti.max(to.norm(), 1.0))
    for a in ti.static(range(3)):
        out[e, i, at + a] = own[a]


class CircleErrors:
    """Writes the true errors of a team of aircraft into its `distance`, `gap_error` and `in_range`."""

    def __init__(self, team: CirclingTeam, form: CirclingForm):
        """Measure `team` about the vessel of its mission."""
        mission, state = team.mission, team.fleet.state
        boats = mission.world.teams.get(mission.config.escort.boats)
        self._form, self._launch = form, runtime.Launcher(_measure)
        self._out = runtime.Packed(ErrorsPack, distance=team.distance, gap_error=team.gap_error, in_range=team.in_range)
        self._true = runtime.Packed(
            TruePack, state=state, boats=state if boats is None else boats.state, vessel=mission.vessel_place,
            down=team.down, numbers=numbers_of(team),
        )  # fmt: skip

    def measure(self, due: Due) -> None:
        """Measure in the environments that are `due`."""
        self._launch(self._out(), self._true(), due.which, self._form, envs=due.count)


class CircleKnowledge:
    """Writes what aircraft know of the vessel and of each other, and observations of it.

    Attributes:
        widths: term -> how many numbers it has, in order.
    """

    def __init__(self, known: CircleView, team: CirclingTeam, form: CirclingForm):
        """Write into the tensors of `known`, for `team`."""
        state, tracking, model = known.fleet.state, team.tracking, team.fleet.model
        self._form, self._known = form, runtime.Packed(
            KnownPack, target=known.target.table, centre_velocity=known.centre_velocity, gap_error=known.gap_error,
            height_error=known.height_error, boats=known.boats[0], farthest=known.boats[1],
        )  # fmt: skip
        self._heard = runtime.Packed(
            HeardPack, state=state, targets=tracking.targets, heard=tracking.radio.heard, down=team.down,
            numbers=numbers_of(team),
        )  # fmt: skip
        self._own = runtime.Packed(
            OwnPack, state=state, derived=known.fleet.derived, aux=known.fleet.aux, targets=tracking.targets,
            signals=known.sensor.written,
        )  # fmt: skip
        self._tracks = runtime.Packed(
            TracksPack, sightings=tracking.sightings, age=tracking.age, sigma=tracking.sigma,
            radius=state.new_tensor([team.orbit.radius]),
        )  # fmt: skip
        air, speeds = air_columns(model)
        signals = known.sensor.signals.shape[-1]
        terms = CirclingTerms(form.first, signals, len(model.action_names), team.reference_width, air, speeds)
        self.widths = terms.widths
        self._terms = terms._replace(at=columns(self.widths))
        self._listen, self._observe = runtime.Launcher(_listen), runtime.Launcher(_observe)

    def listen(self, due: Due) -> None:
        """Update the tensors in the environments that are `due`."""
        self._listen(self._known(), self._heard(), due.which, self._form, envs=due.count)

    def observe(self, action: Tensor, reference: Tensor | None) -> Tensor:
        """All terms [env, aircraft, n], side by side in a fresh tensor.

        `action` [env, aircraft, a] is the last one; `reference` is what a residual policy corrects, or None.
        """
        corrected = action if reference is None else reference  # kernels take no empty array
        out = action.new_empty((*action.shape[:2], sum(self.widths.values())))
        parts = out, self._known(), self._own(), self._tracks(), action.contiguous(), corrected.contiguous()
        self._observe.once(*parts, self._terms)
        return out


def numbers_of(team: CirclingTeam) -> Tensor:
    """The kernels' argument `numbers`."""
    return team.fleet.state.new_tensor([team.orbit.radius, team.orbit.turn, team.mission.config.radio.range])


class OrbitGains(FixedWing6DofGains):
    """Gains of the orbit, besides those of flight and avoidance."""

    leader_share: Positive = 2.0  # there is no leader
    phase_gain: Positive = 0.05  # 1/s
    phase_speed: Positive = 4.0  # m/s, greatest change of airspeed for phases
    field_radius: Positive = 1.0  # without effect; tuned scenarios may hold it


@ti.kernel
def _lead(
    led: array3, gap_error: array2, height_error: array2, centre_velocity: array3, aux: array3, known: TeamPack,
    kind: ti.template(), form: ti.template(),
):  # fmt: skip
    """Write the velocity [env, aircraft, 3] of the field, and its rate [.., 2]; see `OrbitController`."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(led.shape[0], led.shape[1]):
        g = values_at(kind, known.numbers)
        faster = limited(g.phase_gain * g.circle * gap_error[e, i], -g.phase_speed, g.phase_speed)
        airspeed = limited(g.cruise + faster, g.low, g.high)
        x = taken(known.state, e, i, NORTH, 2) - taken(known.target, e, i, NORTH, 2)
        r = ti.max(x.norm(), 1.0)
        square = r * r + g.circle * g.circle
        along = 2.0 * r * g.circle / square * g.sigma
        out = ti.Vector([x[0] / r, x[1] / r])
        tangent = ti.Vector([-out[1], out[0]])
        d = (g.circle * g.circle - r * r) / square * out + along * tangent
        air, moves = velocity_through_air(aux, known, e, i), taken(centre_velocity, e, i, NORTH, 2)
        v = taken(known.derived, e, i, VELOCITY, 2)
        against = ti.Vector([v[a] - air[a] - moves[a] for a in ti.static(range(2))])
        across = cross(d, against)
        through = ti.sqrt(ti.max(airspeed * airspeed - across * across, 0.0))
        s = ti.max(against.dot(d) + through, LEAST_SHARE * airspeed)
        rate = (v - moves).dot(tangent) / r + 2.0 * g.sigma * g.circle / square * (v - moves).dot(out)
        led[e, i, NORTH], led[e, i, EAST] = moves[NORTH] + s * d[NORTH], moves[EAST] + s * d[EAST]
        led[e, i, DOWN] = limited(g.k_height * height_error[e, i], -g.climb, g.climb)
        led[e, i, CHANGE], led[e, i, CHANGE + 1] = -s * rate * d[EAST], s * rate * d[NORTH]


class OrbitController(SlotController):
    """Controller of aircraft that circle a moving point: a Lyapunov guidance vector field in wind. It has no memory.

    With x = position - centre, of length r, the field is the direction of flight relative to the centre, for a circle
    of radius R (Frew, Lawrence & Morris 2008, J. Guidance, Control, and Dynamics 31(2), eq. 7; sigma = 1 turns
    clockwise):

        d = -(r^2 - R^2) / (r^2 + R^2) e_r + 2 r R / (r^2 + R^2) sigma e_theta.

    It leads to the circle from anywhere, and around it. The centre moves with v_c and the air with w. The velocity over
    ground v* = v_c + s d is the one with |v* - w| = V (wind triangle). The field turns as

        chi' = theta' + 2 sigma R r' / (r^2 + R^2),

    which is fed forward to the bank. Each aircraft chooses its airspeed to fly midway between those ahead and behind,
    V = cruise + sat(k_phase R (gap ahead - gap behind) / 2) (loc. cit., sec. IV, by speed). The formations' controller
    flies the command and evades obstacles (rl/guidance/controllers/fixed_wing_6dof.py).
    """

    Gains = OrbitGains
    gains: OrbitGains

    def __init__(self, model: FixedWing6DOF, orbit: OrbitConfig, gains: OrbitGains | None = None):
        """Fly the circle `orbit`, with gains that follow from those of the autopilot."""
        self.gains = gains or OrbitGains()
        self.flight = self.remember(FixedWing6DofController(model, self.gains))
        limits = model.autopilot_limits
        low, cruise, high = limits.speeds
        numbers = {
            "circle": orbit.radius, "sigma": orbit.turn, "low": low, "cruise": cruise, "high": high,
            "phase_gain": self.gains.phase_gain, "phase_speed": self.gains.phase_speed, "climb": limits.climb,
            "k_height": model.gains.height,
        }  # fmt: skip
        self._lead = TeamKernel(_lead, numbers)

    def act(self, team: Knowledge, wanted: FlightCommand) -> Tensor:
        """Actions [env, aircraft, action] in [-1, 1] that follow the command."""
        return self.flight.act(team, wanted)

    def wanted(self, team: Knowledge) -> FlightCommand:
        """The velocity command of the field, its change, and whether it evades; `team` is a `CircleView`."""
        team = cast(CircleView, team)
        known = team.gap_error, team.height_error, team.centre_velocity, team.fleet.aux
        return self.flight.evaded(team, self._lead(team, CHANGE + 2, *known))
