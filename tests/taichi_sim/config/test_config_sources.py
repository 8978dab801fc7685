"""Where a scenario's numbers come from and go to: vehicle files, overrides, written copies."""

from pathlib import Path

import pytest
from refusal import assert_says, refusal

from rl.missions import load_scenario
from rl.missions.formation.config import FormationScenario
from taichi_sim.config import ConfigError
from taichi_sim.config.io import config_folder, read_toml, validate, vehicle_file, write_toml
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.world import World

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
        load_vehicle(file)
    assert_says(str(caught.value), file, *parts)


@pytest.mark.parametrize(
    ("team", "vehicle", "moves", "meant"),
    [("usv", "unity_aircraft", "air", "water"), ("uav", "unity_boat", "water", "air")],
)
@pytest.mark.parametrize("shipped", ["lanes", "cruise", "aerosonde"])
def test_a_vehicle_of_another_medium_is_refused(shipped, team, vehicle, moves, meant):
    config = load_scenario(shipped, [f"{team}.vehicle={vehicle}"])
    with pytest.raises(ConfigError) as caught:
        World(config, teams=(team,))
    assert_says(str(caught.value), f"{team}.vehicle = {vehicle!r} moves in {moves}", f"{team}.medium = {meant!r}")


def test_a_team_that_names_no_medium_takes_any_vehicle(scenario):
    config = load_scenario(scenario(), ["usv.vehicle=unity_aircraft"])
    assert World(config).teams["usv"].model.medium == "air"


def test_a_missing_vehicle_file_lists_the_known_ones(scenario):
    file = scenario()
    message = refusal(file, "uav.vehicle=zeppelin")
    assert_says(message, "uav.vehicle = 'zeppelin'", "unity_aircraft", "unity_boat", ".toml")
    assert file.name in message or "--set" in message


def test_a_vehicle_beside_the_scenario_comes_before_the_shipped_one(scenario, tmp_path):
    file = scenario()
    (tmp_path / "vehicles").mkdir()
    own = boat_file(tmp_path, "mass", "mass = 77.0").rename(tmp_path / "vehicles" / "unity_boat.toml")
    assert vehicle_file(load_scenario(file).teams["usv"], file) == own
    assert load_vehicle(own).params.mass == 77.0


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
            "usv.terms.coarse.weight=2.5",
            "obstacles.fixed=[{north=1, east=2, radius=3, height=4}]",
            "sea.hs=1.5",
        ],
    )
    assert config.teams["usv"].count == 5
    assert config.sea.hs == 1.5  # the last one counts
    assert config.teams["uav"].formation.shape == "astern"
    assert (config.name, config.reward) == ("a b", "paper")
    assert config.stages["usv"].hidden_dims == (8, 4)
    assert config.teams["usv"].terms == {"coarse": {"weight": 2.5}}
    assert config.obstacles.fixed[0].height == 4.0
    untouched = load_scenario("paper")
    assert config.teams["uav"].count == untouched.teams["uav"].count


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
    written = {key for key in FormationScenario.model_fields if getattr(config, key) is not None}
    assert set(read_toml(file)) == {*written, *config.teams}  # defaults are written too


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
    config = validate(FormationScenario, load_scenario("paper").model_dump(), "memory")
    with pytest.raises(ValueError, match="frozen"):
        config.seed = 3


def test_steps_follow_from_times():
    config = load_scenario("paper", ["dt=0.02", "decision_interval=0.1", "episode_duration=60"])
    assert (config.substeps("usv", 0.1), config.episode_steps) == (5, 600)  # 0.1 / 0.02, 60 / 0.1
    config = load_scenario("paper", ["dt=0.05", "decision_interval=0.15", "episode_duration=0.14"])
    assert (config.substeps("usv", 0.1), config.episode_steps) == (3, 1)
