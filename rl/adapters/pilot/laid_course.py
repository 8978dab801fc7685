"""The motion that lays a mission's plane on the sea: its course begins at a place, and leads along a heading there.

With n (m, NED) in the plane that touches WGS-84 there (taichi_sim/visualisation/recording/east_north_up.py), and p, chi
the place and the direction in which the course begins in the mission,

    p_mission = p + R(turn) n,    heading_mission = heading + turn,    turn = chi - heading of the course on the sea.

Down is the height above home, and zero for vessels; or, where heights of vehicles are compared, the altitude over that
of a level. Velocities and rates in b are the same in both.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rl.adapters.pilot.autopilot_link import Fix, Link
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, POSITION, QUATERNION, STATE_SIZE, VELOCITY
from taichi_sim.kernels.rotation import numpy_rotation_matrix
from taichi_sim.visualisation.recording.east_north_up import Origin, from_geodetic

Array = NDArray[np.float64]


def turned(vector: Array, angle: float) -> Array:
    """Level parts of vectors [.., 2 or more] (NED), turned clockwise by `angle` (rad); the rest stays."""
    c, s, out = math.cos(angle), math.sin(angle), np.array(vector, dtype=np.float64)
    out[..., 0], out[..., 1] = c * vector[..., 0] - s * vector[..., 1], s * vector[..., 0] + c * vector[..., 1]
    return out


def quaternion(roll: float, pitch: float, heading: float) -> Array:
    """Quaternion [4] (w, x, y, z) b to n of Euler angles (rad)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(half := 0.5 * np.array((roll, pitch, heading))), np.sin(half)
    return np.array((cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
                     cr * cp * sy - sr * sp * cy))  # fmt: skip


def rotated(q: Array, by: Array) -> Array:
    """The quaternion [4] of a vehicle that has rotated `by` a vector [3] (rad, b) since it had q."""
    angle, (w, x, y, z) = float(np.linalg.norm(by)), q
    a, b, c = 0.5 * np.sinc(0.5 * angle / np.pi) * by
    d = math.cos(0.5 * angle)
    return np.array((w * d - x * a - y * b - z * c, w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a,
                     w * c + x * b - y * a + z * d))  # fmt: skip


class LaidCourse:
    """Turns telemetry into states of a mission, and velocities of the mission into those over the sea."""

    def __init__(
        self, origin: Origin, heading: float, place: Sequence[float], course: float, *, afloat: bool = False,
        level: float | None = None,
    ):  # fmt: skip
        """Lay the `course` (rad) that begins at `place` (north, east, m) on the sea: at `origin`, along `heading`
        (rad). Vehicles that are `afloat` have no height. Those of others are above home, or above `level` (m, above
        mean sea level).
        """
        self.origin, self.turn, self.place = origin, course - heading, np.asarray(place, float)
        self.afloat, self.level = afloat, level

    def _height(self, there: Fix) -> float:
        return there.height if self.level is None else there.altitude - self.level

    def states(self, links: Sequence[Link], now: float) -> Array:
        """States [vehicle, 13] in the mission at `now` (s): as last heard, moved on by velocity and rates."""
        states, known = np.zeros((len(links), STATE_SIZE)), [(link, *link.last) for link in links]
        places = np.array([(there.latitude, there.longitude, 0.0) for _, there, _ in known])
        for state, (east, north, _), (link, there, faced) in zip(
            states, from_geodetic(places, self.origin), known, strict=True
        ):
            velocity, (roll, pitch, heading) = np.array(there.velocity), faced.euler
            place = np.array((north, east, -self._height(there))) + (now - link.placed) * velocity
            state[POSITION] = (*(self.place + turned(place[:2], self.turn)), 0.0 if self.afloat else place[2])
            state[QUATERNION] = rotated(
                quaternion(roll, pitch, heading + self.turn), (now - link.turned) * np.array(faced.rates)
            )
            state[VELOCITY] = numpy_rotation_matrix(state[QUATERNION]).T @ turned(velocity, self.turn)
            state[ANGULAR_VELOCITY] = faced.rates
        return states

    def in_mission(self, velocity: Sequence[float]) -> Array:
        """A velocity [3] (NED, m/s) in the mission, of one over the sea."""
        return turned(np.array(velocity), self.turn)

    def over_sea(self, velocity: Array) -> Array:
        """Velocities [.., 2 or 3] (NED, m/s) over the sea, of those in the mission."""
        return turned(velocity, -self.turn)
