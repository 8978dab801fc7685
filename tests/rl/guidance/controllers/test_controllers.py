"""Classical controllers: gains against closed forms, and what the vehicles do under them."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import taichi as ti
import torch
from small_missions import TEAMS
from torch import Tensor

from rl.evaluation.episodes import judge_episodes
from rl.guidance import avoidance
from rl.guidance.controllers import laws
from rl.guidance.controllers.sampled import held, place_poles
from rl.learn.policy import ClassicalPolicy, policies_of
from rl.mission import ControllerError
from rl.missions import load_scenario
from rl.missions.formation.mission import Formation
from taichi_sim.kernels import runtime
from taichi_sim.kernels.rotation import torch_quaternion_from_euler
from taichi_sim.kernels.runtime import array1

SMALL = ("track.worlds=4", "sea.realisations=4")
CALM = (*SMALL, "sea.hs=0", "obstacles.count=0")


def make(team: str, *overrides: str, envs: int = 4, seed: int = 3) -> Formation:
    """Return a task with environment i in world i."""
    task = Formation(load_scenario("lanes", overrides), envs, seed=seed, teams=(team,))
    task.reset(worlds=torch.arange(envs), starts=torch.zeros(envs, dtype=torch.int64))
    return task


def classical(team: str) -> ClassicalPolicy:
    return policies_of("classical", Path(), load_scenario("lanes"))[team]


def fly(task: Formation, team: str, seconds: float) -> tuple[Tensor, Tensor]:
    """Run; return the smallest gap [env, vehicle] on the way and the actions [step, env, vehicle, action]."""
    policy, gaps, actions = classical(team), [], []
    for _ in range(round(seconds / task.config.decision_interval)):
        actions.append(policy(task.teams[team]).values)
        task.drive({team: actions[-1]}, begin=False)
        gaps.append(task.teams[team].sensor.gap.clone())
    return torch.stack(gaps).amin(0), torch.stack(actions)


def put(task: Formation, team: str, away: Tensor, heading: float = 0.0) -> None:
    """Put vehicles `away` [env, vehicle, 2] (ahead, starboard, m) of undisturbed slots, `heading` off course."""
    side = task.teams[team]
    place = task.tracks.at(task.env_world, side.targets.progress)
    offset = side.offsets + away
    c, s = place.course.cos()[:, None], place.course.sin()[:, None]
    state = torch.zeros_like(side.fleet.state)
    state[..., 0] = place.position[:, :1] + c * offset[..., 0] - s * offset[..., 1]
    state[..., 1] = place.position[:, 1:] + s * offset[..., 0] + c * offset[..., 1]
    state[..., 2] = 0.0 if team == "usv" else -task.config.track.flight_height
    psi = (place.course + heading)[:, None].expand(state.shape[:2])
    state[..., 3:7] = torch_quaternion_from_euler(torch.zeros_like(psi), torch.zeros_like(psi), psi)
    state[..., 7] = task.config.track.target_speed
    task.world.place(team, torch.arange(task.num_envs), state)
    task.drive({team: torch.zeros_like(side.action)}, begin=False)  # so that everything is measured anew


# -- closed forms -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.0, 1.0, 5.0])
def test_held_is_the_geometric_series(damping):
    dt, n = 0.02, 5
    plant, kappa = held(dt, n, damping), 1 - damping * dt
    series = sum(kappa**i for i in range(1, n + 1))
    assert plant.keep == pytest.approx(kappa**n)
    assert plant.gain == pytest.approx(dt * series)
    assert plant.reach == pytest.approx(dt * series)
    assert plant.push == pytest.approx(dt**2 * sum((n + 1 - i) * kappa**i for i in range(1, n + 1)))


@pytest.mark.parametrize("damping", [0.0, 1.0, 5.0])
@pytest.mark.parametrize("bandwidth", [0.5, 2.0, 8.0])
def test_both_poles_are_placed(damping, bandwidth):
    plant = held(0.02, 5, damping)
    k_x, k_rate = place_poles(plant, bandwidth, 0.1)
    A = np.array([[1.0, plant.reach], [0.0, plant.keep]])
    closed = A - np.outer([plant.push, plant.gain], [k_x, k_rate])
    p = math.exp(-bandwidth * 0.1)
    np.testing.assert_allclose(np.poly(closed), [1.0, -2 * p, p * p], atol=1e-12)


@ti.kernel
def _approach(error: array1, gain: float, acceleration: float):
    for k in range(error.shape[0]):
        error[k] = laws.approach(error[k], gain, acceleration)


def test_approach_can_be_stopped():
    """From a rate sqrt(2 a |e|) a deceleration a stops exactly at zero error; near zero it is linear."""
    runtime.current()
    rate = torch.tensor([-2.0, 0.001])
    _approach(rate, 4.0, 3.0)
    torch.testing.assert_close(rate, torch.tensor([-math.sqrt(2 * 3.0 * 2.0), 0.004]))


# -- behaviour ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("team", TEAMS)
def test_converges_from_20_m(team):
    """Ahead, behind, to either side: after 20 s the whole team is on its slots, and nobody was hit."""
    task = make(team, *CALM)
    away = 20 * torch.tensor([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])[:, None].expand(4, 3, 2)
    put(task, team, away)
    assert task.teams[team].distance[:, 0].min() > 18
    gap, _ = fly(task, team, 20.0)
    assert gap.min() > 0
    assert task.teams[team].distance.max() < 0.1


@pytest.mark.parametrize("team", TEAMS)
def test_turns_round_when_it_faces_backwards(team):
    task = make(team, *CALM, f"{team}.count=1")
    put(task, team, torch.zeros(4, 1, 2), heading=math.pi - 0.01)
    fly(task, team, 15.0)
    assert task.teams[team].distance.max() < 0.2


@pytest.mark.parametrize("team", TEAMS)
def test_avoids_an_obstacle_in_its_way(team, monkeypatch):
    """A cylinder on the leader's track is passed and the slot found again; without avoidance it is hit."""

    def smallest_gap() -> float:
        task = make(team, *CALM, f"{team}.count=1")
        put(task, team, torch.zeros(4, 1, 2))
        ahead = task.tracks.at(task.env_world, task.teams[team].targets.progress + 80.0)
        rest = torch.tensor([5.0, 90.0]).expand(4, 2)  # radius and height
        vars(task)["obstacles"] = torch.cat((ahead.position, rest), dim=1).unsqueeze(1)
        gap, _ = fly(task, team, 16.0)
        assert task.teams[team].distance.max() < 0.3
        return float(gap.min())

    assert smallest_gap() > 0.3
    monkeypatch.setattr(avoidance.Avoider, "__call__", lambda self, team, velocity: velocity)
    assert smallest_gap() < 0.0


