"""Scenarios: every mistake is refused in words that name file, key, value and what is allowed."""

import pytest
from refusal import MINIMAL, assert_says, refusal

from rl.missions import load_scenario
from taichi_sim.config.io import config_folder, vehicle_file
from taichi_sim.models.catalogue import load_vehicle


@pytest.mark.parametrize(
    ("top", "end", "parts"),
    [
        ("dt = 0\n", "", ("dt = 0", "greater than 0")),
        ("dt = -0.02\n", "", ("dt = -0.02", "greater than 0")),
        ("dt = 'fast'\n", "", ("dt = 'fast'", "number")),
        ("dt = 1e-9\n", "", ("dt = 1e-09", "1e+08 steps", "allowed are 10000", "dt of 1e-05 s or more")),
        ("dt = 1e-300\n", "", ("dt = 1e-300", "allowed are 10000")),
        ("dt = 0.02\ndecision_interval = 0.05\n", "", ("decision_interval = 0.05", "multiple of dt = 0.02")),
        ("dt = 0.02\ndecision_interval = 0.01\n", "", ("decision_interval = 0.01", "multiple of dt = 0.02")),
        ("", "dt = 0.03\n", ("decision_interval = 0.1", "multiple of uav.dt = 0.03")),
        ("dt = 0.02\n", "dt = 0.05\n", ("uav.dt = 0.05", "dt = 0.02 is the step of all teams")),
        ("seed = -1\n", "", ("seed = -1", "greater than or equal to 0")),
        ("reward = 'fame'\n", "", ("reward = 'fame'", "'paper'", "'tracking'")),
        ("usv_count = 3\n", "", ("usv_count", "unknown key", "allowed here: ", "decision_interval")),
        ("", "[sea]\ngamma_js = 0.5\n", ("sea.gamma_js = 0.5", "greater than or equal to 1")),
        ("", "[sea]\nhs = -1\n", ("sea.hs = -1", "greater than or equal to 0")),
        ("", "[sea]\nhs = nan\n", ("sea.hs = nan", "or equal to")),
        ("", "[sea]\ntp = inf\nhs = 1\n", ("sea.tp = inf", "less than or equal to 30")),
        ("", "[sea]\ndepth = 0\n", ("sea.depth = 0", "greater than 0")),
        ("", "[sea]\nspreading_s = -1\n", ("sea.spreading_s = -1", "greater than 0")),
        ("", "[sea]\ncomponents = 0\n", ("sea.components = 0", "greater than or equal to 1")),
        ("", "[sea]\ncomponents = 10000\n", ("sea.components = 10000", "less than or equal to 64")),
        ("", "[sea]\ndirection_deg = nan\n", ("sea.direction_deg = nan", "finite")),
        ("", "[sea]\nspectrum = 'white'\n", ("sea.spectrum = 'white'", "'jonswap'", "'pierson_moskowitz'")),
        ("", "[sea]\nsea_state = 9\n", ("sea.sea_state = 9", "less than or equal to 8")),
        ("", "[sea]\ntp = 5\n", ("sea: tp is given without hs",)),
        ("", "[sea]\nfetch = 1e4\n", ("sea: fetch is given without wind_speed",)),
        ("", "[sea]\nhs = 1\ntp = 5\nsea_state = 3\n", ("sea", "2 times", "hs and tp", "sea_state", "keep one")),
        ("", "[sea]\nsea_state = 3\nwind_speed = 9\n", ("sea", "2 times", "sea_state", "wind_speed")),
        ("", "[sea]\nspectrum = 'jonswap'\nwind_speed = 9\n", ("needs a fetch", "'pierson_moskowitz'")),
        (
            "",
            "[sea]\nspectrum = 'bretschneider'\nwind_speed = 9\nfetch = 1e4\n",
            ("fetch", "must be 'jonswap'", "'bretschneider'"),
        ),
        (
            "",
            "[sea]\ncomponents = 40\n[sea.swell]\nhs = 1\ntp = 9\ncomponents = 25\n",
            ("sea: components + swell.components = 65", "at most 64"),
        ),
        ("", "[sea.current]\nspeed = -1\n", ("sea.current.speed = -1", "greater than or equal to 0")),
        ("", "[sea.current]\nprofile = 'power'\n", ("sea: current.profile = 'power'", "set depth")),
        ("", "[sensing]\ndetection_range = inf\n", ("sensing.detection_range = inf", "finite")),
        ("", "[obstacles]\nradius_min = 5\nradius_max = 4\n", ("obstacles", "radius_max = 4", "radius_min")),
        ("", "[stages.swim]\nteam = 'fish'\n", ("stages.swim.team = 'fish'", "'usv'", "'uav'")),
        (
            "",
            "[stages.a]\nteam = 'usv'\n[stages.b]\nteam = 'usv'\nactivation = 'relu'\n",
            ("stages.b.activation", "'relu'", "stages.a", "'elu'"),
        ),
        (
            "area = 1000\n",
            "[[obstacles.fixed]]\nnorth = 0\neast = 495\nradius = 6\nheight = 9\n",
            ("obstacles.fixed[0]", "495", "radius 6", "area / 2 = 500"),
        ),
        (
            "",
            "[[obstacles.fixed]]\nnorth = 0\neast = 0\nradius = 6\n",
            ("obstacles.fixed.0.height", "missing"),
        ),
    ],
)
def test_a_wrong_value_is_refused_by_name(scenario, top, end, parts):
    file = scenario(top, end)
    assert_says(refusal(file), file, *parts)


