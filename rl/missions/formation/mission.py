"""The formation mission: every team holds formation behind a target that moves along a track.

Each environment is on one of the scenario's worlds (a track with obstacles) and one of its seas; an episode draws both
anew. Targets of vessels move on the sea, those of aircraft straight above them at the flight height.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from rl.guidance.course.obstacles import ROWS, Bodies
from rl.guidance.targets_and_errors import Targets
from rl.mission import Frame, Histories, Mission
from rl.missions.formation.config import FormationScenario
from rl.missions.formation.judge import FormationJudge
from rl.missions.formation.team import TeamTask
from rl.missions.formation.worlds import PER_WORLD, check_teams, draw_starts, draw_traffic, generate_worlds, in_wind
from rl.perception.radio import RadioConfig
from rl.perception.tracked_objects import SensorsConfig
from rl.planning.planner import write_obstacles_as_bodies
from rl.step import BEGINS, Due
from taichi_sim.config import AirConfig, SeaConfig
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import DOWN
from taichi_sim.state.snapshot import transfer
from taichi_sim.visualisation.recording.episode import Episode, Scene

OUT_OF_RANGE = 1e6  # m: further than any vehicle
CALM = {"hs": 0.0, "tp": 4.0, "components": 1, "realisations": 1}  # sea of the honest planner's model


class Formation(Mission[FormationScenario, TeamTask]):
    """Teams in formation; see the module.

    Attributes:
        tracks, obstacles, starts: of every world; obstacles [world, n, 4] north, east, radius, height, m.
        bodies: moving obstacles (rl/guidance/course/obstacles.py).
        fences: geofences of the route, if it has some. env_world: int64 [env], world of each environment.
        targets: of the leaders, by their pace.
        wind_factor: mean wind at the flight height over that at 10 m.
    """

    Config = FormationScenario
    Team = TeamTask
    Judge = FormationJudge

    def make_teams(self, names: Sequence[str]) -> dict[str, TeamTask]:
        """Generate worlds, starts and targets, then the teams that follow these."""
        run, config = runtime.current(), self.config
        self.wind_factor = self.world.wind.speed_factor(config.track.flight_height)
        models = {name: self.world.teams[name].model for name in names}
        check_teams(config, models)
        self.tracks, generated, route = generate_worlds(config, self.seed)
        self.origin, fences = (route.origin, route.fences) if route else (None, ())
        self.fences = [fence._replace(corners=fence.corners.to(run.device, run.torch_dtype)) for fence in fences]
        fixed = torch.tensor([[o.north, o.east, o.radius, o.height] for o in config.obstacles.fixed]).reshape(-1, 4)
        both = torch.cat((generated, fixed.expand(self.tracks.worlds, -1, 4)), dim=1)
        starts = draw_starts(config, self.tracks, both, models, self.generator)
        pool = draw_traffic(config, self.tracks, starts, both, models, self.generator)
        # all was drawn on the CPU: the same worlds on every device
        self.tracks = self.tracks.to(run.device, run.torch_dtype)
        self.starts = starts.to(run.device, run.torch_dtype)
        self.bodies = self.remember(Bodies(self.num_envs, pool.to(run.device, run.torch_dtype)))
        if not both.shape[1]:  # a kernel needs one row: put it out of every vehicle's reach
            both = both.new_tensor([1e6, 1e6, 1.0, 1.0]).expand(self.tracks.worlds, 1, 4)
        self.obstacles = both.to(run.device, run.torch_dtype).contiguous()
        self.env_world = self.remember(torch.zeros(self.num_envs, dtype=torch.int64, device=run.device))
        self.targets = self.remember({
            pace: Targets(
                self.tracks, self.env_world, self.world.wind.velocity, speed=pace.speed,
                interval=config.decision_interval, wind_factor=self.wind_factor, over_air=pace.over == "air",
            )
            for pace in map(config.pace, names)
        })  # fmt: skip
        kinds = self.kinds(config)
        return {name: kinds[name](self, name, self.targets[config.pace(name)]) for name in names}

    # -- one step --------------------------------------------------------------------------------------------------

    def move(self, due: Due) -> None:
        """Move targets, bodies and slots."""
        for targets in self.targets.values():
            targets.move(due)
        self.bodies.move(self.config.decision_interval, self.world.current.velocity)
        for team in self.teams.values():
            team.slots.advance(self.steps)

    # -- episodes --------------------------------------------------------------------------------------------------

    def begin(self, envs: Tensor, *, worlds: Tensor | None = None, starts: Tensor | None = None) -> None:
        """Place teams in environments `envs` on `worlds` from `starts`, each int64 [n] (default: random ones)."""
        n = len(envs)
        worlds = self.draw(self.tracks.worlds, n) if worlds is None else worlds
        starts = self.draw(PER_WORLD, n) if starts is None else starts
        self.env_world[envs] = worlds
        for targets in self.targets.values():
            targets.progress[envs] = self.starts.progress[worlds, starts]
            targets.move(self.due)
        self.bodies.begin(envs, worlds, starts, self.world.current.velocity)
        aloft = self.world.wind.velocity.index_select(0, envs)[:, :2] * self.wind_factor  # at the flight height
        for name, team in self.teams.items():
            state = self.starts.states[name][worlds, starts].to(team.fleet.state)
            pace = self.config.pace(name)
            if pace.over == "air":
                state = in_wind(state, aloft, team.target.speed[envs, 0], pace.speed, team.fleet.model)
            self.world.place(name, envs, state)
            team.slots.begin(envs, self.starts.formations[name].at(worlds, starts), self.generator)

    @classmethod
    def one_each(cls, config: FormationScenario, episodes: int) -> FormationScenario:
        """One world and one sea for each episode."""
        config = super().one_each(config, episodes)
        return config.model_copy(update={"track": config.track.model_copy(update={"worlds": episodes})})

    def begin_each(self) -> None:
        """Begin environment e on world e and sea e."""
        seas = self._all % self.world.sea.num_seas
        self.reset(seas=seas, worlds=self._all, starts=torch.zeros_like(self._all))

    # -- what others ask -------------------------------------------------------------------------------------------

    def imagined(self, team: TeamTask) -> Mission:
        """Make an `ImaginedFormation` for the model of `team`, with the same classes of teams."""
        config = imagined_scenario(self.config, team.name)
        kind = type("Imagined", (ImaginedFormation,), {"Teams": self.Teams, "Team": self.Team})
        return kind(config, self.num_envs, seed=self.seed, teams=(team.name,), source=self.source)

    @classmethod
    def piloted(cls, config: FormationScenario, team: str) -> FormationScenario:
        """One track; no sea, no obstacles but fixed ones; sensors and radio without errors."""
        section = config.formations[team].model_copy(update={"vary": {}})
        radio = config.radio and RadioConfig(range=OUT_OF_RANGE)
        track = config.track.model_copy(update={"worlds": 1})
        fixed = config.obstacles.model_copy(update={"count": 0})
        keep = {"radio": radio, "track": track, "obstacles": fixed, team: section}
        return imagined_scenario(config, team).model_copy(update=keep)

    def course(self, team: TeamTask) -> tuple[Tensor, Tensor]:
        """The target of its leader, and the track's course there."""
        return team.target.position[:, :2], team.target.course[:, 0]

    def join(self, team: TeamTask, place: Tensor) -> None:
        """Put the target where the track is nearest to `place`."""
        world = int(self.env_world[0])
        nearest = (self.tracks.table[world, :, :2] - place).norm(dim=-1).argmin()
        team.targets.progress[:] = nearest * self.tracks.length_m[world] / self.tracks.samples
        self._all_are(BEGINS)
        team.targets.move(self.due)

    def frame(self, env: int) -> Frame:
        """Targets, slots and errors of the teams, slots of vessels at mean sea level; traffic as cylinders."""
        rows = {name: self._row(team, env) for name, team in self.teams.items()}
        return Frame(rows, self.bodies.cylinders(env, self.config.area))

    @staticmethod
    def _row(team: TeamTask, env: int) -> dict[str, Tensor]:
        slot = team.now.slot[env].clone()
        if team.fleet.model.medium == "water":
            slot[:, DOWN] = 0.0
        target = {"target_n": team.target.position[env], "target_course": team.target.course[env, 0]}
        return target | {"slot_n": slot, "error_m": team.distance[env]}

    def scene(self, env: int) -> Scene:
        """The track at the heights of the teams, its checkpoints, and the obstacles inside the area."""
        world = int(self.env_world[env])
        track = self.tracks.table[world, :, :2].cpu().numpy()
        flown = self.config.track.flight_height
        heights = {name: flown if team.fleet.model.medium == "air" else 0.0 for name, team in self.teams.items()}
        obstacles = self.obstacles[world].cpu().numpy()
        half = self.config.area / 2
        return Scene(
            area_m=self.config.area,
            tracks_n={name: np.column_stack((track, np.full(len(track), -heights[name]))) for name in self.teams},
            checkpoints_n=self.tracks.checkpoints[world].cpu().numpy(),
            obstacles=obstacles[np.abs(obstacles[:, :2]).max(axis=1) <= half],
        )

    @classmethod
    def draw_figures(cls, out: Path, histories: Histories, episode: Episode | None, config: FormationScenario) -> None:
        """Draw the figures of the seed paper."""
        from rl.missions.formation.figures import write_figures  # matplotlib takes a second

        write_figures(out, histories, episode, config.evaluation.settle)


