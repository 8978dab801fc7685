"""docs/extending.md: its examples, run as they are written, from a folder outside the repository."""

import re
from pathlib import Path

import pytest
from command_line import ROOT, here, printed, sets  # noqa: F401 fixture

from rl.evaluation.episodes import CHUNK

PAGE = ROOT / "docs" / "extending.md"
BLOCK = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FEW = "stages.first.iterations=2", "episode_duration=2"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return a folder with every file of the page."""
    place = tmp_path_factory.mktemp("extending")
    for name, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        (place / name).write_text(text, encoding="utf-8")
    return place


@pytest.mark.slow
def test_the_vehicle_is_driven_alone(folder):
    text = printed("try_ferry.py", cwd=folder)
    light, laden = map(float, re.search(r"\[(.*)\]", text).group(1).split(","))
    # u = (F / d) (1 - exp(-d t / m)): 4.82 and 4.05 m/s after ten seconds; Euler's method at 0.1 s is 1 % off
    assert light == pytest.approx(5.0 * (1 - 2.718281828 ** (-300 * 10 / 900)), rel=0.01)
    assert laden == pytest.approx(5.0 * (1 - 2.718281828 ** (-300 * 10 / 1800)), rel=0.01)
    assert "1.666" in text


@pytest.mark.parametrize("processes", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_mission_is_trained_evaluated_recorded_and_judged_by_its_own_figures(processes, folder):
    """Nothing of the repository is touched: the files of the mission are its own. Processes exchange its objects."""
    out, shared = f"run_{processes}", ("--processes", processes)
    episodes = CHUNK * (processes - 1) + 1  # of two processes each judges some
    few = sets(*FEW, f"evaluation.episodes={episodes}")
    printed("rl.train", "--config", "rendezvous.toml", "--out", out, *shared, *few, cwd=folder)
    other = sets("ferries.vehicle=ferry.toml")  # that of `folder`, where the mission lies, too
    told = printed("rl.commands.evaluate", out, "--episodes", episodes, *shared, *other, cwd=folder)
    assert "final_distance_m" in told
    assert {"ferry.py", "rendezvous.py"} <= {file.name for file in (folder / out).rglob("*.py")}
    assert (folder / out / "episode.rrd").is_file()


def test_a_shipped_mission_is_changed_by_sections_and_by_classes(folder, here, monkeypatch):  # noqa: F811
    from rl.evaluation.episodes import judge_episodes
    from rl.learn.policy import ClassicalPolicy
    from rl.missions import load_scenario
    from taichi_sim.config.io import find_config

    shipped = find_config("otter").read_text(encoding="utf-8")
    end = (folder / "quiet_terms.toml").read_text(encoding="utf-8")
    (folder / "quiet.toml").write_text('mission = "quiet:Quiet"\n' + shipped + end, encoding="utf-8")
    monkeypatch.chdir(folder)
    told = here("rl.commands.describe", "quiet.toml").out
    assert re.search(r"heave +vertical speed, m/s\n.* wind +Mean wind", told) and " role " not in told
    assert "weight 0.2, scale 0.5: -|vertical speed| over a scale (m/s): a quiet ride" in told
    file = folder / "quiet.toml"
    config = load_scenario(file, ["episode_duration=4", "evaluation.settle=0", "track.worlds=2"])
    found = judge_episodes(
        config, {"usv": ClassicalPolicy()}, episodes=2, seed=1, source=file, show_progress=False
    ).episodes["usv"]
    assert set(found["succeeded"]) <= {0.0, 1.0}


def test_an_adapter_steps(folder):
    assert re.search(r"\(24, 65\) mean reward -?\d\.\d+", printed("rows.py", cwd=folder))


@pytest.mark.slow
def test_the_mission_learns(folder):
    """Vehicles that begin 50 m away on average end within 25 m."""
    printed("rl.train", "--config", "rendezvous.toml", "--out", "long", cwd=folder)
    told = printed("rl.commands.evaluate", "long", cwd=folder)
    assert float(re.search(r'"final_distance_m": ([\d.]+)', told).group(1)) < 25.0
