"""Geometry of guidance: errors of a team's vehicles from their slots, in one kernel, and vectors in the plane.

The leader's slot is the target. A follower's slot is the leader's position plus an offset in the path frame, whose
first axis is the target's course. The slot moves with the leader, swings about it as the course turns, and glides when
the formation changes. With `about`, all slots, the leader's too, are offsets from the target.

Errors are vectors in n, and in the vehicle's own frame: its body frame (3 axes), or the heading frame (2: ahead,
starboard), which stays level.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import TYPE_CHECKING, NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.guidance.targets import COS, COURSE_RATE, DOWN, EAST, NORTH, SIN, SPEED
from rl.perception.columns import Message
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN, VELOCITY_N
from taichi_sim.kernels.runtime import array1, array3, array4, whole1

if TYPE_CHECKING:
    from rl.guidance.knowledge import Knowledge

DISTANCE_SCALE = 10.0  # m, where squashed distances are half way to 1
NEAR = 1e-3  # m: a slot nearer than this has no direction
V = VELOCITY_N.start
MEASURE = 60.0  # ns per vehicle, about

# Columns of the table of errors, each three wide, except sights (distance and direction).
SLOT, SLOT_VELOCITY, ERROR, ERROR_RATE, ERROR_B, ERROR_RATE_B, COURSE_B = range(0, 21, 3)
SIGHT, PREVIOUS_SIGHT, SIZE = 21, 25, 29
DISTANCE, REACH, TOTAL = range(3)  # columns of single numbers

# Columns of the table of slots, two each (ahead, starboard): offset (m), its rate (m/s), its goal (m).
OFFSET, RATE, GOAL, SLOT_SIZE = range(0, 8, 2)

ErrorsPack = ti.types.argpack(table=array3, plain=array3)
TeamPack = ti.types.argpack(target=array3, down=array1, slots=array3, state=array3, derived=array3, heard=array4)


class ErrorsForm(NamedTuple):
    """Compile-time parameters of the kernel."""

    axes: int  # of the vehicle's own frame
    heard: bool  # followers know their leader from radio messages (rl/perception/radio.py)
    about: bool  # slots are offsets from the target, not from the leader
    serial: bool  # run on the calling thread


@ti.func
def row_of(target: ti.template(), i):
    """Row of vehicle i in a table of targets (targets.py)."""
    return ti.min(i, target.shape[1] - 1)


@ti.func
def leader_of(team: ti.template(), e, i, form: ti.template()):
    """Position and velocity (NED) of vehicle i's leader, extrapolated from its last message along the target's arc."""
    place = ti.Vector([team.state[e, 0, a] for a in ti.static(range(3))])
    moves = ti.Vector([team.derived[e, 0, V + a] for a in ti.static(range(3))])
    if ti.static(form.heard):
        age, turn = team.heard[e, i, 0, Message.SIZE], team.target[e, row_of(team.target, i), COURSE_RATE]
        c, s, half = ti.cos(turn * age), ti.sin(turn * age), 0.5 * turn * age
        v = ti.Vector([team.heard[e, i, 0, Message.V_NORTH + a] for a in ti.static(range(3))])
        moves = ti.Vector([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])
        chord = ti.Vector([v[0] - half * v[1], v[1] + half * v[0], v[2]])
        place = ti.Vector([team.heard[e, i, 0, a] for a in ti.static(range(3))]) + age * chord
    return place, moves


@ti.func
def slot_of(target: ti.template(), slots: ti.template(), e, i):
    """Offset in n (m) of slot i from the leader, and its velocity (m/s) about it: it swings, and glides."""
    r = row_of(target, i)
    c, s, turn = target[e, r, COS], target[e, r, SIN], target[e, r, COURSE_RATE]
    x, y = slots[e, i, OFFSET], slots[e, i, OFFSET + 1]
    north, east = c * x - s * y, s * x + c * y
    x_rate, y_rate = slots[e, i, RATE], slots[e, i, RATE + 1]
    north_rate, east_rate = c * x_rate - s * y_rate, s * x_rate + c * y_rate
    return ti.Vector([north, east, 0.0]), ti.Vector([north_rate - turn * east, east_rate + turn * north, 0.0])


@ti.func
def own_frame(derived: ti.template(), e, i, axes: ti.template(), v):
    """v [3] in n as a vector of vehicle i's own frame; its third part is 0 in the heading frame."""
    own = ti.Vector([0.0, 0.0, 0.0])
    if ti.static(axes == 3):
        for a in ti.static(range(3)):
            own[a] = derived[e, i, a] * v[0] + derived[e, i, 3 + a] * v[1] + derived[e, i, 6 + a] * v[2]
    else:
        c, s = derived[e, i, HEADING_COS], derived[e, i, HEADING_SIN]
        own = ti.Vector([c * v[0] + s * v[1], c * v[1] - s * v[0], 0.0])
    return own


