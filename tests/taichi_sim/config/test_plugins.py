"""Vehicles of somebody else's: where their modules are found, what is said of those that are not, how they move."""

import pickle
import shutil
import sys

import numpy as np
import pytest
import torch
from folders import TESTS
from refusal import assert_says

from taichi_sim.bench import Bench, pack_state
from taichi_sim.config import ConfigError
from taichi_sim.config.plugins import imported_from, load_class, plugin_source
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.state.memory import StateError
from taichi_sim.vehicle import Vehicle
from taichi_sim.world import World

MODULE = TESTS / "example_boat.py"
NUMBERS = "mass = 100.0\ndrag = 50.0\nforce_max = 200.0\nsize = [4.0, 2.0, 1.0]\ncollision_radius = 2.2\n"
SCENARIO = """
name = "harbour"
[sea]
hs = 0.3
tp = 4.0
components = 4
realisations = 2
current = { speed = 0.5, direction_deg = 90.0 }
[ferry]
vehicle = "mine"
count = 1
[tug]
vehicle = "unity_boat"
count = 2
"""


@pytest.fixture(autouse=True)
def forgotten():
    """What a test imports is nobody else's."""
    before, path = set(sys.modules), list(sys.path)
    yield
    assert sys.path == path
    for name in set(sys.modules) - before:
        if name.startswith("my_"):
            del sys.modules[name]


@pytest.fixture
def write(tmp_path):
    """Write a vehicle file, in a folder of its own, and its module where the test wants it."""

    def make(model="my_boat:MyBoat", module=None, text=None):
        file = tmp_path / "vehicles" / "mine.toml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(f'model = "{model}"\n{NUMBERS}')
        if module is not None:
            module.mkdir(exist_ok=True)
            (module / "my_boat.py").write_text(MODULE.read_text() if text is None else text)
        return file

    return make


def refusal(file, source=None):
    with pytest.raises(ConfigError) as caught:
        load_vehicle(file, source=source)
    return str(caught.value)


@pytest.mark.parametrize("place", ["vehicle", "scenario", "working"])
def test_a_module_is_found_beside_its_vehicle_beside_the_scenario_and_in_the_working_folder(
    place, write, tmp_path, monkeypatch
):
    folder = {"vehicle": tmp_path / "vehicles", "scenario": tmp_path, "working": tmp_path / "working"}[place]
    file = write(module=folder)
    if place == "working":
        monkeypatch.chdir(folder)
    model = load_vehicle(file, source=tmp_path / "harbour.toml")
    assert isinstance(model, Vehicle) and type(model).__name__ == "MyBoat"
    assert sys.modules["my_boat"].__file__ == str(folder / "my_boat.py")
    assert model.size == (4.0, 2.0, 1.0)


def test_the_nearest_of_several_modules_counts(write, tmp_path, monkeypatch):
    file = write(module=tmp_path / "vehicles")
    write(module=tmp_path / "working", text="raise RuntimeError('not this one')")
    monkeypatch.chdir(tmp_path / "working")
    assert load_vehicle(file).action_names == ("ahead", "right")


def test_each_vehicle_has_the_module_beside_it_whatever_was_loaded_before(write, tmp_path):
    """Above the other, below it, or of a name that goes on."""
    file = write(module=tmp_path / "vehicles")
    for turn in range(2):  # the second time all have been loaded
        for name in (".", "vehicles", "vehicles/old", "vehicles_2"):
            folder = tmp_path / name
            folder.mkdir(exist_ok=True)
            (folder / "my_boat.py").write_text(MODULE.read_text().replace('"ahead", "right"', f'"X{name}", "Y"'))
            if name != "vehicles":
                shutil.copy(file, folder / "mine.toml")
            assert load_vehicle(folder / "mine.toml").action_names[0] == f"X{name}", turn


