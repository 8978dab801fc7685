"""Camera rigs that follow the vehicles smoothly from moment to moment.

All rigs are level, so that the picture shows the roll of the vehicles. Distances are in m, angles in rad.
"""

from typing import Protocol

import numpy as np

from taichi_sim.conventions import HORIZONTAL
from taichi_sim.film.camera import Array, FilmCamera, eye_that_holds, heading, look, look_at
from taichi_sim.film.moment import Moment, TeamMoment
from taichi_sim.recording.episode import COMPANY_LENGTHS

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
        """Value at `time_s`; it jumps to `value` if time ran backwards or the distance exceeds `leap`."""
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
        self.about, self._course = about, None
        self._eye = Soft(SOFT_S)

    def camera(self, moment: Moment, aspect: float) -> FilmCamera:
        """See Rig."""
        if self._course is None or moment.time_s <= 0.0:
            self._course = self._way(moment)
        forward = heading(self._course, OVERVIEW_PITCH)
        places = np.concatenate([team.position_n for team in moment.teams.values()])
        middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
        around = 0.5 * AMID * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
        eye = eye_that_holds(np.concatenate([places, middle + around]), forward, FOCAL, aspect, FILLED)
        return look(self._eye.towards(eye, moment.time_s, LEAP * float(np.ptp(places, axis=0).max() + AMID)), forward,
                    FOCAL)  # fmt: skip

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
    """Positions [n, 3] of the vehicles that stay with the first: the formation, or those near it."""
    if team.slot_n is not None:
        return team.position_n
    apart = np.linalg.norm(team.position_n - team.position_n[0], axis=-1)
    return team.position_n[apart <= COMPANY_LENGTHS * max(team.track.size_m[:2])]


def _bound(team: TeamMoment) -> float:
    """Course (rad) of the first vehicle: that of its target, else its own, else its heading if it lies still."""
    if team.target_n is not None:
        return team.course
    north, east = team.velocity_n[0, :2]
    fast = float(np.hypot(north, east)) > 0.3
    return float(np.arctan2(east, north)) if fast else float(team.heading[0])
