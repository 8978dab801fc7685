"""Charts: the tracks that each of several vehicles keeps by its own sightings and by those that others transmit.

Every vehicle keeps a track of every object it has heard of: a Kalman filter of constant velocity (Bar-Shalom, Li &
Kirubarajan 2001, ch. 6.2: white acceleration of power spectral density q; one covariance for both axes),

    x' = v,  v' = w;   P_pp += 2 dt P_pv + dt^2 P_vv + q dt^3 / 3,   P_pv += dt P_vv + q dt^2 / 2,   P_vv += q dt.

A sighting is a place z with the variance r. If it is a seconds old, it is compared with the object's place at that
time, x - a v, without process noise since (loc. cit., ch. 11: one-step retrodiction without the noise within):

    S = P_pp - 2 a P_pv + a^2 P_vv + r,   K_p = (P_pp - a P_pv) / S,   K_v = (P_pv - a P_vv) / S,

    x += K_p (z - x + a v),   v += K_v (z - x + a v),   P -= K S K^T.

Messages hold sightings, not tracks, and a vehicle takes each sighting once, whoever passed it on: nothing is counted
twice. A message (radio.py) holds place and velocity of its sender, and its last sighting of every object: north, east,
variance, and age (below 0: it has not seen the object yet). What is near a vessel that has a chart are team mates as
tracked (tracked_objects.py), and charted obstacles. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import NamedTuple

import taichi as ti
from torch import Tensor

from rl.perception.radio import NEVER, Message, Radio, TalkPack, arrived, source
from rl.perception.sensors import Nearby, Sight, insert, store_obstacle
from rl.perception.sightings import Object, Sighting
from rl.perception.tracked_objects import ObjectsConfig, TrackedObjects
from rl.step import GOES_ON, NOT_DUE, Due
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.runtime import array1, array3, array4, whole1
from taichi_sim.state.memory import Remembers

# Columns of a track: place (m), velocity (m/s), covariance (place, both, velocity), age of its newest look (s; `NEVER`
# before the first), time since it began (s).
NORTH, EAST, V_NORTH, V_EAST, P_PP, P_PV, P_VV, AGE, SINCE, TRACK = range(10)
OLDEST = 30.0  # s: older sightings are ignored
VAGUE = 8.0  # m, standard deviation of a place: objects known less well are not evaded; assumed


class SightingReport:
    """The last sighting of an object in a message: place, variance, AGE (s; below 0: not seen yet)."""

    NORTH, EAST, VARIANCE, AGE, SIZE = range(5)


class TrackNoise(NamedTuple):
    """Assumed for the first object and for the others: q, m^2/s^3, and the standard deviation of a velocity before the
    first sighting, each way, m/s.
    """

    first: float = 0.003
    others: float = 1e-4
    first_speed: float = 1.5
    others_speed: float = 0.5


ASSUMED = TrackNoise()
Q, SPREAD = 1, 3  # columns of `assumed`, behind the interval: of the first object, then of the others

ChartPack = ti.types.argpack(tracks=array4, sightings=array4, looked=array4, assumed=array1)


@ti.func
def fold(t: ti.template(), north, east, variance, a, speed):
    """Update the track t by a sighting that is a seconds old; begin it at the first."""
    if t[AGE] >= NEVER:
        t[NORTH], t[EAST], t[V_NORTH], t[V_EAST] = north, east, 0.0, 0.0
        t[P_PP], t[P_PV], t[P_VV] = variance + a * a * speed * speed, a * speed * speed, speed * speed
        t[AGE], t[SINCE] = a, 0.0
    else:
        m_p, m_v = t[P_PP] - a * t[P_PV], t[P_PV] - a * t[P_VV]
        S = m_p - a * m_v + variance
        k_p, k_v = m_p / S, m_v / S
        x, y = north - t[NORTH] + a * t[V_NORTH], east - t[EAST] + a * t[V_EAST]
        t[NORTH], t[EAST] = t[NORTH] + k_p * x, t[EAST] + k_p * y
        t[V_NORTH], t[V_EAST] = t[V_NORTH] + k_v * x, t[V_EAST] + k_v * y
        t[P_PP], t[P_PV], t[P_VV] = t[P_PP] - k_p * m_p, t[P_PV] - k_p * m_v, t[P_VV] - k_v * m_v
        t[AGE] = ti.min(t[AGE], a)


@ti.func
def carried_on(t: ti.template(), dt, q):
    """Predict the track t."""
    t[P_PP] += dt * (2.0 * t[P_PV] + dt * t[P_VV]) + q * dt * dt * dt / 3.0
    t[P_PV] += dt * t[P_VV] + 0.5 * q * dt * dt
    t[P_VV] += q * dt
    t[NORTH], t[EAST] = t[NORTH] + dt * t[V_NORTH], t[EAST] + dt * t[V_EAST]
    t[AGE], t[SINCE] = t[AGE] + dt, t[SINCE] + dt


@ti.kernel
def _keep(
    chart: ChartPack, radio: TalkPack, which: whole1, steps: ti.types.ndarray(dtype=ti.i64, ndim=1), form: ti.template()
):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(chart.tracks.shape[0], chart.tracks.shape[1]):
        if which[e] != NOT_DUE:
            dt, other, age = chart.assumed[0], source(radio, e, form), radio.heard.shape[3] - 1
            now = ti.cast(steps[e], ti.i32) * dt  # since the episode began, s
            for k in range(chart.tracks.shape[2]):
                variance = chart.sightings[e, i, k, Sighting.VARIANCE]
                known = which[e] == GOES_ON and chart.tracks[e, i, k, AGE] < NEVER
                if known or variance > 0:
                    t = ti.Vector([chart.tracks[e, i, k, c] for c in ti.static(range(TRACK))])
                    if known:
                        carried_on(t, dt, chart.assumed[ti.select(k == 0, Q, Q + 1)])
                    if variance > 0:
                        north, east = chart.sightings[e, i, k, Sighting.NORTH], chart.sightings[e, i, k, Sighting.EAST]
                        fold(t, north, east, variance, 0.0, chart.assumed[ti.select(k == 0, SPREAD, SPREAD + 1)])
                    for c in ti.static(range(TRACK)):
                        chart.tracks[e, i, k, c] = t[c]
            for j in range(radio.said.shape[1]):
                slot = arrived(radio, steps, e, i, j, form)
                if j != i and slot >= 0:
                    for k in range(chart.tracks.shape[2]):
                        at = Message.SIZE + SightingReport.SIZE * k
                        then = radio.sent[other, slot, j, at + SightingReport.AGE]  # when the message was sent
                        old = then + radio.heard[e, i, j, age]
                        if then >= 0 and old < OLDEST and now - old > chart.looked[e, i, j, k] + 0.5 * dt:
                            chart.looked[e, i, j, k] = now - old  # the sender has seen the object anew
                            t = ti.Vector([chart.tracks[e, i, k, c] for c in ti.static(range(TRACK))])
                            fold(
                                t, radio.sent[other, slot, j, at + SightingReport.NORTH],
                                radio.sent[other, slot, j, at + SightingReport.EAST],
                                radio.sent[other, slot, j, at + SightingReport.VARIANCE], old,
                                chart.assumed[ti.select(k == 0, SPREAD, SPREAD + 1)],
                            )  # fmt: skip
                            for c in ti.static(range(TRACK)):
                                chart.tracks[e, i, k, c] = t[c]


@ti.kernel
def _say(chart: ChartPack, radio: TalkPack, which: whole1):
    """Write the last sighting of every object into the next message."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(chart.sightings.shape[0], chart.sightings.shape[1]):
        if which[e] != NOT_DUE:
            for k in range(chart.sightings.shape[2]):
                at = Message.SIZE + SightingReport.SIZE * k
                if chart.sightings[e, i, k, Sighting.VARIANCE] > 0:
                    for c in ti.static(range(Sighting.SIZE)):
                        radio.said[e, i, at + c] = chart.sightings[e, i, k, c]
                    radio.said[e, i, at + SightingReport.AGE] = 0.0
                elif radio.said[e, i, at + SightingReport.AGE] >= 0 and which[e] == GOES_ON:
                    radio.said[e, i, at + SightingReport.AGE] += chart.assumed[0]


