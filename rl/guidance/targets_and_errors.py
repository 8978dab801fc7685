"""Geometry of guidance: the moving target, errors of a team's vehicles from their slots, and vectors in the plane.

`target[env, row, 8]` = position (north, east, down, m), course (rad), its cosine and sine, its rate (rad/s), and the
speed over ground (m/s). One row serves all vehicles; a table in which each vehicle has a target of its own has a row
for each. Targets move along tracks (`Targets`), on the sea, or at the flight height above it.

The leader's slot is the target. A follower's slot is the leader's position plus an offset in the path frame, whose
first axis is the target's course. The slot moves with the leader, swings about it as the course turns, and glides when
the formation changes. With `about`, all slots, the leader's too, are offsets from the target.

Errors are vectors in n, and in the vehicle's own frame: its body frame (3 axes), or the heading frame (2: ahead,
starboard), which stays level. Each vehicle also remembers its mean error, which tells it what wind, current and its own
craft ask for. With e the error, d its length, dt the interval and T = `DRIFT_TIME`,

    m <- m + (1 - exp(-dt / T)) (e / (d + DRIFT_SCALE) - m),    m = 0 before an episode.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.guidance.course.tracks import Tracks, TrackSample, track_point
from rl.perception.radio import Message
from rl.step import GOES_ON, NOT_DUE, Due
from taichi_sim.config import WorldConfig
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN, VELOCITY_N
from taichi_sim.kernels.runtime import array1, array2, array3, array4, whole1
from taichi_sim.randomisation.conditions import bounds
from taichi_sim.state.memory import Remembers
from taichi_sim.surroundings.air.wind import wind_factor, wind_shear

NORTH, EAST, DOWN, COURSE, COS, SIN, COURSE_RATE, SPEED, TARGET_SIZE = range(9)
TARGET_SPEED, INTERVAL, WIND_FACTOR, OVER_AIR = range(4)  # parameters of the kernel

DRIFT_TIME, DRIFT_SCALE = 10.0, 1.0  # s, m, of the mean error; assumed
SIGMAS = 3.0  # standard deviations of the slow variation in the strongest wind
LEAST_SHARE = 0.2  # of the airspeed, the least speed over ground; assumed: the wind must leave that much


@ti.func
def speed_over_ground(airspeed, north, east, cos, sin):
    """Speed over ground (m/s) on a course (cos, sin) at an airspeed in the wind (north, east), m/s.

    It is held at `LEAST_SHARE` of the airspeed where the wind would leave less.
    """
    along, across = cos * north + sin * east, cos * east - sin * north
    through = ti.sqrt(ti.max(airspeed * airspeed - across * across, 0.0))
    return ti.max(along + through, LEAST_SHARE * airspeed)


def crab(airspeed: float, wind: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Heading less course [..] (rad) that keeps to a course in the wind [.., 2] at an airspeed (m/s)."""
    north, east = wind.unbind(-1)
    across = cos * east - sin * north  # to starboard
    return -torch.asin((across * (1 / airspeed)).clamp(-1.0, 1.0))


def strongest_wind(config: WorldConfig, height: float) -> float:
    """The strongest mean wind of any realisation plus `SIGMAS` of its slow variation (m/s) at `height` (m)."""
    air = config.air
    factor = float(wind_factor(air.profile, wind_shear(air), height))
    return factor * (bounds(config, "air.speed")[1] + SIGMAS * air.std)


class Target(Remembers):
    """The target of a team: live views of a table of targets, which the next step overwrites.

    Attributes:
        table: [env, row, 8], see the module.
        position: [env, 3] the leader's own target, NED, m.
        course, cos, sin, course_rate, speed: [env, row] columns of the table: course (rad), its cosine, sine and rate
            (rad/s), and the speed over ground (m/s).
    """

    def __init__(self, table: Tensor, position: Tensor):
        """Take views of a `table` and of the leader's target."""
        self.table = self.remember(table)
        self.position = position
        self.course, self.cos, self.sin = table[..., COURSE], table[..., COS], table[..., SIN]
        self.course_rate, self.speed = table[..., COURSE_RATE], table[..., SPEED]


TrackPack = ti.types.argpack(rows=array2, length=array1, wind=array2, numbers=array1)


