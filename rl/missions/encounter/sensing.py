"""What an own ship knows of others: reports by AIS, echoes of a radar, and a Kalman filter of constant velocity over
both.

A ship with AIS reports place, course, speed and size at the cadence of its class and speed (ITU-R M.1371): class A
every 10 s up to 14 kn, every 6 s up to 23 kn, every 2 s above, three times as often while it turns; class B every 30
s from 2 kn, 15 s from 14 kn, 5 s above 23 kn; every 3 minutes at rest. A report is a decision old, may be lost, and
has errors. A radar scans every `period`, sees all within its range except what it misses, and has errors of range and
bearing. Each track is extrapolated to the present (Bar-Shalom, Li & Kirubarajan 2001, ch. 6.3: white acceleration,
one covariance for both axes) and outlives its measurements by `forget`. Reports and echoes tell the
size of a ship, exactly; its identity is exact, too. Random numbers are counted (kernels/random.py). Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOptionalCall=false

import math
from typing import NamedTuple

import taichi as ti
from torch import Tensor

from rl.missions.encounter.bodies import Body, Track
from rl.missions.encounter.config import EncounterScenario
from rl.step import BEGINS, NOT_DUE, Due
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.random import AIS, CLOCK, KEY, RADAR, SEED, normal6, uniform4
from taichi_sim.kernels.runtime import array1, array3, array4, whole1
from taichi_sim.state.memory import Remembers

KNOT = 1852.0 / 3600.0  # m/s
TURNS_FAST = 0.01  # rad/s: a ship that turns faster reports three times as often; assumed
NO_AIS = 1e9  # s until the next report
GATE = 1e-3  # m^2, least variance


class SensingNumbers(NamedTuple):
    """Numbers of the kernel, SI."""

    interval: float
    carried: float
    class_a_length: float
    ais_range: float
    silent: float
    loss: float
    place_noise: float
    speed_noise: float
    radar_range: float
    period: float
    range_noise: float
    range_share: float
    bearing_noise: float
    misses: float
    acceleration: float
    speed: float
    forget: float


def numbers_of(config: EncounterScenario) -> SensingNumbers:
    """Of a scenario."""
    ais, radar, tracks = config.ais, config.radar, config.tracks
    length = {"A": 0.0, "B": 1e9, "auto": ais.class_a_length}[ais.transponder]
    return SensingNumbers(
        config.decision_interval, ais.carried, length, ais.range, ais.silent, ais.loss, ais.place_noise,
        ais.speed_noise, radar.range, radar.period, radar.range_noise, radar.range_share,
        math.radians(radar.bearing_noise_deg), radar.misses, tracks.acceleration, tracks.speed, tracks.forget,
    )  # fmt: skip


def cadence_of(length, speed, turns, class_a_length):
    """Time (s) between two reports of a ship, by its length (m), its speed (m/s) and whether it turns; class A is from
    a length (m) on. For kernels, too.
    """
    every, knots = 180.0, speed / KNOT
    if length >= class_a_length:
        if knots > 0.2:
            every = 10.0 if knots < 14.0 else (6.0 if knots < 23.0 else 2.0)
            if turns and knots < 23.0:
                every /= 3.0
    elif knots >= 2.0:
        every = 30.0 if knots < 14.0 else (15.0 if knots < 23.0 else 5.0)
    return every


cadence = ti.func(cadence_of)


@ti.func
def corrected(track, at, variance, g: ti.template()):
    """A track corrected by a place with a variance (m^2) each way; begun by it, if there was none."""
    if track[Track.AGE] < 0:
        track[Track.NORTH], track[Track.EAST] = at[0], at[1]
        track[Track.V_NORTH], track[Track.V_EAST] = 0.0, 0.0
        track[Track.P_PP], track[Track.P_PV], track[Track.P_VV] = variance, 0.0, g.speed * g.speed
    else:
        place, fast = (
            track[Track.P_PP] / (track[Track.P_PP] + variance),
            track[Track.P_PV] / (track[Track.P_PP] + variance),
        )
        for a in ti.static(range(2)):
            off = at[a] - track[a]
            track[a] += place * off
            track[2 + a] += fast * off
        track[Track.P_VV] -= fast * track[Track.P_PV]
        track[Track.P_PV] *= 1.0 - place
        track[Track.P_PP] *= 1.0 - place
    track[Track.AGE] = 0.0
    return track


@ti.func
def with_velocity(track, velocity, variance):
    """A track corrected by a velocity with a variance (m^2/s^2) each way."""
    total = track[Track.P_VV] + variance
    place, fast = track[Track.P_PV] / total, track[Track.P_VV] / total
    for a in ti.static(range(2)):
        off = velocity[a] - track[2 + a]
        track[a] += place * off
        track[2 + a] += fast * off
    track[Track.P_PP] -= place * track[Track.P_PV]
    track[Track.P_PV] *= 1.0 - fast
    track[Track.P_VV] *= 1.0 - fast
    return track


@ti.func
def carried_on(track, g: ti.template()):
    """A track an interval later; without one where it is forgotten."""
    dt, q = g.interval, g.acceleration * g.acceleration
    track[Track.P_PP] += dt * (2 * track[Track.P_PV] + dt * track[Track.P_VV]) + q * dt * dt * dt / 3
    track[Track.P_PV] += dt * track[Track.P_VV] + 0.5 * q * dt * dt
    track[Track.P_VV] += q * dt
    for a in ti.static(range(2)):
        track[a] += dt * track[2 + a]
    track[Track.AGE] += dt
    if track[Track.AGE] > g.forget:
        track[Track.AGE] = -1.0
    return track


@ti.kernel
def _sense(
    tracks: array4, bodies: array3, before: array3, numbers: array1, which: whole1,
    steps: ti.types.ndarray(dtype=ti.i64, ndim=1), draws: whole1, kind: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(tracks.shape[0], tracks.shape[1]):
        if which[e] != NOT_DUE:
            g = values_at(kind, numbers)
            here = ti.Vector([bodies[e, i, Body.NORTH], bodies[e, i, Body.EAST]])
            scan = ti.floor(steps[e] * g.interval / g.period) > ti.floor((steps[e] - 1) * g.interval / g.period)
            for j in range(tracks.shape[2]):
                track = ti.Vector([tracks[e, i, j, c] for c in ti.static(range(Track.SIZE))])
                u = uniform4(draws[SEED], AIS + j, draws[KEY + e], i, draws[CLOCK])
                there = j != i
                if which[e] == BEGINS:
                    track[Track.AGE], track[Track.NEXT] = -1.0, NO_AIS
                    if there and u[0] < g.carried:
                        track[Track.NEXT] = u[1] * 10.0
                elif track[Track.AGE] >= 0:
                    track = carried_on(track, g)
                if there:
                    length, beam = bodies[e, j, Body.LENGTH], bodies[e, j, Body.BEAM]
                    z = normal6(draws[SEED], RADAR + j, draws[KEY + e], i, draws[CLOCK])
                    to = ti.Vector([bodies[e, j, Body.NORTH], bodies[e, j, Body.EAST]]) - here
                    far = to.norm()
                    if g.radar_range > 0 and scan and far < g.radar_range and u[2] >= g.misses:
                        noise = ti.max(g.range_noise, g.range_share * far)
                        side = far * g.bearing_noise
                        along = to / ti.max(far, 1e-3)
                        at = here + to + noise * z[0] * along + side * z[1] * ti.Vector([-along[1], along[0]])
                        track = corrected(track, at, 0.5 * (noise * noise + side * side) + GATE, g)
                        track[Track.LENGTH], track[Track.BEAM] = length, beam
                    track[Track.NEXT] -= g.interval
                    if track[Track.NEXT] < 0:
                        v = ti.Vector([before[e, j, Body.V_NORTH], before[e, j, Body.V_EAST]])
                        now = ti.Vector([bodies[e, j, Body.COS], bodies[e, j, Body.SIN]])
                        then = ti.Vector([before[e, j, Body.COS], before[e, j, Body.SIN]])
                        turn = ti.abs(then[0] * now[1] - then[1] * now[0]) / g.interval
                        track[Track.NEXT] += cadence(length, v.norm(), turn > TURNS_FAST, g.class_a_length)
                        if far < g.ais_range and far >= g.silent and u[3] >= g.loss:
                            at = ti.Vector([before[e, j, Body.NORTH], before[e, j, Body.EAST]]) + g.interval * v
                            at += g.place_noise * ti.Vector([z[2], z[3]])
                            v += g.speed_noise * ti.Vector([z[4], z[5]])
                            track = corrected(track, at, g.place_noise * g.place_noise + GATE, g)
                            track = with_velocity(track, v, g.speed_noise * g.speed_noise + GATE)
                            track[Track.LENGTH], track[Track.BEAM] = length, beam
                for c in ti.static(range(Track.SIZE)):
                    tracks[e, i, j, c] = track[c]


class Tracking(Remembers):
    """Tracks [env, own ship, body, Track] of all bodies by each own ship."""

    def __init__(self, config: EncounterScenario, bodies: Tensor, own: int):
        """Track `bodies` [env, body, Body], of which the first `own` ones track."""
        self.tracks = self.remember(bodies.new_zeros((bodies.shape[0], own, bodies.shape[1], Track.SIZE)))
        self.tracks[..., Track.AGE] = -1.0
        self._numbers = bodies.new_tensor(numbers_of(config))
        self._launch = runtime.Launcher(_sense, plain=True, few=runtime.MEDIUM)

    def sense(self, bodies: Tensor, before: Tensor, due: Due) -> None:
        """Sense in the environments that are `due`; `before` are the bodies a decision ago."""
        kind = struct_of(SensingNumbers._fields, runtime.current().precision)
        self._launch(self.tracks, bodies, before, self._numbers, due.which, due.steps, due.draws, kind, envs=due.count)

    @property
    def known(self) -> Tensor:
        """Which bodies are tracked, bool [env, own ship, body]."""
        return self.tracks[..., Track.AGE] >= 0
