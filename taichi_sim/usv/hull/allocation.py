"""Thrust allocation: distribution of a wanted wrench (X, Y, N) to thrusters by a weighted pseudo-inverse, computed
once.

A fixed thruster has one component, its thrust. An azimuth thruster has two, its push ahead and to starboard; angle and
thrust follow from them (extended thrust: Sordalen 1997, Optimal thrust allocation for marine vessels, Control
Engineering Practice 5 (9); Fossen 2021, sec. 11.2). Of all f with B f = tau, the one with the least sum of (f_i /
f_max,i)^2 is

    f = W^-1 B^T (B W^-1 B^T)^-1 tau,   W = diag(1 / f_max^2).

It is exact for every tau in the range of B. Any other part of tau (such as sway with two propellers ahead) is ignored.
A wrench beyond the thrusters' limits is replaced by the largest one in the same direction (`allocated`).
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
IDLE = 1e-3  # share of the largest thrust; below, a thruster does not turn (rounding has no direction); assumed
NONE = 1e-12  # share of the largest thrust; avoids a division by zero
PLANE = (0, 1, 5)  # X, Y, N of a wrench
SINGULAR = 1e-9  # smaller singular values, over the largest one, count as zero


def components(thrusters: Sequence[Thruster]) -> tuple[tuple[int, int], ...]:
    """Thruster and axis of each component. Axis 0 is the thrust, or the push ahead of an azimuth thruster; 1 is to
    starboard.
    """
    return tuple((k, axis) for k, thruster in enumerate(thrusters) for axis in range(1 + thruster.azimuth))


def reach(thrusters: Sequence[Thruster]) -> Array:
    """B [3, component]: X (N), Y (N) and N (N m) of 1 N of each component."""
    loads = [
        thrusters[k].arm[axis] if thrusters[k].azimuth else thrusters[k].wrench for k, axis in components(thrusters)
    ]
    return np.array(loads).reshape(-1, 6)[:, PLANE].T


def pseudo_inverse(thrusters: Sequence[Thruster]) -> Array:
    """Weighted pseudo-inverse [component, 3]: the components that make X = 1 N, Y = 1 N or N = 1 N m alone."""
    most = np.array([thrusters[k].thrust_max for k, _ in components(thrusters)])
    weighted = reach(thrusters) * most
    size = np.abs(weighted).sum(axis=1, keepdims=True)  # makes N and N m comparable
    size[size == 0] = 1.0
    return most[:, None] * np.linalg.pinv(weighted / size, rcond=SINGULAR) / size.T


def largest(thrusters: Sequence[Thruster]) -> tuple[Array, Array]:
    """Largest X, Y and N [3] in the positive direction, and in the negative one (not above 0), within the thrusters'
    limits.

    Each is made alone, by the pseudo-inverse. It is 0 where the thrusters make none.
    """
    share, B = pseudo_inverse(thrusters), reach(thrusters)
    found = np.zeros((2, 3))
    for row, sign in enumerate((1.0, -1.0)):
        for axis in range(3):
            if abs((B @ share)[axis, axis] - 1.0) < 1e-6:
                found[row, axis] = sign * _factor(thrusters, sign * share[:, axis])
    return found[0], found[1]


def _factor(thrusters: Sequence[Thruster], f: Array) -> float:
    """Factor by which all components may grow until the first thruster reaches its limit."""
    factors = []
    for k, thruster in enumerate(thrusters):
        own = f[[k == one for one, _ in components(thrusters)]]
        size = float(np.hypot(*own)) if thruster.azimuth else abs(float(own[0]))
        if size > 1e-12 * np.abs(f).max():
            factors.append(limit(thruster, own) / size)
    return min(factors, default=0.0)


def limit(thruster: Thruster, own: Array) -> float:
    """Largest size (N) of a thruster's components in their present direction."""
    forwards = own[0] > 0
    if thruster.azimuth:
        c, s = thruster.direction
        angle = np.arctan2(c * own[1] - s * own[0], c * own[0] + s * own[1])
        forwards = thruster.turns is None or thruster.turns[0] <= angle <= thruster.turns[1]
    return thruster.thrust_max if forwards else -thruster.thrust_min


def reaches_round(thruster: Thruster) -> bool:
    """Whether an azimuth thruster can push in every direction: it turns all round, or half round with thrust both
    ways.
    """
    return thruster.turns is None or (thruster.thrust_min < 0 and thruster.turns[1] - thruster.turns[0] >= np.pi - 1e-9)


class Allocation(NamedTuple):
    """Compile-time tables of `allocated`."""

    shares: tuple[tuple[float, ...], ...]  # rows of `pseudo_inverse`
    first: tuple[int, ...]  # first component of each thruster
    largest: tuple[float, ...]  # X, Y (N), N (N m) of actions of 1
    smallest: tuple[float, ...]  # X, Y (N), N (N m) of actions of -1

    @classmethod
    def of(cls, thrusters: Sequence[Thruster]) -> "Allocation":
        """Make the tables for the given thrusters."""
        order, (most, least) = components(thrusters), largest(thrusters)
        return cls(
            tuple(tuple(map(float, row)) for row in pseudo_inverse(thrusters)),
            tuple(order.index((k, 0)) for k in range(len(thrusters))),
            tuple(map(float, most)),
            tuple(map(float, least)),
        )


@ti.func
def allocated(fitted: ti.template(), tau, controls):
    """Command that makes tau (X, Y, N), or the largest wrench in its direction that `fitted` (a ThrusterSet) can make.

    An azimuth thruster is commanded to the angle of its push. Meanwhile its thrust is the part of that push along its
    present angle (in `controls`).
    """
    command, push, share = controls, controls * 0.0, tau[0] * 0.0 + 1.0
    ahead, right = controls * 0.0, controls * 0.0  # pushes, relative to each thruster's unturned direction
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
            if ti.static(not t.all_round):  # outside its range the thruster pushes the other way
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
