"""Control allocation: thrusts of the rotors for a collective thrust and moments, by the pseudo-inverse of their
geometry.

With the thrust f_i of rotor i at r_i, up: (T, M_x, M_y, M_z) = B f, B_i = (1, -r_iy, r_ix, s_i k_m / k_f); f = B^+ (T,
M) has the least sum of squares. Controllers know the nominal rotors, whose gains are all 1.

Where the rotors cannot give everything, roll and pitch have priority: their moments are scaled until some collective
thrust fits them, the collective is moved into the range that then fits, and yaw takes what is left.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from functools import cache
from typing import NamedTuple

import numpy as np
import taichi as ti

from taichi_sim.config import ConfigError
from taichi_sim.conventions import GRAVITY
from taichi_sim.kernels.abreast import some
from taichi_sim.uav.multirotor.params import MultirotorParams

AXES = ("thrust", "roll", "pitch", "yaw")
REACHED = 1e-6  # largest residual of a least-squares solution for a unit of thrust or moment
SMALLEST = 1e-9  # N: a thrust below it does not bound a scale


class RotorAllocation(NamedTuple):
    """Thrusts f = P (T, M_x, M_y, M_z), and the thrusts and speeds in hover."""

    P: tuple[tuple[float, ...], ...]  # [rotor][4], 1 and 1/m
    weight: float  # N
    hover: tuple[float, ...]  # rotor speeds, rad/s
    thrust_to_weight: float  # of all rotors at omega_max, 1
    shares: tuple[float, float]  # least and largest share of a rotor in a collective thrust


def effectiveness(craft: MultirotorParams) -> np.ndarray:
    """B [4, rotor]: thrust and moments (about the centre of gravity, b) per unit of thrust of each rotor."""
    arms, lever = craft.arms, craft.rotor.k_m / craft.rotor.k_f
    yaw = [mount.yaw * lever for mount in craft.rotors]
    return np.stack((np.ones(len(arms)), -arms[:, 1], arms[:, 0], np.array(yaw)))


@cache
def allocation(craft: MultirotorParams) -> RotorAllocation:
    """The allocation of a vehicle file's rotors.

    Raises:
        ConfigError: for rotors that cannot lift the weight, cannot turn about an axis, or would have to push down.
    """
    weight, rotor = craft.physical.mass * GRAVITY, craft.rotor
    greatest = rotor.k_f * rotor.omega_max**2
    ratio = sum(mount.gain for mount in craft.rotors) * greatest / weight
    if ratio <= 1:
        raise ConfigError(
            f"rotors: thrust to weight is {ratio:.3g}: all rotors at omega_max = {rotor.omega_max:g} rad/s lift "
            f"{ratio * weight:.4g} N of {weight:.4g} N; it must be above 1"
        )
    B = effectiveness(craft)
    P = np.linalg.pinv(B, rcond=1e-9)
    missing = [axis for k, axis in enumerate(AXES) if abs(B @ P[:, k] - np.eye(4)[k]).max() > REACHED]
    moments = [axis for axis in missing if axis != "thrust"]
    if missing:
        raise ConfigError(
            f"rotors: they cannot {', '.join(moments) or 'lift without turning'}: {_why(moments)}; thrust and three "
            "moments must be independent"
        )
    thrust = P[:, 0] * weight
    least = rotor.k_f * rotor.omega_min**2
    for k, f in enumerate(thrust):
        if not least <= f <= greatest or f <= 0:
            raise ConfigError(
                f"rotors.{k}: hover asks it for {f:.4g} N, and it gives {least:.4g} to {greatest:.4g} N: the centre of "
                "gravity is too far from the rotors' middle"
            )
    speeds = tuple(float(x) for x in np.sqrt(thrust / rotor.k_f))
    shares = float(P[:, 0].min()), float(P[:, 0].max())
    return RotorAllocation(tuple(tuple(float(x) for x in row) for row in P), weight, speeds, float(ratio), shares)


def _why(missing: list[str]) -> str:
    """The reason why the rotors cannot turn the aircraft about the `missing` axes, as text."""
    if missing == ["yaw"]:
        return "all turn the same way, or those of each way are balanced against roll and pitch"
    return "their hubs lie in one line, or there are too few"


@ti.func
def allocate(a: ti.template(), T, M, low, high):
    """Thrusts [rotor] (N), each from `low` to `high`, for a collective thrust T (N) and moments M (N m, b).

    Also returns the fractions of the moments that these thrusts give: about roll and pitch, and about yaw.
    """
    N = ti.static(len(a.P))
    turn, yaw = ti.Vector([T * 0.0 for _ in ti.static(range(N))]), ti.Vector([T * 0.0 for _ in ti.static(range(N))])
    for k in ti.static(range(N)):
        turn[k] = ti.static(a.P[k][1]) * M[0] + ti.static(a.P[k][2]) * M[1]
        yaw[k] = ti.static(a.P[k][3]) * M[2]
    # T between `least` and `most` fits the turn; without a turn, between `least_0` and `most_0`
    least, most = (low - turn[0]) * ti.static(1.0 / a.P[0][0]), (high - turn[0]) * ti.static(1.0 / a.P[0][0])
    for k in ti.static(range(1, N)):
        least = ti.max(least, (low - turn[k]) * ti.static(1.0 / a.P[k][0]))
        most = ti.min(most, (high - turn[k]) * ti.static(1.0 / a.P[k][0]))
    scale = T * 0.0 + 1.0
    beyond = least > most
    if some(beyond):
        free = high * ti.static(1.0 / a.shares[1]) - low * ti.static(1.0 / a.shares[0])
        free = ti.max(free, 0.0)
        # the gap between them is convex in the scale, so no larger scale fits
        scale = ti.select(beyond, free / ti.select(beyond, free + least - most, 1.0), 1.0)
        least, most = -1e30 + 0.0 * T, 1e30 + 0.0 * T
        for k in ti.static(range(N)):
            turn[k] *= scale
            least = ti.max(least, (low - turn[k]) * ti.static(1.0 / a.P[k][0]))
            most = ti.min(most, (high - turn[k]) * ti.static(1.0 / a.P[k][0]))
    collective = ti.max(ti.min(T, most), least)
    f, part = turn, T * 0.0 + 1.0
    for k in ti.static(range(N)):
        f[k] = turn[k] + ti.static(a.P[k][0]) * collective
        room = ti.select(yaw[k] > 0.0, high - f[k], f[k] - low)
        part = ti.min(part, ti.max(room, 0.0) / ti.max(ti.abs(yaw[k]), SMALLEST))
    for k in ti.static(range(N)):
        f[k] = ti.max(ti.min(f[k] + part * yaw[k], high), low)
    return f, scale, part
