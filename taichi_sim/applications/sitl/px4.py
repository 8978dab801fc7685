"""PX4 in the loop: a craft behind PX4's simulator interface, MAVLink messages over TCP (docs.px4.io, Simulation).

    to PX4      HIL_SENSOR every frame, HIL_STATE_QUATERNION (ground truth) and HIL_GPS more rarely, HEARTBEAT
    from PX4    HIL_ACTUATOR_CONTROLS

Lockstep: each HIL_SENSOR carries the simulated time. The craft waits for the controls that answer it, and then moves by
one frame. PX4 gives no controls until it has started: before the first ones, frames pass at real time under no outputs.
Controls are taken once; those of the same time again, or of an older one, change nothing. If no controls come for
RESEND seconds, the last HIL_SENSOR is sent again. A new connection is a restart: the craft is back at its place, at
rest.

Controls are -1 to 1, or 0 to 1 for throttles and rotors. They become the pulse widths of channels.py, which turns them
into actions. All are 0 while PX4 is disarmed.

Sensors have white noise, because PX4 takes a sensor that does not change for a broken one.
"""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from taichi_sim.applications.sitl.craft import HELD_HEIGHT, Counts, Craft, Pace, Servos
from taichi_sim.applications.sitl.driven import Sensors
from taichi_sim.errors import needs
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.rotation import numpy_rotation_matrix
from taichi_sim.visualisation.recording.east_north_up import FJORD, geodetic

PORT = 4560  # of PX4's first instance; the next ones follow
RATE = 250  # frames per second, those of PX4's inertial sensors
GPS_EVERY, TRUTH_EVERY, HEARTBEAT_EVERY = 25, 5, RATE  # frames
RESEND = 1.0  # s without an answer, after which the last frame is sent again
CONTROLS = 16
ORIGIN = FJORD  # where the world's origin lies
FIELD = np.array([0.134, 0.0115, 0.505])  # magnetic field there, NED, gauss; World Magnetic Model of 2025, to 1 %
NOISE = {"acceleration": 0.02, "gyro": 0.001, "field": 0.001, "pressure": 0.02}  # m/s^2, rad/s, gauss, hPa; assumed
P_0, T_0, LAPSE, EXPONENT = 1013.25, 288.15, 0.0065, 5.2559  # hPa, K, K/m, -: standard atmosphere (ISO 2533)
RHO_0, ZERO_CELSIUS = 1.225, 273.15  # kg/m^3, the same; K
SENSORS = 0x1FFF  # HIL_SENSOR.fields_updated: all
ARMED = 128  # HIL_ACTUATOR_CONTROLS.mode: MAV_MODE_FLAG_SAFETY_ARMED
VEHICLE_TYPES = {"water": 11, "air": 1}  # MAV_TYPE of a boat, of a fixed wing


def mavlink() -> Any:
    """The MAVLink 2 dialect `common` of pymavlink."""
    with needs("pymavlink", "px4"):
        from pymavlink.dialects.v20 import common
    return common


