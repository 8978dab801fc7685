"""ArduPilot in the loop: packets of its JSON interface, and the conversation with one autopilot.

Packets are those of ArduPilot (libraries/SITL/examples/JSON/readme.md). From ArduPilot, binary, little-endian: magic
(uint16), frame_rate (uint16, Hz), frame_count (uint32), pulse widths of 16 or 32 servos (uint16, microseconds). To
ArduPilot, a line of JSON: time, IMU, position, attitude, velocity.

Lockstep: ArduPilot sends frame k and waits. It receives an answer once the vehicle has advanced by one frame. It takes
one answer a frame, so a second one would leave it a frame behind for good. After a second without an answer it sends
the frame again. Such a copy that was sent before the answer arrived gets none; one that comes CROSSED after it says
that the answer was lost, and gets the same one. A jump ahead means that frames were lost: the vehicle advances by as
many frames, the lost ones under the last known outputs. Frame 0 after other frames is a restart. Any other older frame
came late, and gets no answer.
"""

import json
import math
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from ipaddress import ip_address
from typing import Any, Generic, TypeVar

from taichi_sim.applications.sitl.craft import Counts, Pace, Servos
from taichi_sim.applications.sitl.driven import Driven, Sensors

MAGIC = {18458: 16, 29569: 32}  # magic -> servo channels
FIRST_RATE = 1200  # Hz, with which ArduPilot starts
LOWEST = 1  # lowest frame rate, Hz
LONGEST_GAP = 2.0  # s; after a longer gap the lost frames are skipped
CROSSED = 0.5  # s, of the clock; a copy that comes sooner after the answer crossed it: ArduPilot waits for 1 s
ALIVE = 2.5  # s, of the clock, without a packet, after which another autopilot may take over
AT_REST = 10.0  # s since its start; ArduPilot does not arm before, so its outputs are at rest
LARGEST = 65536  # bytes of the largest packet
AT_ONCE = 256  # most packets that are read at once
Address = tuple[str, int]
D = TypeVar("D", bound=Driven)


class PacketError(ValueError):
    """Data that are no valid packet; the message says why."""


def parse(data: bytes) -> Servos:
    """Decode a packet with 16 or 32 channels."""
    if len(data) < 2:
        raise PacketError(f"{len(data)} bytes are no packet")
    magic = int.from_bytes(data[:2], "little")
    channels = MAGIC.get(magic)
    if channels is None:
        allowed = " and ".join(f"{m} ({n} channels)" for m, n in MAGIC.items())
        raise PacketError(f"magic {magic}: allowed are {allowed}")
    size = 8 + 2 * channels
    if len(data) != size:
        raise PacketError(f"{len(data)} bytes of {size}: a packet of {channels} channels cut short, or too long")
    _, rate, frame, *pwm = struct.unpack(f"<HHI{channels}H", data)
    if rate < LOWEST:
        raise PacketError(f"frame_rate {rate} Hz: allowed are {LOWEST} Hz and more")
    return Servos(rate, frame, tuple(pwm))


def pack(servos: Servos) -> bytes:
    """Encode a packet, for peers that play ArduPilot."""
    magic = {n: m for m, n in MAGIC.items()}[len(servos.pwm)]
    return struct.pack(f"<HHI{len(servos.pwm)}H", magic, servos.rate, servos.frame, *servos.pwm)


def encode(sensors: Sensors) -> bytes:
    """Encode the answer: JSON between line feeds, as ArduPilot's parser expects."""
    data = {
        "timestamp": sensors.timestamp,
        "imu": {"gyro": sensors.gyro, "accel_body": sensors.accel_body},
        "position": sensors.position,
        "attitude": sensors.attitude,
        "quaternion": sensors.quaternion,
        "velocity": sensors.velocity,
    }
    if sensors.airspeed is not None:
        data["airspeed"] = sensors.airspeed
    if sensors.wind_direction is not None and sensors.wind_speed is not None:
        data["windvane"] = {"direction": sensors.wind_direction, "speed": sensors.wind_speed}
    return b"\n" + json.dumps(data, separators=(",", ":")).encode() + b"\n"


