"""Right-hand sides of the seed paper's boat and aircraft and of the vessel in the plane, against short steps."""

import numpy as np
import pytest
import torch

from taichi_sim.bench import pack_state

pytestmark = pytest.mark.usefixtures("f64")
DT, ENVS = 1e-8, 12  # s; rates are then exact to some 1e-8 of rounding and 1e-5 of the aircraft's acceleration
CHANGES = {
    "unity_boat": {},
    "unity_aircraft": {"roll_rule": "script", "max_pitch_deg": 60.0},
    "cybership2": {"actions": "surge_sway_yaw"},
}


def _states(file, rng):
    """States [env, 13] as the model can have them."""
    eta, nu = rng.uniform(-1, 1, (ENVS, 6)), rng.uniform(-1, 1, (ENVS, 6))
    if file == "cybership2":
        eta[:, 2:5], nu[:, 2:5] = 0.0, 0.0
    if file == "unity_boat":
        eta[:, 2:5] *= 0.3
    return pack_state(eta, nu)


def _controls(model, rng):
    """Random controls [env, control], and the actions that hold them."""
    action = rng.uniform(0.1, 1.0, (ENVS, len(model.action_names)))
    p = model.params
    if model.control_names == ("X", "Y", "N"):
        return action * (p.surge_force_max, p.sway_force_max, p.yaw_moment_max), action
    if model.medium == "water":
        return np.stack((0.5 * (action[:, 0] + 1), action[:, 1]), 1), action
    boost = rng.uniform(p.boost_min, p.boost_max, ENVS)
    action[:, 2] = [model.boost_action(b) for b in boost]
    return np.stack((action[:, 1], action[:, 0], action[:, 1], boost), 1), action


@pytest.mark.parametrize("file", CHANGES)
def test_short_steps_tend_to_the_right_hand_side(file, make_model, bench):
    """In a current, under loads from outside; a step's error is of the order of dt."""
    rng = np.random.default_rng(6)
    model = make_model(file, DT, 1, **CHANGES[file])
    team, (controls, action) = bench(model, envs=ENVS), _controls(model, rng)
    load, current = rng.uniform(-20, 20, (ENVS, 6)), rng.uniform(-1, 1, (ENVS, 2))
    team.current[:], team.fleet.load[:, 0] = torch.from_numpy(current), torch.from_numpy(load)
    team.state[:, 0] = torch.from_numpy(_states(file, rng))
    model.reset_aux(team.aux, team.state, team.around)
    if model.medium == "air":
        team.aux[:, 0, :3] = torch.from_numpy(controls[:, :3])
        team.step(action[:, None])  # the rates of its attitude are now those of the increments
    before = team.state[:, 0].numpy().copy()
    after = team.step(action[:, None]).state[:, 0].numpy()
    expected = model.rhs(before, controls, current, load=load)
    scale = np.abs(expected).max(axis=0)
    assert (np.abs((after - before) / DT - expected) <= 2e-5 * scale + 2e-7).all()
    assert scale[[0, 1, 6, 7, 8, 12]].min() > 0.0


def test_a_clamped_angle_does_not_turn_further(make_model):
    model = make_model("unity_aircraft", DT, 1, **CHANGES["unity_aircraft"])
    state = pack_state([0.0, 0.0, 0.0, 0.0, np.deg2rad(60.0) + 1e-9, 0.0])
    up, down = (model.rhs(state, [0.0, increment, 0.0, 0.1])[0, 3:7] for increment in (1.0, -1.0))
    assert not up.any() and down.any()
