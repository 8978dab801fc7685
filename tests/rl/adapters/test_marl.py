"""A mission as torch tensors by team and as PettingZoo's agents: against Gymnasium's view, endings, misuse."""

from __future__ import annotations

import functools
import importlib
import sys

import numpy as np
import pytest
import torch
from gym_envs import SHORT, SMALL
from gymnasium.error import ResetNeeded
from parallel_checks import pettingzoo_accepts

from rl.adapters.batched import BatchedEnv
from rl.adapters.gymnasium import TeamVectorEnv
from rl.adapters.pettingzoo import parallel_env
from taichi_sim.config import ConfigError
from taichi_sim.errors import MissingExtraError

LONG = (*SMALL, "episode_duration=100", "usv.lost_distance=10000")  # m: no slot is that far


@functools.cache
def batched(overrides: tuple[str, ...] = SHORT, autoreset: bool = True) -> BatchedEnv:
    """Three environments that several tests use, each after a seeded reset."""
    return BatchedEnv("paper", 3, overrides=overrides, autoreset=autoreset)


def still(env: BatchedEnv) -> dict[str, np.ndarray]:
    return {team: np.zeros((env.num_envs, n, len(env.action_names[team]))) for team, n in env.vehicles.items()}


def hit(env: BatchedEnv, row: int) -> None:
    """Put the leader of the boats of one environment on its first obstacle."""
    centre = env.mission.obstacles[env.mission.env_world[row], 0, :2]
    env.mission.teams["usv"].fleet.state[row, 0, :2] = centre


def test_pettingzoos_own_tests_pass():
    pettingzoo_accepts("paper", SHORT)


def test_a_team_alone_does_to_the_bit_what_it_does_under_gymnasium():
    """Over several episodes, of 10 decisions each."""
    ours, reference = BatchedEnv("paper", 3, teams="usv", overrides=SHORT), TeamVectorEnv("usv", 3, overrides=SHORT)
    observed, expected = ours.reset(seed=7)["usv"], reference.reset(seed=7)[0]
    generator = np.random.default_rng(1)
    for _ in range(24):
        np.testing.assert_array_equal(observed.flatten(1), expected)
        actions = generator.uniform(-1, 1, (3, *observed.shape[1:2], len(ours.action_names["usv"]))).astype(np.float32)
        stepped = ours.step({"usv": actions})
        expected, reward, terminated, truncated, infos = reference.step(actions.reshape(3, -1))
        observed = stepped.observations["usv"]
        np.testing.assert_allclose(stepped.rewards["usv"].mean(1), reward, rtol=1e-6)
        np.testing.assert_array_equal(stepped.terminated["usv"].any(1), terminated)
        over = (stepped.terminated["usv"] | stepped.truncated["usv"]).all(1)
        np.testing.assert_array_equal(over, terminated | truncated)
        np.testing.assert_array_equal(stepped.infos["usv"]["collided"], infos["collided"])


def test_agents_are_the_vehicles_in_order():
    env = parallel_env("paper", overrides=SHORT)
    env.reset(seed=1)
    actions = {agent: np.full(env.action_space(agent).shape, 0.1 * k) for k, agent in enumerate(env.agents)}
    observations, rewards, *_, infos = env.step(actions)
    assert list(observations) == list(rewards) == ["usv_0", "usv_1", "usv_2", "uav_0", "uav_1", "uav_2"]
    usv, uav = env.task.teams["usv"], env.task.teams["uav"]
    taken = torch.cat((usv.action[0, :, 0], uav.action[0, :, 0]))
    assert taken.tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    for k in range(3):
        np.testing.assert_array_equal(observations[f"uav_{k}"], uav.observations()[0, k])
        assert infos[f"usv_{k}"]["distance"] == pytest.approx(usv.distance[0, k].item())


def test_the_state_is_what_all_observe():
    env = batched()
    env.reset(seed=2)
    told = torch.cat([observed.flatten(1) for observed in env.observations.values()], dim=1)
    assert torch.equal(env.state(), told)  # all is known, nothing varies: there is no other truth


def test_what_is_handed_out_may_be_written_to():
    """A normaliser in place, of a reset's or a step's observations, changes no state."""
    env = batched()
    for observations in (env.reset(seed=2), env.step(still(env)).observations, env.observations):
        told = env.state()
        for each in observations.values():
            each.sub_(1.0).div_(2.0)
        assert torch.equal(env.state(), told)
        env.state().zero_()
        assert torch.equal(env.state(), told)


