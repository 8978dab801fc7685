import subprocess
import sys
from pathlib import Path

import pytest
import torch

from taichi_sim.config.io import load_scenario
from taichi_sim.dump import load_dump
from taichi_sim.world import World, replay

ROOT = Path(__file__).resolve().parents[1]
SMALL = ("sea.realisations=2", "sea.components=4", "usv.count=1", "uav.count=1")


def still(world):
    return {name: torch.zeros((world.num_envs, 1, len(t.model.action_names))) for name, t in world.teams.items()}


@pytest.fixture
def world(tmp_path):
    world = World(load_scenario("paper", SMALL), 3, teams=("usv",))
    world.dump_folder = tmp_path / "dumps"
    return world


class TestDumps:
    def test_a_state_that_stops_being_finite_is_written_and_runs_again(self, world, tmp_path):
        world.teams["usv"].state[1, 0, 7] = 1e38  # a speed whose square no number holds
        before = world.teams["usv"].state[1].clone()
        world.step(still(world))
        after = world.teams["usv"].state[:, 0]
        assert torch.isfinite(after[[0, 2]]).all()
        assert not torch.isfinite(after[1]).all()
        (file,) = (tmp_path / "dumps").glob("*.dump")
        dump = load_dump(file)
        assert dump.states["usv"].equal(before)
        again = replay(dump).teams["usv"].state[0, 0]
        assert torch.equal(again.isnan(), after[1].isnan())

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

    def test_the_command_says_what_is_wrong(self, tmp_path):
        done = subprocess.run(
            [sys.executable, ROOT / "tools" / "replay.py", tmp_path / "missing.dump"], capture_output=True, text=True
        )
        assert done.returncode == 2
        assert "missing.dump" in done.stderr


class TestSurroundings:
    def test_current_and_wind_reach_the_vehicles(self):
        config = load_scenario(
            "paper", (*SMALL, "sea.hs=0", "sea.tp=4", "sea.current.speed=1", "air.speed=5", "air.direction_deg=90")
        )
        world = World(config, 2)
        assert world.around.current.tolist() == [[1.0, 0.0]] * 2
        assert torch.allclose(world.around.wind, torch.tensor([0.0, -5.0, 0.0]), atol=1e-5)

    def test_they_vary_from_step_to_step_and_from_environment_to_environment(self):
        config = load_scenario("paper", (*SMALL, "sea.current.std=0.2", "air.std=1"))
        world = World(config, 2, teams=("usv",))
        first = world.around.current.clone(), world.around.wind.clone()
        world.step(still(world))
        for before, now in zip(first, (world.around.current, world.around.wind), strict=True):
            assert not torch.equal(before, now)
            assert not torch.equal(now[0], now[1])

    def test_an_episode_begins_with_a_current_of_its_own(self):
        world = World(load_scenario("paper", (*SMALL, "sea.current.std=0.2")), 2, teams=("usv",))
        before = world.around.current.clone()
        world.renew(torch.tensor([1]))
        assert torch.equal(world.around.current[0], before[0])
        assert not torch.equal(world.around.current[1], before[1])

    def test_a_sea_that_follows_the_wind_is_its_developed_sea_and_travels_with_it(self):
        wind = ("air.speed=10", "air.direction_deg=90")
        follows = World(load_scenario("paper", (*SMALL, *wind, "sea.follows_wind=true")), 1, teams=("usv",)).sea
        given = World(load_scenario("paper", (*SMALL, "sea.wind_speed=10", "sea.direction_deg=270")), 1, teams=("usv",))
        assert torch.allclose(follows.table, given.sea.table, atol=1e-4)
        calm = World(load_scenario("paper", (*SMALL, "sea.follows_wind=true")), 1, teams=("usv",)).sea
        assert float(calm.components.hs.max()) == 0.0
