"""What a scenario may say of formations: a name, or a section; what is refused, and in which words."""

import pytest
from refusal import assert_says, refusal
from small_missions import make

from rl.missions import load_scenario, make_mission
from taichi_sim.config import ConfigError
from taichi_sim.config.io import write_toml

SECTION = (
    '[usv.formation]\nshapes = ["wedge", "circle"]\nspacing_range = [10, 20.0]\nchange_every = 20.0\nglide = 2.0\n'
)


def formation(file, *overrides):
    return load_scenario(file, overrides).teams["usv"].formation


def test_a_name_is_a_shape_that_stays():
    paper = load_scenario("paper", ["usv.formation=astern"])
    team = paper.teams["usv"]
    assert (team.shapes, team.spacings, team.formation.change_every) == (("astern",), (15.0, 15.0), None)


def test_a_section_says_all(scenario, tmp_path):
    file = scenario(end=SECTION)
    config = load_scenario(file)
    team = config.teams["usv"]
    assert team.shapes == ("wedge", "circle") and team.spacings == (10.0, 20.0)
    assert (team.formation.change_every, team.formation.glide) == (20.0, 2.0)
    write_toml(config, tmp_path / "config.toml")
    assert load_scenario(tmp_path / "config.toml") == config
    write_toml(load_scenario("paper"), tmp_path / "paper.toml")
    assert load_scenario(tmp_path / "paper.toml") == load_scenario("paper")


def test_a_key_set_in_a_name_makes_it_a_section():
    set_in = formation("paper", "usv.formation.change_every=20", 'usv.formation.shapes=["wedge"]')
    assert (set_in.shape, set_in.shapes, set_in.change_every) == ("abreast", ("wedge",), 20.0)
    assert formation("paper", "usv.formation=astern", "usv.formation.glide=1.0").shape == "astern"


def test_a_name_set_in_place_of_a_section_is_all_there_is(scenario):
    file = scenario(end=SECTION)
    assert formation(file, "usv.formation=astern") == formation(scenario(), "usv.formation=astern")


def test_a_shape_set_in_a_section_takes_the_files_shapes_back(scenario):
    """And `shapes` the file's shape."""
    one = formation(scenario(end=SECTION), "usv.formation.shape=pairs")
    assert (one.shape, one.shapes, one.change_every) == ("pairs", None, 20.0)


@pytest.mark.parametrize(
    ("override", "parts"),
    [
        ("usv.formation=wegde", ("usv.formation.shape = 'wegde'", "'abreast'", "did you mean 'wedge'?")),
        (
            'usv.formation.shapes=["wedge", "eshelon"]',
            ("usv.formation.shapes.1 = 'eshelon'", "did you mean 'echelon'?"),
        ),
        ("usv.formation.shapes=[]", ("usv.formation.shapes", "at least 1")),
        ("usv.formation.change_every=0", ("usv.formation.change_every = 0", "greater than 0")),
        ("usv.formation.change_every=-3.5", ("usv.formation.change_every = -3.5", "greater than 0")),
        ("usv.formation.spacing_range=[20, 10]", ("usv.formation", "spacing_range = [20, 10]", "first")),
        ("usv.formation.spacing_range=[0, 10]", ("usv.formation.spacing_range.0 = 0", "greater than 0")),
        ("usv.formation.gilde=1", ("usv.formation.gilde", "did you mean 'glide'?")),
        ("usv.formation=3", ("usv.formation = 3",)),
        ("usv.formation.shape.x=3", ("usv.formation.shape is a value, not a section",)),
    ],
)
def test_what_is_wrong_is_told_by_its_key(override, parts):
    message = refusal("paper", override)
    assert_says(message, f"--set {override}", *parts)
    assert "team has a vehicle" not in message


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (("usv.formation.spacing_range=[4, 20]",), ("usv.formation.spacing_range = [4.0, 20.0]", "4.4 m")),
        (("usv.count=16",), ("track.min_radius = 100.0", "'abreast'", "usv.count = 16", "15 m apart", "120 m")),
        (("usv.formation.spacing_range=[10, 110]",), ("usv.count = 3", "110 m apart")),
        (('uav.formation.shapes=["astern", "echelon"]', "uav.count=11"), ("uav's", "'echelon'", "106 m")),
    ],
)
def test_a_formation_that_the_vehicles_or_the_track_leave_no_room_for_is_refused(overrides, parts):
    with pytest.raises(ConfigError) as caught:
        make(*overrides)
    assert_says(str(caught.value), *parts)


def test_a_target_that_is_faster_than_its_boats_is_refused():
    """An Otter makes 3.09 m/s (thrust over linear damping, Fossen's model)."""
    config = load_scenario("cruise", ("track.worlds=2", "sea.realisations=2", "usv.target_speed=3.2"))
    with pytest.raises(ConfigError, match=r"usv\.target_speed = 3\.2: .*'otter' goes at most 3\.09 m/s"):
        make_mission(config, 1, seed=1)
