"""Loads from outside on the boat, the aircraft of the seed paper and the vessel in the plane: momentum and energy."""

import numpy as np
import pytest
import torch

from taichi_sim.config import SeaConfig
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.surroundings.sea import Sea

pytestmark = pytest.mark.usefixtures("f64")
FREE = {
    "unity_boat": {"drag": 0.0, "angular_drag": 0.0, "buoyancy_damping": 0.0},
    "unity_aircraft": {"drag": 0.0},
    "cybership2": {
        **{f"X_{k}": 0.0 for k in ("u", "uu", "uuu")},
        **{f"{force}_{k}": 0.0 for force in "YN" for k in ("v", "vv", "rv", "r", "vr", "rr")},
        "actions": "surge_sway_yaw",
    },
}
COAST = {"unity_boat": (-1.0, 0.0), "unity_aircraft": (0.4, 0.5, -1.0), "cybership2": (0.0, 0.0, 0.0)}
LOAD = {
    "unity_boat": (40.0, -25.0, 30.0, 120.0, -150.0, 15.0),
    "unity_aircraft": (900.0, -2000.0, 1500.0, 0.0, 0.0, 0.0),
    "cybership2": (9.0, -5.0, 0.0, 0.0, 0.0, 2.0),
}
DT = 1e-3  # s
STEP_ERROR = {"unity_boat": 1e-3, "unity_aircraft": 1e-3, "cybership2": 1e-6}  # of the work; PhysX is of first order


def _springs(team):
    """Energy of the corners' springs and of the weight that preloads them, J."""
    p, state = team.model.params, team.state[0, 0]
    signs = torch.tensor([[1, -1], [1, 1], [-1, -1], [-1, 1]], dtype=torch.float64)
    corners = 0.5 * signs * torch.tensor([p.length, p.beam])
    down = state[2] + corners @ torch_rotation_matrix(state[QUATERNION])[2, :2]
    return 0.5 * p.buoyancy_stiffness * down.square().sum()


def _energy(file, team):
    """Of the first vehicle, J."""
    p, state = team.model.params, team.state[0, 0]
    v, omega = state[VELOCITY], state[ANGULAR_VELOCITY]
    if file == "cybership2":
        nu = state[[7, 8, 12]].numpy()
        return 0.5 * nu @ p.M @ nu
    energy = 0.5 * p.mass * v.dot(v)
    if file == "unity_boat":
        energy += 0.5 * (torch.tensor(p.inertia, dtype=torch.float64) * omega).dot(omega) + _springs(team)
    return float(energy)


@pytest.mark.parametrize("file", FREE)
def test_work_of_a_load_is_energy(file, make_model, bench):
    """Undamped, in calm water: energy gained is the work of load and thrust, but for the error of the step."""
    model = make_model(file, DT, 1, **FREE[file])
    team = bench(model).put((0.0, 0.0, -20.0 if model.medium == "air" else 0.0), velocity_b=(0.3, 0.1, 0.0))
    team.fleet.load[:] = torch.tensor(LOAD[file], dtype=torch.float64)
    acting = team.fleet.load[0, 0].clone()
    if model.medium == "air":
        acting[0] += model.params.thrust_factor * model.params.thrust * model.params.boost_min
    powers, before = [], _energy(file, team)
    for _ in range(1500):
        nu = team.state[0, 0, 7:13].clone()
        team.step(COAST[file])
        powers.append(float(acting @ (nu + team.state[0, 0, 7:13])) / 2)
    work = np.sum(powers) * DT
    assert abs(work) > 0.5 * before
    assert _energy(file, team) - before == pytest.approx(work, rel=STEP_ERROR[file])


def test_a_force_through_the_centre_of_a_boat_is_its_momentum(make_model, bench):
    """m v = F t ahead, I_z r = N t, and the springs give way by F / 4 k: exact, but for the last."""
    model = make_model("unity_boat", 0.02, 5, **FREE["unity_boat"] | {"buoyancy_damping": 45.0})
    p, team = model.params, bench(model, envs=3)
    team.fleet.load[0, 0, 0], team.fleet.load[1, 0, 5], team.fleet.load[2, 0, 2] = 10.0, 8.0, 20.0
    team.step((-1.0, 0.0), 100)
    motion = team.read()
    assert motion.nu[0] == pytest.approx([10.0 * 10.0 / p.mass, 0, 0, 0, 0, 0], abs=1e-12)
    assert motion.nu[1] == pytest.approx([0, 0, 0, 0, 0, 8.0 * 10.0 / p.inertia[2]], abs=1e-9)
    assert motion.position[2, 2] == pytest.approx(20.0 / (4 * p.buoyancy_stiffness), rel=1e-3)


def test_a_force_on_an_aircraft_is_its_momentum_and_a_moment_is_nothing(make_model, bench):
    """m dv = R (F + thrust) t at a steady attitude, wherever the nose points."""
    model = make_model("unity_aircraft", 0.02, 5, **FREE["unity_aircraft"])
    p, angles = model.params, (0.0, 0.4, 1.1)
    team = bench(model).put((0.0, 0.0, -20.0), angles)
    team.fleet.load[:] = torch.tensor([300.0, -200.0, 100.0, 1e5, -1e5, 1e5], dtype=torch.float64)
    team.step((0.0, 0.0, -1.0), 20)
    force = np.array([300.0 + p.thrust_factor * p.thrust * p.boost_min, -200.0, 100.0])
    assert team.read().nu[0] == pytest.approx([*(force * 2.0 / p.mass), 0, 0, 0], abs=1e-9)
    assert team.euler == pytest.approx(angles, abs=1e-12)


def test_a_load_on_a_vessel_in_the_plane_is_what_its_actuators_would_do(make_model, bench):
    """In waves and a current; what heaves, rolls or pitches does nothing."""
    model = make_model("cybership2", 0.02, 5, actions="surge_sway_yaw")
    p, sea = model.params, Sea.from_config(SeaConfig(hs=0.1, tp=3.0, components=8, realisations=1), seed=2)
    pushed, driven = bench(model, sea), bench(model, sea)
    for team in (pushed, driven):
        team.current[:] = torch.tensor([0.1, -0.2], dtype=torch.float64)
    pushed.fleet.load[:] = torch.tensor([0.8, -0.4, 50.0, 30.0, -30.0, 0.1], dtype=torch.float64)
    driven.step((0.8 / p.surge_force_max, -0.4 / p.sway_force_max, 0.1 / p.yaw_moment_max), 50)
    pushed.step((0.0, 0.0, 0.0), 50)
    assert pushed.state[0, 0].numpy() == pytest.approx(driven.state[0, 0].numpy(), abs=1e-11)


@pytest.mark.parametrize("file", FREE)
def test_a_load_of_zero_is_no_load(file, make_model, bench):
    sea = Sea.from_config(SeaConfig(hs=0.2, tp=4.0, components=8, realisations=1), seed=3)
    model = make_model(file, DT, 1, **FREE[file])
    without, zero = bench(model, sea), bench(model, sea)
    zero.fleet.load[:] = 0.0
    for team in (without, zero):
        team.step(COAST[file], 200)
    assert zero.state[0, 0].numpy() == pytest.approx(without.state[0, 0].numpy(), abs=1e-11)
