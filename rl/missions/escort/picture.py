"""The common operational picture of boats and aircraft: sightings, messages, charts, and the vessel as each knows it.

Observers are the boats, then the aircraft. Observed objects ("things") are the vessel, then what moves, then fixed
obstacles. In each decision all observers look, transmit what they have seen, receive messages, and update their charts
(rl/perception/chart.py).

An observer without news of the vessel for `escort.lost` searches once it is near the expected position: the point that
it approaches (a boat) or circles (an aircraft) moves out along an Archimedean spiral; each observer's spiral is turned
by its share of a full turn. At speed U along a spiral of pitch b, the point is at r = sqrt(b U s / pi) after s seconds,
at the angle 2 pi r / b.
"""

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor

from rl.guidance.targets import COS, COURSE, EAST, NORTH, SIN, SIZE, SPEED
from rl.perception.camera import LOOK_SIZE, LOOK_VARIANCE, UNSEEN
from rl.perception.chart import AGE, P_PP, P_PV, P_VV, V_EAST, V_NORTH, Chart, width_of
from rl.perception.radio import PLACE_AND_VELOCITY, Radio
from taichi_sim.fleet import Views

if TYPE_CHECKING:
    from rl.missions.escort.mission import Escort

SLOWEST = 0.3  # m/s: below this speed the last known course is kept
CUE_SPEED = 1.5  # m/s, initial standard deviation of the vessel's velocity, each way; assumed
THING = 6  # columns of an observed object: position (3), velocity north and east, radius


class SearchPattern(NamedTuple):
    """How a team searches: pitch of the spiral (m), speed along it (m/s), and distance from the expected vessel at
    which the search begins (m).
    """

    pitch: float
    speed: float
    begins: float


class ObserverGroup(NamedTuple):
    """The observers of one team: index of the first, states as measured and as they are, and how they search."""

    first: int
    own: Views
    true: Views
    search: SearchPattern


