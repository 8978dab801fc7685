"""The seed paper's figures 2 to 6 as PNG files: from a recorded episode, and from the training's history.

Positions are drawn as on a map, east to the right and north up, heights up from mean sea level, in m.
"""

import math
from pathlib import Path
from string import ascii_lowercase

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from rl.evaluation.training_figures import save_figures, training_figures
from rl.mission import Histories
from taichi_sim.kernels.conventions import DOWN, EAST, NORTH
from taichi_sim.kernels.rotation import numpy_rotation_matrix
from taichi_sim.visualisation.plotting import INK, dress, new_figure, rgb
from taichi_sim.visualisation.recording import Episode, TeamTrack
from taichi_sim.visualisation.recording.bodies import body_mesh
from taichi_sim.visualisation.recording.overlays import Cylinders
from taichi_sim.visualisation.recording.palette import OBSTACLE, TARGET, Livery

STYLE = {"water": "-", "air": (0, (4, 3))}
WIDE = {"water": 4.0, "air": 1.6}  # tracks may lie one above the other
SEA_COLOUR = "#DCEAF2"
OBSTACLE_COLOUR = "#8C6D5A"
NOT_MEASURED = "#C9CED3"
SIDE = 0.3  # height of the side view over its width
MARGIN, LEAST_HALF = 0.06, 50.0  # around what is shown, of its size; half the side of the least square, m
DEEP = 0.2  # of the side view below the sea's level, over the greatest height
VIEWS = (("from behind", 20.0, 205.0, 1.0), ("from the side", 14.0, 110.0, 1.0), ("from above", 80.0, 180.0, 0.95))
"""Title; the eye's elevation (deg) and bearing (deg, clockwise from the target's course); zoom."""
INSTANTS = (0.3, 0.6, 0.9)  # share of the episode
SEA_POINTS = 70  # per side of the drawn wave surface


def write_figures(out: Path, histories: Histories, episode: Episode | None, settle: float = 0.0) -> list[Path]:
    """Write every figure that there are data for into `out`; an old one stays until the new one is complete.

    `settle` (s) at the start of an episode counts for no error.
    """
    figures: dict[str, Figure] = {}
    if episode is not None:
        figures["scene"] = scene_figure(episode)
        figures["tracking_error"] = tracking_error_figure(episode, settle)
        figures["formation"] = formation_figure(episode)
    return save_figures(out, figures | training_figures(histories, episode))


def scene_figure(episode: Episode) -> Figure:
    """The tracks with the checkpoints and the obstacles, from above and from the side (paper, Fig. 2)."""
    scene = episode.scene
    figure = new_figure(9.0, 11.6, f"Tracks, checkpoints and obstacles: {episode.name}")
    top, side = figure.subplots(2, 1, gridspec_kw={"height_ratios": [1, SIDE]})
    middle, half = _extent(episode)
    top.set_facecolor(SEA_COLOUR)
    for north, east, radius, _ in scene.obstacles:
        top.add_patch(Circle((east, north), radius, color=OBSTACLE_COLOUR, zorder=3))
    if len(scene.obstacles):
        label = f"{len(scene.obstacles)} obstacles"
        top.plot([], [], "o", color=OBSTACLE_COLOUR, label=label)
        top.scatter(scene.obstacles[:, EAST], scene.obstacles[:, NORTH], s=7, color=OBSTACLE_COLOUR, zorder=3)
    for name, track in scene.tracks_n.items():
        length = float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())
        medium = episode.teams[name].medium
        top.plot(
            track[:, EAST], track[:, NORTH], color=rgb(episode.liveries[name].first), linestyle=STYLE[medium],
            linewidth=WIDE[medium], zorder=4, label=f"{name.upper()} track, {length:.0f} m",
        )  # fmt: skip
    for number, (north, east) in enumerate(scene.checkpoints_n, start=1):
        top.plot(east, north, "o", markersize=12, markerfacecolor="white", markeredgecolor=INK, zorder=6)
        top.text(east, north, str(number), ha="center", va="center_baseline", fontsize=7, zorder=7, color=INK)
    area = "" if scene.area_m is None else f"; the area is {scene.area_m:.0f} m square"
    dress(top, f"(a) from above{area}", "east (m)", "north (m)")
    (south, west), (far_north, far_east) = middle - half, middle + half
    top.set(xlim=(west, far_east), ylim=(south, far_north), box_aspect=1)
    top.legend(loc="best", framealpha=0.95)
    _side_view(side, episode)
    side.set(xlim=top.get_xlim(), box_aspect=SIDE)
    return figure


