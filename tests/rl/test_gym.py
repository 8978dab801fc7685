"""The Gymnasium environments: Gymnasium's own checkers, its SyncVectorEnv as reference, seeds, endings."""

from __future__ import annotations

import functools
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.env_match import check_environments_match
from gymnasium.utils.passive_env_checker import data_shares_objects
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers

from rl.gym import TeamEnv, TeamVectorEnv
from rl.policy import OBS_GROUPS, CheckpointError, TrainedPolicy, actor_config
from rl.run_folder import CONFIG, RunError
from rl.task.endings import UsvEndings
from taichi_sim.config import StageConfig
from taichi_sim.config_io import load_scenario, write_toml

IDS = ("taichi_sim/UsvFormation-v0", "taichi_sim/UavFormation-v0")
SMALL = ("track.worlds=4", "sea.realisations=4", "obstacles.count=4")
SHORT = (*SMALL, "episode_duration=1.0")  # 10 decisions
REASONS = ("collided", "lost", "left")
both = pytest.mark.parametrize("env_id", IDS)


def make_vec(env_id: str, num_envs: int = 3, overrides=SHORT, **options):
    return gymnasium.make_vec(env_id, num_envs=num_envs, overrides=overrides, **options)


@functools.cache
def shared(env_id: str):
    """An environment that several tests use, each after a seeded reset: building one compiles its kernels."""
    return make_vec(env_id)


def rollout(env, seed: int | None, steps: int = 14) -> list[np.ndarray]:
    """Observations, rewards and endings of `steps` steps after a reset, under seeded random actions."""
    env.action_space.seed(5)
    history = [env.reset(seed=seed)[0]]
    for _ in range(steps):
        history += env.step(env.action_space.sample())[:4]
    return history


def same(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


# -- Gymnasium's checks --------------------------------------------------------------------------------------


@both
def test_gymnasiums_checker_passes_and_warns_of_unbounded_observations_only(env_id: str) -> None:
    env = gymnasium.make(env_id, overrides=SHORT)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped)
    assert len(caught) == 2
    for warning in caught:
        assert "A Box observation space m" in str(warning.message)
        assert "infinity" in str(warning.message)


def test_an_environment_made_twice_is_the_same() -> None:
    first = gymnasium.make(IDS[1], overrides=SHORT)
    assert isinstance(first.unwrapped, TeamEnv)
    assert first.spec is not None
    check_environments_match(first, first.spec.make(), 25, seed=3, skip_render=True)


@pytest.mark.parametrize(
    ("env_id", "mode"), [(IDS[1], AutoresetMode.SAME_STEP), *((IDS[0], mode) for mode in AutoresetMode)]
)
def test_one_environment_steps_as_in_gymnasiums_vector_environment(env_id: str, mode: AutoresetMode) -> None:
    """Over several episodes: observations, rewards, endings, final observations and infos."""
    ours = make_vec(env_id, 1, autoreset_mode=mode)
    reference = SyncVectorEnv([lambda: gymnasium.make(env_id, overrides=SHORT)], autoreset_mode=mode)
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


