"""One autopilot behind one MAVLink connection: what it has said, how old that is, and what is sent to it.

A link keeps to one system: the one that it is told, or the first autopilot (component 1) whose HEARTBEAT arrives. It
asks for the messages that it needs, and reads parameters; it never writes one.

A message counts as new if the autopilot's own clock in it has advanced: one that is repeated grows old like one that is
lost. It was sent when that clock says so, reckoned by the message that has come quickest so far: one that has waited in
a radio is as old as it is. A simulated autopilot tells `SIM_SPEEDUP` and has no radio: what it says was sent when it
arrived, however slow the simulation. Places that are 0, 0 (no fix) and numbers that are not finite are ignored.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from rl.adapters.pilot.clock import Pace
from taichi_sim.errors import needs

AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
STATION, COMPANION = (255, 190), (0, 191)  # system and component of a ground station; of a companion, 0: the vehicle's
ARMED, CUSTOM_MODE = 128, 1  # MAV_MODE_FLAG_SAFETY_ARMED, MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
ATTITUDE, POSITION = 30, 33  # ids of ATTITUDE, GLOBAL_POSITION_INT
WIND = 168  # id of WIND, of ArduPilot's dialect
SET_MODE, ARM, SET_INTERVAL = 176, 400, 511  # MAV_CMD_DO_SET_MODE, _COMPONENT_ARM_DISARM, _SET_MESSAGE_INTERVAL
FORCED = 21196  # second parameter of ARM: ArduCopter's land detector waits for a ground at rest
REBOOT = 1000  # ms; a clock that falls by more has started anew
EVERY = 1.0  # s between heartbeats, and between requests that are not answered
NEVER = -math.inf  # s, of the clock
DRIFT = 1e-4  # of the autopilot's clock, at the most; assumed
SIMULATED = "SIM_SPEEDUP"  # a parameter that simulated autopilots alone have


def dialect() -> Any:
    """The MAVLink 2 dialect of ArduPilot."""
    with needs("pymavlink", "ardupilot"):
        from pymavlink.dialects.v20 import ardupilotmega
    return ardupilotmega


class Heart(NamedTuple):
    """The last HEARTBEAT."""

    kind: int  # MAV_TYPE
    autopilot: int  # MAV_AUTOPILOT
    mode: int  # custom_mode
    armed: bool


class Fix(NamedTuple):
    """The last GLOBAL_POSITION_INT."""

    latitude: float  # deg
    longitude: float  # deg
    height: float  # above home, m
    altitude: float  # above mean sea level, m
    velocity: tuple[float, float, float]  # over ground, NED, m/s


class Attitude(NamedTuple):
    """The last ATTITUDE."""

    euler: tuple[float, float, float]  # roll, pitch, heading, rad
    rates: tuple[float, float, float]  # b, rad/s


class Link:
    """One autopilot.

    Attributes:
        name: of the vehicle, for messages. heart, place, attitude: what it has said last; None: nothing yet. wind: of
            the last WIND, velocity of the air, NED, m/s; NaN: nothing yet.
        placed, turned, blown: when the newest place, attitude and wind were sent; heard: when anything arrived, s.
        clock: the newest time that it has told, of its own clock, s; pace: how fast that runs against ours.
        parameters: name -> value, as it has told them. refused: number of a command -> MAV_RESULT.
        other: another system on this connection whose autopilot has been heard; 0: there is none, or one was named.
    """

    def __init__(
        self, name: str, send: Callable[[bytes], None], *, station: bool = False, system: int = 0, airy: bool = False
    ):
        """Send by `send`, as a companion of the vehicle's own system, or as its ground `station`.

        `system` is the one to hear; 0: the first. `airy`: wind is needed, too.
        """
        self.name, self._send, self._kinds = name, send, dialect()
        self._station, self._named, self._airy, self.system, self.other = station, system, airy, 0, 0
        self._reader = self._kinds.MAVLink(None)
        self._reader.robust_parsing = True
        self._writer = self._kinds.MAVLink(None, *(STATION if station else COMPANION))
        self.heart: Heart | None = None
        self.place: Fix | None = None
        self.attitude: Attitude | None = None
        self.wind = math.nan, math.nan, math.nan
        self.placed = self.turned = self.blown = self.heard = NEVER
        self._clocks: dict[str, int] = {}  # kind of message -> the autopilot's clock, ms
        self.clock, self.pace = NEVER, Pace()
        self._ahead, self._at = math.inf, NEVER  # our clock over its, by the quickest message, s; as of when
        self.parameters: dict[str, float] = {}
        self.refused: dict[int, int] = {}
        self._beaten = self._asked = NEVER

    # -- hearing ---------------------------------------------------------------------------------------------------

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes that arrived at `now` (s), cut anywhere."""
        for message in self._reader.parse_buffer(data) or ():
            kind, system = message.get_type(), message.get_srcSystem()
            if kind == "BAD_DATA" or message.get_srcComponent() != AUTOPILOT or self._named not in (0, system):
                continue
            if kind == "HEARTBEAT" and not self.system:
                self.system = system
                if not self._station:
                    self._writer.srcSystem = system
            if system != self.system:
                self.other = system if kind == "HEARTBEAT" and self.system else self.other
                continue
            self.heard = now
            take = getattr(self, f"_{kind.lower()}", None)
            if take is not None:
                take(message, now)

    def _heartbeat(self, m: Any, now: float) -> None:
        self.heart = Heart(m.type, m.autopilot, m.custom_mode, bool(m.base_mode & ARMED))

    def _global_position_int(self, m: Any, now: float) -> None:
        sent = self._sent(m, now) if m.lat or m.lon else None
        if sent is not None:
            velocity = (0.01 * m.vx, 0.01 * m.vy, 0.01 * m.vz)
            self.place = Fix(1e-7 * m.lat, 1e-7 * m.lon, 1e-3 * m.relative_alt, 1e-3 * m.alt, velocity)
            self.placed = sent

    def _attitude(self, m: Any, now: float) -> None:
        euler, rates = (m.roll, m.pitch, m.yaw), (m.rollspeed, m.pitchspeed, m.yawspeed)
        sent = self._sent(m, now) if all(map(math.isfinite, (*euler, *rates))) else None
        if sent is not None:
            self.attitude, self.turned = Attitude(euler, rates), sent

    def _wind(self, m: Any, now: float) -> None:
        if all(map(math.isfinite, (m.direction, m.speed, m.speed_z))):
            blows = math.radians(m.direction)  # from there
            self.wind = -m.speed * math.cos(blows), -m.speed * math.sin(blows), m.speed_z
            self.blown = now

    def _param_value(self, m: Any, now: float) -> None:
        self.parameters[m.param_id] = m.param_value

    def _command_ack(self, m: Any, now: float) -> None:
        if m.result not in (0, 5):  # MAV_RESULT_ACCEPTED, MAV_RESULT_IN_PROGRESS
            self.refused[m.command] = m.result

    def _sent(self, m: Any, now: float) -> float | None:
        """When a message was sent, s; None unless the autopilot's clock has advanced since the last of its kind, or has
        started anew.
        """
        kind, clock = m.get_type(), m.time_boot_ms
        last = self._clocks.get(kind, -1)
        if last - REBOOT <= clock <= last:
            return None
        if clock < last:
            self._clocks, self._ahead = {}, math.inf
        self._clocks[kind] = clock
        self.clock = 1e-3 * clock
        self.pace(now, self.clock)
        ahead = now - self.clock
        drift = 1.0 if self.simulated else DRIFT
        self._ahead = ahead if ahead < self._ahead else min(ahead, self._ahead + drift * (now - self._at))
        self._at = now
        return self.clock + self._ahead

    @property
    def simulated(self) -> bool:
        """Whether it is known to be a simulated autopilot."""
        return SIMULATED in self.parameters

    def age(self, now: float) -> float:
        """How long ago the oldest one of place, attitude and, if needed, wind was sent, s; infinite without one."""
        return now - min(self.placed, self.turned, self.blown if self._airy else now)

    @property
    def missing(self) -> str:
        """The message that is the oldest one now."""
        times = {"GLOBAL_POSITION_INT": self.placed, "ATTITUDE": self.turned}
        times |= {"WIND": self.blown} if self._airy else {}
        return min(times, key=lambda kind: times[kind])

    @property
    def last(self) -> tuple[Fix, Attitude]:
        """Fix and attitude of a vehicle that has told them."""
        assert self.place is not None and self.attitude is not None, "a vehicle that has told nothing"
        return self.place, self.attitude

    # -- saying ----------------------------------------------------------------------------------------------------

    def say(self, kind: str, *values: Any) -> None:
        """Send a message, by its name in lower case and its fields."""
        self._send(getattr(self._writer, f"{kind}_encode")(*values).pack(self._writer))

    def converse(self, now: float, interval: float, parameters: Iterable[str] = ()) -> None:
        """Send a heartbeat every second. Ask for what it must tell every `interval` (s) while that is missing, and for
        `parameters` that are not known.
        """
        if now - self._beaten >= EVERY:
            self._beaten = now
            kind = self._kinds.MAV_TYPE_GCS if self._station else self._kinds.MAV_TYPE_ONBOARD_CONTROLLER
            self.say("heartbeat", kind, self._kinds.MAV_AUTOPILOT_INVALID, 0, 0, self._kinds.MAV_STATE_ACTIVE)
        if not self.system or now - self._asked < EVERY:
            return
        missing = [name for name in parameters if name not in self.parameters]
        if missing or self.age(now) > EVERY or self._asked == NEVER:
            self._asked = now
            for message in (ATTITUDE, POSITION, *((WIND,) if self._airy else ())):
                self.command(SET_INTERVAL, message, round(1e6 * interval))
            for name in (*missing, *(() if self.simulated else (SIMULATED,))):
                self.say("param_request_read", self.system, AUTOPILOT, name.encode(), -1)

    def command(self, number: int, first: float, second: float) -> None:
        """Send a COMMAND_LONG with two parameters."""
        self.refused.pop(number, None)
        self.say("command_long", self.system, AUTOPILOT, number, 0, first, second, 0, 0, 0, 0, 0)

    def disarm(self) -> None:
        """Stop the motors, by force: on a deck that moves, nothing else does."""
        self.command(ARM, 0, FORCED)

    def set_mode(self, mode: int) -> None:
        """Ask for a mode, by ArduPilot's number."""
        self.command(SET_MODE, CUSTOM_MODE, mode)
