"""What objects say of themselves (`repr`), by what they were made of."""

import numpy as np
import pytest
import torch

from rl.missions import load_scenario, make_mission
from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, CurrentConfig, SeaConfig
from taichi_sim.config.base import number, span
from taichi_sim.world import World

SMALL = ("sea.realisations=2", "sea.components=4", "usv.count=1", "uav.count=1")


def says(it, *parts, lines=2):
    text = repr(it)
    assert len(text.splitlines()) <= lines and max(map(len, text.splitlines())) < 160, text
    assert [part for part in parts if part not in text] == [], text


def test_ranges_are_told_once_where_they_are_one():
    assert span(torch.tensor([[0.25, 1.0], [0.5, 0.75]]), "m") == "0.25 to 1 m"
    assert span(np.full(3, 2.0), "s") == "2 s" and span([], "s") == "none"
    assert number(1, "environment") == "1 environment" and number(2, "environment") == "2 environments"


def test_a_bench_its_sea_and_its_fleet_say_what_they_are():
    sea = SeaConfig(hs=1.5, tp=6.0, depth=20.0, realisations=3, components=8, current=CurrentConfig(speed=0.4))
    bench = Bench("unity_boat", sea=sea, air=AirConfig(speed=5.0), envs=4, count=2, dt=0.02, substeps=5)
    bench.time += 2.5
    says(bench, "2 x UnityBoat in 4 environments", "t = 2.5 s", "current 0.4 m/s", "wind 5 m/s", "hs 1.5 m")
    says(bench.sea, "hs 1.5 m, sea state 4", "20 m deep", "3 realisations of 8 components", lines=1)
    says(Bench("unity_boat").sea, "calm", "deep water", "1 realisation of 1 component", lines=1)
    says(bench.fleet, "'fleet'", "2 x UnityBoat", *bench.model.action_names, lines=1)


def test_a_world_and_a_mission_say_what_they_are():
    world = World.from_scenario("paper", 3, overrides=SMALL, teams=("usv",))
    says(world, "'paper'", "3 environments", "t = 0 s", "usv (1 x UnityBoat)", "2 realisations of 4 components", "hs ")
    mission = make_mission(load_scenario("paper", SMALL), 3, seed=1, teams=["usv"])
    says(mission, "'paper'", "3 environments, 0 decisions of ", "usv (1 x UnityBoat)", repr(mission.world.sea))
    team = mission.teams["usv"]
    step = mission.step({"usv": torch.zeros(3, 1, len(team.fleet.model.action_names))})
    says(mission, "1 decisions of ")
    says(step, "usv is paid", "none ended", "0 terminated, 0 truncated of 3 environments")
    ended = step.endings["usv"]
    assert "collided" in ended
    ended["collided"][1] = True
    says(step._replace(terminated=torch.tensor([False, True, False])), "1 collided", "1 terminated")
    assert float(step.reward["usv"].mean()) == pytest.approx(float(repr(step).split("paid ")[1].split()[0]), rel=0.01)
