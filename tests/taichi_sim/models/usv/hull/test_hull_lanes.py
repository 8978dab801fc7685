"""Hulls' sums in vectors of several components (kernels/lanes.py): the last vector need not be full."""

import numpy as np
import pytest
import torch

from taichi_sim.bench import calm_sea
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, POSITION, VELOCITY
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.spectrum import Components


@pytest.mark.slow
def test_components_without_amplitude_change_nothing(constant_model, bench):
    """Load of the water, and motion, in 20 waves, and in the same with 12 that are nothing, which fill the vectors."""
    rng, model = np.random.default_rng(1), constant_model("otter", 0.02, 2)
    k = rng.uniform(0.1, 4.0, (3, 32))
    size = np.where(np.arange(32) < 20, 0.01, 0.0) * np.ones_like(k)
    all_waves = (size, k, np.sqrt(GRAVITY * k), *rng.uniform(-np.pi, np.pi, (2, 3, 32)))
    found = []
    for count in (20, 32):
        team = bench(model, Sea(Components(*(values[:, :count].copy() for values in all_waves))), envs=3)
        team.put()
        load = model.pressure_load(team.state, team.around)
        for _ in range(5):
            team.step(torch.zeros_like(team.fleet.action))
        found.append((load, team.state.clone()))
    (load, state), (full_load, full_state) = found
    assert (load - full_load).abs().max() < 1e-5 * model.params.weight
    assert (state - full_state).abs().max() < 1e-5
    assert load.std(dim=0).abs().max() > 0.01 * model.params.weight  # there are waves


@pytest.mark.slow
def test_a_straight_run_in_calm_water_is_straight_to_the_last_bit(constant_model, bench):
    """What fills up the last lanes makes no wave: its side force, however small, an unstable course would multiply."""
    team = bench(constant_model("otter", 0.02, 5, restoring="linear"), calm_sea(), envs=2)
    team.put()
    ahead = torch.zeros_like(team.fleet.action)
    ahead[..., 0] = 0.8
    for _ in range(100):  # 10 s
        team.step(ahead)
    state = team.state[:, 0]
    aside = (POSITION.start + 1, VELOCITY.start + 1, ANGULAR_VELOCITY.start, ANGULAR_VELOCITY.start + 2)
    flushed = torch.finfo(state.dtype).tiny  # a thread may take what is below the least normal number for zero, or not
    assert state[:, VELOCITY.start].min() > 1.0 and (state[:, aside].abs() < flushed).all()


@pytest.mark.slow
def test_a_ship_whose_numbers_vary_follows_propeller_and_rudder_as_one_of_the_file(make_model, bench):
    """Rates of change are vectors of numbers then, and negated."""
    model, found = make_model("kvlcc2_6dof", 0.05, 2, hydrodynamics={"radiation": "constant"}), []
    for numbers in ({}, {"rigid_body.mass": model.nominal["rigid_body.mass"]}):
        team = bench(model, calm_sea()).put(velocity_b=(1.0, 0.0, 0.0))
        if numbers:
            team.fleet.set_numbers(numbers)
        found.append(team.step((0.7, 0.5), 4).state.clone())
    assert (found[0] - found[1]).abs().max() < 1e-5
