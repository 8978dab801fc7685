"""Lines that lie on the waves: a ring at each slot, one around each boat, and the boats' wakes.

They move as often as the water about a hull does (sea_patch.py), and like it are rounded so that a file packs well.
"""

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.recording.episode import Array, Episode, TeamTrack
from taichi_sim.recording.frames import enu
from taichi_sim.recording.palette import TARGET, WATER
from taichi_sim.recording.sea_patch import frame_steps
from taichi_sim.recording.stream import Stream

TRAIL_S = 25.0  # how much of a wake is shown
TRAIL_POINTS = -1.5  # radius of a trail in points of the screen, whatever the distance
WAKE_S, WAKE_LENGTHS = 0.25, 0.25  # between the points of a wake, at least: time, and vehicle lengths
WAKE_MOST_S = 2.5  # the same, at most
NEWEST = 3  # points of a wake, those at the hull, that move as often as the water there
RING = np.linspace(0.0, 2.0 * np.pi, 41)  # rad
SLOT_RING, WATER_RING = 0.75, 0.9  # radii, of the longer of length and beam
ABOVE_WATER = 0.02  # of the length: lines on the water are drawn this much higher, that it may not hide them
ROUND_M = 1.0 / 128.0  # heights are rounded to this
JUMP_M = 5.0  # a trail is broken where a vehicle moves farther than its speed allows by this much


def surface(episode: Episode, place_n: Array, index: NDArray[np.int64]) -> Array:
    """Elevation [F, ...] (m) at `place_n` [F, ..., 2] (north, east, m) in the steps `index` [F]."""
    steps = zip(np.asarray(place_n, dtype=np.float64), np.asarray(episode.time_s)[index], strict=True)
    return np.stack([episode.elevation(at[..., 0], at[..., 1], float(time)) for at, time in steps])


def jumps(stream: Stream, team: TeamTrack) -> NDArray[np.bool_]:
    """[T, V]: a vehicle has been put elsewhere since the step before, for it moved farther than its speed allows."""
    seconds = np.diff(stream.ns, prepend=stream.ns[:1])[:, None] * 1e-9
    reach = np.linalg.norm(team.velocity_n, axis=-1) * seconds
    moved = np.linalg.norm(np.diff(team.position_n, axis=0, prepend=team.position_n[:1]), axis=-1)
    return moved > 2.0 * reach + JUMP_M


def _lifted(up: Array, team: TeamTrack) -> Array:
    """Heights (m) at which lines are drawn where the water is at `up`."""
    return np.round((up + ABOVE_WATER * team.size_m[0]) / ROUND_M) * ROUND_M


def send_rings(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """One at each slot, if there are any, and one around each boat that shows the water it floats in."""
    length, beam = team.size_m[:2]
    index, _ = frame_steps(episode.time_s)
    livery = episode.liveries[team.name]
    for name, middle, share, thick in (
        ("slot", team.slot_n, SLOT_RING, 0.012),
        ("water", team.position_n, WATER_RING, 0.006),
    ):
        if middle is None:
            continue
        ring = share * max(length, beam) * np.stack([np.cos(RING), np.sin(RING)], axis=-1)
        middle = np.asarray(middle[index, :, :2], dtype=np.float64)
        down = -_lifted(surface(episode, middle[:, :, None] + ring, index), team)  # [F, V, 41]
        strips = enu(np.concatenate([np.broadcast_to(ring, (*down.shape, 2)), down[..., None]], axis=-1))
        place = enu(np.concatenate([middle, 0.0 * middle[..., :1]], axis=-1))
        for vehicle in range(team.vehicles):
            path = f"world/{team.name}/{name}_{vehicle}"
            own = TARGET if vehicle == 0 else livery.of(vehicle)
            colour = own if name == "slot" else WATER
            stream.static(path, rr.LineStrips3D.from_fields(colors=colour, radii=thick * length))
            shape = rr.LineStrips3D.columns(strips=list(strips[:, vehicle]))
            stream.columns(path, [*shape, *rr.Transform3D.columns(translation=place[:, vehicle])], index)


def send_wakes(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """The last seconds of each boat's way, on the water as it is now: a whole line per frame."""
    time = np.asarray(episode.time_s, dtype=np.float64)
    index, whole = frame_steps(time)
    apart = _steps_between_points(team, time)
    jumped = jumps(stream, team)
    up = np.zeros((len(time), team.vehicles))  # where each point was drawn last
    strips: list[list[NDArray[np.float32]]] = [[] for _ in range(team.vehicles)]
    for frame, step in enumerate(index):
        now = float(time[step])
        first = int(np.searchsorted(time, now - TRAIL_S))
        way = np.append(np.arange(-(-first // apart) * apart, step, apart), step)  # the same points every time
        moving = way if frame % whole == 0 else way[-NEWEST:]
        place = np.asarray(team.position_n[moving, :, :2], dtype=np.float64)
        up[moving] = _lifted(episode.elevation(place[..., 0], place[..., 1], now), team)
        points = enu(np.concatenate([team.position_n[way, :, :2], -up[way, :, None]], axis=-1))
        for vehicle, strip in enumerate(strips):
            breaks = np.flatnonzero(jumped[: step + 1, vehicle])
            strip.append(points[way >= (breaks[-1] if len(breaks) else 0), vehicle])
    for vehicle, strip in enumerate(strips):
        path, colour = f"world/{team.name}/trail_{vehicle}", episode.liveries[team.name].of(vehicle)
        stream.static(path, rr.LineStrips3D.from_fields(colors=colour, radii=TRAIL_POINTS))
        stream.columns(path, rr.LineStrips3D.columns(strips=strip), index)


def _steps_between_points(team: TeamTrack, time: Array) -> int:
    """How many steps lie between the points of a wake."""
    if len(time) < 2:
        return 1
    speed = float(np.nanmedian(np.linalg.norm(team.velocity_n, axis=-1)))
    seconds = min(max(WAKE_S, WAKE_LENGTHS * team.size_m[0] / max(speed, 1e-9)), WAKE_MOST_S)
    return max(1, round(seconds / float(np.median(np.diff(time)))))