class Session(Generic[D]):
    """A craft and the one peer that drives it."""

    def __init__(self, craft: D, clock: Callable[[], float] = time.monotonic):
        """Start without a peer; `clock` gives the time of arrival, s."""
        self.craft, self.counts, self.clock = craft, Counts(), clock
        self.seen: list[Callable[[Servos, Sensors], None]] = []  # called after each new frame
        self.peer: Address | None = None  # sender of the first valid packet
        self.last: Servos | None = None
        self.answer: bytes | None = b""  # None while a frame is not over
        self.pace = Pace()
        self._heard = self._answered = -math.inf  # s, of the clock: the peer, and the last frame
        self._unjudged = False  # whether the outputs of an autopilot that started are still to be looked at

    def tick(self) -> float:
        """Seconds until something is due by the wall clock: infinite, because nothing is."""
        return math.inf

    def state(self, seconds: float) -> str:
        """A status line: simulated time, its pace since the last line, frame counts, and the mean frame rate over the
        `seconds` since the start.
        """
        c, craft = self.counts, self.craft
        if self.last is None:
            return f"waiting for ArduPilot{c.refusals()}"
        return (
            f"t {craft.time:.1f} s at {craft.rate} Hz{self.pace(seconds, craft.time)}, "
            f"{c.frames} frames ({c.frames / seconds:.0f}/s), "
            f"repeated {c.repeated}, lost {c.lost}, late {c.late}, restarts {c.restarts}{c.refusals()}"
        )

    def receive(self, data: bytes, sender: Address) -> bytes | None:
        """Process a packet of `sender`; return the answer, or None for a packet that is refused or late, and for a
        frame that is not over yet: `complete` will give its answer.
        """
        try:
            servos = parse(data)
            self._check_sender(sender, servos)
        except PacketError as error:
            self.counts.refuse(str(error))
            return None
        last, now = self.last, self.clock()
        if sender == self.peer:
            self._heard = now
        if last is None or (servos.frame == 0 and (last.frame != 0 or sender != self.peer)):
            if last is not None:
                self.counts.restarts += 1
            self.craft.begin(servos.rate)
            gap, self._unjudged = 1, servos.frame == 0
        elif servos.frame == last.frame:
            self.counts.repeated += 1
            if self.answer is None or now - self._answered < CROSSED:
                return None
            self._answered = now
            return self.answer
        elif servos.frame < last.frame:
            self.counts.late += 1
            return None
        else:
            if servos.rate != last.rate:
                self.craft.change_rate(servos.rate)
            gap = servos.frame - last.frame
            if gap > LONGEST_GAP * servos.rate:
                gap = 1
            for _ in range(gap - 1):
                self.craft.advance(last.pwm)
            self.counts.lost += gap - 1
        self.craft.advance(servos.pwm)
        self.last, self.peer, self.answer = servos, sender, None
        self.counts.frames += 1
        return self.complete() if self.craft.ready else None

    def complete(self) -> bytes:
        """The answer to the last frame, which is over."""
        servos, sensors = self.last, self.craft.sensors()
        assert servos is not None
        self.answer = encode(sensors)
        self._unjudged = self._unjudged and not self.craft.flown  # what has flown had its outputs
        if self._unjudged and self.craft.time > AT_REST:
            self._unjudged = False
            self.craft.news += self.craft.mixer.strange(servos.pwm)
        for seen in self.seen:
            seen(servos, sensors)
        self._heard = self._answered = self.clock()
        return self.answer

    def _check_sender(self, sender: Address, servos: Servos) -> None:
        """Refuse (PacketError) other senders than the peer. Once the peer is silent for ALIVE, another port of the same
        machine may take over with frame 0, as a restarted SITL does.
        """
        if self.peer is None or sender == self.peer:
            return
        told = f"{sender[0]}:{sender[1]} does not drive this vehicle, {self.peer[0]}:{self.peer[1]} does"
        if ip_address(sender[0]) != ip_address(self.peer[0]) or servos.frame != 0:
            raise PacketError(told)
        if self.clock() - self._heard < ALIVE:
            raise PacketError(
                f"{told}: a second autopilot needs a port of its own (--instances 2; -I 1 there); a restarted one is "
                f"let in once the last one has been silent for {ALIVE:g} s"
            )


def answer_all(wire: socket.socket, session: Session[Any], tell: Callable[[str], None]) -> None:
    """Answer all packets that have arrived: copies of one frame come together after a pause."""
    arrived: list[tuple[bytes, Address]] = []
    with suppress(BlockingIOError, ConnectionResetError):  # the latter on Windows: an answer found nobody
        while len(arrived) < AT_ONCE:
            arrived.append(wire.recvfrom(LARGEST))
    for data, sender in arrived:
        known = len(session.counts.refused)
        answer = session.receive(data, sender)
        if answer is not None:
            with suppress(BlockingIOError):  # lost: it is asked for again
                wire.sendto(answer, sender)
        elif len(session.counts.refused) > known:  # at once, because whoever sent it waits for an answer
            tell(f"refused: {next(reversed(session.counts.refused))}")
