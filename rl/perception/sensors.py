"""Sensing within the detection range: the nearest obstacles and team mates of each vehicle.

An obstacle is a vertical cylinder: one that stands on the sea, (north, east, radius, height), or a body that moves and
lies between two heights (rl/guidance/course/obstacles.py). Its distance to a vehicle's origin is that to the nearest
point of
its surface: horizontal beside it, vertical above its top and below its bottom. Kernels and torch code use the columns
of tables alike; controllers read metres and NED, policies signals in the vehicle's own frame.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import Literal, NamedTuple

import taichi as ti
import torch

from rl.guidance.course.obstacles import AWAY, BOTTOM, EAST, NORTH, RADIUS, ROWS, TOP, V_EAST, V_NORTH, Bodies
from rl.step import NOT_DUE, Due
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN, VELOCITY_N, rotated_back
from taichi_sim.kernels.runtime import array1, array2, array3, array4, whole1
from taichi_sim.state.memory import Remembers

SensedPack = ti.types.argpack(gap=array2, obstacles=array4, mates=array4, signals=array3)
REACH, BODY = range(2)  # numbers of the kernel: range of the sensors, radius of a vehicle, m
SensingPack = ti.types.argpack(state=array3, derived=array3, numbers=array1)
WIDTH = 8  # obstacles in a vector
FAR = 1e9  # m: below any bottom

V = VELOCITY_N.start
SPEED_SCALE = 10.0  # m/s, where an obstacle's squashed speed is half way to 1


class Obstacle:
    """An obstacle near a vehicle, as the vehicle senses it (`Nearby.obstacles`).

    DISTANCE to its surface; NORTH, EAST, DOWN of the unit vector to its axis; velocity; RADIUS; LEVEL, the horizontal
    distance to its surface, negative above or below it; NUMBER, -1 if there is none.
    """

    DISTANCE, NORTH, EAST, DOWN, V_NORTH, V_EAST, RADIUS, LEVEL, NUMBER, SIZE = range(10)


class Mate:
    """A team mate near a vehicle (`Nearby.team_mates`): DISTANCE to its origin, unit vector, NUMBER, velocity."""

    DISTANCE, NORTH, EAST, DOWN, NUMBER, V_NORTH, V_EAST, SIZE = range(8)


class Sight(NamedTuple):
    """Amount of sensing: compile-time parameters of the kernel."""

    obstacles: int  # number of nearest ones
    mates: int
    axes: int  # of the vehicle's own frame
    field: int = 1  # obstacles in a world: a loop of known length is unrolled over whole vectors
    moving: bool = False  # whether there are bodies that move


@ti.func
def cylinder_distance(dx, dy, altitude, radius, bottom, top):
    """Distance (m) from a point to a vertical cylinder whose axis is (dx, dy) away; negative inside.

    One that stands on the sea reaches down without end: `bottom` -inf.
    """
    beside = ti.sqrt(dx * dx + dy * dy) - radius
    above = ti.max(altitude - top, bottom - altitude)
    distance = beside
    if above > 0:
        distance = above
        if beside > 0:
            distance = ti.sqrt(beside * beside + above * above)
    return distance


@ti.func
def insert(distance, index, d, j, count: ti.template()):
    """Insert body j at distance d into the ordered lists of the `count` smallest distances and their indices."""
    for k in ti.static(range(count)):
        if d < distance[k]:
            d, distance[k] = distance[k], d
            j, index[k] = index[k], j
    return distance, index


@ti.func
def near_obstacles(field: ti.template(), w, place, reach, radius, sight: ti.template()):
    """Smallest clearance (m) to obstacles of world w, at most `reach`; distances (m), indices of the nearest ones."""
    count = ti.static(sight.obstacles)
    x, y = place[0], place[1]
    gap, margin = x * 0.0 + reach, x * 0.0
    distance = ti.Vector([gap] * ti.static(count + 1))
    index = ti.Vector([-1] * ti.static(count + 1))
    for m in range(sight.field):  # without branches: vectorised
        dx, dy, r = field[w, 0, m] - x, field[w, 1, m] - y, field[w, 2, m] + reach
        margin = ti.min(margin, dx * dx + dy * dy - r * r)
    if margin < 0:  # something is in range, which is rare
        for m in range(sight.field):
            dx, dy, r = field[w, 0, m] - x, field[w, 1, m] - y, field[w, 2, m]
            if dx * dx + dy * dy < (reach + r) * (reach + r):
                d = cylinder_distance(dx, dy, -place[2], r, -FAR, field[w, 3, m])
                gap = ti.min(gap, d - radius)
                distance, index = insert(distance, index, d, m, count)
    return gap, distance, index


@ti.func
def near_bodies(bodies: ti.template(), e, place, reach, radius, sight: ti.template(), gap, distance, index):
    """Add the moving bodies of environment e to the nearest obstacles, with indices that follow those of fixed ones."""
    if ti.static(sight.moving):
        for m in range(bodies.shape[2]):
            dx, dy, r = bodies[e, NORTH, m] - place[0], bodies[e, EAST, m] - place[1], bodies[e, RADIUS, m]
            if dx * dx + dy * dy < (reach + radius + r) ** 2:
                d = cylinder_distance(dx, dy, -place[2], r, bodies[e, BOTTOM, m], bodies[e, TOP, m])
                gap = ti.min(gap, d - radius)
                distance, index = insert(distance, index, d, m + ti.static(sight.field), sight.obstacles)
    return gap, distance, index


@ti.func
def numbered(field: ti.template(), bodies: ti.template(), w, e, number, sight: ti.template()):
    """Look up an obstacle or body by its index: north, east, radius (m), and velocity, north and east (m/s)."""
    found = ti.Vector([field[w, 0, 0] * 0.0 for _ in ti.static(range(5))])
    if number < ti.static(sight.field):
        found[0], found[1], found[2] = field[w, 0, number], field[w, 1, number], field[w, 2, number]
    else:
        m = number - ti.static(sight.field)
        found[0], found[1], found[2] = bodies[e, NORTH, m], bodies[e, EAST, m], bodies[e, RADIUS, m]
        found[3], found[4] = bodies[e, V_NORTH, m], bodies[e, V_EAST, m]
    return found


@ti.func
def near_mates(state: ti.template(), e, i, place, reach, radius, count: ti.template()):
    """Smallest clearance (m) to team mates, at most `reach`; distances (m) and indices of the `count` nearest ones.

    Distances are between origins. An index is -1 if fewer mates are within `reach`.
    """
    gap = place[0] * 0.0 + reach
    distance = ti.Vector([gap] * ti.static(count + 1))
    index = ti.Vector([-1] * ti.static(count + 1))
    for m in range(state.shape[1]):
        if m != i:
            d = (taken(state, e, m, NORTH, 3) - place).norm()
            gap = ti.min(gap, d - 2 * radius)
            distance, index = insert(distance, index, d, m, count)
    return gap, distance, index


@ti.func
def store_seen(out: ti.template(), e, i, k, distance, n):
    """Write the k-th contact of vehicle i: distance (m) and unit vector n in NED."""
    out[e, i, k, Obstacle.DISTANCE] = distance  # the first columns of mates are the same
    for a in ti.static(range(3)):
        out[e, i, k, Obstacle.NORTH + a] = n[a]


@ti.func
def store_signal(signals: ti.template(), e, i, at, distance, reach, n, derived: ti.template(), axes: ti.template()):
    """Write a signal from column `at` on: closeness 1 - d / reach; the direction in the own frame, times closeness."""
    near = ti.max(1.0 - distance / reach, 0.0)
    signals[e, i, at] = near
    if ti.static(axes == 3):
        own = rotated_back(derived, e, i, n)
        for a in ti.static(range(3)):
            signals[e, i, at + 1 + a] = own[a] * near
    else:
        c, s = derived[e, i, HEADING_COS], derived[e, i, HEADING_SIN]
        signals[e, i, at + 1] = (c * n[0] + s * n[1]) * near
        signals[e, i, at + 2] = (c * n[1] - s * n[0]) * near


@ti.func
def store_obstacle(out: ti.template(), derived: ti.template(), sight: ti.template(), e, i, k, distance,
                   number, place, there, reach):  # fmt: skip
    """Write the k-th nearest obstacle; `there` is as in `numbered`. `number` is -1 if there is none, which is written
    once.
    """
    if number >= 0 or out.obstacles[e, i, k, Obstacle.NUMBER] >= 0:
        direction, spread, moves = place * 0.0, reach * 0.0, ti.Vector([reach * 0.0, reach * 0.0])
        level, radius = reach, reach * 0.0
        if number >= 0:
            dx, dy = there[0] - place[0], there[1] - place[1]
            axis = ti.max(ti.sqrt(dx * dx + dy * dy), 1e-6)
            direction, moves = ti.Vector([dx / axis, dy / axis, 0.0]), ti.Vector([there[3], there[4]])
            level, radius, spread = axis - there[2], there[2], ti.min(there[2] / axis, 1.0)
        store_seen(out.obstacles, e, i, k, distance, direction)
        out.obstacles[e, i, k, Obstacle.V_NORTH], out.obstacles[e, i, k, Obstacle.V_EAST] = moves[0], moves[1]
        out.obstacles[e, i, k, Obstacle.RADIUS], out.obstacles[e, i, k, Obstacle.LEVEL] = radius, level
        out.obstacles[e, i, k, Obstacle.NUMBER] = number
        at = k * ti.static(sight.axes + 4)
        store_signal(out.signals, e, i, at, ti.max(distance, 0.0), reach, direction, derived, sight.axes)
        c, s, speed = derived[e, i, HEADING_COS], derived[e, i, HEADING_SIN], moves.norm() + SPEED_SCALE
        out.signals[e, i, at + ti.static(sight.axes + 1)] = spread
        out.signals[e, i, at + ti.static(sight.axes + 2)] = (c * moves[0] + s * moves[1]) / speed
        out.signals[e, i, at + ti.static(sight.axes + 3)] = (c * moves[1] - s * moves[0]) / speed


@ti.func
def store_mate(out: ti.template(), derived: ti.template(), sight: ti.template(), e, i, k, distance,
               number, direction, moves, reach):  # fmt: skip
    """Write the k-th nearest team mate, number -1 if there is none, in `direction` (unit vector, NED); `moves` is its
    velocity, north and east, m/s.
    """
    store_seen(out.mates, e, i, k, distance, direction)
    out.mates[e, i, k, Mate.NUMBER] = number
    out.mates[e, i, k, Mate.V_NORTH], out.mates[e, i, k, Mate.V_EAST] = moves[0], moves[1]
    at = ti.static(sight.obstacles * (sight.axes + 4)) + k * ti.static(sight.axes + 1)
    store_signal(out.signals, e, i, at, distance, reach, direction, derived, sight.axes)


@ti.kernel
def _sense(
    out: SensedPack, team: SensingPack, field: array3, bodies: array3,
    env_world: ti.types.ndarray(dtype=ti.i64, ndim=1), which: whole1, sight: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(team.state.shape[0], team.state.shape[1]):
        if which[e] != NOT_DUE:
            w, reach, radius = env_world[e], team.numbers[REACH], team.numbers[BODY]
            place = taken(team.state, e, i, NORTH, 3)
            clear, far, index = near_obstacles(field, w, place, reach, radius, sight)
            clear, far, index = near_bodies(bodies, e, place, reach, radius, sight, clear, far, index)
            apart, away, who = near_mates(team.state, e, i, place, reach, radius, sight.mates)
            out.gap[e, i] = ti.min(clear, apart)
            for k in ti.static(range(sight.obstacles)):
                there = numbered(field, bodies, w, e, ti.max(index[k], 0), sight)
                store_obstacle(out, team.derived, sight, e, i, k, far[k], index[k], place, there, reach)
            for k in ti.static(range(sight.mates)):
                direction, moves, m = place * 0.0, ti.Vector([0.0, 0.0]), ti.max(who[k], 0)
                if who[k] >= 0:
                    there = taken(team.state, e, m, NORTH, 3)
                    direction = (there - place) / ti.max(away[k], 1e-6)
                    moves = taken(team.derived, e, m, V, 2)
                store_mate(out, team.derived, sight, e, i, k, away[k], who[k], direction, moves, reach)


class Nearby(Remembers):
    """Obstacles and team mates near each vehicle of a team; the next measurement overwrites them.

    Attributes:
        gap: [env, vehicle] smallest clearance (m) between this vehicle's sphere of `radius` and any obstacle or
            team mate's sphere, at most `reach`; negative means contact.
        obstacles: [env, vehicle, k, 9] distance (m) to the k-th nearest obstacle's surface, the horizontal unit
            vector to its axis (NED), its velocity, north and east (m/s), its radius (m), and the horizontal distance
            to its surface (m), negative above or below it, and its number, of obstacles that stand and bodies on from
            them; `reach`, zeros and the number -1 where there is none in range.
        team_mates: [env, vehicle, k, 7] likewise, of the k-th nearest mate's origin: distance, unit vector, number,
            velocity north and east (m/s).
        signals: [env, vehicle, n] all of it as a policy observes it, obstacles first: closeness 1 - d / reach, and
            the direction in the vehicle's own frame times closeness; zeros where there is nothing in range. An
            obstacle has three more: the sine of half the angle it fills, without which nobody can tell whether a
            course clears it, and its velocity, ahead and to starboard, squashed.
        written: the same, or one column where there are none, as kernels take it.
    """

    def __init__(self, state: torch.Tensor, num_obstacles: int, num_mates: int, reach: float, radius: float, axes: int):
        """Make tensors, all zero, for a team whose state is `state` [env, vehicle, 13].

        Args:
            num_obstacles, num_mates: how many of the nearest ones. reach: detection range, m. radius: of a
                vehicle, m. axes: of the vehicle's own frame: 3, the body frame, or 2, the heading frame (ahead,
                starboard), which stays level.
        """
        env, vehicle = state.shape[:2]
        self.num_obstacles, self.num_mates = num_obstacles, num_mates
        self.reach, self.radius, self.axes = reach, radius, axes
        self.gap = self.remember(state.new_zeros((env, vehicle)))
        self.obstacles = self.remember(state.new_zeros((env, vehicle, max(num_obstacles, 1), Obstacle.SIZE)))
        self.team_mates = self.remember(state.new_zeros((env, vehicle, max(num_mates, 1), Mate.SIZE)))
        width = num_obstacles * (self.axes + 4) + num_mates * (self.axes + 1)
        self.signals = state.new_zeros((env, vehicle, width))
        # kernels take no empty array
        self.written = self.remember(self.signals if width else state.new_zeros((env, vehicle, 1)))


class Sensor(Nearby):
    """Senses the true obstacles and team mates of one team."""

    def __init__(
        self,
        fleet: Fleet,
        num_obstacles: int,
        num_mates: int,
        reach: float,
        radius: float,
        frame: Literal["heading", "body"] = "heading",
    ):
        """Sense for `fleet`; arguments as of `Nearby`. Signals are in the body frame, or in the heading frame."""
        state = fleet.state
        super().__init__(state, num_obstacles, num_mates, reach, radius, 3 if frame == "body" else 2)
        numbers = state.new_tensor([reach, radius])
        self._team = runtime.Packed(SensingPack, state=state, derived=fleet.derived, numbers=numbers)
        self._nobody = state.new_zeros((1, ROWS, 1))
        self._all = torch.ones(len(state), dtype=torch.int32, device=state.device)
        self._field: torch.Tensor | None = self.scratch(None)
        self._columns = self.scratch(state)
        self._sight, self._launch = Sight(num_obstacles, num_mates, self.axes), runtime.Launcher(_sense, plain=True)
        self._sensed = runtime.Packed(
            SensedPack, gap=self.gap, obstacles=self.obstacles, mates=self.team_mates, signals=self.written
        )

    def look(
        self,
        obstacles: torch.Tensor,
        env_world: torch.Tensor,
        due: Due | None = None,
        bodies: Bodies | None = None,
    ) -> None:
        """Sense `obstacles` [world, m, 4] and moving `bodies`; `env_world` int64 [env] is the world of each
        environment.

        Only environments that are `due` are sensed; default: all.
        """
        if obstacles is not self._field:  # by column, so that the kernel reads whole vectors
            self._field, self._columns = obstacles, _padded(obstacles.transpose(1, 2))
        which, count = (self._all, len(self._all)) if due is None else due[:2]
        moving = bodies is not None and bodies.present
        table = bodies.table if bodies is not None and moving else self._nobody
        sight = self._sight._replace(field=self._columns.shape[2], moving=moving)
        self._launch(self._sensed(), self._team(), self._columns, table, env_world, which, sight, envs=count)


def _padded(columns: torch.Tensor) -> torch.Tensor:
    """Obstacles [world, 4, m], padded with far ones to a multiple of `WIDTH`: fewer kernels to compile."""
    missing = -columns.shape[2] % WIDTH
    far = columns.new_tensor([AWAY, AWAY, 0.0, 0.0]).view(1, 4, 1).expand(columns.shape[0], 4, missing)
    return torch.cat((columns, far), dim=2).contiguous()
