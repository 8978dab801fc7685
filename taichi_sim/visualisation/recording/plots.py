"""Plots of one team: one entity per plot, its lines named and coloured."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from taichi_sim.kernels.conventions import HEADING
from taichi_sim.visualisation.recording.east_north_up import euler
from taichi_sim.visualisation.recording.episode import Array, Episode, TeamTrack
from taichi_sim.visualisation.recording.palette import FOLLOWERS, TARGET, Colour
from taichi_sim.visualisation.recording.rerun_stream import Stream

OTHERS = "others"  # suffix of a plot with the lines of all vehicles but the first
FAINT = 200  # grey of which the lines of an episode beside the main one have a half
DEGREES = {"rad": ("deg", float(np.degrees(1.0)))}  # unit -> as shown, factor


def send_plot(stream: Stream, path: str, values: Array, names: list[str], colours: list[Colour]) -> None:
    """Send values [T, K] as K lines."""
    names = [f"{stream.caption} {name}".lstrip() for name in names]
    if stream.faint:
        colours = [((r + FAINT) // 2, (g + FAINT) // 2, (b + FAINT) // 2) for r, g, b in colours]
    lines = rr.SeriesLines(names=names, colors=colours, widths=[1.5] * len(names))
    stream.static(path, lines)
    flat = np.array(values, dtype=np.float64).reshape(-1)
    stream.columns(path, rr.Scalars.columns(scalars=flat).partition([len(names)] * len(stream.ns)))


def as_shown(lines: Sequence[str], unit: str) -> tuple[list[str], float]:
    """Line names with the unit in which they are plotted, and the factor from SI to it."""
    unit, factor = DEGREES.get(unit, (unit, 1.0))
    names = [line.replace("_", " ") for line in lines]
    return [f"{name} ({unit})" for name in names] if unit else names, factor


def send_plots(stream: Stream, episode: Episode, team: TeamTrack) -> None:
    """Send the plots of a team: errors (m) and reward if it has a mission, heading (deg) of the first vehicle, signals
    and actions of each vehicle.
    """
    name, everyone = team.name, range(team.vehicles)
    names = [team.vehicle_name(vehicle) for vehicle in everyone]
    livery = episode.liveries[name]
    colours = [livery.of(vehicle) for vehicle in everyone]
    for path, of in error_plots(team).items():
        assert team.error_m is not None
        send_plot(stream, f"plots/{path}/{name}", team.error_m[:, of], names[of], colours[of])
    if team.reward is not None:
        send_plot(stream, f"plots/reward/{name}", team.reward, names, colours)
    lines, headings = _headings(stream, team)
    send_plot(stream, f"plots/heading/{name}", headings, lines, [livery.first, TARGET][: len(lines)])
    of_each = [vehicle_plots(team, vehicle) for vehicle in everyone]
    for path, (labels, first) in of_each[0].items():
        send_plot(stream, f"plots/{path}/first", first, labels, _shades(colours[0], len(labels)))
        if team.vehicles > 1:
            lines = [f"{label}, {who}" for who in names[1:] for label in labels]
            shades = [shade for colour in colours[1:] for shade in _shades(colour, len(labels))]
            values = np.concatenate([plots[path][1] for plots in of_each[1:]], axis=1)
            send_plot(stream, f"plots/{path}/{OTHERS}", values, lines, shades)


def _shades(colour: Colour, lines: int) -> list[Colour]:
    """Colours of the lines of a vehicle whose colour is `colour`."""
    shades = [colour, *(shade for shade in FOLLOWERS if shade != colour)]
    return [shades[line % len(shades)] for line in range(lines)]


def error_plots(team: TeamTrack) -> dict[str, slice]:
    """Plots of the team's errors: path -> its vehicles. A leader's errors differ in size from followers'."""
    if team.error_m is None:
        return {}
    if team.slot_n is None or team.vehicles == 1:
        return {"tracking_error": slice(None)}
    return {"tracking_error": slice(0, 1), "formation_error": slice(1, None)}


def _headings(stream: Stream, team: TeamTrack) -> tuple[list[str], Array]:
    """Names and values [T, K] of the first vehicle's heading and its target's course, without jumps by 360."""
    heading = np.degrees(euler(team.quaternion_nb[:, 0])[HEADING])
    if team.target_course is None:
        return ["heading (deg)"], _unwrapped(stream, team, heading)[:, None]
    course = _unwrapped(stream, team, np.degrees(team.target_course))
    heading = course + (heading - course + 180.0) % 360.0 - 180.0  # on the turn nearest to the target's course
    return ["heading (deg)", "target course (deg)"], np.stack([heading, course], axis=1)


def _unwrapped(stream: Stream, team: TeamTrack, angle: Array) -> Array:
    """Angles [T] (deg) without jumps by 360, continuing the part before."""
    key = f"plots/heading/{team.name}"
    begin = stream.memory.get(key, angle[0])
    on = np.unwrap(np.append(begin, angle), period=360.0)[1:]
    stream.memory[key] = on[-1]
    return np.asarray(on, dtype=np.float64)


def vehicle_plots(team: TeamTrack, vehicle: int) -> dict[str, tuple[list[str], Array]]:
    """Plots of one vehicle: path -> names of K lines with their units, values [T, K]."""
    roll, pitch, _ = (np.degrees(angle) for angle in euler(team.quaternion_nb[:, vehicle]))
    plots = {f"attitude/{team.name}": (["roll (deg)", "pitch (deg)"], np.stack([roll, pitch], axis=1))}
    height = -team.position_n[:, vehicle, 2:]
    if team.on_water:
        heave = np.concatenate([height, team.wave_height[:, vehicle, None]], axis=1)
        plots[f"heave/{team.name}"] = (["heave (m)", "wave (m)"], heave)
    elif team.slot_n is None:
        plots[f"altitude/{team.name}"] = (["altitude (m)"], height)
    else:
        altitude = np.concatenate([height, -team.slot_n[:, vehicle, 2:]], axis=1)
        plots[f"altitude/{team.name}"] = (["altitude (m)", "slot (m)"], altitude)
    for name, signal in team.signals.items():
        labels, factor = as_shown(signal.names, signal.unit)
        plots[signal_path(team, name)] = (labels, factor * signal.values[:, vehicle])
    if team.action is not None:
        plots[f"action/{team.name}"] = (list(team.action_names), team.action[:, vehicle])
    return plots


def signal_path(team: TeamTrack, name: str) -> str:
    """Entity path of the plot `name` of a team's signals."""
    return f"signal/{team.name}/{name.replace(' ', '_')}"
