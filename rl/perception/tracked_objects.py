"""Contacts: obstacles and team mates near a vehicle as it measures and tracks them.

A vehicle measures range and bearing of each of the nearest bodies (of team mates in the air also the elevation), with
noise and `late` decisions late; a measurement fails with the probability `dropout`. The vehicle's measured place and
heading at that time turn a measurement into a place; an error of its own place cancels, one of its heading does not. A
Kalman filter of constant velocity (Bar-Shalom, Li & Kirubarajan 2001, ch. 6.3: white acceleration, one covariance for
all axes) makes a track of the places, extrapolated to the present: over ground for an obstacle, relative to the vehicle
for a team mate, because mates turn together. A track begins at the first measurement, at rest with the standard
deviation `speed`, and lasts while its body is among the nearest. Identity, size, and height difference are exact.
Random numbers are counted (kernels/random.py): same seed, same bits. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Annotated, NamedTuple

import taichi as ti
from pydantic import Field

from rl.perception.instruments import InstrumentsConfig
from rl.perception.sensors import Mate, Nearby, Obstacle, Sight, store_mate, store_obstacle
from rl.step import BEGINS, NOT_DUE, Due
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.random import CLOCK, CONTACTS, KEY, SEED, normal6, uniform4
from taichi_sim.kernels.rotation import HEADING_COS, HEADING_SIN, VELOCITY_N
from taichi_sim.kernels.runtime import array1, array2, array3, array4, array5, whole1

# Columns of a measurement that waits: whose (-1 nobody's), seen or not, place, variance, radius, height above or below.
WHO, SEEN, AT, VARIANCE, SIZE, ASIDE, MEASURED = 0, 1, 2, 5, 6, 7, 8
# Columns of a track: WHO, place, velocity, covariance (place, both, velocity), radius, height above or below.
PLACE, SPEED, P_PP, P_PV, P_VV, RADIUS, BESIDE, TRACKED = 1, 4, 7, 8, 9, 10, 11, 12
NOBODY = -1.0
MOST_DROPOUT = 0.99  # share of measurements, the most after scaling
VARIANCE_FLOOR = 1e-4  # m^2: of what is measured exactly
LUCK = 16  # streams of random numbers after those of noise
V = VELOCITY_N.start


class ObjectsConfig(Strict):
    """`[sensors.contacts]`: obstacles and team mates as radar, lidar or cameras have them."""

    range_noise: Annotated[NonNegative, Plausible(2e-3, 100.0, "m")] = 0.0  # standard deviation
    # standard deviation, of elevations too
    bearing_noise_deg: Annotated[NonNegative, Plausible(5e-3, 30.0, "deg")] = 0.0
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.0  # share of measurements that fail
    late: Annotated[int, Field(ge=0, le=50)] = 0  # delay of a measurement, decisions
    # standard deviation of a body's speed at first; assumed
    speed: Annotated[Positive, Plausible(0.05, 100.0, "m/s")] = 3.0
    # m/s^2 over one second, white acceleration of bodies; assumed
    acceleration: Annotated[Positive, Plausible(2e-3, 20.0, "m/s^2")] = 0.1
    # m/s^2 likewise, of team mates relative to the vehicle; assumed
    mate_acceleration: Annotated[Positive, Plausible(2e-3, 20.0, "m/s^2")] = 0.5

    @property
    def exact(self) -> bool:
        """Whether there are no errors."""
        return not (self.range_noise or self.bearing_noise_deg or self.dropout or self.late)


class SensorsConfig(InstrumentsConfig):
    """`[sensors]`: errors of instruments and contacts; what is left out is exact."""

    contacts: ObjectsConfig = ObjectsConfig()

    @property
    def scaled_objects(self) -> ObjectsConfig:
        """Contacts with their errors multiplied by `errors`; their delay stays, unless `errors` is 0."""
        c, e = self.contacts, self.errors
        noise = {"range_noise": e * c.range_noise, "bearing_noise_deg": e * c.bearing_noise_deg}
        rest = {"dropout": min(e * c.dropout, MOST_DROPOUT), "late": c.late if e > 0 else 0}
        return c.model_copy(update=noise | rest)


class ObjectsNumbers(NamedTuple):
    """Parameters of the kernel, SI."""

    reach: float
    radius: float
    range_noise: float
    bearing_noise: float
    dropout: float
    speed: float
    acceleration: float
    mates: float
    interval: float


ObjectsPack = ti.types.argpack(
    gap=array2, obstacles=array4, mates=array4, signals=array3, waiting=array5, tracks=array5
)
TruePack = ti.types.argpack(seen=array4, near=array4, true_derived=array3)  # two packs share no name
OwnPack = ti.types.argpack(state=array3, derived=array3, numbers=array1)


class ObjectsForm(NamedTuple):
    """Compile-time parameters of the kernel."""

    sight: Sight
    late: int
    vehicles: int  # number of the first vehicle among the random numbers


@ti.func
def measured(true: ti.template(), own: ti.template(), e, i, relative, origin, aside, size, who, z, u, g: ti.template()):
    """Measure body `who`, which is `relative` (m, NED) to vehicle i; return the columns above.

    The place is `origin` plus the measured way from the vehicle to the body.
    """
    far = ti.sqrt(relative[0] * relative[0] + relative[1] * relative[1])
    away = 1.0 + g.range_noise * z[0] / ti.max(far, 1.0)
    c0, s0 = true.true_derived[e, i, HEADING_COS], true.true_derived[e, i, HEADING_SIN]
    c1, s1 = own.derived[e, i, HEADING_COS], own.derived[e, i, HEADING_SIN]
    turned = g.bearing_noise * z[1]  # and by the error of the heading
    c, s = ti.cos(turned), ti.sin(turned)
    cos, sin = (c0 * c1 + s0 * s1) * c - (c0 * s1 - s0 * c1) * s, (c0 * s1 - s0 * c1) * c + (c0 * c1 + s0 * s1) * s
    m = ti.Vector([0.0 for _ in ti.static(range(MEASURED))])
    m[WHO], m[SEEN] = who, ti.select(u >= g.dropout, 1.0, 0.0)
    m[AT] = origin[0] + away * (cos * relative[0] - sin * relative[1])
    m[AT + 1] = origin[1] + away * (sin * relative[0] + cos * relative[1])
    m[AT + 2] = origin[2] + away * relative[2] + far * g.bearing_noise * z[2]
    side = far * g.bearing_noise
    m[VARIANCE] = 0.5 * (g.range_noise * g.range_noise + side * side) + VARIANCE_FLOOR
    m[SIZE], m[ASIDE] = size, aside
    return m


@ti.func
def drawn(who, e, k, vehicle, draws: ti.template(), g: ti.template()):
    """Draw random numbers for contact k of a vehicle: six normal ones, a uniform one (0 and 1 if `who` is no body)."""
    z, u = ti.Vector([0.0 for _ in ti.static(range(6))]), 1.0
    if who >= 0:
        z = normal6(draws[SEED], CONTACTS + k, draws[KEY + e], vehicle, draws[CLOCK])
        if g.dropout > 0:
            u = uniform4(draws[SEED], CONTACTS + LUCK + k, draws[KEY + e], vehicle, draws[CLOCK])[0]
    return z, u


@ti.func
def begun(m, g: ti.template()):
    """Begin a track by its first measurement; without a body (`NOBODY`) if the measurement failed."""
    t = ti.Vector([0.0 for _ in ti.static(range(TRACKED))])
    t[WHO] = ti.select(m[SEEN] > 0, m[WHO], NOBODY)
    for a in ti.static(range(3)):
        t[PLACE + a] = m[AT + a]
    t[P_PP], t[P_VV], t[RADIUS], t[BESIDE] = m[VARIANCE], g.speed * g.speed, m[SIZE], m[ASIDE]
    return t


@ti.func
def carried_on(t, m, acceleration, g: ti.template()):
    """Advance a track by one interval, and correct it by measurement m."""
    dt, q = g.interval, acceleration * acceleration
    t[P_PP] += dt * (2 * t[P_PV] + dt * t[P_VV]) + q * dt * dt * dt / 3
    t[P_PV] += dt * t[P_VV] + 0.5 * q * dt * dt
    t[P_VV] += q * dt
    for a in ti.static(range(3)):
        t[PLACE + a] += dt * t[SPEED + a]
    t[RADIUS], t[BESIDE] = m[SIZE], m[ASIDE]
    if m[SEEN] > 0:
        k_place, k_speed = t[P_PP] / (t[P_PP] + m[VARIANCE]), t[P_PV] / (t[P_PP] + m[VARIANCE])
        for a in ti.static(range(3)):
            off = m[AT + a] - t[PLACE + a]
            t[PLACE + a] += k_place * off
            t[SPEED + a] += k_speed * off
        t[P_VV] -= k_speed * t[P_PV]
        t[P_PV] *= 1.0 - k_place
        t[P_PP] *= 1.0 - k_place
    return t


@ti.func
def tracked(
    out: ti.template(), e, i, k, first: ti.template(), last: ti.template(), m, acceleration, now, g: ti.template()
):
    """Write track k of the measured body: continue the track among `first` to `last` of the same body, or begin one."""
    t = begun(m, g)
    for j in range(first, last):
        if m[WHO] >= 0 and out.tracks[e, i, 1 - now, j, WHO] == m[WHO]:
            before = ti.Vector([out.tracks[e, i, 1 - now, j, c] for c in ti.static(range(TRACKED))])
            t = carried_on(before, m, acceleration, g)
    for c in ti.static(range(TRACKED)):
        out.tracks[e, i, now, k, c] = t[c]
    return t


@ti.func
def queued(out: ti.template(), e, i, k, m, which, slot, form: ti.template()):
    """Queue a measurement, and return the one that is due."""
    slots = ti.static(form.late + 1)
    due = m
    for n in range(slots):
        if which == BEGINS or n == slot:
            for c in ti.static(range(MEASURED)):
                out.waiting[e, i, n, k, c] = m[c]
    for c in ti.static(range(MEASURED)):
        due[c] = out.waiting[e, i, (slot + 1) % slots, k, c]
    return due


@ti.func
def put_obstacle(out: ti.template(), own: ti.template(), e, i, k, t, g: ti.template(), form: ti.template()):
    """Write the k-th obstacle by its track t, extrapolated to now; return the clearance (m)."""
    ahead = ti.static(form.late) * g.interval
    place = ti.Vector([own.state[e, i, a] for a in ti.static(range(3))])
    there = ti.Vector([t[PLACE] + ahead * t[SPEED], t[PLACE + 1] + ahead * t[SPEED + 1], t[RADIUS], t[SPEED],
                       t[SPEED + 1]])  # fmt: skip
    beside = ti.sqrt((there[0] - place[0]) ** 2 + (there[1] - place[1]) ** 2) - t[RADIUS]
    distance = beside
    if t[BESIDE] > 0:
        distance = ti.sqrt(ti.max(beside, 0.0) ** 2 + t[BESIDE] ** 2)
    distance = ti.select(t[WHO] >= 0, distance, g.reach)
    store_obstacle(
        out, own.derived, form.sight, e, i, k, distance, ti.cast(t[WHO], ti.i32), place,
        ti.Vector([there[0], there[1], there[2], there[3], there[4]]), g.reach,
    )  # fmt: skip
    return distance - g.radius


@ti.func
def put_mate(out: ti.template(), own: ti.template(), e, i, k, t, g: ti.template(), form: ti.template()):
    """Write the k-th team mate by its track t, extrapolated to now; return the clearance (m)."""
    ahead, direction, distance = ti.static(form.late) * g.interval, ti.Vector([0.0, 0.0, 0.0]), g.reach
    if t[WHO] >= 0:
        for a in ti.static(range(3)):
            direction[a] = t[PLACE + a] + ahead * t[SPEED + a]
        distance = ti.max(direction.norm(), 1e-6)
        direction /= distance
    moves = ti.Vector([own.derived[e, i, V + a] + t[SPEED + a] for a in ti.static(range(2))])
    store_mate(out, own.derived, form.sight, e, i, k, distance, ti.cast(t[WHO], ti.i32), direction, moves, g.reach)
    return distance - 2 * g.radius


@ti.kernel
def _contact(
    out: ObjectsPack, true: TruePack, own: OwnPack, which: whole1, steps: ti.types.ndarray(dtype=ti.i64, ndim=1),
    draws: whole1, kind: ti.template(), form: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(own.state.shape[0], own.state.shape[1]):
        if which[e] != NOT_DUE:
            g = values_at(kind, own.numbers)
            here, nowhere = ti.Vector([own.state[e, i, a] for a in ti.static(range(3))]), ti.Vector([0.0, 0.0, 0.0])
            step, clear = ti.cast(steps[e], ti.i32), g.reach
            slot, now = step % ti.static(form.late + 1), step % 2
            ends = ti.static((form.sight.obstacles, form.sight.obstacles + form.sight.mates))
            if which[e] == BEGINS:
                for k in range(ends[1]):
                    out.tracks[e, i, 1 - now, k, WHO] = NOBODY
            for k in range(ends[0]):
                n = ti.Vector([true.seen[e, i, k, Obstacle.NORTH], true.seen[e, i, k, Obstacle.EAST], 0.0])
                level, size = true.seen[e, i, k, Obstacle.LEVEL], true.seen[e, i, k, Obstacle.RADIUS]
                far, who = true.seen[e, i, k, Obstacle.DISTANCE], true.seen[e, i, k, Obstacle.NUMBER]
                aside = ti.select(level > 0, ti.sqrt(ti.max(far * far - level * level, 0.0)), ti.max(far, 0.0))
                z, u = drawn(who, e, k, form.vehicles + i, draws, g)
                m = measured(true, own, e, i, (level + size) * n, here, aside, size, who, z, u, g)
                m = queued(out, e, i, k, m, which[e], slot, form)
                t = tracked(out, e, i, k, 0, ends[0], m, g.acceleration, now, g)
                clear = ti.min(clear, put_obstacle(out, own, e, i, k, t, g, form))
            for k in range(ends[0], ends[1]):
                mate = k - ti.static(form.sight.obstacles)
                n = ti.Vector([true.near[e, i, mate, Mate.NORTH + a] for a in ti.static(range(3))])
                who, far = true.near[e, i, mate, Mate.NUMBER], true.near[e, i, mate, Mate.DISTANCE]
                z, u = drawn(who, e, k, form.vehicles + i, draws, g)
                m = measured(true, own, e, i, far * n, nowhere, 0.0, 0.0, who, z, u, g)
                m = queued(out, e, i, k, m, which[e], slot, form)
                t = tracked(out, e, i, k, ends[0], ends[1], m, g.mates, now, g)
                clear = ti.min(clear, put_mate(out, own, e, i, mate, t, g, form))
            out.gap[e, i] = clear


class TrackedObjects(Nearby):
    """Obstacles and team mates of one team as its vehicles measure and track them."""

    def __init__(
        self, config: ObjectsConfig, sensor: Nearby, fleet: Views, own: Views, interval: float, vehicles: int = 0
    ):
        """Measure what the true `sensor` of `fleet` senses, by vehicles whose instruments say `own`; `interval` s.

        `vehicles`: number of the first vehicle among the random numbers.
        """
        state = fleet.state
        super().__init__(state, sensor.num_obstacles, sensor.num_mates, sensor.reach, sensor.radius, sensor.axes)
        both, rows = sensor.num_obstacles + sensor.num_mates, state.shape[:2]
        self._numbers = ObjectsNumbers(
            sensor.reach, sensor.radius, config.range_noise, math.radians(config.bearing_noise_deg), config.dropout,
            config.speed, config.acceleration, config.mate_acceleration, interval,
        )  # fmt: skip
        self._waiting = self.remember(state.new_zeros((*rows, config.late + 1, max(both, 1), MEASURED)))
        self._tracks = self.remember(state.new_zeros((*rows, 2, max(both, 1), TRACKED)))
        self._out = runtime.Packed(
            ObjectsPack, gap=self.gap, obstacles=self.obstacles, mates=self.team_mates, signals=self.written,
            waiting=self._waiting, tracks=self._tracks,
        )  # fmt: skip
        self._true = runtime.Packed(TruePack, seen=sensor.obstacles, near=sensor.team_mates, true_derived=fleet.derived)
        self._own = runtime.Packed(
            OwnPack, state=own.state, derived=own.derived, numbers=state.new_tensor(self._numbers)
        )
        self._form = ObjectsForm(Sight(sensor.num_obstacles, sensor.num_mates, sensor.axes), config.late, vehicles)
        self._launch = runtime.Launcher(_contact, plain=True, few=runtime.MEDIUM)

    def update(self, due: Due) -> None:
        """Measure in the environments that are `due`."""
        kind = struct_of(ObjectsNumbers._fields, runtime.current().precision)
        self._launch(
            self._out(), self._true(), self._own(), due.which, due.steps, due.draws, kind, self._form, envs=due.count
        )
