"""Configurations: every mistake is refused in words that name file, key, value and what is allowed."""

from pathlib import Path

import pytest

from taichi_sim.config import ConfigError, ScenarioConfig
from taichi_sim.config_io import config_folder, load_scenario, read_toml, validate, vehicle_file, write_toml
from taichi_sim.vehicles import load_vehicle

MINIMAL = """
name = "little"
[usv]
vehicle = "unity_boat"
[uav]
vehicle = "unity_aircraft"
"""


@pytest.fixture
def scenario(tmp_path: Path):
    """Write a scenario: `top` before the sections of a minimal one, `end` after them."""

    def write(top: str = "", end: str = "") -> Path:
        file = tmp_path / "little.toml"
        file.write_text(top + MINIMAL + end, encoding="utf-8")
        return file

    return write


def refusal(path: Path | str, *overrides: str) -> str:
    """Return the message of the ConfigError that loading raises."""
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, overrides)
    return str(caught.value)


def assert_says(message: str, *parts: object) -> None:
    """Fail, showing the message, unless every part is in it."""
    missing = [str(part) for part in parts if str(part) not in message]
    assert not missing, f"{missing} not in: {message}"


@pytest.mark.parametrize(
    ("top", "end", "parts"),
    [
        ("dt = 0\n", "", ("dt = 0", "greater than 0")),
        ("dt = -0.02\n", "", ("dt = -0.02", "greater than 0")),
        ("dt = 'fast'\n", "", ("dt = 'fast'", "number")),
        ("dt = 0.02\ndecision_interval = 0.05\n", "", ("decision_interval = 0.05", "multiple of dt = 0.02")),
        ("dt = 0.02\ndecision_interval = 0.01\n", "", ("decision_interval = 0.01", "multiple of dt = 0.02")),
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
        ("", "[sea]\nhs = 1\n", ("sea: hs is given without tp",)),
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
        ("", "[sea.swell]\nhs = 1\n", ("sea.swell.tp", "missing")),
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
            "[stages.a]\nteam = 'usv'\n[stages.b]\nteam = 'usv'\n",
            ("stages", "'usv', 'usv'", "one stage only"),
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
        ("[uav.tracking_reward]\nendng = 7.5\n", "uav.tracking_reward.endng", "7.5", "ending"),
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
        for team in ("usv", "uav"):
            model = load_vehicle(vehicle_file(config.team(team), file), team, config.dt, config.substeps)
            assert model.team == team


# -- vehicles --------------------------------------------------------------------------------------------


def boat_file(folder: Path, old: str, new: str) -> Path:
    """Write the shipped boat with one line changed."""
    text = (config_folder() / "vehicles" / "unity_boat.toml").read_text(encoding="utf-8")
    lines = [new if line.startswith(old) else line for line in text.splitlines()]
    assert new in lines
    file = folder / "boat.toml"
    file.write_text("\n".join(lines), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("mass", "mass = -50.0", ("mass = -50.0", "greater than 0")),
        ("mass", "mas = 50.0", ("mas", "unknown key", "did you mean 'mass'")),
        ("mass", "", ("mass", "missing")),
        ("model", "model = 'submarine'", ("model = 'submarine'", "unity_boat", "unity_aircraft")),
        ("model", "", ("model", "unity_boat")),
        ("model", "model = ['unity_boat']", ("model = ['unity_boat']", "unity_aircraft")),
        ("drag", "drag = nan", ("drag = nan", "finite")),
        ("drag", "drag = -1.0", ("drag = -1.0", "greater than or equal to 0")),
    ],
)
def test_a_wrong_vehicle_is_refused_by_name(tmp_path, old, new, parts):
    file = boat_file(tmp_path, old, new)
    with pytest.raises(ConfigError) as caught:
        load_vehicle(file, "usv", 0.02, 5)
    assert_says(str(caught.value), file, *parts)


def test_a_vehicle_of_the_other_team_is_refused():
    file = config_folder() / "vehicles" / "unity_boat.toml"
    with pytest.raises(ConfigError) as caught:
        load_vehicle(file, "uav", 0.02, 5)
    # what is allowed: the models that fly
    assert_says(str(caught.value), file, "'unity_boat'", "USV", "uav.vehicle", "unity_aircraft")


def test_a_missing_vehicle_file_lists_the_known_ones(scenario):
    file = scenario()
    message = refusal(file, "uav.vehicle=zeppelin")
    assert_says(message, "uav.vehicle = 'zeppelin'", "unity_aircraft", "unity_boat", ".toml")
    assert file.name in message or "--set" in message


def test_a_vehicle_beside_the_scenario_comes_before_the_shipped_one(scenario, tmp_path):
    file = scenario()
    (tmp_path / "vehicles").mkdir()
    own = boat_file(tmp_path, "mass", "mass = 77.0").rename(tmp_path / "vehicles" / "unity_boat.toml")
    assert vehicle_file(load_scenario(file).usv, file) == own
    assert load_vehicle(own, "usv", 0.02, 5).params.mass == 77.0


# -- overrides -------------------------------------------------------------------------------------------


def test_overrides_replace_values_of_every_type():
    config = load_scenario(
        "paper",
        [
            "usv.count=5",
            "sea.hs = 1.25",
            "uav.formation=astern",
            'name="a b"',
            "reward='paper'",
            "stages.usv.hidden_dims=[8, 4]",
            "usv.tracking_reward.coarse=2.5",
            "obstacles.fixed=[{north=1, east=2, radius=3, height=4}]",
            "sea.hs=1.5",
        ],
    )
    assert config.usv.count == 5
    assert config.sea.hs == 1.5  # the last one counts
    assert config.uav.formation == "astern"
    assert (config.name, config.reward) == ("a b", "paper")
    assert config.stages["usv"].hidden_dims == (8, 4)
    assert config.usv.tracking_reward.coarse == 2.5
    assert config.obstacles.fixed[0].height == 4.0
    untouched = load_scenario("paper")
    assert config.uav.count == untouched.uav.count
    assert config.usv.tracking_reward.fine == untouched.usv.tracking_reward.fine


@pytest.mark.parametrize("text", ["usv.count", "=3", ".=3", "usv..count=3", ""])
def test_an_override_that_is_no_assignment_is_refused(text):
    assert_says(refusal("paper", text), f"--set {text}", "KEY=VALUE", "usv.count=5")


@pytest.mark.parametrize(("text", "value"), [("seed.x=3", "seed"), ("usv.count.x=3", "usv.count")])
def test_an_override_below_a_value_is_refused(text, value):
    assert_says(refusal("paper", text), f"--set {text}", f"{value} is a value, not a section")


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("usv.count=0", ("usv.count = 0", "greater than or equal to 1")),
        ("usv.count=many", ("usv.count = 'many'", "integer")),
        ("usv=3", ("usv = 3",)),
        ("usv.cuont=3", ("usv.cuont", "3", "did you mean 'count'")),
    ],
)
def test_a_wrong_override_is_refused_as_an_override(text, parts):
    assert_says(refusal("paper", text), "--set", *parts)


