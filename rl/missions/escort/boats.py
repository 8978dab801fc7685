"""The boats of the escort: true errors from their slots about the vessel, and what the boats know."""

from collections.abc import Mapping

import torch
from torch import Tensor

from rl.guidance.controllers import controller_of
from rl.guidance.observations import MEANINGS, ObservationWriter, squashed
from rl.guidance.residual import ResidualTeam
from rl.guidance.shapes import escort_offsets
from rl.guidance.targets_and_errors import OFFSET, RATE, SLOT_SIZE, Geometry, Target, course_of
from rl.guidance.targets_and_errors import TARGET_SIZE as TARGET
from rl.missions.escort.host import EscortHost
from rl.missions.escort.rewards import BOAT_TERMS
from rl.missions.escort.tracking import LOGGED, ObserverGroup, SharedTracking, SpiralSearch, log_of, margins_of
from rl.perception.chart import ChartedObjects
from rl.perception.instruments import Readings
from rl.perception.sensors import Sensor
from rl.perception.sightings import Lookout
from rl.step import Due
from rl.team import Controller, Endings
from taichi_sim.state.memory import Remembers

AGE_SCALE, SIGMA_SCALE = 5.0, 10.0  # s, m at which an observation of a track reaches 1/2
SEARCH_SPEED = 0.7  # along the spiral, in top speeds; assumed
SEARCH_PITCH = 1.6  # between two turns of the spiral, in ranges of the lookout; assumed
SEARCHES = 15.0  # m from the expected vessel at which a search begins
LINEAR = 10.0  # m from a boat's slot: beyond it a plan's cost grows linearly
NEAR_COST, ENDED_COST = 10.0, 2e3  # of plans, m: for each m less than the berth; for an ending


def boat_observers(mission: EscortHost, name: str, first: int) -> ObserverGroup:
    """Make the observer group of the boats of team `name`, numbered from `first` on."""
    config, fleet = mission.config, mission.world.teams[name]
    section = config.parts[name]
    own = Readings(fleet, section.sensors, config.decision_interval, config.first_number(name))
    pitch, speed = SEARCH_PITCH * section.lookout.vessel_range, SEARCH_SPEED * fleet.model.limits.speeds[2]
    return ObserverGroup(first, own, fleet, SpiralSearch(pitch, speed, SEARCHES))


