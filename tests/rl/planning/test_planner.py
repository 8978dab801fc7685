"""Planners: a fork predicts what will happen, plans pay off, and what cannot be planned is refused."""

import pytest
import torch
from folders import PLUGINS

from rl.learn.policy import ClassicalPolicy
from rl.mission import ControllerError, VehicleActions
from rl.missions import load_scenario, make_mission
from rl.planning.planner import HonestPlanner, PlanConfig, Planner
from taichi_sim.config import ConfigError

PLUGIN = PLUGINS / "buoys.toml"
FEW = ("track.worlds=8", "sea.realisations=4")
SHORT = PlanConfig(samples=16, rounds=2, horizon=2.0, every=1.9)


def team_of(scenario: str, *overrides: str, envs: int = 3, team: str = "usv"):
    mission = make_mission(load_scenario(scenario, (*FEW, *overrides)), envs, seed=3, teams=(team,))
    return mission.teams[team]


def cost_of(team, steps: int, action) -> torch.Tensor:
    """What the team's next steps cost it [env]; `action` is asked for the number of each."""
    cost, ended = torch.zeros(team.mission.num_envs), torch.zeros_like(team.fleet.never)
    for k in range(steps):
        now = team.mission.step({team.name: action(k)}, begin=False).endings[team.name].any
        cost += team.plan_cost(now & ~ended).sum(-1)
        ended |= now
    return cost


@pytest.mark.parametrize("scenario", ["lanes", pytest.param("otter", marks=pytest.mark.slow)])
def test_what_an_oracle_predicts_is_what_happens(scenario):
    """Sensors' noise, currents and bodies that move included; and it is no worse than the classical controller."""
    team = team_of(scenario)
    steps = round(SHORT.horizon / team.mission.config.decision_interval)
    planner = Planner(SHORT, seed=1)
    cost_of(team, 5, lambda k: ClassicalPolicy()(team))
    planner(team)
    saved = team.mission.snapshot()
    happened = cost_of(team, steps, lambda k: VehicleActions(team.planned(planner.correction_at(k))))
    assert happened == pytest.approx(planner.cost.numpy(), rel=2e-4)
    team.mission.restore(saved)
    assert cost_of(team, steps, lambda k: VehicleActions(team.planned(planner.correction_at(k) * 0))) == pytest.approx(
        planner.classical.numpy(), rel=2e-4
    )
    assert (planner.cost <= planner.classical).all() and (planner.cost < planner.classical).any()


def test_few_forks_serve_plans_for_any_number_of_environments(monkeypatch):
    team = team_of("lanes", envs=8)
    built, alike = [], type(team.mission)._alike
    monkeypatch.setattr(type(team.mission), "_alike", lambda self, n: built.append(n) or alike(self, n))
    planner = Planner(PlanConfig(samples=4, rounds=1, horizon=0.2, every=0.1), seed=1)
    for count in range(8, 0, -1):
        planner.bind(team)
        planner._plan(team, torch.arange(count))
        assert (planner.cost[:count] <= planner.classical[:count]).all()
    assert sorted(built) == [8, 16, 24, 32]  # two, four, six, eight environments, four copies of each


def test_a_plan_costs_more_inside_its_berth():
    """As much as the square of the distance from the slot says, and 300 m^2 for each metre."""
    team = team_of("lanes", "usv.plan.berth=2.0")
    team.sensor.gap.copy_(torch.tensor([3.0, 1.5, 0.0]).expand_as(team.sensor.gap))
    extra = team.plan_cost(torch.zeros_like(team.fleet.never)) - team.distance.square()
    assert extra[0].tolist() == pytest.approx([0.0, 150.0, 600.0], rel=1e-4)


