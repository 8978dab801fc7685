"""The boats of the escort: true errors from their slots about the vessel, and what the boats know."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.guidance.geometry import OFFSET, RATE, SLOT_SIZE, Geometry, Target
from rl.guidance.geometry import TARGET_SIZE as TARGET
from rl.guidance.observations import ObservationWriter, squashed
from rl.guidance.residual import ResidualTeam
from rl.guidance.shapes import escort_offsets
from rl.missions.escort.tracking import ObserverGroup, SharedTracking, SpiralSearch
from rl.perception.chart import Charted
from rl.perception.contacts import TrackedContacts
from rl.perception.instruments import Readings
from rl.perception.sensors import Sensor
from rl.perception.sightings import Lookout

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort

AGE_SCALE, SIGMA_SCALE = 5.0, 10.0  # s, m at which an observation of a track reaches 1/2
SEARCH_SPEED = 0.7  # along the spiral, in top speeds; assumed
SEARCH_PITCH = 1.6  # between two turns of the spiral, in ranges of the lookout; assumed
BEGINS = 15.0  # m from the expected vessel at which a search begins


def boat_observers(mission: "Escort", name: str, first: int) -> ObserverGroup:
    """Make the observer group of the boats of team `name`, numbered from `first` on."""
    config, fleet = mission.config, mission.world.teams[name]
    section = config.parts[name]
    own = Readings(fleet, section.sensors, config.decision_interval, config.first_number(name))
    pitch, speed = SEARCH_PITCH * section.lookout.vessel_range, SEARCH_SPEED * fleet.model.limits.speeds[2]
    return ObserverGroup(first, own, fleet, SpiralSearch(pitch, speed, BEGINS))


class EscortBoats(ResidualTeam):
    """The team of boats, measured after each step; every tensor is [env, boat, ...].

    The class implements `Knowledge` (rl/guidance/knowledge.py) with the true values.

    Attributes:
        now: errors from the slots about the true vessel; known.now: about the vessel as each boat knows it.
        target: the true vessel. sensor: obstacles near, the vessel among them. distance, before: m from the slot, now
            and a decision ago. own: what the instruments measure. known: the input of policies and controllers.
    """

    STATE = ("now", "sensor", "before", "own", "lookout", "target", "known")

    mission: "Escort"
    axes = 2
    radio = None

    def __init__(self, mission: "Escort", name: str, tracking: SharedTracking):
        """Make team `name`, whose boats are among the observers of `tracking`."""
        super().__init__(mission, name)
        config, state, model = mission.config, self.fleet.state, self.fleet.model
        self.radius, self.interval, self.tracking = model.collision_radius, config.decision_interval, tracking
        offsets = escort_offsets(self.section.formation, self.fleet.count, self.section.spacing)
        self.offsets = offsets.to(state)
        sensing = config.sensing
        self.sensor = Sensor(
            self.fleet, sensing.obstacles, sensing.team_mates, sensing.detection_range, self.radius, "heading"
        )
        self.slot_table = state.new_zeros((mission.num_envs, self.fleet.count, SLOT_SIZE))
        self.slot_table[..., OFFSET:RATE] = self.offsets
        table = state.new_zeros((mission.num_envs, 1, TARGET))
        self.now = Geometry(self.fleet, table, 0.0, self.slot_table, self.axes, about=True)
        self.target = Target(table, self.now.slot[:, 0])
        self.before = torch.zeros_like(self.now.distance)
        group, number = tracking.groups[name], config.first_number(name)
        assert isinstance(group.own, Readings)
        self.own = group.own
        self.lookout = Lookout(
            self.section.lookout, self.section.sensors, tracking.sightings, tracking.objects, self.fleet, self.own,
            mission.elevation, vehicles=number,
        )  # fmt: skip
        self.known = self.measured = MeasuredBoats(self, number)
        self.observations = ObservationWriter(self.known, "full", self.reference_width)
        self._true = ObservationWriter(self, "full", self.reference_width)

    def measure(self, which: Tensor, count: int) -> None:
        """Measure the truth and read the instruments in the `count` environments where `which` [env] int32 is not 0."""
        self.forget()
        self.before = torch.where((which == 1).unsqueeze(-1), self.now.distance, self.before)
        self.now.measure(which, count)
        self.before = torch.where((which == 2).unsqueeze(-1), self.now.distance, self.before)
        mission = self.mission
        self.sensor.look(mission.obstacles, mission.env_world, which, count, mission.bodies)
        self.own.read(which, count, mission.noise.table)

    def look(self, which: Tensor, rows: int) -> None:
        """Look out for the vessel and obstacles in the `rows` environments where `which` [env] int32 is not 0."""
        self.lookout.see(which, rows, self.mission.noise.table)

    def conclude(self, which: Tensor, count: int) -> None:
        """Update what the boats know; call after `SharedTracking.update`."""
        self.measured.measure(which, count)

    @property
    def layout(self) -> Mapping[str, int]:
        """Terms of the team's observations and their widths: those of formations, and two of the vessel's track."""
        return {**self.observations.widths, "track_age": 1, "track_sigma": 1}

    def observations_now(self) -> Tensor:
        """Observations [env, boat, n], a fresh tensor each time."""
        age, sigma = (self.tracking.of(self.name, x).unsqueeze(-1) for x in (self.tracking.age, self.tracking.sigma))
        row = self.observations(self.action, self.reference())
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


class MeasuredBoats:
    """Knowledge of the boats (rl/guidance/knowledge.py).

    Attributes:
        fleet: own state as measured. target: each boat's estimate of the vessel, a row for each boat.
        now: errors from the slots about that estimate. sensor: charted objects near, team mates as measured.
    """

    STATE = ("target", "now", "sensor")

    axes = EscortBoats.axes
    radio = None

    def __init__(self, team: EscortBoats, number: int):
        """Measure for `team`, whose first boat has that `number` among the random numbers."""
        tracking = team.tracking
        self._team, self.fleet = team, team.own
        self.radius, self.slot_table = team.radius, team.slot_table
        table = tracking.of(team.name, tracking.targets).contiguous().clone()
        self.now = Geometry(self.fleet, table, 0.0, team.slot_table, team.axes, about=True)
        self.target = Target(table, self.now.slot[:, 0])
        self.sensor = TrackedContacts(
            team.section.sensors.scaled_contacts, team.sensor, team.fleet, self.fleet, team.interval, number
        )
        first = tracking.groups[team.name].first
        self._charted = Charted(self.sensor, tracking.chart, first, tracking.objects, self.fleet)

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self._team.steps

    def measure(self, which: Tensor, rows: int) -> None:
        """Measure in the `rows` environments where `which` [env] int32 is not 0."""
        tracking = self._team.tracking
        self.target.table.copy_(tracking.of(self._team.name, tracking.targets))
        self.now.measure(which, rows)
        self.sensor.update(which, rows, self.steps, self._team.mission.noise.table)
        self._charted.write(which, rows)
