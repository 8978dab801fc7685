"""Thrust allocation: a wanted wrench (X, Y, N) shared out to thrusters by a weighted pseudo-inverse, computed once.

A fixed thruster has one component, its thrust; one that turns has two, its push ahead and to starboard, from which
angle and thrust follow (extended thrust: Sordalen 1997, Optimal thrust allocation for marine vessels, Control
Engineering Practice 5 (9); Fossen 2021, sec. 11.2). Of all f with B f = tau, that with the least sum of
(f_i / f_max,i)^2,

    f = W^-1 B^T (B W^-1 B^T)^-1 tau,   W = diag(1 / f_max^2),

is exact for every tau that B reaches. What B does not reach (sway by two propellers ahead) is left out. A wrench beyond
the thrusters' limits becomes the largest one of its direction (`allocated`).
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import NDArray

from taichi_sim.usv.hull.thrusters import Thruster, shaft_speed

Array = NDArray[np.float64]
IDLE = 1e-3  # of its greatest thrust: for less, a thruster does not turn; assumed (rounding has no direction)
NONE = 1e-12  # of its greatest thrust; keeps the direction of no thrust finite
PLANE = (0, 1, 5)  # X, Y, N of a wrench
SINGULAR = 1e-9  # of the largest singular value, below which B is taken not to reach


def components(thrusters: Sequence[Thruster]) -> tuple[tuple[int, int], ...]:
    """Thruster and axis of each component. Axis 0: thrust, or of one that turns its push ahead; 1: to starboard."""
    return tuple((k, axis) for k, thruster in enumerate(thrusters) for axis in range(1 + thruster.azimuth))


def reach(thrusters: Sequence[Thruster]) -> Array:
    """B [3, component]: X (N), Y (N), N (N m) of 1 N of each component."""
    loads = [
        thrusters[k].arm[axis] if thrusters[k].azimuth else thrusters[k].wrench for k, axis in components(thrusters)
    ]
    return np.array(loads).reshape(-1, 6)[:, PLANE].T


def pseudo_inverse(thrusters: Sequence[Thruster]) -> Array:
    """Components [component, 3] of a wrench of 1 N, 1 N, 1 N m, so weighted."""
    most = np.array([thrusters[k].thrust_max for k, _ in components(thrusters)])
    weighted = reach(thrusters) * most
    size = np.abs(weighted).sum(axis=1, keepdims=True)  # makes newtons and newton metres comparable
    size[size == 0] = 1.0
    return most[:, None] * np.linalg.pinv(weighted / size, rcond=SINGULAR) / size.T


def largest(thrusters: Sequence[Thruster]) -> tuple[Array, Array]:
    """The largest X, Y, N [3] above zero, and below (not above 0), each alone, that the pseudo-inverse gets from the
    thrusters' limits; 0 where they make none.
    """
    share, B = pseudo_inverse(thrusters), reach(thrusters)
    found = np.zeros((2, 3))
    for row, sign in enumerate((1.0, -1.0)):
        for axis in range(3):
            if abs((B @ share)[axis, axis] - 1.0) < 1e-6:
                found[row, axis] = sign * _factor(thrusters, sign * share[:, axis])
    return found[0], found[1]


def _factor(thrusters: Sequence[Thruster], f: Array) -> float:
    """By how much all components may be multiplied until the first thruster is at its limit."""
    factors = []
    for k, thruster in enumerate(thrusters):
        own = f[[k == one for one, _ in components(thrusters)]]
        size = float(np.hypot(*own)) if thruster.azimuth else abs(float(own[0]))
        if size > 1e-12 * np.abs(f).max():
            factors.append(limit(thruster, own) / size)
    return min(factors, default=0.0)


def limit(thruster: Thruster, own: Array) -> float:
    """Of the size of a thruster's components, in the direction that they have, N."""
    forwards = own[0] > 0
    if thruster.azimuth:
        c, s = thruster.direction
        angle = np.arctan2(c * own[1] - s * own[0], c * own[0] + s * own[1])
        forwards = thruster.turns is None or thruster.turns[0] <= angle <= thruster.turns[1]
    return thruster.thrust_max if forwards else -thruster.thrust_min


