"""AIS as MAVLink: AIS_VESSEL (common.xml, 301), by which an autopilot tells what its receiver hears of ships.

A companion hears them (`Heard`, taichi-sim pilot); a simulation tells those of the ships of an encounter (`Teller`,
taichi-sim sitl), at the cadence, with the errors and losses of `[ais]`. Place and time are those of the report; between
two reports a ship goes straight on.
"""

import math
import random
import socket
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rl.adapters.pilot.autopilot_link import dialect
from rl.adapters.pilot.laid_course import LaidCourse
from rl.missions.encounter.bodies import sizes_of
from rl.missions.encounter.config import AisConfig
from rl.missions.encounter.sensing import TURNS_FAST, cadence_of
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import YAW_RATE
from taichi_sim.kernels.rotation import torch_heading
from taichi_sim.visualisation.recording.east_north_up import Origin, from_geodetic, geodetic

COG, VELOCITY, DIMENSIONS = 2, 4, 64  # AIS_FLAGS that say what is valid
FIRST_MMSI = 200_000_001
SENDER = 1, 191  # system and component: an onboard computer
UNKNOWN = 50.0, 10.0  # m, length and beam of a ship that does not tell them; assumed


class Report(NamedTuple):
    """The last report of a ship."""

    latitude: float  # deg, of its middle
    longitude: float  # deg
    velocity: tuple[float, float]  # over ground, north and east, m/s; 0 where it is not told
    size: tuple[float, float]  # length and beam, m
    sent: float  # s, our clock


class Heard:
    """Ships that have been heard.

    Attributes:
        reports: MMSI -> its last report.
    """

    def __init__(self, forget: float):
        """Hear nobody yet; a report is good for `forget` s."""
        self.reports: dict[int, Report] = {}
        self._forget, self._readers = forget, {}

    def receive(self, data: bytes, now: float, wire: object = None) -> None:
        """Take bytes that arrived at `now` (s) by a `wire`, cut anywhere."""
        reader = self._readers.get(wire)
        if reader is None:
            reader = self._readers[wire] = dialect().MAVLink(None)
            reader.robust_parsing = True
        for m in reader.parse_buffer(data) or ():
            if m.get_type() == "AIS_VESSEL" and (m.lat or m.lon) and abs(m.lat) <= 900_000_000:
                self._take(m, now)

    def _take(self, m, now: float) -> None:
        told = m.flags & COG and m.flags & VELOCITY
        course, speed = math.radians(0.01 * m.COG), 0.01 * m.velocity if told else 0.0
        length, beam = m.dimension_bow + m.dimension_stern, m.dimension_port + m.dimension_starboard
        size = (float(length), float(beam)) if m.flags & DIMENSIONS and length and beam else UNKNOWN
        ahead, aside = 0.5 * (m.dimension_bow - m.dimension_stern), 0.5 * (m.dimension_starboard - m.dimension_port)
        heading = math.radians(0.01 * m.heading) if m.heading < 36000 else course  # 511 deg: it is not told
        c, s = math.cos(heading), math.sin(heading)
        antenna = Origin(1e-7 * m.lat, 1e-7 * m.lon)
        middle = geodetic(np.array((ahead * s + aside * c, ahead * c - aside * s, 0.0)), antenna)
        velocity = (speed * math.cos(course), speed * math.sin(course))
        self.reports[m.MMSI] = Report(float(middle[0]), float(middle[1]), velocity, size, now - m.tslc)

    def tracks(self, laid: LaidCourse, now: float, place: Tensor) -> Tensor:
        """Ships that are known now, [n, 7] as `Mission.hear` takes them, the nearest to `place` [2] first."""
        rows: list[NDArray[np.float64]] = []
        for report in self.reports.values():
            age = now - report.sent
            if age > self._forget:
                continue
            east, north, _ = from_geodetic(np.array((report.latitude, report.longitude, 0.0)), laid.origin)
            velocity = laid.in_mission((*report.velocity, 0.0))[:2]
            there = laid.place + laid.in_mission((north, east, 0.0))[:2] + age * velocity
            rows.append(np.concatenate((there, velocity, report.size, (age,))))
        table = torch.from_numpy(np.array(rows)).to(place) if rows else place.new_zeros((0, 7))
        return table[(table[:, :2] - place).norm(dim=1).argsort()]


class Teller:
    """Tells the ships of a fleet of one environment to an address by UDP."""

    def __init__(self, ships: Fleet, ais: AisConfig, to: tuple[str, int], home: Origin, interval: float, seed: int):
        """Tell `ships` as `ais` says, every `interval` s, to `to`; (0, 0) is at `home`."""
        self._ships, self._ais, self._to, self._home, self._interval = ships, ais, to, home, interval
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._writer = dialect().MAVLink(None, *SENDER)
        self._random = random.Random(seed)
        draw = self._random.random
        self._wait = [10 * draw() if draw() < ais.carried else math.inf for _ in range(ships.count)]

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def __call__(self) -> None:
        """Tell what is due after a decision."""
        fleet, ais, draw, sizes = self._ships, self._ais, self._random, sizes_of(self._ships)[0]
        place, velocity = fleet.position_n[0].tolist(), fleet.velocity_n[0].tolist()
        heading, turn = torch_heading(fleet.quaternion_nb)[0].tolist(), fleet.state[0, :, YAW_RATE].tolist()
        for k, (length, beam) in enumerate(sizes.tolist()):
            self._wait[k] -= self._interval
            if self._wait[k] >= 0:
                continue
            north, east = (x + draw.gauss(0.0, ais.place_noise) for x in place[k][:2])
            v_north, v_east = (x + draw.gauss(0.0, ais.speed_noise) for x in velocity[k][:2])
            long = {"A": 0.0, "B": math.inf, "auto": ais.class_a_length}[ais.transponder]
            self._wait[k] += cadence_of(length, math.hypot(*velocity[k][:2]), abs(turn[k]) > TURNS_FAST, long)
            if draw.random() < ais.loss:
                continue
            latitude, longitude, _ = geodetic(np.array((east, north, 0.0)), self._home)
            course, ahead = (round(100 * math.degrees(a)) % 36000 for a in (math.atan2(v_east, v_north), heading[k]))
            bow, side = round(0.5 * length), round(0.5 * beam)
            message = self._writer.ais_vessel_encode(
                FIRST_MMSI + k, round(1e7 * float(latitude)), round(1e7 * float(longitude)), course, ahead,
                round(100 * math.hypot(v_north, v_east)), 0, 0, 70, bow, round(length) - bow, side,
                round(beam) - side, b"", f"SHIP {k + 1}".encode(), 0, COG | VELOCITY | DIMENSIONS,
            )  # fmt: skip
            self._socket.sendto(message.pack(self._writer), self._to)
