"""Routes of waypoints as tracks: of QGroundControl's plans (.plan), Mission Planner's waypoints, and CSV.

Waypoints become a closed track: straight legs, arcs of one radius between them, tangent to both legs (fly-by turns),
and a leg from the last waypoint back to the first. Its frame is north, east (m) about the middle of its extent. An arc
of radius R at a turn by the angle a needs R tan(a / 2) of the legs before and after it.

Formats: MAVLink's commands and frames (mavlink.io, common), QGroundControl's plan files (docs.qgroundcontrol.com), and
"QGC WPL 110" (mavlink.io, file formats).
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rl.guidance.course.tracks import Tracks
from taichi_sim.config import ConfigError
from taichi_sim.config.columns import Sheet
from taichi_sim.errors import reading, refuse
from taichi_sim.visualisation.recording.east_north_up import Origin, from_geodetic, geodetic

WAYPOINT, SPLINE, TAKEOFF, VTOL_TAKEOFF, JUMP = 16, 82, 22, 84, 177  # MAV_CMD_NAV_..., MAV_CMD_DO_JUMP
ENDS = (20, 21, 85)  # return to launch, land, VTOL land
NAVIGATION = range(16, 96)  # commands that go somewhere, or wait there
ALTITUDE = {0: "above mean sea level", 5: "above mean sea level", 3: "above home", 6: "above home"}  # of MAV_FRAME
FARTHEST = 50e3  # m from home to a waypoint; assumed
SAME = 0.5  # m, between waypoints that are one; assumed
SHARPEST = 175.0  # deg, turn at a waypoint; assumed
PER_RADIUS, SAMPLES = 8, (1024, 32768)  # samples of a track: of a radius; bounds

AROUND = 64  # corners of the polygon in place of a circle

Array = NDArray[np.float64]
GeoFence = tuple[Sequence[Sequence[float]], float, bool]
"""Corners (latitude, longitude, deg), or the middle of a circle; its radius (m), 0 of a polygon; whether inside."""


class Fence(NamedTuple):
    """A geofence: a polygon that vehicles must not leave, or must not enter."""

    corners: Tensor  # [n, 2] north, east, m
    inside: bool  # vehicles stay inside

    def clearance(self, place: Tensor) -> Tensor:
        """Distance [..] (m) of a `place` [.., 2] to the fence, negative where it must not be."""
        ahead = self.corners.roll(-1, 0)
        edge, off, on = ahead - self.corners, place.unsqueeze(-2) - self.corners, place.unsqueeze(-2)
        share = ((off * edge).sum(-1) / edge.square().sum(-1).clamp(min=SAME**2)).clamp(0.0, 1.0)
        away = (off - share.unsqueeze(-1) * edge).norm(dim=-1).amin(-1)
        beside = (self.corners[:, 1] > on[..., 1]) != (ahead[:, 1] > on[..., 1])  # edges that its meridian crosses
        north = off[..., 0] * edge[:, 1] < edge[:, 0] * off[..., 1]
        within = (beside & (north == (edge[:, 1] > 0))).sum(-1) % 2 == 1
        return torch.where(within == self.inside, away, -away)


class Route(NamedTuple):
    """Waypoints in order, about the middle of their extent."""

    place: Array  # [n, 2] north, east, m
    height: Array  # [n] m, NaN where none is given
    origin: Origin | None  # of (0, 0); None where the file has metres
    fences: tuple[Fence, ...] = ()


class Waypoint(NamedTuple):
    """A command of a mission file."""

    number: int
    command: int
    frame: int
    latitude: float  # deg
    longitude: float  # deg
    height: float  # m


def read_route(path: Path) -> Route:
    """Read the waypoints of a file."""
    with reading(path, ConfigError):
        text = path.read_text(encoding="utf-8-sig")
        if text.lstrip().startswith("{"):
            return _flown(*_of_plan(text))
        if text.startswith("QGC WPL"):
            return _flown(*_of_waypoints(text))
        return _of_table(path)


def laid(route: Route, path: Path, radius: float, worlds: int) -> Tracks:
    """The same closed track in all worlds, with bends of `radius` (m)."""
    points = route.place[:, 0] + 1j * route.place[:, 1]
    leg = np.roll(points, -1) - points
    length, course = np.abs(leg), np.angle(leg)
    turn = np.angle(leg / np.roll(leg, 1))  # at each waypoint, positive to starboard
    taken = radius * np.tan(np.minimum(np.abs(turn), np.radians(SHARPEST)) / 2)
    of_leg = taken + np.roll(taken, -1)
    sharp, short = int(np.abs(turn).argmax()), int((of_leg / length).argmax())
    refuse(
        ConfigError,
        (
            (most := math.degrees(abs(turn[sharp]))) > SHARPEST,
            f"{path}: at waypoint {sharp + 1} the route turns by {most:.0f} deg, allowed are {SHARPEST:g}; the last "
            "waypoint leads back to the first",
        ),
        (
            of_leg[short] > length[short],
            f"{path}: the leg from waypoint {short + 1} to {(short + 1) % len(points) + 1} is {length[short]:.4g} m "
            f"long: bends of track.min_radius = {radius:g} m do not fit, at most "
            f"{radius * length[short] / of_leg[short]:.3g} m does",
        ),
    )
    straight = length - of_leg
    # pieces from the middle of the first bend on: half a bend, leg, bend, leg ... half a bend
    bend = radius * np.abs(turn)
    pieces = np.ravel(np.column_stack((bend, straight)))
    curvature = np.ravel(np.column_stack((np.sign(turn) / radius, np.zeros(len(points)))))
    pieces, curvature = np.append(pieces, bend[0] / 2), np.append(curvature, curvature[0])
    pieces[0] /= 2
    s = np.concatenate(([0.0], np.cumsum(pieces)))
    samples = int(np.clip(s[-1] * PER_RADIUS / radius, *SAMPLES))
    first = course[-1] + turn[0] / 2
    heading = first + np.concatenate(([0.0], np.cumsum(pieces * curvature)))
    inside = radius * (1 / np.cos(turn[0] / 2) - 1)  # from the waypoint to the middle of its bend
    start = points[0] + 1j * np.sign(turn[0]) * inside * np.exp(1j * first)
    place = start + np.concatenate(([0.0], np.cumsum(_arc(pieces, heading[:-1], curvature))))
    at = s[-1] * np.arange(samples) / samples
    piece = np.searchsorted(s[1:-1], at, side="right")
    along = at - s[piece]
    point = place[piece] + _arc(along, heading[piece], curvature[piece])
    table = np.stack((point.real, point.imag, heading[piece] + along * curvature[piece], curvature[piece]), axis=-1)
    middle = s[:-1:2] + pieces[::2] / 2
    middle[0] = 0.0
    own = (np.array(x, dtype=np.float32) for x in (table, s[-1], route.place, middle[: len(points)]))
    return Tracks(*(torch.from_numpy(x).expand(worlds, *x.shape).clone() for x in own))


def _arc(length: Array, heading: Array, curvature: Array) -> NDArray[np.complex128]:
    """From the beginning to the end of arcs, north + i east."""
    turn = length * curvature
    return np.asarray(length * np.sinc(turn / (2 * np.pi)) * np.exp(1j * (heading + turn / 2)), np.complex128)


def _of_plan(text: str) -> tuple[list[Waypoint], Origin, list[GeoFence]]:
    """Commands of a plan of QGroundControl, its home, and its geofences."""
    plan = json.loads(text)
    mission, fence = plan["mission"], plan.get("geoFence", {})
    simple = list(_simple(mission["items"]))
    places = [[math.nan if x is None else float(x) for x in one["params"][4:7]] for one in simple]
    commands = [Waypoint(k + 1, one["command"], one["frame"], *places[k]) for k, one in enumerate(simple)]
    fences = [(x["polygon"], 0.0, x["inclusion"]) for x in fence.get("polygons", ())]
    fences += [(fence["polygon"], 0.0, True)] if fence.get("polygon") else []  # of version 1 of the format
    fences += [([x["circle"]["center"]], x["circle"]["radius"], x["inclusion"]) for x in fence.get("circles", ())]
    return commands, Origin(*map(float, mission["plannedHomePosition"][:2])), fences


def _simple(items: list[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """The items of a plan, and those that its surveys consist of."""
    for item in items:
        if item["type"] == "SimpleItem":
            yield item
        else:
            yield from _simple(item["TransectStyleComplexItem"]["Items"])


def _of_waypoints(text: str) -> tuple[list[Waypoint], Origin]:
    """Commands of a file of Mission Planner, and its home: the first line."""
    rows = [line.split() for line in text.splitlines()[1:] if line.strip()]
    wrong = next((k for k, row in enumerate(rows, 2) if len(row) != 12), None if rows else 2)
    refuse(ConfigError, (wrong, f"line {wrong} has not 12 numbers: number, current, frame, command, four parameters, "
                                "latitude, longitude, altitude, autocontinue; the first line is home"))  # fmt: skip
    home, *rest = (Waypoint(int(r[0]), int(r[3]), int(r[2]), *map(float, r[8:11])) for r in rows)
    return rest, Origin(home.latitude, home.longitude)


def _flown(commands: list[Waypoint], home: Origin, fences: Sequence[GeoFence] = ()) -> Route:
    """The route of a mission: its waypoints up to a return or a landing, and its geofences."""
    end = next((k for k, one in enumerate(commands) if one.command in ENDS), len(commands))
    told = [one for one in commands[:end] if one.command not in (TAKEOFF, VTOL_TAKEOFF)]
    found = [one for one in told if one.command in (WAYPOINT, SPLINE)]
    other = next((one for one in told if one.command == JUMP or one.command in NAVIGATION and one not in found), None)
    frames = {one.frame: one.number for one in found}
    terrain = next((frame for frame in frames if frame not in ALTITUDE), None)
    refuse(
        ConfigError,
        (
            other,
            f"item {other and other.number} is command {other and other.command} (of MAV_CMD), which no track can do: "
            f"allowed are waypoints ({WAYPOINT}, {SPLINE}), takeoff, return, landing",
        ),
        (
            terrain is not None or len({ALTITUDE.get(frame) for frame in frames}) > 1,
            "altitudes must all be above mean sea level (frame 0) or all above home (3), not over terrain; there are "
            + ", ".join(f"frame {frame} in item {number}" for frame, number in frames.items()),
        ),
    )
    place = np.array([(one.latitude, one.longitude, one.height) for one in found]).reshape(-1, 3)
    route = _geographic(place)
    assert route.origin is not None
    away = float(np.linalg.norm(from_geodetic(np.array((*home, 0.0)), route.origin)))
    refuse(
        ConfigError,
        (
            away > FARTHEST,
            f"home, {home[0]:g} {home[1]:g}, is {away / 1e3:.0f} km from the waypoints (allowed: {FARTHEST / 1e3:g}): "
            "the plan is of another place",
        ),
    )
    return route._replace(fences=tuple(_fenced(fence, route.origin) for fence in fences))


def _fenced(fence: GeoFence, origin: Origin) -> Fence:
    """A geofence about `origin`; circles become polygons of the same area."""
    places, radius, inside = fence
    corners = from_geodetic(np.array([(*place, 0.0) for place in places], float), origin)[:, 1::-1]
    if radius:
        angle = 2 * np.pi * np.arange(AROUND) / AROUND
        radius *= math.sqrt(2 * np.pi / AROUND / math.sin(2 * np.pi / AROUND))
        corners = corners + radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
    return Fence(torch.from_numpy(corners.copy()).float(), inside)


def _of_table(path: Path) -> Route:
    """Waypoints of a CSV file: latitude, longitude (deg), or north, east (m); altitude (m) if given."""
    sheet = Sheet(path)
    ways = (("latitude", "longitude", "degrees"), ("lat", "lon", "degrees"), ("north", "east", "length"))
    way = next((w for w in ways if sheet.find(w[0]) and sheet.find(w[1])), None)
    refuse(
        ConfigError,
        (
            way is None,
            f"columns are {', '.join(sheet.header) or 'none'}; expected latitude and longitude (deg), or north and "
            "east (m), and altitude if there is one; or a .plan of QGroundControl, .waypoints of Mission Planner",
        ),
    )
    assert way is not None
    columns = [sheet.numbers(column, way[2]) for name in way[:2] if (column := sheet.find(name))]
    altitude = sheet.find("altitude")
    height = sheet.numbers(altitude, "length") if altitude else np.full(len(sheet.rows), np.nan)
    if way[2] == "degrees":
        return _geographic(np.column_stack((*columns, height)))
    return _centred(np.column_stack(columns), height, None)


def _geographic(place: Array) -> Route:
    """The route through places [n, 3]: latitude, longitude (deg), height (m)."""
    wrong = ~((np.abs(place[:, 0]) < 90) & (np.abs(place[:, 1]) <= 180) & (np.abs(place[:, :2]).sum(1) > 1e-9))
    told = "; ".join(f"waypoint {k + 1} is at {place[k, 0]:g} {place[k, 1]:g}" for k in np.flatnonzero(wrong)[:1])
    refuse(
        ConfigError,
        (len(place) == 0, "there is no waypoint"),
        (wrong.any(), f"{told}: latitude and longitude in degrees are needed, not 0 0"),
    )
    origin = Origin(*((place.min(0) + place.max(0)) / 2)[:2])
    east, north, _ = from_geodetic(np.nan_to_num(place * (1.0, 1.0, 0.0)), origin).T
    return _centred(np.column_stack((north, east)), place[:, 2], origin)


def _centred(place: Array, height: Array, origin: Origin | None) -> Route:
    """The route through `place` [n, 2] (m), without repeated waypoints."""
    new = np.linalg.norm(place - np.roll(place, 1, axis=0), axis=1) > SAME
    place, height = place[new], height[new]
    refuse(ConfigError, (len(place) < 3, f"a closed track needs three waypoints apart, not {len(place)}"))
    middle = (place.min(0) + place.max(0)) / 2
    if origin is not None:
        origin = Origin(*geodetic(np.array((middle[1], middle[0], 0.0)), origin)[:2])
    return Route(place - middle, height, origin)