def reaches_round(thruster: Thruster) -> bool:
    """Whether a thruster that turns can push every way: all round, or half of it, with thrust either way."""
    return thruster.turns is None or (thruster.thrust_min < 0 and thruster.turns[1] - thruster.turns[0] >= np.pi - 1e-9)


class Allocation(NamedTuple):
    """What `allocated` is compiled with."""

    shares: tuple[tuple[float, ...], ...]  # `pseudo_inverse`
    first: tuple[int, ...]  # component of each thruster, the first one
    largest: tuple[float, ...]  # X, Y (N), N (N m) that the actions 1 stand for
    smallest: tuple[float, ...]  # that the actions -1 stand for

    @classmethod
    def of(cls, thrusters: Sequence[Thruster]) -> "Allocation":
        """For these thrusters."""
        order, (most, least) = components(thrusters), largest(thrusters)
        return cls(
            tuple(tuple(map(float, row)) for row in pseudo_inverse(thrusters)),
            tuple(order.index((k, 0)) for k in range(len(thrusters))),
            tuple(map(float, most)),
            tuple(map(float, least)),
        )


@ti.func
def allocated(fitted: ti.template(), tau, controls):
    """Command that makes tau (X, Y, N), or as much of it as all thrusters of `fitted` (a ThrusterSet) can make in its
    direction. A thruster that turns is told where to push; meanwhile it pushes with the part of that which its present
    angle (in `controls`) has.
    """
    command, push, share = controls, controls * 0.0, tau[0] * 0.0 + 1.0
    ahead, right = controls * 0.0, controls * 0.0  # of the thrusters, as they are unturned
    for k in ti.static(range(len(fitted.thrusters))):
        t, first = ti.static(fitted.thrusters[k], fitted.allocation.first[k])
        limit = tau[0] * 0.0
        for axis in ti.static(range(3)):
            ahead[k] += ti.static(fitted.allocation.shares[first][axis]) * tau[axis]
        if ti.static(t.azimuth):
            c, s = ti.static(t.direction)
            x, y = ahead[k], tau[0] * 0.0
            for axis in ti.static(range(3)):
                y += ti.static(fitted.allocation.shares[first + 1][axis]) * tau[axis]
            ahead[k], right[k] = c * x + s * y, c * y - s * x
            angle, at = ti.atan2(right[k], ahead[k]), ti.static(fitted.angle_of[k])
            push[k], limit = 1.0, ti.static(t.thrust_max)
            if ti.static(not t.all_round):  # out of its range it pushes the other way
                low, high = ti.static(t.turns)
                if angle < low or angle > high:
                    push[k], limit = -1.0, ti.static(-t.thrust_min)
                    angle += ti.select(angle > 0, ti.static(-math.pi), ti.static(math.pi))
            command[at] = angle
        else:
            limit = ti.select(ahead[k] > 0, ti.static(t.thrust_max), ti.static(-t.thrust_min))
        size = ti.sqrt(ahead[k] * ahead[k] + right[k] * right[k])
        share = ti.min(share, limit / ti.max(size, ti.static(NONE * t.thrust_max)))
    for k in ti.static(range(len(fitted.thrusters))):
        t = ti.static(fitted.thrusters[k])
        thrust = share * ahead[k]
        if ti.static(t.azimuth):
            at = ti.static(fitted.angle_of[k])
            if share * ti.sqrt(ahead[k] * ahead[k] + right[k] * right[k]) < ti.static(IDLE * t.thrust_max):
                command[at] = controls[at]
            thrust = share * (ahead[k] * ti.cos(controls[at]) + right[k] * ti.sin(controls[at]))
            thrust = ti.select(push[k] > 0, ti.max(thrust, 0.0), ti.min(thrust, 0.0))
        command[k] = shaft_speed(t, thrust)
    return command
