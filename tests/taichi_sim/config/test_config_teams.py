"""Teams and missions of a scenario: sections of any name, and slips of the pen that would make one silently another."""

import pytest
from refusal import assert_says, refusal

from rl.missions import find_mission, load_scenario, shipped
from rl.missions.formation.mission import Formation
from taichi_sim.config import ConfigError
from taichi_sim.config.io import load_world
from taichi_sim.world import World

THIRD = '[pilot]\nvehicle = "unity_boat"\ncount = 1\n'

# -- teams --------------------------------------------------------------------------------------------------------


def test_every_section_with_a_vehicle_is_a_team_in_the_order_of_the_file(scenario):
    config = load_scenario(scenario(end=THIRD + '[stages.a]\nteam = "pilot"\n'))
    assert list(config.teams) == ["usv", "uav", "pilot"]
    assert config.trained == ("pilot",) and config.teams["pilot"].spacing == 15.0


@pytest.mark.parametrize(
    ("end", "said"),
    [
        ("[obstacle]\ncount = 5\nradius_min = 2.0\n", "obstacle: unknown key, did you mean 'obstacles'?"),
        ("[stage.a]\nteam = 'usv'\n", "stage: unknown key, did you mean 'stages'?"),
        ("[pilot]\ncount = 2\n", "pilot: unknown key (a team has a vehicle)"),
        ("[pilot]\nvehicl = 'unity_boat'\n", "pilot.vehicl = 'unity_boat': unknown key, did you mean 'vehicle'?"),
        (THIRD + "spacng = 5.0\n", "pilot.spacng = 5.0: unknown key, did you mean 'spacing'?"),
        (THIRD + "terms.corse.weight = 1.0\n", "pilot.terms.corse = {'weight': 1.0}: unknown key, did you mean 'co"),
    ],
)
def test_a_slip_is_told_once_with_what_was_meant(scenario, end, said):
    file = scenario(end=end)
    message = refusal(file)
    assert_says(message, f"{file}: {said}")
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    ("override", "said"),
    [("obstacle.count=5", "obstacle: unknown key"), ("usv.start_distance=300", "usv: start_distance = 300.0 must be")],
)
def test_a_mistake_of_a_section_names_what_was_set_in_it(scenario, override, said):
    assert_says(refusal(scenario(), override), f"little.toml with --set {override}: {said}")


def test_a_stage_of_a_team_that_is_not_there_names_the_nearest(scenario):
    file = scenario(end=THIRD + '[stages.a]\nteam = "pilto"\n')
    assert_says(refusal(file), file, "stages.a.team = 'pilto'", "did you mean 'pilot'?", "'usv', 'uav', 'pilot'")


def test_a_stage_of_a_scripted_team_is_refused(scenario):
    file = scenario(end=THIRD + 'script = "traffic:Ferry"\n[stages.a]\nteam = "pilot"\n')
    assert_says(refusal(file), "stages.a.team = 'pilot'", "script")


# -- missions -----------------------------------------------------------------------------------------------------


def test_missions_are_found_by_name():
    assert shipped() == ("encounter", "escort", "formation", "landing", "station")
    assert find_mission("formation") is Formation


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("'formtion'", ("'formtion'", "formation", "module:Class")),
        ("3", ("3", "formation")),
        ("'nowhere:Thing'", ("'nowhere:Thing'", "no module 'nowhere' beside the file")),
        ("'mine:Thing'", ("'mine:Thing'", "mine.py", "has no 'Thing'")),
        ("'mine:number'", ("'mine:number'", "number is not a class that derives from rl.mission.Mission")),
        ("'mine:'", ("'mine:'", "expected module:Class")),
        ("'broken:Thing'", ("'broken:Thing'", "importing broken failed", "division by zero")),
    ],
)
def test_a_mission_that_is_not_there_is_named_as_the_file_has_it(scenario, tmp_path, name, parts):
    (tmp_path / "mine.py").write_text("number = 3\n", encoding="utf-8")
    (tmp_path / "broken.py").write_text("1 / 0\n", encoding="utf-8")
    file = scenario(f"mission = {name}\n")
    assert_says(refusal(file), f"{file}: mission = {parts[0]}", *parts)
    assert_says(refusal(scenario(), f"mission={name}"), f"--set mission={name}: mission = ")


def test_a_script_that_is_not_there_is_named(scenario, tmp_path):
    file = scenario(end=THIRD + 'script = "traffic:Ferry"\n')
    with pytest.raises(ConfigError) as caught:
        World(load_scenario(file), source=file)
    assert_says(str(caught.value), "pilot.script = 'traffic:Ferry'", "no module 'traffic'")
    (tmp_path / "traffic.py").write_text("def Ferry(world, name):\n    return None\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="derives from taichi_sim.world.Script"):
        World(load_scenario(file), source=file)


# -- the world alone ----------------------------------------------------------------------------------------------


def test_a_world_leaves_out_what_only_a_mission_knows(scenario):
    file = scenario(
        'mission = "nowhere:Thing"\nreward = "fame"\narea = -1\n',
        "formation = 'abreast'\n[goals]\nnorth = 3\n[stages.a]\nteam = 'nobody'\n",
    )
    config = load_world(file, ("usv.spacing=-4", "usv.count=2"))
    assert list(config.teams) == ["usv", "uav"] and config.teams["usv"].count == 2
    world = World.from_scenario(file, 2, ("usv.count=2",), teams=("usv",))
    assert world.teams["usv"].state.shape[:2] == (2, 2)


@pytest.mark.parametrize(
    ("top", "end", "said"),
    [
        ("sede = 3\n", "", "sede = 3: unknown key, did you mean 'seed'?"),
        ("decision_intervall = 0.1\n", "", "decision_intervall = 0.1: unknown key, did you mean 'decision_interval'?"),
        ("", "[seas]\nhs = 1.0\n", "seas = {'hs': 1.0}: unknown key, did you mean 'sea'?"),
        ("", "cuont = 2\n", "uav.cuont = 2: unknown key, did you mean 'count'?"),
        ("", "[pilot]\nvehicel = 'unity_boat'\n", "pilot.vehicel = 'unity_boat': unknown key, did you mean 'vehicle'?"),
        ("", "[sea]\ngama_js = 2.0\n", "sea.gama_js = 2.0: unknown key, did you mean 'gamma_js'?"),
        ("", "[sea.current]\nsped = 2.0\n", "sea.current.sped = 2.0: unknown key, did you mean 'speed'?"),
        ("dt = -1\n", "", "dt = -1: input should be greater than 0"),
    ],
)
def test_a_world_refuses_slips_of_what_it_knows(scenario, top, end, said):
    file = scenario(top, end)
    with pytest.raises(ConfigError) as caught:
        load_world(file)
    assert_says(str(caught.value), f"{file}: {said}")


def test_a_world_is_that_of_the_scenario(scenario):
    """The same seas, teams and times, whichever of the two reads the file."""
    file = scenario("dt = 0.01\nseed = 4\n", THIRD + "[sea]\nsea_state = 3\n")
    assert load_scenario(file).bare() == load_world(file)