def _extent(episode: Episode) -> tuple[NDArray, float]:
    """Middle (north, east) of the square shown, and half its side, m: what there is to see, with a margin."""
    scene = episode.scene
    tracks = (track[:, :2] for track in scene.tracks_n.values())
    places = np.concatenate([*tracks, np.reshape(scene.checkpoints_n, (-1, 2)), scene.obstacles[:, :2]])
    low, high = (places.min(0), places.max(0)) if len(places) else np.zeros((2, 2))
    return 0.5 * (low + high), max(LEAST_HALF, (0.5 + MARGIN) * float((high - low).max()))


def _side_view(axes: Axes, episode: Episode) -> None:
    """Heights against east, looking north."""
    scene = episode.scene
    for _, east, radius, height in scene.obstacles:
        axes.add_patch(Rectangle((east - radius, 0.0), 2 * radius, height, color=OBSTACLE_COLOUR, alpha=0.75, zorder=2))
    heights = [-track[:, DOWN].min() for track in scene.tracks_n.values()]
    ceiling = max([30.0, *heights, *scene.obstacles[:, 3:].ravel()])
    for name, track in scene.tracks_n.items():
        _, east, down = track.T
        up = -down
        colour, style = rgb(episode.liveries[name].first), STYLE[episode.teams[name].medium]
        axes.plot(east, up, color=colour, linestyle=style, linewidth=2.2, zorder=4)
        above = up.max() > 0.5 * ceiling
        axes.annotate(
            f"{name.upper()} track, {up.min():.0f} to {up.max():.0f} m" if np.ptp(up) > 1 else f"{name.upper()} track",
            (0.5 * (east.min() + east.max()), up.max() if above else up.min()), xytext=(0, 6 if above else -6),
            textcoords="offset points", ha="center", va="bottom" if above else "top", color=colour, zorder=5,
        )  # fmt: skip
    axes.axhspan(-DEEP * ceiling, 0.0, color=SEA_COLOUR, zorder=1)  # pyright: ignore[reportArgumentType]
    dress(axes, "(b) from the side, looking north (heights stretched)", "east (m)", "height (m)")
    axes.set(ylim=(-DEEP * ceiling, 1.25 * ceiling))


def tracking_error_figure(episode: Episode, settle: float = 0.0) -> Figure:
    """Distance of each vehicle from its slot over the episode (paper, Fig. 5); the first `settle` (s) do not count."""
    time = np.asarray(episode.time_s) - episode.time_s[0]
    errors = {name: team.error_m for name, team in episode.teams.items() if team.error_m is not None}
    figure = new_figure(10.0, 3.6 * len(errors) + 0.5, f"Tracking error of leaders and followers: {episode.name}")
    panels = figure.subplots(len(errors), 1, sharex=True, squeeze=False)[:, 0]
    measured = time >= settle if time[-1] > settle else np.ones(len(time), dtype=bool)
    for axes, letter, (name, of_team) in zip(panels, ascii_lowercase, errors.items(), strict=False):
        team, livery = episode.teams[name], episode.liveries[name]
        for vehicle in reversed(range(team.vehicles)):
            error = of_team[:, vehicle]
            mean = np.nanmean(error[measured]) if np.isfinite(error[measured]).any() else math.nan
            axes.plot(
                time, error, color=rgb(livery.of(vehicle)), linewidth=2.0 if vehicle == 0 else 1.2,
                label=f"{team.vehicle_name(vehicle)}: mean {mean:.2f} m", zorder=5 if vehicle == 0 else 3,
            )  # fmt: skip
        finite = of_team[measured][np.isfinite(of_team[measured])]
        ceiling = max(1.0, 1.35 * float(finite.max())) if len(finite) else 1.0
        if settle > 0:
            until = min(settle, time[-1])
            axes.axvspan(0.0, until, color=NOT_MEASURED, alpha=0.5, linewidth=0)
            axes.text(
                0.5 * until, 0.96 * ceiling, "approach,\nnot measured", ha="center", va="top", fontsize=8, color=INK,
                zorder=6,
            )  # fmt: skip
        dress(axes, f"({letter}) {name.upper()} team", "", "distance from slot (m)")
        axes.set(xlim=(0.0, time[-1]), ylim=(0.0, ceiling))
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(
            handles[::-1], labels[::-1], loc="upper left", bbox_to_anchor=(1.0, 1.0), framealpha=0.9, fontsize=8,
        )  # fmt: skip
    panels[-1].set_xlabel("time (s)")
    return figure