def test_a_module_in_the_id_is_all_that_needs_importing() -> None:
    """And no TimeLimit is wrapped around: the environment truncates itself."""
    code = (
        "import gymnasium; id = 'rl.gym:taichi_sim/UsvFormation-v0';"
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
    np.testing.assert_array_equal(observed.reshape(4, count, -1), vehicle.observe().numpy())
    observed, reward, terminated, truncated, infos = env.step(env.action_space.sample())
    assert observed in env.observation_space
    assert reward.shape == terminated.shape == truncated.shape == (4,)
    assert terminated.dtype == truncated.dtype == np.bool_
    for key in ("reward_vehicle", "distance", *REASONS):
        assert infos[key].shape == (4, count)
        assert infos[f"_{key}"].all()
    np.testing.assert_allclose(reward, infos["reward_vehicle"].mean(axis=1), rtol=1e-5, atol=1e-6)


# -- seeds ---------------------------------------------------------------------------------------------------


@both
def test_a_seed_fixes_every_bit_over_resets(env_id: str) -> None:
    env = shared(env_id)
    first = rollout(env, 1)
    assert same(first, rollout(env, 1))
    assert same(first, rollout(make_vec(env_id), 1))
    assert not same(first, rollout(env, 2))


def test_the_constructors_seed_makes_other_worlds() -> None:
    assert not same(rollout(shared(IDS[0]), 1, 1), rollout(make_vec(IDS[0], seed=99), 1, 1))


def test_without_a_seed_episodes_continue_one_sequence() -> None:
    env, again = make_vec(IDS[0]), make_vec(IDS[0])
    first, second = rollout(env, None), rollout(env, None)
    assert not same(first, second)
    assert same(first, rollout(again, None))
    assert same(second, rollout(again, None))
    env.reset(seed=7)
    after = env.reset()[0]
    again.reset(seed=7)
    np.testing.assert_array_equal(after, again.reset()[0])


# -- endings -------------------------------------------------------------------------------------------------


@both
def test_time_running_out_truncates(env_id: str) -> None:
    env = shared(env_id)
    env.reset(seed=1)
    steps = [env.step(np.zeros(env.action_space.shape, np.float32)) for _ in range(10)]
    assert not any((terminated | truncated).any() for _, _, terminated, truncated, _ in steps[:-1])
    assert all("final_obs" not in infos for *_, infos in steps[:-1])
    _, _, terminated, truncated, infos = steps[-1]
    assert truncated.all()
    assert not terminated.any()
    assert not any(infos["final_info"][reason].any() for reason in REASONS)


def test_an_obstacle_on_the_leader_terminates_its_environment_only() -> None:
    env = make_vec(IDS[0], 3, (*SMALL, "episode_duration=100"))
    env.reset(seed=1)
    place_on_an_obstacle(env, 1)
    _, reward, terminated, truncated, infos = env.step(np.zeros(env.action_space.shape, np.float32))
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert infos["collided"].tolist() == [[False] * 3, [True, False, False], [False] * 3]
    np.testing.assert_array_equal(infos["_final_info"], terminated)
    np.testing.assert_array_equal(infos["final_info"]["collided"], infos["collided"])
    assert reward[1] < reward[[0, 2]].min()


def place_on_an_obstacle(env, row: int) -> None:
    """Put the leader of one environment of the USV team on its first obstacle."""
    task = env.unwrapped.task
    centre = task.obstacles[task.env_world[row], 0, :2]
    task.teams["usv"].team.state[row, 0, :2] = centre


def test_final_observations_are_those_before_the_new_episode() -> None:
    """With the same actions as where nothing is reset; the observation returned begins the next episode."""
    env, manual = shared(IDS[0]), make_vec(IDS[0], autoreset_mode="Disabled")
    assert same([env.reset(seed=6)[0]], [manual.reset(seed=6)[0]])
    actions = np.linspace(-1, 1, env.action_space.low.size, dtype=np.float32).reshape(env.action_space.shape)
    for _ in range(10):
        observed, _, _, truncated, infos = env.step(actions)
        last, *_, last_infos = manual.step(actions)
    assert truncated.all()
    np.testing.assert_array_equal(np.stack(list(infos["final_obs"])), last)
    np.testing.assert_array_equal(infos["final_info"]["distance"], last_infos["distance"])
    first, first_infos = manual.reset()
    np.testing.assert_array_equal(observed, first)
    np.testing.assert_array_equal(infos["distance"], first_infos["distance"])


def test_environments_that_go_on_are_untouched_by_one_that_begins_anew() -> None:
    env, mask = make_vec(IDS[0], 3, SMALL), np.array([False, True, False])
    env.reset(seed=1)
    before = env.step(env.action_space.sample())[0]
    after, infos = env.reset(options={"reset_mask": mask})
    np.testing.assert_array_equal(after[~mask], before[~mask])
    assert not np.array_equal(after[mask], before[mask])
    np.testing.assert_array_equal(infos["_distance"], mask)


def test_next_step_ignores_the_action_and_gives_nothing_where_an_episode_begins() -> None:
    env = make_vec(IDS[0], autoreset_mode=AutoresetMode.NEXT_STEP, overrides=(*SMALL, "episode_duration=100"))
    env.reset(seed=1)
    place_on_an_obstacle(env, 1)
    actions = np.zeros(env.action_space.shape, np.float32)
    *_, terminated, _, infos = env.step(actions)
    assert terminated.tolist() == [False, True, False]
    assert "final_obs" not in infos
    actions[1] = np.nan
    _, reward, terminated, truncated, infos = env.step(actions)
    assert reward[1] == 0.0
    assert reward[[0, 2]].all()
    assert not (terminated | truncated).any()
    assert infos["_reward_vehicle"].tolist() == [True, False, True]
    with pytest.raises(ValueError, match="must be finite"):
        env.step(actions)


def test_an_ended_episode_must_be_reset_where_autoreset_is_disabled() -> None:
    env = gymnasium.make(IDS[1], overrides=SHORT).unwrapped
    env.reset(seed=1)
    while not any(env.step(env.action_space.sample())[2:4]):
        pass
    with pytest.raises(ResetNeeded, match="ended"):
        env.step(env.action_space.sample())
    env.reset()
    env.step(env.action_space.sample())


# -- the other team ------------------------------------------------------------------------------------------


def test_an_absent_team_is_not_simulated_and_a_constant_one_is() -> None:
    alone, together = make_vec(IDS[0]), make_vec(IDS[0], other="constant")
    assert list(alone.unwrapped.task.teams) == ["usv"]
    task = together.unwrapped.task
    assert list(task.teams) == ["usv", "uav"]
    together.reset(seed=1)
    before = task.teams["uav"].team.state.clone()
    together.step(together.action_space.sample())
    assert not torch.equal(task.teams["uav"].team.state, before)
    assert not task.teams["uav"].action.any()


def test_an_ending_of_the_other_team_truncates() -> None:
    env = make_vec(IDS[0], other="constant", overrides=(*SMALL, "episode_duration=100"))
    env.reset(seed=1)
    env.unwrapped.task.teams["uav"].team.state[1, 0, 2] = 5.0  # in the sea
    _, _, terminated, truncated, infos = env.step(env.action_space.sample())
    assert not terminated.any()
    assert truncated.tolist() == [False, True, False]
    assert not any(infos[reason].any() for reason in UsvEndings._fields)


def save_policy(folder, observations: int, actions: int) -> None:
    """A checkpoint of an untrained actor of the default stage."""
    from rsl_rl.models import MLPModel
    from tensordict import TensorDict

    options = actor_config(StageConfig(team="uav"))
    options.pop("class_name")
    example = TensorDict({"policy": torch.zeros(1, observations)}, batch_size=[1])
    torch.manual_seed(0)
    actor = MLPModel(example, OBS_GROUPS, "actor", actions, **options)
    folder.mkdir()
    torch.save({"actor_state_dict": actor.state_dict(), "iter": 1}, folder / "model_1.pt")


def test_a_frozen_policy_acts_for_the_other_team(tmp_path) -> None:
    probe = make_vec(IDS[1]).unwrapped
    observations = probe.single_observation_space.shape[0] // 3
    actions = probe.single_action_space.shape[0] // 3
    save_policy(tmp_path / "uav", observations, actions)
    env = make_vec(IDS[0], other=tmp_path / "uav" / "model_1.pt").unwrapped
    env.reset(seed=1)
    policy = TrainedPolicy.load(tmp_path / "uav" / "model_1.pt", StageConfig(team="uav"))
    expected = policy(env.task.teams["uav"])
    env.step(env.action_space.sample())
    torch.testing.assert_close(env.task.teams["uav"].action, expected)
    write_toml(load_scenario(overrides=SMALL), tmp_path / CONFIG)
    whole_run = make_vec(IDS[0], other=tmp_path).unwrapped
    whole_run.reset(seed=1)
    whole_run.step(env.action_space.sample())
    torch.testing.assert_close(whole_run.task.teams["uav"].action, expected)
    with pytest.raises(RunError, match="no trained usv policy"):
        make_vec(IDS[1], other=tmp_path)
    with pytest.raises(CheckpointError, match="observations"):
        make_vec(IDS[0], other=tmp_path / "uav" / "model_1.pt", overrides=(*SMALL, "sensing.obstacles=1"))


@both
def test_a_classical_controller_acts_for_the_other_team(env_id: str) -> None:
    env = make_vec(env_id, other="classical").unwrapped
    env.reset(seed=1)
    env.step(env.action_space.sample())
    rival = next(team for name, team in env.task.teams.items() if name != env.team)
    assert rival.action.any()


def test_a_wrong_choice_of_the_other_team_names_the_choices() -> None:
    with pytest.raises(ValueError, match="'absent', 'constant'"):
        make_vec(IDS[0], other="none")


# -- misuse --------------------------------------------------------------------------------------------------


@both
def test_bad_actions_are_refused_and_move_nothing(env_id: str) -> None:
    env = shared(env_id).unwrapped
    env.reset(seed=1)
    before = env.task.teams[env.team].team.state.clone()
    action = env.action_space.sample()
    for value in (np.nan, np.inf, -np.inf):
        action[2, -1] = value
        with pytest.raises(ValueError, match="vehicle 2 in environment 2 .*must be finite"):
            env.step(action)
    for shape in ((3, 1), (2, *env.single_action_space.shape), env.single_action_space.shape):
        with pytest.raises(ValueError, match=r"actions have shape .*, expected \(3, "):
            env.step(np.zeros(shape, np.float32))
    assert torch.equal(env.task.teams[env.team].team.state, before)
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


@pytest.mark.parametrize("options", [{"team": "submarine"}, {"team": "usv", "num_envs": 0}])
def test_wrong_arguments_are_refused(options: dict) -> None:
    with pytest.raises(ValueError, match="allowed are|at least 1"):
        TeamVectorEnv(**options)


def test_closing_twice_is_allowed() -> None:
    env = make_vec(IDS[0])
    env.close()
    env.close()
    assert env.closed
