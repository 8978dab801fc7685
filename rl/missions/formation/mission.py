"""The formation mission: every team holds formation behind a target that moves along a track.

Each environment is on one of the scenario's worlds (a track with obstacles) and one of its seas; an episode draws both
anew. Targets of vessels move on the sea, those of aircraft straight above them at the flight height.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from rl.course.obstacles import ROWS, Bodies
from rl.guidance.controllers import controller_of
from rl.guidance.geometry import Geometry, SlotErrors, Target, Targets
from rl.guidance.knowledge import Knowledge
from rl.guidance.observations import ObservationWriter
from rl.guidance.residual import ResidualTeam
from rl.mission import Endings, Frame, Histories, Mission, Step
from rl.missions.formation import rewards
from rl.missions.formation.config import FormationScenario
from rl.missions.formation.judge import FormationJudge
from rl.missions.formation.slots import Slots
from rl.missions.formation.worlds import PER_WORLD, check_teams, draw_starts, draw_traffic, generate_worlds, in_wind
from rl.perception.contacts import SensorsConfig, TrackedContacts
from rl.perception.instruments import Readings
from rl.perception.radio import Radio
from rl.perception.sensors import Nearby, Sensor
from rl.planning.planner import write_obstacles_as_bodies
from rl.team import Controller
from taichi_sim.config import AirConfig, SeaConfig
from taichi_sim.conventions import DOWN
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.recording.episode import Episode, Scene
from taichi_sim.state import transfer

GLIDE_SHARE = 0.15  # of the target's speed, with which slots glide to a new formation; assumed
NEAR_COST, ENDED_COST = 300.0, 2e4  # of plans, m^2: for each m less than the berth; for an ending
CALM = {"hs": 0.0, "tp": 4.0, "components": 1, "realisations": 1}  # sea of the honest planner's model


class TeamTask(ResidualTeam):
    """One team, measured after each step; every tensor is [env, vehicle, ...].

    The class implements `Knowledge` (rl/guidance/knowledge.py) with the true values.

    Attributes:
        targets: of all environments, on their tracks. target: what its leader tracks.
        now: errors as of the last step or reset (geometry.py).
        known: what its vehicles know, the input of policies and controllers: the team itself, or
            `MeasuredFormation`.
        observations: writes what its policy observes. sensor: true obstacles and team mates.
        slots: about the leader (slots.py). offsets: [env, vehicle, 2] of them, a live view, m.
    """

    STATE = ("slots", "sensor", "now", "known")

    mission: "Formation"
    radio = None

    def __init__(self, mission: "Formation", name: str, targets: Targets):
        """Make team `name`, which holds formation behind `targets`; those of aircraft are at the flight height."""
        super().__init__(mission, name)
        self.targets = targets
        state, model, config = self.fleet.state, self.fleet.model, mission.config
        flies = model.medium == "air"
        down = -config.track.flight_height if flies else 0.0
        self.axes, self.radius = 3 if flies else 2, model.collision_radius
        glide = self.section.formation.glide or GLIDE_SHARE * config.pace(name).speed
        interval, steps = config.decision_interval, config.episode_steps
        self.slots = Slots(self.section, state, interval=interval, glide=glide, steps=steps)
        self.offsets, self.slot_table = self.slots.offsets, self.slots.table
        sensing, frame = config.sensing, "body" if flies else "heading"
        reach = sensing.detection_range
        # The number of mates observed does not depend on the team's size: one that does not exist is out of range.
        self.sensor = Sensor(self.fleet, sensing.obstacles, sensing.team_mates, reach, self.radius, frame)
        self.now = Geometry(self.fleet, targets.table, down, self.slot_table, self.axes)
        self.target = Target(targets.table, self.now.slot[:, 0])
        exact = config.radio is None and config.sensors.exact and config.sensors.scaled_contacts.exact
        self.measured = None if exact else MeasuredFormation(self, down)
        self.known: Knowledge = self.measured or self
        self.observations = ObservationWriter(self.known, config.observations, self.reference_width)
        self._true = None if exact else ObservationWriter(self, config.observations, self.reference_width)

    @property
    def layout(self) -> Mapping[str, int]:
        """Terms of the team's observations and their widths (observations.py)."""
        return self.observations.widths

    def observations_now(self) -> Tensor:
        """Observations [env, vehicle, n] (observations.py), a fresh tensor each time."""
        return self.observations(self.action, self.reference())

    def truth_now(self) -> Tensor | None:
        """Ground truth [env, vehicle, n] that its vehicles do not know: errors, surroundings, numbers that vary."""
        parts = []
        if self._true is not None:
            parts.append(self._true(self.action, self.reference()))
        if self.mission.config.varies:
            parts.append(self.mission.world.truth[self.name])
        return torch.cat(parts, dim=-1) if parts else None

    def measure(self, obstacles: Tensor, bodies: Bodies, env_world: Tensor, which: Tensor, count: int) -> None:
        """Measure in `count` environments `which` (geometry.py), among obstacles [world, m, 4] and `bodies`."""
        self.forget()
        self.now.measure(which, count)
        self.sensor.look(obstacles, env_world, which, count, bodies)
        if self.measured is not None:
            self.measured.measure(which, count)

    @property
    def distance(self) -> Tensor:
        """Distance (m) of each vehicle from its slot: the leader's tracking error, a follower's formation error."""
        return self.now.distance


