"""Tuning classical controllers: what is found is better than a bad beginning, and goes into the file."""

import tomllib

import pytest
from named_thrusters import write_hull

from rl.guidance.controllers.unity import UnityBoatGains
from rl.missions import load_scenario
from rl.runs.tune import summary, tune, write_numbers, write_scenario
from taichi_sim.config import ConfigError
from taichi_sim.config.io import find_config, vehicle_file

TINY = (
    "track.worlds=8", "sea.realisations=4", "obstacles.count=0", "episode_duration=12", "evaluation.settle=6",
    "usv.count=1", "usv.control={bandwidth=0.3, closing=4.0}",
)  # fmt: skip


@pytest.mark.slow
def test_a_bad_number_is_found_again():
    """A position loop of 0.3 rad/s is too slow to be in place within 6 s."""
    config = load_scenario("lanes", TINY)
    found = tune(config, "usv", names=("bandwidth",), rounds=4, candidates=5, episodes=8, show_progress=False)
    assert found.numbers["bandwidth"] > 0.5
    assert found.loss < found.loss_before
    assert found.numbers["closing"] == 4.0  # given by the file, and not searched for


@pytest.mark.slow
def test_numbers_that_are_no_better_than_those_before_are_not_taken(monkeypatch):
    monkeypatch.setattr("rl.runs.tune._numbers", lambda names, _: dict.fromkeys(names, 0.01))
    config = load_scenario("lanes", TINY)
    found = tune(config, "usv", names=("bandwidth",), rounds=1, candidates=2, episodes=4, show_progress=False)
    assert found.numbers == {"bandwidth": 0.3, "closing": 4.0} and found.loss == found.loss_before
    assert "nothing better was found" in summary(found, str)


def test_unknown_numbers_and_zeros_are_refused():
    with pytest.raises(ConfigError, match="usv.control has no bandwith; allowed are acceleration"):
        tune(load_scenario("lanes", TINY), "usv", names=("bandwith",), episodes=4)
    with pytest.raises(ConfigError, match="usv.control.turning = 0 has no logarithm"):
        tune(load_scenario("lanes", TINY), "usv", names=("turning",), episodes=4)


def test_numbers_go_into_the_file_and_nothing_else_changes(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('# mine\nname = "mine"\n\n[usv]\nvehicle = "unity_boat"\n\n[stages.usv]\nteam = "usv"\n')
    write_numbers(file, "usv", {"horizon": 4.5}, "found")
    first = file.read_text()
    write_numbers(file, "usv", {"horizon": 5.5, "lean": 0.1}, "found again")
    text = file.read_text()
    assert text.startswith("# mine\n")
    assert text.count("[usv.control]") == 1
    assert len(first.splitlines()) + 1 == len(text.splitlines())
    assert tomllib.loads(text)["usv"]["control"] == {"horizon": 5.5, "lean": 0.1}
    assert UnityBoatGains(**tomllib.loads(text)["usv"]["control"]).horizon == 5.5


def test_a_new_scenario_has_the_numbers_and_every_override(tmp_path, monkeypatch):
    """Another vehicle of one's own too, found from the new file's folder, with the list of what changed."""
    monkeypatch.chdir(tmp_path)
    write_hull(tmp_path / "cat.toml")
    config, out = load_scenario("cruise", ["usv.vehicle=cat.toml", "seed=7"]), tmp_path / "mine" / "cat_cruise.toml"
    out.parent.mkdir()
    write_scenario(out, config, find_config("cruise"), "usv", {"horizon": 4.5})
    again = load_scenario(out)
    assert again.formations["usv"].control == {"horizon": 4.5}
    assert vehicle_file(again.teams["usv"], out).samefile("cat.toml")
    same = {name: config.formations[name].model_copy(update={"vehicle": "", "control": {}}) for name in config.teams}
    for name, section in same.items():
        assert again.formations[name].model_copy(update={"vehicle": "", "control": section.control}) == section
    assert (again.replaced, again.seed, again.stages) == (config.replaced, 7, config.stages)
    assert "cat in place of otter" in again.replaced[0]
