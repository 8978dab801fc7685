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
variance, and age (below 0: it has not seen the object yet). Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import NamedTuple

import taichi as ti
from torch import Tensor

from rl.perception.due import GOES_ON, NOT_DUE, Due
from rl.perception.radio import NEVER, Message
from rl.perception.sightings import Sighting
from taichi_sim.kernels import runtime
from taichi_sim.kernels.runtime import array1, array3, array4, whole1
from taichi_sim.state.memory import Remembers

# Columns of a track: place (m), velocity (m/s), covariance (place, both, velocity), age of its newest look (s; `NEVER`
# before the first), time since it began (s).
NORTH, EAST, V_NORTH, V_EAST, P_PP, P_PV, P_VV, AGE, SINCE, TRACK = range(10)
OLDEST = 30.0  # s: older sightings are ignored
KEEP = 25.0  # ns of one vehicle, object and sender, about


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

ChartPack = ti.types.argpack(tracks=array4, sightings=array4, said=array3, heard=array4, taken=array4, numbers=array1)


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
def _keep(chart: ChartPack, which: whole1, serial: ti.template()):
    ti.loop_config(serialize=serial)
    for e, i in ti.ndrange(chart.tracks.shape[0], chart.tracks.shape[1]):
        if which[e] != NOT_DUE:
            dt, senders = chart.numbers[0], chart.heard.shape[2]
            age = chart.said.shape[2]  # the column of a message's own age
            for k in range(chart.tracks.shape[2]):
                q, speed = chart.numbers[2], chart.numbers[4]
                if k == 0:
                    q, speed = chart.numbers[1], chart.numbers[3]
                t = ti.Vector([chart.tracks[e, i, k, c] for c in ti.static(range(TRACK))])
                if which[e] == GOES_ON and t[AGE] < NEVER:
                    carried_on(t, dt, q)
                variance = chart.sightings[e, i, k, Sighting.VARIANCE]
                if variance > 0:
                    fold(
                        t,
                        chart.sightings[e, i, k, Sighting.NORTH],
                        chart.sightings[e, i, k, Sighting.EAST],
                        variance,
                        0.0,
                        speed,
                    )
                at = Message.SIZE + SightingReport.SIZE * k
                for j in range(senders):
                    then = chart.heard[e, i, j, at + SightingReport.AGE]  # when the message was sent
                    if j != i and then >= 0:  # the sender has seen the object
                        old = then + chart.heard[e, i, j, age]
                        # `taken` is how long ago the last look that was taken of this sender was made
                        last = chart.taken[e, i, j, k] + ti.select(which[e] == GOES_ON, dt, 0.0)
                        if old < OLDEST and old < last - 0.5 * dt:
                            last = old
                            fold(
                                t, chart.heard[e, i, j, at + SightingReport.NORTH],
                                chart.heard[e, i, j, at + SightingReport.EAST],
                                chart.heard[e, i, j, at + SightingReport.VARIANCE], old, speed,
                            )  # fmt: skip
                        chart.taken[e, i, j, k] = last
                for c in ti.static(range(TRACK)):
                    chart.tracks[e, i, k, c] = t[c]


@ti.kernel
def _say(chart: ChartPack, which: whole1, serial: ti.template()):
    """Write the last sighting of every object into the next message."""
    ti.loop_config(serialize=serial)
    for e, i in ti.ndrange(chart.sightings.shape[0], chart.sightings.shape[1]):
        if which[e] != NOT_DUE:
            for k in range(chart.sightings.shape[2]):
                at = Message.SIZE + SightingReport.SIZE * k
                if chart.sightings[e, i, k, Sighting.VARIANCE] > 0:
                    for c in ti.static(range(Sighting.SIZE)):
                        chart.said[e, i, at + c] = chart.sightings[e, i, k, c]
                    chart.said[e, i, at + SightingReport.AGE] = 0.0
                elif chart.said[e, i, at + SightingReport.AGE] >= 0 and which[e] == GOES_ON:
                    chart.said[e, i, at + SightingReport.AGE] += chart.numbers[0]


class Chart(Remembers):
    """The charts of all observers.

    Attributes:
        tracks: [env, vehicle, object, 9], columns as above.
    """

    def __init__(self, sightings: Tensor, said: Tensor, heard: Tensor, interval: float, numbers: TrackNoise = ASSUMED):
        """Make charts of `sightings` [env, vehicle, object, 3] (camera.py); see radio.py for `said` and `heard`."""
        envs, vehicles, objects, _ = sightings.shape
        self.tracks = self.remember(sightings.new_zeros((envs, vehicles, objects, TRACK)))
        self._taken = self.remember(sightings.new_zeros((envs, vehicles, vehicles, objects)))
        self._said = said
        self._chart = runtime.Packed(
            ChartPack, tracks=self.tracks, sightings=sightings, said=said, heard=heard, taken=self._taken,
            numbers=sightings.new_tensor([interval, *numbers]),
        )  # fmt: skip
        self._rows = vehicles * vehicles * objects
        self._keep, self._say = runtime.Launcher(_keep), runtime.Launcher(_say)

    def begin(self, envs: Tensor) -> None:
        """Clear all tracks in environments `envs` [n]."""
        self.tracks[envs] = 0.0
        self.tracks[envs, :, :, AGE] = NEVER
        self._taken[envs] = NEVER
        self._said[envs, :, Message.SIZE + SightingReport.AGE :: SightingReport.SIZE] = -1.0

    def say(self, due: Due) -> None:
        """Write sightings into the next messages; call before `Radio.talk`."""
        self._say(self._chart(), due.which, runtime.few(due.count * self._rows, KEEP))

    def keep(self, due: Due) -> None:
        """Update tracks by sightings and messages."""
        self._keep(self._chart(), due.which, runtime.few(due.count * self._rows, KEEP))


def width_of(objects: int) -> int:
    """Width of a message that reports on `objects` objects."""
    return Message.SIZE + SightingReport.SIZE * objects