class EscortBoats(ResidualTeam):
    """The team of boats, measured after each step; every tensor is [env, boat, ...].

    The class implements `Knowledge` (rl/guidance/knowledge.py) with the true values.

    Attributes:
        now: errors from the slots about the true vessel; measured.now: about the vessel as each boat knows it.
        target: the true vessel. sensor: obstacles near, the vessel among them. distance, before: m from the slot, now
            and a decision ago. own: what the instruments measure. measured: the input of policies and controllers.
    """

    terms = BOAT_TERMS
    logged = LOGGED
    meanings = MEANINGS | {
        "track_age": f"age of what is known of the vessel, s, squashed by {AGE_SCALE:g}",
        "track_sigma": f"standard deviation of its place, m, squashed by {SIGMA_SCALE:g}",
    }
    mission: EscortHost
    axes = 2
    radio = None

    def __init__(self, mission: EscortHost, name: str, tracking: SharedTracking):
        """Make team `name`, whose boats are among the observers of `tracking`."""
        super().__init__(mission, name)
        config, state, model = mission.config, self.fleet.state, self.fleet.model
        self.radius, self.interval, self.tracking = model.collision_radius, config.decision_interval, tracking
        offsets = escort_offsets(self.section.formation, self.fleet.count, self.section.spacing)
        self.offsets = offsets.to(state)
        sensing = config.sensing
        self.sensor = self.remember(
            Sensor(self.fleet, sensing.obstacles, sensing.team_mates, sensing.detection_range, self.radius, "heading")
        )
        slots = state.new_zeros((mission.num_envs, self.fleet.count, SLOT_SIZE))
        slots[..., OFFSET:RATE] = self.offsets
        self.slot_table = slots
        table = state.new_zeros((mission.num_envs, 1, TARGET))
        self.now = self.remember(
            Geometry(self.fleet, table, 0.0, self.slot_table, self.axes, self.interval, about=True)
        )
        self.target = self.remember(Target(table, self.now.slot[:, 0]))
        self.before = self.remember(torch.zeros_like(self.now.distance))
        group, number = tracking.groups[name], config.first_number(name)
        assert isinstance(group.own, Readings)
        self.own = self.remember(group.own)
        self.lookout = self.remember(Lookout(
            self.section.lookout, self.section.sensors, tracking.sightings, tracking.objects, self.fleet, self.own,
            mission.elevation, vehicles=number,
        ))  # fmt: skip
        self.measured = self.remember(MeasuredBoats(self, number))
        self.writer = ObservationWriter(self.measured, "full", self.reference_width)
        self._true = ObservationWriter(self, "full", self.reference_width)

    def follow(self, place: Tensor, velocity: Tensor) -> None:
        """Write the true vessel's place and velocity [env, 2] (NED, m, m/s) into `target`."""
        (north, east), speed, course = place.unbind(-1), velocity.norm(dim=-1), course_of(velocity)
        target = (north, east, 0 * speed, course, course.cos(), course.sin(), 0 * speed, speed)
        self.target.table[:, 0] = torch.stack(target, dim=-1)

    @property
    def known(self) -> "MeasuredBoats":
        """What is measured."""
        return self.measured

    def truth(self, due: Due) -> None:
        """Measure errors about the true vessel, and gaps to all around."""
        super().truth(due)
        self.before = torch.where(due.goes_on.unsqueeze(-1), self.now.distance, self.before)
        self.now.measure(due)
        self.before = torch.where(due.begins.unsqueeze(-1), self.now.distance, self.before)
        mission = self.mission
        self.sensor.look(mission.obstacles, mission.env_world, due, mission.bodies)

    def perceive(self, due: Due) -> None:
        """Read the instruments."""
        self.own.read(due)

    def look(self, due: Due) -> None:
        """Look out for the vessel and obstacles."""
        self.lookout.see(due)

    def conclude(self, due: Due) -> None:
        """Update errors about the vessel as each boat knows it, and what is near."""
        super().conclude(due)
        self.measured.conclude(due)

    def plan_cost(self, ended: Tensor) -> Tensor:
        """Distance from the slot, squared where it is small, plus NEAR_COST and ENDED_COST."""
        far, near = self.distance, (self.section.plan.berth - self.sensor.gap).clamp(min=0.0)
        return far.square() / (far + LINEAR) + NEAR_COST * near + ENDED_COST * ended

    def margins(self) -> dict[str, Tensor]:
        """To contact with an obstacle, the vessel or a team mate; to the edge of the area."""
        return margins_of(self.fleet, self.sensor, self.mission.config)

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """See tracking.py."""
        return log_of(self.distance, self.tracking, ended, self.mission.arrived, self.mission.config)

    def info(self) -> dict[str, Tensor]:
        """distance: m, from the slot."""
        return {"distance": self.distance}

    def make_controller(self) -> Controller | None:
        """The vehicle's own controller, else that of formations for its model."""
        own = super().make_controller()
        return own or controller_of(self.fleet.model, self.section.control, f"{self.name}.control")

    @property
    def written(self) -> Mapping[str, int]:
        """Terms of the team's observations and their widths: those of formations, and two of the vessel's track."""
        return {**self.writer.widths, "track_age": 1, "track_sigma": 1}

    def write(self) -> Tensor:
        """Observations [env, boat, n], a fresh tensor each time."""
        age, sigma = (self.tracking.of(self.name, x).unsqueeze(-1) for x in (self.tracking.age, self.tracking.sigma))
        row = self.writer(self.action, self.reference())
        return torch.cat((row, squashed(age, AGE_SCALE), squashed(sigma, SIGMA_SCALE)), dim=-1)

    def truth_now(self) -> Tensor | None:
        """Ground truth [env, boat, n]: the observations without errors of measurement, and the numbers that vary."""
        parts = [self._true(self.action, self.reference())]
        if self.mission.config.varies:
            parts.append(self.mission.world.truth[self.name])
        return torch.cat(parts, dim=-1)

    @property
    def distance(self) -> Tensor:
        """Distance from the slot about the true vessel, m."""
        return self.now.distance


class MeasuredBoats(Remembers):
    """Knowledge of the boats (rl/guidance/knowledge.py).

    Attributes:
        fleet: own state as measured. target: each boat's estimate of the vessel, a row for each boat.
        now: errors from the slots about that estimate. sensor: charted objects near, team mates as measured.
    """

    axes = EscortBoats.axes
    radio = None

    def __init__(self, team: EscortBoats, number: int):
        """Measure for `team`, whose first boat has that `number` among the random numbers."""
        tracking = team.tracking
        self._team, self.fleet = team, team.own
        self.radius, self.slot_table = team.radius, team.slot_table
        table = tracking.of(team.name, tracking.targets).contiguous().clone()
        self.now = self.remember(
            Geometry(self.fleet, table, 0.0, team.slot_table, team.axes, team.interval, about=True)
        )
        self.target = self.remember(Target(table, self.now.slot[:, 0]))
        self.sensor = self.remember(ChartedObjects(
            team.section.sensors.scaled_objects, team.sensor, team.fleet, self.fleet, team.interval, number,
            chart=tracking.chart, first=tracking.groups[team.name].first, objects=tracking.objects,
        ))  # fmt: skip

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self._team.steps

    def conclude(self, due: Due) -> None:
        """Update all where it is `due`."""
        tracking = self._team.tracking
        self.target.table.copy_(tracking.of(self._team.name, tracking.targets))
        self.now.measure(due)
        self.sensor.update(due)