@ti.kernel
def _follow(
    target: array3, progress: array1,
    env_world: ti.types.ndarray(dtype=ti.i64, ndim=1), track: TrackPack, which: whole1,
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e in range(target.shape[0]):
        if which[e] != NOT_DUE:
            if which[e] == GOES_ON:
                progress[e] += target[e, 0, SPEED] * track.numbers[INTERVAL]
            place = track_point(track.rows, track.length, ti.cast(env_world[e], ti.i32), progress[e])
            course, speed = place[TrackSample.COURSE], track.numbers[TARGET_SPEED]
            c, s = ti.cos(course), ti.sin(course)
            if track.numbers[OVER_AIR] > 0:
                factor = track.numbers[WIND_FACTOR]
                north, east = track.wind[e, NORTH] * factor, track.wind[e, EAST] * factor
                speed = speed_over_ground(speed, north, east, c, s)
            target[e, 0, NORTH], target[e, 0, EAST], target[e, 0, DOWN] = place[NORTH], place[EAST], 0.0
            target[e, 0, COURSE], target[e, 0, COS], target[e, 0, SIN] = course, c, s
            target[e, 0, COURSE_RATE], target[e, 0, SPEED] = place[TrackSample.CURVATURE] * speed, speed


class Targets(Remembers):
    """Targets of all environments: they move along their worlds' tracks at a speed over ground or through the air.

    An aircraft's target moves as if it flew at a constant airspeed, by the wind triangle: velocity over ground is
    velocity through the air plus wind. On a course at the angle D from where the wind blows to, with airspeed V_a and
    wind w, the nose is turned into the wind by the crab angle c, and the speed over ground is v:

        sin c = (w / V_a) sin D,    v = w cos D + V_a cos c       (so |v - w| = V_a; Beard & McLain 2012, sec. 2.4)

    On a path of curvature k the heading turns at v k v / (V_a cos c). The acceleration, normal to the velocity through
    the air, is therefore v^2 k / cos c. It is largest straight downwind, where v = V_a + w and c = 0.

    Attributes:
        table: [env, 1, 8]; see the module. progress: float32 [env], m along the track; to be written at a reset.
    """

    def __init__(
        self, tracks: Tracks, env_world: Tensor, wind: Tensor, *, speed: float, interval: float, wind_factor: float,
        over_air: bool,
    ):  # fmt: skip
        """Move targets at `speed` (m/s) along `tracks`; `env_world` int64 [env] is the track of each environment.

        `speed` is over ground, or with `over_air` through the air. A decision takes `interval` (s). `wind` [env, 3] is
        at 10 m (m/s); `wind_factor` is the wind at the flight height over it. `env_world` and `wind` are live views.
        """
        self.table = self.remember(wind.new_zeros((wind.shape[0], 1, TARGET_SIZE)))
        self.progress = self.remember(tracks.length_m.new_zeros(wind.shape[0]))
        numbers = wind.new_tensor([speed, interval, wind_factor, float(over_air)])
        self._env_world = env_world
        self._track = runtime.Packed(TrackPack, rows=tracks.rows, length=tracks.length_m, wind=wind, numbers=numbers)
        self._launch = runtime.Launcher(_follow)

    def move(self, due: Due) -> None:
        """Move targets by an interval where an episode goes on, to `progress` where one begins."""
        self._launch(self.table, self.progress, self._env_world, self._track(), due.which, envs=due.count)


DISTANCE_SCALE = 10.0  # m, where squashed distances are half way to 1
NEAR = 1e-3  # m: a slot nearer than this has no direction
V = VELOCITY_N.start

# Columns of the table of errors, each three wide, except sights (distance and direction).
SLOT, SLOT_VELOCITY, ERROR, ERROR_RATE, ERROR_B, ERROR_RATE_B, COURSE_B = range(0, 21, 3)
SIGHT, PREVIOUS_SIGHT, DRIFT, ERRORS_SIZE = 21, 25, 29, 32
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
    forgets: float  # share of the mean error that the newest one replaces


@ti.func
def row_of(target: ti.template(), i):
    """Row of vehicle i in a table of targets."""
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
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(team.state.shape[0], team.state.shape[1]):
        if which[e] != NOT_DUE:
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
                mean = ti.select(which[e] == GOES_ON, out.table[e, i, DRIFT + a], 0.0)
                now = error[a] / (distance + ti.static(DRIFT_SCALE))
                out.table[e, i, DRIFT + a] = mean + ti.static(form.forgets) * (now - mean)
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
        table[e, i, PREVIOUS_SIGHT + k] = ti.select(which == GOES_ON, table[e, i, SIGHT + k], seen[k])
        table[e, i, SIGHT + k] = seen[k]


class SlotErrors(Remembers):
    """Errors of a team from its slots, as of the last step or reset: live views of one table, which the next
    overwrites.

    Attributes, [env, vehicle, ..]:
        slot, slot_velocity: [.., 3] position and velocity of the slot, NED, m and m/s.
        error, error_rate: [.., 3] slot minus vehicle, NED, m and m/s. distance: [..] length of `error_b`, m.
        error_b, error_rate_b, course_b: [.., axes] error, its rate, and the unit vector of the target's course, in the
            vehicle's own frame.
        drift: [.., 3] mean error, NED, squashed, see the module.
        sight, previous_sight: [.., 1 + axes] squashed distance and unit direction in its own frame, as of the last
            step and of the one before.
        reach: [..] m, the greater of |north| and |east| of the vehicle. total: [..] a sum of all measurements and of
            the state, which is finite if they are. about: whether slots are offsets from the target.
    """

    def __init__(self, state: Tensor, axes: int, *, about: bool = False):
        """Make errors, all zero, of a team whose state is `state` [env, vehicle, 13]."""
        self.table = self.remember(state.new_zeros((*state.shape[:2], ERRORS_SIZE)))
        self._plain = state.new_zeros((3, *state.shape[:2]))
        self.distance, self.reach, self.total = map(self.remember, self._plain)
        self.axes, self.about = axes, about
        self.slot, self.slot_velocity = self._view(SLOT, 3), self._view(SLOT_VELOCITY, 3)
        self.error, self.error_rate = self._view(ERROR, 3), self._view(ERROR_RATE, 3)
        self.error_b, self.error_rate_b = self._view(ERROR_B, axes), self._view(ERROR_RATE_B, axes)
        self.course_b, self.drift = self._view(COURSE_B, axes), self._view(DRIFT, 3)
        self.sight, self.previous_sight = self._view(SIGHT, 1 + axes), self._view(PREVIOUS_SIGHT, 1 + axes)

    def _view(self, first: int, width: int) -> Tensor:
        return self.table[..., first : first + width]


class Geometry(SlotErrors):
    """Errors that are measured: from the state of the vehicles, the target and the slots."""

    def __init__(
        self, fleet: Views, target: Tensor, down: float, slots: Tensor, axes: int, interval: float,
        heard: Tensor | None = None, *, about: bool = False,
    ):  # fmt: skip
        """Measure `fleet` every `interval` (s) against the table `target` at `down` (m) and the table of `slots`.

        Followers know their leader from the messages `heard` (rl/perception/radio.py); None: exactly. With `about`,
        slots are offsets from the target.
        """
        state = fleet.state
        super().__init__(state, axes, about=about)
        self._forgets = -math.expm1(-interval / DRIFT_TIME)
        self._heard, self._launch = heard is not None, runtime.Launcher(_measure)
        self._errors = runtime.Packed(ErrorsPack, table=self.table, plain=self._plain)
        self._team = runtime.Packed(
            TeamPack, target=target, down=state.new_tensor([down]), slots=slots, state=state, derived=fleet.derived,
            heard=state.new_zeros((1, 1, 1, 1)) if heard is None else heard,
        )  # fmt: skip

    def measure(self, due: Due) -> None:
        """Measure in the environments that are `due`."""
        form = ErrorsForm(self.axes, self._heard, self.about, self._forgets)
        self._launch(self._errors(), self._team(), due.which, form, envs=due.count)


def to_starboard(vector: Tensor) -> Tensor:
    """A level `vector` [.., 2] (NED), turned to starboard by a right angle."""
    north, east = vector.unbind(-1)
    return torch.stack((-east, north), dim=-1)


def course_of(vector: Tensor) -> Tensor:
    """Course [..] (rad) of vectors [.., 2 or more] (NED)."""
    return torch.atan2(vector[..., EAST], vector[..., NORTH])


def wrap(angle: Tensor) -> Tensor:
    """`angle` (rad) in [-pi, pi)."""
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi
