"""Which thruster makes what of a wanted wrench (X, Y, N): a weighted pseudo-inverse, computed once.

A fixed unit has one component, its thrust; one that turns has two, its push ahead and to starboard, from which angle
and thrust follow (extended thrust: Sordalen 1997, Optimal thrust allocation for marine vessels, Control Engineering
Practice 5 (9); Fossen 2021, sec. 11.2). Of all f with B f = tau, that with the least sum of (f_i / f_max,i)^2,

    f = W^-1 B^T (B W^-1 B^T)^-1 tau,   W = diag(1 / f_max^2),

is exact for every tau that B reaches. What B does not reach (sway by two propellers ahead) is left out.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from taichi_sim.usv.hull.thrusters import Unit

Array = NDArray[np.float64]
PLANE = (0, 1, 5)  # X, Y, N of a wrench
SINGULAR = 1e-9  # of the largest singular value, below which B is taken not to reach


def components(units: Sequence[Unit]) -> tuple[tuple[int, int], ...]:
    """Unit and axis of each component: axis 0 is its thrust, or its push ahead if it turns; 1 its push to starboard."""
    return tuple((k, axis) for k, unit in enumerate(units) for axis in range(1 + unit.azimuth))


def reach(units: Sequence[Unit]) -> Array:
    """B [3, component]: X (N), Y (N), N (N m) of 1 N of each component."""
    loads = [units[k].arm[axis] if units[k].azimuth else units[k].wrench for k, axis in components(units)]
    return np.array(loads).reshape(-1, 6)[:, PLANE].T


def pseudo_inverse(units: Sequence[Unit]) -> Array:
    """Components [component, 3] of a wrench of 1 N, 1 N, 1 N m, so weighted."""
    most = np.array([units[k].thrust_max for k, _ in components(units)])
    weighted = reach(units) * most
    size = np.abs(weighted).sum(axis=1, keepdims=True)  # makes newtons and newton metres comparable
    size[size == 0] = 1.0
    return most[:, None] * np.linalg.pinv(weighted / size, rcond=SINGULAR) / size.T


def largest(units: Sequence[Unit]) -> tuple[Array, Array]:
    """The largest X, Y, N [3] above zero, and below (not above 0), each alone, that the pseudo-inverse gets from the
    units' limits; 0 where they make none.
    """
    share, B = pseudo_inverse(units), reach(units)
    found = np.zeros((2, 3))
    for row, sign in enumerate((1.0, -1.0)):
        for axis in range(3):
            if abs((B @ share)[axis, axis] - 1.0) < 1e-6:
                found[row, axis] = sign * _factor(units, sign * share[:, axis])
    return found[0], found[1]


def _factor(units: Sequence[Unit], f: Array) -> float:
    """By how much all components may be multiplied until the first unit is at its limit."""
    factors = []
    for k, unit in enumerate(units):
        own = f[[k == one for one, _ in components(units)]]
        size = float(np.hypot(*own)) if unit.azimuth else abs(float(own[0]))
        if size > 1e-12 * np.abs(f).max():
            factors.append(limit(unit, own) / size)
    return min(factors, default=0.0)


def limit(unit: Unit, own: Array) -> float:
    """Of the size of a unit's components, in the direction that they have, N."""
    forwards = own[0] > 0
    if unit.azimuth:
        c, s = unit.direction
        angle = np.arctan2(c * own[1] - s * own[0], c * own[0] + s * own[1])
        forwards = unit.turns is None or unit.turns[0] <= angle <= unit.turns[1]
    return unit.thrust_max if forwards else -unit.thrust_min


def reaches_round(unit: Unit) -> bool:
    """Whether a unit that turns can push every way: all round, or half of it, with thrust either way."""
    return unit.turns is None or (unit.thrust_min < 0 and unit.turns[1] - unit.turns[0] >= np.pi - 1e-9)
