"""Thrusters of a hull: from the action to the load on the hull.

    action     of a policy, each in [-1, 1]                                    `commanded`
    command    speed of each thruster, then angle (rad) of each azimuth one    `lagged`
    controls   the actual settings: speeds follow their commands with a
               first-order lag, exact for a held command, angles at a rate     `thrusts`
    thrust     N of each, k |n| n (thrusters.py)                               `load`
    load       N, N m, about CO, b

A wanted wrench (X, Y, N) is distributed to the thrusters by a weighted pseudo-inverse, computed once. A fixed thruster
has one component, its thrust. An azimuth thruster has two, its push ahead and to starboard; angle and thrust follow
from them (extended thrust: Sordalen 1997, Optimal thrust allocation for marine vessels, Control Engineering Practice 5
(9); Fossen 2021, sec. 11.2). Of all f with B f = tau, the one with the least sum of (f_i / f_max,i)^2 is

    f = W^-1 B^T (B W^-1 B^T)^-1 tau,   W = diag(1 / f_max^2).

It is exact for every tau in the range of B. Any other part of tau (such as sway with two propellers ahead) is ignored.
A wrench beyond the thrusters' limits is replaced by the largest one in the same direction (`allocated`).

`p` holds the kernel's numbers (params.py). All loops over the thrusters are unrolled.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.fleet import Fleet
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import AHEAD
from taichi_sim.models.usv.hull.params import Hull6DofParams, vector
from taichi_sim.models.usv.hull.thrusters import Thruster

# other actions have the thrusters' names
ACTION_NAMES = {"surge_yaw": ("acceleration", "yaw"), "wrench": ("surge", "sway", "yaw")}
Arrow = tuple[tuple[float, float, float], tuple[str | None, str | None, str | None]]
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
        size, forwards = abs(float(own[0])), own[0] > 0
        if thruster.azimuth:
            (c, s), size = thruster.direction, float(np.hypot(*own))
            angle = np.arctan2(c * own[1] - s * own[0], c * own[0] + s * own[1])
            forwards = thruster.turns is None or thruster.turns[0] <= angle <= thruster.turns[1]
        if size > 1e-12 * np.abs(f).max():
            factors.append((thruster.thrust_max if forwards else -thruster.thrust_min) / size)
    return min(factors, default=0.0)


class Allocation(NamedTuple):
    """Compile-time tables of `allocated`."""

    shares: tuple[tuple[float, ...], ...]  # rows of `pseudo_inverse`
    first: tuple[int, ...]  # first component of each thruster
    largest: tuple[float, ...]  # X, Y (N), N (N m) that actions of 1 command
    smallest: tuple[float, ...]  # X, Y (N), N (N m) that actions of -1 command

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


class ThrusterSet:
    """Compile-time tables of the thrusters, and their names; a hull without thrusters has the columns of two at rest.
    MmgDrive (mmg_drive.py) takes its place on a hull with propellers and rudders.

    Attributes:
        thrusters: in the order of the vehicle file.
        turning: the azimuth thrusters.
        actions: how the thrusters are commanded.
        action_names, control_names: names of actions and controls.
        columns: names of the columns in the auxiliary state, controls first.
        first, first_thrust: first column of the controls, and of the thrusts, in the auxiliary state.
        push_of: for each thruster, the column of its push ahead, followed by its push to starboard; -1 if its thrust is
        its push.
        angle_of: for each thruster, the index of its angle among the controls; -1 for a fixed thruster.
        allocation: tables for `actions = "wrench"`.
        signals: plots of a recording (`Vehicle.signals`).
    """

    in_flow = False  # whether loads depend on the velocity through the water
    helm_max = None  # angle of rudders at full helm, rad

    def __init__(self, params: Hull6DofParams, dt: float, first: int):
        """Take the thrusters of `params`, for steps of `dt` (s); their columns in the auxiliary state begin at
        `first`.
        """
        self.thrusters, self.actions = params.all_thrusters, params.actions
        self.turning = tuple(t for t in self.thrusters if t.azimuth)
        names = tuple(t.name for t in self.thrusters) or ("left", "right")
        angles = tuple(f"angle_{t.name}" for t in self.turning)
        self.action_names = ACTION_NAMES.get(self.actions, (*names, *(f"{t.name}_angle" for t in self.turning)))
        self.control_names = (*(f"shaft_{name}" for name in names), *angles)
        self.first, self.first_thrust = first, first + len(self.control_names)
        columns, push_of = [*self.control_names, *(f"thrust_{name}" for name in names)], []
        for t in self.thrusters:
            plain = not t.azimuth and 1.0 in t.direction
            push_of.append(-1 if plain else first + len(columns))
            columns += [] if plain else [f"ahead_{t.name}", f"starboard_{t.name}"]
        self.columns, self.push_of = tuple(columns), tuple(push_of)
        self.angle_of = tuple(len(names) + self.turning.index(t) if t.azimuth else -1 for t in self.thrusters)
        self.allocation = Allocation.of(self.thrusters) if self.actions == "wrench" else None
        rated = params.thrusters is not None or all(one.n_max is not None for one in params.actuators.values())
        self.signals = {
            "shaft speed": ("rad/s" if rated else "", self.control_names[: len(names)]),
            "thrust": ("N", tuple(f"thrust_{name}" for name in names)),
            **({"thruster angle": ("rad", angles)} if angles else {}),
        }

    @property
    def backs(self) -> bool:
        """Whether `steer` can command a push astern."""
        if self.allocation is not None:
            return self.allocation.smallest[0] < 0
        return self.actions == "left_right" and all(t.n_min < 0 for t in self.thrusters)

    def steer(self, ahead: ArrayLike, helm: ArrayLike) -> NDArray[np.float64] | None:
        """Return the actions of a helmsman (`Vessel.steer`); None without thrusters, or if they are commanded one by
        one.

        "surge_yaw" and "wrench" take shares of the largest force and moment; azimuth thrusters all ahead or all behind
        push aside to turn. "left_right" takes the shares ahead + helm
        and ahead - helm of the two propellers' shaft speeds, clipped to their range.
        """
        ahead, helm = np.broadcast_arrays(np.asarray(ahead, dtype=np.float64), helm)
        if not self.thrusters or self.actions == "units":
            return None
        if self.actions == "surge_yaw":
            return np.stack((2.0 * ahead - 1.0, helm), axis=-1)
        if self.actions == "wrench":
            return np.stack((ahead, self.aside * helm, helm), axis=-1)
        return np.clip(np.stack((ahead + helm, ahead - helm), axis=-1), -1.0, 1.0)

    @property
    def aside(self) -> float:
        """Share of the largest sway force with which azimuth thrusters at one end turn the hull by full helm."""
        x = np.array([thruster.position[0] for thruster in self.thrusters])
        if self.allocation is None or not all(t.azimuth for t in self.thrusters) or x.min() * x.max() <= 0:
            return 0.0
        push = self.allocation.largest[2] / x.mean() / max(self.allocation.largest[1], NONE)
        return float(np.clip(push, -1.0, 1.0))

    def __len__(self) -> int:
        """Number of thrusters."""
        return len(self.thrusters)

    @property
    def arrows(self) -> Mapping[str, Arrow]:
        """Load arrows of a recording (`Vehicle.forces`)."""
        found: dict[str, Arrow] = {}
        for t, push in zip(self.thrusters, self.push_of, strict=True):
            name = f"thrust_{t.name}"
            if push >= 0:
                columns = f"ahead_{t.name}", f"starboard_{t.name}", None
            else:
                columns = (name, None, None) if t.direction[0] == 1.0 else (None, name, None)
            found[name] = (t.position, columns)
        return found

    def power(self, fleet: Fleet) -> Tensor | None:
        """Sum of thrust times the hull's speed in its direction, [env, vehicle], W; None without thrusters."""
        if not self.thrusters:
            return None
        if all(t.direction[0] == 1.0 and not t.azimuth for t in self.thrusters):
            thrusts = fleet.aux[..., self.first_thrust : self.first_thrust + len(self)]
            return thrusts.sum(-1) * fleet.velocity_b[..., AHEAD]
        total = fleet.velocity_b[..., AHEAD] * 0.0
        for _, columns in self.arrows.values():
            for axis, column in enumerate(columns):
                if column is not None:
                    total += fleet.reading(column) * fleet.velocity_b[..., axis]
        return total


