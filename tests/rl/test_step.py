"""One decision of a mission: its phases in order, environments that begin anew in it, policies beside actions."""

import math

import pytest
import torch
from folders import PLUGINS
from torch import Tensor

from rl.learn.policy import ClassicalPolicy
from rl.mission import Mission, VehicleActions
from rl.missions import load_scenario, make_mission
from rl.step import BEGINS, GOES_ON, NOT_DUE
from taichi_sim.config.arguments import ActionError

FILE = PLUGINS / "shadow.toml"
PHASES = ("move", "truth", "begin", "perceive", "exchange", "conclude")
SHORT = ("episode_duration=1.0",)


def shadow(*overrides: str, envs: int = 3) -> Mission:
    return make_mission(load_scenario(FILE, overrides), envs, seed=1, source=FILE)


def still(mission: Mission) -> dict[str, Tensor]:
    return {name: torch.zeros_like(team.action) for name, team in mission.teams.items()}


def end(mission: Mission, env: int) -> None:
    """Let the time of an environment be up after the next decision."""
    mission.steps[env] = mission.config.episode_steps - 1


@pytest.fixture
def told(monkeypatch) -> tuple[Mission, list[tuple[str, list[int]]]]:
    """A mission, and the phases that run in it, each with `Due.which` or the environments that begin."""
    mission, phases = shadow(), []
    for name in PHASES:
        real = getattr(mission, name)

        def run(arg, name=name, real=real, **where):
            phases.append((name, (arg if name == "begin" else arg.which).tolist()))
            return real(arg, **where)

        monkeypatch.setattr(mission, name, run)
    return mission, phases


def test_the_phases_come_in_order_and_ended_environments_begin_anew_in_them(told):
    mission, phases = told
    end(mission, 1)
    judged = []
    step = mission.step(still(mission), judged=lambda step: judged.append((len(phases), step.over.tolist())))
    all_go, mixed = [GOES_ON] * 3, [GOES_ON, BEGINS, GOES_ON]
    assert phases == [
        ("move", all_go), ("truth", all_go),
        ("begin", [1]), ("truth", [NOT_DUE, BEGINS, NOT_DUE]),
        ("perceive", mixed), ("exchange", mixed), ("conclude", mixed),
    ]  # fmt: skip
    assert judged == [(2, [False, True, False])] and step.truncated.tolist() == [False, True, False]
    assert mission.steps.tolist() == [1, 0, 1]
    for name, team in mission.teams.items():
        assert step.observations[name].equal(team.observations())
    assert step.last is None


def test_the_last_observations_are_those_of_an_episode_that_goes_on(told):
    """They cost a second look, of all environments; the others then look no more."""
    mission, phases = told
    twin = shadow()
    for of in (mission, twin):
        end(of, 2)
    phases.clear()
    step = mission.step(still(mission), last=True)
    assert [which for name, which in phases if name == "perceive"] == [[GOES_ON] * 3, [NOT_DUE, NOT_DUE, BEGINS]]
    on = twin.step(still(twin), begin=False)
    assert twin.steps.tolist()[2] == mission.config.episode_steps and on.last is None
    for name in mission.teams:
        assert step.last is not None and step.last[name].equal(on.observations[name])
        assert step.observations[name][:2].equal(on.observations[name][:2])
        assert not step.observations[name][2].equal(on.observations[name][2])
    assert mission.step(still(mission), last=True).last is None  # none has ended


def test_only_the_teams_that_are_asked_for_are_observed(monkeypatch):
    mission = shadow()
    monkeypatch.setattr(mission.teams["boats"], "observe", lambda: pytest.fail("is observed"))
    assert [*mission.step(still(mission), observe=["aircraft"]).observations] == ["aircraft"]


def test_a_policy_acts_when_all_actions_have_been_checked():
    mission, asked = shadow(), []

    def policy(team) -> VehicleActions:
        asked.append(team.name)
        return VehicleActions(torch.full_like(team.action, 2.0))

    with pytest.raises(ActionError, match=r"of boats_1 in environment 2 is nan"):
        wrong = still(mission)["boats"]
        wrong[2, 1, 0] = math.nan
        mission.step({"boats": wrong, "aircraft": policy})
    assert not asked and not mission.steps.any()
    mission.step({"boats": still(mission)["boats"], "aircraft": policy})
    assert asked == ["aircraft"] and bool((mission.teams["aircraft"].action == 1.0).all())


def test_to_drive_is_to_step_by_actions_of_the_vehicles():
    """Where a policy corrects a classical controller, its actions are others."""
    config = load_scenario("otter", ("track.worlds=2", "sea.realisations=2"))
    mission, ahead = make_mission(config, 2, seed=1, teams=["usv"]), {"usv": torch.ones(2, 3, 2)}
    saved, states = mission.snapshot(), []
    for step in (mission.step, mission.drive, lambda given: mission.drive(mission.act(given))):
        mission.restore(saved)
        assert not step(ahead).over.any()
        states.append(mission.teams["usv"].fleet.state.clone())
    assert states[0].equal(states[2]) and not states[0].equal(states[1])


def test_a_term_that_is_not_finite_in_a_rare_state_ends_one_episode_and_a_faulty_one_is_named(monkeypatch):
    mission = shadow()
    team = mission.teams["boats"]
    for _ in range(3):
        mission.step(still(mission))
    reward, bad = team.reward, torch.tensor([[False], [True], [False]])
    monkeypatch.setattr(team, "reward", lambda ended: torch.where(bad, math.nan, reward(ended)))
    with pytest.warns(RuntimeWarning, match="the reward of 'boats' is not finite in environment 1"):
        step = mission.step(still(mission))
    assert step.terminated.tolist() == [False, True, False] and not step.reward["boats"][1].any()
    with pytest.raises(FloatingPointError, match=r"reward of 'boats' .* in environments \[1\] as an episode begins"):
        mission.step(still(mission))


def test_a_classical_policy_is_taken_as_it_is():
    mission = make_mission(load_scenario("otter", ("track.worlds=2", "sea.realisations=2")), 2, seed=1, teams=["usv"])
    wanted = ClassicalPolicy()(mission.teams["usv"]).values
    mission.step({"usv": ClassicalPolicy()})
    assert mission.teams["usv"].action.equal(torch.as_tensor(wanted).clamp(-1.0, 1.0))
