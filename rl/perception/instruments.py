"""Instruments of a vehicle: its own state as it measures it.

    GNSS        place over ground, north and east: a slow walk (a first-order Gauss-Markov process, Gelb 1974) of
                which `shared` of the variance is that of all receivers of an environment (satellites, atmosphere), and
                noise
    altimeter   height of aircraft: a constant of the episode, and noise
    compass     heading: likewise
    log         velocity over ground, of vessels in b (Doppler log), of aircraft in n (Doppler of the GNSS): likewise
    IMU         rates, roll and pitch: noise
    air data    airspeed: a constant and noise; angles of attack and sideslip: noise; the velocity of the air is what
                those and the velocity over ground leave (the wind triangle)

All noise is white from decision to decision. Random numbers are counted (kernels/random.py): same seed, same bits.
Instruments that are not configured are exact. Inner loops of a vehicle model (autopilot) use the truth. Frame: NED, b.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Annotated, NamedTuple

import taichi as ti

from rl.step import BEGINS, NOT_DUE, Due
from taichi_sim.config import Fraction, NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Fleet, Views
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import DOWN, QW, ROLL_RATE, SURGE
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.random import CLOCK, INSTRUMENTS, KEY, SEED, normal6
from taichi_sim.kernels.rotation import quaternion_product, rotation_matrix, store
from taichi_sim.kernels.runtime import array1, array3, whole1
from taichi_sim.vehicle import Vehicle

EVERYBODY = 1 << 20  # number, among the random numbers, of errors that all vehicles of an environment share
OWN, COMMON, HEADING, LOG, HEIGHT, AIRSPEED, MEMORY = 0, 2, 4, 5, 8, 9, 10  # columns of `memory`


class GnssConfig(Strict):
    """`[sensors.gnss]`"""

    noise: Annotated[NonNegative, Plausible(2e-3, 50.0, "m")] = 0.0  # standard deviation of each direction
    bias: Annotated[NonNegative, Plausible(2e-3, 100.0, "m")] = 0.0  # of the walk
    time_constant: Annotated[Positive, Plausible(1.0, 1e4, "s")] = 60.0  # of the walk
    shared: Fraction = 0.8  # of the walk's variance, common to all receivers nearby; assumed


class CompassConfig(Strict):
    """`[sensors.compass]`"""

    noise_deg: Annotated[NonNegative, Plausible(5e-3, 30.0, "deg")] = 0.0
    bias_deg: Annotated[NonNegative, Plausible(5e-3, 60.0, "deg")] = 0.0  # of an episode


class LogConfig(Strict):
    """`[sensors.log]`"""

    noise: Annotated[NonNegative, Plausible(1e-3, 5.0, "m/s")] = 0.0  # of each component
    bias: Annotated[NonNegative, Plausible(1e-3, 5.0, "m/s")] = 0.0  # of an episode


class ImuConfig(Strict):
    """`[sensors.imu]`"""

    rate_noise_deg: Annotated[NonNegative, Plausible(1e-3, 30.0, "deg/s")] = 0.0
    attitude_noise_deg: Annotated[NonNegative, Plausible(1e-3, 30.0, "deg")] = 0.0  # of roll and pitch


class AirDataConfig(Strict):
    """`[sensors.air_data]`"""

    noise: Annotated[NonNegative, Plausible(2e-3, 20.0, "m/s")] = 0.0  # of the airspeed
    bias: Annotated[NonNegative, Plausible(2e-3, 20.0, "m/s")] = 0.0  # of an episode
    angle_noise_deg: Annotated[NonNegative, Plausible(2e-3, 30.0, "deg")] = 0.0


class AltimeterConfig(Strict):
    """`[sensors.altimeter]`"""

    noise: Annotated[NonNegative, Plausible(2e-3, 50.0, "m")] = 0.0
    bias: Annotated[NonNegative, Plausible(2e-3, 100.0, "m")] = 0.0  # of an episode


class InstrumentsConfig(Strict):
    """Standard deviations of a vehicle's instruments; what is left out is exact."""

    errors: NonNegative = 1.0  # factor of all errors; 0: everything is exact
    gnss: GnssConfig = GnssConfig()
    compass: CompassConfig = CompassConfig()
    log: LogConfig = LogConfig()
    imu: ImuConfig = ImuConfig()
    air_data: AirDataConfig = AirDataConfig()
    altimeter: AltimeterConfig = AltimeterConfig()

    @property
    def numbers(self) -> "InstrumentErrors":
        """Parameters of the kernel, except the decision interval."""
        g, deg = self.gnss, math.pi / 180
        given = InstrumentErrors(
            place=g.noise,
            walk=g.bias * math.sqrt(1 - g.shared),
            common=g.bias * math.sqrt(g.shared),
            time=g.time_constant,
            heading=self.compass.noise_deg * deg,
            heading_bias=self.compass.bias_deg * deg,
            speed=self.log.noise,
            speed_bias=self.log.bias,
            rate=self.imu.rate_noise_deg * deg,
            tilt=self.imu.attitude_noise_deg * deg,
            air=self.air_data.noise,
            air_bias=self.air_data.bias,
            angle=self.air_data.angle_noise_deg * deg,
            height=self.altimeter.noise,
            height_bias=self.altimeter.bias,
        )
        scaled = {name: self.errors * value for name, value in given._asdict().items() if name != "time"}
        return given._replace(**scaled)

    @property
    def exact(self) -> bool:
        """Whether there are no errors."""
        return not any(value for name, value in self.numbers._asdict().items() if name != "time")


