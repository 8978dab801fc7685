"""The Gymnasium environments: Gymnasium's own checkers, its SyncVectorEnv as reference, shapes, misuse."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gym_envs import IDS, MORE, REASONS, SHORT, both, gymnasium_accepts, make_vec, rollout, same, shared, short
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.utils.env_match import check_environments_match
from gymnasium.utils.passive_env_checker import data_shares_objects
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers

from rl.adapters.gymnasium import TeamEnv, TeamVectorEnv
from rl.missions import load_scenario
from taichi_sim.config.io import config_folder

# -- Gymnasium's checks --------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", [*IDS, *(pytest.param(other, marks=pytest.mark.slow) for other in MORE)])
def test_gymnasiums_checker_passes_and_warns_of_unbounded_observations_only(env_id: str) -> None:
    gymnasium_accepts(env_id)


def test_every_team_that_a_shipped_scenario_trains_has_an_id() -> None:
    ours = [spec.kwargs for spec in gymnasium.registry.values() if spec.namespace == "taichi_sim"]
    scenarios = {file.stem: load_scenario(file) for file in config_folder().glob("*.toml")}
    teams = {(name, team) for name, config in scenarios.items() for team in config.trained}
    assert {(given["scenario"], given["team"]) for given in ours} == teams


def test_an_environment_made_twice_is_the_same() -> None:
    first = gymnasium.make(IDS[1], overrides=SHORT)
    assert isinstance(first.unwrapped, TeamEnv)
    assert first.spec is not None
    check_environments_match(first, first.spec.make(), 25, seed=3, skip_render=True)


@pytest.mark.parametrize(
    ("env_id", "mode"),
    [
        (IDS[1], AutoresetMode.SAME_STEP),
        *((IDS[0], mode) for mode in AutoresetMode),
        *(pytest.param(other, AutoresetMode.SAME_STEP, marks=pytest.mark.slow) for other in MORE),
    ],
)
def test_one_environment_steps_as_in_gymnasiums_vector_environment(env_id: str, mode: AutoresetMode) -> None:
    """Over several episodes: observations, rewards, endings, final observations and infos."""
    ours = make_vec(env_id, 1, autoreset_mode=mode)
    reference = SyncVectorEnv([lambda: gymnasium.make(env_id, overrides=short(env_id))], autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is reference.metadata["autoreset_mode"] is mode
    for space in ("action_space", "observation_space", "single_action_space", "single_observation_space"):
        assert getattr(ours, space) == getattr(reference, space)
    assert data_equivalence(ours.reset(seed=9), reference.reset(seed=9), exact=True)
    ours.action_space.seed(9)
    for _ in range(24):
        action = ours.action_space.sample()
        *step, infos = ours.step(action)
        *expected, expected_infos = reference.step(action)
        assert data_equivalence(step, expected, exact=True)
        for key, value in expected_infos.items():
            assert data_equivalence(infos[key], value, exact=True), key
        assert ("final_obs" in infos) == ("final_obs" in expected_infos)
        if mode is AutoresetMode.DISABLED and (ended := step[2] | step[3]).any():
            options = {"reset_mask": ended}
            assert data_equivalence(ours.reset(options=options), reference.reset(options=options), exact=True)


def test_gymnasiums_vector_wrappers_work() -> None:
    env = wrappers.DictInfoToList(wrappers.RecordEpisodeStatistics(make_vec(IDS[0])))
    env.reset(seed=1)
    for _ in range(10):
        *_, truncated, infos = env.step(np.zeros(env.action_space.shape, np.float32))
    assert truncated.all()
    assert [info["episode"]["l"] for info in infos] == [10, 10, 10]
    assert all(info["final_obs"].shape == env.single_observation_space.shape for info in infos)
    assert all(info["final_info"]["distance"].shape == (3,) for info in infos)


@pytest.mark.slow  # a process of its own
def test_a_module_in_the_id_is_all_that_needs_importing() -> None:
    """And no TimeLimit is wrapped around: the environment truncates itself."""
    code = (
        "import gymnasium; id = 'rl:taichi_sim/UsvFormation-v0';"
        "v = gymnasium.make_vec(id, num_envs=2, overrides=['track.worlds=2', 'sea.realisations=2']);"
        "print(v.reset(seed=1)[0].shape, v.spec.id, gymnasium.spec(id.partition(':')[2]).max_episode_steps)"
    )
    command = [sys.executable, "-W", "error::UserWarning", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "taichi_sim/UsvFormation-v0 None" in done.stdout


# -- shapes --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("env_id", "team"), zip(IDS, ("usv", "uav"), strict=True))
@pytest.mark.parametrize("count", [1, 2, 8])
def test_vehicles_are_stacked(env_id: str, team: str, count: int) -> None:
    env = make_vec(env_id, 4, (*SHORT, f"{team}.count={count}"))
    vehicle = env.unwrapped.task.teams[team]
    actions = len(vehicle.action_names)
    observed, infos = env.reset(seed=1)
    assert observed.dtype == np.float32
    assert observed in env.observation_space
    assert env.single_action_space == gymnasium.spaces.Box(-1, 1, (count * actions,), np.float32)
    np.testing.assert_array_equal(observed.reshape(4, count, -1), vehicle.observations().numpy())
    observed, reward, terminated, truncated, infos = env.step(env.action_space.sample())
    assert observed in env.observation_space
    assert reward.shape == terminated.shape == truncated.shape == (4,)
    assert terminated.dtype == truncated.dtype == np.bool_
    for key in ("reward_vehicle", "distance", *REASONS):
        assert infos[key].shape == (4, count)
        assert infos[f"_{key}"].all()
    np.testing.assert_allclose(reward, infos["reward_vehicle"].mean(axis=1), rtol=1e-5, atol=1e-6)


# -- misuse --------------------------------------------------------------------------------------------------


@both
def test_bad_actions_are_refused_and_move_nothing(env_id: str) -> None:
    env = shared(env_id).unwrapped
    env.reset(seed=1)
    before = env.task.teams[env.team].fleet.state.clone()
    action = env.action_space.sample()
    for value in (np.nan, np.inf, -np.inf):
        action[2, -1] = value
        with pytest.raises(ValueError, match="_2 in environment 2 .*must be finite"):
            env.step(action)
    for shape in ((3, 1), (2, *env.single_action_space.shape), env.single_action_space.shape):
        with pytest.raises(ValueError, match=r"actions have shape .*, expected \(3, "):
            env.step(np.zeros(shape, np.float32))
    assert torch.equal(env.task.teams[env.team].fleet.state, before)
    single = gymnasium.make(env_id, overrides=SHORT).unwrapped
    single.reset(seed=1)
    with pytest.raises(ValueError, match="the action has shape"):
        single.step(np.zeros(1, np.float32))
    with pytest.raises(ValueError, match="must be finite"):
        single.step(np.full(single.action_space.shape, np.nan, np.float32))


def test_actions_are_clipped() -> None:
    env = shared(IDS[0])
    env.reset(seed=1)
    inside = env.step(np.ones(env.action_space.shape, np.float32))[0]
    env.reset(seed=1)
    np.testing.assert_array_equal(env.step(np.full(env.action_space.shape, 7.0))[0], inside)


@both
def test_nothing_returned_is_shared_with_a_later_step(env_id: str) -> None:
    env = shared(env_id)
    observed, infos = env.reset(seed=1)
    action = env.action_space.sample()
    kept = [(observed, infos)]
    for _ in range(11):
        observed, *_, infos = env.step(action)
        for other in kept:
            assert not data_shares_objects(other, (observed, infos))
        kept.append((observed, infos))
    before = rollout(env, 3, 3)
    env.reset(seed=3)[0][:] = 1e9
    observed, *_, infos = env.step(action)
    infos["distance"][:] = 1e9
    assert same(rollout(env, 3, 3), before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mask": 1}, "unknown"),
        ({"reset_mask": [True] * 3}, "bool array"),
        ({"reset_mask": np.ones(2, bool)}, r"shape \(3,\)"),
        ({"reset_mask": np.zeros(3, bool)}, "true somewhere"),
    ],
)
def test_wrong_reset_options_are_refused(options: dict, message: str) -> None:
    env = shared(IDS[0])
    with pytest.raises(ValueError, match=message):
        env.reset(options=options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"team": "submarine"}, "allowed are"),
        ({"team": "usv", "num_envs": 0}, "at least 1"),
        ({"team": "usv", "max_episode_steps": 50}, "'episode_duration=5'"),
    ],
)
def test_wrong_arguments_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TeamVectorEnv(**options)


def test_closing_twice_is_allowed() -> None:
    env = make_vec(IDS[0])
    env.close()
    env.close()
    assert env.closed
