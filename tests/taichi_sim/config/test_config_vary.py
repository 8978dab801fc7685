"""Ranges in scenarios: how they are given, overridden and taken back, and what is refused."""

import pytest
from named_thrusters import write_hull
from refusal import assert_says, refusal

from rl.missions import load_scenario
from taichi_sim.config import Range
from taichi_sim.config.io import write_toml
from taichi_sim.randomisation.conditions import nominal_conditions
from taichi_sim.surroundings.sea.wind_sea import swell_size

MASS = "[usv.vary]\nmass = { factor = [0.9, 1.2] }\n"
SEA = '[sea]\nhs = 0.5\ntp = 4.0\n[vary]\n"sea.hs" = [0.2, 1.0]\n"air.speed" = { add = [0, 3] }\n'


@pytest.mark.parametrize(
    ("end", "parts"),
    [
        ("[usv.vary]\nmass = { factor = [1.2, 0.9] }\n", ("usv.vary.mass: factor = [1.2, 0.9]", "must not be above")),
        ("[usv.vary]\nmass = [nan, 60]\n", ("usv.vary.mass.range.0 = nan", "finite")),
        ("[usv.vary]\nmass = [40, inf]\n", ("usv.vary.mass.range.1 = inf", "finite")),
        ("[usv.vary]\nmass = { factor = [1, 2], add = [0, 1] }\n", ("exactly one of range", "given: factor, add")),
        ("[usv.vary]\nmass = { distribution = 'normal' }\n", ("exactly one of range, factor, add; given: none",)),
        ("[usv.vary]\nmass = { factr = [1, 2] }\n", ("usv.vary.mass.factr", "did you mean 'factor'", "distribution")),
        ("[usv.vary]\nmass = { add = [1, 2], distribution = 'flat' }\n", ("distribution = 'flat'", "'uniform'")),
        ("[usv.vary]\nmass = 50\n", ("usv.vary.mass = 50",)),
        ("[vary]\nsea.hss = [0, 1]\n", ("vary.sea.hss", "did you mean 'sea.hs'", "allowed here: sea.hs, sea.tp")),
        ("[vary]\nsea.hs = [0, 1]\nsea.sea_state = [1, 2]\n", ("sea.hs and sea.sea_state", "vary it, or these")),
        ("[sea]\nfollows_wind = true\n[vary]\nsea.hs = [0, 1]\n", ("vary.sea.hs", "vary air.speed and air.direction")),
        ("[sea]\nfollows_wind = true\n[vary]\nsea.direction_deg = [0, 9]\n", ("sea.direction_deg", "follows the wind")),
        ("[sea]\nwind_speed = 9\n[vary]\nsea.tp = [3, 9]\n", ("vary.sea.tp", "given by sea.wind_speed")),
        ("[varry]\nsea.hs = [0, 1]\n", ("varry: unknown key", "did you mean 'vary'")),
    ],
)
def test_a_wrong_range_is_refused_by_name(scenario, end, parts):
    assert_says(refusal(scenario("", end)), *parts)


def test_a_negative_variation_is_refused():
    assert_says(refusal("paper", "variation=-1"), "variation = -1", "greater than or equal to 0")


@pytest.mark.parametrize(
    ("given", "nominal", "variation", "ends"),
    [
        ({"range": (1.0, 4.0)}, 2.0, 1.0, (1.0, 4.0)),
        ({"range": (1.0, 4.0)}, 2.0, 2.0, (0.0, 6.0)),
        ({"range": (1.0, 4.0)}, 2.0, 0.0, (2.0, 2.0)),
        ({"range": (3.0, 4.0)}, 2.0, 0.5, (2.5, 3.0)),  # one that does not contain it: both ends move from it
        ({"factor": (0.9, 1.2)}, -10.0, 1.0, (-12.0, -9.0)),
        ({"add": (-1.0, 2.0)}, 10.0, 0.5, (9.5, 11.0)),
    ],
)
def test_ends_move_in_proportion_from_the_nominal_value(given, nominal, variation, ends):
    assert Range(**given).ends(nominal, variation) == pytest.approx(ends)


