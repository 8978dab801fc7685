
import numpy as np
import pytest
import torch

from taichi_sim.config import ConfigError
from taichi_sim.state.divergence_dump import load_dump
from taichi_sim.world import ActionError, Script, World, replay

SMALL = ("sea.realisations=2", "sea.components=4", "usv.count=1", "uav.count=1")
HARBOUR = """
[sea]
realisations = 2
components = 4
[ferry]
vehicle = "unity_boat"
count = 2
medium = "water"
[gulls]
vehicle = "unity_aircraft"
count = 1
"""


def make(*overrides, envs=3, teams=("usv",), **options):
    return World.from_scenario("paper", envs, overrides=(*SMALL, *overrides), teams=teams, **options)


def still(world):
    return {name: torch.zeros((world.num_envs, t.count, len(t.model.action_names))) for name, t in world.teams.items()}


@pytest.fixture
def harbour(tmp_path):
    """Write a world of teams of any name, with `more` at its end."""

    def write(more=""):
        file = tmp_path / "harbour.toml"
        file.write_text(HARBOUR + more)
        return file

    return write


class TestTeams:
    def test_actions_are_tensors_or_arrays_and_are_clipped(self):
        states = []
        for kind, action in ((np.full, 2.0), (torch.full, 1.0)):
            world = make()
            taken = world.step({"usv": kind((3, 1, 2), action)})
            assert torch.equal(taken["usv"], torch.ones((3, 1, 2)))
            assert torch.equal(world.teams["usv"].action, taken["usv"])
            states.append(world.teams["usv"].state)
        assert torch.equal(*states)

    @pytest.mark.parametrize(
        ("actions", "error", "message"),
        [
            ({}, ValueError, r"expected one tensor for each of \['usv'\]"),
            ({"usv": np.zeros((3, 1, 2)), "fish": np.zeros(1)}, ValueError, r"\['fish', 'usv'\]"),
            ({"usv": np.zeros((3, 2))}, ValueError, r"shape \(3, 2\), expected \(3, 1, 2\)"),
            (
                {"usv": np.array([[[0, 0]], [[0, np.nan]], [[0, 0]]])},
                ActionError,
                "'yaw' of usv_0 in environment 1",
            ),
        ],
    )
    def test_other_actions_are_refused_and_nothing_moves(self, actions, error, message):
        world = make()
        before = world.teams["usv"].state.clone(), world.time.clone()
        with pytest.raises(error, match=message):
            world.step(actions)
        assert torch.equal(world.teams["usv"].state, before[0]) and torch.equal(world.time, before[1])

    def test_a_scripted_team_acts_by_itself_unless_it_is_told(self):
        world, seen = make(teams=("usv", "uav")), []

        class Ahead(Script):
            def __call__(self, of):
                seen.append(float(of.time[0]))
                return np.ones((3, 1, 2))

        world.scripts["usv"] = Ahead(world, "usv")
        uav = {"uav": np.zeros((3, 1, 3))}
        assert bool((world.step(uav)["usv"] == 1).all())
        assert bool((world.step(uav | {"usv": np.zeros((3, 1, 2))})["usv"] == 0).all())
        world.step(uav)
        assert seen == pytest.approx([0.0, 0.2])

    def test_a_script_does_not_act_before_the_actions_of_others_are_right(self):
        world, acted = make(teams=("usv", "uav")), []

        class Lost(Script):
            def __call__(self, of):
                acted.append(float(of.time[0]))
                return np.full((3, 1, 2), np.nan)

        world.scripts["usv"] = Lost(world, "usv")
        before = world.snapshot().values
        for wrong in (np.full((3, 1, 3), np.inf), np.zeros((3, 3)), [["a"]], None):
            with pytest.raises(ActionError, match="uav"):
                world.step({"uav": wrong})
        for wrong in ({}, None, {"uav": np.zeros((3, 1, 3)), "fish": 0}, np.zeros((3, 1, 3))):
            with pytest.raises(ActionError, match="actions are"):
                world.step(wrong)
        assert not acted
        with pytest.raises(ActionError, match="the script of usv: usv action 'acceleration' of usv_0 .* is nan"):
            world.step({"uav": np.zeros((3, 1, 3))})
        for path, value in world.snapshot().values.items():
            assert torch.equal(value, before[path]) if isinstance(value, torch.Tensor) else value == before[path], path

    def test_a_script_is_named_in_the_team_s_section(self, harbour, tmp_path):
        (tmp_path / "my_pilot.py").write_text(
            "import taichi_sim as ts\n"
            "class Pilot(ts.Script):\n"
            "    def begin(self, world, envs):\n"
            "        state = world.teams[self.name].state[envs].clone()\n"
            "        state[..., 2] = -50.0\n"
            "        world.place(self.name, envs, state)\n"
            "    def __call__(self, world): return world.teams[self.name].action + 0.25\n"
        )
        world = World.from_scenario(harbour('script = "my_pilot:Pilot"\n'), 2)
        gulls = world.teams["gulls"]
        for step in (1, 2):
            taken = world.step({"ferry": np.zeros((2, 2, 2))})
            assert bool((taken["gulls"] == 0.25 * step).all())
        assert bool((gulls.state[..., 2] != -50.0).all())
        world.renew(torch.tensor([1]))
        assert (gulls.state[:, 0, 2] == -50.0).tolist() == [False, True]

    def test_a_team_that_is_not_there_is_refused(self):
        with pytest.raises(ValueError, match="no team 'fish': allowed are usv, uav"):
            make(teams=("fish",))

    def test_a_vehicle_of_another_medium_is_refused(self, harbour):
        file = harbour('medium = "water"\n')
        with pytest.raises(
            ConfigError, match="gulls.vehicle = 'unity_aircraft' moves in air, and gulls.medium = 'water'"
        ):
            World.from_scenario(file, 1)
        assert World.from_scenario(file, 1, teams=("ferry",)).teams.keys() == {"ferry"}

    def test_teams_of_one_vehicle_do_not_touch_each_other(self, harbour):
        world = World.from_scenario(harbour('[tug]\nvehicle = "unity_boat"\ncount = 2\n'), 2)
        ferry, tug = world.teams["ferry"], world.teams["tug"]
        apart = (tug.position_n[:, 1] - tug.position_n[:, 0]).norm(dim=-1)  # else two boats begin in one place
        assert bool((apart > 2 * tug.model.collision_radius).all())
        tug.set_numbers({"mass": 70.0})
        before = world.teams["ferry"].state.clone()
        world.step({"ferry": np.full((2, 2, 2), -1.0), "tug": np.full((2, 2, 2), 1.0), "gulls": np.zeros((2, 1, 3))})
        assert ferry.model is tug.model and not ferry.varied
        assert bool((tug.velocity_n[..., 0] > ferry.velocity_n[..., 0] + 1.0).all())
        assert not torch.equal(before, ferry.state)