def test_a_learned_policy_is_followed_where_it_is_the_best_sample():
    """One that stops is, where nothing else is tried but the classical controller, in some environments."""
    team = team_of("lanes", envs=12)

    def stop(team):
        return VehicleActions(-torch.ones_like(team.fleet.action))

    planner = Planner(PlanConfig(samples=4, rounds=1, horizon=2.0, every=1.0, spread=1e-6), proposal=stop)
    action, follows = planner(team).values, planner.follows_policy
    assert follows.any() and not follows.all()
    assert action[follows].equal(stop(team).values[follows])
    assert action[~follows] == pytest.approx(ClassicalPolicy()(team).values[~follows].numpy(), abs=1e-4)
    assert (planner.cost[follows] < planner.classical[follows]).all()


@pytest.mark.parametrize("scenario", ["lanes", pytest.param("otter", marks=pytest.mark.slow)])
def test_an_honest_planner_believes_what_is_measured(scenario):
    team = team_of(scenario, "sensors={gnss={noise=0.05}, contacts={range_noise=0.2}}")
    truth, everywhere = team.mission.world, torch.arange(3)
    truth.wind.set_mean(everywhere, torch.tensor([[3.0, 1.0, 0.0]]).expand(3, 3))  # not those of the scenario
    truth.current.set_mean(everywhere, torch.tensor([[0.1, -0.2]]).expand(3, 2))
    cost_of(team, 10, lambda k: ClassicalPolicy()(team))
    planner = HonestPlanner(SHORT, seed=1)
    action = planner(team).values
    model = planner._believed
    mine = model.teams["usv"]
    assert mine.fleet.state.equal(team.known.fleet.state) and not mine.fleet.state.equal(team.fleet.state)
    assert float(model.world.sea.components.amplitude.sum()) == 0.0
    assert model.world.wind.velocity.equal(truth.wind.mean)
    assert model.world.current.velocity.equal(truth.current.steady)
    assert mine.now.slot[:, 0].equal(team.now.slot[:, 0])
    assert action.shape == team.fleet.action.shape and bool(action.isfinite().all())
    seen = team.known.sensor.obstacles[..., 0, 8] >= 0
    believed, known = (of.sensor.obstacles[..., 0, 7][seen] for of in (mine, team.known))
    assert len(known) and believed == pytest.approx(known.numpy(), abs=1.0)  # m: a mate may have it nearer


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Planner, HonestPlanner])
def test_plans_are_better_than_the_classical_controller_in_lanes_full_of_obstacles(kind):
    errors = []
    for policy in (ClassicalPolicy(), kind(PlanConfig(samples=64, rounds=2))):
        team = team_of("lanes", "seed=11", envs=12)
        total = torch.zeros(12)
        for _ in range(450):
            step = team.mission.step({"usv": policy}, begin=False)
            assert not step.endings["usv"]["collided"].any() or isinstance(policy, ClassicalPolicy)
            total += team.distance.square().mean(-1)
        errors.append(float(total.mean()))
    assert errors[1] < 0.7 * errors[0]


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("usv.plan.samples=0", "usv.plan.samples"),
        ("usv.plan.horizon=0.3", "every = 0.5 s must be below horizon = 0.3 s"),
        ("usv.plan.sample=3", "samples"),
    ],
)
def test_plans_that_cannot_be_are_refused_with_the_key(override, told):
    with pytest.raises(ConfigError, match=told):
        load_scenario("lanes", (override,))


def test_horizons_that_do_not_fit_the_episode_are_refused():
    team = team_of("lanes", "obstacles.count=0", "episode_duration=5", "evaluation.settle=1")
    for horizon, told in ((0.12, "two decisions of 0.1 s"), (6.0, "beyond episode_duration = 5.0 s")):
        with pytest.raises(ConfigError, match=f"usv.plan.horizon = {horizon} s: must .*{told}"):
            Planner(PlanConfig(horizon=horizon, every=0.1))(team)


def test_a_mission_that_cannot_say_what_is_known_has_no_honest_planner():
    mission = make_mission(load_scenario(PLUGIN), 2, seed=1, source=PLUGIN)
    team = next(iter(mission.teams.values()))
    with pytest.raises(ControllerError, match="no way to build what boats knows .*Mission.imagined"):
        HonestPlanner(PlanConfig(horizon=1.0, every=0.5))(team)
