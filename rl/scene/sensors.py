"""What a vehicle senses within its detection range: the nearest obstacles and the nearest team mates.

An obstacle is a vertical cylinder standing on the sea: (north, east, radius, height). Its distance to a vehicle's
origin is that to the nearest point of the cylinder's surface: horizontal beside it, vertical above its top.
"""

from typing import Literal, Protocol

import taichi as ti
import torch


class HasState(Protocol):
    """A team: its state [env, vehicle, 13] and what follows from it [env, vehicle, 14] (kinematics.py)."""

    state: torch.Tensor
    derived: torch.Tensor


@ti.func
def cylinder_distance(dx, dy, altitude, radius, height):
    """Distance (m) from a point to a vertical cylinder whose axis is (dx, dy) away; negative inside."""
    beside = ti.sqrt(dx * dx + dy * dy) - radius
    above = altitude - height
    distance = beside
    if above > 0:
        distance = above
        if beside > 0:
            distance = ti.sqrt(beside * beside + above * above)
    return distance


@ti.func
def store_seen(out: ti.template(), e, i, k, distance, n):
    """Write what vehicle i sees k-th: distance (m) and unit vector n in NED."""
    out[e, i, k, 0] = distance
    for a in ti.static(range(3)):
        out[e, i, k, 1 + a] = n[a]


@ti.func
def store_signal(signals: ti.template(), e, i, at, distance, reach, n, derived: ti.template(), axes: ti.template()):
    """Write a signal from column `at` on: closeness 1 - d / reach, and the direction in the vehicle's own frame times
    closeness.
    """
    near = ti.max(1.0 - distance / reach, 0.0)
    if ti.static(axes == 3):
        signals[e, i, at] = near
        for a in ti.static(range(3)):
            own = derived[e, i, a] * n[0] + derived[e, i, 3 + a] * n[1] + derived[e, i, 6 + a] * n[2]
            signals[e, i, at + 1 + a] = own * near
    else:
        c, s = derived[e, i, 12], derived[e, i, 13]
        signals[e, i, at] = near
        signals[e, i, at + 1] = (c * n[0] + s * n[1]) * near
        signals[e, i, at + 2] = (c * n[1] - s * n[0]) * near


@ti.kernel
def _sense(
    gap: ti.types.ndarray(ndim=2),
    seen: ti.types.ndarray(ndim=4),
    mates: ti.types.ndarray(ndim=4),
    signals: ti.types.ndarray(ndim=3),
    state: ti.types.ndarray(ndim=3),
    derived: ti.types.ndarray(ndim=3),
    obstacles: ti.types.ndarray(ndim=3),
    env_world: ti.types.ndarray(dtype=ti.i64, ndim=1),
    envs: ti.types.ndarray(dtype=ti.i64, ndim=1),
    reach: float,
    radius: float,
    num_seen: ti.template(),
    num_mates: ti.template(),
    num_obstacles: ti.template(),
    axes: ti.template(),
):
    for row, i in ti.ndrange(envs.shape[0], state.shape[1]):
        e = envs[row]
        w = env_world[e]
        x, y, z = state[e, i, 0], state[e, i, 1], state[e, i, 2]
        nearest = x * 0.0 + reach
        distance = ti.Vector([nearest] * ti.static(num_seen + 1))
        index = ti.Vector([-1] * ti.static(num_seen + 1))
        margin = x * 0.0
        for m in range(num_obstacles):  # of fixed length and without branches: vectorised
            dx, dy, r = obstacles[w, 0, m] - x, obstacles[w, 1, m] - y, obstacles[w, 2, m] + reach
            margin = ti.min(margin, dx * dx + dy * dy - r * r)
        if margin < 0:  # something is in range, which is rare
            for m in range(num_obstacles):
                dx, dy, r = obstacles[w, 0, m] - x, obstacles[w, 1, m] - y, obstacles[w, 2, m]
                if dx * dx + dy * dy < (reach + r) * (reach + r):
                    d = cylinder_distance(dx, dy, -z, r, obstacles[w, 3, m])
                    nearest = ti.min(nearest, d - radius)
                    j = m
                    for k in ti.static(range(num_seen)):
                        if d < distance[k]:
                            d, distance[k] = distance[k], d
                            j, index[k] = index[k], j
        for k in ti.static(range(num_seen)):
            direction = ti.Vector([x * 0.0, x * 0.0, x * 0.0])
            spread = x * 0.0
            if index[k] >= 0:
                dx, dy = obstacles[w, 0, index[k]] - x, obstacles[w, 1, index[k]] - y
                inv = 1.0 / ti.max(ti.sqrt(dx * dx + dy * dy), 1e-6)
                direction = ti.Vector([dx * inv, dy * inv, 0.0])
                spread = ti.min(obstacles[w, 2, index[k]] * inv, 1.0)
            store_seen(seen, e, i, k, distance[k], direction)
            at = k * (axes + 2)
            store_signal(signals, e, i, at, ti.max(distance[k], 0.0), reach, direction, derived, axes)
            signals[e, i, at + axes + 1] = spread

        near = ti.Vector([x * 0.0 + reach] * ti.static(num_mates + 1))
        who = ti.Vector([-1] * ti.static(num_mates + 1))
        for m in range(state.shape[1]):
            if m != i:
                dx, dy, dz = state[e, m, 0] - x, state[e, m, 1] - y, state[e, m, 2] - z
                d = ti.sqrt(dx * dx + dy * dy + dz * dz)
                nearest = ti.min(nearest, d - 2 * radius)
                j = m
                for k in ti.static(range(num_mates)):
                    if d < near[k]:
                        d, near[k] = near[k], d
                        j, who[k] = who[k], j
        for k in ti.static(range(num_mates)):
            direction = ti.Vector([x * 0.0, x * 0.0, x * 0.0])
            if who[k] >= 0:
                m = who[k]
                offset = ti.Vector([state[e, m, 0] - x, state[e, m, 1] - y, state[e, m, 2] - z])
                direction = offset / ti.max(near[k], 1e-6)
            store_seen(mates, e, i, k, near[k], direction)
            at = num_seen * (axes + 2) + k * (axes + 1)
            store_signal(signals, e, i, at, near[k], reach, direction, derived, axes)
        gap[e, i] = nearest


