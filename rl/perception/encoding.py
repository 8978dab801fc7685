"""Encoding of what a vehicle senses: metres and NED for controllers, signals in its own frame for policies.

See columns.py.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from rl.perception.columns import Mate, Obstacle
from taichi_sim.kernels.kinematics import HEADING_COS, HEADING_SIN

SPEED_SCALE = 10.0  # m/s, where an obstacle's squashed speed is half way to 1


@ti.func
def store_seen(out: ti.template(), e, i, k, distance, n):
    """Write the k-th contact of vehicle i: distance (m) and unit vector n in NED."""
    out[e, i, k, 0] = distance
    for a in ti.static(range(3)):
        out[e, i, k, 1 + a] = n[a]


@ti.func
def store_signal(signals: ti.template(), e, i, at, distance, reach, n, derived: ti.template(), axes: ti.template()):
    """Write a signal from column `at` on: closeness 1 - d / reach, and the direction in the vehicle's own frame times
    closeness.
    """
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
def store_obstacle(out: ti.template(), derived: ti.template(), sight: ti.template(), e, i, k: ti.template(), distance,
                   number, place, there, reach):  # fmt: skip
    """Write the k-th nearest obstacle; `number` is -1 if there is none, `there` is as in `numbered`."""
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
    at = ti.static(k * (sight.axes + 4))
    store_signal(out.signals, e, i, at, ti.max(distance, 0.0), reach, direction, derived, sight.axes)
    c, s, speed = derived[e, i, HEADING_COS], derived[e, i, HEADING_SIN], moves.norm() + SPEED_SCALE
    out.signals[e, i, at + ti.static(sight.axes + 1)] = spread
    out.signals[e, i, at + ti.static(sight.axes + 2)] = (c * moves[0] + s * moves[1]) / speed
    out.signals[e, i, at + ti.static(sight.axes + 3)] = (c * moves[1] - s * moves[0]) / speed


@ti.func
def store_mate(out: ti.template(), derived: ti.template(), sight: ti.template(), e, i, k: ti.template(), distance,
               number, direction, moves, reach):  # fmt: skip
    """Write the k-th nearest team mate, number -1 if there is none, in `direction` (unit vector, NED); `moves` is its
    velocity, north and east, m/s.
    """
    store_seen(out.mates, e, i, k, distance, direction)
    out.mates[e, i, k, Mate.NUMBER] = number
    out.mates[e, i, k, Mate.V_NORTH], out.mates[e, i, k, Mate.V_EAST] = moves[0], moves[1]
    at = ti.static(sight.obstacles * (sight.axes + 4) + k * (sight.axes + 1))
    store_signal(out.signals, e, i, at, distance, reach, direction, derived, sight.axes)
