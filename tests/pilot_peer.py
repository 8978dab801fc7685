"""Plays ArduPilot's side of MAVLink, for companions: vehicles of ours, each with a small autopilot.

It has the documented behaviour of ArduPilot's Rover (GCS_MAVLink_Rover.cpp, mode.cpp, mode_guided.cpp, GCS_Common.cpp):
a HEARTBEAT a second; ATTITUDE and GLOBAL_POSITION_INT at the interval that SET_MESSAGE_INTERVAL asks for; a mode that
DO_SET_MODE asks for, unless it refuses; velocities are obeyed in GUIDED alone, and forgotten after 3 s; MANUAL_CONTROL
overrides the sticks, from the ground station alone, for 3 s. Of a Copter, it has velocities and WIND. Its control loops
are ours, not ArduPilot's.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as kinds
from sitl_peer import Clock

from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, SeaConfig
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.visualisation.recording.east_north_up import FJORD, geodetic

MANUAL, HOLD, GUIDED = 0, 4, 15
FRAME, SUBSTEPS = 0.05, 1  # s; physics steps of a frame
TIMEOUT = 3.0  # s: GUID_TIMEOUT, RC_OVERRIDE_TIME
NO_AXIS = 0x7FFF
PARAMETERS = {
    "RCMAP_ROLL": 1.0, "RCMAP_THROTTLE": 3.0, "RC1_DZ": 0.0, "RC3_DZ": 0.0, "PILOT_STEER_TYPE": 3.0,
    "MANUAL_STR_EXPO": 0.0, "MOT_SLEWRATE": 0.0, "MOT_THST_EXPO": 0.0,
}  # fmt: skip


class Autopilot:
    """The autopilot of one boat.

    Attributes:
        mode, armed, kind, autopilot: of its HEARTBEAT. refuses: modes that it does not take. parameters: those it has.
        wind: where it blows from (deg), and how fast (m/s). silent: whether it says nothing. frozen: whether its place
            and attitude, and their clock, stay as they are.
        heard: messages it has received, by kind.
    """

    SPEED, DRAG = (0.5, 0.15), 0.57  # 1/(m/s), 1/m; (m/s)^-1/2: the share of the shafts that holds a speed
    HEADING, RATE, MOST = 0.8, (0.6, 1.0), 0.5  # 1/s; s: forward, back; rad/s

    def __init__(self, system: int = 1, mode: int = HOLD):
        self.system, self.mode, self.armed, self.kind, self.autopilot = system, mode, False, 11, 3
        self.parameters, self.refuses = dict(PARAMETERS), ()
        self.silent = self.frozen = False
        self.wind = 0.0, 0.0
        self.heard: dict[str, list] = {}
        self._link = kinds.MAVLink(None, srcSystem=system, srcComponent=1)
        self._link.robust_parsing = True
        self._answers: list[bytes] = []
        self._intervals: dict[int, float] = {}
        self._due: dict[int, float] = {}
        self._wanted: tuple[float, float, float] | None = None  # heading (rad), speed (m/s), when
        self._sticks: tuple[float, float, float] | None = None  # steering, throttle, when
        self._sum = 0.0

    def hear(self, data: bytes, now: float) -> None:
        for m in self._link.parse_buffer(data) or ():
            self.heard.setdefault(m.get_type(), []).append(m)
            take = getattr(self, f"_{m.get_type().lower()}", None)
            if take is not None:
                take(m, now)

    def _command_long(self, m, now: float) -> None:
        result = 0
        if m.command == 511:
            self._intervals[round(m.param1)] = 1e-6 * m.param2
        elif m.command == 176:
            result = 4 if round(m.param2) in self.refuses else 0
            self.mode = self.mode if result else round(m.param2)
        self._answer("command_ack", m.command, result)

    def _param_request_read(self, m, now: float) -> None:
        if m.param_id in self.parameters:
            self._answer("param_value", m.param_id.encode(), self.parameters[m.param_id], 9, 1, 0)

    def _set_position_target_local_ned(self, m, now: float) -> None:
        if self.mode == GUIDED:
            heading = math.atan2(m.vy, m.vx) if m.type_mask & 1024 else m.yaw
            self._wanted = heading, math.hypot(m.vx, m.vy), now

    def _manual_control(self, m, now: float) -> None:
        if m.get_srcSystem() == 255 and m.target == self.system:
            self._sticks = None if m.z == NO_AXIS else (1e-3 * m.y, 1e-3 * m.z, now)

    def _answer(self, kind: str, *values) -> None:
        self._answers.append(getattr(self._link, f"{kind}_encode")(*values).pack(self._link))

    def says(self, now: float, place: np.ndarray, velocity: np.ndarray, euler: np.ndarray, rates: np.ndarray) -> bytes:
        """What it sends now: of its boat's place (NED of the fjord, m), velocity, Euler angles and rates."""
        clock = round(1e3 * now) + 5000
        if self._is_due(0, now, 1.0):
            self._answer("heartbeat", self.kind, self.autopilot, 1 + 128 * self.armed, self.mode, 4)
        if 30 in self._intervals and self._is_due(30, now, self._intervals[30]):
            self._answer("attitude", 5000 if self.frozen else clock, *euler, *rates)
        if 33 in self._intervals and self._is_due(33, now, self._intervals[33]):
            lat, lon, _ = geodetic(np.array([place[1], place[0], 0.0]), FJORD)
            high, speed = round(-1e3 * place[2]), (round(100 * v) for v in velocity)
            at = round(lat * 1e7), round(lon * 1e7), high, high
            self._answer("global_position_int", 5000 if self.frozen else clock, *at, *speed, 0)
        if 168 in self._intervals and self._is_due(168, now, self._intervals[168]):
            self._answer("wind", *self.wind, 0.0)
        said, self._answers = b"".join(self._answers), []
        return b"" if self.silent else said

    def _is_due(self, kind: int, now: float, every: float) -> bool:
        due = now >= self._due.get(kind, 0.0) - 1e-9
        if due:
            self._due[kind] = now + every
        return due

    def acts(self, now: float, velocity: np.ndarray, euler: np.ndarray, rates: np.ndarray) -> tuple[float, ...]:
        """Actions of its vehicle: shares of its propellers' greatest speeds, left and right, in [-1, 1]."""
        throttle = steering = 0.0
        if self.armed and self.mode == MANUAL and self._sticks and now - self._sticks[2] < TIMEOUT:
            steering, throttle, _ = self._sticks
        elif self.armed and self.mode == GUIDED and self._wanted and now - self._wanted[2] < TIMEOUT:
            heading, speed, _ = self._wanted
            off = (heading - euler[2] + math.pi) % (2 * math.pi) - math.pi
            rate = min(max(self.HEADING * off, -self.MOST), self.MOST)
            steering = self.RATE[0] * rate + self.RATE[1] * (rate - rates[2])
            slow = speed - (math.cos(euler[2]) * velocity[0] + math.sin(euler[2]) * velocity[1])
            self._sum = min(max(self._sum + self.SPEED[1] * slow * FRAME, -0.5), 0.5)
            throttle = self.DRAG * math.sqrt(speed) + self.SPEED[0] * slow + self._sum
        throttle, steering = min(max(throttle, -1.0), 1.0), min(max(steering, -1.0), 1.0)
        if abs(throttle) + abs(steering) > 1.0:  # steering has priority
            throttle = math.copysign(1.0 - abs(steering), throttle)
        return throttle + steering, throttle - steering


