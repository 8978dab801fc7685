"""The escorted vessel: a script that changes course and speed at random times, or flees from boats.

Its manoeuvres are drawn when an episode begins, so that all controllers meet the same. It sails by the classical
controller of its model, avoids obstacles, all of which it knows, and turns back at the edge of the area. Boats must
keep clear of it. It evades them only at the last moment (`leader_horizon` of its control), as rule 17 of the COLREGs
demands.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from rl.guidance.avoidance import Avoider
from rl.guidance.controllers import controller_of
from rl.guidance.controllers.vessel import CourseCommand, Hull6DofController, Manoeuvring3dofController
from rl.guidance.course.obstacles import Bodies
from rl.guidance.targets_and_errors import SLOT_SIZE, SlotErrors, Target, course_of, wrap
from rl.guidance.targets_and_errors import TARGET_SIZE as TARGET
from rl.missions.escort.config import EscortScenario
from rl.perception.sensors import Mate, Nearby, Sensor
from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.rotation import level_states
from taichi_sim.world import Script, World

EDGE = 0.4  # of the area's side: further out it turns back
SEEN, BOATS = 3, 2  # nearest obstacles and boats that it avoids
REACH = 40.0  # m, detection range
SMOOTH = 5.0  # s, time constant of the averaged velocity, whose direction is the course; assumed


class Among(NamedTuple):
    """What the vessel sails among."""

    obstacles: Tensor  # [world, n, 4] as sensors take them
    env_world: Tensor  # int64 [env]
    traffic: Bodies
    boats: Fleet | None
    steps: Tensor  # int64 [env], decisions since the episode began


class Wanderer(Script):
    """Script of the vessel (see the module), which steers by the true state.

    The class implements `Knowledge` (rl/guidance/knowledge.py).

    Attributes:
        velocity: [env, 2] over ground, NED, m/s, averaged over `SMOOTH`; it defines the vessel's course.
    """

    axes = 2
    radio = None

    def __init__(self, world: World, name: str):
        """Command team `name`, of vessels whose classical controller follows velocity commands."""
        super().__init__(world, name)
        if not isinstance(world.config, EscortScenario):
            raise ConfigError(
                f"{name}.script: the vessel's manoeuvres are described by the mission 'escort', and this world has no "
                "mission: make the environments by rl.BatchedEnv or gymnasium.make, or name the teams of the world "
                f"without {name!r} (teams=...)"
            )
        self.config, self.fleet = world.config, world.teams[name]
        model, state = self.fleet.model, self.fleet.state
        section = self.config.parts[name]
        sails = model.medium == "water"
        controller = controller_of(model, section.control, f"{name}.control") if sails else None
        if controller is None:
            raise ConfigError(f"{name}.vehicle = {section.vehicle!r}: not a vessel that a script can sail")
        if not isinstance(controller, Hull6DofController | Manoeuvring3dofController):
            raise ConfigError(
                f"{name}.vehicle = {section.vehicle!r}: the script sails only manoeuvring_3dof and hull_6dof"
            )
        self.controller, top = self.remember(controller), model.limits.speeds[2]
        if self.config.course.speed[1] > top:
            raise ConfigError(f"course.speed = {list(self.config.course.speed)}: {name}'s vehicle can go {top:.3g} m/s")
        envs = state.shape[0]
        changes = 4 + math.ceil(2 * self.config.episode_duration / self.config.course.every)
        self.radius = model.collision_radius
        self.now = self.remember(SlotErrors(state, self.axes))
        self.slot_table = state.new_zeros((envs, self.fleet.count, SLOT_SIZE))
        self.target = self.remember(Target(state.new_zeros((envs, 1, TARGET)), state[:, 0, :3]))
        self._sensor = self.remember(Sensor(self.fleet, SEEN, 0, REACH, self.radius))
        # boats count as mates of its own
        self.sensor = self.remember(Nearby(state, SEEN, BOATS, REACH, self.radius, self.axes))
        self.sensor.obstacles = self._sensor.obstacles
        self._avoid = Avoider(self.controller.gains)
        self._next = self.remember(torch.zeros(envs, dtype=torch.int64, device=state.device))
        # of each change: time (s), course (rad), speed (m/s)
        self._plan = self.remember(state.new_zeros((envs, changes, 3)))
        self._time, self._steered, self._course, self._speed = (self.remember(state.new_zeros(envs)) for _ in range(4))
        self.velocity = self.remember(state.new_zeros((envs, 2)))
        self._among: Among | None = None

    def attach(self, among: "Among") -> None:
        """Sail among what a mission holds, which is made after the world and its scripts."""
        self._among = among

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self._next if self._among is None else self._among.steps

    def start(self, envs: Tensor, course: Tensor, speed: Tensor, generator: torch.Generator) -> Tensor:
        """Begin episodes in environments `envs` [n] on `course` [n] (rad) at `speed` [n] (m/s).

        Returns the vessel's initial states, [n, vehicle, 13].
        """
        way, n = self.config.course, len(envs)
        draws = torch.rand((n, self._plan.shape[1], 3), generator=generator, dtype=torch.float64)
        wait, turn, share = draws.unbind(-1)
        wait, turn = -way.every * (1 - wait).log(), (2 * turn - 1) * math.radians(way.turn_deg)
        speeds = way.speed[0] + (way.speed[1] - way.speed[0]) * share
        courses = course.double().cpu().unsqueeze(-1) + turn.cumsum(-1)
        self._plan[envs] = torch.stack((wait.cumsum(-1), courses, speeds), dim=-1).to(self._plan)
        self._time[envs], self._next[envs] = 0.0, 0
        course, speed = course.to(self._course), speed.to(self._speed)
        self._steered[envs] = self._course[envs] = course
        self._speed[envs] = speed
        self.velocity[envs] = speed.unsqueeze(-1) * torch.stack((course.cos(), course.sin()), dim=-1)
        still = self._plan.new_zeros((n, self.fleet.count, 2))
        state = level_states(still, course.unsqueeze(-1).expand(-1, self.fleet.count), speed.unsqueeze(-1))
        if self.fleet.count > 1:  # further vessels of the team follow in line, without escort
            state[..., 1:, :2] = (
                -20.0
                * torch.arange(1, self.fleet.count).view(1, -1, 1)
                * torch.stack((course.cos(), course.sin()), dim=-1).unsqueeze(1).to(state)
            )
        return state

    def __call__(self, world: World) -> Tensor:
        """Actions for this decision."""
        way, dt = self.config.course, self.config.decision_interval
        self._time += dt
        rows = torch.arange(len(self._time), device=self._time.device)
        due = self._plan[rows, self._next.clamp(max=self._plan.shape[1] - 1)]
        when, course, speed = due.unbind(-1)
        now = (self._time >= when) & (self._next < self._plan.shape[1])
        self._course, self._speed = torch.where(now, course, self._course), torch.where(now, speed, self._speed)
        self._next += now
        place = self.fleet.position_n[:, 0, :2]
        course, speed = self._course, self._speed
        if way.evasive:
            course, speed = self._run(place, course, speed)
        outside = place.abs().amax(-1) > EDGE * self.config.area
        self._course = course = torch.where(outside, course_of(-place), course)
        most = math.radians(way.turn_rate_deg) * dt
        self._steered = self._steered + wrap(course - self._steered).clamp(-most, most)
        heading = torch.stack((self._steered.cos(), self._steered.sin()), dim=-1)
        wanted = (speed.unsqueeze(-1) * heading).unsqueeze(1).expand(-1, self.fleet.count, -1).contiguous()
        if self._among is not None:
            self._sensor.look(self._among.obstacles, self._among.env_world, bodies=self._among.traffic)
            self._see_boats(self._among.boats)
            self.now.slot_velocity[..., :2] = wanted
            wanted = self._avoid(self, wanted)
        share = dt / (SMOOTH + dt)
        self.velocity += share * (self.fleet.velocity_n[:, 0, :2] - self.velocity)
        return self.controller.act(self, CourseCommand(wanted, torch.zeros_like(wanted)))

    def _see_boats(self, boats: Fleet | None) -> None:
        """Write the nearest boats as mates."""
        mates = self.sensor.team_mates
        mates.zero_()
        mates[..., Mate.DISTANCE], mates[..., Mate.NUMBER] = REACH, -1.0
        if boats is None:
            return
        to = boats.position_n[:, None, :, :2] - self.fleet.position_n[:, :, None, :2]
        far, which = to.norm(dim=-1).topk(min(BOATS, boats.count), dim=-1, largest=False)
        k = far.shape[-1]
        place = to.gather(2, which.unsqueeze(-1).expand(*which.shape, 2))
        velocity = boats.velocity_n[:, None, :, :2].expand(-1, self.fleet.count, -1, -1)
        velocity = velocity.gather(2, which.unsqueeze(-1).expand(*which.shape, 2))
        near = (far < REACH).unsqueeze(-1)
        mates[:, :, :k, Mate.DISTANCE] = far.clamp(max=REACH)
        mates[:, :, :k, Mate.NORTH : Mate.DOWN] = torch.where(near, place / far.unsqueeze(-1).clamp(min=1e-6), 0.0)
        mates[:, :, :k, Mate.V_NORTH : Mate.SIZE] = velocity

    def _run(self, place: Tensor, course: Tensor, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Flee from the nearest boat within range at top speed."""
        boats = self._among.boats if self._among is not None else None
        if boats is None:
            return course, speed
        away = place.unsqueeze(1) - boats.position_n[..., :2]
        near, which = away.norm(dim=-1).min(dim=-1)
        least = away.gather(1, which.view(-1, 1, 1).expand(-1, 1, 2)).squeeze(1)
        hunted = near < self.config.course.evasive_range
        course = torch.where(hunted, course_of(least), course)
        return course, torch.where(hunted, torch.full_like(speed, self.config.course.speed[1]), speed)