def test_numbers_are_not_read_from_other_types():
    """Strict: true is not one vehicle, and a number in quotes is text."""
    for text in ("usv.count=true", 'usv.count="3"', 'sea.hs="0.5"'):
        key = text.split("=")[0]
        assert_says(refusal("paper", text), key)


# -- writing ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        (
            "obstacles.fixed=[{north=1.5, east=-2, radius=3, height=4}]",
            "stages.uav.hidden_dims=[3]",
            "seed=2",
        ),
        ("sea.depth=20", "sea.swell={hs=1, tp=9}", "sea.current={speed=0.5, profile='power', std=0.1}"),
    ],
)
def test_what_is_written_reads_the_same(tmp_path, overrides):
    config = load_scenario("paper", overrides)
    file = tmp_path / "copy.toml"
    write_toml(config, file)
    assert load_scenario(file) == config
    assert set(read_toml(file)) == set(ScenarioConfig.model_fields)  # defaults are written too


@pytest.mark.parametrize(
    "sea", ["", "sea_state = 4", "wind_speed = 9", "wind_speed = 9\nfetch = 2e4", "spectrum = 'bretschneider'"]
)
def test_a_sea_written_reads_the_same_whichever_way_it_has_its_size(scenario, tmp_path, sea):
    config = load_scenario(scenario(end=f"[sea]\n{sea}\n"))
    file = tmp_path / "copy.toml"
    write_toml(config, file)
    assert load_scenario(file) == config


def test_a_wind_alone_makes_a_fully_developed_sea(scenario):
    assert load_scenario(scenario(end="[sea]\nwind_speed = 9\n")).sea.spectrum == "pierson_moskowitz"
    assert load_scenario(scenario(end="[sea]\nwind_speed = 9\nfetch = 2e4\n")).sea.spectrum == "jonswap"


def test_values_cannot_change_after_reading():
    config = validate(ScenarioConfig, load_scenario("paper").model_dump(), "memory")
    with pytest.raises(ValueError, match="frozen"):
        config.seed = 3


def test_steps_follow_from_times():
    config = load_scenario("paper", ["dt=0.02", "decision_interval=0.1", "episode_duration=60"])
    assert (config.substeps, config.episode_steps) == (5, 600)  # 0.1 / 0.02, 60 / 0.1
    config = load_scenario("paper", ["dt=0.05", "decision_interval=0.15", "episode_duration=0.01"])
    assert (config.substeps, config.episode_steps) == (3, 1)