class MeasuredFormation:
    """One team's measured knowledge (rl/guidance/knowledge.py); parts without errors are those of the team itself.

    Rewards, endings and figures use the truth. Target and formation are the plan, which every vehicle knows exactly.
    """

    STATE = ("fleet", "now", "sensor", "radio")

    def __init__(self, team: TeamTask, down: float):
        """Measure for `team`, whose target is at `down` (m)."""
        mission = team.mission
        config, interval = mission.config, mission.config.decision_interval
        number = config.first_number(team.name)
        exact, contacts = config.sensors.exact, config.sensors.scaled_contacts
        self.axes, self.radius = team.axes, team.radius
        self.target, self.slot_table = team.target, team.slot_table
        self._team, self._count = team, mission.noise.table
        self.fleet: Fleet | Readings = team.fleet if exact else Readings(team.fleet, config.sensors, interval, number)
        self.radio = None if config.radio is None else Radio(config.radio, team.fleet.state, interval, vehicles=number)
        self.now: SlotErrors = team.now
        if not exact or self.radio is not None:
            heard = None if self.radio is None else self.radio.heard
            self.now = Geometry(self.fleet, team.target.table, down, team.slot_table, team.axes, heard)
        self.sensor: Nearby = team.sensor
        if not (exact and contacts.exact):
            self.sensor = TrackedContacts(contacts, team.sensor, team.fleet, self.fleet, interval, number)

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self._team.steps

    def measure(self, which: Tensor, rows: int) -> None:
        """Measure after the truth has been measured; arguments as of `Geometry.measure`."""
        if isinstance(self.fleet, Readings):
            self.fleet.read(which, rows, self._count)
        if self.radio is not None:
            torch.cat((self.fleet.position_n, self.fleet.velocity_n), dim=-1, out=self.radio.said)
            self.radio.talk(which, rows, self.steps, self._count)
        if isinstance(self.now, Geometry) and self.now is not self._team.now:
            self.now.measure(which, rows)
        if isinstance(self.sensor, TrackedContacts):
            self.sensor.update(which, rows, self.steps, self._count)


