"""What a vehicle senses within its detection range: the nearest obstacles and the nearest team mates.

An obstacle is a vertical cylinder standing on the sea: (north, east, radius, height). Its distance to a vehicle's
origin is that to the nearest point of the cylinder's surface: horizontal beside it, vertical above its top.
"""

from typing import Protocol

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


@ti.kernel
def _sense(
    gap: ti.types.ndarray(ndim=2),
    seen: ti.types.ndarray(ndim=4),
    mates: ti.types.ndarray(ndim=4),
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
):
    for row, i in ti.ndrange(envs.shape[0], state.shape[1]):
        e = envs[row]
        w = env_world[e]
        x, y, z = state[e, i, 0], state[e, i, 1], state[e, i, 2]
        c, s = derived[e, i, 12], derived[e, i, 13]
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
            north, east = x * 0.0, x * 0.0
            if index[k] >= 0:
                dx, dy = obstacles[w, 0, index[k]] - x, obstacles[w, 1, index[k]] - y
                inv = 1.0 / ti.max(ti.sqrt(dx * dx + dy * dy), 1e-6)
                north, east = dx * inv, dy * inv
            seen[e, i, k, 0], seen[e, i, k, 1], seen[e, i, k, 2] = distance[k], north, east
            seen[e, i, k, 3], seen[e, i, k, 4] = c * north + s * east, c * east - s * north

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
            north, east = direction[0], direction[1]
            mates[e, i, k, 0], mates[e, i, k, 1], mates[e, i, k, 2] = near[k], north, east
            mates[e, i, k, 3], mates[e, i, k, 4] = c * north + s * east, c * east - s * north
            mates[e, i, k, 5] = direction[2]
        gap[e, i] = nearest


class Sensor:
    """Senses for one team; results are overwritten by the next call.

    Attributes:
        gap: [env, vehicle] smallest clearance (m) between this vehicle's sphere of `radius` and any obstacle or
            team mate's sphere, at most `reach`; negative means contact.
        obstacles: [env, vehicle, k, 5] distance (m) to the k-th nearest obstacle's surface, the horizontal unit
            vector to its axis (north, east), and the same in the heading frame (ahead, starboard); `reach` and
            zeros where there is none in range.
        team_mates: [env, vehicle, k, 6] distance (m) and unit vector to the k-th nearest: north, east; ahead,
            starboard; down. Likewise.
    """

    def __init__(self, team: HasState, num_obstacles: int, num_mates: int, reach: float, radius: float):
        """Allocate for a team; `reach` and `radius` in m."""
        state = team.state
        env, vehicle = state.shape[:2]
        self.team, self.reach, self.radius = team, reach, radius
        self.num_obstacles, self.num_mates = num_obstacles, num_mates
        self.gap = state.new_zeros((env, vehicle))
        self.obstacles = state.new_zeros((env, vehicle, max(num_obstacles, 1), 5))
        self.team_mates = state.new_zeros((env, vehicle, max(num_mates, 1), 6))
        self._all = torch.arange(env, device=state.device)
        self._field: torch.Tensor | None = None
        self._columns = state

    def sense(self, obstacles: torch.Tensor, env_world: torch.Tensor, envs: torch.Tensor | None = None) -> None:
        """Look around in environments `envs` (int64; default: all): `obstacles` [world, m, 4], `env_world` [env]."""
        if obstacles is not self._field:  # by column, so that the kernel reads whole vectors
            self._field, self._columns = obstacles, obstacles.transpose(1, 2).contiguous()
        _sense(
            self.gap, self.obstacles, self.team_mates, self.team.state, self.team.derived, self._columns, env_world,
            self._all if envs is None else envs, self.reach, self.radius, self.num_obstacles, self.num_mates,
            obstacles.shape[1],
        )  # fmt: skip
