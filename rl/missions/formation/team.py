"""One team of the formation mission: true errors and surroundings of its vehicles, what they know, its observations."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.course.obstacles import Bodies
from rl.guidance.geometry import Geometry, SlotErrors, Target, Targets
from rl.guidance.knowledge import Knowledge
from rl.guidance.observations import ObservationWriter
from rl.guidance.residual import ResidualTeam
from rl.missions.formation.slots import Slots
from rl.perception.contacts import TrackedContacts
from rl.perception.instruments import Readings
from rl.perception.radio import Radio
from rl.perception.sensors import Nearby, Sensor
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime

if TYPE_CHECKING:
    from rl.missions.formation.mission import Formation

GLIDE_SHARE = 0.15  # of the target's speed, with which slots glide to a new formation; assumed


class TeamTask(ResidualTeam):
    """One team, measured after each step; every tensor is [env, vehicle, ...]. It is its own ground truth.

    Attributes:
        target: what its leader tracks. now: errors as of the last step or reset (geometry.py).
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
        state, model, config = self.fleet.state, self.fleet.model, mission.config
        flies = model.medium == "air"
        down = -config.track.flight_height if flies else 0.0
        self.axes, self.radius = 3 if flies else 2, model.collision_radius
        glide = self.section.formation.glide or GLIDE_SHARE * config.track.target_speed
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
        """Terms of its observations and their widths (observations.py)."""
        return self.observations.widths

    def observe(self) -> Tensor:
        """Observations [env, vehicle, n] (observations.py), a fresh tensor each time."""
        with runtime.torch_at_rest():
            return self.observations(self.action, self.reference())

    @property
    def privileged(self) -> Tensor | None:
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
