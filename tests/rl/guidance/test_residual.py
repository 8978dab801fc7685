"""A policy that corrects the classical controller: nothing is added where it is silent, or where nothing is near."""

import pytest
import torch
from small_missions import begin, make, wander
from torch import Tensor

from rl.guidance.observations import CHANGE_SCALE
from rl.learn.actor import Actor
from rl.learn.policy import CheckpointError, ClassicalPolicy, TrainedPolicy
from rl.missions.formation.team import TeamTask
from rl.perception.sensors import Obstacle
from rl.scenario import StageConfig
from taichi_sim.config import ConfigError

MOST = 2.0  # m/s


def corrected(*overrides: str):
    """A mission whose boats correct the classical controller's desired velocity by MOST in each component."""
    return make(f"usv.residual={{velocity={MOST}}}", *overrides, teams=("usv",))


def pushes(team, monkeypatch) -> Tensor:
    """Length [vehicle] of what a policy that asks for the most ahead changes in the desired velocity, m/s."""
    asked = []
    monkeypatch.setattr(team.corrected, "act", lambda known, wanted: asked.append(wanted.velocity) or team.action)
    silent = torch.zeros(team.mission.num_envs, 3, 2)
    for action in (silent, silent + torch.tensor([1.0, 0.0])):
        team.commanded(action)
    return (asked[1] - asked[0]).norm(dim=-1)[0]


def test_a_silent_policy_is_the_classical_controller_and_a_loud_one_is_limited():
    task = corrected()
    begin(task)
    team, classical = task.teams["usv"], ClassicalPolicy()
    wander(task, 2)
    expected = classical(team).values.clamp(-1.0, 1.0)
    silent = torch.zeros(task.num_envs, 3, 2)
    quiet, loud, loudest = (task.act({"usv": silent + size})["usv"] for size in (0.0, 1.0, 7.0))
    assert quiet.equal(expected) and loudest.equal(loud) and not loud.equal(expected)


def test_the_change_of_velocity_that_the_controller_wants_now_is_observed():
    task = corrected()
    begin(task)
    team = task.teams["usv"]
    assert team.observation_names[-2:] == ("reference.0", "reference.1")
    for _ in range(2):
        squashed = team.observations()[..., -2:]
        ahead, aside = (CHANGE_SCALE * squashed / (1 - squashed.abs())).unbind(-1)
        c, s = team.known.fleet.heading
        change = torch.stack((c * ahead - s * aside, s * ahead + c * aside), dim=-1)
        wanted = team.corrected.wanted(team.known).velocity
        torch.testing.assert_close(change, wanted - team.known.fleet.velocity_n[..., :2], rtol=1e-4, atol=1e-4)
        wander(task, 1)


def test_a_gate_opens_where_an_obstacle_is_near(monkeypatch):
    task = corrected("usv.residual.gate=20.0", "sea.hs=0")
    begin(task)
    team = task.teams["usv"]
    near = torch.tensor([20.0, 15.0, 5.0]) + team.radius
    team.sensor.obstacles[..., 0, 0] = near.expand(task.num_envs, 3)
    team.sensor.obstacles[..., 0, Obstacle.NUMBER] = 0.0
    torch.testing.assert_close(pushes(team, monkeypatch), MOST * torch.tensor([0.0, 0.5, 1.0]))
    team.sensor.obstacles[..., 0, Obstacle.NUMBER] = -1.0  # there is nothing: what stands in the table is the range
    assert pushes(team, monkeypatch).equal(torch.zeros(3))


@pytest.mark.parametrize("team", ["usv", "uav"])
def test_a_corrected_velocity_is_flown(team):
    """A policy that always asks for 2 m/s to port is that much to port of a formation that goes straight on."""
    straight = ("sea.hs=0", "obstacles.count=0", "track.min_radius=300", "track.checkpoints=6")
    task = make(*straight, f"{team}.residual={{velocity=2.0}}", f"{team}.count=1", teams=(team,))
    begin(task)
    side = task.teams[team]
    assert side.action_names == ("velocity ahead (correction)", "velocity to starboard (correction)")
    port = torch.tensor([0.0, -1.0]).expand(task.num_envs, 1, 2)
    for _ in range(80):
        task.step({team: port})
    off = side.now.error[:, 0, :2]
    aside = off[:, 1] * side.target.cos[:, 0] - off[:, 0] * side.target.sin[:, 0]
    assert (aside > 1.0).all()  # where the controller's own 2 m/s back balance it
    assert side.observations().shape[-1] == len(side.observation_names)


def test_its_policy_is_another_than_one_that_acts_alone():
    task = corrected()
    names = {"observations": task.teams["usv"].observation_names, "actions": ("acceleration", "yaw")}
    actor = Actor(StageConfig(team="usv"), len(names["observations"]), 2)
    with pytest.raises(CheckpointError, match="correction"):
        TrainedPolicy(actor, names, "model_1.pt").check(task.teams["usv"])


def test_what_has_no_classical_controller_cannot_be_corrected(monkeypatch):
    task = corrected()
    monkeypatch.setattr(TeamTask, "make_controller", lambda self: None)
    team = task.teams["usv"]
    team._controller = team._wanted = None
    with pytest.raises(ConfigError, match="usv.residual: there is no classical controller to correct"):
        team.observations()


@pytest.mark.parametrize("team", ["usv", "uav"])
def test_a_silent_policy_that_corrects_velocities_is_the_classical_controller_in_lanes_full_of_obstacles(team):
    lanes = ("obstacles.clearance_min=-15", "obstacles.clearance_max=0", "obstacles.count=60")
    task = make(f"{team}.residual={{velocity=3.0, shield=4.0}}", *lanes, teams=(team,))
    begin(task)
    side, classical = task.teams[team], ClassicalPolicy()
    silent = torch.zeros(task.num_envs, 3, 2)
    for _ in range(40):
        expected = classical(side)
        assert task.act({team: silent})[team].equal(expected.values.clamp(-1.0, 1.0))
        task.step({team: expected})