class Chart(Remembers):
    """The charts of all observers.

    Attributes:
        tracks: [env, vehicle, object, 9], columns as above.
    """

    def __init__(self, sightings: Tensor, radio: Radio, interval: float, numbers: TrackNoise = ASSUMED):
        """Make charts of `sightings` [env, vehicle, object, 3] (camera.py), and of those that come by `radio`."""
        envs, vehicles, objects, _ = sightings.shape
        self.tracks = self.remember(sightings.new_zeros((envs, vehicles, objects, TRACK)))
        # when the newest look at an object was made that has been taken of a sender, s since the episode began
        self._looked = self.remember(sightings.new_zeros((envs, vehicles, vehicles, objects)))
        self._radio = radio
        self._chart = runtime.Packed(
            ChartPack, tracks=self.tracks, sightings=sightings, looked=self._looked,
            assumed=sightings.new_tensor([interval, *numbers]),
        )  # fmt: skip
        self._keep, self._say = runtime.Launcher(_keep, few=runtime.LARGE), runtime.Launcher(_say)

    def begin(self, envs: Tensor) -> None:
        """Clear all tracks in environments `envs` [n]."""
        self.tracks[envs] = 0.0
        self.tracks[envs, :, :, AGE] = NEVER
        self._looked[envs] = -NEVER
        self._radio.said[envs, :, Message.SIZE + SightingReport.AGE :: SightingReport.SIZE] = -1.0

    def say(self, due: Due) -> None:
        """Write sightings into the next messages; call before `Radio.talk`."""
        self._say(self._chart(), self._radio.pack(), due.which, envs=due.count)

    def keep(self, due: Due) -> None:
        """Update tracks by sightings and messages."""
        self._keep(self._chart(), self._radio.pack(), due.which, due.steps, self._radio.form, envs=due.count)


