"""A vehicle that an autopilot steps frame by frame: it begins, advances and measures; what passes between the two.

A vessel begins afloat, at rest. Aircraft begin HELD_HEIGHT above the sea. A multirotor stands there on a level ground
until its rotors lift it, and may land on it again. A fixed-wing aircraft is held there in the attitude of its cruise
until its throttle opens; a launcher then accelerates it to its cruising airspeed. The sea ends a flight: the aircraft
stays where it met the water.

Launch, touchdown and ditching are passages: velocity and attitude change at constant rates, which the IMU feels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from taichi_sim.applications.bench import Bench
from taichi_sim.applications.sitl.channels import PWM, Mixer, changes_for, default_channels
from taichi_sim.config import AirConfig, SeaConfig, WorldConfig
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, DOWN, GRAVITY, HORIZONTAL, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import numpy_rotation_matrix, torch_quaternion_from_euler
from taichi_sim.models.catalogue import Changes, load_vehicle
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.vehicle import Vehicle

LONGEST_STEP = 0.02  # s, longest physics step; frames below 50 Hz have several
SHORT = 1e-3  # s, a step that is stable for every vehicle
ROUNDING = 1e-9  # of a number of steps
WARM_UP = 5  # frames
HELD_HEIGHT = 50.0  # m, height at which aircraft are held; they report their position from there
GROUND = 50.0  # m, half of the side of the level square around the place where a multirotor begins; assumed
OPEN = 0.6  # throttle at which a held aircraft is launched
LAUNCH = 1.0  # s from rest to cruise: 25 m/s^2 for an Aerosonde; assumed
STOP = 0.1  # s from a touchdown, or from the water, to rest; assumed
HARD, STEEP = 3.0, math.radians(45.0)  # m/s, rad: a faster or steeper touchdown is a crash; assumed
WET = "ditched", "crashed"  # endings of aircraft in the water (`Vehicle.endings`)
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
    airspeed: float | None = None  # of a pitot: flow from ahead, m/s
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


class Passage(NamedTuple):
    """A change of velocity and attitude at constant rates, from `begun` (s, since the beginning) on."""

    begun: float
    seconds: float  # how long it takes
    velocity: tuple[np.ndarray, np.ndarray]  # at both ends, n, m/s
    euler: tuple[np.ndarray, np.ndarray]  # roll, pitch, heading at both ends, rad; of one heading
    flies: bool  # whether the aircraft flies afterwards; otherwise it is held

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Velocity (n, m/s), roll, pitch and heading (rad), and angular velocity (b, rad/s) at `time` (s)."""
        share = min((time - self.begun) / self.seconds, 1.0)
        v, euler = ((1.0 - share) * a + share * b for a, b in (self.velocity, self.euler))
        roll_rate, pitch_rate, _ = (self.euler[1] - self.euler[0]) / self.seconds * (share < 1.0)
        return v, euler, np.array([roll_rate, pitch_rate * math.cos(euler[0]), -pitch_rate * math.sin(euler[0])])


