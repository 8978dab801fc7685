"""A vehicle that an autopilot steps frame by frame: it begins, advances and measures; what passes between the two.

A vessel begins afloat, at rest. A multirotor stands at its place until its rotors lift it, because decks are the only
ground here. A fixed-wing aircraft is held at its place, level, until its throttle opens; from there it flies at its
cruising airspeed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from torch import Tensor

from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, SeaConfig
from taichi_sim.conventions import DOWN, GRAVITY, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import numpy_rotation_matrix, torch_euler_from_quaternion
from taichi_sim.sitl.channels import PWM, Mixer, changes_for, default_channels
from taichi_sim.uav.fixed_wing.params import FixedWingParams
from taichi_sim.vehicle import Vehicle
from taichi_sim.vehicles import Changes, load_vehicle

LONGEST_STEP = 0.02  # s, longest physics step; frames below 50 Hz have several
SHORT = 1e-3  # s, a step that is stable for every vehicle
ROUNDING = 1e-9  # of a number of steps
WARM_UP = 5  # frames
HELD_HEIGHT = 50.0  # m, height at which aircraft are held; they report their position from there
OPEN = 0.6  # throttle at which a held aircraft is released
MOST_REASONS = 16  # largest number of reasons of refusals that are counted separately


class Servos(NamedTuple):
    """A packet from ArduPilot."""

    rate: int  # frame rate, Hz
    frame: int  # counts from 0; repeated if no answer arrived
    pwm: tuple[int, ...]  # microseconds; 0: no output


class Sensors(NamedTuple):
    """Measurements of a vehicle at the end of a frame; SI, NED and forward-right-down."""

    timestamp: float  # simulated time, s
    gyro: tuple[float, float, float]  # rad/s, b
    accel_body: tuple[float, float, float]  # specific force, m/s^2, b: (0, 0, -9.8) at rest
    position: tuple[float, float, float]  # from the initial position, m, NED
    attitude: tuple[float, float, float]  # roll, pitch, yaw, rad
    quaternion: tuple[float, float, float, float]  # w, x, y, z, b to NED
    velocity: tuple[float, float, float]  # over ground, m/s, NED
    airspeed: float | None = None  # m/s
    wind_direction: float | None = None  # direction that the apparent wind blows from, clockwise from the bow, rad
    wind_speed: float | None = None  # apparent wind, m/s


@dataclass
class Counts:
    """Counts frames, packets and messages, by kind."""

    frames: int = 0  # new frames
    repeated: int = 0
    lost: int = 0  # frames that never arrived
    late: int = 0  # of an older frame, or repeated controls
    waiting: int = 0  # frames before the first controls of PX4
    resent: int = 0  # frames that were sent to PX4 again
    restarts: int = 0
    refused: dict[str, int] = field(default_factory=dict)  # reason -> number

    def refuse(self, why: str) -> None:
        """Count a refusal by its reason `why`."""
        if why in self.refused or len(self.refused) < MOST_REASONS:
            self.refused[why] = self.refused.get(why, 0) + 1

    @property
    def refusals(self) -> str:
        """Refusals by reason, as the end of a status line."""
        return "".join(f"; refused {n}: {why}" for why, n in self.refused.items())


class Craft:
    """One vehicle in a sea and a wind."""

    def __init__(
        self,
        vehicle: str,
        changes: Changes | None = None,
        *,
        sea: SeaConfig | None = None,
        air: AirConfig | None = None,
        channels: dict[str, int] | None = None,
        pwm: tuple[float, float] = PWM,
        heading: float = 0.0,
        seed: int = 0,
    ):
        """Load a vehicle file or name, with `changes` of its keys and the initial `heading` (rad).

        `channels` and `pwm` are explained in channels.py.

        Raises:
            ConfigError: for a vehicle that cannot be loaded, or that an autopilot cannot drive.
        """
        self.vehicle, self.changes = vehicle, dict(changes or {})
        self.sea, self.air, self.heading, self.seed, self.pwm = sea, air, heading, seed, pwm
        first = load_vehicle(vehicle, SHORT, 1, **self.changes)
        for section, values in changes_for(first).items():
            self.changes[section] = values | self.changes.get(section, {}) | values
        self.first = load_vehicle(vehicle, SHORT, 1, **self.changes)
        self.channels = channels or default_channels(self.first)
        self.rate, self.steps = 0, 1  # Hz; physics steps of a frame
        self.frames, self.time, self.held = 0, 0.0, False  # since the beginning; s, likewise; still at its place
        self.model: Vehicle  # that of the present rate, as are bench and mixer, if it has no free step
        self.bench: Bench
        self.mixer: Mixer

    def begin(self, rate: int) -> None:
        """Place the vehicle at rest at its initial position, for frames of `rate` Hz."""
        self._follow(rate)
        b, air = self.bench, self.model.medium == "air"
        b.time.zero_()
        down = -HELD_HEIGHT if air else 0.0
        b.put((0.0, 0.0, down), (0.0, 0.0, self.heading), settle=not air)
        b.fleet.action.zero_()
        for name in self.model.control_names:  # rotors and propellers stand still
            if air and name in self.model.aux_names:
                b.fleet.reading(name).zero_()
        self.frames, self.time, self.held = 0, 0.0, air
        self.origin = b.position
        if not air:  # let it reach the motion of the water under it
            b.step(self.mixer.actions(()), times=WARM_UP * self.steps)
            self.origin[2] = 0.0
        self.before = self._velocity()

    def change_rate(self, rate: int) -> None:
        """Continue with frames of another rate, Hz; motion and time stay."""
        old = self.bench
        self._follow(rate)
        if self.bench is not old:
            b, f, g = self.bench, self.bench.fleet, old.fleet
            for new, kept in ((f.state, g.state), (f.remainder, g.remainder), (f.aux, g.aux), (f.surface, g.surface)):
                new.copy_(kept)
            b.time.copy_(old.time)
            b.refresh()
            f.update()

    def _follow(self, rate: int) -> None:
        """Step by frames of `rate` Hz: in the same bench, or in a new one if the kernels hold their step."""
        if rate == self.rate:
            return
        longest = min(LONGEST_STEP, self.first.longest_step)
        self.rate, self.steps = rate, max(1, math.ceil(1 / (rate * longest) - ROUNDING))
        dt, free = 1 / (rate * self.steps), self.first.free_step
        if not free or not hasattr(self, "bench"):
            self.model = self.first if free else load_vehicle(self.vehicle, dt, 1, **self.changes)
            sea = None if self.sea is None else self.sea.model_copy(update={"realisations": 1})
            self.bench = Bench(self.model, sea=sea, air=self.air, seed=self.seed)
            self.mixer = Mixer(self.model, self.channels, self.pwm)
        if free:
            self.bench.fleet.set_step(dt)

    def advance(self, pwm: tuple[int, ...]) -> None:
        """Advance by one frame under the servo outputs `pwm` (microseconds)."""
        b, kept = self.bench, self.bench.state.clone()
        self.before = self._velocity()
        b.step(self.mixer.actions(pwm), times=self.steps)
        self.frames += 1
        self.time += 1 / self.rate
        if self.held and not self._released(kept, pwm):
            self._back(kept)

    def _back(self, kept: Tensor) -> None:
        """Put a held vehicle back to the state before the frame."""
        b = self.bench
        b.state.copy_(kept)
        b.fleet.remainder.zero_()
        b.fleet.update()

    def _released(self, kept: Tensor, pwm: tuple[int, ...]) -> bool:
        """Whether a held vehicle, in state `kept` before the frame, is released: a multirotor when its rotors lift it:
        the frame has given it a velocity upwards, from rest; an aircraft when its throttle opens.
        """
        b = self.bench
        if isinstance(self.model.params, FixedWingParams):
            if self.mixer.share("throttle", pwm) < OPEN:
                return False
            self._back(kept)
            b.state.copy_(self.model.settle(b.state.clone(), b.surface, b.around))
            self.model.reset_aux(b.aux, b.state, b.around)
            b.fleet.update()
            self.before = self._velocity()
        elif not self._velocity()[DOWN] < 0.0:
            return False
        self.held = False
        return True

    def _state(self) -> np.ndarray:
        return self.bench.state[0, 0].double().cpu().numpy()

    def _velocity(self) -> np.ndarray:
        """Velocity over ground [3], NED, m/s."""
        return numpy_rotation_matrix(self._state()[QUATERNION]) @ self._state()[VELOCITY]

    def sensors(self) -> Sensors:
        """Measurements at the end of the last frame; the specific force is the mean over that frame."""
        s = self._state()
        R, velocity = numpy_rotation_matrix(s[QUATERNION]), self._velocity()
        force = R.T @ ((velocity - self.before) * self.rate - np.array([0.0, 0.0, GRAVITY]))
        euler = torch_euler_from_quaternion(self.bench.state[0, 0, QUATERNION].double()).tolist()
        met = R.T @ (self.bench.around.wind[0].double().cpu().numpy() - velocity)  # of the air, b
        air = self.model.medium == "air"
        speed = float(np.linalg.norm(met)) if air else None
        if air and "airspeed" in self.model.aux_names and not self.held:
            speed = float(self.bench.fleet.reading("airspeed")[0, 0])
        position = self.bench.position - self.origin
        return Sensors(
            self.time, _three(s[10:13]), _three(force), _three(position), _three(euler),
            (float(s[3]), float(s[4]), float(s[5]), float(s[6])), _three(velocity), speed,
            math.atan2(-met[1], -met[0]), float(math.hypot(met[0], met[1])),
        )  # fmt: skip


def _three(x: np.ndarray | Sequence[float]) -> tuple[float, float, float]:
    return float(x[0]), float(x[1]), float(x[2])