@ti.kernel
def _measure(out: ErrorsPack, team: TeamPack, which: whole1, form: ti.template()):
    ti.loop_config(serialize=form.serial)
    for e, i in ti.ndrange(team.state.shape[0], team.state.shape[1]):
        if which[e] != 0:
            r = row_of(team.target, i)
            c, s, speed = team.target[e, r, COS], team.target[e, r, SIN], team.target[e, r, SPEED]
            offset, moving = slot_of(team.target, team.slots, e, i)
            height = team.target[e, r, DOWN] + team.down[0]
            slot = ti.Vector([team.target[e, r, NORTH], team.target[e, r, EAST], height])
            moves = ti.Vector([speed * c, speed * s, 0.0])
            if ti.static(form.about):
                for a in ti.static(range(3)):
                    slot[a], moves[a] = slot[a] + offset[a], moves[a] + moving[a]
            elif i > 0:
                place, velocity = leader_of(team, e, i, form)
                for a in ti.static(range(3)):
                    slot[a], moves[a] = place[a] + offset[a], velocity[a] + moving[a]
            error, rate = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            for a in ti.static(range(3)):
                error[a], rate[a] = slot[a] - team.state[e, i, a], moves[a] - team.derived[e, i, V + a]
            error_b = own_frame(team.derived, e, i, form.axes, error)
            rate_b = own_frame(team.derived, e, i, form.axes, rate)
            course_b = own_frame(team.derived, e, i, form.axes, ti.Vector([c, s, 0.0]))
            distance = error_b.norm()
            for a in ti.static(range(3)):
                out.table[e, i, SLOT + a], out.table[e, i, SLOT_VELOCITY + a] = slot[a], moves[a]
                out.table[e, i, ERROR + a], out.table[e, i, ERROR_RATE + a] = error[a], rate[a]
                out.table[e, i, ERROR_B + a], out.table[e, i, ERROR_RATE_B + a] = error_b[a], rate_b[a]
                out.table[e, i, COURSE_B + a] = course_b[a]
            look(out.table, e, i, which[e], distance, error_b)
            total = distance
            for k in ti.static(range(13)):
                total += team.state[e, i, k]
            out.plain[DISTANCE, e, i], out.plain[TOTAL, e, i] = distance, total
            out.plain[REACH, e, i] = ti.max(ti.abs(team.state[e, i, NORTH]), ti.abs(team.state[e, i, EAST]))


@ti.func
def look(table: ti.template(), e, i, which, distance, error_b):
    """Shift the last sight into the previous one, and write the new one; both are equal as an episode begins."""
    seen = ti.Vector([distance / (distance + DISTANCE_SCALE), 0.0, 0.0, 0.0])
    for a in ti.static(range(3)):
        seen[1 + a] = error_b[a] / ti.max(distance, NEAR)
    for k in ti.static(range(4)):
        table[e, i, PREVIOUS_SIGHT + k] = ti.select(which == 1, table[e, i, SIGHT + k], seen[k])
        table[e, i, SIGHT + k] = seen[k]