class TestDumps:
    @pytest.fixture
    def world(self, tmp_path):
        world = make()
        world.dump_folder = tmp_path / "dumps"
        return world

    def test_a_state_that_stops_being_finite_is_written_and_runs_again(self, world, tmp_path):
        world.teams["usv"].state[1, 0, 12] = 1e38  # a yaw rate whose square no number holds
        before = world.teams["usv"].state[1].clone()
        world.step(still(world))
        after = world.teams["usv"].state[:, 0]
        assert torch.isfinite(after[[0, 2]]).all()
        assert not torch.isfinite(after[1]).all()
        (file,) = (tmp_path / "dumps").glob("*.dump")
        dump = load_dump(file)
        assert dump.states["usv"].equal(before) and not dump.vary and not dump.loads
        again = replay(dump).teams["usv"].state[0, 0]
        assert torch.equal(again.isnan(), after[1].isnan())

    def test_numbers_and_loads_of_a_vehicle_are_dumped_with_it(self, tmp_path):
        """One boat leaves the physical; the replay moves the other of its environment as it moved, to the last bit."""
        world = make("usv.count=2", "sea.current.speed=0.3")
        world.dump_folder = tmp_path / "dumps"
        fleet = world.teams["usv"]
        masses = torch.tensor([[45.0, 46.0], [60.0, 61.5], [75.0, 76.0]])
        fleet.set_numbers({"mass": masses, "drag": 0.9})
        fleet.load[1, 1, 0] = 300.0
        for _ in range(3):
            world.step(still(world))
        fleet.state[1, 0, 12] = 1e38
        world.step(still(world))
        (file,) = (tmp_path / "dumps").glob("*.dump")
        dump = load_dump(file)
        assert {key: value.tolist() for key, value in dump.vary["usv"].items()} == {
            **{key: [value] * 2 for key, value in fleet.model.nominal.items()}, "mass": [60.0, 61.5], "drag": [0.9] * 2
        }  # fmt: skip
        assert dump.loads["usv"][1].tolist() == [300.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        again = replay(dump).teams["usv"]
        assert torch.equal(again.state[0, 1], fleet.state[1, 1])
        assert not torch.isfinite(again.state[0, 0]).all()

    def test_a_healthy_world_writes_nothing(self, world, tmp_path):
        for _ in range(3):
            world.step(still(world))
        assert not (tmp_path / "dumps").exists()

    def test_a_fault_is_written_once(self, world, tmp_path):
        world.teams["usv"].state[0, 0, 7] = float("nan")
        world.step(still(world))  # broken before the step: nothing to learn from it
        assert not (tmp_path / "dumps").exists()

    def test_a_file_that_is_no_dump_is_refused(self, tmp_path):
        file = tmp_path / "x.dump"
        file.write_text("nonsense")
        with pytest.raises(ValueError, match="x.dump: not a dump"):
            load_dump(file)

    def test_the_command_says_what_is_wrong(self, tmp_path, capsys):
        from tools.replay import main

        assert main([str(tmp_path / "missing.dump")]) == 2
        assert "missing.dump" in capsys.readouterr().err


class TestSurroundings:
    def test_current_and_wind_reach_the_vehicles(self):
        world = make(
            "sea.hs=0", "sea.tp=4", "sea.current.speed=1", "air.speed=5", "air.direction_deg=90", teams=("usv", "uav")
        )
        assert world.around.current.tolist() == [[1.0, 0.0]] * 3
        assert torch.allclose(world.around.wind, torch.tensor([0.0, -5.0, 0.0]), atol=1e-5)
        assert all(torch.equal(world.felt(team).current, world.around.current) for team in world.teams)

    def test_they_vary_from_step_to_step_and_from_environment_to_environment(self):
        world = make("sea.current.std=0.2", "air.std=1")
        first = world.around.current.clone(), world.around.wind.clone()
        world.step(still(world))
        for before, now in zip(first, (world.around.current, world.around.wind), strict=True):
            assert not torch.equal(before, now)
            assert not torch.equal(now[0], now[1])

    def test_an_episode_begins_with_a_current_of_its_own(self):
        world = make("sea.current.std=0.2")
        before = world.around.current.clone()
        world.renew(torch.tensor([1]))
        assert torch.equal(world.around.current[0], before[0])
        assert not torch.equal(world.around.current[1], before[1])

    def test_a_sea_that_follows_the_wind_is_its_developed_sea_and_travels_with_it(self):
        wind = ("air.speed=10", "air.direction_deg=90")
        follows = make(*wind, "sea.follows_wind=true").sea
        given = make("sea.wind_speed=10", "sea.direction_deg=270")
        assert torch.allclose(follows.table, given.sea.table, atol=1e-4)
        calm = make("sea.follows_wind=true").sea
        assert float(calm.components.hs.max()) == 0.0


def test_teams_of_one_world_step_differently(scenario):
    """Each as it does alone with its step as the scenario's `dt`; a vehicle file's step is made to divide."""
    both = World.from_scenario(scenario("", "dt = 0.02\n"), overrides=["usv.dt=0.05"])
    assert (both.teams["usv"].dt, both.teams["usv"].model.substeps) == (0.05, 2)
    assert (both.teams["uav"].dt, both.teams["uav"].model.substeps) == (0.02, 5)
    idle = {name: np.full((1, fleet.count, len(fleet.model.action_names)), 0.3) for name, fleet in both.teams.items()}
    both.step(idle)
    for name, dt in (("usv", 0.05), ("uav", 0.02)):
        alone = World.from_scenario(scenario(), overrides=[f"dt={dt}"])
        alone.step(idle)
        assert torch.equal(alone.teams[name].state, both.teams[name].state)
    own = World.from_scenario(scenario(), overrides=["usv.vehicle='kvlcc2'", "usv.count=1"])
    assert own.teams["usv"].dt == pytest.approx(0.05)  # of at most 0.07 s


@pytest.mark.parametrize(
    ("override", "key"), [("dt=0.1", "dt: "), ("uav.dt=0.1", "uav.dt: ")]
)  # fmt: skip
def test_a_step_above_the_largest_stable_one_is_refused_by_its_key(scenario, override, key):
    with pytest.raises(ConfigError, match=rf"^{key}.*aerosonde.*largest stable dt is 0\.0776 s"):
        World.from_scenario(scenario(), overrides=["uav.vehicle='aerosonde'", override])
