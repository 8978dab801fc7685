"""The plots of one team: an entity per plot, its lines named and coloured."""

import numpy as np
import rerun as rr

from taichi_sim.recording.episode import Array, TeamTrack
from taichi_sim.recording.frames import euler
from taichi_sim.recording.palette import FOLLOWERS, LEADERS, TARGET, Colour, vehicle_colour, vehicle_name
from taichi_sim.recording.stream import Stream

DEGREES = {"rad": ("deg", float(np.degrees(1.0)))}  # unit -> as shown, factor


def send_plot(stream: Stream, path: str, values: Array, names: list[str], colours: list[Colour]) -> None:
    """Values [T, K] as K lines."""
    lines = rr.SeriesLines(names=names, colors=colours, widths=[1.5] * len(names))
    stream.static(path, lines)
    flat = np.array(values, dtype=np.float64).reshape(-1)
    stream.columns(path, rr.Scalars.columns(scalars=flat).partition([len(names)] * len(stream.ns)))


def send_plots(stream: Stream, team: TeamTrack) -> None:
    """Errors (m) and reward of the team; heading (deg) of the leader; what each vehicle does."""
    name, everyone = team.name, range(team.vehicles)
    names = [vehicle_name(name, vehicle) for vehicle in everyone]
    colours = [vehicle_colour(name, vehicle) for vehicle in everyone]
    send_plot(stream, f"plots/tracking_error/{name}", team.error_m[:, :1], names[:1], colours[:1])
    if team.vehicles > 1:
        send_plot(stream, f"plots/formation_error/{name}", team.error_m[:, 1:], names[1:], colours[1:])
    send_plot(stream, f"plots/reward/{name}", team.reward, names, colours)
    heading = np.degrees(euler(team.quaternion_nb[:, 0])[2])
    course = np.degrees(np.unwrap(team.target_course))
    # heading on the turn nearest to the target's course, so that neither line jumps by 360 degrees
    heading = course + (heading - course + 180.0) % 360.0 - 180.0
    lines = ["heading (deg)", "target course (deg)"]
    send_plot(stream, f"plots/heading/{name}", np.stack([heading, course], axis=1), lines, [LEADERS[name], TARGET])
    for vehicle in everyone:
        for path, (labels, values) in vehicle_plots(team, vehicle).items():
            whose = "" if vehicle == 0 else f", {names[vehicle]}"
            shades = [colours[vehicle], *(shade for shade in FOLLOWERS if shade != colours[vehicle])]
            shades = [shades[line % len(shades)] for line in range(len(labels))]
            send_plot(
                stream, f"plots/{path}/vehicle_{vehicle}", values, [f"{label}{whose}" for label in labels], shades
            )


def vehicle_plots(team: TeamTrack, vehicle: int) -> dict[str, tuple[list[str], Array]]:
    """The plots that each vehicle has: path -> names of K lines with their units, values [T, K]."""
    roll, pitch, _ = (np.degrees(angle) for angle in euler(team.quaternion_nb[:, vehicle]))
    plots = {f"attitude/{team.name}": (["roll (deg)", "pitch (deg)"], np.stack([roll, pitch], axis=1))}
    if team.name == "usv":
        heave = np.stack([-team.position_n[:, vehicle, 2], team.wave_height[:, vehicle]], axis=1)
        plots[f"heave/{team.name}"] = (["heave (m)", "wave (m)"], heave)
    else:
        height = np.stack([-team.position_n[:, vehicle, 2], -team.slot_n[:, vehicle, 2]], axis=1)
        plots[f"altitude/{team.name}"] = (["altitude (m)", "slot (m)"], height)
    for name, signal in team.signals.items():
        unit, scale = DEGREES.get(signal.unit, (signal.unit, 1.0))
        labels = [f"{line.replace('_', ' ')} ({unit})" if unit else line.replace("_", " ") for line in signal.names]
        plots[signal_path(team, name)] = (labels, scale * signal.values[:, vehicle])
    plots[f"action/{team.name}"] = (list(team.action_names), team.action[:, vehicle])
    return plots


def signal_path(team: TeamTrack, name: str) -> str:
    """Where the plot `name` of a team's signals is filed."""
    return f"signal/{team.name}/{name.replace(' ', '_')}"
