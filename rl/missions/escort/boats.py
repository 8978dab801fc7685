"""The boats of the escort: errors from their slots about the vessel, and what they know of all that."""

from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor

from rl.guidance.geometry import SLOT_SIZE, Geometry
from rl.guidance.observations import ObservationWriter
from rl.guidance.residual import ResidualTeam
from rl.guidance.targets import SIZE as TARGET
from rl.guidance.targets import seen_at
from rl.missions.escort.shapes import escort_offsets
from rl.missions.escort.tracking import Group, Search
from rl.perception.chart import Charted
from rl.perception.contacts import Contacts
from rl.perception.instruments import Readings
from rl.perception.lookout import Lookout
from rl.perception.sensors import Sensor

AGE_SCALE, SIGMA_SCALE = 5.0, 10.0  # s, m, where what is observed of a track is half way to 1
SEARCH_SPEED = 0.7  # of the top speed, along the spiral; assumed
SEARCH_PITCH = 1.6  # ranges at which the vessel is seen, between two turns of the spiral; assumed
BEGINS = 15.0  # m from where the vessel should be


class Boats(ResidualTeam):
    """Measures the boats after each step; everything is [env, boat, ...].

    Attributes:
        now: errors from the slots about the vessel as it is; known.now: about the vessel as each boat knows it.
        sensor: what is near, the vessel among it. distance, before: m from the slot, now and a decision ago.
        known: what policies and controllers act by.
    """

    STATE = ("now", "sensor", "before", "own", "targets", "known")

    axes = 2

    def __init__(self, mission: Any, name: str):
        """Prepare team `name`."""
        super().__init__(mission, name)
        config, state, model = mission.config, self.fleet.state, self.fleet.model
        self.radius, self.interval = model.collision_radius, config.decision_interval
        offsets = escort_offsets(self.section.formation, self.fleet.count, self.section.spacing)
        self.offsets = offsets.to(state)
        sensing = config.sensing
        self.sensor = Sensor(
            self.fleet, sensing.obstacles, sensing.team_mates, sensing.detection_range, self.radius, "heading"
        )
        slots = torch.zeros((mission.num_envs, self.fleet.count, SLOT_SIZE), dtype=state.dtype, device=state.device)
        slots[..., :2] = self.offsets
        self.slots = SimpleNamespace(table=slots, offsets=slots[..., :2])
        self.targets = SimpleNamespace(table=state.new_zeros((mission.num_envs, 1, TARGET)))
        self.now = Geometry(self.fleet, self.targets.table, 0.0, slots, self.axes, about=True)
        self.known: Any
        self._true: ObservationWriter | None = None
        self.before = torch.zeros_like(self.now.distance)

    def group(self, first: int, number: int) -> Group:
        """As observers, the first of which has that number; the team is the `number`-th of its mission."""
        self.own = Readings(self.fleet, self.section.sensors, self.interval, 64 * number)
        search = Search(
            SEARCH_PITCH * self.section.lookout.vessel_range, SEARCH_SPEED * self.fleet.model.limits.speeds[2], BEGINS
        )
        self._number = number
        return Group(first, self.own, self.fleet, search)

    def join(self, tracking: Any) -> None:
        """Look out, and know what the `tracking` has."""
        mission, number = self.mission, 64 * self._number
        self.tracking = tracking
        tracking.observers.append(
            Lookout(
                self.section.lookout, self.section.sensors, tracking.sightings, tracking.objects, self.fleet, self.own,
                mission.elevation, vehicles=number,
            )
        )  # fmt: skip
        self.known = MeasuredBoats(self, tracking, number)
        self.target = self.known.target
        self.seen = ObservationWriter(self.known, "full")

    def measure(self, which: Tensor, count: int) -> None:
        """The truth, in environments `which` [env] int32, `count` of them; and what instruments say."""
        self.forget()
        self.before = torch.where((which == 1).unsqueeze(-1), self.now.distance, self.before)
        self.now.measure(which, count)
        self.before = torch.where((which == 2).unsqueeze(-1), self.now.distance, self.before)
        mission = self.mission
        self.sensor.look(mission.obstacles, mission.env_world, which, count, mission.bodies)
        self.own.read(which, count, mission.noise.table)

    def conclude(self, which: Tensor, count: int) -> None:
        """What they know, once the tracking is up to date."""
        self.known.measure(which, count)

    def terms(self) -> dict[str, Tensor]:
        """What each boat is told: as in formations, and how old and how good its track of the vessel is."""
        flat = self._flat(self.seen)
        terms = dict(zip(self.seen.widths, flat.split(list(self.seen.widths.values()), dim=-1), strict=True))
        name, tracking = self.name, self.tracking
        age, sigma = (tracking.of(name, x).unsqueeze(-1) for x in (tracking.age, tracking.sigma))
        return terms | {"track_age": squashed(age, AGE_SCALE), "track_sigma": squashed(sigma, SIGMA_SCALE)}

    def _flat(self, observer: ObservationWriter) -> Tensor:
        return observer(self.action, self.action if self.residual is None else self.reference())

    @property
    def privileged(self) -> Tensor | None:
        """The truth [env, boat, n], and what varies."""
        if self._true is None:
            self._true = ObservationWriter(self, "full")
        told = [self._flat(self._true)]
        if self.mission.config.varies:
            told.append(self.mission.world.truth[self.name])
        return torch.cat(told, dim=-1)

    @property
    def distance(self) -> Tensor:
        """m from the slot about the vessel as it is."""
        return self.now.distance


def squashed(x: Tensor, scale: float) -> Tensor:
    """x / (|x| + scale)."""
    return x / (x.abs() + scale)


class MeasuredBoats:
    """What the boats know; what is not here is as in the team.

    Attributes: fleet, own state as measured. now: errors from the slots about the vessel as known. sensor: objects near
        by the chart, team mates as measured. targets, target: the vessel as known, a row for each boat.
    """

    STATE = ("targets", "now", "sensor")

    def __init__(self, team: Boats, tracking: Any, number: int):
        """Of `team`; `number` vehicles of others come before it, among the random numbers."""
        interval = team.interval
        self._team, self._tracking, self.fleet = team, tracking, team.own
        table = tracking.rows(team.name).contiguous().clone()
        self.targets = SimpleNamespace(table=table)
        self.now = Geometry(self.fleet, table, 0.0, team.slots.table, team.axes, about=True)
        self.target = seen_at(table, self.now.slot[:, 0])
        self.sensor = Contacts(
            team.section.sensors.scaled_contacts, team.sensor, team.fleet, self.fleet, interval, number
        )
        first = tracking.groups[team.name].first
        self._charted = Charted(self.sensor, tracking.chart, first, tracking.objects, self.fleet)

    def __getattr__(self, name: str) -> Any:
        """What is not known otherwise is known as it is."""
        return getattr(self._team, name)

    def measure(self, which: Tensor, rows: int) -> None:
        """In environments `which` [env] int32, `rows` of them."""
        mission = self._team.mission
        self.targets.table.copy_(self._tracking.rows(self._team.name))
        self.now.measure(which, rows)
        self.sensor.update(which, rows, mission.steps, mission.noise.table)
        self._charted.write(which, rows)
