"""The escort mission: boats hold formation about a manoeuvring vessel that only aircraft can see from afar.

The vessel is a scripted team (vessel.py). Boats see it, and obstacles, from near. Aircraft circle it, and see it and
the obstacles from afar. All send each other their sightings by radio (tracking.py). An episode begins with the boats
some hundred metres away; they are given a place where the vessel was.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, cast

import numpy as np
import torch
from torch import Tensor

from rl.guidance.course.obstacles import EAST, RADIUS, TOP, V_EAST, V_NORTH, Bodies
from rl.guidance.rewards import fine
from rl.guidance.shapes import escort_offsets
from rl.mission import Frame, Histories, Mission
from rl.missions.escort.aircraft import EscortAircraft, Scouts, aircraft_observers, scout_observers
from rl.missions.escort.boats import EscortBoats, boat_observers
from rl.missions.escort.config import EscortScenario
from rl.missions.escort.film import overlays_of
from rl.missions.escort.judge import EscortJudge
from rl.missions.escort.tracking import SharedTracking
from rl.missions.escort.vessel import Among, Wanderer
from rl.missions.escort.worlds import afloat, aloft, check_parts, check_slots, draw_worlds, warn_of_speeds
from rl.perception.sightings import Object
from rl.step import Due
from taichi_sim.kernels import runtime
from taichi_sim.kernels.conventions import DOWN
from taichi_sim.visualisation.recording.episode import Episode, Scene

VESSEL_TOP = 4.0  # m above the sea: aircraft pass above; assumed
RESULT_SCALE = 8.0  # m from its slot, at which a boat's result is a half; assumed
WAIT, WAITS = 1.0, 10  # s that their episode begins later, and how often
OVERVIEW = 150.0  # m about the vessel, in recordings without aircraft


class Escort(Mission[EscortScenario, EscortBoats | EscortAircraft]):
    """Boats and aircraft about a vessel; see the module.

    Attributes:
        worlds: the pool of beginnings (worlds.py). obstacles: [world, n, 4] of them, as sensors take them.
        bodies: moving bodies, the vessel first; traffic: the others. env_world: int64 [env].
        vessel_place, vessel_velocity: [env, 2] NED, m, m/s; the velocity is averaged (vessel.py).
        hs: [env] significant wave height, m. tracking: what boats and aircraft know (tracking.py).
        boats, aircraft: the teams, or None. scouts: in place of the aircraft, or None.
    """

    Config = EscortScenario
    Teams: ClassVar = {"boats": EscortBoats, "aircraft": EscortAircraft}
    Judge = EscortJudge

    @classmethod
    def part(cls, config: EscortScenario, team: str) -> str:
        """The part of a team, by `[escort]`."""
        return {config.escort.boats: "boats", config.escort.aircraft: "aircraft"}.get(team, team)

    def make_teams(self, names: Sequence[str]) -> dict[str, EscortBoats | EscortAircraft]:
        """Draw the worlds, then make the tracking that all observers share, and the teams."""
        run, config, fleets = runtime.current(), self.config, {name: self.world.teams[name] for name in names}
        check_parts(config, fleets)
        boats, vessel = fleets.get(config.escort.boats), config.escort.vessel
        self._script: Wanderer = self.world.scripts[vessel]  # pyright: ignore[reportAttributeAccessIssue]
        self._vessel = self.world.teams[vessel]
        radius = self._vessel.model.collision_radius
        section = config.parts[config.escort.boats]
        offsets = escort_offsets(section.formation, section.count, section.spacing)
        if boats is not None:
            check_slots(config, boats, offsets, radius)
            warn_of_speeds(config, boats)
        worlds = draw_worlds(config, section.count, offsets, radius, self.generator)
        self.worlds = worlds.to(run.device)
        obstacles = self.worlds.obstacles.to(run.torch_dtype)
        if not obstacles.shape[1]:  # a kernel needs at least one row: put it far away
            obstacles = obstacles.new_tensor([1e6, 1e6, 1.0, 1.0]).expand(config.escort.worlds, 1, 4)
        self.obstacles = obstacles.contiguous()
        pool = self.worlds.bodies.to(run.torch_dtype).unsqueeze(1)
        self.bodies = self.remember(Bodies(self.num_envs, pool))
        self.traffic = self.remember(Bodies(self.num_envs, pool[..., 1:]))
        self.bodies.table[:, RADIUS, 0], self.bodies.table[:, TOP, 0] = radius, VESSEL_TOP
        self.env_world = self.remember(torch.zeros(self.num_envs, dtype=torch.int64, device=run.device))
        self._hs = torch.as_tensor(self.world.sea.components.hs).to(run.device, run.torch_dtype)
        self.hs = self.remember(torch.zeros(self.num_envs, device=run.device, dtype=run.torch_dtype))
        self.vessel_velocity = self._script.velocity
        # place of the vessel now, and the one that is given at the start, m
        self.vessel_place, self._cue = (self.remember(self.hs.new_zeros((self.num_envs, 2))) for _ in range(2))
        self.arrived = self.remember(torch.zeros(self.num_envs, dtype=torch.bool, device=run.device))
        self.tracking = self.remember(self._shared_tracking(names))
        aircraft = config.escort.aircraft
        seen_by = config.parts.get(aircraft)
        self._on_waves = seen_by is not None and seen_by.camera.surface == "waves"  # else at mean sea level
        scouted = aircraft in config.teams and aircraft not in names
        self.scouts = self.remember(Scouts(self, aircraft, self.tracking) if scouted else None)
        boats = config.escort.boats
        kinds = self.kinds(config)
        made = {name: kinds[name](self, name, self.tracking) for name in names}
        self.boats = cast(EscortBoats | None, made.get(boats))
        self.aircraft = cast(EscortAircraft | None, made.get(aircraft))
        return made

    def _shared_tracking(self, names: Sequence[str]) -> SharedTracking:
        """The tracking of all observers: boats, then aircraft or the scouts in their place."""
        parts, groups = self.config.escort, {}
        if parts.boats in names:
            groups[parts.boats] = boat_observers(self, parts.boats, 0)
        if parts.aircraft in self.config.teams:
            observers = aircraft_observers if parts.aircraft in names else scout_observers
            groups[parts.aircraft] = observers(self, parts.aircraft, sum(g.count for g in groups.values()))
        return SharedTracking(self.config, groups, self.bodies.table.shape[2] + self.obstacles.shape[1])

    def prepare(self) -> None:
        """Give the vessel its obstacles and boats."""
        boats = None if self.boats is None else self.boats.fleet
        self._script.attach(Among(self.obstacles, self.env_world, self.traffic, boats, self.steps))

    # -- one step --------------------------------------------------------------------------------------------------

    def move(self, due: Due) -> None:
        """Move traffic."""
        self.traffic.move(self.config.decision_interval, self.world.current.velocity)

    def truth(self, due: Due) -> None:
        """Write down where all is; then measure the teams, and who has arrived."""
        self._place_vessel()
        super().truth(due)
        if self.scouts:
            self.scouts.truth(due)
        if self.boats is not None:
            to = self.boats.fleet.position_n[:, 0, :2] - self.vessel_place
            here = to.norm(dim=-1) < self.config.escort.arrival
            self.arrived = torch.where(due.begins, here, self.arrived | here)

    def _place_vessel(self) -> None:
        """Write the vessel's place into bodies and objects, and what boats track."""
        place, table = self.vessel_place, self.bodies.table
        place.copy_(self._vessel.position_n[:, 0, :2])
        table[:, : EAST + 1, 0], table[:, V_NORTH : V_EAST + 1, 0] = place, self._vessel.velocity_n[:, 0, :2]
        if self.traffic.present:
            table[..., 1:] = self.traffic.table
        self.tracking.place_objects(table, self.obstacles[self.env_world])
        if self._on_waves:
            objects = self.tracking.objects
            inside = objects[..., Object.NORTH].abs() < self.config.area  # obstacles that a world has not are far away
            objects[..., Object.DOWN] = torch.where(inside, -self.elevation(objects[..., :2]), 0.0)
        if self.boats is not None:
            self.boats.follow(place, self.vessel_velocity)

    def perceive(self, due: Due) -> None:
        """Read instruments; where an episode begins, tell all where the vessel was; then look."""
        super().perceive(due)
        begun = due.begins.nonzero().flatten()
        if len(begun):
            self.tracking.begin(begun, self._cue[begun])
        for observers in (*self.teams.values(), *((self.scouts,) if self.scouts else ())):
            observers.look(due)

    def exchange(self, due: Due) -> None:
        """All observers have one radio."""
        self.tracking.exchange(due)
        super().exchange(due)

    def conclude(self, due: Due) -> None:
        """Update the charts of all observers; then what the teams know."""
        self.tracking.conclude(due)
        super().conclude(due)

    def elevation(self, points: Tensor) -> Tensor:
        """Elevation of the sea (m, up) now at points [env, n, 2]."""
        north, east = points.unbind(-1)
        return self.world.elevation(self._all, north.contiguous(), east.contiguous())

    def boats_result(self) -> Tensor:
        """Mean of 1 / (1 + (d / RESULT_SCALE)^2) over the boats, d from the slot, m: [env]; 0 without boats."""
        return torch.zeros_like(self.hs) if self.boats is None else fine(self.boats.distance, RESULT_SCALE).mean(-1)

    # -- episodes --------------------------------------------------------------------------------------------------

    def begin(self, envs: Tensor, *, worlds: Tensor | None = None) -> None:
        """Place all in environments `envs` on `worlds`, int64 [n] (default: random ones)."""
        n, config = len(envs), self.config
        worlds = self.draw(config.escort.worlds, n) if worlds is None else worlds
        self.env_world[envs] = worlds
        self.hs[envs] = self._hs[self.world.env_sea[envs].long()]
        course, speed = self.worlds.course[worlds], self.worlds.speed[worlds]
        vessel = self._script.start(envs, course, speed, self.generator)
        self.traffic.begin(envs, worlds, torch.zeros_like(worlds), self.world.current.velocity)
        noise = torch.randn((n, 2), generator=self.generator).to(self.hs)
        before = config.escort.cue_age * speed.unsqueeze(-1) * torch.stack((course.cos(), course.sin()), dim=-1)
        self._cue[envs] = config.escort.cue_error * noise - before.to(noise)
        boats, aircraft = self.boats, self.aircraft
        if boats is not None:
            place, heading = self.worlds.place[worlds], self.worlds.heading[worlds]
            self._launch(boats, envs, afloat(boats.fleet, place, heading, self.generator))
        self.world.place(config.escort.vessel, envs, vessel)
        over = self.worlds.aloft[worlds]
        if self.scouts is not None:
            self.scouts.begin(envs, over)
        elif aircraft is not None:
            self.world.place(aircraft.name, envs, aloft(aircraft.fleet, aircraft.down, over, self.generator))

    def _launch(self, boats: EscortBoats, envs: Tensor, state: Tensor) -> None:
        """Place the boats at `state`; where the sea lifts one faster than `escort.start_lift`, a little later.

        The memory of radiated waves begins at rest, so that a boat is slow to follow a crest at first.
        """
        self.world.place(boats.name, envs, state)
        for _ in range(WAITS):
            lifted = (boats.fleet.velocity_n[envs, :, DOWN] < -self.config.escort.start_lift).any(-1)
            envs, state = envs[lifted], state[lifted]
            if not len(envs):
                break
            self.world.time[envs] += WAIT
            self.world.place(boats.name, envs, state)

    @classmethod
    def one_each(cls, config: EscortScenario, episodes: int) -> EscortScenario:
        """One world and one sea for each episode."""
        config = super().one_each(config, episodes)
        return config.model_copy(update={"escort": config.escort.model_copy(update={"worlds": episodes})})

    def begin_each(self) -> None:
        """Begin environment e on world e and sea e."""
        self.reset(seas=self._all % self.world.sea.num_seas, worlds=self._all)

    # -- recordings ---------------------------------------------------------------------------------------------------

    @property
    def flying(self) -> EscortAircraft | Scouts | None:
        """The aircraft, or the scouts in their place; None without either."""
        return self.aircraft or self.scouts

    def frame(self, env: int) -> Frame:
        """Errors of all teams, slots of boats; observations, messages and estimates of the vessel (film.py)."""
        rows = {name: {"error_m": team.distance[env]} for name, team in self.teams.items()}
        if self.boats is not None:
            slot = self.boats.now.slot[env].clone()
            slot[:, DOWN] = 0.0
            rows[self.boats.name]["slot_n"] = slot
        return Frame(rows, overlays_of(self, self.tracking, self.flying, env))

    def scene(self, env: int) -> Scene:
        """The obstacles inside the area."""
        obstacles = self.obstacles[int(self.env_world[env])].cpu().numpy()
        half = self.config.area / 2
        reach = OVERVIEW if self.flying is None else 1.6 * self.flying.orbit.radius
        return Scene(
            area_m=self.config.area,
            obstacles=obstacles[np.abs(obstacles[:, :2]).max(axis=1) <= half],
            overview=(self.config.escort.vessel, reach),
        )

    @classmethod
    def draw_figures(cls, out: Path, histories: Histories, episode: Episode | None, config: EscortScenario) -> None:
        """See figures.py."""
        from rl.missions.escort.figures import write_escort_figures  # matplotlib takes a second

        write_escort_figures(out, histories, episode, config)


MISSION = Escort
