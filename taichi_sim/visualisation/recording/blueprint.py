"""Layout of the viewer: a view that follows each team, map, plots, events, the run's configuration.

Several episodes have a column of views each.
Empty views and plots are left out: the viewer would mark them as errors or leave holes.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from taichi_sim.visualisation.recording.episode import Array, Episode, TeamTrack
from taichi_sim.visualisation.recording.overlays import Note, Plot, entity_name
from taichi_sim.visualisation.recording.plots import OTHERS, error_plots, signal_path
from taichi_sim.visualisation.recording.rerun_stream import root_of
from taichi_sim.visualisation.recording.sea_patch import HAZE, patch_of
from taichi_sim.visualisation.recording.static_scene import map_bounds
from taichi_sim.visualisation.recording.team_view import TRAIL_S

MAP_ROOM = 0.2  # margin of a live view's map over its side
CURVES = "curves"  # path of a live view's plots that belong to no episode
COLUMNS = 2  # views of teams side by side; with more teams, those of one medium share a place
NEAR_EYE = (-2.2, 1.1, -0.65)  # wing spans forward, right, down of the first vehicle
NEAR_LOOK = (0.6, 0.0, 0.0)
UP, DOWN = (0, 0, 1), (0, 0, -1)  # upward direction on the screen, in the frames of boats and of aircraft


class LiveLayout(NamedTuple):
    """Additions to the layout in a live view."""

    curves: tuple[str, ...] = ()  # plots under plots/curves
    everywhere: bool = False  # the map shows the whole area, because other episodes follow


def blueprint(episodes: Episode | Mapping[str, Episode], live: LiveLayout | None = None) -> rrb.Blueprint:
    """Layout of a file of one episode, or of several by caption (rrd.py), or of a live view that begins with one."""
    if isinstance(episodes, Episode):
        episodes = {"": episodes}
    views = [view for caption, episode in episodes.items() for view in _column(episode, caption)]
    maps = [_map(episode, caption, live) for caption, episode in episodes.items()]
    caption, episode = list(episodes.items())[-1]
    about: list[rrb.View] = [rrb.TextDocumentView(origin=f"{root_of(caption)}config", name="Run")]
    about += [
        rrb.TextLogView(origin=f"{root_of(caption)}events", name=f"{caption} events".strip().capitalize())
        for caption, one in episodes.items()
        if live or one.events or any(isinstance(overlay, Note) for overlay in one.overlays)
    ]
    over = rrb.Tabs(*maps, active_tab=len(maps) - 1) if len(maps) > 1 else maps[0]
    beside = rrb.Vertical(over, rrb.Tabs(*about), row_shares=[3, 2])
    upper = rrb.Horizontal(*views, beside, column_shares=[4] * len(views) + [3])
    curves = [_series(name, f"{CURVES}/{name}", [""]) for name in live.curves] if live else []
    plots = rrb.Horizontal(*(rrb.Tabs(*group) for group in [curves, *_plots(episode, episodes)] if group))
    return rrb.Blueprint(
        rrb.Vertical(upper, plots, row_shares=[7, 3]),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.TimePanel(timeline="sim_time", play_state="following" if live else "paused", state="collapsed"),
    )


def _column(episode: Episode, caption: str) -> list[rrb.View | rrb.Container]:
    """The views of one episode; with a caption in one column."""
    views = _views(episode, caption)
    return [rrb.Vertical(*views, name=caption)] if caption else [*views]


def _map(episode: Episode, caption: str, live: LiveLayout | None) -> rrb.Spatial2DView:
    low, high = map_bounds(episode)
    if live and live.everywhere and episode.scene.area_m is not None:
        high = np.full(2, 0.5 * episode.scene.area_m)
        low = -high
    elif live:  # the episode has only begun
        low, high = low - MAP_ROOM * (high - low), high + MAP_ROOM * (high - low)
    return rrb.Spatial2DView(
        origin=f"{root_of(caption)}map",
        name=f"{caption} map (north up, m)".strip().capitalize(),
        background=(228, 236, 240),
        visual_bounds=rrb.VisualBounds2D(x_range=[low[1], high[1]], y_range=[-high[0], -low[0]]),
    )


def _views(episode: Episode, caption: str) -> list[rrb.View | rrb.Tabs]:
    """A view of each team; where there is room, also a close view of the first aircraft."""
    teams = list(episode.teams.values())
    places = [[team] for team in teams]
    if len(teams) > COLUMNS:
        places = [[team for team in teams if team.on_water == on_water] for on_water in (True, False)]
    groups = [[view for team in place for view in _of_team(episode, team, caption)] for place in places if place]
    if len(teams) == 1:
        return [*groups[0]]
    if episode.scene.overview:
        name, reach = episode.scene.overview  # everything that near, from abeam of the first vehicle's initial course
        eye = reach * np.array([-0.9, -1.3, 0.95])
        groups[0].insert(0, _view(episode, episode.teams[name], "Overview", eye, np.zeros(3), UP, caption))
    return [rrb.Tabs(*group) if len(group) > 1 else group[0] for group in groups]


def _of_team(episode: Episode, team: TeamTrack, caption: str) -> list[rrb.Spatial3DView]:
    """View of a team from behind and above, far enough to hold the formation; it moves with the first vehicle.

    It is centred on that vehicle, because the formation's centre changes sides in every bend. The view of boats keeps
    the direction of the start. That of aircraft turns with the course but stays level, so that the horizon shows the
    bank; a second view shows the first aircraft alone, from behind.
    """
    name, size = f"{team.name.upper()} team", max(team.size_m[:2])
    if not team.on_water:
        away, span = 2.0 * team.formation_radius_m + 2.2 * size, team.size_m[1]
        eye, look = span * np.array(NEAR_EYE), span * np.array(NEAR_LOOK)
        return [
            _view(episode, team, name, away * np.array([-0.95, 0.1, -0.3]), np.zeros(3), DOWN, caption),
            _view(episode, team, team.vehicle_name(0), eye, look, DOWN, caption),
        ]
    north, east = np.cos(team.course[0]), np.sin(team.course[0])
    forward, right = np.array([east, north, 0.0]), np.array([north, -east, 0.0])
    away = 1.15 * team.formation_radius_m + 2.2 * size
    eye = away * (-0.95 * forward + 0.45 * right + np.array([0.0, 0.0, 0.5]))
    return [_view(episode, team, name, eye, np.zeros(3), UP, caption)]


def _view(
    episode: Episode, team: TeamTrack, name: str, eye: Array, look: Array, up: tuple[int, int, int], caption: str
) -> rrb.Spatial3DView:
    """A view in the frame that follows a team: east, north, up of boats; forward, right, down of aircraft."""
    return rrb.Spatial3DView(
        origin=f"{root_of(caption)}world/{team.name}/follow",
        contents=f"{root_of(caption)}world/**",
        name=f"{name}, {caption}" if caption else name,
        background=tuple(int(part) for part in HAZE),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=look, eye_up=up),
        overrides=_overrides(episode, team, root_of(caption)),
    )


def _overrides(episode: Episode, team: TeamTrack, root: str) -> dict:
    """Overrides of a team's view: it hides other teams' sea and, for boats, the plumb lines of aircraft.

    An aircraft's trail has one segment for each step, so the view shows those of the last TRAIL_S seconds. A boat's
    wake is a whole line in each frame. All else shows the present only.
    """
    aloft, patches = [one.name for one in episode.teams.values() if not one.on_water], patch_of(episode)
    hidden = [f"{root}world/{name}/sea" for name in set(patches.values()) if name != patches[team.name]]
    hidden += [f"{root}world/{name}/plumb_lines" for name in aloft] if team.on_water else []
    now = rr.TimeRangeBoundary.cursor_relative
    trail = rrb.VisibleTimeRanges(timeline="sim_time", start=now(seconds=-TRAIL_S), end=now())
    return {f"{root}world/{name}/trails": trail for name in aloft} | {
        path: rrb.EntityBehavior(visible=False) for path in hidden
    }


def _series(name: str, path: str, roots: Sequence[str], hidden: Sequence[str] = ()) -> rrb.TimeSeriesView:
    """A plot of everything at `path`, of each root, over the whole episode; lines in `hidden` start switched off."""
    whole = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin=f"{roots[-1]}plots",
        contents=[f"{root}plots/{path}" for root in roots],
        name=name,
        axis_x=rrb.TimeAxis(view_range=whole),
        plot_legend=rrb.PlotLegend("RightTop"),
        overrides={f"{root}plots/{line}": rrb.EntityBehavior(visible=False) for root in roots for line in hidden},
    )


def _each(team: TeamTrack, name: str, path: str, roots: Sequence[str]) -> rrb.TimeSeriesView:
    """A plot of each vehicle; only that of the first is switched on."""
    hidden = [f"{path}/{OTHERS}"] if team.vehicles > 1 else []
    return _series(f"{team.vehicle_name(0)} {name}", f"{path}/**", roots, hidden)


def _plots(episode: Episode, captions: Collection[str]) -> list[Sequence[rrb.View]]:
    """Plots from the left: errors, the mission's own, motion, instruments, the policy's input and output.

    Errors are those of all episodes with `captions`, the others those of the last.
    """
    teams, roots = list(episode.teams.values()), [root_of(caption) for caption in captions]
    judged, own = [team for team in teams if team.error_m is not None], roots[-1:]
    errors: list[rrb.View] = []
    if judged:
        whose = "Leaders' tracking" if all(team.slot_n is not None for team in judged) else "Tracking"
        errors.append(_series(f"{whose} error (m)", "tracking_error/**", roots))
    errors += [
        _series(f"{team.name.upper()} followers' error (m)", f"formation_error/{team.name}", roots)
        for team in judged
        if "formation_error" in error_plots(team)
    ]
    added = [_series(one.name, entity_name(one), own) for one in episode.overlays if isinstance(one, Plot)]
    motion = []
    for team in teams:
        up = ("heave, wave (m)", f"heave/{team.name}") if team.on_water else ("altitude (m)", f"altitude/{team.name}")
        motion += [_each(team, "roll, pitch (deg)", f"attitude/{team.name}", own), _each(team, *up, own)]
        motion.append(_series(f"{team.vehicle_name(0)} heading (deg)", f"heading/{team.name}", own))
    signals = [_each(team, name, signal_path(team, name), own) for team in teams for name in team.signals]
    gets = [
        _series(f"{team.name.upper()} reward", f"reward/{team.name}", own) for team in teams if team.reward is not None
    ]
    gives = [_each(team, "actions", f"action/{team.name}", own) for team in teams if team.action is not None]
    return [errors, added, motion, signals, [*gets, *gives]]