class InstrumentErrors(NamedTuple):
    """Standard deviations, SI; and the time constant of the walk, s."""

    place: float
    walk: float
    common: float
    time: float
    heading: float
    heading_bias: float
    speed: float
    speed_bias: float
    rate: float
    tilt: float
    air: float
    air_bias: float
    angle: float
    height: float
    height_bias: float


TruthPack = ti.types.argpack(true_state=array3, true_aux=array3)  # two packs of a kernel share no name
ReadPack = ti.types.argpack(state=array3, derived=array3, aux=array3, memory=array3, numbers=array1)


class InstrumentsForm(NamedTuple):
    """Compile-time parameters of the kernel."""

    vehicles: int  # number of the first vehicle among the random numbers
    over_ground: bool = False  # velocity is measured in n, not in b
    air_data: tuple[int, ...] = ()  # columns of `aux`: airspeed, alpha, beta
    air: tuple[int, ...] = ()  # of the air's velocity, north, east, down


@ti.func
def walked(old, beginning, std, phi, z):
    """A Gauss-Markov process after a step, or at its beginning."""
    return ti.select(beginning, std * z, phi * old + std * ti.sqrt(1.0 - phi * phi) * z)


@ti.func
def remember(memory: ti.template(), e, i, g: ti.template(), beginning, interval, z_own, z_common, z_episode, z_more):
    """Advance the lasting errors by one decision, or draw them as an episode begins."""
    phi = ti.exp(-interval / g.time)
    for a in ti.static(range(2)):
        memory[e, i, OWN + a] = walked(memory[e, i, OWN + a], beginning, g.walk, phi, z_own[a])
        memory[e, i, COMMON + a] = walked(memory[e, i, COMMON + a], beginning, g.common, phi, z_common[a])
    if beginning:
        memory[e, i, HEADING] = g.heading_bias * z_episode[0]
        for a in ti.static(range(3)):
            memory[e, i, LOG + a] = g.speed_bias * z_episode[1 + a]
        memory[e, i, HEIGHT] = g.height_bias * z_episode[4]
        memory[e, i, AIRSPEED] = g.air_bias * z_more


@ti.func
def read_air(out: ti.template(), e, i, g: ti.template(), z, z_more, R, v_n, form: ti.template()):
    """Measure airspeed and angles; the wind follows from them and from the velocity over ground v_n."""
    Va = out.aux[e, i, form.air_data[0]] + out.memory[e, i, AIRSPEED] + g.air * z[4]
    alpha = out.aux[e, i, form.air_data[1]] + g.angle * z[5]
    beta = out.aux[e, i, form.air_data[2]] + g.angle * z_more
    out.aux[e, i, form.air_data[0]], out.aux[e, i, form.air_data[1]] = Va, alpha
    out.aux[e, i, form.air_data[2]] = beta
    if ti.static(len(form.air) > 0):
        level = Va * ti.cos(beta)
        wind = v_n - R @ ti.Vector([level * ti.cos(alpha), Va * ti.sin(beta), level * ti.sin(alpha)])
        for a in ti.static(range(3)):
            out.aux[e, i, form.air[a]] = wind[a]


