"""The boats of the escort: errors from their slots about the vessel, and what they know."""

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from rl.guidance.corrected import Corrected
from rl.guidance.geometry import SLOT_SIZE, Geometry
from rl.guidance.observations import Observer
from rl.guidance.targets import SIZE as TARGET
from rl.guidance.targets import seen_at
from rl.missions.escort.picture import CommonPicture, ObserverGroup, SearchPattern
from rl.missions.escort.shapes import escort_offsets
from rl.perception.chart import Charted
from rl.perception.contacts import Contacts
from rl.perception.instruments import Readings
from rl.perception.lookout import Lookout
from rl.perception.sensors import Sensor

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort

AGE_SCALE, SIGMA_SCALE = 5.0, 10.0  # s, m at which an observation of a track reaches 1/2
SEARCH_SPEED = 0.7  # along the spiral, in top speeds; assumed
SEARCH_PITCH = 1.6  # between two turns of the spiral, in ranges of the lookout; assumed
BEGINS = 15.0  # m from the expected vessel at which a search begins


class EscortBoats(Corrected):
    """The team of boats, measured after each step; every tensor is [env, boat, ...].

    Attributes:
        now: errors from the slots about the true vessel; known.now: about the vessel as each boat knows it.
        sensor: surrounding obstacles and team mates, and the vessel.
        distance, before: m from the slot, now and one decision ago.
        known: what policies and controllers act by.
    """

    STATE = ("now", "sensor", "before", "own", "targets", "known")

    axes = 2

    def __init__(self, mission: "Escort", name: str):
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
        self._true: Observer | None = None
        self.before = torch.zeros_like(self.now.distance)

    def group(self, first: int, number: int) -> ObserverGroup:
        """The team as a group of observers.

        Args:
            first: index of its first observer.
            number: the team's index in the mission.
        """
        self.own = Readings(self.fleet, self.section.sensors, self.interval, 64 * number)
        search = SearchPattern(
            SEARCH_PITCH * self.section.lookout.vessel_range, SEARCH_SPEED * self.fleet.model.limits.speeds[2], BEGINS
        )
        self._number = number
        return ObserverGroup(first, self.own, self.fleet, search)

    def join(self, picture: CommonPicture) -> None:
        """Connect lookouts and knowledge to the `picture`."""
        mission, number = self.mission, 64 * self._number
        self.picture = picture
        picture.lookers.append(
            Lookout(
                self.section.lookout, self.section.sensors, picture.looks, picture.things, self.fleet, self.own,
                mission.elevation, vehicles=number,
            )
        )  # fmt: skip
        self.known = KnownBoats(self, picture, number)
        self.target = self.known.target
        self.seen = Observer(self.known, "full")

    def measure(self, which: Tensor, count: int) -> None:
        """Measure the truth and read the instruments in environments `which` [env] int32, `count` of them."""
        self.forget()
        self.before = torch.where((which == 1).unsqueeze(-1), self.now.distance, self.before)
        self.now.measure(which, count)
        self.before = torch.where((which == 2).unsqueeze(-1), self.now.distance, self.before)
        mission = self.mission
        self.sensor.look(mission.obstacles, mission.env_world, which, count, mission.bodies)
        self.own.read(which, count, mission.noise.table)

    def conclude(self, which: Tensor, count: int) -> None:
        """Update their knowledge after the picture."""
        self.known.measure(which, count)

    def terms(self) -> dict[str, Tensor]:
        """The observations of each boat by name: those of formations, and age and accuracy of its track of the
        vessel.
        """
        flat = self._flat(self.seen)
        terms = dict(zip(self.seen.widths, flat.split(list(self.seen.widths.values()), dim=-1), strict=True))
        name, picture = self.name, self.picture
        age, sigma = (picture.of(name, x).unsqueeze(-1) for x in (picture.age, picture.sigma))
        return terms | {"track_age": squashed(age, AGE_SCALE), "track_sigma": squashed(sigma, SIGMA_SCALE)}

    def _flat(self, observer: Observer) -> Tensor:
        return observer(self.action, self.action if self.residual is None else self.reference())

    @property
    def privileged(self) -> Tensor | None:
        """Ground truth for the critic, [env, boat, n]: the same observations without errors, and varied numbers."""
        if self._true is None:
            self._true = Observer(self, "full")
        truth = [self._flat(self._true)]
        if self.mission.config.varies:
            truth.append(self.mission.world.truth[self.name])
        return torch.cat(truth, dim=-1)

    @property
    def distance(self) -> Tensor:
        """Distance from the slot about the true vessel, m."""
        return self.now.distance


def squashed(x: Tensor, scale: float) -> Tensor:
    """x / (|x| + scale), within (-1, 1)."""
    return x / (x.abs() + scale)


class KnownBoats:
    """What the boats know; any other attribute is that of the true team.

    Attributes:
        fleet: own state as measured.
        now: errors from the slots about the vessel as known.
        sensor: obstacles from the chart, team mates as measured.
        targets, target: the vessel as known, a row for each boat.
    """

    STATE = ("targets", "now", "sensor")

    def __init__(self, team: EscortBoats, picture: CommonPicture, number: int):
        """Knowledge of `team`; `number` vehicles of other teams precede it in the streams of random numbers."""
        interval = team.interval
        self._team, self._picture, self.fleet = team, picture, team.own
        table = picture.rows(team.name).contiguous().clone()
        self.targets = SimpleNamespace(table=table)
        self.now = Geometry(self.fleet, table, 0.0, team.slots.table, team.axes, about=True)
        self.target = seen_at(table, self.now.slot[:, 0])
        self.sensor = Contacts(
            team.section.sensors.scaled_contacts, team.sensor, team.fleet, self.fleet, interval, number
        )
        first = picture.groups[team.name].first
        self._charted = Charted(self.sensor, picture.chart, first, picture.things, self.fleet)

    def __getattr__(self, name: str) -> Any:
        """Anything not measured falls through to the true team."""
        return getattr(self._team, name)

    def measure(self, which: Tensor, rows: int) -> None:
        """Update in environments `which` [env] int32, `rows` of them."""
        mission = self._team.mission
        self.targets.table.copy_(self._picture.rows(self._team.name))
        self.now.measure(which, rows)
        self.sensor.update(which, rows, mission.steps, mission.noise.table)
        self._charted.write(which, rows)
