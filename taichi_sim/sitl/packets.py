"""Packets of ArduPilot's JSON interface (ardupilot, libraries/SITL/examples/JSON/readme.md).

From ArduPilot, binary, little-endian: magic (uint16), frame_rate (uint16, Hz), frame_count (uint32), pulse widths of 16
or 32 servos (uint16, microseconds). To ArduPilot, a line of JSON: time, IMU, position, attitude, velocity.
"""

import json
import struct
from typing import NamedTuple

MAGIC = {18458: 16, 29569: 32}  # magic -> servo channels
RATES = (1, 10000)  # lowest and highest frame rate, Hz


class PacketError(ValueError):
    """Data that are no valid packet; the message says why."""


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


def parse(data: bytes) -> Servos:
    """Decode a packet with 16 or 32 channels.

    Raises:
        PacketError: for a wrong length, an unknown magic, or a frame rate out of range.
    """
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
    if not RATES[0] <= rate <= RATES[1]:
        raise PacketError(f"frame_rate {rate} Hz: allowed are {RATES[0]} to {RATES[1]}")
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