@ti.kernel
def _read(out: ReadPack, truth: TruthPack, which: whole1, draws: whole1, kind: ti.template(), form: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(truth.true_state.shape[0], truth.true_state.shape[1]):
        if which[e] != NOT_DUE:
            n = ti.static(len(kind.members))
            g = values_at(kind, out.numbers)
            env, number, clock, seed = draws[KEY + e], form.vehicles + i, draws[CLOCK], draws[SEED]
            z0, z1 = normal6(seed, INSTRUMENTS, env, number, clock), ti.Vector([0.0 for _ in ti.static(range(6))])
            if ti.static(len(form.air_data) > 0) or which[e] == BEGINS:  # otherwise nothing needs them
                z1 = normal6(seed, INSTRUMENTS + 1, env, number, clock)
            z2, z3 = (
                normal6(seed, INSTRUMENTS + 2, env, number, clock),
                normal6(seed, INSTRUMENTS + 3, env, number, clock),
            )
            z4 = normal6(seed, INSTRUMENTS, env, EVERYBODY, clock)
            remember(out.memory, e, i, g, which[e] == BEGINS, out.numbers[n], z0, z4, z1, z0[2])
            for k in ti.static(range(13)):
                out.state[e, i, k] = truth.true_state[e, i, k]
            for a in ti.static(range(2)):
                out.state[e, i, a] += out.memory[e, i, OWN + a] + out.memory[e, i, COMMON + a] + g.place * z2[a]
            out.state[e, i, DOWN] += out.memory[e, i, HEIGHT] + g.height * z2[2]
            half = 0.5 * (out.memory[e, i, HEADING] + g.heading * z2[3])
            q = taken(truth.true_state, e, i, QW, 4)
            tilt = ti.Vector([1.0, 0.5 * g.tilt * z2[4], 0.5 * g.tilt * z2[5], 0.0])
            q = quaternion_product(quaternion_product(ti.Vector([ti.cos(half), 0.0, 0.0, ti.sin(half)]), q), tilt)
            q = q.normalized()
            for k in ti.static(range(4)):
                out.state[e, i, QW + k] = q[k]
            R = rotation_matrix(q)
            v_b = taken(truth.true_state, e, i, SURGE, 3)
            off = ti.Vector([out.memory[e, i, LOG + a] + g.speed * z3[a] for a in ti.static(range(3))])
            v_n = R @ (v_b + off)
            if ti.static(form.over_ground):
                v_n = rotation_matrix(taken(truth.true_state, e, i, QW, 4)) @ v_b + off
                v_b = R.transpose() @ v_n
            else:
                v_b += off
            for a in ti.static(range(3)):
                out.state[e, i, SURGE + a] = v_b[a]
                out.state[e, i, ROLL_RATE + a] += g.rate * z0[3 + a]
            store(out.derived, e, i, R, v_n)
            for k in range(truth.true_aux.shape[2]):
                out.aux[e, i, k] = truth.true_aux[e, i, k]
            if ti.static(len(form.air_data) > 0):
                read_air(out, e, i, g, z3, z1[5], R, v_n, form)


class Readings(Views[Vehicle]):
    """State of a fleet as its vehicles measure it: views named as in a `Fleet`, which the next reading overwrites.

    Attributes:
        memory: [env, vehicle, 10], errors that last: walks and constants of an episode.
    """

    def __init__(self, fleet: Fleet[Vehicle], config: InstrumentsConfig, interval: float, vehicles: int = 0):
        """Measure `fleet` every `interval` s; `vehicles` numbers its first vehicle among the random numbers."""
        super().__init__(fleet.model, *(x.clone() for x in (fleet.state, fleet.derived, fleet.aux)))
        self.fleet, self.count, self.num_envs = fleet, fleet.count, fleet.num_envs
        self.memory = self.remember(fleet.state.new_zeros((*fleet.state.shape[:2], MEMORY)))
        numbers = config.numbers
        self._numbers = numbers
        self._out = runtime.Packed(
            ReadPack, state=self.state, derived=self.derived, aux=self.aux, memory=self.memory,
            numbers=fleet.state.new_tensor([*numbers, interval]),
        )  # fmt: skip
        self._truth = runtime.Packed(TruthPack, true_state=fleet.state, true_aux=fleet.aux)
        names, model = fleet.model.aux_names, fleet.model
        measured = ("airspeed", "alpha", "beta")
        air_data = tuple(names.index(name) for name in measured) if set(measured) <= set(names) else ()
        air = tuple(names.index(name) for name in model.air) if air_data and model.air is not None else ()
        self._form = InstrumentsForm(vehicles, model.medium == "air", air_data, air)
        self._launch = runtime.Launcher(_read, plain=True, few=runtime.MEDIUM)

    def read(self, due: Due) -> None:
        """Measure in the environments that are `due`."""
        kind = struct_of(self._numbers._fields, runtime.current().precision)
        self._launch(self._out(), self._truth(), due.which, due.draws, kind, self._form, envs=due.count)