@ti.func
def thrust(t: ti.template(), n):
    """Thrust (N) of a Thruster with gain 1 at the speed n (rad/s), limited to its range."""
    n = ti.max(ti.min(n, t.n_max), t.n_min)
    k = ti.select(n > 0, t.k_positive, t.k_negative)
    return k * ti.abs(n) * n


@ti.func
def shaft_speed(t: ti.template(), force):
    """Speed (rad/s) that gives the thrust `force` (N)."""
    k = ti.select(force > 0, t.k_positive, t.k_negative)
    n = ti.sqrt(ti.abs(force) / k)
    return ti.select(force > 0, n, -n)


@ti.func
def within_half_turn(angle):
    """The angle (rad) wrapped to [-pi, pi)."""
    return angle - ti.static(2 * math.pi) * ti.floor((angle + ti.static(math.pi)) * ti.static(0.5 / math.pi))


@ti.func
def controls_at(fitted: ti.template(), aux: ti.template(), e, i):
    """Controls of vehicle i in environment e."""
    return ti.Vector([aux[e, i, ti.static(fitted.first) + c] for c in ti.static(range(len(fitted.control_names)))])


@ti.func
def commanded(fitted: ti.template(), p: ti.template(), action: ti.template(), e, i, controls):
    """Command for an action; hull_6dof.py defines the actions."""
    command = controls * 0.0
    if ti.static(len(fitted) > 0):
        if ti.static(fitted.actions == "wrench"):
            tau = taken(action, e, i, 0, 3)
            for c in ti.static(range(3)):
                most, least = ti.static(fitted.allocation.largest[c], fitted.allocation.smallest[c])
                tau[c] *= ti.select(tau[c] > 0, most, -least)
            command = allocated(fitted, tau, controls)
        elif ti.static(fitted.actions == "surge_yaw"):
            left, right = ti.static(fitted.thrusters[0], fitted.thrusters[1])
            low, high = ti.static(left.thrust_min), ti.static(left.thrust_max)
            surge = 0.5 * (action[e, i, 0] + 1.0) * high
            yaw = 0.5 * action[e, i, 1] * (high - low)
            command[0] = shaft_speed(left, ti.max(ti.min(surge + yaw, high), low))
            command[1] = shaft_speed(right, ti.max(ti.min(surge - yaw, high), low))
        else:
            for k in ti.static(range(len(fitted.control_names))):
                share = action[e, i, k]
                if ti.static(k < len(fitted)):
                    n_max, n_min = ti.static(fitted.thrusters[k].n_max, fitted.thrusters[k].n_min)
                    command[k] = ti.select(share > 0, share * n_max, -share * n_min)
                else:
                    low, high = ti.static(fitted.turning[k - len(fitted)].span)
                    command[k] = low + 0.5 * (share + 1.0) * (high - low)
    return command


