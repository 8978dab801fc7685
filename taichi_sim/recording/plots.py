"""The plots of one team: an entity per plot, its lines named and coloured."""

import numpy as np
import rerun as rr

from taichi_sim.recording.episode import Array, TeamTrack
from taichi_sim.recording.frames import euler
from taichi_sim.recording.palette import FOLLOWERS, LEADERS, TARGET, Colour, vehicle_colour, vehicle_name
from taichi_sim.recording.stream import Stream


def send_plot(stream: Stream, path: str, values: Array, names: list[str], colours: list[Colour]) -> None:
    """Values [T, K] as K lines."""
    lines = rr.SeriesLines(names=names, colors=colours, widths=[1.5] * len(names))
    stream.static(path, lines)
    flat = np.array(values, dtype=np.float64).reshape(-1)
    stream.columns(path, rr.Scalars.columns(scalars=flat).partition([len(names)] * len(stream.ns)))


def send_plots(stream: Stream, team: TeamTrack) -> None:
    """Errors (m), reward, wave height (m), attitude and heading (deg), actions."""
    name, everyone = team.name, range(team.vehicles)
    names = [vehicle_name(name, vehicle) for vehicle in everyone]
    colours = [vehicle_colour(name, vehicle) for vehicle in everyone]
    send_plot(stream, f"plots/tracking_error/{name}", team.error_m[:, :1], names[:1], colours[:1])
    if team.vehicles > 1:
        send_plot(stream, f"plots/formation_error/{name}", team.error_m[:, 1:], names[1:], colours[1:])
    send_plot(stream, f"plots/reward/{name}", team.reward, names, colours)
    if name == "usv":
        send_plot(stream, f"plots/wave_height/{name}", team.wave_height, names, colours)
    roll, pitch, heading = (np.degrees(angle) for angle in euler(team.quaternion_nb[:, 0]))
    course = np.degrees(np.unwrap(team.target_course))
    # heading on the turn nearest to the target's course, so that neither line jumps by 360 degrees
    heading = course + (heading - course + 180.0) % 360.0 - 180.0
    pairs = {
        "attitude": ((roll, pitch), ["roll (deg)", "pitch (deg)"], [LEADERS[name], FOLLOWERS[0]]),
        "heading": ((heading, course), ["heading (deg)", "target course (deg)"], [LEADERS[name], TARGET]),
    }
    for plot, (angles, labels, shades) in pairs.items():
        send_plot(stream, f"plots/{plot}/{name}", np.stack(angles, axis=1), labels, shades)
    labels = list(team.action_names)
    shades = [FOLLOWERS[action % len(FOLLOWERS)] for action in range(len(labels))]
    for vehicle in everyone:
        send_plot(stream, f"plots/action/{name}/vehicle_{vehicle}", team.action[:, vehicle], labels, shades)
