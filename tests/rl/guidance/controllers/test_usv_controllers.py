"""Classical controllers of displacement vessels: gains and thrusts against closed forms, and how vessels keep track."""

import math
import shutil

import numpy as np
import pytest
import torch
from folders import ROOT
from named_thrusters import write_hull
from phases import due
from torch import Tensor

from rl.evaluation.episodes import judge_episodes
from rl.guidance import avoidance
from rl.guidance.controllers import vessel
from rl.guidance.controllers.vessel import (
    Hull6DofController,
    Load,
    Resistance,
    Steering,
    hull_dynamics,
    loops,
    pair_limits,
    shaft,
    shares,
)
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario
from rl.missions.formation.mission import Formation
from taichi_sim.kernels.rotation import torch_quaternion_from_euler

VEHICLES = ROOT / "configs" / "vehicles"
CALM = (
    "sea.sea_state=0", "sea.components=6", "sea.current.speed=0", "sea.current.std=0", "air.speed=0",
    "obstacles.count=0", "track.worlds=4", "sea.realisations=1", "variation=0", "sensors.errors=0", "radio={}",
)  # fmt: skip
STRAIGHT = ("track.min_radius=150", "track.length=3000", "area=4000", "track.checkpoints=8")
INTERVAL, SPEED = 0.2, 1.5  # of the scenario


@pytest.fixture(scope="module")
def left_right(tmp_path_factory) -> str:
    """Return an Otter that takes shaft speeds."""
    file = tmp_path_factory.mktemp("vehicles") / "otter_left_right.toml"
    file.write_text((VEHICLES / "otter.toml").read_text().replace('"surge_yaw"   ', '"left_right"   '))
    shutil.copy(VEHICLES / "otter.hydro.json", file.parent)
    return str(file)


@pytest.fixture(scope="module")
def named_thrusters(tmp_path_factory) -> dict[str, str]:
    """Return Otters with named thrusters, by kind."""
    folder = tmp_path_factory.mktemp("vehicles")
    return {kind: str(write_hull(folder / f"{kind}.toml", kind)) for kind in ("azimuth", "fixed", "tunnel")}


def make(*overrides: str, vehicle: str = "otter", envs: int = 4, seed: int = 3) -> Formation:
    """Return a task with environment i in world i."""
    config = load_scenario("otter", [f'usv.vehicle="{vehicle}"', "usv.control={}", *overrides])
    task = Formation(config, envs, seed=seed, teams=("usv",))
    task.reset(worlds=torch.arange(envs), starts=torch.zeros(envs, dtype=torch.int64))
    return task


def sail(task: Formation, seconds: float, policy: ClassicalPolicy | None = None) -> tuple[Tensor, Tensor]:
    """Distances [step, env, vehicle] from the slots, and gaps likewise."""
    policy, team = policy or ClassicalPolicy(), task.teams["usv"]
    distances, gaps = [], []
    for _ in range(round(seconds / task.config.decision_interval)):
        task.step({"usv": policy}, begin=False)
        distances.append(team.distance.clone())
        gaps.append(team.sensor.gap.clone())
    return torch.stack(distances), torch.stack(gaps)


def put(task: Formation, speed: float = SPEED, heading: float = 0.0) -> None:
    """Put vehicles in undisturbed slots at `speed`, `heading` off course."""
    team = task.teams["usv"]
    place = task.tracks.at(task.env_world, task.teams["usv"].targets.progress)
    c, s = place.course.cos()[:, None], place.course.sin()[:, None]
    state = torch.zeros_like(team.fleet.state)
    state[..., 0] = place.position[:, :1] + c * team.offsets[..., 0] - s * team.offsets[..., 1]
    state[..., 1] = place.position[:, 1:] + s * team.offsets[..., 0] + c * team.offsets[..., 1]
    psi = (place.course + heading)[:, None].expand(state.shape[:2])
    state[..., 3:7] = torch_quaternion_from_euler(torch.zeros_like(psi), torch.zeros_like(psi), psi)
    state[..., 7] = speed
    task.world.place("usv", torch.arange(task.num_envs), state)
    task.drive({"usv": torch.zeros_like(team.action)}, begin=False)  # so that everything is measured anew


# -- closed forms -------------------------------------------------------------------------------------------------


