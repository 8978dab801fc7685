"""rsl-rl's view: rows, endings against time-outs, untouched observations, frozen policies."""

import pytest
import torch
from torch import Tensor

from rl.learn.env import MissionEnv
from rl.mission import Team
from rl.missions import load_scenario
from rl.missions.formation.mission import Formation

SMALL = ("track.worlds=4", "sea.realisations=4", "uav.count=2")
ENVS, UAVS, USVS = 4, 2, 3


class Pilot:
    """A frozen policy that remembers what it was shown and what it said."""

    def __init__(self, value: float):
        self.value, self.seen, self.said = value, [], []

    def __call__(self, team: Team) -> Tensor:
        self.seen.append((team.name, team.observations()))
        self.said.append(torch.full((ENVS, USVS, 2), self.value))
        return self.said[-1]


@pytest.fixture(scope="module")
def shared() -> MissionEnv:
    return build(Pilot(0.25))


@pytest.fixture
def env(shared: MissionEnv) -> MissionEnv:
    """Return the aircraft's environment at the beginning of an episode, boats frozen."""
    shared.mission.reseed(5)
    shared.mission.reset()
    shared.step(nothing())  # fills the observations of the new episode
    return shared


def build(pilot) -> MissionEnv:
    task = Formation(load_scenario("paper", SMALL), ENVS, seed=1)
    return MissionEnv(task, "uav", {"usv": pilot})


def nothing() -> Tensor:
    return torch.zeros(ENVS * UAVS, 3)


def test_row_is_env_times_vehicles_plus_vehicle(env):
    assert env.num_envs == ENVS * UAVS
    assert env.num_actions == 3
    actions = torch.linspace(-0.9, 0.9, ENVS * UAVS * 3).reshape(ENVS * UAVS, 3)
    observations, reward, dones, extras = env.step(actions)
    rows, own = observations["policy"], env.mission.teams["uav"].observations()
    assert observations.batch_size == (ENVS * UAVS,)
    for e in range(ENVS):
        for v in range(UAVS):
            row = e * UAVS + v
            assert rows[row].equal(own[e, v])
            assert env.mission.teams["uav"].action[e, v].equal(actions[row])
            assert reward[row] == env.last.reward["uav"][e, v]
    for tensor in (reward, dones, extras["time_outs"], env.episode_length_buf):
        assert tensor.shape == (ENVS * UAVS,)


def test_an_action_moves_its_own_vehicle_only(env):
    """Two steps from the same start differ in one row's action, and in that vehicle's place alone."""
    places = []
    for boost in (-1.0, 1.0):
        env.mission.reseed(7)
        env.mission.reset()
        actions = nothing()
        actions[2 * UAVS + 1, 2] = boost
        env.step(actions)
        places.append(env.mission.teams["uav"].fleet.state.clone())
    moved = (places[0] != places[1]).any(dim=-1)
    assert moved.nonzero().tolist() == [[2, 1]]


def test_in_the_middle_of_an_episode_nothing_is_done(env):
    env.mission.steps.zero_()
    _, _, dones, extras = env.step(nothing())
    assert not dones.any() and not extras["time_outs"].any()
    assert env.mission.steps.tolist() == [1] * ENVS


def test_own_ending_terminates_and_a_team_mates_truncates(env):
    env.mission.steps.zero_()
    env.mission.teams["uav"].fleet.state[1, 0, 2] = 5.0  # under water
    _, _, dones, extras = env.step(nothing())
    # env:              0     1     2     3
    assert dones.tolist() == [0, 0, 1, 1, 0, 0, 0, 0]
    assert extras["time_outs"].tolist() == [0, 0, 0, 1, 0, 0, 0, 0]
    assert env.mission.steps.tolist() == [1, 0, 1, 1]  # a new episode there


def test_the_ending_of_the_other_team_truncates_every_row(env):
    env.mission.steps.zero_()
    boats = env.mission.teams["usv"].fleet.state
    boats[2, 1] = boats[2, 2]  # a collision
    _, _, dones, extras = env.step(nothing())
    assert dones.tolist() == [0, 0, 0, 0, 1, 1, 0, 0]
    assert extras["time_outs"].tolist() == [0, 0, 0, 0, 1, 1, 0, 0]