class CommonPicture:
    """The common picture of all observers of a mission.

    Attributes:
        things: [env, thing, 6], ground truth.
        looks: [env, observer, thing, 3], the last sightings.
        radio, chart: messages and tracks.
        targets: [env, observer, 8] the vessel as each knows it, in the columns of rl/guidance/targets.py. Its rate of
            turn is 0: estimating it did more harm than good.
        age, sigma: [env, observer] of that track, s, and m (standard deviation, each way).
    """

    STATE = (
        "things", "looks", "place", "radio", "chart", "targets", "age", "sigma", "_course", "_searching", "lookers",
    )  # fmt: skip

    def __init__(self, mission: "Escort", groups: dict[str, ObserverGroup], things: int):
        """Build the picture of all observers.

        Args:
            mission: the mission.
            groups: team -> its observers, in order; not empty.
            things: number of observed objects.
        """
        config, self._mission = mission.config, mission
        state = next(iter(groups.values())).own.state
        envs, lookers = state.shape[0], sum(g.own.state.shape[1] for g in groups.values())
        self.groups, self.things = groups, state.new_zeros((envs, things, THING))
        self.looks = state.new_full((envs, lookers, things, LOOK_SIZE), UNSEEN)
        self.place = state.new_zeros((envs, lookers, 3))
        radio, escort = config.radio, config.escort
        if escort.reports == "none":
            radio = radio.model_copy(update={"loss": 1.0})
        flying = [g for name, g in groups.items() if name == escort.aircraft]
        relays = (0, 0)
        if escort.relay and flying:
            relays = flying[0].first, flying[0].first + flying[0].own.state.shape[1]
        self.radio = Radio(
            radio, self.place, config.decision_interval, width=width_of(things), known=False, relays=relays,
            shift=1 if escort.reports == "others" else 0,
        )  # fmt: skip
        self.chart = Chart(self.looks, self.radio.said, self.radio.heard, config.decision_interval)
        self.targets = state.new_zeros((envs, lookers, SIZE))
        self.age, self.sigma = state.new_zeros((envs, lookers)), state.new_zeros((envs, lookers))
        self._course, self._searching = state.new_zeros((envs, lookers)), state.new_zeros((envs, lookers))
        self.lookers: list[Any] = []  # cameras and lookouts (rl/perception)

    def begin(self, envs: Tensor, cue: Tensor) -> None:
        """Begin episodes in environments `envs` [n] with the cue [n, 2] (m), the vessel's position given at the
        start.
        """
        config = self._mission.config.escort
        self.chart.begin(envs)
        track = self.chart.tracks[envs]
        track[..., 0, :2] = cue.unsqueeze(1).to(track)
        variance, age = CUE_SPEED**2, config.cue_age
        track[..., 0, P_VV], track[..., 0, P_PV] = variance, age * variance
        track[..., 0, P_PP], track[..., 0, AGE] = max(config.cue_error, 1.0) ** 2 + age * age * variance, age
        self.chart.tracks[envs] = track
        self._searching[envs] = 0.0
        here = torch.cat([g.own.position_n[envs, :, :2] for g in self.groups.values()], dim=1)
        way = cue.unsqueeze(1).to(here) - here
        self._course[envs] = torch.atan2(way[..., 1], way[..., 0])
        self.targets[envs, :, NORTH : EAST + 1] = cue.unsqueeze(1).to(here)

    def update(self, which: Tensor, rows: int) -> None:
        """Look, communicate, and update tracks and targets.

        Args:
            which: [env] int32: 0 no update, 1 after a step, 2 at the start of an episode.
            rows: number of environments that are not 0.
        """
        mission = self._mission
        for looker in self.lookers:
            looker.see(which, rows, mission.noise.table)
        groups = self.groups.values()
        torch.cat([g.true.position_n for g in groups], dim=1, out=self.place)
        own = [torch.cat((g.own.position_n, g.own.velocity_n), dim=-1) for g in groups]
        self.radio.said[..., :PLACE_AND_VELOCITY] = torch.cat(own, dim=1)
        self.chart.say(which, rows)
        self.radio.talk(which, rows, mission.steps, mission.noise.table)
        self.chart.keep(which, rows)
        self._conclude(which)

    def _conclude(self, which: Tensor) -> None:
        """Update the vessel's position and course as each observer knows them."""
        track = self.chart.tracks[:, :, 0]
        speed = torch.hypot(track[..., V_NORTH], track[..., V_EAST])
        course = torch.atan2(track[..., V_EAST], track[..., V_NORTH])
        self._course = torch.where(speed > SLOWEST, course, self._course)
        c, s = self._course.cos(), self._course.sin()
        self.age, self.sigma = track[..., AGE], track[..., P_PP].clamp(min=0.0).sqrt()
        place = track[..., :2] + self._offset(track, which)
        t = self.targets
        t[..., NORTH], t[..., EAST] = place[..., 0], place[..., 1]
        t[..., COURSE], t[..., COS], t[..., SIN], t[..., SPEED] = self._course, c, s, speed

    def _offset(self, track: Tensor, which: Tensor) -> Tensor:
        """Offset of the search point from the vessel's expected position, [env, observer, 2], m."""
        lost, dt = self._mission.config.escort.lost, self._mission.config.decision_interval
        away, pitches, speeds, turned, begins = [], [], [], [], []
        for g in self.groups.values():
            n = g.own.state.shape[1]
            here = g.own.position_n[..., :2] - track[:, g.first : g.first + n, :2]
            away.append(here.norm(dim=-1))
            begins += [g.search.begins] * n
            pitches += [g.search.pitch] * n
            speeds += [g.search.speed] * n
            turned += [2 * math.pi * k / n for k in range(n)]
        blind = track[..., AGE] > lost
        near = torch.cat(away, dim=1) < track.new_tensor(begins)
        on = blind & (near | (self._searching > 0))
        searching = torch.where(on, self._searching + dt, 0.0)
        self._searching = torch.where((which != 0).unsqueeze(-1), searching, self._searching)
        pitch, speed = track.new_tensor(pitches), track.new_tensor(speeds)
        r = (pitch * speed * self._searching / math.pi).sqrt()
        angle = 2 * math.pi * r / pitch + track.new_tensor(turned)
        return r.unsqueeze(-1) * torch.stack((angle.cos(), angle.sin()), dim=-1)

    def rows(self, name: str) -> Tensor:
        """The targets of a team's observers, a view."""
        g = self.groups[name]
        return self.targets[:, g.first : g.first + g.own.state.shape[1]]

    def of(self, name: str, values: Tensor) -> Tensor:
        """The part of `values` [env, observer, ...] that belongs to a team."""
        g = self.groups[name]
        return values[:, g.first : g.first + g.own.state.shape[1]]

    def sees(self, name: str) -> Tensor:
        """Whether each observer of a team saw the vessel in its last look, [env, observer]."""
        return self.of(name, self.looks)[..., 0, LOOK_VARIANCE] > 0