def test_zero_vehicles_are_refused(tmp_path):
    file = tmp_path / "none.toml"
    file.write_text(MINIMAL.replace("[uav]", "count = 0\n[uav]"), encoding="utf-8")
    assert_says(refusal(file), file, "usv.count = 0", "greater than or equal to 1")


@pytest.mark.parametrize(
    ("end", "key", "value", "suggestion"),
    [
        ("[sea]\ngama_js = 3.75\n", "sea.gama_js", "3.75", "gamma_js"),
        ("[uav.terms.ending]\nwieght = 7.5\n", "uav.terms.ending.wieght", "7.5", "weight"),
        ("[stages.one]\nteam = 'usv'\nitrations = 41\n", "stages.one.itrations", "41", "iterations"),
        ("[[obstacles.fixed]]\nnorht = 41.5\n", "obstacles.fixed.0.norht", "41.5", "north"),
    ],
)
def test_an_unknown_key_is_refused_with_the_one_meant(scenario, end, key, value, suggestion):
    file = scenario(end=end)
    line = next(text for text in refusal(file).splitlines() if key in text)
    assert_says(line, file, key, value, "unknown key", f"did you mean {suggestion!r}", "allowed here: ")
    allowed = line.split("allowed here: ")[1]
    assert suggestion in allowed.split(", ")


def test_all_mistakes_are_told_at_once(scenario):
    message = refusal(scenario("dt = 0\narae = 3\n"))
    assert len(message.splitlines()) == 2
    assert_says(message, "dt = 0", "arae", "did you mean 'area'")


def test_malformed_toml_is_refused_with_its_line(tmp_path):
    file = tmp_path / "broken.toml"
    file.write_text("name = 'x'\ndt = = 2\n", encoding="utf-8")
    assert_says(refusal(file), file, "not valid TOML", "line 2")


def test_a_file_that_is_not_text_is_refused(tmp_path):
    file = tmp_path / "binary.toml"
    file.write_bytes(b"\xff\xfe\x00")
    assert_says(refusal(file), file, "cannot be read")


@pytest.mark.parametrize("name", ["atlantis", "atlantis.toml", "configs/atlantis.toml", "some/where/paper.toml", ""])
def test_a_missing_scenario_lists_the_shipped_ones(name):
    shipped = sorted(p.stem for p in config_folder().glob("*.toml"))
    assert "paper" in shipped
    assert_says(refusal(name), name, "no such configuration file", ", ".join(shipped))


@pytest.mark.parametrize("name", ["paper", "paper.toml", "configs/paper.toml"])
def test_a_shipped_scenario_is_found_from_anywhere(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load_scenario(name).name == "paper"


def test_every_shipped_scenario_loads_with_its_vehicles():
    for file in config_folder().glob("*.toml"):
        config = load_scenario(file)
        act = [name for name in config.teams if name not in config.scripted]
        one = {"landing": ["uav"], "station": ["usv"], "route": ["usv"], "encounter": ["usv"], "imazu": ["usv"]}
        assert act == one.get(config.name, ["usv", "uav"])
        for name, team in config.teams.items():
            substeps = config.substeps(name, 0.02)
            model = load_vehicle(vehicle_file(team, file), config.decision_interval / substeps, substeps, source=file)
            assert model.medium == team.medium
