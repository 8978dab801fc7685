"""Observations of a vehicle; every term is [env, vehicle, n], scaled to be of order one.

`observations = "paper"` is sec. 3.3 (current and previous distance and direction to the target) and what partial
observability needs to avoid collisions: the nearest obstacles and team mates within the detection range. "full" adds
the error and its rate as vectors, own velocity, attitude and rates, the target's course, the previous action, the role
(1 of the leader, 0 of followers), and the offset of the own slot from the leader now (ahead and to starboard in the
path frame) instead of the name of a formation. Aircraft with air data also observe airspeed and wind; vehicles with a
radio observe the age of their leader's last message. Every term is as the vehicle knows it (knowledge.py). A residual
policy also observes what it corrects, "reference"; a policy that acts alone has no controller that remembers, and
observes "drift", its mean error (targets_and_errors.py). Directions are in the body frame (of USVs: its horizontal
part), so a policy needs no compass. No width depends on the size of the team.

"encounters" predicts how the vehicle will pass each obstacle and team mate if it keeps its motion, and how its slot
will pass each obstacle if the formation keeps its own. An encounter is the distance ahead, the distance aside (to
starboard of the motion), and the gap.

One kernel writes all of them, in the order of `widths`.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from collections import namedtuple
from collections.abc import Mapping
from typing import Literal, NamedTuple

import taichi as ti
from torch import Tensor

from rl.guidance.knowledge import Knowledge
from rl.guidance.targets_and_errors import (
    COS,
    COURSE_B,
    COURSE_RATE,
    DISTANCE_SCALE,
    DRIFT,
    ERROR,
    ERROR_B,
    ERROR_RATE_B,
    OFFSET,
    PREVIOUS_SIGHT,
    SIGHT,
    SIN,
    SPEED,
    own_frame,
    row_of,
)
from rl.guidance.targets_and_errors import V as VELOCITY
from rl.perception.radio import Message
from rl.perception.sensors import Mate, Obstacle
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import ROLL_RATE, SURGE
from taichi_sim.kernels.rotation import DOWN
from taichi_sim.kernels.runtime import array1, array3, array4
from taichi_sim.vehicle import Vehicle

SPEED_SCALE = 10.0  # m/s: squashed speeds are half way to 1 here
DRIFT_FACTOR = 3.0  # the mean error of a vehicle near its slot is a small share
RATE_SCALE = 2.0  # rad/s, rotation of the vehicle
TURN_SCALE = 0.1  # rad/s, of the target's course
AGE_SCALE = 1.0  # s, age of the last message
CHANGE_SCALE = 3.0  # m/s, where a squashed change of velocity is half way to 1
AHEAD_SCALE, ASIDE_SCALE, CLEAR_SCALE = 20.0, 5.0, 2.0  # m, of encounters
SLOWEST = 0.1  # m/s: a slower approach has no direction

MEETING = 3  # numbers of an encounter: distance ahead, distance aside, gap

MEANINGS = {
    "sight": f"distance d to the slot, m, as d / (d + {DISTANCE_SCALE:g}); unit vector to it, body",
    "previous_sight": "the same a decision ago",
    "surroundings": "of each obstacle: 1 - distance / range; direction, body, times that; sine of half its angle; "
    f"velocity ahead and to starboard, m/s, over speed + {SPEED_SCALE:g}; of each team mate: the first two",
    "error": f"to the slot, body, m, squashed by {DISTANCE_SCALE:g}",
    "error_rate": f"its rate, body, m/s, squashed by {SPEED_SCALE:g}",
    "drift": f"mean of error / (distance + 1 m) over the last seconds, body, times {DRIFT_FACTOR:g}",
    "velocity": f"over ground, body, m/s, squashed by {SPEED_SCALE:g}",
    "down": "unit vector down, body",
    "rates": f"roll, pitch, yaw, rad/s, over {RATE_SCALE:g}",
    "target_course": "unit vector along the target's course, body",
    "target_turn": f"rate of that course, rad/s, over {TURN_SCALE:g}",
    "previous_action": "the vehicle's last actions, -1 to 1",
    "role": "1 of the leader, 0 of followers",
    "offset": f"of the slot from the leader, ahead and to starboard of the course, m, squashed by {DISTANCE_SCALE:g}",
    "encounters": "of each obstacle, for the vehicle and for its slot, then of each team mate: distance ahead s, m, as "
    f"{AHEAD_SCALE:g} / ({AHEAD_SCALE:g} + s); aside, m, squashed by {ASIDE_SCALE:g}; gap, m, by {CLEAR_SCALE:g}",
    "airspeed": "from its cruise value, over half the range from the lowest to the highest",
    "wind": f"body, m/s, squashed by {SPEED_SCALE:g}",
    "age": f"of the leader's last message, s, squashed by {AGE_SCALE:g}",
    "reference": f"change of velocity that the corrected controller asks for, body, m/s, squashed by {CHANGE_SCALE:g}",
}
"""Term -> what it is; x squashed by c is x / (|x| + c); body: ahead, to starboard (aircraft: and down)."""

SeenPack = ti.types.argpack(
    table=array3, signals=array3, state=array3, derived=array3, aux=array3, target=array3, slots=array3, heard=array4,
    obstacles=array4, mates=array4, radius=array1,
)  # fmt: skip


def air_columns(model: Vehicle) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Columns of `aux`: airspeed, velocity of the air; lowest, cruise and highest airspeed. Boats have none of them."""
    if "airspeed" not in model.aux_names or model.air is None:
        return (), ()
    return tuple(model.aux_names.index(name) for name in ("airspeed", *model.air)), model.limits.speeds