def test_steady_motion_meets_the_resistance():
    """A line, a parabola with the root (sqrt(b^2 + 4 c F) - b) / 2c, and the cubic x^3 = 8."""
    assert Resistance(4.0).steady(10.0) == pytest.approx(2.5)
    assert Resistance(3.0, 2.0).steady(5.0) == pytest.approx(1.0)
    assert Resistance(0.0, 0.0, 1.0).steady(8.0) == pytest.approx(2.0)
    assert Resistance(0.0).steady(1.0) == math.inf


def otter():
    model = make(*CALM).teams["usv"].fleet.model
    return model, hull_dynamics(model, *pair_limits(model.params.thrusters))


def test_otter_is_what_was_published():
    """Fossen's figures: 3.09 m/s at full thrust; 60.8124 N m s^2 of cross-flow in yaw by the sum over strips."""
    model, hull = otter()
    assert hull.top_speed == pytest.approx(model.top_speed)
    assert hull.top_speed == pytest.approx(3.0864, rel=1e-4)  # 2 k n^2 / D11
    assert hull.moment == pytest.approx(0.395 * (119.682 + 66.708), rel=1e-4)
    assert hull.yaw.b == pytest.approx(426.5145 + 60.8124, rel=0.03)  # 21 strips against the integral
    assert hull.yaw.steady(hull.yaw.a * 0.1 + hull.yaw.b * 0.01) == pytest.approx(0.1)


@pytest.mark.parametrize("interval", [0.05, 0.2])
def test_heading_loop_has_its_poles_where_stated(interval):
    """The sampled loop of a double integrator with linear damping, by a matrix exponential."""
    _, hull = otter()
    k, d = loops(hull, Hull6DofController.Gains(), interval), hull.yaw.a / hull.m33
    A = np.array([[0.0, 1.0, 0.0], [0.0, -d, 1.0 / hull.m33], [0.0, 0.0, 0.0]])  # psi, r, held N
    step = np.linalg.matrix_power(np.eye(3) + A * interval / 2**24, 2**24)
    N = -np.array([[hull.m33 * (k.k_r + d) * k.k_psi, hull.m33 * k.k_r]])
    w = min(math.sqrt(hull.moment / (hull.m33 * 0.35)), 0.5 / interval)
    p = math.exp(-w * interval)
    np.testing.assert_allclose(np.poly(step[:2, :2] + step[:2, 2:] @ N), [1.0, -2 * p, p * p], atol=1e-6)


def test_position_loop_is_critically_damped():
    _, hull = otter()
    k = loops(hull, Hull6DofController.Gains(), INTERVAL)
    roots = np.roots([1.0, k.k_e, k.k_i])
    np.testing.assert_allclose(roots, -k.k_e / 2, rtol=1e-6)


def test_moment_goes_before_surge():
    """Full thrust and full moment: one propeller full ahead, the other full astern; X takes what is left."""
    model, _ = otter()
    t = model.params.thrusters
    zero, much = torch.zeros(1), torch.full((1,), 1e4)
    left, right = shares(t, Load(much, zero, much), astern=False)
    assert left.item() == pytest.approx(t.thrust_max)
    assert right.item() == pytest.approx(t.thrust_min)
    N = torch.tensor([20.0])
    left, right = shares(t, Load(much, zero, N), astern=False)
    assert left.item() == pytest.approx(t.thrust_max)
    assert 0.395 * (left - right).item() == pytest.approx(20.0, rel=1e-5)
    left, right = shares(t, Load(-much, zero, N), astern=False)
    assert (left + right).item() == pytest.approx(0.0, abs=1e-4)
    assert 0.395 * (left - right).item() == pytest.approx(20.0, rel=1e-5)


def test_shaft_speed_gives_the_thrust():
    model, _ = otter()
    t = model.params.thrusters
    wanted = torch.linspace(t.thrust_min, t.thrust_max, 9, dtype=torch.float64)
    share = shaft(t, wanted)
    n = torch.where(share > 0, share * t.n_max, -share * t.n_min)
    k = torch.where(n > 0, t.k_positive, t.k_negative)
    torch.testing.assert_close(k * n.abs() * n, wanted)


