"""One moment of an episode, between two recorded steps: positions of everything and the mission's overlays.

Motion is interpolated, attitudes along the shorter arc. Overlays move from the earlier step towards the later one if
both have them. What runs now gives an episode of one step.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeVar

import numpy as np

from taichi_sim.visualisation.recording.east_north_up import euler
from taichi_sim.visualisation.recording.episode import Array, Episode, Event, Scene, TeamTrack
from taichi_sim.visualisation.recording.overlays import Overlay3D
from taichi_sim.visualisation.recording.palette import Livery

TRAIL_S = 25.0  # length of a trail
TRAIL_POINTS = 80  # most points of a trail
JUMP_M = 5.0  # a trail is broken where a vehicle moves farther than its speed allows by this much
ANGLES = ("heading",)
Shown = TypeVar("Shown", bound=Overlay3D)


class TeamMoment(NamedTuple):
    """One team at one moment; frames and units as in TeamTrack, without the time axis."""

    track: TeamTrack  # data that do not change
    livery: Livery
    position_n: Array  # [V, 3]
    quaternion_nb: Array  # [V, 4]
    velocity_n: Array  # [V, 3]
    course: float  # course of the team, rad
    target_n: Array | None  # [3]
    slot_n: Array | None  # [V, 3]
    error_m: Array | None  # [V]
    trail_n: Array  # [n, V, 3] past positions, oldest first; NaN where a vehicle was placed anew

    @property
    def heading(self) -> Array:
        """Headings [V], rad."""
        return euler(self.quaternion_nb)[2]


class Happened(NamedTuple):
    """An event and its position."""

    event: Event
    place_n: Array  # [3] m


class Moment(NamedTuple):
    """Everything that one picture shows."""

    name: str
    time_s: float
    teams: dict[str, TeamMoment]
    scene: Scene
    overlays: tuple[Overlay3D, ...]  # one frame each
    waves: Array | None  # [6, component] now; None: only `elevation` is known
    elevation: Callable[[Array, Array], Array]  # (north, east) -> m, up
    events: tuple[Happened, ...]  # events up to this moment
    wind_n: Array | None  # [3] m/s, velocity of the air

    def finite(self) -> bool:
        """Whether all positions are finite."""
        states = (part for team in self.teams.values() for part in (team.position_n, team.quaternion_nb))
        return all(np.isfinite(state).all() for state in states)


def moment_of(episode: Episode, time_s: float) -> Moment:
    """The moment at `time_s` (s) on the episode's clock, clipped to the episode."""
    clock = np.asarray(episode.time_s, dtype=np.float64)
    now = float(np.clip(time_s, clock[0], clock[-1]))
    step = int(np.clip(np.searchsorted(clock, now, side="right") - 1, 0, max(len(clock) - 2, 0)))
    after = min(step + 1, len(clock) - 1)
    share = (now - clock[step]) / (clock[after] - clock[step]) if after > step else 0.0

    def between(array: Array) -> Array:
        return _between(array[step], array[after], share)

    def perhaps(array: Array | None) -> Array | None:
        return None if array is None else between(array)

    liveries, teams = episode.liveries, {}
    for name, track in episode.teams.items():
        place, turn = between(track.position_n), track.target_course
        quaternion = _turned(track.quaternion_nb[step], track.quaternion_nb[after], share)
        course = euler(quaternion)[2][0] if turn is None else _angle(turn[step], turn[after], share)
        teams[name] = TeamMoment(
            track, liveries[name], place, quaternion, between(track.velocity_n), float(course),
            perhaps(track.target_n), perhaps(track.slot_n), perhaps(track.error_m),
            _trail(track, clock, step, now, place),
        )  # fmt: skip
    return Moment(
        name=episode.name,
        time_s=now,
        teams=teams,
        scene=episode.scene,
        overlays=tuple(_still(one, step, after, share) for one in episode.overlays if isinstance(one, Overlay3D)),
        waves=None if episode.waves is None else episode.waves(now),
        elevation=lambda north, east: episode.elevation(north, east, now),
        events=tuple(_happened(episode, event) for event in episode.events if event.time_s <= now + 1e-6),
        wind_n=perhaps(episode.wind_n),
    )


def _happened(episode: Episode, event: Event) -> Happened:
    step = min(int(np.searchsorted(episode.time_s, event.time_s - 1e-6)), len(episode.time_s) - 1)
    return Happened(event, episode.teams[event.team].position_n[step, event.vehicle])


def _between(one: Array, other: Array, share: float) -> Array:
    """Interpolate between two arrays; rows missing in the other stay in place."""
    one, other = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    return one + share * np.where(np.isfinite(other), other - one, 0.0)


def _angle(one: Array, other: Array, share: float) -> Array:
    return one + share * np.nan_to_num(np.mod(other - one + np.pi, 2.0 * np.pi) - np.pi)


def _turned(one: Array, other: Array, share: float) -> Array:
    """Interpolate between two quaternions [V, 4] on the shorter arc."""
    one, other = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    other = np.where((one * other).sum(axis=-1, keepdims=True) < 0.0, -other, other)
    found = _between(one, other, share)
    return found / np.maximum(np.linalg.norm(found, axis=-1, keepdims=True), 1e-12)


def _trail(track: TeamTrack, clock: Array, step: int, now: float, here: Array) -> Array:
    """The last seconds of a path: fixed points, and `here` as the newest one."""
    first = int(np.searchsorted(clock, now - TRAIL_S))
    apart = max(1, -(-int(np.searchsorted(clock, clock[first] + TRAIL_S) - first) // TRAIL_POINTS))
    steps = np.arange(-(-first // apart) * apart, step + 1, apart)
    way = np.concatenate([track.position_n[steps], here[None]]).astype(np.float64)
    if len(steps):
        seconds = np.diff(np.append(clock[steps], now))[:, None]
        reach = np.linalg.norm(track.velocity_n[steps], axis=-1) * seconds
        jumped = np.linalg.norm(np.diff(way, axis=0), axis=-1) > 2.0 * reach + JUMP_M
        way[:-1][jumped] = np.nan
    return way


def _still(overlay: Shown, step: int, after: int, share: float) -> Shown:
    """An overlay of one frame: `overlay` between `step` and the next one."""
    found = {}
    for name in overlay.shapes:
        array = getattr(overlay, name)
        last = len(array) - 1  # a fixed overlay has one frame
        one, other = array[min(step, last)], array[min(after, last)]
        found[name] = (_angle if name in ANGLES else _between)(one, other, share)[None]
    return replace(overlay, **found)
