"""What a vehicle that an autopilot drives does besides moving by its model: it is held, launched, meets ground and
water, and is measured.

A multirotor stands on a level ground where it begins, until its rotors lift it. A fixed-wing aircraft is held in the
attitude of its cruise until its throttle opens; a launcher then accelerates it to its cruising airspeed. The sea ends a
flight: the aircraft stays where it met the water.

Launch, touchdown and ditching are passages: velocity and attitude change at constant rates, which the IMU feels.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from taichi_sim.applications.sitl.channels import Mixer
from taichi_sim.fleet import Fleet, exact
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, DOWN, GRAVITY, HORIZONTAL, POSITION, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import numpy_rotation_matrix, torch_quaternion_from_euler
from taichi_sim.models.uav.fixed_wing.params import FixedWingParams
from taichi_sim.vehicle import Vehicle, Waters

GROUND = 50.0  # m, half of the side of the level square around the place where a multirotor begins; assumed
OPEN = 0.6  # throttle at which a held aircraft is launched
LAUNCH = 1.0  # s from rest to cruise: 25 m/s^2 for an Aerosonde; assumed
STOP = 0.1  # s from a touchdown, or from the water, to rest; assumed
SAME = 1e-9  # s between times that are one
HARD, STEEP = 3.0, math.radians(45.0)  # m/s, rad: a faster or steeper touchdown is a crash; assumed
WET = "ditched", "crashed"  # endings of aircraft in the water (`Vehicle.endings`)


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


class Moment(NamedTuple):
    """Motion of a vehicle at a time; SI."""

    time: float  # s
    position: np.ndarray  # NED, m
    quaternion: np.ndarray
    velocity: np.ndarray  # over ground, NED, m/s
    gyro: np.ndarray  # b, rad/s

    def toward(self, later: "Moment", time: float) -> "Moment":
        """The moment at `time` on the straight way from this one to a `later` one."""
        if abs(time - later.time) < SAME:
            return later._replace(time=time)
        share = (time - self.time) / (later.time - self.time)
        found = [a + share * (b - a) for a, b in zip(self[1:], later[1:], strict=True)]
        q = self.quaternion + share * (later.quaternion * np.sign(self.quaternion @ later.quaternion) - self.quaternion)
        return Moment(time, found[0], q / np.linalg.norm(q), *found[2:])


class Driven(ABC):
    """Vehicle `number` of environment `env` of a fleet; a derived class steps it.

    Around a step, a derived class calls `keep` and then `happen`. If the vehicle was held, it updates the fleet then.

    Attributes:
        rate: frame rate, Hz. frames: since the beginning.
        time: since the beginning, s. step: time between `keep` and `happen`, s.
        held: whether an aircraft does not fly: it stands, is launched, comes to rest, or has ended its flight.
        ended: how the flight has ended ("ditched", "crashed"), or "".
        ground: whether a multirotor may land where it began.
        news: what has happened to an aircraft, for whoever reads and clears it.
    """

    env = number = 0
    model: Vehicle
    mixer: Mixer
    channels: dict[str, int]
    crest: float  # m, no wave is higher
    rate: int
    step: float

    def __init__(self) -> None:
        """Hold nothing yet."""
        self.frames, self.time, self.held, self.ended, self.ground = 0, 0.0, False, "", False
        self.news: list[str] = []
        self.passage: Passage | None = None
        self.before = self.origin = np.zeros(3)
        self._views: tuple[Tensor, ...] | None = None  # the fleet's state, and this vehicle's state, remainder and aux
        self._kept: tuple[Tensor, Tensor] | None = None
        self._down = 0.0

    # -- what a derived class gives --------------------------------------------------------------------------------

    @property
    @abstractmethod
    def fleet(self) -> Fleet[Vehicle]:
        """The fleet."""

    @property
    @abstractmethod
    def waters(self) -> Waters:
        """What the model's endings ask."""

    @abstractmethod
    def settled(self, state: Tensor) -> Tensor:
        """`Vehicle.settle` of this vehicle's `state` [1, 1, 13]."""

    @property
    @abstractmethod
    def steady_wind(self) -> Tensor:
        """Velocity of the air that a vessel feels [3], NED, m/s."""

    @abstractmethod
    def begin(self, rate: int) -> None:
        """Place the vehicle at its beginning, for frames of `rate` Hz."""

    @abstractmethod
    def change_rate(self, rate: int) -> None:
        """Continue with frames of another rate, Hz; motion and time stay."""

    @abstractmethod
    def advance(self, pwm: tuple[int, ...]) -> None:
        """Advance by one frame under the servo outputs `pwm` (microseconds), at once or as soon as it can be done."""

    @abstractmethod
    def sensors(self) -> Sensors:
        """Measurements at the end of the last frame; the specific force is the mean over that frame."""

    @property
    def ready(self) -> bool:
        """Whether all frames that were asked for are over."""
        return True

    @property
    def flown(self) -> bool:
        """Whether it is an aircraft in flight."""
        return self.model.medium == "air" and not self.held

    # -- beginning -------------------------------------------------------------------------------------------------

    @property
    def flies_ahead(self) -> bool:
        """Whether it is an aircraft that cannot stop, which a launcher holds."""
        return isinstance(self.model.params, FixedWingParams)

    def _begun(self, *, held: bool) -> None:
        """Begin where the state says; an aircraft that is `held` stands still, with its rotors."""
        if held and self.flies_ahead:
            self._row[VELOCITY] = self._row[ANGULAR_VELOCITY] = 0.0
            self.fleet.update()
        if self.model.medium == "air":
            for name in self.model.control_names:
                if name in self.model.aux_names:
                    self.fleet.reading(name)[self.env, self.number] = 0.0
        self.fleet.action[self.env, self.number] = 0.0
        self.frames, self.time, self.held, self.ended, self.passage = 0, 0.0, held, "", None
        self.ground = held and not self.flies_ahead
        self.before = self._velocity()

    # -- a step ----------------------------------------------------------------------------------------------------

    def keep(self) -> None:
        """Remember what a step is about to change."""
        self.before, self._down = self._velocity(), self._state()[DOWN]
        self._kept = (self._row.clone(), self._view(1).clone()) if self.held else None

    def happen(self, pwm: tuple[int, ...], *, wet: bool = True) -> None:
        """Let a vehicle that has moved by a step, under `pwm`, be held, or meet ground and, if asked for, water."""
        self.time += self.step
        if self._kept is not None:
            self._hold(self._kept, pwm)
        elif self.model.medium == "air":
            self._meet(wet)

    def _hold(self, kept: tuple[Tensor, Tensor], pwm: tuple[int, ...]) -> None:
        """Put an aircraft back to where it was before the step, or to where its passage leads it, or release it.

        A multirotor is released when its rotors lift it: the step has given it a velocity upwards, from rest. A fixed
        wing is launched when its throttle opens.
        """
        if self.passage is None and not (self.flies_ahead or self.ended) and self._velocity()[DOWN] < 0.0:
            self.held = False
            self.news.append("lifts off")
            return
        self._row.copy_(kept[0])
        self._view(1).copy_(kept[1])
        if self.passage is not None:
            self._pass(self.passage)
        elif self.flies_ahead and not self.ended and self.mixer.share("throttle", pwm) >= OPEN:
            cruise = self.settled(self._row.clone().view(1, 1, -1))[0, 0, VELOCITY].double().cpu().numpy()
            self._begin_passage(LAUNCH, numpy_rotation_matrix(self._state()[QUATERNION]) @ cruise, flies=True)
            self.news.append("is launched")

    def _begin_passage(self, seconds: float, velocity: np.ndarray, *, flies: bool, level: bool = False) -> None:
        """Begin to change to a `velocity` (n, m/s) and, if asked for, to a level attitude."""
        euler = _euler(numpy_rotation_matrix(self._state()[QUATERNION]))
        to = np.array([0.0, 0.0, euler[2]]) if level else euler
        self.passage, self.held = Passage(self.time, seconds, (self._velocity(), velocity), (euler, to), flies), True

    def _pass(self, passage: Passage) -> None:
        """Move by one step of a passage; end it when its time has passed."""
        row, fleet = self._row, self.fleet
        ends = self.time - passage.begun > passage.seconds - 0.5 * self.step
        v, euler, omega = passage.at(math.inf if ends else self.time)
        way = torch.zeros_like(fleet.position_exact)
        way[self.env, self.number] = torch.from_numpy(0.5 * self.step * (self.before + v))
        fleet.move(way)
        row[QUATERNION] = torch_quaternion_from_euler(*torch.from_numpy(euler)).to(row)
        R = numpy_rotation_matrix(self._state()[QUATERNION])
        row[VELOCITY] = torch.from_numpy(R.T @ v).to(row)
        row[ANGULAR_VELOCITY] = torch.from_numpy(omega).to(row)
        if ends:
            self.passage, self.held = None, not passage.flies

    def _meet(self, wet: bool) -> None:
        """Let an aircraft in flight meet ground or water."""
        s = self._state()
        over = self.ground and (abs(s[HORIZONTAL] - self.origin[HORIZONTAL]) < GROUND).all()
        if over and self._down <= self.origin[DOWN] < s[DOWN]:
            sinks, tilt = self._velocity()[DOWN], math.acos(min(numpy_rotation_matrix(s[QUATERNION])[2, 2], 1.0))
            crashes = sinks > HARD or tilt > STEEP
            self.ended = "crashed" if crashes else ""
            verb = "crashes" if crashes else "touches down"
            self.news.append(f"{verb} at {sinks:.2f} m/s, {math.degrees(tilt):.0f} deg from level")
            self._begin_passage(STOP, np.zeros(3), flies=False, level=not crashes)
        elif wet and -s[DOWN] < self.crest + max(self.model.size) and self.meets_water():
            self.ended = "ditched"
            self.news.append("has ditched: it stays there; restart the autopilot to begin anew")
            self._begin_passage(STOP, np.zeros(3), flies=False)

    def meets_water(self) -> bool:
        """Whether an aircraft touches the water, as its model judges it."""
        found = self.model.endings(self.fleet, self.waters)
        return any(bool(found[name][self.env, self.number]) for name in WET if name in found)

    # -- measuring -------------------------------------------------------------------------------------------------

    def _view(self, which: int) -> Tensor:
        """State (0), remainder (1) or aux (2) of the vehicle, which share memory with the fleet's."""
        fleet = self.fleet
        if self._views is None or self._views[0] is not fleet.state:
            mine = (x[self.env, self.number] for x in (fleet.state, fleet.remainder, fleet.aux))
            self._views = fleet.state, *mine
        return self._views[1 + which]

    @property
    def _row(self) -> Tensor:
        return self._view(0)

    def _read(self, which: int) -> np.ndarray:
        return self._view(which).cpu().numpy().astype(np.float64)

    def _state(self) -> np.ndarray:
        return self._read(0)

    def _velocity(self) -> np.ndarray:
        """Velocity over ground [3], NED, m/s."""
        s = self._state()
        return numpy_rotation_matrix(s[QUATERNION]) @ s[VELOCITY]

    def _wind(self) -> np.ndarray:
        """Velocity of the air that the vehicle feels [3], NED, m/s: for aircraft with turbulence and gusts."""
        if self.model.air is None:
            return self.steady_wind.cpu().numpy().astype(np.float64)
        columns = [self.model.aux_names.index(name) for name in self.model.air]
        return self._read(2)[columns]

    def moment(self) -> Moment:
        """The vehicle now."""
        s, place = self._state(), exact(self._row[POSITION], self._view(1)).cpu().numpy()
        v = numpy_rotation_matrix(s[QUATERNION]) @ s[VELOCITY]
        return Moment(self.time, place, s[QUATERNION], v, s[ANGULAR_VELOCITY])

    def measured(self, now: Moment, before: np.ndarray, length: float, origin: np.ndarray) -> Sensors:
        """Measurements at the moment `now`, the end of a frame of `length` (s) that began with the velocity `before`
        (NED, m/s); positions are from `origin` (NED, m).
        """
        R = numpy_rotation_matrix(now.quaternion)
        force = R.T @ ((now.velocity - before) / length - np.array([0.0, 0.0, GRAVITY]))
        met = R.T @ (self._wind() - now.velocity)  # velocity of the air, b
        pitot = max(float(-met[0]), 0.0) if self.model.medium == "air" else None
        w, x, y, z = map(float, now.quaternion)
        return Sensors(
            now.time, _three(now.gyro), _three(force), _three(now.position - origin), _three(_euler(R)), (w, x, y, z),
            _three(now.velocity), pitot, math.atan2(-met[1], -met[0]), float(math.hypot(met[0], met[1])),
        )  # fmt: skip


def _euler(R: np.ndarray) -> np.ndarray:
    """Roll, pitch and heading [3], rad, of the attitude R_nb."""
    return np.array(
        (math.atan2(R[2, 1], R[2, 2]), -math.asin(min(max(R[2, 0], -1.0), 1.0)), math.atan2(R[1, 0], R[0, 0]))
    )


def _three(x: np.ndarray | Sequence[float]) -> tuple[float, float, float]:
    return float(x[0]), float(x[1]), float(x[2])