def test_a_factor_of_nothing_is_refused():
    with pytest.raises(ValueError, match="nominal value is 0: use add or range"):
        Range(factor=(0.5, 2.0)).ends(0.0)


def test_keys_may_be_quoted_or_nested_and_a_written_copy_is_the_same(scenario, tmp_path):
    nested = load_scenario(scenario("", "[usv.vary.a.b]\n0 = [1, 2]\nc = { add = [1, 2] }\n"))
    flat = load_scenario(scenario("", '[usv.vary]\n"a.b.0" = { range = [1, 2] }\n"a.b.c".add = [1, 2]\n'))
    assert nested == flat and set(nested.teams["usv"].vary) == {"a.b.0", "a.b.c"}
    write_toml(nested, tmp_path / "copy.toml")
    assert load_scenario(tmp_path / "copy.toml") == nested


@pytest.mark.parametrize("key", ["usv.vary.rigid_body.mass", 'usv.vary."rigid_body.mass"'])
def test_an_override_sets_a_range_by_its_dotted_key(scenario, key):
    config = load_scenario(scenario("", MASS), [f"{key}={{add=[0, 5]}}"])
    assert config.teams["usv"].vary == {"mass": Range(factor=(0.9, 1.2)), "rigid_body.mass": Range(add=(0.0, 5.0))}


def test_an_override_of_one_number_of_a_range_takes_another_way_back(scenario):
    changed = load_scenario(scenario("", MASS), ["usv.vary.mass.add=[1, 2]", "usv.vary.mass.distribution=normal"])
    assert changed.teams["usv"].vary == {"mass": Range(add=(1.0, 2.0), distribution="normal")}
    assert_says(refusal(scenario("", MASS), "usv.vary.mass=[2, 1]"), "--set usv.vary.mass=[2, 1]", "must not be above")


@pytest.mark.parametrize(
    ("override", "left"),
    [
        (["sea.sea_state=3"], {"air.speed"}),
        (["sea.hs=1", "sea.tp=5"], {"air.speed"}),
        (["sea.follows_wind=true"], {"air.speed"}),
        (["air.beaufort=3"], {"sea.hs"}),
        (["vary.sea.sea_state=[1, 2]"], {"air.speed", "sea.sea_state"}),
        (["sea.hs=1", "sea.tp=5", "vary.sea.tp=[4, 6]"], {"air.speed", "sea.tp"}),
        (["vary={}"], set()),
        (["sea.current.speed=1"], {"sea.hs", "air.speed"}),
    ],
)
def test_a_condition_that_is_overridden_no_longer_varies(scenario, override, left):
    assert set(load_scenario(scenario("", SEA), override).vary) == left


@pytest.mark.parametrize("name", ["cruise", "paper", "aerosonde", "escort"])
def test_a_height_alone_keeps_the_steepness(name):
    """Of what a scenario gives, whichever way: hs / tp^2 stays; so does that of a swell, which has 0.005 by itself."""
    config = load_scenario(name, ["variation=0"])
    calm, rough = (nominal_conditions(of) for of in (config, load_scenario(name, ["sea.hs=1.2", "variation=0"])))
    assert rough["sea.hs"] == 1.2
    assert rough["sea.hs"] / rough["sea.tp"] ** 2 == pytest.approx(calm["sea.hs"] / calm["sea.tp"] ** 2)
    swell = [load_scenario(name, sets).sea.swell for sets in
             (["sea.swell.hs=0.5"], ["sea.swell={hs=0.5, tp=8}", "seed=2"])]  # fmt: skip
    assert [swell_size(of).tp for of in swell] == pytest.approx([8.0, 8.0], rel=1e-3)


