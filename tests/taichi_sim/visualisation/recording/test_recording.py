"""An episode written and read back, and the figures drawn from it."""

import errno
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from folders import ROOT, TESTS
from numpy.typing import NDArray
from recorded import AMPLITUDE_M, assert_nothing_is_empty, circling_team, column, elevation, make_episode
from rerun.chunk import RrdReader

from rl.evaluation.training_figures import judged, levels_of, training_figures
from rl.learn.history import read_history, team_history
from rl.mission import History
from rl.missions.formation import figures
from rl.missions.formation.figures import write_figures
from taichi_sim.visualisation.recording import Episode, TeamTrack
from taichi_sim.visualisation.recording.rrd import write_recording
from taichi_sim.visualisation.recording.sea_patch import OFF_CRESTS, SeaGrid


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Episode, Path]:
    episode = make_episode()
    return episode, write_recording(episode, tmp_path_factory.mktemp("new") / "folder" / "circle.rrd")


def test_positions_are_east_north_up_exactly(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    for name, team in episode.teams.items():
        for vehicle in range(team.vehicles):
            _, _, read = column(path, f"/world/{name}/vehicle_{vehicle}", "Transform3D:translation")
            north, east, down = team.position_n[:, vehicle].T
            np.testing.assert_array_equal(read, np.stack([east, north, -down], 1).astype(np.float32))


def test_attitude_turns_body_axes_as_the_quaternion_does(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    team = episode.teams["usv"]
    _, _, (*_, last) = column(path, "/world/usv/vehicle_0", "Transform3D:quaternion")
    x, y, z, w = last.astype(np.float64)
    forward = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    right = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
    course = team.target_course[-1]
    # level nose along the course; the right side 0.1 rad below the horizon
    np.testing.assert_allclose(forward, [np.sin(course), np.cos(course), 0.0], atol=1e-6)
    level = np.array([np.cos(course), -np.sin(course), 0.0])
    np.testing.assert_allclose(right, np.cos(0.1) * level - [0.0, 0.0, np.sin(0.1)], atol=1e-6)


def test_both_timelines_count_every_step(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    times, steps, _ = column(path, "/world/usv/vehicle_0", "Transform3D:translation")
    np.testing.assert_array_equal(steps, np.arange(len(episode.time_s)))
    np.testing.assert_array_equal(times, 100_000_000 * steps)  # 0.1 s, whole ns, not truncated


def test_sea_patch_is_the_elevation_around_the_leader(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    _, steps, origin = column(path, "/world/usv/sea", "Transform3D:translation")
    _, _, vertices = column(path, "/world/usv/sea", "Mesh3D:vertex_positions")
    grid = SeaGrid.of(episode.teams["usv"])
    last = 2 * ((len(steps) - 1) // 2)  # all of the patch moves every 0.2 s
    place = vertices[last].reshape(-1, 3)[: grid.shown.sum()] + origin[last]
    expected = elevation(place[:, 1], place[:, 0], episode.time_s[steps[last]])
    # beyond what could be seen nothing is drawn anew
    np.testing.assert_allclose(place[:, 2], expected, atol=OFF_CRESTS * AMPLITUDE_M + 1.0 / 128.0 + 1e-4)
    assert np.std(place[:, 2] - expected) < 0.25 * np.std(expected)
    leader = episode.teams["usv"].position_n[steps[last], 0]
    assert np.all(place[:, :2].min(axis=0) < leader[[1, 0]])
    assert np.all(place[:, :2].max(axis=0) > leader[[1, 0]])


def test_water_at_a_hull_moves_in_every_frame(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    _, steps, origin = column(path, "/world/usv/sea", "Transform3D:translation")
    _, _, vertices = column(path, "/world/usv/sea", "Mesh3D:vertex_positions")
    team = episode.teams["usv"]
    grid = SeaGrid.of(team)
    fine = slice(int(grid.shown.sum()), int(grid.shown.sum()) + len(grid.fine_line) ** 2)
    assert 2 * len(steps) > 10
    for frame in range(10, 20):
        place = vertices[frame].reshape(-1, 3)[fine] + origin[frame]
        boats = team.position_n[steps[frame], :, [1, 0]].T
        near = (np.linalg.norm(place[:, None, :2] - boats, axis=-1) < team.size_m[0]).any(axis=1)
        expected = elevation(place[:, 1], place[:, 0], episode.time_s[steps[frame]])
        np.testing.assert_allclose(place[near, 2], expected[near], atol=1.0 / 128.0 + 1e-4)
        assert near.sum() > 10


def test_plots_and_events_hold_what_was_given(recorded: tuple[Episode, Path]) -> None:
    episode, path = recorded
    team = episode.teams["uav"]
    _, _, error = column(path, "/plots/formation_error/uav", "Scalars:scalars")
    np.testing.assert_array_equal(error, team.error_m[:, 1:])
    _, _, attitude = column(path, "/plots/attitude/uav/first", "Scalars:scalars")
    np.testing.assert_allclose(attitude, np.degrees([[0.1, 0.0]] * len(error)), atol=1e-9)
    _, steps, texts = column(path, "/events", "TextLog:text")
    assert [text for (text,) in texts] == ["USV leader stall: alpha 0.4 rad", "USV 2 collision: obstacle 1"]
    np.testing.assert_array_equal(steps, [8, 20])


@pytest.mark.parametrize(("vehicles", "teams"), [(1, ("usv",)), (8, ("usv", "uav")), (3, ("uav",))])
def test_any_team_makes_a_whole_file(vehicles: int, teams: tuple[str, ...], tmp_path: Path) -> None:
    path = write_recording(make_episode(vehicles, teams, steps=5), tmp_path / "run.rrd")
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.rrd"]
    viewer = shutil.which("rerun", path=str(Path(sys.executable).parent))
    if viewer:
        verified = subprocess.run([viewer, "rrd", "verify", str(path)], capture_output=True, text=True)
        assert verified.returncode == 0, verified.stderr


def test_a_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(b"old")

    def interrupt(north: NDArray, east: NDArray, time_s: float) -> NDArray:
        raise KeyboardInterrupt

    episode = make_episode(steps=5)
    object.__setattr__(episode, "elevation", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_recording(episode, path)
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.rrd"]


def test_an_unwritable_place_is_an_oserror(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"old")
    with pytest.raises(OSError):
        write_recording(make_episode(steps=5), tmp_path / "file" / "run.rrd")
    assert (tmp_path / "file").read_bytes() == b"old"
    target = tmp_path / "run.rrd"
    target.mkdir()  # the finished file cannot take this place
    with pytest.raises(OSError):
        write_recording(make_episode(steps=5), target)
    assert not list(target.iterdir())
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "run.rrd"]


@pytest.mark.slow
@pytest.mark.parametrize("room", [20_000, 1_200_000])
def test_a_full_disk_is_an_oserror_that_says_so(room: int, tmp_path: Path) -> None:
    """A limit on file size stands in for the full disk; it needs a process of its own."""
    pytest.importorskip("resource")
    path = tmp_path / "run.rrd"
    path.write_bytes(b"old")
    code = f"""
import pathlib, resource, sys
sys.path.insert(0, {str(TESTS)!r})
from folders import ROOT, TESTS
from recorded import make_episode
from taichi_sim.visualisation.recording.rrd import write_recording
resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))
write_recording(make_episode(steps=200), pathlib.Path({str(path)!r}))
"""
    failed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=600)
    assert failed.returncode == 1
    assert f"[Errno {errno.EFBIG}] recording not written" in failed.stderr
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.rrd"]


def test_arrays_of_the_wrong_shape_are_refused() -> None:
    team = circling_team("usv", 2, np.arange(3.0))
    with pytest.raises(ValueError, match="reward"):
        TeamTrack(**{**vars(team), "reward": team.reward[:, :1]})


@pytest.mark.slow
def test_figures_are_pictures(tmp_path: Path) -> None:
    table = tmp_path / "progress.csv"
    rows = [f"{number},{1000 * number},{number},,0.01" for number in range(20)]
    table.write_text("iteration,agent_steps,wall_time_s,reward_per_step,policy_loss\n" + "\n".join(rows))
    history = read_history(table)
    assert np.isnan(history["reward_per_step"]).all()
    checkups = tmp_path / "checkups.csv"  # the untrained team is lost at once, few last at first
    checkups.write_text(
        "iteration,agent_steps,wall_time_s,controller,reward_per_step,error_m,measured\n0,0,0,classical,1,0.5,1\n"
        "0,0,0,policy,-1,,0\n10,10000,9,policy,0.5,30,0.2\n20,19000,19,policy,0.9,0.6,1\n"
    )
    history = team_history(tmp_path)
    assert judged(history) == ["error_m"] and levels_of(history, "error_m") == {"classical": 0.5}
    assert levels_of(history, "reward_per_step") == {"classical": 1.0, "before training": -1.0}
    written = write_figures(tmp_path / "figures", {"usv": history}, make_episode(steps=260))
    names = {"scene", "tracking_error", "formation", "reward", "policy_loss", "checkups"}
    assert {path.stem for path in written} == names
    for path in written:
        data = path.read_bytes()
        assert data.startswith(b"\x89PNG")
        width, height = (int.from_bytes(data[at : at + 4], "big") for at in (16, 20))
        assert width >= 800
        assert height >= 600


def test_the_ring_of_a_slot_goes_round_the_body_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies, collection = [], figures.Poly3DCollection
    monkeypatch.setattr(
        figures, "Poly3DCollection", lambda faces, **style: bodies.append(faces) or collection(faces, **style)
    )
    *_, above = figures.formation_figure(make_episode(1, ("uav",), steps=2)).axes
    assert len(bodies) == len(figures.VIEWS)
    ring = np.ptp(above.lines[0].get_data_3d()[0])
    body = np.ptp(bodies[-1].reshape(-1, 3)[:, :2], axis=0).max()
    assert body < ring < 2 * body


def test_two_episodes_share_a_recording(tmp_path: Path) -> None:
    both = {"before": make_episode(steps=3), "after": make_episode(steps=5)}
    assert_nothing_is_empty(both, write_recording(both, tmp_path / "both.rrd"))


def test_each_recording_opens_in_its_own_layout(tmp_path: Path) -> None:
    """A viewer keeps one layout for each application."""
    files = [write_recording(make_episode(1, ("usv",), steps=2), tmp_path / f"{i}.rrd") for i in range(2)]
    names = {entry.application_id for file in files for entry in RrdReader(file).recordings()}
    assert len(names) == 2


@pytest.mark.filterwarnings("error::UserWarning")
def test_a_training_in_which_nothing_lasted_is_drawn_in_its_frame(tmp_path):
    steps, nothing = np.array([0.0, 1e4, 2e4]), np.full(3, np.nan)
    iterations = dict.fromkeys(("agent_steps", "wall_time_s", "reward_per_step", "policy_loss"), steps[1:])
    levels = {"iteration": steps, "agent_steps": steps, "measured": 0.0 * steps, "a_m": nothing, "b_m": nothing}
    classical = {"iteration": steps[:1], "a_m": np.array([0.3]), "b_m": np.array([0.3])}
    drawn = training_figures({"usv": History(iterations, {"policy": levels, "classical": classical})}, None)["checkups"]
    drawn.savefig(tmp_path / "checkups.png")
    for axes in drawn.axes[:2]:
        assert axes.get_position().width > 0.3 and any(line.get_marker() == "x" for line in axes.lines)
