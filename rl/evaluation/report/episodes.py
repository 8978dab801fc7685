"""The part of a report on single episodes: the worst, the median, and collisions."""

import shlex

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from rl.evaluation.episode_log import BEFORE, Crash, Excerpt, TeamLog
from rl.evaluation.store import Run, recording_name
from taichi_sim.kernels.conventions import EAST, NORTH
from taichi_sim.visualisation.plotting import INK, rgb
from taichi_sim.visualisation.plotting.page import FAINT, beside, blank, missing, panel, paragraph, svg, text
from taichi_sim.visualisation.recording.palette import ALARM, OBSTACLE, liveries

MARGIN = 60.0  # m around the motion on a map
LINE = {"water": "-", "air": "--"}


def shown_episodes(run: Run) -> str:
    """Maps and time series of the median and the worst episode, with links to their recordings."""
    if not run.shown:
        return missing("No episode to show: the run is not evaluated yet.", run.command("evaluate"))
    order = [name for name in ("median", "worst") if name in run.shown]
    heads = [f"<h3>{name} episode: number {run.shown[name].episode}</h3>{_events(run.shown[name])}" for name in order]
    maps = [_map(name, run.shown[name]) for name in order]
    links = [_recording(run, name) for name in order]
    parts = [f"{head}{drawn}{link}" for head, drawn, link in zip(heads, maps, links, strict=True)]
    return beside(*parts) + _series({name: run.shown[name] for name in order})


def _events(of: Excerpt) -> str:
    lines = [f"{e.time_s:.1f} s: {e.team} {e.vehicle} {e.text}" for e in of.events]
    return paragraph("; ".join(lines) or "No vehicle ended.", "faint")


def _recording(run: Run, name: str) -> str:
    file = recording_name("policy", name)
    if (run.folder / file).is_file():
        line = shlex.join(("rerun", str(run.folder / file)))
        return f'<p>Recording: <a href="{file}">{file}</a>, opened by <code>{text(line)}</code></p>'
    return missing("Not recorded yet.", run.command("play", f"--{name}"))


def _map(name: str, of: Excerpt) -> str:
    """Paths of all vehicles seen from above."""
    figure = blank(5.4, 5.0)
    axes = figure.subplots()
    places = np.concatenate([team.position_n.reshape(-1, 3)[:, :2] for team in of.teams.values()])
    places = places[np.isfinite(places).all(axis=1)]
    low, high = places.min(axis=0), places.max(axis=0)
    middle, half = (low + high) / 2, max(high - low) / 2 + MARGIN
    colours = liveries({team: log.medium for team, log in of.teams.items()})
    for north, east, radius, _ in of.obstacles:
        axes.add_patch(Circle((east, north), radius, color=rgb(OBSTACLE), alpha=0.7, linewidth=0))
    for team, track in of.tracks_n.items():
        if team in colours:
            axes.plot(track[:, EAST], track[:, NORTH], color=rgb(colours[team].track), linewidth=3.0, alpha=0.45)
    for team, log in of.teams.items():
        for vehicle in reversed(range(log.position_n.shape[1])):
            (north, east, _), colour = log.position_n[:, vehicle].T, rgb(colours[team].of(vehicle))
            axes.plot(east, north, LINE[log.medium], color=colour, linewidth=1.2, label=f"{team} {vehicle}")
            axes.plot(east[0], north[0], "o", color=colour, markersize=3.5)
    for event in of.events:
        north, east, _ = of.teams[event.team].position_n[np.searchsorted(of.time_s, event.time_s - 1e-6), event.vehicle]
        axes.plot(east, north, "x", color=rgb(ALARM), markersize=8, markeredgewidth=2, zorder=5)
    panel(axes, "from above: dots begin, crosses end", "east (m)", "north (m)")
    axes.set(xlim=(middle[1] - half, middle[1] + half), ylim=(middle[0] - half, middle[0] + half), aspect="equal")
    handles, labels = axes.get_legend_handles_labels()
    order = np.argsort(labels)
    axes.legend([handles[k] for k in order], [labels[k] for k in order], loc="upper left", ncols=2)
    return svg(figure, f"map of the {name} episode")