class Craft:
    """One vehicle in a sea and a wind.

    Attributes:
        rate: frame rate, Hz.
        frames, time: since the beginning; time in s.
        held: whether an aircraft does not fly: it stands, is launched, comes to rest, or has ended its flight.
        ended: how the flight has ended ("ditched", "crashed"), or "".
        news: what has happened to an aircraft, for whoever reads and clears it.
    """

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
        self.config = WorldConfig(sea=sea or SeaConfig(), air=air or AirConfig())
        first = load_vehicle(vehicle, SHORT, 1, **self.changes)
        for section, values in changes_for(first).items():
            self.changes[section] = values | self.changes.get(section, {}) | values
        self.first = load_vehicle(vehicle, SHORT, 1, **self.changes)
        self.channels = channels or default_channels(self.first)
        self.rate, self.steps = 0, 1  # steps: physics steps of a frame
        self.frames, self.time, self.held, self.ended = 0, 0.0, False, ""
        self.news: list[str] = []
        self.passage: Passage | None = None
        self.model: Vehicle  # that of the present rate, as are bench and mixer, if it has no free step
        self.bench: Bench
        self.mixer: Mixer

    def compile(self, rate: int) -> None:
        """Compile all kernels, so that no frame from the first one on, at `rate` Hz, waits for it."""
        self.begin(rate)
        self.advance(())
        if self.model.medium == "air":
            self._meets_water()

    def begin(self, rate: int) -> None:
        """Place the vehicle at rest at its initial position, for frames of `rate` Hz."""
        self._follow(rate)
        b, air = self.bench, self.model.medium == "air"
        b.time.zero_()
        down = -HELD_HEIGHT if air else 0.0
        b.put((0.0, 0.0, down), (0.0, 0.0, self.heading), settle=not air or self.flies_ahead)
        if self.flies_ahead:
            b.state[..., VELOCITY] = 0.0
            b.fleet.update()
        b.fleet.action.zero_()
        for name in self.model.control_names:  # rotors and propellers stand still
            if air and name in self.model.aux_names:
                b.fleet.reading(name).zero_()
        self.frames, self.time, self.held, self.ended, self.passage = 0, 0.0, air, "", None
        self.origin = b.position
        if not air:  # let it reach the motion of the water under it
            b.step(self.mixer.actions(()), times=WARM_UP * self.steps)
            self.origin[2] = 0.0
        self.before = self._velocity()

    @property
    def flies_ahead(self) -> bool:
        """Whether it is an aircraft that cannot stop, which a launcher holds."""
        return isinstance(self.first.params, FixedWingParams)

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
            if self.model.air is not None:
                self._air = [self.model.aux_names.index(name) for name in self.model.air]
            self.crest = float(self.bench.sea.components.amplitude.sum())  # m, no wave is higher
        if free:
            self.bench.fleet.set_step(dt)

    def advance(self, pwm: tuple[int, ...]) -> None:
        """Advance by one frame under the servo outputs `pwm` (microseconds)."""
        b, s = self.bench, self._state()
        self.before = numpy_rotation_matrix(s[QUATERNION]) @ s[VELOCITY]
        kept = (b.state.clone(), b.fleet.remainder.clone()) if self.held else None
        b.step(self.mixer.actions(pwm), times=self.steps)
        self.frames += 1
        self.time += 1 / self.rate
        if kept is not None:
            self._hold(kept, pwm)
        elif self.model.medium == "air":
            self._meet(s[DOWN])

    # -- aircraft that do not fly ----------------------------------------------------------------------------------

    def _hold(self, kept: tuple[Tensor, Tensor], pwm: tuple[int, ...]) -> None:
        """Put an aircraft back to where it was before the frame, or to where its passage leads it, or release it.

        A multirotor is released when its rotors lift it: the frame has given it a velocity upwards, from rest. A fixed
        wing is launched when its throttle opens.
        """
        if self.passage is None and not (self.flies_ahead or self.ended) and self._velocity()[DOWN] < 0.0:
            self.held = False
            self.news.append("lifts off")
            return
        b = self.bench
        for now, then in zip((b.state, b.fleet.remainder), kept, strict=True):
            now.copy_(then)
        if self.passage is not None:
            self._pass(self.passage)
        elif self.flies_ahead and not self.ended and self.mixer.share("throttle", pwm) >= OPEN:
            cruise = self.model.settle(b.state.clone(), b.surface, b.around)[0, 0, VELOCITY].double().cpu().numpy()
            self._begin_passage(LAUNCH, numpy_rotation_matrix(self._state()[QUATERNION]) @ cruise, flies=True)
            self.news.append("is launched")
        b.fleet.update()

    def _begin_passage(self, seconds: float, velocity: np.ndarray, *, flies: bool, level: bool = False) -> None:
        """Begin to change to a `velocity` (n, m/s) and, if asked for, to a level attitude."""
        euler = _euler(numpy_rotation_matrix(self._state()[QUATERNION]))
        to = np.array([0.0, 0.0, euler[2]]) if level else euler
        self.passage, self.held = Passage(self.time, seconds, (self._velocity(), velocity), (euler, to), flies), True

    def _pass(self, passage: Passage) -> None:
        """Move by one frame of a passage; end it when its time has passed."""
        b, frame = self.bench, 1 / self.rate
        ends = self.time - passage.begun > passage.seconds - 0.5 * frame
        v, euler, omega = passage.at(math.inf if ends else self.time)
        b.fleet.move(torch.from_numpy(0.5 * frame * (self.before + v)).to(b.state.device))
        b.state[0, 0, QUATERNION] = torch_quaternion_from_euler(*torch.from_numpy(euler)).to(b.state)
        R = numpy_rotation_matrix(self._state()[QUATERNION])
        b.state[0, 0, VELOCITY] = torch.from_numpy(R.T @ v).to(b.state)
        b.state[0, 0, ANGULAR_VELOCITY] = torch.from_numpy(omega).to(b.state)
        if ends:
            self.passage, self.held = None, not passage.flies

    def _meet(self, down: float) -> None:
        """Let an aircraft in flight meet ground or water; it was `down` (m) before the frame."""
        s = self._state()
        if not self.flies_ahead and down <= self.origin[DOWN] < s[DOWN] and (abs(s[HORIZONTAL]) < GROUND).all():
            sinks, tilt = self._velocity()[DOWN], math.acos(min(numpy_rotation_matrix(s[QUATERNION])[2, 2], 1.0))
            crashes = sinks > HARD or tilt > STEEP
            self.ended = "crashed" if crashes else ""
            verb = "crashes" if crashes else "touches down"
            self.news.append(f"{verb} at {sinks:.2f} m/s, {math.degrees(tilt):.0f} deg from level")
            self._begin_passage(STOP, np.zeros(3), flies=False, level=not crashes)
        elif -s[DOWN] < self.crest + max(self.model.size) and self._meets_water():
            self.ended = "ditched"
            self.news.append("has ditched: it stays there; restart the autopilot to begin anew")
            self._begin_passage(STOP, np.zeros(3), flies=False)

    def _meets_water(self) -> bool:
        """Whether an aircraft touches the water, as its model judges it."""
        found = self.model.endings(self.bench.fleet, self)
        return any(bool(found[name].any()) for name in WET if name in found)

    def elevation_below(self, team: Fleet, height: Tensor) -> Tensor:
        """Elevation (m, up) of the sea under each vehicle of `team`: a craft is the `Waters` of its model's endings."""
        return self.bench.around.elevation(team.position_n[..., HORIZONTAL])

    # -- measuring -------------------------------------------------------------------------------------------------

    def _state(self) -> np.ndarray:
        return self.bench.state.cpu().numpy()[0, 0].astype(np.float64)

    def _velocity(self) -> np.ndarray:
        """Velocity over ground [3], NED, m/s."""
        s = self._state()
        return numpy_rotation_matrix(s[QUATERNION]) @ s[VELOCITY]

    def _wind(self) -> np.ndarray:
        """Velocity of the air that the vehicle feels [3], NED, m/s: for aircraft with turbulence and gusts."""
        if self.model.air is None:
            return self.bench.around.wind.cpu().numpy()[0].astype(np.float64)
        return self.bench.aux.cpu().numpy()[0, 0, self._air].astype(np.float64)

    def sensors(self) -> Sensors:
        """Measurements at the end of the last frame; the specific force is the mean over that frame."""
        s = self._state()
        R = numpy_rotation_matrix(s[QUATERNION])
        velocity = R @ s[VELOCITY]
        force = R.T @ ((velocity - self.before) * self.rate - np.array([0.0, 0.0, GRAVITY]))
        met = R.T @ (self._wind() - velocity)  # velocity of the air, b
        pitot = max(float(-met[0]), 0.0) if self.model.medium == "air" else None
        position = self.bench.position - self.origin
        return Sensors(
            self.time, _three(s[10:13]), _three(force), _three(position), _three(_euler(R)),
            (float(s[3]), float(s[4]), float(s[5]), float(s[6])), _three(velocity), pitot,
            math.atan2(-met[1], -met[0]), float(math.hypot(met[0], met[1])),
        )  # fmt: skip


def _euler(R: np.ndarray) -> np.ndarray:
    """Roll, pitch and heading [3], rad, of the attitude R_nb."""
    return np.array(
        (math.atan2(R[2, 1], R[2, 2]), -math.asin(min(max(R[2, 0], -1.0), 1.0)), math.atan2(R[1, 0], R[0, 0]))
    )


def _three(x: np.ndarray | Sequence[float]) -> tuple[float, float, float]:
    return float(x[0]), float(x[1]), float(x[2])
