"""The seed paper's figures 2 to 6 as PNG files: from a recorded episode, and from the training's history.

Positions are drawn as on a map, east to the right and north up, heights up from mean sea level, in m.
"""

import csv
import math
import os
import uuid
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from taichi_sim.recording import Episode, TeamTrack
from taichi_sim.recording.meshes import BODIES
from taichi_sim.recording.palette import vehicle_colour, vehicle_name

Histories = Mapping[str, Mapping[str, NDArray[np.float64]]]
"""team -> column of progress.csv -> [iterations]."""

APPROACH_S = 20.0  # the start of an episode, which no error is measured in
SMOOTH = 0.05  # width of the smoothing window, as a share of a curve's length
TEAM_COLOUR = {"usv": "#D55E00", "uav": "#8C3CBE"}  # the leaders' colours in a recording
TEAM_STYLE = {"usv": "-", "uav": (0, (4, 3))}
SEA_COLOUR = "#DCEAF2"
OBSTACLE_COLOUR = "#8C6D5A"
INK = "#22313F"
NOT_MEASURED = "#C9CED3"


def read_history(path: Path) -> dict[str, NDArray[np.float64]]:
    """A stage's progress.csv by column; a blank is NaN. Raises ValueError on what is not a number."""
    with Path(path).open(newline="") as file:
        reader = csv.DictReader(file, restval="")
        rows = list(reader)
        names = reader.fieldnames or []
    return {name: np.array([float(row[name]) if row[name] else math.nan for row in rows]) for name in names}


def write_figures(out: Path, histories: Histories, episode: Episode | None) -> list[Path]:
    """Every figure there is something to draw for, into `out`; an old one stays until the new is whole."""
    figures: dict[str, Figure] = {}
    if episode is not None:
        figures["scene"] = scene_figure(episode)
        figures["tracking_error"] = tracking_error_figure(episode)
        figures["formation"] = formation_figure(episode)
    if histories:
        figures["reward"] = reward_figure(histories)
        figures["policy_loss"] = policy_loss_figure(histories)
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    return [_save(figure, out / f"{name}.png") for name, figure in figures.items()]


def _save(figure: Figure, path: Path) -> Path:
    part = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:8]}.part.png")
    try:
        figure.savefig(part, dpi=150)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return path


def _figure(width: float, height: float, title: str) -> Figure:
    """A white page, in inches, drawn by Agg whatever the display."""
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13, fontweight="bold", color=INK)
    return figure


def _rgb(team: str, vehicle: int) -> tuple[float, float, float]:
    red, green, blue = vehicle_colour(team, vehicle)
    return red / 255, green / 255, blue / 255