class ObservationForm(NamedTuple):
    """Compile-time parameters of the kernel."""

    axes: int  # of the vehicle's own frame
    signals: int  # of its surroundings
    actions: int
    full: bool
    obstacles: int  # of its surroundings, the nearest
    mates: int
    residual: int = 0  # numbers of "reference"
    radio: bool = False
    air: tuple[int, ...] = ()  # columns of `aux`: airspeed; velocity of the air, north, east, down
    speeds: tuple[float, ...] = ()  # airspeeds: lowest, cruise, highest, m/s
    at: tuple[int, ...] = ()  # the column in which each term begins (`columns`)


def widths(form: ObservationForm) -> dict[str, int]:
    """Width of each term, in order."""
    n = form.axes
    terms = {"sight": 1 + n, "previous_sight": 1 + n, "surroundings": form.signals}
    if form.full:
        terms |= {"error": n, "error_rate": n} | ({} if form.residual else {"drift": n})
        terms |= {"velocity": 3, "down": 3, "rates": 3, "target_course": n}
        terms |= {"target_turn": 1, "previous_action": form.actions, "role": 1, "offset": 2}
        terms |= {"encounters": 2 * MEETING * form.obstacles + MEETING * form.mates}
    if form.full and form.air:
        terms |= {"airspeed": 1, "wind": n}
    if form.full and form.radio:
        terms |= {"age": 1}
    if form.residual > 0:
        terms |= {"reference": form.residual}
    return terms


def columns(terms: Mapping[str, int]) -> tuple[int, ...]:
    """The column in which each of `terms`, name -> width, begins, as a named tuple."""
    sizes = list(terms.values())
    return namedtuple("Columns", terms)(*(sum(sizes[:k]) for k in range(len(sizes))))


@ti.func
def squash(x, scale):
    """x / (|x| + scale): linear near zero, bounded by 1."""
    return x / (abs(x) + scale)


def squashed(x: Tensor, scale: float) -> Tensor:
    """The function `squash` for tensors: x / (|x| + scale)."""
    return x / (x.abs() + scale)


@ti.func
def put(out: ti.template(), e, i, at: ti.template(), width: ti.template(), values: ti.template(), first: ti.template()):
    """Copy `width` columns of `values` [env, vehicle, n], starting at `first`, into `out`, starting at column `at`."""
    for k in range(width):
        out[e, i, at + k] = values[e, i, first + k]


@ti.func
def put_squashed(out: ti.template(), e, i, at: ti.template(), width: ti.template(), values: ti.template(),
                 first: ti.template(), scale: ti.template()):  # fmt: skip
    """Copy as `put` does, squashed."""
    for k in ti.static(range(width)):
        out[e, i, at + k] = squash(values[e, i, first + k], scale)


