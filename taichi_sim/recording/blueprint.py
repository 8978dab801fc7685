"""What the viewer shows: a view that follows each team, the map, plots, events, the run's configuration."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from taichi_sim.recording.episode import Episode, TeamTrack
from taichi_sim.recording.plots import signal_path
from taichi_sim.recording.sea_patch import HAZE
from taichi_sim.recording.vehicles import TRAIL_S

MAP_MARGIN_M = 120.0
TITLES = {"usv": "USV team", "uav": "UAV team"}


def blueprint(episode: Episode) -> rrb.Blueprint:
    """Layout of one episode's file."""
    teams = list(episode.teams.values())
    views = [_follow(team, teams) for team in teams]
    places = np.concatenate(
        [
            *(track[:, :2] for track in episode.scene.tracks_n.values()),
            *(team.position_n[:, 0, :2] for team in teams),
        ]
    )
    low, high = places.min(axis=0) - MAP_MARGIN_M, places.max(axis=0) + MAP_MARGIN_M
    map_view = rrb.Spatial2DView(
        origin="map",
        name="Map (north up, m)",
        background=(228, 236, 240),
        visual_bounds=rrb.VisualBounds2D(x_range=[low[1], high[1]], y_range=[-high[0], -low[0]]),
    )
    about = rrb.Tabs(
        rrb.TextDocumentView(origin="config", name="Run"),
        rrb.TextLogView(origin="events", name="Events"),
    )
    upper = rrb.Horizontal(
        *views, rrb.Vertical(map_view, about, row_shares=[3, 2]), column_shares=[4] * len(views) + [3]
    )
    return rrb.Blueprint(
        rrb.Vertical(upper, _plots(teams), row_shares=[7, 3]),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.TimePanel(timeline="sim_time", play_state="paused", state="collapsed"),
    )


def _follow(team: TeamTrack, teams: Sequence[TeamTrack]) -> rrb.Spatial3DView:
    """From behind and above at the start, far enough to hold the formation; moves along with the leader, never turns.

    It looks at the leader itself: the formation's middle is on another side of it after every bend.
    """
    course = float(team.target_course[0])
    forward = np.array([np.sin(course), np.cos(course), 0.0])
    right = np.array([np.cos(course), -np.sin(course), 0.0])
    size = max(team.size_m[:2])
    away = 1.15 * team.formation_radius_m + 2.2 * size
    rise = 0.5 if team.name == "usv" else 0.25
    eye = away * (-0.95 * forward + 0.45 * right + np.array([0.0, 0.0, rise]))
    return rrb.Spatial3DView(
        origin=f"world/{team.name}/follow",
        contents="world/**",
        name=TITLES.get(team.name, team.name),
        background=tuple(int(part) for part in HAZE),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=np.zeros(3), eye_up=[0, 0, 1]),
        overrides={
            f"world/{one.name}/trail_{vehicle}": _last_seconds()
            for one in teams
            if one.name != "usv"  # whose trails are whole lines
            for vehicle in range(one.vehicles)
        },
    )


def _last_seconds() -> rrb.VisibleTimeRanges:
    """What a trail of segments shows. Nothing else has a past: a ring on the waves or an arrow would be drawn
    once for each step.
    """
    return rrb.VisibleTimeRanges(
        timeline="sim_time",
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rr.TimeRangeBoundary.cursor_relative(),
    )


def _series(name: str, *contents: str, hidden: Sequence[str] = ()) -> rrb.TimeSeriesView:
    """A plot of everything under `contents`, over the whole episode; `hidden` of it waits to be switched on."""
    whole = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin="plots",
        contents=[f"plots/{content}" for content in contents],
        name=name,
        axis_x=rrb.TimeAxis(view_range=whole),
        plot_legend=rrb.PlotLegend("RightTop"),
        overrides={f"plots/{content}": rrb.EntityBehavior(visible=False) for content in hidden},
    )


def _leader_series(team: TeamTrack, name: str, path: str) -> rrb.TimeSeriesView:
    """A plot that each vehicle has: the leader's is shown, the others' are a click away."""
    followers = [f"{path}/vehicle_{vehicle}" for vehicle in range(1, team.vehicles)]
    return _series(f"{team.name.upper()} leader {name}", f"{path}/**", hidden=followers)


def _plots(teams: list[TeamTrack]) -> rrb.Horizontal:
    """Errors at the left, then motion, instruments, and what the policy gets and gives; in tabs."""
    formation = [
        _series(f"{team.name.upper()} followers' error (m)", f"formation_error/{team.name}")
        for team in teams
        if team.vehicles > 1
    ]
    motion = []
    for team in teams:
        motion.append(_leader_series(team, "roll, pitch (deg)", f"attitude/{team.name}"))
        if team.name == "usv":
            motion.append(_leader_series(team, "heave, wave (m)", f"heave/{team.name}"))
        motion.append(_series(f"{team.name.upper()} leader heading (deg)", f"heading/{team.name}"))
    signals = [_leader_series(team, name, signal_path(team, name)) for team in teams for name in team.signals]
    reward = [_series(f"{team.name.upper()} reward", f"reward/{team.name}") for team in teams]
    actions = [_leader_series(team, "actions", f"action/{team.name}") for team in teams]
    return rrb.Horizontal(
        rrb.Tabs(_series("Leaders' tracking error (m)", "tracking_error/**"), *formation),
        rrb.Tabs(*motion),
        *([rrb.Tabs(*signals)] if signals else []),
        rrb.Tabs(*reward, *actions),
    )