class Sensor:
    """Senses for one team; results are overwritten by the next call.

    Attributes:
        gap: [env, vehicle] smallest clearance (m) between this vehicle's sphere of `radius` and any obstacle or
            team mate's sphere, at most `reach`; negative means contact.
        obstacles: [env, vehicle, k, 4] distance (m) to the k-th nearest obstacle's surface and the horizontal unit
            vector to its axis (NED); `reach` and zeros where there is none in range.
        team_mates: [env, vehicle, k, 4] likewise, of the k-th nearest team mate's origin.
        signals: [env, vehicle, n] all of it as a policy observes it, obstacles first: closeness 1 - d / reach, and
            the direction in the vehicle's own frame times closeness; zeros where there is nothing in range. An
            obstacle has one more, the sine of half the angle it fills: without its width nobody can tell whether a
            course clears it.
    """

    def __init__(
        self,
        team: HasState,
        num_obstacles: int,
        num_mates: int,
        reach: float,
        radius: float,
        frame: Literal["heading", "body"] = "heading",
    ):
        """Allocate for a team; `reach` and `radius` in m.

        A vehicle's own frame is its body frame (3 axes), or the heading frame (ahead, starboard), which stays level.
        """
        self.axes = 3 if frame == "body" else 2
        state = team.state
        env, vehicle = state.shape[:2]
        self.team, self.reach, self.radius = team, reach, radius
        self.num_obstacles, self.num_mates = num_obstacles, num_mates
        self.gap = state.new_zeros((env, vehicle))
        self.obstacles = state.new_zeros((env, vehicle, max(num_obstacles, 1), 4))
        self.team_mates = state.new_zeros((env, vehicle, max(num_mates, 1), 4))
        width = num_obstacles * (self.axes + 2) + num_mates * (self.axes + 1)
        self.signals = state.new_zeros((env, vehicle, width))
        self._signals = self.signals if width else state.new_zeros((env, vehicle, 1))  # kernels take no empty array
        self._all = torch.arange(env, device=state.device)
        self._field: torch.Tensor | None = None
        self._columns = state

    def sense(self, obstacles: torch.Tensor, env_world: torch.Tensor, envs: torch.Tensor | None = None) -> None:
        """Look around in environments `envs` (int64; default: all): `obstacles` [world, m, 4], `env_world` [env]."""
        if obstacles is not self._field:  # by column, so that the kernel reads whole vectors
            self._field, self._columns = obstacles, obstacles.transpose(1, 2).contiguous()
        _sense(
            self.gap, self.obstacles, self.team_mates, self._signals, self.team.state, self.team.derived,
            self._columns, env_world, self._all if envs is None else envs, self.reach, self.radius,
            self.num_obstacles, self.num_mates, obstacles.shape[1], self.axes,
        )  # fmt: skip