def formation_figure(episode: Episode) -> Figure:
    """The formation at three instants, each from elsewhere, the boats on their waves (paper, Fig. 6)."""
    teams = [team for team in episode.teams.values() if team.slot_n is not None]
    figure = new_figure(13.5, 4.0 * len(teams) + 0.8, f"Formation from several viewpoints: {episode.name}\n")
    figure.text(
        0.5, 1.0 - 0.42 / figure.get_figheight(),
        "rings are the slots, the leader's in magenta; what is in the way is brown; distances from the middle",
        ha="center", va="top", fontsize=9, color=INK,
    )  # fmt: skip
    for row, team in enumerate(teams):
        for column, (share, view) in enumerate(zip(INSTANTS, VIEWS, strict=True)):
            axes = figure.add_subplot(
                len(teams), len(VIEWS), row * len(VIEWS) + column + 1, projection="3d", computed_zorder=False
            )
            _formation_panel(axes, episode, team, int(share * (len(episode.time_s) - 1)), view)
    return figure


def _formation_panel(
    axes: Axes3D, episode: Episode, team: TeamTrack, step: int, view: tuple[str, float, float, float]
) -> None:
    """One team at one step; x east, y north, z up, from the middle of the formation, m."""
    title, elevation, bearing, zoom = view
    time = float(episode.time_s[step])
    slots, livery = team.places_n[step], episode.liveries[team.name]
    middle = slots.mean(axis=0)
    there = np.concatenate((slots, team.position_n[step]))[:, :2]
    spread = float(np.abs(there - middle[:2]).max())
    length = max(team.size_m[:2])
    half = max(1.25 * spread, 2.0 * length) + length
    grow = max(1.0, 0.22 * half / length)
    if team.on_water:
        line = np.linspace(-half, half, SEA_POINTS)
        east, north = np.meshgrid(line, line)
        up = episode.elevation(north + middle[0], east + middle[1], time)
        crest = max(0.1, float(np.abs(up).max()))
        axes.plot_surface(
            east, north, up, cmap="ocean", vmin=-3.2 * crest, vmax=2.2 * crest, rcount=SEA_POINTS, ccount=SEA_POINTS,
            linewidth=0, antialiased=False, zorder=1,
        )  # fmt: skip
    axes.view_init(elev=elevation, azim=90.0 - bearing - float(np.degrees(team.course[step])))
    base = 0.0 if team.on_water else -middle[2]
    for vehicle in range(team.vehicles):
        place = team.position_n[step, vehicle] - (middle[0], middle[1], 0.0)
        _body(axes, team, step, vehicle, place, grow, livery)
        slot = slots[vehicle] - (middle[0], middle[1], 0.0)
        height = float(team.wave_height[step, vehicle]) if team.on_water else -slot[2]
        angle = np.linspace(0.0, 2.0 * np.pi, 40)
        ring = 0.75 * grow * length
        axes.plot(
            slot[1] + ring * np.cos(angle), slot[0] + ring * np.sin(angle), height + 0.0 * angle,
            color=rgb(TARGET if vehicle == 0 else livery.of(vehicle)), linewidth=1.2, zorder=3,
        )  # fmt: skip
    for cylinder in cylinders(episode, step):
        _outline(axes, cylinder - np.array([middle[0], middle[1], 0.0, 0.0, 0.0]), half, base)
    axes.set(xlim=(-half, half), ylim=(-half, half), zlim=(base - 0.4 * half, base + 0.4 * half))
    axes.set_box_aspect((1.0, 1.0, 0.4), zoom=zoom)  # pyright: ignore[reportArgumentType]
    drawn = f", bodies x{grow:.1f}" if grow > 1.05 else ""
    axes.set_title(f"{team.name.upper()} team {title}, t = {time:.0f} s{drawn}", fontsize=10, color=INK)
    axes.tick_params(labelsize=7, pad=0)
    axes.set_xlabel("east (m)", fontsize=8, labelpad=-2)
    axes.set_ylabel("north (m)", fontsize=8, labelpad=-2)
    axes.locator_params(nbins=5)
    if elevation > 60.0:
        axes.set_zticks([])  # pyright: ignore[reportCallIssue]
    else:
        axes.set_zlabel("up (m)", fontsize=8, labelpad=-4)


