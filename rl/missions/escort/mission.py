"""The escort mission: boats hold formation about a manoeuvring vessel that only aircraft can see from afar.

The vessel is a scripted team (vessel.py). Boats see vessel and obstacles from near; aircraft circle the vessel and see
all of them from afar. All share their sightings by radio (picture.py). An episode begins with the boats some hundred
metres away; a cue gives them an old position of the vessel.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from rl.course.traffic import RADIUS, TOP, Bodies
from rl.mission import Endings, Mission, Step
from rl.missions.escort import rewards
from rl.missions.escort.aircraft import EscortAircraft
from rl.missions.escort.boats import EscortBoats
from rl.missions.escort.checks import check_parts, check_slots, tell_speeds
from rl.missions.escort.config import EscortScenario
from rl.missions.escort.control import controller_of
from rl.missions.escort.film import EscortFilm
from rl.missions.escort.judge import EscortJudge
from rl.missions.escort.picture import CommonPicture
from rl.missions.escort.scouts import Scouts
from rl.missions.escort.shapes import escort_offsets
from rl.missions.escort.starts import afloat, aloft
from rl.missions.escort.things import write_things
from rl.missions.escort.vessel import Wanderer
from rl.missions.escort.worlds import draw_worlds
from rl.rewards import fine, paid
from rl.seeds import derive_seed
from taichi_sim.kernels import runtime
from taichi_sim.kernels.counters import Noise
from taichi_sim.recording.episode import Scene

VESSEL_TOP = 4.0  # m above the sea: aircraft pass above; assumed
RESULT_SCALE = 8.0  # m from its slot at which a boat's result is 1/2; assumed
LINEAR = 10.0  # m from a boat's slot beyond which a plan's cost grows linearly
NEAR_COST, ENDED_COST = 10.0, 2e3  # cost in plans of each m below the berth; of an ending
OVERVIEW_M = 150.0  # m shown around the vessel in recordings without aircraft


class Escort(Mission):
    """Boats and aircraft about a vessel.

    Attributes:
        worlds: the pool of starts (worlds.py).
        obstacles: fixed obstacles [world, n, 4], for sensors.
        bodies: all that moves, the vessel first; traffic: the rest of it.
        env_world: int64 [env].
        vessel_place, vessel_velocity: [env, 2] NED, m, m/s; the velocity is averaged (vessel.py).
        hs: [env] significant wave height, m.
        picture: knowledge of boats and aircraft (picture.py).
        noise: counts the decisions of all episodes, for random numbers of sensors and radio.
    """

    STATE = (
        "env_world", "bodies", "traffic", "hs", "vessel_place", "_cue", "arrived", "_which", "noise", "picture",
        "scouts",
    )  # fmt: skip

    Config = EscortScenario
    logged = ("error_m", "arrived", "seen", "collisions_per_hour")
    Judge = EscortJudge
    config: EscortScenario

    @staticmethod
    def Team(mission: Any, name: str) -> Any:  # noqa: N802
        """The class of a team, by its part."""
        return (EscortBoats if name == mission.config.escort.boats else EscortAircraft)(mission, name)

    def prepare(self) -> None:
        """Draw the worlds and connect the teams.

        Raises:
            ConfigError: if the teams do not fit their vehicles, the wind or each other.
        """
        run, config = runtime.current(), self.config
        check_parts(config, self.teams)
        boats, vessel = self.teams.get(config.escort.boats), config.escort.vessel
        self._script: Wanderer = self.world.scripts[vessel]  # pyright: ignore[reportAttributeAccessIssue]
        self._vessel = self.world.teams[vessel]
        radius = self._vessel.model.collision_radius
        if boats is None:
            section = config.parts[config.escort.boats]
            count, offsets = section.count, escort_offsets(section.formation, section.count, section.spacing)
        else:
            count, offsets = boats.fleet.count, boats.offsets.cpu().double()
            check_slots(boats, radius)
            tell_speeds(config, boats)
        worlds = draw_worlds(config, count, offsets, radius, self.generator)
        self.worlds = worlds.to(run.device)
        self.obstacles = self.worlds.obstacles.to(run.torch_dtype).contiguous()
        if not self.obstacles.shape[1]:  # a kernel needs at least one row: put it far away
            far = self.obstacles.new_tensor([1e6, 1e6, 1.0, 1.0])
            self.obstacles = far.expand(config.escort.worlds, 1, 4).contiguous()
        pool = self.worlds.bodies.to(run.torch_dtype).unsqueeze(1)
        self.bodies, self.traffic = Bodies(self.num_envs, pool), Bodies(self.num_envs, pool[..., 1:])
        self.bodies.table[:, RADIUS, 0], self.bodies.table[:, TOP, 0] = radius, VESSEL_TOP
        self.env_world = torch.zeros(self.num_envs, dtype=torch.int64, device=run.device)
        amplitude = torch.as_tensor(self.world.sea.components.amplitude)
        self._hs = (4 * (amplitude.double().square().sum(1) / 2).sqrt()).to(run.device, run.torch_dtype)
        self.hs = torch.zeros(self.num_envs, device=run.device, dtype=run.torch_dtype)
        self.vessel_place, self.vessel_velocity = self.hs.new_zeros((self.num_envs, 2)), self._script.velocity
        self._cue = self.hs.new_zeros((self.num_envs, 2))  # the cue: the vessel's position given at the start, m
        self.arrived = torch.zeros(self.num_envs, dtype=torch.bool, device=run.device)
        self._which = torch.zeros(self.num_envs, dtype=torch.int32, device=run.device)
        self.noise = Noise(self.num_envs, derive_seed(self.seed, "sensors"))
        self._connect()
        self._script.attach(self)
        self._film = EscortFilm(self)

    def _connect(self) -> None:
        """Make the common picture of all observers."""
        config, groups, first = self.config, {}, 0
        self.scouts: Scouts | None = None
        for part in (config.escort.boats, config.escort.aircraft):
            if part in self.teams:
                groups[part] = self.teams[part].group(first, list(config.teams).index(part))
            elif part == config.escort.aircraft and part in config.teams:
                self.scouts = Scouts(self, part, config.parts[part])
                groups[part] = self.scouts.group(first)
            if part in groups:
                first += groups[part].own.state.shape[1]
        things = self.bodies.table.shape[2] + self.obstacles.shape[1]
        self.picture = CommonPicture(self, groups, things)
        for member in (*self.teams.values(), *((self.scouts,) if self.scouts else ())):
            member.join(self.picture)

    def reseed(self, seed: int) -> None:
        """Also restart the random numbers of sensors and radio."""
        super().reseed(seed)
        self.noise.restart(derive_seed(seed, "sensors"))

    # -- one step --------------------------------------------------------------------------------------------------

    def measure(self) -> None:
        """Move the traffic; let observers look and communicate; measure errors."""
        self._which.fill_(1)
        self.noise.tick()
        self.traffic.move(self.config.decision_interval, self.world.current.velocity)
        self._look(self.num_envs)

    def measure_again(self, envs: Tensor) -> None:
        """Measure at the start of an episode in environments `envs`."""
        self._which.zero_()
        self._which[envs] = 2
        self._look(len(envs), envs)

    def _look(self, rows: int, envs: Tensor | None = None) -> None:
        which = self._which
        self.vessel_place = write_things(self, self._vessel)
        for team in self.teams.values():
            team.measure(which, rows)
        if self.scouts:
            self.scouts.measure(which)
        if envs is not None:
            self.picture.begin(envs, self._cue[envs])
        self.picture.update(which, rows)
        for team in self.teams.values():
            team.conclude(which, rows)
        if self.boats is not None:
            to = self.boats.fleet.position_n[:, 0, :2] - self.vessel_place
            here = to.norm(dim=-1) < self.config.escort.arrival
            self.arrived = torch.where(which == 2, here, self.arrived | here)

    def elevation(self, points: Tensor) -> Tensor:
        """Elevation of the sea (m, up) at points [env, n, 2]."""
        return self.world.elevation(self._all, points[..., 0].contiguous(), points[..., 1].contiguous())

    def observe(self, team: Any) -> dict[str, Tensor]:
        """The observations of a team (boats.py, aircraft.py)."""
        return team.terms()

    def reward(self, team: Any, ended: Endings) -> Tensor:
        """The reward of a team (rewards.py)."""
        if isinstance(team, EscortBoats):
            return paid(rewards.BOAT_TERMS, team.section.boat_reward, team, ended)
        return paid(rewards.AIRCRAFT_TERMS, team.section.aircraft_reward, team, ended)

    def plan_cost(self, team: Any, ended: Tensor) -> Tensor:
        """Cost of plans: for boats the distance from the slot, squared where it is near, plus too little clearance."""
        if not isinstance(team, EscortBoats):
            return super().plan_cost(team, ended)
        far, near = team.distance, (team.section.plan.berth - team.sensor.gap).clamp(min=0.0)
        return far.square() / (far + LINEAR) + NEAR_COST * near + ENDED_COST * ended

    def endings(self, team: Any) -> dict[str, Tensor]:
        """Contact with an obstacle, the vessel or a team mate; leaving the area."""
        place = team.fleet.position_n[..., :2]
        return {"collided": team.sensor.gap < 0.0, "left": place.abs().amax(-1) > self.config.area / 2}

    @property
    def boats(self) -> Any:
        """The team of boats (boats.py), or None."""
        return self.teams.get(self.config.escort.boats)

    def boats_result(self) -> Tensor:
        """Mean of 1 / (1 + (d / RESULT_SCALE)^2) over the boats, d from the slot, m: [env]; 0 without boats."""
        return torch.zeros_like(self.hs) if self.boats is None else fine(self.boats.distance, RESULT_SCALE).mean(-1)

    # -- episodes --------------------------------------------------------------------------------------------------

    def begin(self, envs: Tensor, *, worlds: Tensor | None = None) -> None:
        """Place all vehicles in environments `envs` on `worlds`, int64 [n], default random."""
        n, config = len(envs), self.config
        worlds = self.draw(config.escort.worlds, n) if worlds is None else worlds
        self.env_world[envs] = worlds
        self.hs[envs] = self._hs[self.world.env_sea[envs].long()]
        course, speed = self.worlds.course[worlds], self.worlds.speed[worlds]
        self.world.place(config.escort.vessel, envs, self._script.start(envs, course, speed, self.generator))
        self.traffic.begin(envs, worlds, torch.zeros_like(worlds), self.world.current.velocity)
        noise = torch.randn((n, 2), generator=self.generator).to(self.hs)
        before = config.escort.cue_age * speed.unsqueeze(-1) * torch.stack((course.cos(), course.sin()), dim=-1)
        self._cue[envs] = config.escort.cue_error * noise - before.to(noise)
        boats, aircraft = (self.teams.get(part) for part in (config.escort.boats, config.escort.aircraft))
        if boats is not None:
            place, heading = self.worlds.place[worlds], self.worlds.heading[worlds]
            self.world.place(boats.name, envs, afloat(boats, place, heading, self.generator))
        over = self.worlds.aloft[worlds]
        if self.scouts:
            self.scouts.begin(envs, over)
        if aircraft is not None:
            self.world.place(aircraft.name, envs, aloft(aircraft, over, self.generator))

    @classmethod
    def one_each(cls, config: EscortScenario, episodes: int) -> EscortScenario:
        """The scenario with one world and one sea for each episode, so that all begin far from the vessel."""
        config = super().one_each(config, episodes)
        return config.model_copy(update={"escort": config.escort.model_copy(update={"worlds": episodes})})

    def begin_each(self) -> None:
        """Begin environment e on world e and sea e."""
        numbers = torch.arange(self.num_envs, device=self.device)
        self.reset(seas=numbers % self.world.sea.num_seas, worlds=numbers)

    # -- logs, recordings, controllers -----------------------------------------------------------------------------

    def log(self, team: Any, step: Step) -> dict[str, Tensor]:
        """Errors now; shares of episodes in which the leader has arrived and a camera sees the vessel; collisions."""
        hours = team.distance.numel() * self.config.decision_interval / 3600
        sees = self.picture.looks[..., 0, 2] > 0
        return {
            "error_m": team.distance.mean(),
            "arrived": self.arrived.float().mean(),
            "seen": sees.any(-1).float().mean(),
            "collisions_per_hour": step.endings[team.name]["collided"].sum() / hours,
        }

    def info(self, team: Any) -> dict[str, Tensor]:
        """`distance`: m, of boats from the slot, of aircraft from the circle."""
        return {"distance": team.distance}

    @property
    def flying(self) -> Any:
        """The aircraft, or the scouts that replace them; None without either."""
        return self.teams.get(self.config.escort.aircraft, self.scouts)

    def frame(self, team: Any) -> dict[str, Tensor]:
        """For boats errors and slots; for aircraft the distance from the circle. Asked for the first team, it also
        films.
        """
        env = self.shown
        if team is next(iter(self.teams.values())):  # the first call of a step
            if int(self.steps[env]) <= 1:
                self._film = EscortFilm(self)
            self._film.take()
        shown = {"error_m": team.distance[env]}
        if isinstance(team, EscortBoats):
            slot = team.now.slot[env].clone()
            slot[:, 2] = 0.0
            shown |= {"slot_n": slot}
        return shown

    def scene(self) -> Scene:
        """The obstacles inside the area."""
        obstacles = self.obstacles[int(self.env_world[self.shown])].cpu().numpy()
        half = self.config.area / 2
        reach = OVERVIEW_M if self.flying is None else 1.6 * self.flying.orbit.radius
        return Scene(
            area_m=self.config.area,
            obstacles=obstacles[np.abs(obstacles[:, :2]).max(axis=1) <= half],
            overview=(self.config.escort.vessel, reach),
        )

    @classmethod
    def draw_figures(cls, out: Path, histories: Any, episode: Any, config: EscortScenario) -> None:
        """Draw the figures of figures.py."""
        from rl.missions.escort.figures import write_escort_figures  # matplotlib takes a second

        write_escort_figures(out, histories, episode, config)

    def overlays(self) -> tuple[Any, ...]:
        """Overlays of sightings and messages (film.py) in the frames collected so far."""
        return self._film.overlays()

    def forget_frames(self) -> None:
        """Drop the frames collected so far."""
        self._film = EscortFilm(self)

    def controller(self, team: Any) -> Any:
        """The controller that the vehicle brings, else that of control.py."""
        own = super().controller(team)
        return controller_of(team) if own is None else own


MISSION = Escort
