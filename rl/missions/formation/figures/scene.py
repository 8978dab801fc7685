"""Fig. 2: the tracks with the checkpoints and the obstacles, from above and from the side."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from taichi_sim.plotting.style import INK, dress, new_figure, rgb
from taichi_sim.recording import Episode

STYLE = {"water": "-", "air": (0, (4, 3))}
WIDE = {"water": 4.0, "air": 1.6}  # tracks may lie one above the other
SEA_COLOUR = "#DCEAF2"
OBSTACLE_COLOUR = "#8C6D5A"


def scene_figure(episode: Episode) -> Figure:
    """The tracks with the checkpoints and the obstacles, from above and from the side (paper, Fig. 2)."""
    scene = episode.scene
    figure = new_figure(9.0, 11.6, f"Tracks, checkpoints and obstacles: {episode.name}")
    top, side = figure.subplots(2, 1, gridspec_kw={"height_ratios": [3.2, 1]})
    half = _extent(episode)
    top.set_facecolor(SEA_COLOUR)
    for north, east, radius, _ in scene.obstacles:
        top.add_patch(Circle((east, north), radius, color=OBSTACLE_COLOUR, zorder=3))
    if len(scene.obstacles):
        label = f"{len(scene.obstacles)} obstacles"
        top.plot([], [], "o", color=OBSTACLE_COLOUR, label=label)
        top.scatter(scene.obstacles[:, 1], scene.obstacles[:, 0], s=7, color=OBSTACLE_COLOUR, zorder=3)
    for name, track in scene.tracks_n.items():
        length = float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())
        medium = episode.teams[name].medium
        top.plot(
            track[:, 1], track[:, 0], color=rgb(episode.liveries[name].first), linestyle=STYLE[medium],
            linewidth=WIDE[medium], zorder=4, label=f"{name.upper()} track, {length:.0f} m",
        )  # fmt: skip
    for number, (north, east) in enumerate(scene.checkpoints_n, start=1):
        top.plot(east, north, "o", markersize=12, markerfacecolor="white", markeredgecolor=INK, zorder=6)
        top.text(east, north, str(number), ha="center", va="center_baseline", fontsize=7, zorder=7, color=INK)
    area = "" if scene.area_m is None else f"; the area is {scene.area_m:.0f} m square"
    dress(top, f"(a) from above{area}", "east (m)", "north (m)")
    top.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    top.legend(loc="upper right", framealpha=0.95)
    _side_view(side, episode)
    return figure


def _extent(episode: Episode) -> float:
    """Half the side of the square shown, m: what there is to see, within the area."""
    scene = episode.scene
    places = [
        *(track[:, :2] for track in scene.tracks_n.values()), scene.checkpoints_n, scene.obstacles[:, :2],
    ]  # fmt: skip
    half = np.inf if scene.area_m is None else 0.5 * scene.area_m
    return min(half, 1.12 * max(float(np.abs(part).max(initial=50.0)) for part in places))


def _side_view(axes: Axes, episode: Episode) -> None:
    """Heights against east, looking north."""
    scene, half = episode.scene, _extent(episode)
    for _, east, radius, height in scene.obstacles:
        axes.add_patch(Rectangle((east - radius, 0.0), 2 * radius, height, color=OBSTACLE_COLOUR, alpha=0.75, zorder=2))
    ceiling = max([30.0, *(-track[:, 2].min() for track in scene.tracks_n.values()), *scene.obstacles[:, 3:].ravel()])
    for name, track in scene.tracks_n.items():
        up = -track[:, 2]
        colour, style = rgb(episode.liveries[name].first), STYLE[episode.teams[name].medium]
        axes.plot(track[:, 1], up, color=colour, linestyle=style, linewidth=2.2, zorder=4)
        edge = int(np.argmax(track[:, 1]))
        axes.annotate(
            f"{name.upper()} track, {up.min():.0f} to {up.max():.0f} m" if np.ptp(up) > 1 else f"{name.upper()} track",
            (track[edge, 1], up[edge]), xytext=(0.99, (up[edge] + 0.2 * ceiling) / (1.45 * ceiling)),
            textcoords="axes fraction", ha="right", color=colour, arrowprops={"arrowstyle": "->", "color": colour},
        )  # fmt: skip
    axes.axhspan(-0.1 * ceiling, 0.0, color=SEA_COLOUR, zorder=1)  # pyright: ignore[reportArgumentType]
    dress(axes, "(b) from the side, looking north (heights stretched)", "east (m)", "height (m)")
    axes.set(xlim=(-half, half), ylim=(-0.1 * ceiling, 1.35 * ceiling))