def cylinders(episode: Episode, step: int) -> NDArray[np.floating]:
    """Fixed and moving obstacles at one step [n, 5]: north, east, radius, bottom, top, m."""
    stands = np.asarray(episode.scene.obstacles, dtype=float).reshape(-1, 4)
    rows = [np.column_stack((stands[:, :3], np.zeros(len(stands)), stands[:, 3]))]
    for overlay in episode.overlays:
        if isinstance(overlay, Cylinders):
            place, (radius, height) = overlay.position_n[step], overlay.size_m[step].T
            top = -place[:, DOWN] + 0.5 * height
            rows.append(np.column_stack((place[:, :2], radius, top - height, top)))
    found = np.concatenate(rows)
    return found[np.isfinite(found).all(axis=1)]


def _outline(axes: Axes3D, cylinder: NDArray[np.floating], half: float, base: float) -> None:
    """The rings of a cylinder, about the middle, as far as they are in a panel `half` (m) wide about `base` (m)."""
    north, east, radius, bottom, top = cylinder
    low, high = max(bottom, base - 0.4 * half), min(top, base + 0.4 * half)
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    x, y = east + radius * np.cos(angle), north + radius * np.sin(angle)
    seen = (np.abs(x) < half) & (np.abs(y) < half)
    if high < low or not seen.any():
        return
    x, y = np.where(seen, x, np.nan), np.where(seen, y, np.nan)
    for height in (low, high):
        axes.plot(x, y, height + 0.0 * angle, color=rgb(OBSTACLE), linewidth=1.4, zorder=3)
    for k in range(0, len(angle), 6):
        axes.plot([x[k]] * 2, [y[k]] * 2, [low, high], color=rgb(OBSTACLE), linewidth=0.7, zorder=3)


def _body(
    axes: Axes3D, team: TeamTrack, step: int, vehicle: int, place: NDArray[np.floating], grow: float, livery: Livery,
) -> None:  # fmt: skip
    """The body's triangles at `place` (north, east, down, m), `grow` times too large, lit from above."""
    body = body_mesh(team, livery.of(vehicle))
    R_nb = numpy_rotation_matrix(team.quaternion_nb[step, vehicle])
    corners = (grow * body.vertices_b @ R_nb.T + place)[:, [1, 0, 2]] * (1, 1, -1)
    normals = body.normals_b[::3] @ R_nb.T
    light = 0.62 - 0.38 * normals[:, 2:]
    colours = np.clip(body.colours[::3] / 255.0 * light, 0.0, 1.0)
    faces = corners.reshape(-1, 3, 3)
    elev, azim = np.radians([axes.elev, axes.azim])
    eye_n = np.array([np.cos(elev) * np.sin(azim), np.cos(elev) * np.cos(azim), -np.sin(elev)])
    seen = normals @ eye_n > 0.0
    if team.on_water:
        seen &= faces[:, :, DOWN].max(axis=1) > team.wave_height[step, vehicle]
    faces, colours = faces[seen], colours[seen]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=colours, zorder=4 + 0.01 * vehicle))