def _dress(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=11, loc="left", color=INK)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(True, color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


# Fig. 2


def scene_figure(episode: Episode) -> Figure:
    """Both tracks with the checkpoints and the obstacles, from above and from the side (paper, Fig. 2)."""
    scene = episode.scene
    figure = _figure(9.0, 11.6, f"Tracks, checkpoints and obstacles: {episode.name}")
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
        wide = {"usv": 4.0, "uav": 1.6}[name]
        top.plot(
            track[:, 1],
            track[:, 0],
            color=TEAM_COLOUR[name],
            linestyle=TEAM_STYLE[name],
            linewidth=wide,
            zorder=4,
            label=f"{name.upper()} track, {length:.0f} m",
        )
    for number, (north, east) in enumerate(scene.checkpoints_n, start=1):
        top.plot(east, north, "o", markersize=12, markerfacecolor="white", markeredgecolor=INK, zorder=6)
        top.text(east, north, str(number), ha="center", va="center_baseline", fontsize=7, zorder=7, color=INK)
    _dress(top, f"(a) from above; the area is {scene.area_m:.0f} m square", "east (m)", "north (m)")
    top.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
    top.legend(loc="upper right", framealpha=0.95)
    _side_view(side, episode)
    return figure


def _extent(episode: Episode) -> float:
    """Half the side of the square shown, m: what there is to see, within the area."""
    scene = episode.scene
    places = [
        *(track[:, :2] for track in scene.tracks_n.values()),
        scene.checkpoints_n,
        scene.obstacles[:, :2],
    ]
    return min(0.5 * scene.area_m, 1.12 * max(float(np.abs(part).max(initial=50.0)) for part in places))


def _side_view(axes: Axes, episode: Episode) -> None:
    """Heights against east, looking north."""
    scene, half = episode.scene, _extent(episode)
    for _, east, radius, height in scene.obstacles:
        axes.add_patch(
            Rectangle((east - radius, 0.0), 2 * radius, height, color=OBSTACLE_COLOUR, alpha=0.75, zorder=2)
        )
    ceiling = max(
        [30.0, *(-track[:, 2].min() for track in scene.tracks_n.values()), *scene.obstacles[:, 3:].ravel()]
    )
    for name, track in scene.tracks_n.items():
        up = -track[:, 2]
        axes.plot(
            track[:, 1], up, color=TEAM_COLOUR[name], linestyle=TEAM_STYLE[name], linewidth=2.2, zorder=4
        )
        edge = int(np.argmax(track[:, 1]))
        axes.annotate(
            f"{name.upper()} track, {up.min():.0f} to {up.max():.0f} m"
            if np.ptp(up) > 1
            else f"{name.upper()} track",
            (track[edge, 1], up[edge]),
            xytext=(0.99, (up[edge] + 0.2 * ceiling) / (1.45 * ceiling)),
            textcoords="axes fraction",
            ha="right",
            color=TEAM_COLOUR[name],
            arrowprops={"arrowstyle": "->", "color": TEAM_COLOUR[name]},
        )
    axes.axhspan(-0.1 * ceiling, 0.0, color=SEA_COLOUR, zorder=1)
    _dress(axes, "(b) from the side, looking north (heights stretched)", "east (m)", "height (m)")
    axes.set(xlim=(-half, half), ylim=(-0.1 * ceiling, 1.35 * ceiling))


# Figs. 3 and 4


def _smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centred moving mean that steps over NaN."""
    width = max(1, round(SMOOTH * len(values))) | 1
    known = np.isfinite(values)
    window = np.ones(width)
    total = np.convolve(np.where(known, values, 0.0), window, mode="full")[width // 2 :][: len(values)]
    count = np.convolve(known.astype(float), window, mode="full")[width // 2 :][: len(values)]
    return np.where(count > 0, total / np.maximum(count, 1.0), np.nan)


def _history_figure(histories: Histories, column: str, title: str, y: str, zero: bool) -> Figure:
    """`column` of each team's history against the agent steps: as it was, and smoothed."""
    figure = _figure(5.6 * max(1, len(histories)), 4.3, title)
    panels = figure.subplots(1, len(histories), squeeze=False)[0]
    for axes, letter, (team, history) in zip(panels, "abcdefgh", histories.items(), strict=False):
        steps = np.asarray(history["agent_steps"]) / 1e6
        values = np.asarray(history[column])
        known = np.isfinite(values)
        colour = TEAM_COLOUR.get(team, INK)
        if zero:
            axes.axhline(0.0, color=INK, linewidth=0.8)
        axes.plot(
            steps[known], values[known], color=colour, linewidth=0.9, alpha=0.35, label="each iteration"
        )
        axes.plot(steps[known], _smooth(values[known]), color=colour, linewidth=2.2, label="moving mean")
        if len(steps):
            axes.set_xlim(0.0, float(steps[-1]) or 1.0)
        _dress(axes, f"({letter}) {team.upper()} team", "agent steps (millions)", y)
        axes.legend(loc="best", framealpha=0.9)
    return figure


def reward_figure(histories: Histories) -> Figure:
    """Cumulative reward of an episode while training (paper, Fig. 3)."""
    return _history_figure(
        histories,
        "episode_reward",
        "Cumulative reward per episode during training",
        "cumulative reward per episode",
        zero=False,
    )


def policy_loss_figure(histories: Histories) -> Figure:
    """PPO's policy loss while training (paper, Fig. 4)."""
    return _history_figure(histories, "policy_loss", "Policy loss during training", "policy loss", zero=True)


# Fig. 5


def tracking_error_figure(episode: Episode) -> Figure:
    """Distance of each vehicle from its slot over the episode (paper, Fig. 5)."""
    time = np.asarray(episode.time_s) - episode.time_s[0]
    figure = _figure(
        10.0, 3.6 * len(episode.teams) + 0.5, f"Tracking error of leaders and followers: {episode.name}"
    )
    panels = figure.subplots(len(episode.teams), 1, sharex=True, squeeze=False)[:, 0]
    measured = time >= APPROACH_S if time[-1] > APPROACH_S else np.ones(len(time), dtype=bool)
    for axes, letter, team in zip(panels, "ab", episode.teams.values(), strict=False):
        for vehicle in reversed(range(team.vehicles)):
            error = team.error_m[:, vehicle]
            mean = np.nanmean(error[measured]) if np.isfinite(error[measured]).any() else math.nan
            axes.plot(
                time,
                error,
                color=_rgb(team.name, vehicle),
                linewidth=2.0 if vehicle == 0 else 1.2,
                label=f"{vehicle_name(team.name, vehicle)}: mean {mean:.2f} m",
                zorder=5 if vehicle == 0 else 3,
            )
        finite = team.error_m[measured][np.isfinite(team.error_m[measured])]
        ceiling = max(1.0, 1.35 * float(finite.max())) if len(finite) else 1.0
        axes.axvspan(0.0, min(APPROACH_S, time[-1]), color=NOT_MEASURED, alpha=0.5, linewidth=0)
        axes.text(
            0.5 * min(APPROACH_S, time[-1]),
            0.96 * ceiling,
            "approach,\nnot measured",
            ha="center",
            va="top",
            fontsize=8,
            color=INK,
            zorder=6,
        )
        _dress(axes, f"({letter}) {team.name.upper()} team", "", "distance from slot (m)")
        axes.set(xlim=(0.0, time[-1]), ylim=(0.0, ceiling))
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(
            handles[::-1],
            labels[::-1],
            loc="upper left",
            bbox_to_anchor=(1.0, 1.0),
            framealpha=0.9,
            fontsize=8,
        )
    panels[-1].set_xlabel("time (s)")
    return figure


# Fig. 6

VIEWS = (
    ("from behind", 20.0, 205.0, 1.35),
    ("from the side", 14.0, 110.0, 1.35),
    ("from above", 80.0, 180.0, 1.1),
)
"""Title; the eye's elevation (deg); its bearing from the formation (deg, clockwise from the target's course); zoom."""
INSTANTS = (0.3, 0.6, 0.9)  # share of the episode
SEA_POINTS = 70  # per side of the drawn wave surface


def formation_figure(episode: Episode) -> Figure:
    """The formation at three instants, each from another viewpoint, the USVs on their waves (paper, Fig. 6)."""
    teams = list(episode.teams.values())
    figure = _figure(13.5, 4.0 * len(teams) + 0.8, f"Formation from several viewpoints: {episode.name}\n")
    figure.text(
        0.5,
        1.0 - 0.42 / figure.get_figheight(),
        "rings are the slots, the leader's in magenta; distances from the formation's middle",
        ha="center",
        va="top",
        fontsize=9,
        color=INK,
    )
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
    middle = team.slot_n[step].mean(axis=0)
    spread = float(np.abs(team.slot_n[step, :, :2] - middle[:2]).max())
    length = max(team.size_m[:2])
    half = max(1.25 * spread, 2.0 * length) + length
    grow = max(1.0, 0.22 * half / length)
    if team.name == "usv":
        line = np.linspace(-half, half, SEA_POINTS)
        east, north = np.meshgrid(line, line)
        up = episode.elevation(north + middle[0], east + middle[1], time)
        crest = max(0.1, float(np.abs(up).max()))
        axes.plot_surface(
            east,
            north,
            up,
            cmap="ocean",
            vmin=-3.2 * crest,
            vmax=2.2 * crest,
            rcount=SEA_POINTS,
            ccount=SEA_POINTS,
            linewidth=0,
            antialiased=False,
            zorder=1,
        )
    base = 0.0 if team.name == "usv" else -middle[2]
    for vehicle in range(team.vehicles):
        place = team.position_n[step, vehicle] - (middle[0], middle[1], 0.0)
        _body(axes, team, step, vehicle, place, grow)
        slot = team.slot_n[step, vehicle] - (middle[0], middle[1], 0.0)
        height = -slot[2] if team.name == "uav" else float(team.wave_height[step, vehicle])
        angle = np.linspace(0.0, 2.0 * np.pi, 40)
        ring = 0.75 * grow * length
        axes.plot(
            slot[1] + ring * np.cos(angle),
            slot[0] + ring * np.sin(angle),
            height + 0.0 * angle,
            color="#D62778" if vehicle == 0 else _rgb(team.name, vehicle),
            linewidth=1.2,
            zorder=3,
        )
    axes.set(xlim=(-half, half), ylim=(-half, half), zlim=(base - 0.4 * half, base + 0.4 * half))
    axes.set_box_aspect((1.0, 1.0, 0.4), zoom=zoom)
    axes.view_init(elev=elevation, azim=90.0 - bearing - float(np.degrees(team.target_course[step])))
    drawn = f", bodies x{grow:.1f}" if grow > 1.05 else ""
    axes.set_title(f"{team.name.upper()} team {title}, t = {time:.0f} s{drawn}", fontsize=10, color=INK)
    axes.tick_params(labelsize=7, pad=0)
    axes.set_xlabel("east (m)", fontsize=8)
    axes.set_ylabel("north (m)", fontsize=8)
    axes.locator_params(nbins=5)
    if elevation > 60.0:
        axes.set_zticks([])
    else:
        axes.set_zlabel("up (m)", fontsize=8)


def _body(
    axes: Axes3D, team: TeamTrack, step: int, vehicle: int, place: NDArray[np.floating], grow: float
) -> None:
    """The body's triangles at `place` (north, east, down, m), `grow` times too large, lit from above."""
    body = BODIES[team.name](team.size_m, vehicle_colour(team.name, vehicle))
    w, x, y, z = team.quaternion_nb[step, vehicle]
    R_nb = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    corners = (grow * body.vertices_b @ R_nb.T + place)[:, [1, 0, 2]] * (1, 1, -1)
    light = 0.62 - 0.38 * (body.normals_b @ R_nb.T)[::3, 2:]
    colours = np.clip(body.colours[::3] / 255.0 * light, 0.0, 1.0)
    faces = corners.reshape(-1, 3, 3)
    if team.name == "usv":
        dry = faces[:, :, 2].max(axis=1) > team.wave_height[step, vehicle]
        faces, colours = faces[dry], colours[dry]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=colours, zorder=4 + 0.01 * vehicle))