@pytest.mark.parametrize("team", TEAMS)
@pytest.mark.parametrize("count", [8, *(pytest.param(count, marks=pytest.mark.slow) for count in (1, 3))])
def test_actions_are_legal_and_repeatable(team, count):
    def actions() -> Tensor:
        return fly(make(team, *SMALL, f"{team}.count={count}", "sea.hs=1"), team, 2.0)[1]

    first = actions()
    assert first.shape == (20, 4, count, 2 if team == "usv" else 3)
    assert torch.isfinite(first).all()
    assert first.abs().max() <= 1
    assert torch.equal(first, actions())


@pytest.mark.parametrize("team", TEAMS)
def test_decides_on_what_is_measured_now_alone(team):
    """No memory: a new controller in the middle of an episode acts as the old one."""
    task, policy = make(team, *SMALL), classical(team)
    for _ in range(5):
        task.step({team: policy})
    assert torch.equal(policy(task.teams[team]).values, classical(team)(task.teams[team]).values)


@pytest.mark.parametrize("team", TEAMS)
def test_blind_teams_act_too(team):
    task = make(team, *SMALL, "sensing.obstacles=0", "sensing.team_mates=0")
    _, actions = fly(task, team, 1.0)
    assert torch.isfinite(actions).all()


def test_baseline_is_strong():
    """Centimetres in the paper's scenario: the hull's own tilt tells the push of the waves."""
    config = load_scenario("lanes", ["episode_duration=20", "evaluation.settle=15", "obstacles.count=0"])
    policies = policies_of("classical", Path(), config)
    teams = judge_episodes(config, policies, episodes=8, seed=7, show_progress=False).result["teams"]
    assert teams["usv"]["leader_error_rms_m"] < 0.05
    assert teams["usv"]["follower_error_rms_m"] < 0.1
    assert teams["uav"]["leader_error_rms_m"] < 0.02
    assert teams["uav"]["follower_error_rms_m"] < 0.05
    assert all(figures["collision_free_episodes"] >= 7 / 8 for figures in teams.values())


def test_unknown_vehicle_is_refused_by_name():
    mission = SimpleNamespace(controller=lambda team: None)
    team = SimpleNamespace(name="usv", mission=mission, controller=None, fleet=SimpleNamespace(model=object()))
    with pytest.raises(ControllerError, match="usv: .*vehicle model object"):
        ClassicalPolicy()(team)
