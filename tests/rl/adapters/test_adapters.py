"""Stable-Baselines3's and skrl's views: against Gymnasium's and the batched one."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gym_envs import IDS, SHORT, make_vec

from rl.adapters.batched import BatchedEnv
from rl.adapters.pettingzoo import parallel_env


@pytest.fixture
def vec_env():
    """Three environments of boats, as Stable-Baselines3 sees them."""
    pytest.importorskip("stable_baselines3")
    from rl.adapters.sb3 import TeamVecEnv

    return TeamVecEnv(make_vec(IDS[0]))


def test_stable_baselines_sees_what_gymnasium_does(vec_env):
    """Over two episodes of 10 decisions."""
    reference = make_vec(IDS[0])
    vec_env.seed(4)
    np.testing.assert_array_equal(vec_env.reset(), reference.reset(seed=4)[0])
    returns = np.zeros(3)
    for k in range(20):
        actions = reference.action_space.sample()
        observed, reward, done, told = vec_env.step(actions)
        expected, expected_reward, terminated, truncated, infos = reference.step(actions)
        np.testing.assert_array_equal(observed, expected)
        np.testing.assert_allclose(reward, expected_reward, rtol=1e-6)
        np.testing.assert_array_equal(done, terminated | truncated)
        returns += expected_reward
        np.testing.assert_array_equal([info["distance"] for info in told], infos["distance"])
        if k % 10 == 9:
            assert done.all()
            for env, info in enumerate(told):
                np.testing.assert_array_equal(info["terminal_observation"], infos["final_obs"][env])
                assert info["TimeLimit.truncated"]
                assert info["episode"] == {"r": pytest.approx(returns[env]), "l": 10}
            returns[:] = 0.0
        else:
            assert not any("terminal_observation" in info for info in told)


def test_stable_baselines_is_told_what_it_cannot_take(vec_env):
    kind = type(vec_env)
    with pytest.raises(ValueError, match="not a vector environment of taichi_sim"):
        kind(gymnasium.make(IDS[0], overrides=SHORT))
    with pytest.raises(ValueError, match="only 'SameStep'"):
        kind(make_vec(IDS[0], autoreset_mode="NextStep"))
    with pytest.raises(ValueError, match="TransformReward of Gymnasium"):
        kind(gymnasium.wrappers.vector.TransformReward(make_vec(IDS[0]), lambda reward: 0.0 * reward))
    for options in ({"nonsense": 1}, {"reset_mask": np.array([True, False, False])}):  # it would reset one of three
        vec_env.set_options(options)
        with pytest.raises(ValueError, match=f"{next(iter(options))}.*there are none"):
            vec_env.reset()
    vec_env.reset()
    before = vec_env.envs.task.teams["usv"].fleet.state.clone()
    with pytest.raises(ValueError, match="must be finite"):
        vec_env.step(np.full(vec_env.envs.action_space.shape, np.nan))
    assert torch.equal(vec_env.envs.task.teams["usv"].fleet.state, before)


def test_skrl_sees_each_vehicle():
    pytest.importorskip("skrl")
    from rl.adapters.skrl import SkrlEnv

    ours, batched = (BatchedEnv("paper", 3, overrides=SHORT) for _ in range(2))
    env = SkrlEnv(ours)
    assert env.num_envs == 3
    assert env.possible_agents == ["usv_0", "usv_1", "usv_2", "uav_0", "uav_1", "uav_2"]
    observations, _ = env.reset(seed=3)
    expected = batched.reset(seed=3)
    for _ in range(10):
        for name, observed in observations.items():
            assert torch.equal(observed, expected[name[:3]][:, int(name[-1])])
            assert observed.shape == (3, *env.observation_space(name).shape)
        assert all(torch.equal(state, batched.state()) for state in env.state().values())
        actions = {name: torch.rand(3, *env.action_space(name).shape) for name in env.possible_agents}
        observations, rewards, terminated, truncated, infos = env.step(actions)
        by_team = {t: torch.stack([actions[f"{t}_{k}"] for k in range(3)], dim=1) for t in ("usv", "uav")}
        expected, *stepped = batched.step(by_team)
        for found, right in zip((rewards, terminated, truncated), stepped, strict=False):
            assert all(torch.equal(value[:, 0], right[name[:3]][:, int(name[-1])]) for name, value in found.items())
        assert torch.equal(infos["uav_1"]["distance"], stepped[3]["uav"]["distance"][:, 1])
    assert all(value.all() for value in truncated.values())
    with pytest.raises(ValueError, match="autoreset"):
        SkrlEnv(BatchedEnv("paper", 3, overrides=SHORT, autoreset=False))


def test_skrl_takes_the_environment_of_pettingzoo():
    wrappers = pytest.importorskip("skrl.envs.wrappers.torch")
    env = wrappers.wrap_env(parallel_env("paper", overrides=SHORT))
    observations, _ = env.reset()
    actions = {name: torch.zeros(1, *env.action_space(name).shape) for name in env.possible_agents}
    observations, rewards, *_ = env.step(actions)
    assert observations["uav_2"].shape == (1, *env.observation_space("uav_2").shape)
    assert env.state()["usv_0"].shape == (1, *env.state_space("usv_0").shape)
    assert rewards["usv_0"].shape == (1, 1)
