"""A state that is not finite ends its episode for all in its environment, pays finite rewards, and leaves nothing."""

import math
import warnings

import pytest
import torch
from folders import PLUGINS
from small_missions import begin, make, observed, state, still

from rl.missions import load_scenario, make_mission
from rl.missions.formation.mission import Formation
from taichi_sim.state.divergence import NotFiniteError
from taichi_sim.state.snapshot import walk

PLUGIN = PLUGINS / "buoys.toml"


def not_finite(task) -> list[str]:
    """Paths of what is remembered and not finite."""
    entries = [entry for entry in walk(task).entries if isinstance(entry.value, torch.Tensor)]
    return [entry.path for entry in entries if not bool(entry.value.isfinite().all())]


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e30])
@pytest.mark.parametrize("column", [0, 4, 8, 12])
def test_one_boat_that_diverges_ends_the_episode_of_all_in_its_environment_and_of_nobody_else(shared, value, column):
    right = begin(shared).step(still(shared))
    begin(shared)
    state(shared, "usv")[1, 2, column] = value
    with pytest.warns(RuntimeWarning, match="'usv'") if not shared.divergence._told else warnings.catch_warnings():
        step = shared.step(still(shared))
    for name in ("usv", "uav"):
        assert step.endings[name]["diverged"].equal(torch.tensor([False, True, False, False])[:, None].expand(4, 3))
        assert step.endings[name].any[1].all() and step.reward[name].isfinite().all()
        others = [0, 2, 3]
        assert step.reward[name][others].equal(right.reward[name][others])
    assert step.reward["usv"][1].tolist() == [0.0, 0.0, -1.0] and step.reward["uav"][1].tolist() == [0.0, 0.0, 0.0]
    assert step.terminated.tolist() == [False, True, False, False]
    assert all(seen.isfinite().all() for seen in observed(shared).values()) and not not_finite(shared)


def test_a_boat_that_diverges_beside_an_obstacle_leaves_nothing_in_later_episodes():
    """That nothing is in range is written once, by the place of the vehicle: a place that was no number stayed."""
    task, env = begin(make()), 0
    north, east, radius, _ = task.obstacles[task.env_world[env], 0].tolist()
    state(task, "usv")[env, 1, :2] = torch.tensor([north + radius + 15.0, east])
    task.step(still(task), begin=False)
    assert task.teams["usv"].sensor.signals[env, 1, 0] > 0.0
    state(task, "usv")[env, 1] = math.nan
    with pytest.warns(RuntimeWarning, match="'usv'"):
        assert task.step(still(task)).terminated[env]
    for _ in range(3):
        assert all(seen.isfinite().all() for seen in observed(task).values())
        task.reset(torch.tensor([env]))
        task.step(still(task))
    assert not not_finite(task)


def test_what_has_not_shown_itself_goes_with_the_episode(shared: Formation):
    begin(shared)
    hidden = shared.teams["usv"].slots.table
    hidden[2, 1, 4] = math.nan
    shared.reset(torch.tensor([2]))
    assert not not_finite(shared)


def test_a_command_computed_from_what_is_not_finite_ends_the_episode_and_a_callers_is_refused():
    task = make("usv.residual.velocity=1", teams=("usv",))
    team, silent = task.teams["usv"], torch.zeros((4, 3, 2))
    begin(task)
    team.target.table[3] = math.nan
    step = task.step({"usv": silent})
    assert step.endings["usv"]["diverged"][:, 0].tolist() == [False, False, False, True]
    silent[0, 0, 0] = math.nan
    with pytest.raises(ValueError, match="finite"):
        task.step({"usv": silent})


def buoys():
    return make_mission(load_scenario(PLUGIN), 3, seed=1, source=PLUGIN)


def test_a_scripted_vehicle_that_diverges_ends_the_episode():
    mission = buoys()
    script = next(iter(mission.world.scripts))
    mission.world.teams[script].state[1] = math.nan
    actions = {name: torch.zeros_like(team.action) for name, team in mission.teams.items()}
    step = mission.step(actions)
    assert step.terminated.tolist() == [False, True, False]
    assert all(reward.isfinite().all() for reward in step.reward.values())
    assert not mission.step(actions).terminated.any()


def test_a_mission_that_computes_what_is_not_finite_from_what_is_is_named(monkeypatch):
    mission = buoys()
    team = next(iter(mission.teams.values()))
    terms = team.observe()
    monkeypatch.setattr(team, "observe", lambda: {**terms, "heading": terms["heading"] / 0.0})
    with pytest.raises(NotFiniteError, match=f"'heading' of '{team.name}'.*Buoys"):
        team.observations()
    monkeypatch.setattr(team, "reward", lambda ended: team.fleet.position_n[..., 0] * math.nan)
    with pytest.raises(NotFiniteError, match=r"the reward of .*Buoys"):
        mission.step({name: torch.zeros_like(team.action) for name, team in mission.teams.items()})