# -- behaviour ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("overrides", [(), STRAIGHT], ids=["curved", "straight"])
@pytest.mark.parametrize("vehicle", ["otter", "left_right", "otter_3dof"])
def test_tracks_in_calm_water(vehicle, overrides, left_right):
    """Within 15 cm of every slot after 60 s, 5 cm on a gentle track; the thrust is then that of the speed."""
    task = make(*CALM, *overrides, vehicle=left_right if vehicle == "left_right" else vehicle)
    policy = ClassicalPolicy()
    distances, gaps = sail(task, 80.0, policy)
    assert gaps.min() > 0
    assert distances[300:].max() < (0.05 if overrides else 0.15)
    team = task.teams["usv"]
    load = team.controller.course.load(team, team.controller.wanted(team))
    assert load.X[:, 0].mean().item() == pytest.approx(77.554432 * SPEED, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["azimuth", "fixed", "tunnel"])
def test_a_hull_with_named_thrusters_tracks_in_calm_water(kind, named_thrusters):
    """Within 15 cm of every slot after 60 s; loads of its actions are those it wants, within the thrusters' limits."""
    task = make(*CALM, vehicle=named_thrusters[kind])
    distances, gaps = sail(task, 65.0)
    assert gaps.min() > 0
    assert distances[300:].max() < 0.15
    model = task.teams["usv"].fleet.model
    steering = Steering.of(model)
    load = Load(*torch.tensor([[40.0, 1e4, 40.0], [0.0, 0.0, 0.0], [10.0, -20.0, 1e4]]))
    X, _, N = (steering.actions(load) * torch.tensor(model.wrench_max)).unbind(-1)
    torch.testing.assert_close((X[0], N[0]), (load.X[0], load.N[0]))
    assert X[1] / steering.thrust + abs(N[1]) / steering.moment == pytest.approx(1.0, rel=1e-5)  # the moment first
    assert X[2] == 0 and N[2].item() == pytest.approx(steering.moment, rel=1e-5)
    assert (steering.actions(load).abs() <= 1 + 1e-6).all()


@pytest.mark.slow
def test_shaft_speeds_do_as_surge_and_yaw(left_right):
    """Under way, either kind of action asks for the same thrusts, by the meaning that Hull6Dof.step gives them."""
    task = make(*CALM)
    sail(task, 10.0)
    team, other = task.teams["usv"], make(*CALM, vehicle=left_right).teams["usv"].fleet.model
    t = team.fleet.model.params.thrusters
    surge, yaw = team.make_controller()(team).unbind(-1)  # a new one: it has not learnt a drift yet
    mean, half = 0.5 * (surge + 1) * t.thrust_max, 0.5 * yaw * (t.thrust_max - t.thrust_min)
    share = Hull6DofController(other)(team)
    n = torch.where(share > 0, share * t.n_max, -share * t.n_min)
    thrust = torch.where(n > 0, t.k_positive, t.k_negative) * n.abs() * n
    torch.testing.assert_close(thrust, torch.stack((mean + half, mean - half), dim=-1), rtol=1e-4, atol=1e-3)
    assert half.abs().max() > 1


@pytest.mark.slow
def test_ship_that_slides_keeps_to_its_track():
    """CyberShip II, unstable in yaw at every speed, at 0.3 m/s: within two lengths or so of its slots."""
    small = ("track.target_speed=0.3", "usv.spacing=4", "usv.start_distance=2", "usv.count=1")
    task = make(*CALM, *small, *STRAIGHT, vehicle="cybership2")
    distances, _ = sail(task, 150.0)
    assert distances[500:].max() < 1.5


@pytest.mark.slow
def test_learns_the_current(monkeypatch):
    """A current across, along and in between: gone after a minute; without the integral it stays."""
    task, policy = make(*CALM, *STRAIGHT, "sea.current.speed=0.3"), ClassicalPolicy()
    learnt = sail(task, 90.0, policy)[0][300:]
    assert learnt.max() < 0.15
    loops = vessel.loops
    monkeypatch.setattr(vessel, "loops", lambda *given: loops(*given)._replace(k_i=0.0))
    task = make(*CALM, *STRAIGHT, "sea.current.speed=0.3")
    assert sail(task, 90.0, ClassicalPolicy())[0][300:].max() > 3 * learnt.max()


