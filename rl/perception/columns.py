"""Columns, by name, of the tables that perception writes, and the functions that write what a vehicle senses.

Kernels and torch code use the columns alike; SI, NED. Controllers read metres and NED, policies signals in the
vehicle's own frame.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN

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


class Object:
    """An object that observers can see: place, velocity, radius; the truth."""

    NORTH, EAST, DOWN, V_NORTH, V_EAST, RADIUS, SIZE = range(7)


class Sighting:
    """A sighting of an object: measured place and variance (m^2, each way); a variance below 0: not seen."""

    NORTH, EAST, VARIANCE, SIZE = range(4)


class Message:
    """The first numbers of every message: place and velocity of its sender, as the sender measures them."""

    PLACE, VELOCITY = slice(0, 3), slice(3, 6)
    V_NORTH, SIZE = 3, 6


class SightingReport:
    """The last sighting of an object in a message: place, variance, AGE (s; below 0: not seen yet)."""

    NORTH, EAST, VARIANCE, AGE, SIZE = range(5)


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
        for a in ti.static(range(3)):
            own = derived[e, i, a] * n[0] + derived[e, i, 3 + a] * n[1] + derived[e, i, 6 + a] * n[2]
            signals[e, i, at + 1 + a] = own * near
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