def test_packages_of_one_name_are_told_apart(tmp_path):
    for name in ("one", "two", "one"):
        package = tmp_path / name / "my_fleet"
        package.mkdir(parents=True, exist_ok=True)
        (package / "__init__.py").touch()
        (package / "boat.py").write_text(MODULE.read_text().replace('"mass", "drag"', f'"{name}",'))
        assert load_class("my_fleet.boat:MyBoat", Vehicle, [tmp_path / name]).varying == (name,)
        assert plugin_source("my_fleet.boat:MyBoat", [tmp_path / name]) == package
    assert plugin_source("my_nothing:MyBoat", [tmp_path]) is None


def test_each_module_has_the_helpers_beside_it_and_they_are_found_for_a_run(tmp_path):
    for name in ("one", "two", "one"):
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        (folder / "my_helper.py").write_text(f'NAMES = ("{name}",)\n')
        text = MODULE.read_text().replace('varying = ("mass", "drag")', "varying = NAMES")
        (folder / f"my_{name}.py").write_text(f"from my_helper import NAMES\n{text}")
        assert load_class(f"my_{name}:MyBoat", Vehicle, [folder]).varying == (name,)
        assert {place.name for place in imported_from(folder)} == {"my_helper.py", f"my_{name}.py"}


def test_a_class_passes_between_processes_whatever_lies_beside_the_next_one(tmp_path):
    """A run's folder holds copies of modules that lie beside each other elsewhere, too (some as links)."""
    for name in ("run", "home"):
        (tmp_path / name).mkdir()
        for module in ("my_boat", "my_tug"):
            (tmp_path / name / f"{module}.py").symlink_to(MODULE)
    kind = load_class("my_boat:MyBoat", Vehicle, [tmp_path / "run"])
    load_class("my_tug:MyBoat", Vehicle, [tmp_path / "home"])
    assert pickle.loads(pickle.dumps(kind)) is kind is load_class("my_boat:MyBoat", Vehicle, [tmp_path / "run"])
    assert load_class("my_boat:MyBoat", Vehicle, [tmp_path / "home"]) is not kind


def test_a_copy_of_a_world_has_its_vehicles_whatever_the_file_says_by_now(write, tmp_path, monkeypatch):
    file = write(module=tmp_path / "vehicles")
    scenario = tmp_path / "harbour.toml"
    scenario.write_text(SCENARIO)
    monkeypatch.chdir(tmp_path)
    world = World.from_scenario("harbour.toml", 1)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert world.fork([0], 2).teams["ferry"].model is world.teams["ferry"].model
    saved = world.snapshot()
    file.write_text(file.read_text().replace("mass = 100.0", "mass = 300.0"))
    assert world.fork([0], 2).teams["ferry"].model.params.mass == 100.0
    with pytest.raises(StateError, match="another World: vehicles"):
        World.from_scenario(scenario, 1).restore(saved)


def test_a_module_that_is_in_use_already_is_not_replaced(write, tmp_path):
    """Classes of two modules of one name would not know each other."""
    used, package = sys.modules["pydantic"], tmp_path / "vehicles" / "pydantic"
    package.mkdir(parents=True)
    for name in ("__init__.py", "boat.py"):
        (package / name).touch()
    message = refusal(write("pydantic.boat:MyBoat"))
    assert_says(message, f"another pydantic is in use already, of {used.__file__}", f"rename that of {package.parent}")
    assert sys.modules["pydantic"] is used


def test_a_module_that_only_another_vehicle_has_beside_it_is_missing(write, tmp_path):
    file, other = write(module=tmp_path / "vehicles"), tmp_path / "others" / "theirs.toml"
    load_vehicle(file)
    other.parent.mkdir()
    shutil.copy(file, other)
    assert_says(refusal(other), str(other), "no module 'my_boat'")


