"""Shared tracking of the vessel: sightings, messages, charts, and each observer's estimate of the vessel.

Observers are the boats, then the aircraft. Objects are the vessel, then moving bodies, then obstacles. In each decision
the observers look, transmit their sightings, receive messages, and update their charts (rl/perception/chart.py).

An observer begins to search when it has had no news of the vessel for `escort.lost` seconds and is near the vessel's
predicted place. Its estimate of that place, to which a boat sails and about which an aircraft circles, then moves
outwards along an Archimedean spiral. The spirals of a team start in different directions. At a speed U along a spiral
of pitch b, the radius after s seconds is r = sqrt(b U s / pi), and the angle is 2 pi r / b.

Boats and aircraft have margins to endings, and logs, in common.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportOptionalCall=false, reportIndexIssue=false

import math
from collections.abc import Mapping
from typing import NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.guidance.course import obstacles as bodies
from rl.guidance.course.obstacles import Cylinder
from rl.guidance.targets_and_errors import COS, COURSE, EAST, NORTH, SIN, SPEED, TARGET_SIZE, course_of
from rl.missions.escort.config import EscortScenario
from rl.perception.chart import AGE, P_PP, P_PV, P_VV, V_EAST, V_NORTH, Chart, width_of
from rl.perception.radio import Message, Radio
from rl.perception.sensors import Sensor
from rl.perception.sightings import UNSEEN, Object, Sighting
from rl.step import NOT_DUE, Due, Endings
from taichi_sim.fleet import Fleet, Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.runtime import array1, array2, array3, array4, whole1
from taichi_sim.state.memory import Remembers

SLOWEST = 0.3  # m/s: the course of a slower vessel is not updated
LOGGED = ("error_m", "arrived", "seen", "collisions_per_hour")
CUE_SPEED = 1.5  # m/s, standard deviation of the vessel's velocity at first, each way; assumed
COPIED = (
    (Object.NORTH, bodies.NORTH), (Object.EAST, bodies.EAST), (Object.V_NORTH, bodies.V_NORTH),
    (Object.V_EAST, bodies.V_EAST), (Object.RADIUS, bodies.RADIUS),
)  # fmt: skip
"""Columns of an object, and the rows of a body that they are copied from."""


PITCH, SEARCH_SPEED, BEGINS, TURNED = range(4)  # columns of `searches`, a row for each observer

LOST, INTERVAL = range(2)  # numbers of the kernel: without news, of a decision, s
EstimatesPack = ti.types.argpack(targets=array3, age=array2, sigma=array2, course=array2, searching=array2)
SearchPack = ti.types.argpack(tracks=array4, said=array3, searches=array2, numbers=array1)


@ti.kernel
def _estimate(out: EstimatesPack, by: SearchPack, which: whole1):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, o in ti.ndrange(by.tracks.shape[0], by.tracks.shape[1]):
        if which[e] != NOT_DUE:
            lost, dt = by.numbers[LOST], by.numbers[INTERVAL]
            place = ti.Vector([by.tracks[e, o, 0, a] for a in ti.static(range(2))])
            north, east = by.tracks[e, o, 0, V_NORTH], by.tracks[e, o, 0, V_EAST]
            old, speed = by.tracks[e, o, 0, AGE], ti.sqrt(north * north + east * east)
            if speed > SLOWEST:
                out.course[e, o] = ti.atan2(east, north)
            out.age[e, o], out.sigma[e, o] = old, ti.sqrt(ti.max(by.tracks[e, o, 0, P_PP], 0.0))
            away = (taken(by.said, e, o, NORTH, 2) - place).norm()
            searched, pitch = 0.0, by.searches[o, PITCH]
            if old > lost and (away < by.searches[o, BEGINS] or out.searching[e, o] > 0):
                searched = out.searching[e, o] + dt
            out.searching[e, o] = searched
            r = ti.sqrt(pitch * by.searches[o, SEARCH_SPEED] * searched * ti.static(1 / math.pi))
            angle = ti.static(2 * math.pi) * r / pitch + by.searches[o, TURNED]
            out.targets[e, o, NORTH] = place[0] + r * ti.cos(angle)
            out.targets[e, o, EAST] = place[1] + r * ti.sin(angle)
            out.targets[e, o, COURSE], out.targets[e, o, SPEED] = out.course[e, o], speed
            out.targets[e, o, COS], out.targets[e, o, SIN] = ti.cos(out.course[e, o]), ti.sin(out.course[e, o])


class SpiralSearch(NamedTuple):
    """Spiral search of a team for the vessel.

    The search begins within `begins` (m) of the vessel's predicted place. The spiral has a `pitch` (m); vehicles follow
    it at a `speed` (m/s).
    """

    pitch: float
    speed: float
    begins: float


class ObserverGroup(NamedTuple):
    """The observers of one team."""

    first: int  # number of the first among all observers
    own: Views  # state as they measure it
    true: Views
    search: SpiralSearch

    @property
    def count(self) -> int:
        """Number of observers."""
        return self.own.state.shape[1]

    @property
    def rows(self) -> slice:
        """Indices of the group among all observers."""
        return slice(self.first, self.first + self.count)


class SharedTracking(Remembers):
    """Sightings, messages, charts and estimates of all observers of a mission.

    Attributes:
        objects: [env, object, 6], the truth. sightings: [env, observer, object, 3]. radio, chart: of rl/perception.
        targets: [env, observer, 8] each observer's estimate of the vessel, columns of
            rl/guidance/targets_and_errors.py; the rate of its course is 0, because an estimated rate did more harm than
            good.
        age, sigma: [env, observer] age (s) and standard deviation (m, each way) of the estimates.
    """

    def __init__(self, config: EscortScenario, groups: Mapping[str, ObserverGroup], objects: int):
        """Track `objects` objects by the observers in `groups`, team -> group, in order and not empty."""
        self._config = config
        state = next(iter(groups.values())).own.state
        envs, observers = state.shape[0], sum(g.count for g in groups.values())
        self.groups = groups
        self.objects = self.remember(state.new_zeros((envs, objects, Object.SIZE)))
        self.sightings = self.remember(state.new_full((envs, observers, objects, Sighting.SIZE), UNSEEN))
        self.place = self.remember(state.new_zeros((envs, observers, 3)))
        radio, escort = config.radio, config.escort
        if escort.reports == "none":
            radio = radio.model_copy(update={"loss": 1.0})
        self.radio = self.remember(Radio(
            radio, self.place, config.decision_interval, width=width_of(objects), kept=Message.SIZE, known=False,
            shift=1 if escort.reports == "others" else 0,
        ))  # fmt: skip
        self.chart = self.remember(Chart(self.sightings, self.radio, config.decision_interval))
        self.targets = self.remember(state.new_zeros((envs, observers, TARGET_SIZE)))
        self.age, self.sigma, self._course, self._searching = (
            self.remember(state.new_zeros((envs, observers))) for _ in range(4)
        )
        self._estimates = runtime.Packed(
            EstimatesPack, targets=self.targets, age=self.age, sigma=self.sigma, course=self._course,
            searching=self._searching,
        )  # fmt: skip
        searches = [
            (g.search.pitch, g.search.speed, g.search.begins, 2 * math.pi * k / g.count)
            for g in groups.values()
            for k in range(g.count)
        ]
        self._search = runtime.Packed(
            SearchPack, tracks=self.chart.tracks, said=self.radio.said, searches=state.new_tensor(searches),
            numbers=state.new_tensor([escort.lost, config.decision_interval]),
        )  # fmt: skip
        self._launch = runtime.Launcher(_estimate)

    def place_objects(self, table: Tensor, stands: Tensor) -> None:
        """Write where bodies are now, `table` [env, 8, body], and obstacles `stands` [env, n, 4], at mean sea level."""
        n = table.shape[2]
        for column, row in COPIED:
            self.objects[:, :n, column] = table[:, row]
        self.objects[:, n:, :2], self.objects[:, n:, Object.RADIUS] = stands[..., :2], stands[..., Cylinder.RADIUS]

    def begin(self, envs: Tensor, cue: Tensor) -> None:
        """Begin episodes in environments `envs` [n]: all observers know the place `cue` [n, 2] (m) of the vessel."""
        config = self._config.escort
        self.chart.begin(envs)
        track = self.chart.tracks[envs]
        track[..., 0, :2] = cue.unsqueeze(1).to(track)
        variance, age = CUE_SPEED**2, config.cue_age
        track[..., 0, P_VV], track[..., 0, P_PV] = variance, age * variance
        track[..., 0, P_PP], track[..., 0, AGE] = max(config.cue_error, 1.0) ** 2 + age * age * variance, age
        self.chart.tracks[envs] = track
        self._searching[envs] = 0.0
        here = torch.cat([g.own.position_n[envs, :, :2] for g in self.groups.values()], dim=1)
        self._course[envs] = course_of(cue.unsqueeze(1).to(here) - here)
        self.targets[envs, :, NORTH : EAST + 1] = cue.unsqueeze(1).to(here)

    def exchange(self, due: Due) -> None:
        """Send sightings, and receive those of others."""
        groups = self.groups.values()
        torch.cat([g.true.position_n for g in groups], dim=1, out=self.place)
        own = [torch.cat((g.own.position_n, g.own.velocity_n), dim=-1) for g in groups]
        self.radio.said[..., : Message.SIZE] = torch.cat(own, dim=1)
        self.chart.say(due)
        self.radio.talk(due)

    def conclude(self, due: Due) -> None:
        """Update all charts, and each observer's estimate of the vessel's place and course."""
        self.chart.keep(due)
        self._launch(self._estimates(), self._search(), due.which, envs=due.count)

    def of(self, name: str, values: Tensor) -> Tensor:
        """The rows of team `name` in `values` [env, observer, ...], as a view."""
        return values[:, self.groups[name].rows]

    def sees(self, name: str) -> Tensor:
        """Whether each observer of a team sees the vessel [env, observer]."""
        return self.of(name, self.sightings)[..., 0, Sighting.VARIANCE] > 0


def margins_of(fleet: Fleet, sensor: Sensor, config: EscortScenario) -> dict[str, Tensor]:
    """To contact with an obstacle, the vessel or a team mate, and to the edge of the area, m, [env, vehicle] each."""
    place = fleet.position_n[..., :2]
    return {"collided": sensor.gap, "left": config.area / 2 - place.abs().amax(-1)}


def log_of(
    distance: Tensor, tracking: SharedTracking, ended: Endings, arrived: Tensor, config: EscortScenario
) -> dict[str, Tensor]:
    """Errors now, shares of episodes that have `arrived` (bool [env]) and whose vessel somebody saw, collisions.

    distance: m [env, vehicle], from where each vehicle should be.
    """
    hours = distance.numel() * config.decision_interval / 3600
    sees = tracking.sightings[..., 0, Sighting.VARIANCE] > 0
    return {
        "error_m": distance.mean(),
        "arrived": arrived.float().mean(),
        "seen": sees.any(-1).float().mean(),
        "collisions_per_hour": ended["collided"].sum() / hours,
    }