@pytest.mark.slow
def test_forgets_the_drift_in_a_new_episode():
    task, policy = make("sea.current.speed=0.3"), ClassicalPolicy()
    sail(task, 20.0, policy)
    task.reset(torch.tensor([1, 2]), worlds=torch.tensor([3, 0]))
    team = task.teams["usv"]
    old, new = policy(team).values, team.make_controller()(team.known)
    assert torch.equal(old[1:3], new[1:3])
    assert (old[0] - new[0]).abs().max() > 1e-3
    assert (old[3] - new[3]).abs().max() > 1e-3


@pytest.mark.parametrize("vehicle", ["otter", pytest.param("otter_3dof", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("speed", "heading"),
    [(SPEED, math.pi - 0.01), *(pytest.param(*x, marks=pytest.mark.slow) for x in ((0, 0), (-1.0, 0.5), (0, math.pi)))],
)
def test_recovers_from_odd_states(vehicle, speed, heading):
    """At rest, backwards, facing away: a single vessel is back in its slot within a minute."""
    task = make(*CALM, "usv.count=1", vehicle=vehicle)
    put(task, speed, heading)
    distances, _ = sail(task, 60.0)
    assert distances[-1].max() < 0.3


@pytest.mark.parametrize("vehicle", ["otter", "otter_3dof"])
def test_state_that_is_not_finite_stays_alone(vehicle):
    task, policy = make(*CALM, vehicle=vehicle), ClassicalPolicy()
    sail(task, 1.0, policy)
    team = task.teams["usv"]
    sound = ClassicalPolicy()(team).values
    team.fleet.state[2, 1], team.fleet.derived[2, 1] = math.nan, math.nan
    team.now.measure(due(task.num_envs))
    broken = ClassicalPolicy()(team).values
    assert (broken[2, 1] == 0).all()
    others = torch.ones(4, 3, dtype=torch.bool)
    others[2, 1] = False
    assert torch.equal(broken[others], sound[others])


def test_drift_survives_what_is_not_finite():
    """A vehicle that has been lost to the numbers begins its next episode without a memory of them."""
    task, policy = make(*CALM), ClassicalPolicy()
    sail(task, 1.0, policy)
    team = task.teams["usv"]
    team.fleet.state[2, 1], team.fleet.derived[2, 1] = math.nan, math.nan
    team.now.measure(due(task.num_envs))
    policy(team)
    task.reset(torch.tensor([2]))
    assert torch.equal(policy(team).values[2], ClassicalPolicy()(team).values[2])


@pytest.mark.parametrize("vehicle", ["otter", pytest.param("otter_3dof", marks=pytest.mark.slow)])
def test_avoids_an_obstacle_in_its_way(vehicle, monkeypatch):
    """A cylinder on the leader's track is passed and the slot found again; without avoidance it is hit."""

    def run() -> tuple[Tensor, Tensor]:
        task = make(*CALM, "usv.count=1", vehicle=vehicle)
        put(task)
        ahead = task.tracks.at(task.env_world, task.teams["usv"].targets.progress + 40.0)
        rest = torch.tensor([3.0, 10.0]).expand(4, 2)  # radius and height
        vars(task)["obstacles"] = torch.cat((ahead.position, rest), dim=1).unsqueeze(1).to(task.obstacles).contiguous()
        distances, gaps = sail(task, 90.0)
        return gaps.amin(), distances[-1].max()

    gap, distance = run()
    assert gap > 0.2
    assert distance < 0.5
    monkeypatch.setattr(avoidance.Avoider, "__call__", lambda self, team, velocity: velocity)
    assert run()[0] < 0


def test_blind_vessels_act_too():
    task = make("sensing.obstacles=0", "sensing.team_mates=0", "track.worlds=4", "sea.realisations=4")
    distances, _ = sail(task, 1.0)
    assert torch.isfinite(distances).all()


@pytest.mark.slow
def test_baseline_is_strong():
    """In sea state 3: little more than what the waves' orbits carry the hull to the side, 0.2 m."""
    config = load_scenario(
        "otter",
        [
            "episode_duration=60",
            "evaluation.settle=30",
            "variation=0",
            "sensors.errors=0",
            "obstacles.count=0",
            "radio={}",
            "usv.control={}",
        ],
    )
    outcome = judge_episodes(config, {"usv": ClassicalPolicy()}, episodes=16, seed=7, show_progress=False)
    team = outcome.result["teams"]["usv"]
    assert team["leader_error_rms_m"] < 0.3
    assert team["follower_error_rms_m"] < 0.4
    assert team["collision_free_episodes"] == 1.0