@ti.func
def put_own(out: ti.template(), e, i, seen: ti.template(), action: ti.template(), form: ti.template()):
    """Write the vehicle's motion, errors as vectors, the target's motion, the last action, the role and the offset."""
    n = ti.static(form.axes)
    put_squashed(out, e, i, form.at.error, n, seen.table, ERROR_B, DISTANCE_SCALE)
    put_squashed(out, e, i, form.at.error_rate, n, seen.table, ERROR_RATE_B, SPEED_SCALE)
    if ti.static(not form.residual):
        mean = own_frame(seen.derived, e, i, n, taken(seen.table, e, i, DRIFT, 3))
        for k in ti.static(range(n)):
            out[e, i, form.at.drift + k] = ti.static(DRIFT_FACTOR) * mean[k]
    put_squashed(out, e, i, form.at.velocity, 3, seen.state, SURGE, SPEED_SCALE)
    put(out, e, i, form.at.down, 3, seen.derived, DOWN.start)
    for k in ti.static(range(3)):
        out[e, i, form.at.rates + k] = seen.state[e, i, ROLL_RATE + k] * ti.static(1 / RATE_SCALE)
    put(out, e, i, form.at.target_course, n, seen.table, COURSE_B)
    out[e, i, form.at.target_turn] = seen.target[e, row_of(seen.target, i), COURSE_RATE] * ti.static(1 / TURN_SCALE)
    put(out, e, i, form.at.previous_action, form.actions, action, 0)
    out[e, i, form.at.role] = ti.select(i == 0, 1.0, 0.0)
    put_squashed(out, e, i, form.at.offset, 2, seen.slots, OFFSET, DISTANCE_SCALE)


@ti.func
def encounter(out: ti.template(), e, i, at, place, v, turn, R):
    """Write an encounter with a body at `place` (m, NED): v relative, m/s; turn, rad/s; R, sum of radii, m."""
    w = v
    speed = ti.max(w.norm(), SLOWEST)
    t = ti.max(place.dot(w), 0.0) / (speed * speed)
    half = 0.5 * turn * t
    w = ti.Vector([v[0] - half * v[1], v[1] + half * v[0]])  # on the chord of its arc
    speed = ti.max(w.norm(), SLOWEST)
    ahead = place.dot(w) / speed
    aside = (w[0] * place[1] - w[1] * place[0]) / speed
    gap = ti.sqrt(aside * aside + ti.min(ahead, 0.0) ** 2) - R
    out[e, i, at] = AHEAD_SCALE / (AHEAD_SCALE + ti.max(ahead, 0.0))
    out[e, i, at + 1], out[e, i, at + 2] = squash(aside, ASIDE_SCALE), squash(gap, CLEAR_SCALE)


@ti.func
def put_encounters(out: ti.template(), e, i, seen: ti.template(), form: ti.template()):
    """Write how the vehicle will pass each obstacle and team mate, and how its slot will pass each obstacle."""
    now = ti.Vector([seen.derived[e, i, VELOCITY], seen.derived[e, i, VELOCITY + 1]])
    r = row_of(seen.target, i)
    c, s, turn = seen.target[e, r, COS], seen.target[e, r, SIN], seen.target[e, r, COURSE_RATE]
    x, y = seen.slots[e, i, OFFSET], seen.slots[e, i, OFFSET + 1]
    along, across = seen.target[e, r, SPEED] - turn * y, turn * x  # of the slot, in the path frame
    slot = ti.Vector([c * along - s * across, s * along + c * across])
    error, radius = ti.Vector([seen.table[e, i, ERROR], seen.table[e, i, ERROR + 1]]), seen.radius[0]
    for k in ti.static(range(form.obstacles)):
        at = ti.static(form.at.encounters + 2 * MEETING * k)
        if seen.obstacles[e, i, k, Obstacle.NUMBER] >= 0:
            n = ti.Vector([seen.obstacles[e, i, k, Obstacle.NORTH], seen.obstacles[e, i, k, Obstacle.EAST]])
            its = ti.Vector([seen.obstacles[e, i, k, Obstacle.V_NORTH], seen.obstacles[e, i, k, Obstacle.V_EAST]])
            size = seen.obstacles[e, i, k, Obstacle.RADIUS]
            place = (seen.obstacles[e, i, k, Obstacle.LEVEL] + size) * n
            encounter(out, e, i, at, place, now - its, 0.0, size + radius)
            encounter(out, e, i, at + MEETING, place - error, slot - its, turn, size + radius)
        else:
            for a in ti.static(range(2 * MEETING)):
                out[e, i, at + a] = 0.0
    for k in ti.static(range(form.mates)):
        at = ti.static(form.at.encounters + 2 * MEETING * form.obstacles + MEETING * k)
        if seen.mates[e, i, k, Mate.NUMBER] >= 0:
            n = ti.Vector([seen.mates[e, i, k, Mate.NORTH], seen.mates[e, i, k, Mate.EAST]])
            its = ti.Vector([seen.mates[e, i, k, Mate.V_NORTH], seen.mates[e, i, k, Mate.V_EAST]])
            encounter(out, e, i, at, seen.mates[e, i, k, Mate.DISTANCE] * n, now - its, 0.0, 2 * radius)
        else:
            for a in ti.static(range(MEETING)):
                out[e, i, at + a] = 0.0