def test_environments_begin_by_a_mask_or_by_numbers_and_by_nothing_that_could_be_either():
    env = batched()
    env.reset(seed=1)
    for _ in range(3):
        env.step(still(env))
    for wrong in (torch.tensor([0, 1, 1]), torch.tensor([0.0, 1.0, 1.0]), np.array([0, 1, 0], np.uint8), [1.7], [3]):
        with pytest.raises(ValueError, match="envs"):
            env.reset(seed=5, envs=wrong)
    for seed in (1.5, True, "1", -1):
        with pytest.raises(ValueError, match="seed = "):
            env.reset(seed, envs=[0])
    assert env.mission.steps.tolist() == [3, 3, 3]
    env.reset(envs=np.array([False, True, False]))
    env.reset(seed=np.int64(7), envs=[2])
    assert env.mission.steps.tolist() == [3, 0, 0]


def test_a_vehicle_that_ends_ends_the_episode_for_all_of_its_environment_only():
    env = batched(LONG)
    env.reset(seed=1)
    env.step(still(env))
    hit(env, 1)
    stepped = env.step(still(env))
    ended = torch.zeros(3, 3, dtype=torch.bool)
    ended[1, 0] = True
    assert torch.equal(stepped.terminated["usv"], ended)
    assert torch.equal(stepped.infos["usv"]["collided"], ended)
    assert stepped.truncated["usv"].tolist() == [[False] * 3, [False, True, True], [False] * 3]
    assert not stepped.terminated["uav"].any()
    assert stepped.truncated["uav"].all(1).tolist() == [False, True, False]
    assert env.mission.steps.tolist() == [2, 0, 2]  # it has begun anew


def test_without_autoreset_an_episode_that_is_over_is_to_be_begun_anew():
    env, other = batched(LONG, False), batched(LONG)
    env.reset(seed=1)
    other.reset(seed=1)
    for each in (env, other):
        hit(each, 1)
    last, anew = env.step(still(env)), other.step(still(other))
    going, over = [0, 2], [1]
    assert torch.equal(last.observations["usv"][going], anew.observations["usv"][going])
    assert not torch.equal(last.observations["usv"][over], anew.observations["usv"][over])
    with pytest.raises(ResetNeeded, match=r"environments \[1\] are over"):
        env.step(still(env))
    begun = env.reset(envs=last.truncated["uav"].all(1))
    assert all(torch.equal(begun[team], anew.observations[team]) for team in begun)
    env.step(still(env))


def test_an_episode_of_agents_ends_for_all_and_must_be_begun():
    env = parallel_env("paper", teams=["uav"], overrides=SHORT)
    with pytest.raises(ResetNeeded):
        env.step({})
    env.reset(seed=1)
    actions = {agent: np.zeros(env.action_space(agent).shape) for agent in env.agents}
    for _ in range(10):
        assert env.agents == ["uav_0", "uav_1", "uav_2"]
        _, _, terminated, truncated, _ = env.step(actions)
    assert env.agents == []
    assert all(truncated.values())
    assert not any(terminated.values())
    with pytest.raises(ResetNeeded):
        env.step(actions)


def test_others_stand_by_follow_the_controller_or_are_not_there():
    there = BatchedEnv("paper", 2, others={"uav": "classical"}, overrides=SHORT)
    assert list(there.vehicles) == list(there.observations) == ["usv"]
    there.step({"usv": torch.zeros(2, 3, 2)})
    assert there.mission.teams["uav"].action.any()
    constant = BatchedEnv("paper", 2, teams=("usv",), others={"uav": "constant"}, overrides=SHORT)
    constant.step({"usv": torch.zeros(2, 3, 2)})
    assert not constant.mission.teams["uav"].action.any()
    assert list(BatchedEnv("paper", 2, teams="usv", overrides=SHORT).mission.teams) == ["usv"]


