"""Arrows for the loads on each vehicle, the velocities of aircraft, and current and wind at the formation.

Their scales are in the entities' names. All loads of a team share one scale, so that their arrows compare. A boat's
loads are drawn above the deck over their points of attack, because water would hide them. An aircraft's velocities form
the wind triangle: velocity through the air from its centre of mass, then the wind; their sum is the velocity over
ground.
"""

import numpy as np
import rerun as rr

from taichi_sim.visualisation.recording.east_north_up import enu, map_point
from taichi_sim.visualisation.recording.episode import Array, Episode, TeamTrack
from taichi_sim.visualisation.recording.palette import AIRSPEED, BORESIGHT, CURRENT, GROUND_SPEED, LOADS, WIND, Colour
from taichi_sim.visualisation.recording.rerun_stream import Stream
from taichi_sim.visualisation.recording.static_scene import line_lift, map_bounds

SHOWN = 0.95  # quantile over time of the team's largest load; sets the scale
LOAD_LENGTHS = 1.5  # length of the arrow of that load, in vehicle lengths
RAISE = 0.14  # height above the deck of a load at the waterline, in vehicle lengths
THICK = 0.016  # radius of an arrow over the vehicle's length
FLOW_LENGTHS = 1.5  # length of the strongest current's or wind's arrow, in vehicle lengths
ASTERN = 1.6  # vehicle lengths behind the first vehicle, against its initial course, where current and wind are drawn
SPEED_SPANS = 2.5  # length of an aircraft's greatest velocity, in wing spans
MAP_SHARE = 0.12  # length of the wind's arrow on the map over the map's shorter side
STILL = 1e-3  # m/s: slower water or air counts as still


def round_scale(per_metre: float) -> float:
    """The smallest of 1, 2 and 5 times a power of ten that is not below `per_metre`."""
    power = 10.0 ** np.floor(np.log10(per_metre))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= per_metre * (1 - 1e-9)))


def newtons_per_metre(team: TeamTrack) -> float | None:
    """Scale of a team's load arrows, or None if no load ever acts."""
    norms = [np.linalg.norm(force.vector_b, axis=-1) for force in team.forces.values()]
    greatest = float(np.nanquantile(np.max(norms, axis=(0, 2)), SHOWN)) if norms else 0.0
    return round_scale(greatest / (LOAD_LENGTHS * team.size_m[0])) if greatest > 0.0 else None


def load_colours(team: TeamTrack) -> dict[str, str]:
    """Colour name of each force; names that agree up to the first "_" share it."""
    kinds = list(dict.fromkeys(name.split("_")[0] for name in team.forces))
    shades = list(LOADS)
    return {name: shades[kinds.index(name.split("_")[0]) % len(shades)] for name in team.forces}


def arrow_text(episode: Episode) -> str:
    """Markdown that explains the arrows; empty if there are none."""
    lines = []
    for team in episode.teams.values():
        scale = newtons_per_metre(team)
        if scale is not None:
            names = ", ".join(f"{name.replace('_', ' ')} ({hue})" for name, hue in load_colours(team).items())
            lines.append(f"{team.name.upper()} load arrows, 1 m is {scale:g} N: {names}")
        if team.air_n is not None:
            scale, whose = metres_per_second_per_metre(team), team.name.upper()
            lines.append(
                f"{whose} velocity arrows, 1 m is {scale:g} m/s: airspeed (blue) and wind (yellow) make that over "
                "ground (green); the thin red line is where the nose points"
            )
    for name, flow, *_ in _flows(episode):
        speed = np.linalg.norm(flow, axis=-1)
        lines.append(f"{name}: {speed.min():.1f} to {speed.max():.1f} m/s")
    return "".join(f"- {line}\n" for line in lines) + ("\n" if lines else "")