@ti.func
def put_air(out: ti.template(), e, i, seen: ti.template(), form: ti.template()):
    """Write airspeed, as a share of the range in flight, and wind, for an aircraft."""
    ahead = seen.aux[e, i, form.air[0]] - form.speeds[1]
    out[e, i, form.at.airspeed] = ahead * ti.static(2 / (form.speeds[2] - form.speeds[0]))
    wind = ti.Vector([seen.aux[e, i, form.air[1 + a]] for a in ti.static(range(3))])
    wind_b = own_frame(seen.derived, e, i, form.axes, wind)
    for k in ti.static(range(form.axes)):
        out[e, i, form.at.wind + k] = squash(wind_b[k], SPEED_SCALE)


@ti.func
def put_reference(out: ti.template(), e, i, at: ti.template(), axes: ti.template(), velocity: ti.template(),
                  derived: ti.template()):  # fmt: skip
    """Write the change that the velocity command [env, vehicle, axes] asks for, in the vehicle's own frame."""
    change = ti.Vector([0.0, 0.0, 0.0])
    for a in ti.static(range(axes)):
        change[a] = velocity[e, i, a] - derived[e, i, VELOCITY + a]
    own = own_frame(derived, e, i, axes, change)
    for a in ti.static(range(axes)):
        out[e, i, at + a] = squash(own[a], CHANGE_SCALE)


@ti.kernel
def _observe(out: array3, seen: SeenPack, action: array3, reference: array3, form: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(out.shape[0], out.shape[1]):
        n = ti.static(1 + form.axes)
        put(out, e, i, form.at.sight, n, seen.table, SIGHT)
        put(out, e, i, form.at.previous_sight, n, seen.table, PREVIOUS_SIGHT)
        put(out, e, i, form.at.surroundings, form.signals, seen.signals, 0)
        if ti.static(form.full):
            put_own(out, e, i, seen, action, form)
            put_encounters(out, e, i, seen, form)
            if ti.static(len(form.air) > 0):
                put_air(out, e, i, seen, form)
            if ti.static(form.radio):
                out[e, i, form.at.age] = squash(seen.heard[e, i, 0, Message.SIZE], AGE_SCALE)
        if ti.static(form.residual > 0):
            put_reference(out, e, i, form.at.reference, form.residual, reference, seen.derived)


class ObservationWriter:
    """Writes a team's observations.

    Attributes:
        widths: term -> how many numbers it has, in order.
    """

    def __init__(self, team: Knowledge, kind: Literal["paper", "full"], residual: int = 0):
        """Observe what `team` knows; `residual` is the number of values that a residual policy corrects."""
        fleet, model, signals = team.fleet, team.fleet.model, team.sensor.signals
        air, speeds = air_columns(model)
        actions = len(model.action_names)
        radio = team.radio
        form = ObservationForm(
            team.axes, signals.shape[-1], actions, kind == "full", team.sensor.num_obstacles, team.sensor.num_mates,
            residual, radio is not None, air, speeds,
        )  # fmt: skip
        self._form = form._replace(at=columns(widths(form)))
        self._shape = fleet.num_envs, fleet.count, sum(widths(self._form).values())
        self._launch = runtime.Launcher(_observe)
        self._seen = runtime.Packed(
            SeenPack, table=team.now.table, signals=team.sensor.written, state=fleet.state, derived=fleet.derived,
            aux=fleet.aux, target=team.target.table, slots=team.slot_table,
            heard=fleet.state.new_zeros((1, 1, 1, 1)) if radio is None else radio.heard,
            obstacles=team.sensor.obstacles, mates=team.sensor.team_mates,
            radius=fleet.state.new_tensor([team.radius]),
        )  # fmt: skip
        self.widths = widths(self._form)

    def __call__(self, action: Tensor, reference: Tensor | None) -> Tensor:
        """All terms [env, vehicle, n], side by side in a fresh tensor.

        `action` [env, vehicle, a] is the last one; `reference` is the velocity that a residual policy corrects
        (residual.py), m/s, or None.
        """
        corrected = action if reference is None else reference  # kernels take no empty array
        out = action.new_empty(self._shape)
        self._launch.once(out, self._seen(), action.contiguous(), corrected.contiguous(), self._form)
        return out
