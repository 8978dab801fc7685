"""Pictures of encounters: a chart of an episode with gaps and offsets over time, and of the training."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from rl.evaluation.training_figures import save_figures, training_figures
from rl.mission import Histories
from rl.missions.encounter.config import EncounterScenario
from rl.missions.encounter.film import COLOURS, HULLS, OFFSETS
from taichi_sim.kernels.conventions import EAST, NORTH
from taichi_sim.visualisation.plotting import INK, dress, new_figure, rgb
from taichi_sim.visualisation.recording import Episode
from taichi_sim.visualisation.recording.overlays import Lines, Plot

WIDE = 7.6  # inches
EVERY = 8  # outlines of a hull along its track


def write_encounter_figures(
    out: Path, histories: Histories, episode: Episode | None, config: EncounterScenario
) -> list[Path]:
    """Write every figure that there are data for into `out`; an old one stays until the new one is complete."""
    figures = {} if episode is None else {"chart": chart(episode, config)}
    return save_figures(out, figures | training_figures(histories, episode))


def chart(episode: Episode, config: EncounterScenario) -> Figure:
    """Tracks and hulls from above, in the colours of their roles, with times; offsets and the gap below."""
    figure = new_figure(WIDE, 1.25 * WIDE, "An encounter")
    above, below = figure.subplots(2, 1, height_ratios=(3, 1))
    own, step = episode.teams[config.encounter.own], max(1, len(episode.time_s) // EVERY)
    shown = []
    for overlay in episode.overlays:
        if not (isinstance(overlay, Lines) and overlay.name.startswith(HULLS)):
            continue
        name = overlay.name.removeprefix(HULLS)
        colour = rgb(dict(COLOURS.values())[name])
        middle = overlay.points_n.mean(axis=2)  # [frame, hull, 3]
        if not np.isfinite(middle).any():
            continue
        shown.append(Line2D([], [], color=colour, label=name))
        for k in range(middle.shape[1]):
            above.plot(middle[:, k, EAST], middle[:, k, NORTH], color=colour, linewidth=1.0)
            for frame in range(0, len(middle), step):
                if np.isfinite(middle[frame, k]).all():
                    outline = overlay.points_n[frame, k][:, [EAST, NORTH]]
                    above.add_patch(Polygon(outline, facecolor=(*colour, 0.35), edgecolor=colour, linewidth=0.8))
    for vehicle in range(own.vehicles):
        north, east = own.position_n[:, vehicle, NORTH], own.position_n[:, vehicle, EAST]
        above.plot(east, north, color=INK, linewidth=1.8)
        above.plot(east[::step], north[::step], "o", color=INK, markersize=4)
        for frame in range(0, len(north), step):
            text, at = f"{episode.time_s[frame] - episode.time_s[0]:.0f} s", (east[frame], north[frame])
            above.annotate(text, at, fontsize=7, color=INK, xytext=(4, 2), textcoords="offset points")
    shown.insert(0, Line2D([], [], color=INK, label="own ship", linewidth=2))
    above.legend(handles=shown, fontsize=8, frameon=False)
    centre = own.position_n[:, 0, :2].mean(axis=0)
    reach = 1.3 * np.abs(own.position_n[:, 0, :2] - centre).max() + config.encounter.clear
    above.set_xlim(centre[1] - reach, centre[1] + reach)
    above.set_ylim(centre[0] - reach, centre[0] + reach)
    above.set_aspect("equal")
    dress(above, "from above", "east (m)", "north (m)")
    time = episode.time_s - episode.time_s[0]
    for overlay in episode.overlays:
        if isinstance(overlay, Plot) and overlay.name == OFFSETS:
            below.plot(time, overlay.values[:, 0], color=INK, label=overlay.lines[0])
            gaps = below.twinx()
            gaps.plot(time, overlay.values[:, 1], color="#D55E00", label=overlay.lines[1])
            gaps.set_ylabel(f"{overlay.lines[1]} (m)", color="#D55E00")
            gaps.set_ylim(0, 4 * config.encounter.clear)
            gaps.axhline(config.encounter.near, color="#D55E00", linewidth=0.6, linestyle=":")
    dress(below, "offset of course and gap", "time (s)", "offset of course (deg)")
    return figure