# -- misuse --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("uav"), r"actions are for \['usv'\], expected .*\['usv', 'uav'\]"),
        (lambda a: a.update(fish=np.zeros(3)), "actions are for .*'fish'"),
        (lambda a: a.update(usv=np.zeros((3, 2))), r"actions of usv have shape \(3, 2\), expected \(3, 3, 2\)"),
        (lambda a: a["uav"].__setitem__((1, 2, 0), np.nan), "of uav_2 in environment 1 is nan: actions must be finite"),
        (lambda a: a["usv"].__setitem__((2, 0, 1), -np.inf), "of usv_0 in environment 2 is -inf"),
    ],
)
def test_wrong_actions_are_refused_and_move_nothing(change, message):
    env = batched()
    env.reset(seed=1)
    before = [team.fleet.state.clone() for team in env.mission.teams.values()]
    actions = still(env)
    change(actions)
    with pytest.raises(ValueError, match=message):
        env.step(actions)
    for team, state in zip(env.mission.teams.values(), before, strict=True):
        assert torch.equal(team.fleet.state, state)


def test_wrong_actions_of_agents_are_refused_and_move_nothing():
    env = parallel_env("paper", teams="usv", overrides=SHORT)
    env.reset(seed=1)
    before = env.task.teams["usv"].fleet.state.clone()
    right = {agent: np.zeros(2) for agent in env.agents}
    for wrong, message in (
        ({"usv_1": np.zeros(2)}, r"\['usv_0', 'usv_2'\] are missing"),
        (right | {"usv_3": np.zeros(2)}, r"no agent \['usv_3'\]"),
        (right | {"usv_1": np.zeros(3)}, r"the action of usv_1 has shape .*3.*, expected .*2"),
        (right | {"usv_2": [0.0, np.nan]}, "of usv_2 .*must be finite"),
        (right | {"usv_2": None}, "actions of usv_2 cannot be read"),
        ([np.zeros(2)] * 3, "actions are a list, expected is a dictionary by agent"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(wrong)
    assert torch.equal(env.task.teams["usv"].fleet.state, before)
    assert env.agents == env.possible_agents
    env.step({"usv_0": [1, 0], "usv_1": torch.zeros(2, requires_grad=True), "usv_2": np.array([1e300, 0.0])})
    assert env.task.teams["usv"].action.abs().max() <= 1.0


def test_a_picture_of_all_teams_is_drawn_a_decision_and_changes_nothing():
    seen = parallel_env("paper", overrides=SHORT, render_mode="rgb_array", render_size=(160, 120))
    blind = parallel_env("paper", overrides=SHORT)
    assert seen.metadata["render_fps"] == 10 and "rgb_array" in seen.metadata["render_modes"]
    assert seen.reset(seed=1)[0].keys() == blind.reset(seed=1)[0].keys()
    before = seen.render()
    assert before.shape == (120, 160, 3) and before.dtype == np.uint8
    actions = {agent: blind.action_space(agent).sample() for agent in blind.agents}
    observed, expected = seen.step(actions)[0], blind.step(actions)[0]
    assert not np.array_equal(before, seen.render())
    assert blind.render() is None
    for agent, values in expected.items():
        np.testing.assert_array_equal(observed[agent], values)
    seen.close()


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"scenario": "escrot"}, ConfigError, "escrot: no such configuration file; shipped scenarios: .*escort"),
        ({"teams": "usvs"}, ValueError, "no team 'usvs', did you mean 'usv'"),
        ({"teams": []}, ValueError, "none acts; allowed are usv, uav"),
        ({"others": {"fish": "classical"}}, ValueError, "others: there is no team 'fish'"),
        ({"others": ["classical"]}, ValueError, "a dictionary is expected"),
        ({"teams": ["usv", "uav"], "others": {"uav": "classical"}}, ValueError, "uav is also named in teams"),
        ({"others": {"uav": "clasical"}}, ValueError, r"others\['uav'\] = 'clasical': no such choice"),
        ({"scenario": "escort", "overrides": (), "teams": ["vessel"]}, ValueError, "a script acts for 'vessel'"),
        ({"render_mode": "depth"}, ValueError, "'depth'.*'rgb_array', 'human'"),
    ],
)
def test_wrong_arguments_are_refused(options, error, message):
    with pytest.raises(error, match=message):
        parallel_env(**{"scenario": "paper", "overrides": SHORT, **options})


def test_without_pettingzoo_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pettingzoo.utils.env", None)
    monkeypatch.delitem(sys.modules, "rl.adapters.pettingzoo", raising=False)
    with pytest.raises(MissingExtraError, match=r'pip install "taichi-sim\[marl\]"'):
        importlib.import_module("rl.adapters.pettingzoo")
