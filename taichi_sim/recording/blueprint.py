"""What the viewer shows: a view that follows each team, the map, plots, events, the run's configuration."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from taichi_sim.recording.episode import Episode, TeamTrack
from taichi_sim.recording.palette import vehicle_name
from taichi_sim.recording.sea_patch import HAZE

TRAIL_S = 25.0  # how much of a trail is shown
MAP_MARGIN_M = 120.0
TITLES = {"usv": "USV team", "uav": "UAV team"}


def blueprint(episode: Episode) -> rrb.Blueprint:
    """Layout of one episode's file."""
    teams = list(episode.teams.values())
    views = [_follow(team) for team in teams]
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


def _follow(team: TeamTrack) -> rrb.Spatial3DView:
    """From behind and above at the start, far enough to hold the formation; moves along with the leader, never turns.

    It looks at the leader itself: the formation's middle is on another side of it after every bend.
    """
    course = float(team.target_course[0])
    forward = np.array([np.sin(course), np.cos(course), 0.0])
    right = np.array([np.cos(course), -np.sin(course), 0.0])
    size = max(team.size_m[:2])
    away = 1.4 * team.formation_radius_m + 2.8 * size
    rise = 0.5 if team.name == "usv" else 0.25
    eye = away * (-0.95 * forward + 0.45 * right + np.array([0.0, 0.0, rise]))
    return rrb.Spatial3DView(
        origin=f"world/{team.name}/follow",
        contents="world/**",
        name=TITLES.get(team.name, team.name),
        background=tuple(int(part) for part in HAZE),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=np.zeros(3), eye_up=[0, 0, 1]),
        time_ranges=rr.VisibleTimeRange(
            "sim_time",
            start=rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
            end=rr.TimeRangeBoundary.cursor_relative(),
        ),
    )


def _series(name: str, *contents: str) -> rrb.TimeSeriesView:
    """A plot of everything under `contents`, over the whole episode."""
    whole = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    return rrb.TimeSeriesView(
        origin="plots",
        contents=[f"plots/{content}" for content in contents],
        name=name,
        axis_x=rrb.TimeAxis(view_range=whole),
        plot_legend=rrb.PlotLegend("RightTop"),
    )


def _plots(teams: list[TeamTrack]) -> rrb.Horizontal:
    """Errors at the left, then the rest in tabs."""
    afloat = (
        [_series("Wave height (m)", "wave_height/**")] if any(team.name == "usv" for team in teams) else []
    )
    formation = [
        _series(f"{team.name.upper()} followers' error (m)", f"formation_error/{team.name}")
        for team in teams
        if team.vehicles > 1
    ]
    attitude = [
        _series(f"{team.name.upper()} leader {what} (deg)", f"{path}/{team.name}")
        for team in teams
        for what, path in (("roll, pitch", "attitude"), ("heading", "heading"))
    ]
    reward = [_series(f"{team.name.upper()} reward", f"reward/{team.name}") for team in teams]
    actions = [
        _series(f"{vehicle_name(team.name, vehicle)} actions", f"action/{team.name}/vehicle_{vehicle}")
        for team in teams
        for vehicle in range(team.vehicles)
    ]
    return rrb.Horizontal(
        _series("Leaders' tracking error (m)", "tracking_error/**"),
        *([rrb.Tabs(*formation)] if formation else []),
        rrb.Tabs(*attitude, *afloat),
        rrb.Tabs(*reward, *actions),
    )