def _series(shown: dict[str, Excerpt]) -> str:
    """The judge's time series and the speeds of each team: one column for each episode, with shared axes."""
    first = next(iter(shown.values()))
    rows = [(team, label) for team, log in first.teams.items() for label in (*log.series, "speed (m/s)")]
    figure = blank(11.0, 1.75 * len(rows) + 0.3)
    grid = figure.subplots(len(rows), len(shown), squeeze=False, sharex=True, sharey="row")
    colours = liveries({team: log.medium for team, log in first.teams.items()})
    for column, (name, of) in enumerate(shown.items()):
        for (team, label), axes in zip(rows, grid[:, column], strict=True):
            log = of.teams[team]
            values = _speed(of, log) if label == "speed (m/s)" else log.series[label]
            for vehicle in reversed(range(values.shape[1])):
                colour = rgb(colours[team].of(vehicle))
                axes.plot(of.time_s, values[:, vehicle], color=colour, linewidth=1.1, label=f"{vehicle}")
            last = axes is grid[-1, column]
            for event in of.events:
                if event.team == team:
                    axes.axvline(event.time_s, color=rgb(ALARM), linewidth=0.8, linestyle=":")
            panel(axes, f"{name}: {team}, {label}", "time (s)" if last else "", "")
            if label.startswith("gap"):
                axes.axhline(0.0, color=rgb(ALARM), linewidth=0.8)
    return svg(figure, "time series of the shown episodes")


def _speed(of: Excerpt, log: TeamLog) -> np.ndarray:
    """Speed over ground from positions, [T, V] m/s."""
    if len(of.time_s) < 2:
        return np.zeros(log.position_n.shape[:2])
    return np.linalg.norm(np.gradient(log.position_n, of.time_s, axis=0), axis=-1)


def collisions(run: Run) -> str:
    """Each collision with the seconds before it."""
    if "policy" not in run.evaluations:
        return missing("No collision to show: the run is not evaluated yet.", run.command("evaluate"))
    episodes = run.evaluations["policy"].episodes
    count = sum(int((of["collided"] > 0).sum()) for of in episodes.values())
    if not run.crashes:
        return paragraph(f"No vehicle collided in {run.evaluations['policy'].result['episodes']} episodes.")
    total = f"Vehicles of a team collided in an episode {count} times"
    total += f"; the first {len(run.crashes)} follow." if count > len(run.crashes) else "."
    lead = paragraph(f"{total} Thick lines: vehicles that collided. Contact is at 0, after {BEFORE:g} s.")
    return lead + "\n".join(_crash(crash) for crash in run.crashes)


def _crash(crash: Crash) -> str:
    who = " and ".join(f"{crash.team} {vehicle}" for vehicle in crash.vehicles)
    log = crash.before.teams[crash.team]
    head = f"<h3>Episode {crash.before.episode}, {crash.time_s:.1f} s: {text(who)}</h3>"
    labels = [*log.series, "actions"]
    figure = blank(11.0, 1.8)
    figure.set_layout_engine(None)  # constrained layout takes most of a report's time
    figure.subplots_adjust(left=0.05, right=0.99, bottom=0.24, top=0.86, wspace=0.16)
    grid = figure.subplots(1, len(labels), squeeze=False)[0]
    time = crash.before.time_s - crash.time_s
    livery = liveries({crash.team: log.medium})[crash.team]
    for label, axes in zip(labels, grid, strict=True):
        if label == "actions":
            _actions(axes, time, log, crash)
        else:
            for vehicle in range(log.position_n.shape[1]):
                wide = 2.2 if vehicle in crash.vehicles else 0.8
                colour = rgb(livery.of(vehicle))
                axes.plot(time, log.series[label][:, vehicle], color=colour, linewidth=wide, label=f"{vehicle}")
            if label.startswith("gap"):
                axes.axhline(0.0, color=rgb(ALARM), linewidth=0.8)
            _legend(axes)
        panel(axes, label if label != "actions" else f"actions of {crash.team} {crash.vehicles[0]}", "s", "")
    return head + svg(figure, f"five seconds before {who} collided")


def _legend(axes: Axes) -> None:
    """Put the legend above the panel, beside its title."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97), "borderaxespad": 0.0, "borderpad": 0.2}
    axes.legend(**place, ncols=4, handlelength=1.2, columnspacing=0.9)


def _actions(axes: Axes, time: np.ndarray, log: TeamLog, crash: Crash) -> None:
    """Plot the actions of the first vehicle that collided."""
    for k, (name, line) in enumerate(zip(log.action_names, ("-", "--", ":", "-.") * 8, strict=False)):
        axes.plot(time, log.action[:, crash.vehicles[0], k], line, color=INK if k == 0 else FAINT, label=name)
    axes.set_ylim(-1.1, 1.1)
    _legend(axes)
