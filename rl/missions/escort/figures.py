"""Plots of an escort: tracks, the approach of the boats, the age of their news, and the training."""

from pathlib import Path
from string import digits

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from rl.evaluation.training_figures import save_figures, training_figures
from rl.mission import Histories
from rl.missions.escort.config import EscortScenario
from taichi_sim.kernels.conventions import EAST, NORTH
from taichi_sim.visualisation.plotting import INK, dress, new_figure, rgb
from taichi_sim.visualisation.recording import Episode
from taichi_sim.visualisation.recording.overlays import Cylinders, Plot

WIDE = 7.6  # inches
MAP_WIDE, ROOM = 0.9 * WIDE, 1.15  # width of the map; height of titles and labels, inches
EVERY = 60.0  # s between two marks on a track
WINDOW = 5.0  # s, of which the oldest age is drawn


def write_escort_figures(
    out: Path, histories: Histories, episode: Episode | None, config: EscortScenario
) -> list[Path]:
    """Write every figure that there are data for into `out`; an old one stays until the new one is complete."""
    figures: dict[str, Figure] = {}
    if episode is not None:
        figures["scene"] = scene_figure(episode, config)
        figures["approach"] = approach_figure(episode, config)
    return save_figures(out, figures | training_figures(histories, episode))


def scene_figure(episode: Episode, config: EscortScenario) -> Figure:
    """Map of the tracks of vessel, boats and aircraft, with marks each minute, and of obstacles."""
    parts = config.escort
    low, high = _reach(episode, parts.aircraft)
    tall = (high[0] - low[0]) / (high[1] - low[1])
    figure = new_figure(WIDE, min(max(MAP_WIDE * tall, 0.3 * WIDE), 1.5 * WIDE) + ROOM, "An escort from above")
    axes = figure.subplots()
    step = max(1, round(EVERY / float(episode.time_s[1] - episode.time_s[0])))
    for name, team in episode.teams.items():
        flies, width = name == parts.aircraft, 2.6 if name == parts.vessel else 1.4
        for vehicle in range(team.vehicles):
            north, east, _ = team.position_n[:, vehicle].T
            colour = INK if name == parts.vessel else rgb(episode.liveries[name].of(vehicle))
            label = name if vehicle == 0 else None
            axes.plot(
                east, north, color=colour, linewidth=0.7 if flies else width, alpha=0.35 if flies else 1.0, label=label
            )
            if not flies:
                axes.plot(east[::step], north[::step], "o", color=colour, markersize=5 if name == parts.vessel else 3)
    for north, east, radius, _ in episode.scene.obstacles:
        axes.add_patch(Circle((east, north), radius, color="#8C4A3A"))
    for overlay in episode.overlays:
        if isinstance(overlay, Cylinders):
            axes.plot(overlay.position_n[..., EAST], overlay.position_n[..., NORTH], color="#C47828", linewidth=0.8)
    axes.set_xlim(low[1], high[1])
    axes.set_ylim(low[0], high[0])
    axes.set_aspect("equal")
    dress(axes, f"marks each {EVERY:.0f} s", "east (m)", "north (m)")
    axes.legend(loc="best", framealpha=0.9)
    return figure


def _reach(episode: Episode, flying: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest north and east of the vessels, with a margin."""
    places = np.concatenate([t.position_n[..., :2].reshape(-1, 2) for n, t in episode.teams.items() if n != flying])
    places = places[np.isfinite(places).all(axis=1)]
    margin = 60.0
    return places.min(axis=0) - margin, places.max(axis=0) + margin


def approach_figure(episode: Episode, config: EscortScenario) -> Figure:
    """Distance of the boats from the vessel and from their slots, and the age of all estimates, over time."""
    parts = config.escort
    figure = new_figure(8.4, 8.0, "How the boats come in, and what is known of the vessel")
    rows = figure.subplots(3, 1, sharex=True)
    boats, vessel, time = episode.teams.get(parts.boats), episode.teams[parts.vessel], episode.time_s
    if boats is not None:
        apart = np.linalg.norm(boats.position_n[..., :2] - vessel.position_n[:, :1, :2], axis=-1)
        for vehicle in range(boats.vehicles):
            colour = rgb(episode.liveries[parts.boats].of(vehicle))
            label = "leader" if vehicle == 0 else f"boat {vehicle}"
            rows[0].plot(time, apart[:, vehicle], color=colour, label=label)
            if boats.error_m is not None:
                rows[1].plot(time, boats.error_m[:, vehicle], color=colour, label=label)
        rows[0].axhline(parts.arrival, color=INK, linewidth=0.8, linestyle="--")
        rows[0].legend(loc="best", framealpha=0.9)
    dress(rows[0], f"(a) distance from the vessel; arrived below {parts.arrival:g} m", "", "m")
    rows[1].set_yscale("log")
    rows[1].set_ylim(bottom=0.1)
    dress(rows[1], "(b) distance from the slot about it", "", "m")
    for overlay in episode.overlays:
        if isinstance(overlay, Plot):
            for name in dict.fromkeys(line.rstrip(digits) for line in overlay.lines):
                ages = overlay.values[:, [line.rstrip(digits) == name for line in overlay.lines]].max(axis=1)
                begins = np.flatnonzero(np.diff(time // WINDOW, prepend=-1.0))
                oldest = np.maximum.reduceat(ages, begins)
                colour = rgb(episode.liveries[name].first) if name in episode.liveries else INK
                rows[2].step(time[begins], oldest, where="post", color=colour, label=name)
            rows[2].legend(loc="best", framealpha=0.9)
    rows[2].set_ylim(bottom=0.0)
    dress(rows[2], f"(c) age of each team's oldest knowledge of the vessel, within {WINDOW:g} s", "time (s)", "s")
    return figure
