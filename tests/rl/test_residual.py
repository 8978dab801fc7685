"""A policy that corrects the classical controller: nothing is added where it is silent, or where nothing is near."""

import pytest
import torch
from small_missions import begin, make, wander

from rl.learn.policy import CheckpointError, ClassicalPolicy, TrainedPolicy
from taichi_sim.config import ConfigError


def corrected(*overrides: str):
    """A mission whose boats correct the classical controller by three tenths at most."""
    return make("usv.residual.share=0.3", *overrides, teams=("usv",))


def test_a_silent_policy_is_the_classical_controller_and_a_loud_one_is_limited():
    task = corrected()
    begin(task)
    team, classical = task.teams["usv"], ClassicalPolicy()
    wander(task, 2)
    expected = classical(team).clamp(-1.0, 1.0)
    silent = torch.zeros_like(expected)
    assert team.command(silent).equal(expected)
    torch.testing.assert_close(team.command(silent + 7.0), (expected + 0.3).clamp(-1.0, 1.0))


def test_the_classical_action_of_now_is_observed():
    task = corrected()
    begin(task)
    team = task.teams["usv"]
    assert team.observation_names[-2:] == ("reference.0", "reference.1")
    for _ in range(2):
        assert team.observe()[..., -2:].equal(ClassicalPolicy()(team))
        wander(task, 1)
    task.reset(torch.tensor([1]))
    assert team.observe()[1, :, -2:].equal(ClassicalPolicy()(team)[1])


def test_a_gate_opens_where_something_is_near():
    task = corrected("usv.residual.gate=20.0")
    begin(task)
    team = task.teams["usv"]
    team.sensor.gap.copy_(torch.tensor([40.0, 20.0, 15.0]).expand(task.num_envs, 3))
    team._reference = torch.zeros(task.num_envs, 3, 2)
    pushed = team.command(torch.ones(task.num_envs, 3, 2))
    torch.testing.assert_close(pushed[0, :, 0], torch.tensor([0.0, 0.0, 0.15]))


def test_its_policy_is_another_than_one_that_acts_alone():
    task = corrected()
    names = {"observations": task.teams["usv"].observation_names, "actions": ("acceleration", "yaw")}

    class Actor:
        def eval(self):
            return self

        def requires_grad_(self, wanted):
            return self

    with pytest.raises(CheckpointError, match="correction"):
        TrainedPolicy(Actor(), names, "model_1.pt").check(task.teams["usv"])


def test_what_has_no_classical_controller_cannot_be_corrected(monkeypatch):
    task = corrected()
    monkeypatch.setattr(type(task), "controller", lambda self, team: None)
    team = task.teams["usv"]
    team._controller = team._reference = None
    with pytest.raises(ConfigError, match="usv.residual: there is no classical controller to correct"):
        team.observe()