def width_of(objects: int) -> int:
    """Width of a message that reports on `objects` objects."""
    return Message.SIZE + SightingReport.SIZE * objects


REACH, DOUBT, FIRST = range(3)  # limits: of sensors, m; variance, m^2; number of the first vehicle on the chart

ChartedPack = ti.types.argpack(obstacles=array4, signals=array3)
FromPack = ti.types.argpack(tracked=array4, objects=array3, state=array3, derived=array3, limits=array1)


@ti.kernel
def _nearest(out: ChartedPack, of: FromPack, which: whole1, sight: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(of.state.shape[0], of.state.shape[1]):
        if which[e] != NOT_DUE:
            reach, vague, own = of.limits[REACH], of.limits[DOUBT], ti.cast(of.limits[FIRST], ti.i32) + i
            place = ti.Vector([of.state[e, i, a] for a in ti.static(range(3))])
            count = ti.static(sight.obstacles)
            distance = ti.Vector([reach] * ti.static(count + 1))
            index = ti.Vector([-1] * ti.static(count + 1))
            for k in range(of.tracked.shape[2]):
                if of.tracked[e, own, k, AGE] < NEVER and of.tracked[e, own, k, P_PP] < vague:
                    dx, dy = of.tracked[e, own, k, NORTH] - place[0], of.tracked[e, own, k, EAST] - place[1]
                    d = ti.sqrt(dx * dx + dy * dy) - of.objects[e, k, Object.RADIUS]
                    distance, index = insert(distance, index, d, k, count)
            for k in ti.static(range(sight.obstacles)):
                m = ti.max(index[k], 0)
                there = ti.Vector([of.tracked[e, own, m, NORTH], of.tracked[e, own, m, EAST],
                                   of.objects[e, m, Object.RADIUS], of.tracked[e, own, m, V_NORTH],
                                   of.tracked[e, own, m, V_EAST]])  # fmt: skip
                store_obstacle(out, of.derived, sight, e, i, k, distance[k], index[k], place, there, reach)


class ChartedObjects(TrackedObjects):
    """Contacts of one team of vessels that have a chart: obstacles are the nearest charted objects."""

    def __init__(
        self, config: ObjectsConfig, sensor: Nearby, fleet: Views, own: Views, interval: float, vehicles: int, *,
        chart: Chart, first: int, objects: Tensor,
    ):  # fmt: skip
        """Measure as `TrackedObjects` do, and read `chart`.

        Args:
            first: number of the team's first vehicle on the chart. objects: [env, object, 6] radius (m) in the last
                column.
        """
        super().__init__(config, sensor, fleet, own, interval, vehicles)
        self._charted = runtime.Packed(
            FromPack, tracked=chart.tracks, objects=objects, state=own.state, derived=own.derived,
            limits=own.state.new_tensor([self.reach, VAGUE * VAGUE, first]),
        )  # fmt: skip
        self._nearest = runtime.Packed(ChartedPack, obstacles=self.obstacles, signals=self.written)
        self._sight = Sight(self.num_obstacles, self.num_mates, self.axes)
        self._find = runtime.Launcher(_nearest, few=runtime.MEDIUM)

    def update(self, due: Due) -> None:
        """Measure, and read the chart, in the environments that are `due`."""
        super().update(due)
        self._find(self._nearest(), self._charted(), due.which, self._sight, envs=due.count)
