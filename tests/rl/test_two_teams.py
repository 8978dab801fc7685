"""A mission of somebody else's in which one team follows another (data/plugins/shadow.py)."""

import pytest
import torch
from folders import PLUGINS

from rl.mission import Mission, Team
from rl.missions import load_scenario, make_mission

FILE = PLUGINS / "shadow.toml"


def test_boats_follow_aircraft_and_both_are_measured_where_they_begin_anew():
    mission = make_mission(load_scenario(FILE), 3, seed=1, source=FILE)
    boats, aircraft = mission.teams["boats"], mission.teams["aircraft"]
    assert boats.observation_names == ("error.0", "error.1", "error.2", "velocity.0", "velocity.1", "velocity.2")
    torch.testing.assert_close(aircraft.error[..., 2], torch.zeros(3, 2), atol=1e-4, rtol=0)
    for _ in range(10):
        step = mission.step({name: torch.zeros_like(team.action) for name, team in mission.teams.items()})
    away = aircraft.fleet.position_n[..., :2] - boats.fleet.position_n[..., :2]
    torch.testing.assert_close(boats.error[..., :2], away)
    assert not step.terminated.any()
    mission.reset(torch.tensor([1]))
    away = aircraft.fleet.position_n[..., :2] - boats.fleet.position_n[..., :2]
    torch.testing.assert_close(boats.error[..., :2], away)
    assert boats.observations().shape == (3, 2, 6)


def test_a_mission_that_does_what_a_team_owns_is_told_so():
    with pytest.raises(TypeError, match=r"Old\.observe: a team owns it: write it in a class derived from Team"):
        type("Old", (Mission,), {"observe": lambda self, team: {}})
    with pytest.raises(TypeError, match=r"Old\.measure: write `move`"):
        type("Old", (Mission,), {"measure": lambda self: None})
    for name, now in (("sense", "perceive"), ("knowledge", "known"), ("command", "commanded")):
        with pytest.raises(TypeError, match=rf"Old\.{name}: .*`{now}`"):
            type("Old", (Team,), {name: None})


def test_a_team_without_a_reward_is_named():
    mission = make_mission(load_scenario(FILE), 2, seed=1, source=FILE)
    team = mission.teams["boats"]
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr(type(team).__mro__[1], "reward")
        with pytest.raises(NotImplementedError, match=r"Boats\.reward"):
            mission.step({name: torch.zeros_like(team.action) for name, team in mission.teams.items()})
