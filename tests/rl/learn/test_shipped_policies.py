"""Policies that come with the package: how they get there, that they are whole, and their figures."""

import json
import shutil

import pytest
from command_line import TINY, sets, tiny_run

from rl.evaluation.episodes import judge_episodes
from rl.learn import policy_sources
from rl.learn.policy_sources import ABOUT, hashed, shipped_folder, shipped_policies
from rl.missions import load_scenario
from taichi_sim.config.io import find_config

NAMES = sorted(file.parent.name for file in shipped_folder().glob(f"*/{ABOUT}"))
FEW = sets(*TINY)


@pytest.fixture
def shipped(here, tmp_path, monkeypatch):
    """A folder of shipped policies that holds those of the tiny run, in the place of the package's own."""
    place = tmp_path / "policies"
    ending = here("tools.ship_policies", tiny_run(), "--into", place, *FEW)
    assert ending.status == 0, ending.err
    monkeypatch.setattr(policy_sources, "shipped_folder", lambda: place)
    return place / "paper"


def test_shipped_policies_act_without_a_run_and_tell_how_they_were_made(shipped, here, monkeypatch, tmp_path):
    about = json.loads((shipped / ABOUT).read_text())
    assert about["teams"].keys() == {"usv", "uav"} == about["figures"].keys()
    for team, of_team in about["teams"].items():
        assert of_team["sha256"] == hashed(shipped / f"{team}.onnx") and of_team["seed"] == 1
        assert of_team["command"].startswith("taichi-sim train --config paper --threads 1 --set")
        assert "--out" not in of_team["command"] and len(of_team["actions"]) == 2 + (team == "uav")
    monkeypatch.chdir(tmp_path)
    for path in (shipped, *shipped.iterdir()):
        path.chmod(0o555)  # as an installation may be
    ending = here("rl.commands.evaluate", "paper", *FEW)
    assert ending.status == 0, ending.err
    assert json.loads(ending.out)["teams"] == about["figures"]
    assert here("rl.commands.play", "paper", "--duration", "0.5", *FEW).status == 0
    shipped.chmod(0o755)
    assert {file.name for file in shipped.iterdir()} == {ABOUT, "usv.onnx", "uav.onnx"}


def test_a_file_that_is_not_the_shipped_one_is_refused(shipped, here):
    shutil.copyfile(shipped / "uav.onnx", shipped / "usv.onnx")
    here("rl.commands.evaluate", "paper", *FEW).fails("usv.onnx", "not the file", "install anew")
    (shipped / "usv.onnx").unlink()
    here("rl.commands.evaluate", "paper", *FEW).fails("usv.onnx", "missing")


def test_what_cannot_be_shipped_is_refused(here, tmp_path):
    here("tools.ship_policies").fails("run folders, --remake or --figures")
    here("tools.ship_policies", "--figures", "--name", "nowhere", "--into", tmp_path).fails("no policies of nowhere")
    here("tools.ship_policies", tmp_path).fails("not a run folder")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_shipped_policies_reach_their_figures(name):
    """To rounding between machines, which an episode in a seaway multiplies."""
    about = json.loads((shipped_folder() / name / ABOUT).read_text())
    result = judge_episodes(
        load_scenario(name), shipped_policies(name), episodes=about["episodes"], seed=about["seed"],
        source=find_config(name), show_progress=False,
    ).result  # fmt: skip
    for team, figures in about["figures"].items():
        for key, figure in figures.items():
            if figure is not None:
                assert result["teams"][team][key] == pytest.approx(figure, rel=0.05, abs=0.02), (team, key)