class Formation(Mission[FormationScenario, TeamTask]):
    """Teams in formation; see the module.

    Attributes:
        tracks, obstacles, starts: of every world; obstacles [world, n, 4] north, east, radius, height, m.
        bodies: moving obstacles (rl/course/obstacles.py).
        env_world: int64 [env], world of each environment. targets: of the leaders, by their pace.
        wind_factor: mean wind at the flight height over that at 10 m.
    """

    STATE = ("env_world", "targets", "bodies")

    Config = FormationScenario
    logged = ("leader_error_m", "follower_error_m", "collisions_per_hour", "lost")
    Team = TeamTask
    Judge = FormationJudge

    def make_teams(self, names: Sequence[str]) -> dict[str, TeamTask]:
        """Generate worlds, starts and targets, then the teams that follow these.

        Raises:
            ConfigError: where they do not fit, or a team could not follow the track.
        """
        run, config = runtime.current(), self.config
        self.wind_factor = self.world.wind.speed_factor(config.track.flight_height)
        models = {name: self.world.teams[name].model for name in names}
        check_teams(config, models)
        self.tracks, generated = generate_worlds(config, self.seed)
        fixed = torch.tensor([[o.north, o.east, o.radius, o.height] for o in config.obstacles.fixed]).reshape(-1, 4)
        both = torch.cat((generated, fixed.expand(self.tracks.worlds, -1, 4)), dim=1)
        starts = draw_starts(config, self.tracks, both, models, self.generator)
        pool = draw_traffic(config, self.tracks, starts, both, models, self.generator)
        self.tracks = self.tracks.to(run.device)  # all was drawn on the CPU: the same worlds on every device
        self.starts = starts.to(run.device)
        self.bodies = Bodies(self.num_envs, pool.to(run.device, run.torch_dtype))
        self.obstacles = both.to(run.device, run.torch_dtype).contiguous()
        if not self.obstacles.shape[1]:  # a kernel needs one row: put it out of every vehicle's reach
            far = self.obstacles.new_tensor([1e6, 1e6, 1.0, 1.0])
            self.obstacles = far.expand(self.tracks.worlds, 1, 4).contiguous()
        self.env_world = torch.zeros(self.num_envs, dtype=torch.int64, device=run.device)
        self.targets = {
            pace: Targets(
                self.tracks, self.env_world, self.world.wind.velocity, speed=pace.speed,
                interval=config.decision_interval, wind_factor=self.wind_factor, over_air=pace.over == "air",
            )
            for pace in map(config.pace, names)
        }  # fmt: skip
        return {name: TeamTask(self, name, self.targets[config.pace(name)]) for name in names}

    # -- one step --------------------------------------------------------------------------------------------------

    def measure(self) -> None:
        """Move targets and slots; then measure errors and surroundings of every vehicle."""
        for targets in self.targets.values():
            targets.move(self.which, self.num_envs)
        self.bodies.move(self.config.decision_interval, self.world.current.velocity)
        for team in self.teams.values():
            team.slots.advance(self.steps)
        self._look(self.num_envs)

    def _look(self, count: int) -> None:
        for team in self.teams.values():
            team.measure(self.obstacles, self.bodies, self.env_world, self.which, count)

    def observe(self, team: TeamTask) -> dict[str, Tensor]:
        """Observations of rl/guidance/observations.py."""
        return team.terms()

    def reward(self, team: TeamTask, ended: Endings) -> Tensor:
        """Rewards of rewards.py."""
        if self.config.reward == "paper":
            return rewards.paper(team, ended)
        return rewards.tracking(team, ended)

    def plan_cost(self, team: TeamTask, ended: Tensor) -> Tensor:
        """Squared distance from the slot, plus NEAR_COST and ENDED_COST."""
        near = (team.section.plan.berth - team.sensor.gap).clamp(min=0.0)
        return team.distance.square() + NEAR_COST * near + ENDED_COST * ended

    def endings(self, team: TeamTask) -> dict[str, Tensor]:
        """Contact with an obstacle or a team mate, too far from the slot, or out of the area."""
        return {
            "collided": team.sensor.gap < 0.0,
            "lost": team.distance > team.section.lost_distance,
            "left": team.now.reach > self.config.area / 2,
        }

    # -- episodes --------------------------------------------------------------------------------------------------

    def begin(self, envs: Tensor, *, worlds: Tensor | None = None, starts: Tensor | None = None) -> None:
        """Place teams in environments `envs` on `worlds` from `starts`, each int64 [n] (default: random ones)."""
        n = len(envs)
        worlds = self.draw(self.tracks.worlds, n) if worlds is None else worlds
        starts = self.draw(PER_WORLD, n) if starts is None else starts
        self.env_world[envs] = worlds
        for targets in self.targets.values():
            targets.progress[envs] = self.starts.progress[worlds, starts]
            targets.move(self.which, n)
        self.bodies.begin(envs, worlds, starts, self.world.current.velocity)
        aloft = self.world.wind.velocity.index_select(0, envs)[:, :2] * self.wind_factor  # at the flight height
        for name, team in self.teams.items():
            state = self.starts.states[name][worlds, starts].to(team.fleet.state)
            pace = self.config.pace(name)
            if pace.over == "air":
                state = in_wind(state, aloft, team.target.speed[envs, 0], pace.speed, team.fleet.model)
            self.world.place(name, envs, state)
            team.slots.begin(envs, self.starts.formations[name].at(worlds, starts), self.generator)

    def measure_again(self, envs: Tensor) -> None:
        """Measure after `begin` has placed vehicles."""
        self._look(len(envs))

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

    def log(self, team: TeamTask, step: Step) -> dict[str, Tensor]:
        """Errors now, collisions per hour of vehicle time, and vehicles lost in this step."""
        ended, rows = step.endings[team.name], team.distance.numel()
        hours = rows * self.config.decision_interval / 3600
        followers = {"follower_error_m": team.distance[:, 1:].mean()} if team.fleet.count > 1 else {}
        return {
            "leader_error_m": team.distance[:, 0].mean(),
            **followers,
            "collisions_per_hour": ended["collided"].sum() / hours,
            "lost": ended["lost"].sum(),
        }

    def imagined(self, team: TeamTask) -> Mission:
        """Make an `ImaginedFormation` for the model of `team`."""
        config = imagined_scenario(self.config, team.name)
        return ImaginedFormation(config, self.num_envs, seed=self.seed, teams=(team.name,), source=self.source)

    def info(self, team: TeamTask) -> dict[str, Tensor]:
        """distance: m, from the slot (the leader's: from the target)."""
        return {"distance": team.distance}

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

    def controller(self, team: TeamTask) -> Controller | None:
        """The vehicle's own controller, else that of rl/guidance/controllers for its model."""
        own = super().controller(team)
        if own is not None:
            return own
        return controller_of(team.fleet.model, team.section.control, f"{team.name}.control")


def imagined_scenario(config: FormationScenario, name: str) -> FormationScenario:
    """The scenario of the model of team `name`."""
    current = config.sea.current and config.sea.current.model_copy(update={"std": 0.0})
    steady = {"std": 0.0, "turbulence": "none", "gust": None}
    obstacles = config.obstacles.model_copy(update={"count": 0, "fixed": ()})
    section = config.formations[name].model_copy(update={"vary": {}, "residual": None})
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

    STATE = ()

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
        self.which.fill_(2)
        self._look(self.num_envs)


MISSION = Formation