def imagined_scenario(config: FormationScenario, name: str) -> FormationScenario:
    """The scenario of the model of team `name`."""
    current = config.sea.current and config.sea.current.model_copy(update={"std": 0.0})
    steady = {"std": 0.0, "turbulence": "none", "gust": None}
    obstacles = config.obstacles.model_copy(update={"count": 0, "fixed": ()})
    section = config.formations[name].model_copy(update={"vary": {}, "residual": None, "observe": None})
    return config.model_copy(
        update={
            "sea": SeaConfig(**CALM, depth=config.sea.depth, current=current),
            "air": config.air.model_copy(update=steady) if config.air else AirConfig(),
            "vary": {},
            "obstacles": obstacles,
            "sensors": SensorsConfig(),
            "radio": None,
            name: section,
        }
    )


class ImaginedFormation(Formation):
    """The model in which an honest planner (rl/planning/planner.py) tries plans of one team.

    It has nominal vehicles, calm water, the mean wind and current of each environment, exact sensors and no radio.
    Track, target and slots are the plan, which all vehicles know. Its obstacles are those that the vehicles sense; they
    keep their velocity.
    """

    def prepare(self) -> None:
        """Make room for as many bodies as the team may sense."""
        sensed = sum(team.fleet.count * team.sensor.num_obstacles for team in self.teams.values())
        shape = (self.tracks.worlds, PER_WORLD, ROWS, sensed)
        self.bodies = Bodies(self.num_envs, self.obstacles.new_zeros(()).expand(shape))

    def believe(self, team: TeamTask) -> None:
        """Write mean wind and current, target and slots as they are, vehicles and obstacles as `team` measures them."""
        mine, known = self.teams[team.name], team.known
        self.steps.copy_(team.mission.steps)
        self.env_world.copy_(team.mission.env_world)
        transfer(team.targets, mine.targets)
        transfer(team.slots, mine.slots)
        everywhere, theirs = torch.arange(self.num_envs, device=self.steps.device), team.mission.world
        self.world.wind.set_mean(everywhere, theirs.wind.mean)
        self.world.current.set_mean(everywhere, theirs.current.steady)
        mine.fleet.state.copy_(known.fleet.state)
        mine.fleet.aux.copy_(known.fleet.aux)
        mine.fleet.surface.copy_(team.fleet.surface)
        mine.fleet.update()
        transfer(team.controller, mine.controller)
        write_obstacles_as_bodies(self.bodies.table, known.fleet.position_n, known.sensor.obstacles)
        self.measure_anew()


MISSION = Formation