@ti.func
def allocated(fitted: ti.template(), tau, controls):
    """Command that makes tau (X, Y, N), or the largest wrench in its direction that `fitted` (a ThrusterSet) can make.

    An azimuth thruster is commanded to the angle of its share of tau. Until it has turned there, it thrusts with the
    component of that share along its present angle (in `controls`).
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


@ti.func
def lagged(fitted: ti.template(), p: ti.template(), controls, command, ahead):
    """Controls after `ahead` (0, 1/2 or 1) of a step towards the command; without a lag, the command itself."""
    found = controls
    if ti.static(len(fitted) > 0):
        halves, wholes = ti.static(vector(p, "keep_half", len(fitted)), vector(p, "keep", len(fitted)))
        for k in ti.static(range(len(fitted))):
            begin = ti.select(wholes[k] > 0, 1.0, 0.0)
            keep = ti.select(ahead > 0.5, wholes[k], ti.select(ahead > 0, halves[k], begin))
            found[k] = command[k] + (controls[k] - command[k]) * keep
        for a in ti.static(range(len(fitted.turning))):
            t, at = ti.static(fitted.turning[a], len(fitted) + a)
            most = ahead * (t.turn_rate * p.dt)
            if ti.static(t.all_round):  # the shorter way round
                way = within_half_turn(command[at] - controls[at])
                found[at] = within_half_turn(controls[at] + ti.max(ti.min(way, most), -most))
            else:
                found[at] = controls[at] + ti.max(ti.min(command[at] - controls[at], most), -most)
    return found


@ti.func
def thrusts(fitted: ti.template(), p: ti.template(), controls):
    """Thrusts (N), their parts ahead and their parts to starboard: three vectors."""
    size = ti.static(max(len(fitted), 1))
    force = ti.Vector([controls[0] * 0.0 for _ in range(size)])
    ahead, right = force, force
    if ti.static(len(fitted) > 0):
        gains = ti.static(vector(p, "gain", len(fitted)))
        for k in ti.static(range(len(fitted))):
            t = ti.static(fitted.thrusters[k])
            force[k] = gains[k] * thrust(t, controls[k])
            c, s = ti.static(t.direction)
            if ti.static(t.azimuth):
                at = ti.static(fitted.angle_of[k])
                turned_c, turned_s = ti.cos(controls[at]), ti.sin(controls[at])
                ahead[k] = (c * turned_c - s * turned_s) * force[k]
                right[k] = (s * turned_c + c * turned_s) * force[k]
            else:
                ahead[k], right[k] = c * force[k], s * force[k]
    return force, ahead, right


@ti.func
def load(fitted: ti.template(), p: ti.template(), controls):
    """Load (N, N m, about CO, b) of the thrusters at the given controls."""
    tau = ti.Vector([controls[0] * 0.0 for _ in range(6)])
    if ti.static(len(fitted) > 0):
        force, ahead, right = thrusts(fitted, p, controls)
        for k in ti.static(range(len(fitted))):
            t = ti.static(fitted.thrusters[k])
            for c in ti.static(range(6)):
                if ti.static(t.azimuth):
                    tau[c] += ti.static(t.arm[0][c]) * ahead[k] + ti.static(t.arm[1][c]) * right[k]
                elif ti.static(t.wrench[c] != 0):
                    tau[c] += ti.static(t.wrench[c]) * force[k]
    return tau


@ti.func
def note(fitted: ti.template(), p: ti.template(), aux: ti.template(), e, i, controls, nu_r):
    """Write controls and thrusts at the end of the step to the auxiliary state."""
    for c in ti.static(range(len(fitted.control_names))):
        aux[e, i, ti.static(fitted.first) + c] = controls[c]
    if ti.static(len(fitted) > 0):
        force, ahead, right = thrusts(fitted, p, controls)
        for k in ti.static(range(len(fitted))):
            aux[e, i, ti.static(fitted.first_thrust + k)] = force[k]
            if ti.static(fitted.push_of[k] >= 0):
                aux[e, i, ti.static(fitted.push_of[k])] = ahead[k]
                aux[e, i, ti.static(fitted.push_of[k] + 1)] = right[k]
