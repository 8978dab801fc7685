"""What the viewer shows: a view that follows each team, the map, plots, events, the run's configuration."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from taichi_sim.recording.episode import Array, Episode, TeamTrack
from taichi_sim.recording.plots import signal_path
from taichi_sim.recording.sea_patch import HAZE
from taichi_sim.recording.space import map_bounds
from taichi_sim.recording.vehicles import TRAIL_S

NEAR_EYE = (-2.2, 1.1, -0.65)  # wing spans forward, right, down of the leader
NEAR_LOOK = (0.6, 0.0, 0.0)
UP, DOWN = (0, 0, 1), (0, 0, -1)  # what is up on the screen, in the frame of boats and of aircraft
TITLES = {"usv": "USV team", "uav": "UAV team"}


def blueprint(episode: Episode) -> rrb.Blueprint:
    """Layout of one episode's file."""
    teams = list(episode.teams.values())
    views = [view for team in teams for view in _views(team, teams)]
    low, high = map_bounds(episode)
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


def _views(team: TeamTrack, teams: Sequence[TeamTrack]) -> list[rrb.Spatial3DView | rrb.Tabs]:
    """A team as a whole; of aircraft also the leader from near, beside it where there is room."""
    if team.name == "usv":
        return [_follow(team, teams)]
    views = [_follow(team, teams), _near(team, teams)]
    return [*views] if len(teams) == 1 else [rrb.Tabs(*views)]


def _follow(team: TeamTrack, teams: Sequence[TeamTrack]) -> rrb.Spatial3DView:
    """From behind and above, far enough to hold the formation; moves along with the leader.

    It looks at the leader itself: the formation's middle is on another side of it after every bend. The view of boats
    keeps the direction of the start. That of aircraft turns with the course, but stays level: the horizon shows the
    bank.
    """
    name, size = TITLES.get(team.name, team.name), max(team.size_m[:2])
    if team.name != "usv":
        away = 2.0 * team.formation_radius_m + 2.2 * size
        return _view(team, teams, name, away * np.array([-0.95, 0.1, -0.3]), np.zeros(3), DOWN)
    course = float(team.target_course[0])
    forward = np.array([np.sin(course), np.cos(course), 0.0])
    right = np.array([np.cos(course), -np.sin(course), 0.0])
    away = 1.15 * team.formation_radius_m + 2.2 * size
    eye = away * (-0.95 * forward + 0.45 * right + np.array([0.0, 0.0, 0.5]))
    return _view(team, teams, name, eye, np.zeros(3), UP)


def _near(team: TeamTrack, teams: Sequence[TeamTrack]) -> rrb.Spatial3DView:
    """The leader of aircraft alone, from behind."""
    span = team.size_m[1]
    return _view(
        team, teams, f"{team.name.upper()} leader", span * np.array(NEAR_EYE), span * np.array(NEAR_LOOK), DOWN
    )


def _view(
    team: TeamTrack, teams: Sequence[TeamTrack], name: str, eye: Array, look: Array, up: tuple[int, int, int]
) -> rrb.Spatial3DView:
    """A view in the frame that follows a team's leader: east, north, up of boats; forward, right, down of aircraft."""
    return rrb.Spatial3DView(
        origin=f"world/{team.name}/follow",
        contents="world/**",
        name=name,
        background=tuple(int(part) for part in HAZE),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=look, eye_up=up),
        overrides=_trails(teams) | _without_plumb_lines(team, teams),
    )


def _trails(teams: Sequence[TeamTrack]) -> dict:
    """What the views show of the trails that are segments; those of boats are whole lines."""
    return {
        f"world/{one.name}/trail_{vehicle}": _last_seconds()
        for one in teams
        if one.name != "usv"
        for vehicle in range(one.vehicles)
    }


def _without_plumb_lines(team: TeamTrack, teams: Sequence[TeamTrack]) -> dict:
    """Boats are seen without the lines of those above them."""
    return {
        f"world/{one.name}/plumb_{vehicle}": rrb.EntityBehavior(visible=False)
        for one in teams
        if team.name == "usv" != one.name
        for vehicle in range(one.vehicles)
    }


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
        else:
            motion.append(_leader_series(team, "altitude (m)", f"altitude/{team.name}"))
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