def test_the_end_of_time_truncates_every_row_but_those_that_ended_themselves(env):
    env.mission.steps.fill_(env.max_episode_length - 1)
    env.mission.teams["uav"].fleet.state[3, 1, 2] = 5.0
    _, _, dones, extras = env.step(nothing())
    assert dones.tolist() == [1] * 8
    assert extras["time_outs"].tolist() == [1, 1, 1, 1, 1, 1, 1, 0]
    assert env.mission.steps.tolist() == [0] * ENVS


def test_after_an_ending_the_observation_is_of_the_new_episode(env):
    env.mission.steps.zero_()
    env.mission.teams["uav"].fleet.state[1, 0, 2] = 5.0
    observations, reward, _, _ = env.step(nothing())
    rows = observations["policy"].view(ENVS, UAVS, -1)
    assert rows.equal(env.mission.teams["uav"].observations())
    assert rows[1, :, :4].equal(rows[1, :, 4:8])  # no past
    assert reward.view(ENVS, UAVS)[1, 0] < -5.0  # the reward is of the old one, collision weight 10


def test_the_log_is_of_the_step_taken_not_of_the_new_episodes(env):
    """Every episode ends 100 m from its target: that is the error to log, not that of the starts."""
    team = env.mission.teams["uav"]
    env.mission.steps.fill_(env.max_episode_length - 1)
    target = team.target.position
    team.fleet.state[:, 0, :3] = target - 100.0 * target.sign() * torch.tensor([1.0, 0.0, 0.0])
    _, _, dones, extras = env.step(nothing())
    assert dones.all()
    assert extras["log"]["/leader_error_m"].item() == pytest.approx(100.0, abs=5.0)
    assert all(key.startswith("/") for key in extras["log"])


def test_observations_given_out_are_not_written_to_again(env):
    """rsl-rl keeps a reference to them and stores them after the next step."""
    observations = env.get_observations()["policy"]
    copy = observations.clone()
    env.mission.steps.fill_(env.max_episode_length - 2)
    for _ in range(3):  # through an ending
        env.step(torch.ones(ENVS * UAVS, 3))
    assert observations.equal(copy)
    assert not env.get_observations()["policy"].equal(copy)


def test_the_other_team_acts_by_its_frozen_policy(env):
    pilot = env.frozen["usv"]
    pilot.seen.clear()
    expected = env.mission.teams["usv"].observations()
    env.step(torch.ones(ENVS * UAVS, 3))
    assert len(pilot.seen) == 1
    name, observations = pilot.seen[0]
    assert name == "usv"
    assert observations.equal(expected)  # as of before the step
    assert (env.mission.teams["usv"].action == 0.25).all()


@pytest.mark.parametrize("value", [0.25, 3.0])
def test_what_a_frozen_policy_says_is_not_written_to(env, value):
    pilot = Pilot(value)
    env.frozen["usv"] = pilot
    env.mission.steps.fill_(env.max_episode_length - 2)
    for _ in range(3):
        env.step(nothing())
    env.frozen["usv"] = Pilot(0.25)
    assert all((said == value).all() for said in pilot.said)


def test_a_team_without_a_policy_is_refused(env):
    with pytest.raises(ValueError, match="no policy for.*usv"):
        MissionEnv(env.mission, "uav")


def test_episode_lengths_are_read_and_set_by_row(env):
    env.episode_length_buf = torch.tensor([3, 3, 1, 1, 4, 4, 2, 2])
    assert env.mission.steps.tolist() == [3, 1, 4, 2]
    assert env.episode_length_buf.tolist() == [3, 3, 1, 1, 4, 4, 2, 2]


def test_environments_do_not_all_run_out_of_time_together():
    task = Formation(load_scenario("paper", (*SMALL, "uav.count=1")), 64, seed=1, teams=("uav",))
    env = MissionEnv(task, "uav")
    ages = env.episode_length_buf
    assert ages.unique().numel() > 32
    assert ages.min() >= 0 and ages.max() < env.max_episode_length
