"""A pinhole camera in the world frame n (north-east-down), and the rigs that carry it from moment to moment.

The rows of `axes` are the right, down and forward unit vectors of the picture in n. `focal` is the focal length in
heights of the picture: an object of height s at distance d is s / d * focal pictures high. A pixel's centre is at half
numbers. Rigs follow the vehicles smoothly. All are level, so that the picture shows the roll of the vehicles. Distances
are in m, angles in rad.
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from taichi_sim.kernels.conventions import HORIZONTAL
from taichi_sim.visualisation.film.moment import Moment, TeamMoment
from taichi_sim.visualisation.recording.episode import COMPANY_LENGTHS

Array = NDArray[np.floating]
DOWN_N = np.array([0.0, 0.0, 1.0])
HAZE_M = 3500.0
AWAY = 2  # column of the distance ahead in a camera's axes
LEVEL = 1e-6  # sine of the angle to the vertical below which a direction has no heading
FOCAL = 1.15  # focal length in picture heights
SOFT_S, TURN_S = 1.5, 6.0  # time constants of positions, and of directions of view of boats
BANK_S = 1.2  # time constant of directions behind aircraft
LEAP = 4.0  # a camera farther from its place than this, over the reach of the picture, jumps there
OVERVIEW_PITCH, FOLLOW_PITCH, CHASE_PITCH = 0.52, 0.36, 0.2
OVERVIEW_TURN = -0.6  # direction of view relative to the first course of its team
FILLED = 0.78  # share of the picture that the vehicles may take
AMID = 60.0  # m, least extent of an overview
MAP_EYE_M = 60e3  # height of the map's eye: so far that its rays are parallel
CLEAR_M = 1e9  # haze of the map
MAP_FILLED = 0.84


class FilmCamera(NamedTuple):
    """Position and orientation of a pinhole camera."""

    eye_n: Array  # [3] m
    axes: Array  # [3, 3] rows right, down, forward, in n
    focal: float  # focal length, in picture heights
    haze_m: float = HAZE_M  # distance at which half of what is seen is haze

    def pixels(self, place_n: Array, size: tuple[int, int]) -> Array:
        """Column and row (px), distance ahead (m) [..., 3] of points [..., 3] in a picture of `size` (width, height).

        Column and row mean nothing where the distance is not above 0.
        """
        seen = (np.asarray(place_n, dtype=np.float64) - self.eye_n) @ self.axes.T
        ahead = np.where(seen[..., AWAY:] > 0.0, seen[..., AWAY:], 1.0)
        spot = np.array(size) / 2 + self.focal * size[1] * seen[..., :AWAY] / ahead
        return np.concatenate([spot, seen[..., AWAY:]], axis=-1)


def look(eye_n: Array, forward_n: Array, focal: float) -> FilmCamera:
    """A camera at `eye_n` that looks along `forward_n`, without roll; straight down, north is up."""
    forward = np.asarray(forward_n, dtype=np.float64) / np.linalg.norm(forward_n)
    right = np.cross(DOWN_N, forward)
    length = float(np.linalg.norm(right))
    right = right / length if length > LEVEL else np.array([0.0, 1.0, 0.0])
    return FilmCamera(np.asarray(eye_n, dtype=np.float64), np.stack([right, np.cross(forward, right), forward]), focal)


def look_at(eye_n: Array, target_n: Array, focal: float) -> FilmCamera:
    """A camera at `eye_n` with `target_n` in the centre."""
    return look(eye_n, np.asarray(target_n, dtype=np.float64) - np.asarray(eye_n, dtype=np.float64), focal)


def heading(course: float, pitch: float) -> Array:
    """[3] direction in n along `course` (rad, clockwise from north), `pitch` (rad) below level."""
    return np.array([np.cos(pitch) * np.cos(course), np.cos(pitch) * np.sin(course), np.sin(pitch)])


def eye_that_holds(places_n: Array, forward_n: Array, focal: float, aspect: float, filled: float) -> Array:
    """The nearest point [3] from which a camera that looks along `forward_n` sees all of `places_n` [N, 3].

    The picture has the `aspect` width over height; the points may take the share `filled` of its sides.
    """
    axes = look(np.zeros(3), forward_n, focal).axes
    seen = np.asarray(places_n, dtype=np.float64) @ axes.T
    across, ahead = [], []
    for axis, half in ((0, 0.5 * aspect), (1, 0.5)):
        reach = filled * half / focal  # tangent of half the angle that the points may take
        more, less = (float(np.max(sign * seen[:, axis] - reach * seen[:, AWAY])) for sign in (1.0, -1.0))
        across.append(0.5 * (more - less))
        ahead.append(-0.5 * (more + less) / reach)
    return np.array([*across, min(ahead)]) @ axes


class Rig(Protocol):
    """Carries a camera from moment to moment."""

    def camera(self, moment: Moment, aspect: float) -> FilmCamera:
        """The camera for a picture of `aspect` (wide over high); moments come in order."""
        ...


class Soft:
    """A quantity that follows another with a time constant."""

    def __init__(self, seconds: float) -> None:
        """Start at the first value given."""
        self.seconds, self.value, self._time = seconds, np.zeros(0), 0.0

    def towards(self, value: Array, time_s: float, leap: float = np.inf) -> Array:
        """Approach `value` until `time_s`, and return the result.

        It jumps to `value` if time ran backwards or the distance exceeds `leap`.
        """
        value = np.asarray(value, dtype=np.float64)
        passed = time_s - self._time
        if not self.value.size or passed < 0.0 or np.linalg.norm(value - self.value) > leap:
            self.value = value
        else:
            self.value = value + np.exp(-passed / self.seconds) * (self.value - value)
        self._time = time_s
        return self.value


class FollowRig:
    """Rig behind and above a team, close enough to show its vehicles' motion.

    It looks at boats along their course, which it follows slowly, and at aircraft from behind.
    """

    def __init__(self, team: str) -> None:
        """Follow the team of the given name."""
        self.team = team
        self._middle, self._course, self._reach = Soft(SOFT_S), Soft(TURN_S), Soft(SOFT_S)

    def camera(self, moment: Moment, aspect: float) -> FilmCamera:
        """See Rig."""
        team = moment.teams[self.team]
        wet, size = team.track.on_water, max(team.track.size_m[:2])
        self._course.seconds = TURN_S if wet else BANK_S
        places = _company(team)
        middle = places.mean(axis=0) if wet else places[0]
        radius = float(np.linalg.norm(places - middle, axis=-1).max())
        middle = self._middle.towards(middle * ((1, 1, 0) if wet else (1, 1, 1)), moment.time_s, LEAP * (radius + size))
        radius = float(self._reach.towards(np.array([radius]), moment.time_s)[0])
        course = _bound(team)
        way = self._course.towards(np.array([np.cos(course), np.sin(course)]), moment.time_s)
        away = 2.2 * radius / aspect + 4.5 * size if wet else 2.6 * radius / aspect + 2.6 * size
        bearing = float(np.arctan2(way[1], way[0])) + (0.3 if wet else 0.12)
        forward = heading(bearing, FOLLOW_PITCH if wet else CHASE_PITCH)
        eye = middle - away * forward
        eye[2] = min(eye[2], -3.0)
        return look_at(eye, middle + ((0, 0, 0) if wet else 0.1 * size * forward), FOCAL)


class Overview:
    """Rig above and far away, as close as shows every vehicle. Its direction is constant."""

    def __init__(self, about: str) -> None:
        """`about` is the team whose first course gives the direction."""
        self.about, self._course, self._eye = about, None, Soft(SOFT_S)

    def camera(self, moment: Moment, aspect: float) -> FilmCamera:
        """See Rig."""
        if self._course is None or moment.time_s <= 0.0:
            self._course = self._way(moment)
        forward = heading(self._course, OVERVIEW_PITCH)
        places = np.concatenate([team.position_n for team in moment.teams.values()])
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        around = 0.5 * AMID * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
        eye = eye_that_holds(np.concatenate([places, middle + around]), forward, FOCAL, aspect, FILLED)
        reach = float(np.ptp(places, axis=0).max() + AMID)
        return look(self._eye.towards(eye, moment.time_s, LEAP * reach), forward, FOCAL)

    def _way(self, moment: Moment) -> float:
        """Direction from the boats to the team `about`, or the course of that team if they are together."""
        about = moment.teams[self.about]
        for team in moment.teams.values():
            way = (about.position_n[0] - team.position_n.mean(axis=0))[:2]
            if team.track.on_water and team is not about and np.linalg.norm(way) > AMID:
                return float(np.arctan2(way[1], way[0])) + OVERVIEW_TURN
        return about.course + OVERVIEW_TURN


class MapRig:
    """Rig vertically above, north up, which shows all vehicles and their targets."""

    def __init__(self) -> None:
        """Start without a view."""
        self._reach, self._middle = Soft(2.0 * SOFT_S), Soft(2.0 * SOFT_S)

    def camera(self, moment: Moment, aspect: float) -> FilmCamera:
        """See Rig."""
        tracks = [track[:, HORIZONTAL] for track in moment.scene.tracks_n.values()]
        teams = [team.position_n[:, HORIZONTAL] for team in moment.teams.values()]
        ways = [team.trail_n.reshape(-1, 3)[:, HORIZONTAL] for team in moment.teams.values()]
        places = np.concatenate([*tracks, *teams, *ways])
        low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
        reach = np.array([max(high[0] - low[0], (high[1] - low[1]) / aspect, AMID)])
        middle = self._middle.towards(0.5 * (low + high), moment.time_s, LEAP * float(reach[0]))
        metres = float(self._reach.towards(reach, moment.time_s, LEAP * float(reach[0]))[0]) / MAP_FILLED
        eye, down = np.array([*middle, -MAP_EYE_M]), np.array([0.0, 0.0, 1.0])
        return look(eye, down, MAP_EYE_M / metres)._replace(haze_m=CLEAR_M)


def _company(team: TeamMoment) -> Array:
    """Positions [n, 3] of the vehicles that stay with the first: twice as far as their slots, or COMPANY_LENGTHS."""
    reach = COMPANY_LENGTHS * max(team.track.size_m[:2])
    if team.slot_n is not None:
        reach = max(reach, 2.0 * float(np.linalg.norm(team.slot_n - team.slot_n[0], axis=-1).max()))
    apart = np.linalg.norm(team.position_n - team.position_n[0], axis=-1)
    return team.position_n[apart <= reach]


def _bound(team: TeamMoment) -> float:
    """Course (rad) of the first vehicle: that of its target, else its own, else its heading if it lies still."""
    if team.target_n is not None:
        return team.course
    north, east = team.velocity_n[0, :2]
    fast = float(np.hypot(north, east)) > 0.3
    return float(np.arctan2(east, north)) if fast else float(team.heading[0])