def test_a_swell_of_another_height_keeps_its_steepness(scenario):
    file = scenario("", "[sea]\nhs = 0.5\ntp = 4.0\nswell = { hs = 1.0, tp = 10.0 }\n")
    assert swell_size(load_scenario(file, ["sea.swell.hs=0.25"]).sea.swell) == (0.25, 5.0)
    assert swell_size(load_scenario(file, ["sea.swell.hs=2", "sea.swell.tp=9"]).sea.swell) == (2.0, 9.0)
    assert load_scenario(file, ["sea.hs=2"]).sea.tp == 8.0


def test_numbers_do_not_outlive_their_vehicle(scenario):
    config = load_scenario(scenario("", MASS), ["usv.vehicle=otter"])
    assert config.teams["usv"].vary == {}
    assert "usv.vary: mass: dropped, no number of otter" in config.replaced


CRUISE = load_scenario("cruise")
FACTORS = {key: given for key, given in CRUISE.teams["usv"].vary.items() if given.factor}


@pytest.mark.parametrize(
    ("vehicle", "numbers", "overrides", "kept", "told"),
    [
        ("azimuth", {}, (), {"spacing": 6.0}, ("gain_right: for actuators.l.gain, actuators.r.gain",)),
        ("wamv", {}, (), {"target_speed": 1.12, "spacing": 14.7, "lost_distance": 98.0, "start_distance": 8.0},
         ("usv.spacing: 6.0 -> 14.7, by length", "obstacles.track_clearance: 8.0 -> 16.7", "berth 0.623 -> 1.53",
          "rigid_body.cg.1: add [-0.02, 0.02] -> [-0.049, 0.049], by length", "added_mass.5: dropped, 0 in wamv")),
        ("azimuth", {"like": "wamv"}, ("usv.spacing=7", "usv.vary={}", "usv.control.berth=1", "usv.target_speed=1"),
         {"spacing": 7.0, "target_speed": 1.0}, ("margin 0.299 -> 0.733",)),
        ("otter_3dof", {}, (), {"control": {}}, ("usv.control: dropped", "no number of otter_3dof")),
        ("units", {"actions": "units"}, (), {"spacing": 6.0}, ("no classical controller", 'actions = "wrench"')),
        ("kvlcc2", {}, (), {"control": {}}, ("no classical controller acts for it: write one",)),
    ],
)  # fmt: skip
def test_another_vehicle_keeps_what_holds_and_the_rest_is_told(vehicle, numbers, overrides, kept, told, tmp_path):
    """Of `cruise`: factors stay where the vehicle has the number; nothing that changed is missing in the list."""
    named = vehicle in ("azimuth", "units")
    file = write_hull(tmp_path / f"{vehicle}.toml", **numbers) if named else vehicle
    config = load_scenario("cruise", [f"usv.vehicle={file}", *overrides])
    team, words = config.formations["usv"], "\n".join(config.replaced)
    assert {key: getattr(team, key) for key in kept} == kept
    for text in told:
        assert text in words
    if named and not overrides:
        assert {key: team.vary[key] for key in FACTORS if not key.startswith("thrusters.")} == {
            key: given for key, given in FACTORS.items() if not key.startswith("thrusters.")
        }
        assert team.vary["actuators.l.gain"] == CRUISE.teams["usv"].vary["thrusters.gain_left"]
        assert team.vary["actuators.r.lag"] == CRUISE.teams["usv"].vary["thrusters.lag"]
    before = CRUISE.formations["usv"].model_dump(exclude={"vehicle"})
    for key, value in team.model_dump(exclude={"vehicle"}).items():
        given = any(text.startswith(f"usv.{key}") for text in overrides)
        assert value == before[key] or given or f"usv.{key}" in words, key
    dumped = tmp_path / "again.toml"
    write_toml(config, dumped)
    assert load_scenario(dumped).replaced == config.replaced


def test_the_same_vehicle_changes_nothing():
    assert load_scenario("cruise", ["usv.vehicle=otter"]) == CRUISE
