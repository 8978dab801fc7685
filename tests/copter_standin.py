"""Stands in for ArduCopter's program: the JSON interface, and as much of MAVLink as a landing needs (no firmware).

    copter_standin.py --instance N --serial0 udpclient:ADDRESS:PORT --home LAT,LON,...

It arms and disarms on request, takes off, and follows a place and a velocity, or a velocity along its heading. Control
is that of sitl_peer.Copter, for a t650.
"""

import argparse
import math
import socket
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parents[1])]

from pymavlink import mavutil  # noqa: E402
from sitl_peer import Copter, Peer  # noqa: E402

RATE, METRES = 400, 111_319.5  # Hz; m per degree
NEAR = 5.0  # m, farther goals are drawn in: they set its speed


def t650() -> SimpleNamespace:
    """The numbers of the vehicle file that `Copter` asks for."""
    file = Path(__file__).resolve().parents[1] / "configs" / "vehicles" / "t650.toml"
    data = tomllib.loads(file.read_text())
    body = data["physical"]
    inertia = np.diag([body["Jx"], body["Jy"], body["Jz"]])
    return SimpleNamespace(
        physical=SimpleNamespace(mass=body["mass"], cg=body["cg"], inertia=inertia),
        rotor=SimpleNamespace(**data["rotor"]), rotors=[SimpleNamespace(**r) for r in data["rotors"]],
    )  # fmt: skip


class StandIn:
    """The autopilot: what it was told, and what it does about it."""

    def __init__(self, wire: socket.socket, link, home: tuple[float, float]):
        self.link, self.home, self.pilot = link, home, Copter(t650())
        self.armed, self.goal, self.moves, self.ordered = False, None, np.zeros(3), None

        def answered(data: bytes) -> bytes | None:
            wire.send(data)
            return wire.recv(65536)

        self.peer = Peer(answered, RATE)

    def run(self) -> None:
        """Until nobody answers."""
        told = self.peer.step([1000] * 4)
        while True:
            self.hear(told)
            if self.peer.frame % (RATE // 10) == 0:
                self.tell(told)
            told = self.peer.step(self.outputs(told))

    def outputs(self, told: dict) -> list[int]:
        """Pulse widths."""
        if not self.armed or self.goal is None:
            return [1000] * 4
        p, v = np.array(told["position"]), np.array(told["velocity"])
        if self.ordered is not None:
            ahead, right, down = self.ordered
            c, s = math.cos(told["attitude"][2]), math.sin(told["attitude"][2])
            self.pilot.goal = p
            return self.pilot.outputs(
                told | {"velocity": list(v - [c * ahead - s * right, s * ahead + c * right, down])}
            )
        away = self.goal - p
        self.pilot.goal = p + away * min(1.0, NEAR / max(np.linalg.norm(away[:2]), 1e-6))
        return self.pilot.outputs(told | {"velocity": list(v - self.moves * [1.0, 1.0, 0.0])})

    def hear(self, told: dict) -> None:
        """Take commands."""
        while (message := self.link.recv_match(blocking=False)) is not None:
            kind = message.get_type()
            if kind == "COMMAND_LONG" and message.command == mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                self.armed = message.param1 == 1
            elif (
                kind == "COMMAND_LONG" and message.command == mavutil.mavlink.MAV_CMD_NAV_TAKEOFF and self.goal is None
            ):
                self.goal = np.array(told["position"]) - [0.0, 0.0, message.param7]
            elif kind == "SET_POSITION_TARGET_GLOBAL_INT":
                north = (message.lat_int / 1e7 - self.home[0]) * METRES
                east = (message.lon_int / 1e7 - self.home[1]) * METRES * math.cos(math.radians(self.home[0]))
                self.goal, self.moves = (
                    np.array([north, east, -message.alt]),
                    np.array([message.vx, message.vy, message.vz]),
                )

            elif kind == "SET_POSITION_TARGET_LOCAL_NED":
                self.ordered = message.vx, message.vy, message.vz

    def tell(self, told: dict) -> None:
        """Send a heartbeat, attitude and position."""
        clock = round(1e3 * told["timestamp"])
        self.link.mav.attitude_send(clock, *told["attitude"], *told["imu"]["gyro"])
        (north, east, down), v = told["position"], [round(100 * x) for x in told["velocity"]]
        self.link.mav.heartbeat_send(2, 3, 128 if self.armed else 0, 4, 4)
        self.link.mav.global_position_int_send(
            clock, round(1e7 * (self.home[0] + north / METRES)),
            round(1e7 * (self.home[1] + east / (METRES * math.cos(math.radians(self.home[0]))))), round(-1e3 * down),
            round(-1e3 * down), *v, 0,
        )  # fmt: skip


def main() -> None:
    """Run the program."""
    p = argparse.ArgumentParser()
    p.add_argument("--instance", type=int)
    p.add_argument("--home")
    p.add_argument("--serial0")
    args, _ = p.parse_known_args()
    home = tuple(float(x) for x in args.home.split(",")[:2])
    link = mavutil.mavlink_connection("udpout:" + args.serial0.partition(":")[2], source_system=1, source_component=1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.settimeout(60.0)
        wire.connect(("127.0.0.1", 9002 + 10 * args.instance))
        StandIn(wire, link, home).run()


if __name__ == "__main__":
    main()