class Copter(Autopilot):
    """The autopilot of a multirotor: velocities ahead, to starboard and down of its heading, in GUIDED (4) alone.

    Its inner loops are those of the vehicle file, whose actions are such velocities.
    """

    def __init__(self, system: int = 1, mode: int = 5):
        super().__init__(system, mode)
        self.kind, self._kept = 2, None

    def _set_position_target_local_ned(self, m, now: float) -> None:
        if self.mode == 4 and (m.type_mask, m.coordinate_frame) == (0b010111000111, 9):
            self._kept = np.array((m.vx, m.vy, m.vz, m.yaw_rate)), now

    def acts(self, now: float, velocity: np.ndarray, euler: np.ndarray, rates: np.ndarray) -> tuple[float, ...]:
        if not (self.armed and self.mode == 4 and self._kept and now - self._kept[1] < TIMEOUT):
            return (0.0,) * 4
        ahead, right, down, turn = self._kept[0]
        vertical = self.control.descent if down > 0 else self.control.climb
        return ahead / self.control.speed, right / self.control.speed, down / vertical, turn / math.radians(
            self.control.yaw_rate_deg)  # fmt: skip


class Flotilla:
    """Vehicles with their autopilots, and the wires to a companion, in simulated time.

    Attributes:
        clock: the time, s. autopilots: of the vehicles. receivers: what takes the bytes of each, and when they come.
    """

    def __init__(
        self, count: int, sea: SeaConfig | None = None, *, air: AirConfig | None = None, vehicle: str = "otter",
        autopilot: type[Autopilot] = Autopilot, **changes,
    ):  # fmt: skip
        """Vehicles without a place yet: by default Otters in calm water, with what compiles quickly."""
        if vehicle == "otter":
            quick = {"actions": "left_right", "restoring": "linear", "hydrodynamics": {"radiation": "constant"}}
            changes = quick | changes
        self.kind, self.model = autopilot, load_vehicle(vehicle, FRAME / SUBSTEPS, SUBSTEPS, **changes)
        self.bench = Bench(self.model, sea=sea, air=air, envs=count, seed=3)

    def begin(self, starts: Sequence[tuple[float, ...]], mode: int = HOLD, *, armed: bool = True) -> None:
        """Put vehicles at rest at `starts`: north, east (m), heading (rad), and the height (m) of those that fly; with
        new autopilots, armed, in a mode.
        """
        self.clock = Clock()
        self.autopilots = [self.kind(k + 1, mode) for k in range(len(starts))]
        for autopilot in self.autopilots:
            autopilot.armed, autopilot.control = armed, getattr(self.model.params, "control", None)
        at, zero = np.array(starts), np.zeros(len(starts))
        down = -at[:, 3] if at.shape[1] > 3 else zero
        place, euler = np.column_stack((at[:, :2], down)), np.column_stack((zero, zero, at[:, 2]))
        self.bench.time.zero_()
        self.bench.put(place[:, None], euler[:, None], settle=True)
        self.receivers: list[Callable[[bytes, float], None]] = []
        self._inbox: list[tuple[int, bytes]] = []

    def sender(self, k: int) -> Callable[[bytes], None]:
        """What a companion's link to boat k sends by."""
        return lambda data: self._inbox.append((k, data))

    def motion(self) -> list[tuple[np.ndarray, ...]]:
        """Place, velocity (NED), Euler angles, rates of each boat."""
        fleet = self.bench.fleet
        parts = (fleet.position_n, fleet.velocity_n, fleet.euler, fleet.angular_velocity_b)
        return list(zip(*(x[:, 0].double().cpu().numpy() for x in parts), strict=True))

    def step(self) -> None:
        """One frame: what was sent arrives, boats move, autopilots say what is due."""
        inbox, self._inbox = self._inbox, []
        now = self.clock.now
        for k, data in inbox:
            if not self.autopilots[k].silent:
                self.autopilots[k].hear(data, now)
        moved = self.motion()
        actions = [a.acts(now, *m[1:]) for a, m in zip(self.autopilots, moved, strict=True)]
        self.bench.step(np.array(actions)[:, None])
        self.clock.now = now = now + FRAME
        for autopilot, receive, m in zip(self.autopilots, self.receivers, self.motion(), strict=True):
            if data := autopilot.says(now, *m):
                receive(data, now)
