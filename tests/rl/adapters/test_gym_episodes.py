"""Episodes of the Gymnasium environments: seeds, endings, and the other team."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gym_envs import IDS, REASONS, SHORT, SMALL, both, make_vec, place_on_an_obstacle, rollout, same, shared
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from rl.learn.actor import Actor
from rl.learn.policy import CheckpointError, TrainedPolicy
from rl.missions import load_scenario
from rl.runs.folder import CONFIG, RunError
from taichi_sim.config.io import write_toml
from taichi_sim.models.usv.vessel_base import Vessel

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
    with pytest.raises(ResetNeeded, match=r"episodes .* are over"):
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
    before = task.teams["uav"].fleet.state.clone()
    together.step(together.action_space.sample())
    assert not torch.equal(task.teams["uav"].fleet.state, before)
    assert not task.teams["uav"].action.any()


def test_an_ending_of_the_other_team_truncates() -> None:
    env = make_vec(IDS[0], other="constant", overrides=(*SMALL, "episode_duration=100"))
    env.reset(seed=1)
    env.unwrapped.task.teams["uav"].fleet.state[1, 0, 2] = 5.0  # in the sea
    _, _, terminated, truncated, infos = env.step(env.action_space.sample())
    assert not terminated.any()
    assert truncated.tolist() == [False, True, False]
    assert not any(infos[reason].any() for reason in (*REASONS, *Vessel.ending_names))


def save_policy(folder, observations: int, actions: int) -> None:
    """A checkpoint of an untrained actor of the shipped stage."""
    torch.manual_seed(0)
    actor = Actor(load_scenario(overrides=SMALL).stages["uav"], observations, actions)
    folder.mkdir()
    torch.save({"actor_state_dict": actor.state_dict(), "iter": 1}, folder / "model_1.pt")


def test_a_frozen_policy_acts_for_the_other_team(tmp_path) -> None:
    probe = make_vec(IDS[1]).unwrapped
    observations = probe.single_observation_space.shape[0] // 3
    actions = probe.single_action_space.shape[0] // 3
    save_policy(tmp_path / "uav", observations, actions)
    env = make_vec(IDS[0], other=tmp_path / "uav" / "model_1.pt").unwrapped
    env.reset(seed=1)
    policy = TrainedPolicy.load(tmp_path / "uav" / "model_1.pt", load_scenario(overrides=SMALL).stages["uav"])
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
