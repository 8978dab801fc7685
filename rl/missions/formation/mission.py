"""The formation mission over many environments: what VecEnv, Gymnasium, evaluation and recording share."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from rl.missions.formation.endings import Endings
from rl.missions.formation.flyable import check_flyable, least_speed
from rl.missions.formation.slots import Target, lane_half_width
from rl.missions.formation.starts import PER_WORLD, draw_starts, in_wind
from rl.missions.formation.team import TeamTask
from rl.scene.obstacles import generate_obstacles
from rl.scene.tracks import TrackPoint, Tracks, generate_tracks
from rl.scene.wind_triangle import ground_speed
from rl.seeds import derive_seed
from taichi_sim import runtime
from taichi_sim.config import ConfigError, ScenarioConfig
from taichi_sim.conventions import TEAMS
from taichi_sim.world import World

TIME_SPAN = 3600.0  # s: an episode begins at a random time of its sea
TALLEST = 90.0  # m, of generated obstacles


class Step(NamedTuple):
    """What one decision brought; dictionaries are by team."""

    reward: dict[str, Tensor]  # [env, vehicle]
    endings: dict[str, Endings]  # [env, vehicle] flags
    terminated: Tensor  # [env]: some vehicle's episode ended by what happened
    truncated: Tensor  # [env]: time is up, and nothing happened


def generate_worlds(config: ScenarioConfig, seed: int) -> tuple[Tracks, Tensor]:
    """Tracks and generated obstacles [world, count, 4] of a scenario.

    Raises:
        ConfigError: if the scenario's sections track, obstacles and area leave no room for them.
    """
    track, cylinders = config.track, config.obstacles
    try:
        tracks = generate_tracks(
            track.worlds,
            derive_seed(seed, "tracks"),
            length_m=track.length,
            area_m=config.area,
            checkpoints=track.checkpoints,
            min_radius_m=track.min_radius,
        )
        obstacles = generate_obstacles(
            tracks,
            derive_seed(seed, "obstacles"),
            count=cylinders.count,
            lane_half_width_m=max(lane_half_width(t.formation, t.count, t.spacing) for t in (config.usv, config.uav)),
            clearance_m=(cylinders.clearance_min, cylinders.clearance_max),
            radius_m=(cylinders.radius_min, cylinders.radius_max),
            height_m=(5.0, max(TALLEST, track.flight_height + 30.0)),
            tall_fraction=cylinders.tall_fraction,
            flight_height_m=track.flight_height,
            area_m=config.area,
        )
    except ValueError as error:
        raise ConfigError(
            f"scenario {config.name!r}: the tracks (track.length = {track.length}, track.min_radius = "
            f"{track.min_radius}, area = {config.area}) or the obstacles do not fit: {error}"
        ) from None
    return tracks, obstacles


class FormationTask:
    """Both teams' mission in `num_envs` environments.

    Each environment is on one of the scenario's worlds (a track with obstacles) and one of its seas; `reset` draws
    both anew. `step` does not reset: the adapters decide when.

    Attributes:
        world: the simulated world. teams: name -> TeamTask, those simulated.
        env_world: int64 [env]. progress: [env] m along the track. steps: int64 [env] of the episode.
        wind_factor: mean wind at the flight height over that at 10 m.
    """

    def __init__(
        self,
        config: ScenarioConfig,
        num_envs: int,
        *,
        seed: int,
        teams: Sequence[str] = TEAMS,
        source: Path | None = None,
    ):
        """Generate worlds, seas and starts from `seed`, and reset every environment."""
        run = runtime.current()
        self.config, self.num_envs = config, num_envs
        self.world = World(config, num_envs, seed=derive_seed(seed, "sea"), teams=teams, source=source)
        self.generator = torch.Generator().manual_seed(derive_seed(seed, "episodes"))
        self.teams = {name: TeamTask(config, self.world, name) for name in teams}

        self.wind_factor = self.world.wind.speed_factor(config.track.flight_height)
        self._check_spacing()
        self._check_flyable()
        self.tracks, generated = generate_worlds(config, seed)
        fixed = torch.tensor([[o.north, o.east, o.radius, o.height] for o in config.obstacles.fixed]).reshape(-1, 4)
        both = torch.cat((generated, fixed.expand(self.tracks.worlds, -1, 4)), dim=1)
        radii = {name: team.radius for name, team in self.teams.items()}
        unstoppable = {name for name, team in self.teams.items() if least_speed(team.team.model) > 0}
        starts = draw_starts(config, self.tracks, both, radii, self.generator, unstoppable)
        self.tracks = self.tracks.to(run.device)  # all was drawn on the CPU: the same worlds on every device
        self.starts = starts.to(run.device)
        self.obstacles = both.to(run.device, run.torch_dtype).contiguous()
        if not self.obstacles.shape[1]:  # a kernel needs one row: put it out of every vehicle's reach
            far = self.obstacles.new_tensor([1e6, 1e6, 1.0, 1.0])
            self.obstacles = far.expand(self.tracks.worlds, 1, 4).contiguous()

        self.env_world = torch.zeros(num_envs, dtype=torch.int64, device=run.device)
        self.progress = torch.zeros(num_envs, device=run.device)
        self.steps = torch.zeros(num_envs, dtype=torch.int64, device=run.device)
        targets = self._targets(self.tracks.at(self.env_world, self.progress), self.world.wind.velocity)
        for name, team in self.teams.items():
            team.measure(targets[name])
        self.reset()

    def _check_spacing(self) -> None:
        for name, team in self.teams.items():
            if team.section.count > 1 and team.section.spacing <= 2 * team.radius:
                raise ConfigError(
                    f"{name}.spacing = {team.section.spacing}: must be above twice the vehicle's collision_radius, "
                    f"{2 * team.radius} m: neighbours would touch in their slots"
                )

    def _check_flyable(self) -> None:
        """Refuse a track that a team cannot follow in the wind of the scenario."""
        if self.config.track.speed_over == "air" and "uav" not in self.teams:
            raise ConfigError(
                f"track.speed_over = 'air': only {', '.join(self.teams)} is simulated, and nothing flies; it needs "
                "'ground'"
            )
        for name, team in self.teams.items():
            vehicle = f"{name}.vehicle = {team.section.vehicle!r}"
            check_flyable(self.config.track, self.config.air, vehicle, team.team.model)

    # -- one step, as a table of contents --------------------------------------------------------------------------

    def step(self, actions: Mapping[str, Tensor]) -> Step:
        """Advance one decision interval; `actions[team]` is [env, vehicle, action] in [-1, 1].

        Raises:
            ValueError: for a wrong shape or an action that is not finite; nothing has moved then.
        """
        taken = self.world.step(actions)
        self.progress += self._advance()
        self.steps += 1
        targets = self._targets(self.tracks.at(self.env_world, self.progress), self.world.wind.velocity)
        for name, team in self.teams.items():
            team.previous_action, team.action = team.action, taken[name]
            team.measure(targets[name])
            team.sense(self.obstacles, self.env_world)
        ended = {name: team.find_endings() for name, team in self.teams.items()}
        reward = {name: team.compute_reward(ended[name]) for name, team in self.teams.items()}
        terminated = torch.stack([e.any.any(dim=1) for e in ended.values()]).any(dim=0)
        truncated = (self.steps >= self.config.episode_steps) & ~terminated
        return Step(reward, ended, terminated, truncated)

    def observe(self) -> dict[str, Tensor]:
        """Observations [env, vehicle, n] by team, for the next decision."""
        return {name: team.observe() for name, team in self.teams.items()}

    # -- episodes --------------------------------------------------------------------------------------------------

    def reset(self, envs: Tensor | None = None, *, worlds: Tensor | None = None, starts: Tensor | None = None) -> None:
        """Begin new episodes in `envs` (default: all), on `worlds` from `starts` (default: random ones)."""
        if envs is None:
            envs = torch.arange(self.num_envs, device=self.env_world.device)
        n = len(envs)
        if n == 0:
            return
        worlds = self._draw(self.tracks.worlds, n) if worlds is None else worlds
        starts = self._draw(PER_WORLD, n) if starts is None else starts
        self.env_world[envs] = worlds
        self.progress[envs] = self.starts.progress[worlds, starts]
        self.steps[envs] = 0
        self.world.env_sea[envs] = self._draw(self.world.sea.num_seas, n).to(torch.int32)
        begin = torch.rand(n, generator=self.generator, dtype=torch.float64) * TIME_SPAN
        self.world.time[envs] = begin.to(self.world.time.device)
        self.world.renew(envs)
        wind = self.world.wind.velocity.index_select(0, envs)
        targets = self._targets(self.tracks.at(worlds, self.progress.index_select(0, envs)), wind)
        for name, team in self.teams.items():
            state = self.starts.states[name][worlds, starts].to(team.team.state)
            if self.config.track.speed_over == "air":
                state = in_wind(
                    state, self._aloft(wind), targets[name], self.config.track.target_speed, team.team.model
                )
            self.world.place(name, envs, state)
            team.restart(envs, targets[name])
            team.sense(self.obstacles, self.env_world, envs)

    def reseed(self, seed: int) -> None:
        """Make the draws of later resets depend on `seed` alone; worlds, seas and starts stay."""
        self.generator.manual_seed(derive_seed(seed, "episodes"))

    def _draw(self, limit: int, n: int) -> Tensor:
        return torch.randint(limit, (n,), generator=self.generator).to(self.env_world.device)

    def _advance(self) -> Tensor | float:
        """How far (m, [env]) the targets move along their tracks in the coming interval."""
        if self.config.track.speed_over == "ground":
            return self.config.track.target_speed * self.config.decision_interval
        return next(iter(self.teams.values())).target.speed * self.config.decision_interval

    def _aloft(self, wind: Tensor) -> Tensor:
        """Wind [env, 2] at the flight height, of `wind` [env, 3] at 10 m, its slow variation included."""
        return wind[:, :2] * self.wind_factor

    def _targets(self, place: TrackPoint, wind: Tensor) -> dict[str, Target]:
        """The target of each team at a place of the track in the wind [env, 3] (10 m above the sea): on the sea, and
        straight above at the flight height.
        """
        track, cos, sin = self.config.track, place.course.cos(), place.course.sin()
        if track.speed_over == "ground":
            course_rate, speed = place.curvature * track.target_speed, torch.full_like(cos, track.target_speed)
        else:
            speed = ground_speed(track.target_speed, self._aloft(wind), cos, sin).to(cos)
            course_rate = place.curvature * speed
        ground = Target(
            position=torch.nn.functional.pad(place.position, (0, 1)),
            course=place.course,
            cos=cos,
            sin=sin,
            course_rate=course_rate,
            speed=speed,
        )
        above = ground.position - ground.position.new_tensor([0.0, 0.0, track.flight_height])
        return {"usv": ground, "uav": ground._replace(position=above)}
