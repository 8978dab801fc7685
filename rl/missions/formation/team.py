"""The teams of a formation: each holds formation behind a target that moves along a track."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import torch
from torch import Tensor

from rl.guidance.controllers import controller_of
from rl.guidance.course.obstacles import Bodies
from rl.guidance.course.route import Fence
from rl.guidance.knowledge import Knowledge
from rl.guidance.observations import MEANINGS, ObservationWriter, air_columns
from rl.guidance.residual import ResidualTeam
from rl.guidance.targets_and_errors import Geometry, SlotErrors, Target, Targets
from rl.missions.formation.config import FormationScenario
from rl.missions.formation.rewards import PAPER, TERMS
from rl.missions.formation.slots import Slots
from rl.perception.instruments import Readings
from rl.perception.radio import Radio
from rl.perception.sensors import Nearby, Sensor
from rl.perception.tracked_objects import TrackedObjects
from rl.step import Due, Endings
from rl.team import Controller, Host
from rl.terms import Term
from taichi_sim.fleet import Fleet
from taichi_sim.state.memory import Remembers

GLIDE_SHARE = 0.15  # of the target's speed, with which slots glide to a new formation; assumed
NEAR_COST, ENDED_COST = 300.0, 2e4  # of plans, m^2: for each m less than the berth; for an ending


class Course(Host, Protocol):
    """What the teams have in common: where they sail and fly."""

    obstacles: Tensor  # [world, n, 4] north, east, radius, height, m
    bodies: Bodies
    fences: Sequence[Fence]
    env_world: Tensor  # int64 [env]

    @property
    def config(self) -> FormationScenario:
        """The scenario."""
        ...


class TeamTask(ResidualTeam):
    """One team, measured after each step; every tensor is [env, vehicle, ...].

    The class implements `Knowledge` (rl/guidance/knowledge.py) with the true values.

    Attributes:
        targets: of all environments, on their tracks. target: what its leader tracks.
        now: errors as of the last step or reset (geometry.py).
        measured: what its vehicles know, the input of policies and controllers; None: the team itself.
        writer: writes what its policy observes. sensor: true obstacles and team mates.
        slots: about the leader (slots.py). offsets: [env, vehicle, 2] of them, a live view, m.
    """

    terms = TERMS
    logged = ("leader_error_m", "follower_error_m", "collisions_per_hour", "lost")
    meanings = MEANINGS
    mission: Course
    radio = None

    def __init__(self, mission: Course, name: str, targets: Targets):
        """Make team `name`, which holds formation behind `targets`; those of aircraft are at the flight height."""
        super().__init__(mission, name)
        self.targets = targets
        state, model, config = self.fleet.state, self.fleet.model, mission.config
        flies = model.medium == "air"
        down = -config.track.flight_height if flies else 0.0
        self.axes, self.radius = 3 if flies else 2, model.collision_radius
        glide = self.section.formation.glide or GLIDE_SHARE * config.pace(name).speed
        interval, steps = config.decision_interval, config.episode_steps
        self.slots = self.remember(Slots(self.section, state, interval=interval, glide=glide, steps=steps))
        self.offsets, self.slot_table = self.slots.offsets, self.slots.table
        sensing, frame = config.sensing, "body" if flies else "heading"
        reach = sensing.detection_range
        # The number of mates observed does not depend on the team's size: one that does not exist is out of range.
        self.sensor = self.remember(
            Sensor(self.fleet, sensing.obstacles, sensing.team_mates, reach, self.radius, frame)
        )
        self.now = self.remember(Geometry(self.fleet, targets.table, down, self.slot_table, self.axes, interval))
        self.target = self.remember(Target(targets.table, self.now.slot[:, 0]))
        exact = config.radio is None and config.sensors.exact and config.sensors.scaled_objects.exact
        self.measured = self.remember(None if exact else MeasuredFormation(self, down))
        self.writer = ObservationWriter(self.known, config.observations, self.reference_width)
        self._true = None if exact else ObservationWriter(self, config.observations, self.reference_width)

    @classmethod
    def declared(cls, config: FormationScenario) -> Mapping[str, Term]:
        """`terms`, with the weights of the scenario's `reward`."""
        weights = PAPER if config.reward == "paper" else {}
        return {name: term._replace(weight=weights.get(name, term.weight)) for name, term in cls.terms.items()}

    @property
    def written(self) -> Mapping[str, int]:
        """Terms of the team's observations and their widths (observations.py)."""
        return self.writer.widths

    @property
    def observed_air(self) -> tuple[int, ...]:
        """Those of aircraft."""
        return air_columns(self.fleet.model)[0]

    def write(self) -> Tensor:
        """Observations [env, vehicle, n] (observations.py), a fresh tensor each time."""
        return self.writer(self.action, self.reference())

    def truth_now(self) -> Tensor | None:
        """Ground truth [env, vehicle, n] that its vehicles do not know: errors, surroundings, numbers that vary."""
        parts = []
        if self._true is not None:
            parts.append(self._true(self.action, self.reference()))
        if self.mission.config.varies:
            parts.append(self.mission.world.truth[self.name])
        return torch.cat(parts, dim=-1) if parts else None

    @property
    def known(self) -> Knowledge:
        """What is measured, or else the truth."""
        return self.measured or self

    def truth(self, due: Due) -> None:
        """Measure errors (geometry.py), and gaps to obstacles, bodies and team mates."""
        super().truth(due)
        self.now.measure(due)
        mission = self.mission
        self.sensor.look(mission.obstacles, mission.env_world, due, mission.bodies)

    def perceive(self, due: Due) -> None:
        """Read the instruments."""
        if self.measured is not None:
            self.measured.perceive(due)

    def exchange(self, due: Due) -> None:
        """Tell each other place and velocity."""
        if self.measured is not None:
            self.measured.exchange(due)

    def conclude(self, due: Due) -> None:
        """Update errors as they are known, and tracks of what is near."""
        super().conclude(due)
        if self.measured is not None:
            self.measured.conclude(due)

    @property
    def distance(self) -> Tensor:
        """Distance (m) of each vehicle from its slot: the leader's tracking error, a follower's formation error."""
        return self.now.distance

    def plan_cost(self, ended: Tensor) -> Tensor:
        """Squared distance from the slot, plus NEAR_COST and ENDED_COST."""
        near = (self.section.plan.berth - self.sensor.gap).clamp(min=0.0)
        return self.distance.square() + NEAR_COST * near + ENDED_COST * ended

    def margins(self) -> dict[str, Tensor]:
        """To contact with an obstacle or a team mate, to being lost, to the edge of the area or a geofence, m."""
        left = self.mission.config.area / 2 - self.now.reach
        for fence in self.mission.fences:
            left = torch.minimum(left, fence.clearance(self.fleet.position_n[..., :2]))
        return {"collided": self.sensor.gap, "lost": self.section.lost_distance - self.distance, "left": left}

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """Errors now, collisions per hour of vehicle time, and vehicles lost in this step."""
        hours = self.distance.numel() * self.mission.config.decision_interval / 3600
        followers = {"follower_error_m": self.distance[:, 1:].mean()} if self.fleet.count > 1 else {}
        return {
            "leader_error_m": self.distance[:, 0].mean(),
            **followers,
            "collisions_per_hour": ended["collided"].sum() / hours,
            "lost": ended["lost"].sum(),
        }

    def info(self) -> dict[str, Tensor]:
        """distance: m, from the slot (the leader's: from the target)."""
        return {"distance": self.distance}

    def make_controller(self) -> Controller | None:
        """The vehicle's own controller, else that of rl/guidance/controllers for its model."""
        own = super().make_controller()
        return own or controller_of(self.fleet.model, self.section.control, f"{self.name}.control")