class SlotErrors:
    """Errors of a team from its slots, as of the last step or reset: live views of one table, which the next
    overwrites.

    Attributes, [env, vehicle, ..]:
        slot, slot_velocity: [.., 3] position and velocity of the slot, NED, m and m/s.
        error, error_rate: [.., 3] slot minus vehicle, NED, m and m/s. distance: [..] length of `error_b`, m.
        error_b, error_rate_b, course_b: [.., axes] error, its rate, and the unit vector of the target's course, in the
            vehicle's own frame.
        sight, previous_sight: [.., 1 + axes] squashed distance and unit direction in its own frame, as of the last
            step and of the one before.
        reach: [..] m, the greater of |north| and |east| of the vehicle. total: [..] a sum of all measurements and of
            the state, which is finite if they are. about: whether slots are offsets from the target.
    """

    STATE = ("table", "distance", "reach", "total")

    def __init__(self, state: Tensor, axes: int, *, about: bool = False):
        """Make errors, all zero, of a team whose state is `state` [env, vehicle, 13]."""
        self.table = state.new_zeros((*state.shape[:2], SIZE))
        self._plain = state.new_zeros((3, *state.shape[:2]))
        self.distance, self.reach, self.total = self._plain
        self.axes, self.about = axes, about
        self.slot, self.slot_velocity = self._view(SLOT, 3), self._view(SLOT_VELOCITY, 3)
        self.error, self.error_rate = self._view(ERROR, 3), self._view(ERROR_RATE, 3)
        self.error_b, self.error_rate_b = self._view(ERROR_B, axes), self._view(ERROR_RATE_B, axes)
        self.course_b = self._view(COURSE_B, axes)
        self.sight, self.previous_sight = self._view(SIGHT, 1 + axes), self._view(PREVIOUS_SIGHT, 1 + axes)

    def _view(self, first: int, width: int) -> Tensor:
        return self.table[..., first : first + width]


class Geometry(SlotErrors):
    """Errors that are measured: from the state of the vehicles, the target and the slots."""

    STATE = ()

    def __init__(
        self, fleet: Views, target: Tensor, down: float, slots: Tensor, axes: int, heard: Tensor | None = None, *,
        about: bool = False,
    ):  # fmt: skip
        """Measure `fleet` against `target` (targets.py) at `down` (m) and the table of `slots`.

        Followers know their leader from the messages `heard` (rl/perception/radio.py); None: exactly. With `about`,
        slots are offsets from the target.
        """
        state = fleet.state
        super().__init__(state, axes, about=about)
        self._heard, self._rows, self._launch = heard is not None, state.shape[1], runtime.Launcher(_measure)
        self._errors = runtime.Packed(ErrorsPack, table=self.table, plain=self._plain)
        self._team = runtime.Packed(
            TeamPack, target=target, down=state.new_tensor([down]), slots=slots, state=state, derived=fleet.derived,
            heard=state.new_zeros((1, 1, 1, 1)) if heard is None else heard,
        )  # fmt: skip

    def measure(self, which: Tensor, count: int) -> None:
        """Measure environments by `which` [env] int32: 0 not at all, 1 after a step, 2 at the beginning of an episode.

        `count` is the number of environments that are not 0.
        """
        form = ErrorsForm(self.axes, self._heard, self.about, runtime.few(count * self._rows, MEASURE))
        self._launch(self._errors(), self._team(), which, form)


def turning(team: "Knowledge", vector: Tensor) -> Tensor:
    """Rate of change of a `vector` [env, vehicle, 2 or 3] that turns with the target's course."""
    rate = team.target.course_rate
    change = torch.zeros_like(vector)
    change[..., NORTH], change[..., EAST] = -rate * vector[..., EAST], rate * vector[..., NORTH]
    return change


def to_starboard(vector: Tensor) -> Tensor:
    """A level `vector` [.., 2] (NED), turned to starboard by a right angle."""
    north, east = vector.unbind(-1)
    return torch.stack((-east, north), dim=-1)


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Cross product [..] of the level parts of `a` and `b` [.., 2 or more] (NED): above 0 where b is to starboard."""
    return a[..., NORTH] * b[..., EAST] - a[..., EAST] * b[..., NORTH]


def course_of(vector: Tensor) -> Tensor:
    """Course [..] (rad) of vectors [.., 2 or more] (NED)."""
    return torch.atan2(vector[..., EAST], vector[..., NORTH])


def approach(error: Tensor, gain: float, acceleration: float) -> Tensor:
    """Rate towards a zero of `error` that can still be stopped: min(gain |e|, sqrt(2 acceleration |e|))."""
    size = error.abs()
    return error.sign() * torch.minimum(gain * size, torch.sqrt(2 * acceleration * size))


def wrap(angle: Tensor) -> Tensor:
    """`angle` (rad) in [-pi, pi)."""
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


def into(vector: Tensor, heading: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Parts of a `vector` [.., 2] (NED) along the nose and to starboard of it; `heading`: its cosine and sine."""
    (c, s), (north, east) = heading, vector.unbind(-1)
    return c * north + s * east, c * east - s * north
