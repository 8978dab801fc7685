"""One team's side of the mission: errors, sensing, observations, rewards and endings of its vehicles."""

import torch
from torch import Tensor

from rl.missions.formation import endings, observations, rewards
from rl.missions.formation.endings import Endings
from rl.missions.formation.geometry import Geometry, geometry, to_body
from rl.missions.formation.slots import Target, formation_offsets
from rl.scene.sensors import Sensor
from taichi_sim.config import ScenarioConfig
from taichi_sim.world import World


class TeamTask:
    """Measures one team after each step; everything is [env, vehicle, ...].

    Attributes:
        team: the simulated team (state, velocities, attitude). target: what its leader tracks.
        now: errors as of the last step or reset (geometry.py). previous_sight: what was seen one step earlier.
        action, previous_action: of the last two steps. sensor: surroundings.
    """

    def __init__(self, config: ScenarioConfig, world: World, name: str):
        """Prepare team `name` of `world`."""
        self.config, self.section, self.name = config, config.team(name), name
        self.world, self.team = world, world.teams[name]
        state = self.team.state
        self.axes = 2 if name == "usv" else 3
        self.action_names = self.team.model.action_names
        self.radius = self.team.model.params.collision_radius
        offsets = formation_offsets(self.section.formation, self.section.count, self.section.spacing)
        self.offsets = offsets.to(state)
        sensing = config.sensing
        mates = min(sensing.team_mates, self.section.count - 1)
        frame = "body" if self.axes == 3 else "heading"
        self.sensor = Sensor(self.team, sensing.obstacles, mates, sensing.detection_range, self.radius, frame)
        envs, count = state.shape[:2]
        self.action = state.new_zeros((envs, count, len(self.action_names)))
        self.previous_action = self.action
        self.role = observations.role(count, envs, state)
        self.target: Target
        self.now: Geometry
        self.previous_sight: Tensor
        self._measured = False

    # -- measuring ------------------------------------------------------------------------------------------------

    def measure(self, target: Target) -> None:
        """Read the world after a step: slots and errors; what was seen becomes what was seen before."""
        before = self.now.sight if self._measured else None
        self.target, self._measured = target, True
        self.now = geometry(self.team.position_n, self.team.derived, target, self.offsets, self.axes)
        self.previous_sight = self.now.sight if before is None else before

    def restart(self, envs: Tensor, target: Target) -> None:
        """Environments `envs` [n] have begun anew, with `target` of those: forget their past."""
        state, derived = self.team.state.index_select(0, envs), self.team.derived.index_select(0, envs)
        fresh = geometry(state[..., :3], derived, target, self.offsets, self.axes)
        self.now = Geometry(*(old.index_copy(0, envs, new) for old, new in zip(self.now, fresh, strict=True)))
        self.target = Target(*(old.index_copy(0, envs, new) for old, new in zip(self.target, target, strict=True)))
        self.previous_sight = self.previous_sight.index_copy(0, envs, fresh.sight)
        self.action = self.action.index_fill(0, envs, 0.0)  # not in place: it may be a caller's tensor

    def sense(self, obstacles: Tensor, env_world: Tensor, envs: Tensor | None = None) -> None:
        """Look around for obstacles [world, m, 4] and team mates, in environments `envs` (default: all)."""
        self.sensor.sense(obstacles, env_world, envs)

    @property
    def distance(self) -> Tensor:
        """Distance (m) of each vehicle from its slot: the leader's tracking error, a follower's formation error."""
        return self.now.distance

    # -- terms ----------------------------------------------------------------------------------------------------

    def find_endings(self) -> Endings:
        """Which vehicles' episodes terminate, and why."""
        team, model = self.team, self.team.model
        common = {
            "collided": endings.collided(self.sensor.gap),
            "lost": endings.lost(self.distance, self.section.lost_distance),
            "left": endings.outside(team.position_n, self.config.area),
            "diverged": endings.diverged(team.state, self.distance),
        }
        if self.name == "uav":
            height = endings.lowest_point(team.position_n, team.derived, model.params.size[1])
            crashed = endings.in_the_sea(height, self.world.elevation_below(team, height))
            return endings.UavEndings(crashed=crashed, stalled=endings.stalled(self._stall_time()), **common)
        return endings.UsvEndings(
            capsized=endings.capsized(team.quaternion_nb, model.capsize_cosine),
            swamped=endings.swamped(team.position_n, team.surface, model.deck_height),
            grounded=endings.grounded(team.position_n, model.draft, self.config.sea.depth),
            **common,
        )

    def _stall_time(self) -> Tensor:
        """Time (s) [env, vehicle] since each aircraft stalled; 0 of models that cannot stall."""
        return self._read("stall_time") if "stall_time" in self._readings() else torch.zeros_like(self.distance)

    def _readings(self) -> tuple[str, ...]:
        """What the vehicles' own instruments show; none of models without."""
        return getattr(self.team.model, "aux_names", ())

    def _read(self, name: str) -> Tensor:
        """One of them [env, vehicle], as of the last step."""
        return self.team.aux[..., self._readings().index(name)]

    def compute_reward(self, ended: Endings) -> Tensor:
        """Reward [env, vehicle] of the last step; -1 for a vehicle that has diverged."""
        if self.config.reward == "paper":
            reward = self._paper_reward() + rewards.penalty(ended.collided)
        else:
            reward = self._tracking_reward(ended)
        return reward.masked_fill(ended.diverged, -1.0)

    def _tracking_reward(self, ended: Endings) -> Tensor:
        w, d = self.section.tracking_reward, self.now.distance
        return (
            w.coarse * rewards.coarse(d, w.coarse_scale)
            + w.fine * rewards.fine(d, w.fine_scale)
            + w.approach * rewards.approach(d)
            + w.action_rate * rewards.action_rate(self.action, self.previous_action)
            + w.clearance * rewards.clearance(self.sensor.gap, w.clearance_range)
            + w.ending * rewards.penalty(ended.any)
        )

    def _paper_reward(self) -> Tensor:
        d, derived = self.now.distance, self.team.derived
        forward = derived[..., 0:9:3][..., : self.axes]  # the nose, in n
        direction = self.now.error[..., : self.axes] / d.clamp(min=1e-3).unsqueeze(-1)
        toward = (forward * direction).sum(-1)
        along = forward[..., 0] * self.target.cos.unsqueeze(1) + forward[..., 1] * self.target.sin.unsqueeze(1)
        if self.name == "usv":
            return rewards.paper_usv(d, toward, along)
        leader = rewards.paper_uav_leader(d[:, :1], toward[:, :1], along[:, :1])
        return torch.cat((leader, rewards.paper_uav_follower(d[:, 1:])), dim=1)

    def observe(self) -> Tensor:
        """Observations [env, vehicle, n] for the next decision: a fresh tensor each time."""
        parts = [self.now.sight, self.previous_sight, self.sensor.signals]
        if self.config.observations == "full":
            parts += self._full_terms()
        return torch.cat(parts, dim=-1)

    def _full_terms(self) -> list[Tensor]:
        o, team, target = observations, self.team, self.target
        turn = (target.course_rate * (1 / o.TURN_SCALE)).view(-1, 1, 1).expand(*self.distance.shape, 1)
        return [
            o.squash(self.now.error_b, o.DISTANCE_SCALE),
            o.squash(self.now.error_rate_b, o.SPEED_SCALE),
            o.squash(team.velocity_b, o.SPEED_SCALE),
            team.derived[..., 6:9],  # the world's down in b: roll and pitch without a jump
            team.angular_velocity_b * (1 / o.RATE_SCALE),
            self.now.course_b,
            turn,
            self.action,
            self.role,
            *self._air_terms(),
        ]

    def _air_terms(self) -> list[Tensor]:
        """What an aircraft in wind steers by: its airspeed within the range it can fly, and the wind in b."""
        if "airspeed" not in self._readings():
            return []
        low, cruise, high = self.team.model.speed_range
        wind = torch.stack([self._read(f"wind_{axis}") for axis in ("north", "east", "down")], dim=-1)
        wind_b = to_body(wind.unsqueeze(-2), self.team.derived, self.axes).squeeze(-2)
        airspeed = (self._read("airspeed") - cruise) * (2 / (high - low))
        return [airspeed.unsqueeze(-1), observations.squash(wind_b, observations.SPEED_SCALE)]
