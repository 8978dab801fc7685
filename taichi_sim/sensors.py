"""What a vehicle senses within its detection range: the nearest obstacles and the nearest team mates.

An obstacle is a vertical cylinder standing on the sea: (north, east, radius, height). Its distance to a vehicle's
origin is that to the nearest point of the cylinder's surface: horizontal beside it, vertical above its top.
"""

import taichi as ti
import torch


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
    obstacles: ti.types.ndarray(ndim=3),
    env_world: ti.types.ndarray(dtype=ti.i64, ndim=1),
    reach: float,
    radius: float,
    num_seen: ti.template(),
    num_mates: ti.template(),
):
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        w = env_world[e]
        x, y, z = state[e, i, 0], state[e, i, 1], state[e, i, 2]
        nearest = x * 0.0 + reach
        distance = ti.Vector([nearest] * ti.static(num_seen + 1))
        index = ti.Vector([-1] * ti.static(num_seen + 1))
        for m in range(obstacles.shape[1]):
            dx, dy = obstacles[w, m, 0] - x, obstacles[w, m, 1] - y
            r = obstacles[w, m, 2]
            if dx * dx + dy * dy < (reach + r) * (reach + r):
                d = cylinder_distance(dx, dy, -z, r, obstacles[w, m, 3])
                nearest = ti.min(nearest, d - radius)
                j = m
                for k in ti.static(range(num_seen)):
                    if d < distance[k]:
                        d, distance[k] = distance[k], d
                        j, index[k] = index[k], j
        for k in ti.static(range(num_seen)):
            seen[e, i, k, 0], seen[e, i, k, 1], seen[e, i, k, 2] = distance[k], 0.0, 0.0
            if index[k] >= 0:
                dx, dy = obstacles[w, index[k], 0] - x, obstacles[w, index[k], 1] - y
                inv = 1.0 / ti.max(ti.sqrt(dx * dx + dy * dy), 1e-6)
                seen[e, i, k, 1], seen[e, i, k, 2] = dx * inv, dy * inv

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
            mates[e, i, k, 0] = near[k]
            for a in ti.static(range(3)):
                mates[e, i, k, 1 + a] = 0.0
                if who[k] >= 0:
                    mates[e, i, k, 1 + a] = (state[e, who[k], a] - state[e, i, a]) / ti.max(near[k], 1e-6)
        gap[e, i] = nearest


class Sensor:
    """Senses for one team; results are overwritten by the next call.

    Attributes:
        gap: [env, vehicle] smallest clearance (m) between this vehicle's sphere of `radius` and any obstacle or
            team mate's sphere, at most `reach`; negative means contact.
        obstacles: [env, vehicle, k, 3] distance (m) to the k-th nearest obstacle's surface and the horizontal unit
            vector (north, east) to its axis; `reach` and zeros where there is none in range.
        team_mates: [env, vehicle, k, 4] distance (m) and unit vector (NED) to the k-th nearest; likewise.
    """

    def __init__(self, state: torch.Tensor, num_obstacles: int, num_mates: int, reach: float, radius: float):
        """Allocate for a team's `state` [env, vehicle, 13]; `reach` and `radius` in m."""
        env, vehicle = state.shape[:2]
        self.state, self.reach, self.radius = state, reach, radius
        self.num_obstacles, self.num_mates = num_obstacles, num_mates
        self.gap = state.new_zeros((env, vehicle))
        self.obstacles = state.new_zeros((env, vehicle, max(num_obstacles, 1), 3))
        self.team_mates = state.new_zeros((env, vehicle, max(num_mates, 1), 4))

    def sense(self, obstacles: torch.Tensor, env_world: torch.Tensor) -> None:
        """Look around: `obstacles` [world, m, 4], `env_world` int64 [env]."""
        _sense(
            self.gap, self.obstacles, self.team_mates, self.state, obstacles, env_world,
            self.reach, self.radius, self.num_obstacles, self.num_mates,
        )  # fmt: skip
