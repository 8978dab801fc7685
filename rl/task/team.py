"""One team's side of the mission: errors, sensing, observations, rewards and endings of its vehicles."""

import torch
from torch import Tensor

from rl.task import endings, observations, rewards
from rl.task.endings import Endings
from rl.task.slots import Slots, Target, formation_offsets, slots
from taichi_sim.config import ScenarioConfig
from taichi_sim.maths.rotation import torch_rotation_matrix
from taichi_sim.sensors import Sensor
from taichi_sim.world import World


class TeamTask:
    """Measures one team after each step; everything is [env, vehicle, ...].

    Attributes:
        error: slot minus position, NED; its first `axes` components count (2 for USVs, 3 for UAVs), m.
        distance: norm of that error, m: the tracking error of a leader, the formation error of a follower.
        slots, target: what was tracked. endings: why vehicles stopped. reward: of the last step.
    """

    def __init__(self, config: ScenarioConfig, world: World, name: str):
        """Prepare team `name` of `world`."""
        self.config, self.section, self.name = config, config.team(name), name
        self.team = world.teams[name]
        state = self.team.state
        self.axes = 2 if name == "usv" else 3
        self.action_names = self.team.model.action_names
        self.radius = self.team.model.params.collision_radius
        offsets = formation_offsets(self.section.formation, self.section.count, self.section.spacing)
        self.offsets = offsets.to(state)
        sensing = config.sensing
        mates = min(sensing.team_mates, self.section.count - 1)
        self.sensor = Sensor(state, sensing.obstacles, mates, sensing.detection_range, self.radius)
        envs, count = state.shape[:2]
        self.action = state.new_zeros((envs, count, len(self.action_names)))
        self.previous_action = self.action
        self.distance, self.previous_distance = state.new_zeros((2, envs, count))
        self.direction_b, self.previous_direction_b = state.new_zeros((2, envs, count, self.axes))
        self.role = observations.role(count, envs, state)

    # -- measuring ------------------------------------------------------------------------------------------------

    def measure(
        self, target: Target, obstacles: Tensor, env_world: Tensor, fresh: Tensor | None = None
    ) -> None:
        """Read the world: slots, errors, surroundings.

        After a step `fresh` is None. After a reset it holds the environments [n] that have just begun: only their
        past is rewritten (the previous distance and direction become those of now).
        """
        state = self.team.state
        self.target = target
        self.R_nb = torch_rotation_matrix(self.team.quaternion_nb)
        self.velocity_n = (self.R_nb @ self.team.velocity_b.unsqueeze(-1)).squeeze(-1)
        self.slots: Slots = slots(target, state[:, 0, :3], self.velocity_n[:, 0], self.offsets)
        self.error = self.slots.position - state[..., :3]
        self.error_rate = self.slots.velocity - self.velocity_n
        if fresh is None:
            self.previous_distance, self.previous_direction_b = self.distance, self.direction_b
        self.distance = torch.linalg.vector_norm(self.error[..., : self.axes], dim=-1)
        self.error_b = self.to_body(self.error)
        self.direction_b = self.error_b / self.distance.clamp(min=1e-3).unsqueeze(-1)
        if fresh is not None:
            self.previous_distance[fresh] = self.distance[fresh]
            self.previous_direction_b[fresh] = self.direction_b[fresh]
        self.sensor.sense(obstacles, env_world)

    def restart(self, envs: Tensor) -> None:
        """Forget the last action in environments `envs`."""
        self.action = self.action.clone()  # the last one may be a caller's tensor
        self.action[envs] = 0.0

    def to_body(self, vector_n: Tensor) -> Tensor:
        """NED vectors [env, vehicle, 3] in the body frame; for USVs, two components in the heading frame."""
        if self.axes == 3:
            return (self.R_nb.transpose(-1, -2) @ vector_n.unsqueeze(-1)).squeeze(-1)
        c, s = self.heading
        north, east = vector_n[..., 0], vector_n[..., 1]
        return torch.stack((c * north + s * east, c * east - s * north), dim=-1)

    @property
    def heading(self) -> tuple[Tensor, Tensor]:
        """Cosine and sine [env, vehicle] of the heading."""
        c, s = self.R_nb[..., 0, 0], self.R_nb[..., 1, 0]
        norm = torch.sqrt(c * c + s * s).clamp(min=1e-6)
        return c / norm, s / norm

    # -- terms ----------------------------------------------------------------------------------------------------

    def find_endings(self) -> Endings:
        """Which vehicles' episodes terminate, and why."""
        team = self.team
        crash = endings.capsized(team.quaternion_nb) if self.name == "usv" else endings.in_the_sea(team.position_n)
        return Endings(
            collided=endings.collided(self.sensor.gap),
            lost=endings.lost(self.distance, self.section.lost_distance),
            crashed=crash,
            left=endings.outside(team.position_n, self.config.area),
        )

    def compute_reward(self, ended: Endings) -> Tensor:
        """Reward [env, vehicle] of the last step."""
        if self.config.reward == "paper":
            return self._paper_reward() + rewards.collision(ended.collided)
        w, d = self.section.tracking_reward, self.distance
        return (
            w.coarse * rewards.coarse(d, w.coarse_scale)
            + w.fine * rewards.fine(d, w.fine_scale)
            + w.approach * rewards.approach(d)
            + w.action_rate * rewards.action_rate(self.action, self.previous_action)
            + w.clearance * rewards.clearance(self.sensor.gap, w.clearance_range)
            + w.collision * rewards.collision(ended.any)
        )

    def _paper_reward(self) -> Tensor:
        forward = self.R_nb[..., : self.axes, 0]
        direction = self.error[..., : self.axes] / self.distance.clamp(min=1e-3).unsqueeze(-1)
        toward = (forward * direction).sum(-1)
        along = forward[..., 0] * self.target.cos.unsqueeze(1) + forward[..., 1] * self.target.sin.unsqueeze(1)
        if self.name == "usv":
            return rewards.paper_usv(self.distance, toward, along)
        leader = rewards.paper_uav_leader(self.distance[:, :1], toward[:, :1], along[:, :1])
        return torch.cat((leader, rewards.paper_uav_follower(self.distance[:, 1:])), dim=1)

    def observe(self) -> Tensor:
        """Observations [env, vehicle, n] for the next decision: a fresh tensor each time."""
        sensor, o = self.sensor, observations
        parts = [
            o.range_and_direction(self.distance, self.direction_b),
            o.range_and_direction(self.previous_distance, self.previous_direction_b),
        ]
        if sensor.num_obstacles:
            direction = self._sensed_to_body(sensor.obstacles[..., 1:3])
            parts.append(o.closeness(sensor.obstacles[..., 0] - self.radius, direction, sensor.reach))
        if sensor.num_mates:
            direction = self._sensed_to_body(sensor.team_mates[..., 1:4])
            parts.append(o.closeness(sensor.team_mates[..., 0] - self.radius, direction, sensor.reach))
        if self.config.observations == "full":
            parts += self._full_terms()
        return torch.cat(parts, dim=-1)

    def _full_terms(self) -> list[Tensor]:
        o, team = observations, self.team
        c, s = self.heading
        tc, ts = self.target.cos.unsqueeze(1), self.target.sin.unsqueeze(1)
        course = torch.stack((c * tc + s * ts, c * ts - s * tc), dim=-1)
        turn = self.target.course_rate.unsqueeze(1).unsqueeze(2).expand(*self.distance.shape, 1)
        return [
            o.squash(self.error_b, o.DISTANCE_SCALE),
            self.to_body(self.error_rate) * (1 / o.SPEED_SCALE),
            team.velocity_b * (1 / o.SPEED_SCALE),
            self.R_nb[..., 2, :],
            team.angular_velocity_b * (1 / o.RATE_SCALE),
            course,
            turn * 10.0,
            self.action,
            self.role,
        ]

    def _sensed_to_body(self, direction_n: Tensor) -> Tensor:
        """Directions [env, vehicle, k, 2 or 3] in the frame of `to_body` (horizontal ones in the heading frame)."""
        c, s = (a.unsqueeze(-1) for a in self.heading)
        north, east = direction_n[..., 0], direction_n[..., 1]
        parts = [c * north + s * east, c * east - s * north]
        if self.axes == 3 and direction_n.shape[-1] == 3:
            parts.append(direction_n[..., 2])
        return torch.stack(parts, dim=-1)
