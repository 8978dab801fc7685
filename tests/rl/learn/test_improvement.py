"""Policies improved by planning: what planners suggest pays off, and a stage learns it."""

import csv
from types import SimpleNamespace

import pytest
import torch

from rl.learn.improvement import Improver, PlannedImprovement
from rl.learn.policy import read_checkpoint
from rl.learn.stages import train_stages
from rl.missions import load_scenario, make_mission
from rl.planning.planner import PlanConfig
from taichi_sim.config import ConfigError

FEW = ("track.worlds=8", "sea.realisations=4", "usv.plan.horizon=1.0", "usv.plan.every=0.5")
SMALL = (
    *FEW, "stages.usv.num_envs=16", "stages.usv.steps_per_iteration=40", "stages.usv.learning_rate=0.003",
    "stages.usv.planning.samples=8", "stages.usv.checkpoint_interval=1",
)  # fmt: skip
PLAN = PlanConfig(samples=32, rounds=1, horizon=3.0, every=2.9, spread=0.6)


def no_correction(team):
    return torch.zeros((team.mission.num_envs, team.fleet.count, len(team.action_names)))


def cost_of(team, corrections) -> float:
    """What it costs a team to follow corrections, one a decision."""
    total = 0.0
    for correction in corrections:
        step = team.mission.step({team.name: correction}, begin=False)
        total += float(team.plan_cost(step.endings[team.name].any).sum())
    return total


def test_what_is_suggested_costs_less_where_it_has_an_effect():
    """And is nothing where no obstacle opens the gate."""
    team = make_mission(load_scenario("lanes", FEW), 24, seed=3, teams=("usv",)).teams["usv"]
    cost_of(team, [no_correction(team)] * 100)
    planner = Improver(PLAN, no_correction, seed=1)
    with torch.inference_mode():  # as rsl-rl acts
        planner.renew(team)
    assert not planner.correction().is_inference()
    suggested = [planner.correction_at(k) for k in range(30)]
    idle = ~team.in_effect.any(-1)
    assert idle.any() and not idle.all()
    assert all(float(correction[idle].abs().max()) == 0.0 for correction in suggested)
    begin = team.mission.snapshot()
    better = cost_of(team, suggested)
    team.mission.restore(begin)
    assert better < cost_of(team, [no_correction(team)] * 30)


def test_what_the_leader_tries_does_not_blur_what_its_followers_try():
    """In each sample either the leader deviates from the policy or its followers do, and only at first."""
    team = make_mission(load_scenario("lanes", FEW), 4, seed=3, teams=("usv",)).teams["usv"]
    planner = Improver(PLAN, no_correction, seed=1)
    drawn = planner._noise((4, 16, PLAN.knots, 3, 2), team.fleet.state).abs().amax((0, 4))  # [sample, knot, vehicle]
    assert (drawn[:, 2:] == 0).all()
    leader, followers = drawn[:, :2, 0].amax(1) > 0, drawn[:, :2, 1:].amin((1, 2)) > 0
    assert (leader != followers).all() and int(leader.sum()) == 8
    noise = planner._noise((4, 16, PLAN.knots, 3, 2), team.fleet.state)
    assert noise[:, :8].equal(-noise[:, 8:])  # opposite pairs
    alone = planner._noise((4, 16, PLAN.knots, 1, 2), team.fleet.state)
    assert (alone[:, :, :2] != 0).all()


def test_the_spread_of_plans_goes_from_its_first_to_its_last_value_in_a_stage():
    spreads = []
    for done in range(6):  # the last one more than the stage has
        stage = SimpleNamespace(planning=SimpleNamespace(spread=(0.6, 0.2)), iterations=5)
        PlannedImprovement._aim(SimpleNamespace(_stage=stage, _done=done, _planner=SimpleNamespace(aim=spreads.append)))
    assert spreads == pytest.approx([0.6, 0.5, 0.4, 0.3, 0.2, 0.2])


def test_a_policy_is_improved_about_actions_that_it_can_do():
    """A network's output beyond the range is the end of the range."""
    network = SimpleNamespace(
        actor=SimpleNamespace(get_latent=lambda observed: observed["policy"]),
        _actor=SimpleNamespace(rows=lambda rows: 2.0 * rows),
    )
    observed = torch.tensor([[[-3.0, 0.25], [0.55, -0.55]]])
    mean = PlannedImprovement._mean(network, SimpleNamespace(observations=lambda: observed))
    assert mean.tolist() == [[[-1.0, 0.5], [1.0, -1.0]]]


def test_a_stage_learns_what_is_suggested_and_goes_on_after_an_interruption(tmp_path):
    """More epochs leave a smaller error; a second run goes on from the first one's checkpoint."""
    errors = []
    for epochs, iterations in ((1, 1), (40, 1), (40, 2)):
        overrides = (*SMALL, f"stages.usv.learning_epochs={epochs}", f"stages.usv.iterations={iterations}")
        config = load_scenario("lanes", overrides)
        config = config.model_copy(update={"stages": {"usv": config.stages["usv"]}})
        train_stages(config, tmp_path / str(epochs), show_progress=False)
        with (tmp_path / str(epochs) / "usv" / "progress.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == iterations
        errors.append(float(rows[0]["policy_loss"]))
    assert errors[1] < 0.9 * errors[0] and errors[2] == errors[1]
    first, second = (read_checkpoint(tmp_path / "40" / "usv" / f"model_{k}.pt")["actor_state_dict"] for k in (1, 2))
    assert not first["mlp.0.weight"].equal(second["mlp.0.weight"])
    assert first["distribution.std_param"].equal(second["distribution.std_param"])


def test_two_teams_cannot_be_improved_at_a_time():
    with pytest.raises(ConfigError, match="stages.usv.joint = .*one team at a time"):
        load_scenario("lanes", (*SMALL, 'stages.usv.joint=["uav"]'))