@pytest.mark.parametrize(
    ("model", "text", "reasons"),
    [
        ("my_missing:MyBoat", None, ("no module 'my_missing' beside the file, in the working folder, or installed",)),
        ("my_boat:YourBoat", None, ("my_boat.py has no 'YourBoat'",)),
        ("my_boat:", None, ("expected module:Class",)),
        ("my_boat:MyBoatParams", None, ("MyBoatParams is not a class that derives from taichi_sim.vehicle.Vehicle",)),
        ("my_boat:MyBoat", "import my_other_thing", ("importing my_boat failed", "my_other_thing")),
        ("my_boat:MyBoat", "def f(:", ("importing my_boat failed", "SyntaxError")),
        ("my_boat:MyBoat", "1 / 0", ("importing my_boat failed", "ZeroDivisionError")),
        ("my_boat", None, ("'my_boat': allowed are unity_boat", "module:Class of your own")),
    ],
)
def test_what_cannot_be_a_vehicle_is_refused_by_file_and_reason(model, text, reasons, write, tmp_path):
    file = write(model, tmp_path / "vehicles", text)
    assert_says(refusal(file), str(file), "model = ", model, *reasons)


def test_wrong_numbers_are_refused_by_file_and_key(write, tmp_path):
    file = write(module=tmp_path / "vehicles")
    file.write_text(file.read_text().replace("drag = 50.0", "drag = -1.0"))
    assert_says(refusal(file), str(file), "drag = -1.0")


class TestMoving:
    @pytest.fixture
    def world(self, write, tmp_path):
        write(module=tmp_path)
        scenario = tmp_path / "harbour.toml"
        scenario.write_text(SCENARIO)
        return World.from_scenario(scenario, 2)

    def test_teams_of_any_name_share_a_world(self, world, f64):
        """The ferry, in a current: v_n - V_c = F / d (1 - (1 - d dt / m)^n), exactly; others as they are alone."""
        ferry, tug = world.teams["ferry"], world.teams["tug"]
        state = torch.zeros((2, 1, 13), dtype=torch.float64)
        state[..., 3] = 1.0
        world.place("ferry", torch.arange(2), state)
        ferry.set_numbers({"mass": 200.0}, torch.tensor([1]))
        for _ in range(20):
            world.step({"ferry": np.tile([0.5, 0.0], (2, 1, 1)), "tug": np.zeros((2, 2, 2))})
        steps, dt = 20 * ferry.model.substeps, ferry.dt
        for env, mass in enumerate((100.0, 200.0)):
            decay = (1 - 50.0 * dt / mass) ** steps
            assert ferry.velocity_n[env, 0, :2].tolist() == pytest.approx([100 / 50 * (1 - decay), 0.5 * (1 - decay)])
        assert tug.state.isfinite().all() and bool((tug.state[..., 0] > 0).all())
        for fleet in (ferry, tug):
            found = fleet.model.endings(fleet, world)
            assert tuple(found) == fleet.model.ending_names and not any(bool(x.any()) for x in found.values())
        level = world.elevation(torch.arange(2), *ferry.state[..., :2].unbind(-1))
        assert ferry.state[..., 2] == pytest.approx(-level, abs=0.05)

    def test_its_equations_and_loads_are_those_of_any_vehicle(self, write, tmp_path, f64):
        model = load_vehicle(write(module=tmp_path / "vehicles"))
        rates = model.rhs(pack_state(np.zeros(6), [1.0, 0, 0, 0, 0, 0]), [200.0, 0.0], load=[100.0, 50.0, 0, 0, 0, 0])
        assert rates[0, :3].tolist() == [1.0, 0.0, 0.0]
        assert rates[0, 7:10] == pytest.approx([(200.0 + 100.0 - 50.0) / 100.0, 50.0 / 100.0, 0.0])
        team = Bench(model)
        team.fleet.load[..., 0] = 10.0
        assert team.step((0.0, 0.0)).state[0, 0, 7].item() == pytest.approx(10.0 / 100.0 * 0.02)


def test_our_own_packages_are_nobody_elses(tmp_path, monkeypatch):
    """In a checkout a folder `rl` lies in the working folder: it is neither copied nor taken for another one."""
    (tmp_path / "rl").mkdir()
    (tmp_path / "rl" / "__init__.py").write_text("raise RuntimeError\n")
    monkeypatch.chdir(tmp_path)
    assert plugin_source("rl.missions.escort.vessel:Wanderer", [tmp_path]) is None
    assert load_class("rl.missions.escort.vessel:Wanderer", beside=[tmp_path]).__name__ == "Wanderer"