class MeasuredFormation(Remembers):
    """One team's measured knowledge (rl/guidance/knowledge.py); parts without errors are those of the team itself.

    Rewards, endings and figures use the truth. Target and formation are the plan, which every vehicle knows exactly.
    """

    def __init__(self, team: TeamTask, down: float):
        """Measure for `team`, whose target is at `down` (m)."""
        mission = team.mission
        config, interval = mission.config, mission.config.decision_interval
        number = config.first_number(team.name)
        exact, contacts = config.sensors.exact, config.sensors.scaled_objects
        self.axes, self.radius = team.axes, team.radius
        self.target, self.slot_table = team.target, team.slot_table
        self._team = team
        self.fleet: Fleet | Readings = self.remember(
            team.fleet if exact else Readings(team.fleet, config.sensors, interval, number)
        )
        self.radio = self.remember(
            None if config.radio is None else Radio(config.radio, team.fleet.state, interval, vehicles=number)
        )
        self.now: SlotErrors = self.remember(team.now)
        if not exact or self.radio is not None:
            heard = None if self.radio is None else self.radio.heard
            self.now = Geometry(self.fleet, team.target.table, down, team.slot_table, team.axes, interval, heard)
        self.sensor: Nearby = self.remember(team.sensor)
        if not (exact and contacts.exact):
            self.sensor = TrackedObjects(contacts, team.sensor, team.fleet, self.fleet, interval, number)

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self._team.steps

    def perceive(self, due: Due) -> None:
        """Read the instruments."""
        if isinstance(self.fleet, Readings):
            self.fleet.read(due)

    def exchange(self, due: Due) -> None:
        """Tell each other place and velocity."""
        if self.radio is not None:
            torch.cat((self.fleet.position_n, self.fleet.velocity_n), dim=-1, out=self.radio.said)
            self.radio.talk(due)

    def conclude(self, due: Due) -> None:
        """Update errors and tracks."""
        if isinstance(self.now, Geometry) and self.now is not self._team.now:
            self.now.measure(due)
        if isinstance(self.sensor, TrackedObjects):
            self.sensor.update(due)
