"""`hull_6dof` where nothing should be: one broken vehicle harms no other, and threads change no bit."""

import pytest
import torch

from taichi_sim.config.io import load_world
from taichi_sim.kernels import runtime
from taichi_sim.surroundings.sea import Sea

ENVS, COUNT, STEPS = 6, 2, 25
# (north, east, down, roll quaternion x, u): upside down, in the air, under water, very fast, pitched up
EXTREMES = {
    "capsized": {"quaternion": (0.0, 1.0, 0.0, 0.0)},
    "flying": {"down": -100.0},
    "diving": {"down": 50.0},
    "fast": {"u": 100.0},
    "upright on its stern": {"quaternion": (0.5**0.5, 0.0, 0.5**0.5, 0.0)},
    "far away": {"north": 5000.0},
}


@pytest.fixture(scope="module")
def run(make_model, bench):
    """State, aux, surface and derived after some steps in the shipped sea; `spoil` changes the start."""
    models = {}

    def start(threads=1, spoil=None):
        runtime.init(precision="f32", threads=threads)
        if threads not in models:
            models.clear()
            models[threads] = make_model("otter"), Sea.from_config(load_world("paper").sea, seed=1)
        model, sea = models[threads]
        team = bench(model, sea, envs=ENVS, count=COUNT)
        team.state[..., 0] = 30.0 * torch.arange(COUNT)
        team.state[..., 7] = 1.0
        if spoil:
            spoil(team.state)
        action = torch.linspace(-0.5, 0.8, ENVS * COUNT * 2).reshape(ENVS, COUNT, 2)
        team.step(action, STEPS)
        return [t.clone() for t in (team.state, team.aux, team.surface, team.fleet.derived)]

    return start


def same_but(first, second, env, vehicle):
    """Whether all bits agree but those of one vehicle."""
    keep = torch.ones((ENVS, COUNT), dtype=torch.bool)
    keep[env, vehicle] = False
    return all(torch.equal(a[keep], b[keep]) for a, b in zip(first, second, strict=True))


@pytest.mark.slow
def test_a_vehicle_of_nan_changes_no_bit_of_the_others(run):
    def spoil(state):
        state[2, 1] = torch.nan

    clean, broken = run(), run(spoil=spoil)
    assert torch.isfinite(torch.cat([t.flatten() for t in clean])).all()
    assert torch.isnan(broken[0][2, 1]).all()
    assert same_but(clean, broken, 2, 1)


@pytest.mark.slow
@pytest.mark.parametrize("case", EXTREMES)
def test_extreme_places_and_speeds_harm_nobody_else(case, run):
    """Half a second later all but the fastest are finite, too: water and air have no edge."""
    change = EXTREMES[case]

    def spoil(state):
        state[3, 0, 0] += change.get("north", 0.0)
        state[3, 0, 2] = change.get("down", 0.0)
        state[3, 0, 3:7] = torch.tensor(change.get("quaternion", (1.0, 0.0, 0.0, 0.0)))
        state[3, 0, 7] = change.get("u", 1.0)

    clean, extreme = run(), run(spoil=spoil)
    assert same_but(clean, extreme, 3, 0)
    assert case == "fast" or torch.isfinite(extreme[0][3, 0]).all()
    if case == "flying":
        assert float(extreme[3][3, 0, 11]) > 0.5  # m/s: it falls
    if case == "diving":
        assert float(extreme[3][3, 0, 11]) < -0.5  # and floats up


@pytest.mark.slow
def test_two_threads_make_the_same_bits_as_one(run):
    one = run(threads=1)
    again = run(threads=1)
    two = run(threads=2)
    assert all(torch.equal(a, b) for a, b in zip(one, again, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
