"""Arrows: the loads on each vehicle, and current and wind at the formation. Their scales stand in the entities' names.

All loads of a team share one scale, so that their arrows compare. On a boat they are drawn above the deck, over the
places where they attack, for under water nothing would be seen of them.
"""

import numpy as np
import rerun as rr

from taichi_sim.recording.episode import Array, Episode, TeamTrack
from taichi_sim.recording.frames import enu
from taichi_sim.recording.palette import CURRENT, LOADS, WIND, Colour
from taichi_sim.recording.space import line_lift
from taichi_sim.recording.stream import Stream

SHOWN = 0.95  # quantile over time of the greatest load of the team
LOAD_LENGTHS = 1.5  # vehicle lengths, at most, that it is drawn long
RAISE = 0.14  # of the length: how far above the deck a load is drawn that attacks at the waterline
THICK = 0.016  # radius of an arrow, of the length
FLOW_LENGTHS = 1.5  # vehicle lengths that the strongest current or wind is long
ASTERN = 1.6  # vehicle lengths behind the leader, by the course at the start, which is what the view keeps
STILL = 1e-3  # m/s; slower water or air is no flow


def round_scale(per_metre: float) -> float:
    """The next greater number among 1, 2 and 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(per_metre))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= per_metre * (1 - 1e-9)))


def newtons_per_metre(team: TeamTrack) -> float | None:
    """Scale of a team's load arrows, or None if nothing ever acts."""
    norms = [np.linalg.norm(force.vector_b, axis=-1) for force in team.forces.values()]
    greatest = float(np.nanquantile(np.max(norms, axis=(0, 2)), SHOWN)) if norms else 0.0
    return round_scale(greatest / (LOAD_LENGTHS * team.size_m[0])) if greatest > 0.0 else None


def load_colours(team: TeamTrack) -> dict[str, str]:
    """The name of a colour for each force; names that begin alike up to the first "_" share it."""
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
    for name, flow, _ in _flows(episode):
        speed = np.linalg.norm(flow, axis=-1)
        lines.append(f"{name} arrow: {speed.min():.1f} to {speed.max():.1f} m/s")
    return "".join(f"- {line}\n" for line in lines) + ("\n" if lines else "")


def _deck(team: TeamTrack) -> float:
    """Height (m) of a boat's deck above its reference point."""
    return 0.5 * team.size_m[2] if team.body is None else -float(np.min(team.body.vertices_b[:, 2]))


def send_forces(stream: Stream, team: TeamTrack) -> None:
    """An arrow for each force on each vehicle, in the vehicle's frame. A force that never acts has none."""
    scale = newtons_per_metre(team)
    if scale is None:
        return
    length, colours = team.size_m[0], load_colours(team)
    up = _deck(team) + RAISE * length if team.name == "usv" else 0.0
    for name, force in team.forces.items():
        if not np.any(force.vector_b):
            continue
        x, y, z = force.origin_b
        arrow = rr.Arrows3D.from_fields(
            origins=[[x, y, z - up]], colors=LOADS[colours[name]], radii=THICK * length, labels=name.replace("_", " "),
            show_labels=False,
        )  # fmt: skip
        for vehicle in range(team.vehicles):
            path = f"world/{team.name}/vehicle_{vehicle}/forces_1m_is_{scale:g}N/{name}"
            stream.static(path, arrow)
            vector = np.ascontiguousarray(force.vector_b[:, vehicle] / scale, np.float32)
            stream.columns(path, rr.Arrows3D.columns(vectors=vector))


def _flows(episode: Episode) -> list[tuple[str, Array, Colour]]:
    """Name, velocity [T, 3] (m/s, n) and colour of what flows."""
    flows = []
    for name, flow, colour in (("current", episode.current_n, CURRENT), ("wind", episode.wind_n, WIND)):
        if flow is not None and np.nanmax(np.linalg.norm(flow, axis=-1)) > STILL:
            flows.append((name, np.pad(flow, ((0, 0), (0, 3 - flow.shape[1]))), colour))
    return flows


def send_flow(stream: Stream, episode: Episode) -> None:
    """Current and wind beside the leader of the team afloat, each with its own scale and its speed as a label."""
    team = episode.afloat
    length, course = team.size_m[0], float(team.target_course[0])
    for name, flow, colour in _flows(episode):
        speed = np.linalg.norm(flow, axis=-1)
        scale = round_scale(float(np.nanmax(speed)) / (FLOW_LENGTHS * length))
        height = length if name == "wind" else 0.1 * length + line_lift(episode)
        vector = flow / scale
        path = f"world/{team.name}/follow/{name}_1m_is_{scale:g}m_s"
        stream.static(path, rr.Arrows3D.from_fields(colors=colour, radii=1.6 * THICK * length, show_labels=True))
        # its middle is behind the leader, towards the eye: it passes by, it does not push
        origin = enu(-0.5 * vector + [-ASTERN * length * np.cos(course), -ASTERN * length * np.sin(course), -height])
        labels = [f"{name} {value:.1f} m/s" for value in speed]
        stream.columns(path, rr.Arrows3D.columns(vectors=enu(vector), origins=origin, labels=labels))