class Px4Session:
    """A craft and the PX4 that drives it."""

    def __init__(self, craft: Craft, seed: int = 0):
        """Start without a peer; `seed` is of the sensors' noise."""
        self.craft, self.counts, self.seed = craft, Counts(), seed
        self.seen: list[Callable[[Servos, Sensors], None]] = []  # called after each new frame
        self.last: Servos | None = None  # outputs of the last frame
        self.dialect = mavlink()
        self.pace = Pace()
        self._send: Callable[[bytes], None] | None = None
        self._begun = False
        self._due = self._silent = 0.0  # s, of the clock
        self._taken = 0  # time of the last controls, microseconds
        self._frame = b""
        self.driven = False  # whether controls have come over this connection

    @property
    def connected(self) -> bool:
        """Whether a PX4 is connected."""
        return self._send is not None

    def connect(self, send: Callable[[bytes], None]) -> None:
        """Begin with a new connection, to which `send` writes bytes."""
        if self._begun:
            self.counts.restarts += 1
        self._begun, self._send, self.driven = True, send, False
        self.link = self.dialect.MAVLink(None, srcSystem=1, srcComponent=200)
        self.link.robust_parsing = True
        self.random = np.random.default_rng(self.seed)
        self.craft.begin(RATE)
        self._advance(())
        self._due = time.monotonic() + 1 / RATE

    def disconnect(self) -> None:
        """The peer has gone."""
        self._send = None

    def tick(self) -> float:
        """Send what is due by the wall clock; return the seconds until something is due.

        Due are frames at real time until the first controls come, and the last frame again if no controls follow.
        """
        now = time.monotonic()
        if not self.connected:
            return RESEND
        if not self.driven:
            if now >= self._due:
                self.counts.waiting += 1
                self._advance(())
                self._due = max(self._due + 1 / RATE, now)
            return max(self._due - now, 0.0)
        if now - self._silent >= RESEND:
            self.counts.resent += 1
            self._write(self._frame)
            self._silent = now
        return RESEND - (now - self._silent)

    def state(self, seconds: float) -> str:
        """A status line: simulated time, its pace since the last line, frame counts, and the mean frame rate over the
        `seconds` since the start.
        """
        c, craft = self.counts, self.craft
        if not self.connected:
            return f"waiting for PX4{c.refusals()}"
        return (
            f"t {craft.time:.1f} s{self.pace(seconds, craft.time)}, "
            f"{c.frames} frames ({c.frames / seconds:.0f}/s), {c.waiting} before the "
            f"first controls, sent again {c.resent}, late {c.late}, restarts {c.restarts}{c.refusals()}"
        )

    def receive(self, data: bytes) -> None:
        """Take bytes of the connection, cut anywhere."""
        for message in self.link.parse_buffer(data) or ():
            kind = message.get_type()
            if kind == "HIL_ACTUATOR_CONTROLS":
                self._take(message)
            elif kind == "BAD_DATA":
                self.counts.refuse("bytes that are no MAVLink message")

    def _take(self, message: Any) -> None:
        if self.driven and message.time_usec <= self._taken:
            self.counts.late += 1
            return
        self.driven, self._taken = True, message.time_usec
        self.counts.frames += 1
        controls = message.controls if message.mode & ARMED else (math.nan,) * CONTROLS
        self._advance(self.pwm(controls))

    def pwm(self, controls: tuple[float, ...]) -> tuple[int, ...]:
        """Pulse widths [channel] (microseconds) of `controls`; 0, no output, for NaN."""
        mixer = self.craft.mixer
        middle, widths = 0.5 * (mixer.low + mixer.high), [0] * CONTROLS
        for name, channel in mixer.channels.items():
            x = controls[abs(channel) - 1] if abs(channel) <= CONTROLS else math.nan
            low = mixer.low if name in mixer.one_sided else middle
            if not math.isnan(x):
                widths[abs(channel) - 1] = max(round(low + x * (mixer.high - low)), 1)
        return tuple(widths)

    def _advance(self, pwm: tuple[int, ...]) -> None:
        """Move by one frame, and send it."""
        self.craft.advance(pwm)
        sensors = self.craft.sensors()
        self.last = Servos(RATE, self.craft.frames - 1, pwm or (0,) * CONTROLS)
        for seen in self.seen:
            seen(self.last, sensors)
        self._frame = b"".join(m.pack(self.link) for m in self.messages(sensors))
        self._write(self._frame)
        self._silent = time.monotonic()

    def _write(self, data: bytes) -> None:
        if self._send is not None:
            self._send(data)

    def messages(self, s: Sensors) -> list[Any]:
        """MAVLink messages of the present frame with the measurements `s`; HIL_SENSOR is the last one."""
        link, now, n = self.link, round(self.craft.frames * 1e6 / RATE), self.craft.frames
        R = numpy_rotation_matrix(np.array(s.quaternion))
        north, east, down = s.position
        above = -down + (HELD_HEIGHT if self.craft.model.medium == "air" else 0.0)
        place = geodetic(np.array([east, north, 0.0]), ORIGIN)
        lat, lon, alt = round(place[0] * 1e7), round(place[1] * 1e7), round(above * 1e3)
        cm = [round(100 * v) for v in s.velocity]
        speed, course = math.hypot(*s.velocity[:2]), math.degrees(math.atan2(s.velocity[1], s.velocity[0])) % 360.0
        air = s.airspeed or 0.0
        found = []
        if n % HEARTBEAT_EVERY == 1:
            found.append(link.heartbeat_encode(VEHICLE_TYPES[self.craft.model.medium], 8, 0, 0, 4))
        if n % GPS_EVERY == 1:
            found.append(link.hil_gps_encode(
                now, 3, lat, lon, alt, 30, 40, round(100 * speed), *cm, round(100 * course) % 36000, 12))  # fmt: skip
        if n % TRUTH_EVERY == 1:
            found.append(link.hil_state_quaternion_encode(
                now, s.quaternion, *s.gyro, lat, lon, alt, *cm, round(100 * air), round(100 * air),
                *(round(1e3 * a / GRAVITY) for a in s.accel_body)))  # fmt: skip
        a, w, m = (np.asarray(x) + NOISE[name] * self.random.standard_normal(3) for x, name in (
            (s.accel_body, "acceleration"), (s.gyro, "gyro"), (R.T @ FIELD, "field")))  # fmt: skip
        pressure = P_0 * (1 - LAPSE * above / T_0) ** EXPONENT + NOISE["pressure"] * self.random.standard_normal()
        height = T_0 / LAPSE * (1 - (pressure / P_0) ** (1 / EXPONENT))
        ram, celsius = 0.5 * RHO_0 * air**2 / 100, T_0 - LAPSE * above - ZERO_CELSIUS  # hPa, deg C
        found.append(link.hil_sensor_encode(now, *a, *w, *m, pressure, ram, height, celsius, SENSORS))
        return found