def send_forces(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send an arrow for each force on each vehicle, in the vehicle's frame; a force that never acts has none."""
    scale = newtons_per_metre(episode.whole.teams[team.name])
    if scale is None:
        return
    length, colours = team.size_m[0], load_colours(team)
    deck = 0.5 * team.size_m[2] if team.body is None else -float(np.min(team.body.vertices_b[:, 2]))  # height, m
    up = deck + RAISE * length if team.on_water else 0.0
    for name, force in team.forces.items():
        root = f"world/{team.name}/vehicle_{{}}/forces_1m_is_{scale:g}N/{name}"
        if not (stream.has(root.format(0)) or np.any(force.vector_b)):
            continue
        x, y, z = force.origin_b
        arrow = rr.Arrows3D.from_fields(
            origins=[[x, y, z - up]], colors=LOADS[colours[name]], radii=THICK * length, labels=name.replace("_", " "),
            show_labels=False,
        )  # fmt: skip
        for vehicle in range(team.vehicles):
            path = root.format(vehicle)
            stream.static(path, arrow)
            vector = np.ascontiguousarray(force.vector_b[:, vehicle] / scale, np.float32)
            stream.columns(path, rr.Arrows3D.columns(vectors=vector))


def metres_per_second_per_metre(team: TeamTrack) -> float:
    """Scale of an aircraft's velocity arrows."""
    greatest = float(np.nanquantile(np.linalg.norm(team.velocity_n, axis=-1), SHOWN))
    return round_scale(max(greatest, STILL) / (SPEED_SPANS * team.size_m[1]))


def send_air(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send each aircraft's wind triangle and a line along its nose.

    The angle of attack is the angle between that line and the airspeed.
    """
    if team.air_n is None:
        return
    whole = episode.whole.teams[team.name]
    scale, thick = metres_per_second_per_metre(whole), THICK * team.size_m[0]
    through_air = team.velocity_n - team.air_n
    fastest = through_air if whole.air_n is None else whole.velocity_n - whole.air_n
    nose = float(np.nanmax(np.linalg.norm(fastest, axis=-1))) / scale
    for vehicle in range(team.vehicles):
        line = rr.LineStrips3D([[[0.0, 0.0, 0.0], [nose, 0.0, 0.0]]], colors=BORESIGHT, radii=0.4 * thick)
        stream.static(f"world/{team.name}/vehicle_{vehicle}/nose", line)
    start, names = team.position_n, [team.vehicle_name(vehicle) for vehicle in range(team.vehicles)]
    for name, foot, vector, colour in (
        ("airspeed", start, through_air, AIRSPEED),
        ("wind", start + through_air / scale, team.air_n, WIND),
        ("ground speed", start, team.velocity_n, GROUND_SPEED),
    ):
        path = f"world/{team.name}/velocity_1m_is_{scale:g}m_s/{name.replace(' ', '_')}"
        stream.static(path, rr.Arrows3D.from_fields(colors=colour, radii=2.0 * thick, show_labels=False))
        speeds = np.linalg.norm(vector, axis=-1)
        labels = [f"{who}: {name} {speed:.1f} m/s" for step in speeds for who, speed in zip(names, step, strict=True)]
        arrow = rr.Arrows3D.columns(
            vectors=enu(vector / scale).reshape(-1, 3), origins=enu(foot).reshape(-1, 3), labels=labels
        )
        stream.columns(path, arrow.partition([team.vehicles] * len(start)))


def _flows(episode: Episode) -> list[tuple[str, Array, Colour, float]]:
    """Name, velocity [T, 3] (m/s, n), colour and greatest speed (m/s) of current and wind."""
    flows = []
    for name, field, colour in (("current", "current_n", CURRENT), ("wind", "wind_n", WIND)):
        flow, whole = getattr(episode, field), getattr(episode.whole, field)
        strongest = 0.0 if whole is None else float(np.nanmax(np.linalg.norm(whole, axis=-1)))
        if flow is not None and strongest > STILL:
            flows.append((name, np.pad(flow, ((0, 0), (0, 3 - flow.shape[1]))), colour, strongest))
    return flows


def send_flow(stream: Stream, episode: Episode) -> None:
    """Send current and wind at 10 m beside the first boat, each with a scale and a label, and the wind on the map."""
    _send_wind_on_map(stream, episode)
    team = episode.whole.afloat
    if not team.on_water:
        return  # aircraft show their own wind
    length, course = team.size_m[0], float(team.course[0])
    for name, flow, colour, strongest in _flows(episode):
        scale = round_scale(strongest / (FLOW_LENGTHS * length))
        height = length if name == "wind" else 0.1 * length + line_lift(episode)
        vector = flow / scale
        path = f"world/{team.name}/follow/{name}_1m_is_{scale:g}m_s"
        stream.static(path, rr.Arrows3D.from_fields(colors=colour, radii=1.6 * THICK * length, show_labels=True))
        # centred behind the first vehicle, towards the eye, so that the arrow does not seem to push it
        origin = enu(-0.5 * vector + [-ASTERN * length * np.cos(course), -ASTERN * length * np.sin(course), -height])
        stream.columns(path, rr.Arrows3D.columns(vectors=enu(vector), origins=origin, labels=_speeds(name, flow)))


def _send_wind_on_map(stream: Stream, episode: Episode) -> None:
    """Send the wind at 10 m, in the map's north-west corner."""
    low, high = map_bounds(episode)
    side = float(np.min(high - low))
    middle = map_point(np.array([high[0] - MAP_SHARE * side, low[1] + MAP_SHARE * side]))
    for name, flow, colour, strongest in _flows(episode):
        if name == "wind":
            vector = map_point(flow) * (MAP_SHARE * side / strongest)
            look = rr.Arrows2D.from_fields(colors=colour, radii=-2.5, show_labels=True, draw_order=60.0)
            stream.static("map/wind", look)
            row = rr.Arrows2D.columns(vectors=vector, origins=middle - 0.5 * vector, labels=_speeds(name, flow))
            stream.columns("map/wind", row)


def _speeds(name: str, flow: Array) -> list[str]:
    return [f"{name} {speed:.1f} m/s" for speed in np.linalg.norm(flow, axis=-1)]
