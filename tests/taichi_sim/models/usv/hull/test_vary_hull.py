"""Numbers of hulls that differ between environments: each counts, and is what it is in a vehicle file.

One fleet of Otters serves most tests: environment 0 is as the file says, environment k has number k - 1 changed, the
last has all of them changed, each by a factor of its own.
"""

import numpy as np
import pytest
import torch

from taichi_sim.config import AirConfig, SeaConfig
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.models.usv.hull.params import (
    ADDED_MASS,
    AREAS,
    CG,
    CROSS_FLOW,
    DECK_FRICTION,
    GAINS,
    LAG,
    LINEAR,
    MASS,
    QUADRATIC,
)
from taichi_sim.surroundings.sea import Sea

pytestmark = pytest.mark.usefixtures("f64")
STEPS, HELD = 40, 5  # of 0.1 s; steps for which an action is held
ROUNDING = 1e-9  # of m, m/s, rad/s after these steps
HULLS = {
    "otter": {},
    "linear otter": {"restoring": "linear"},
    "wamv": {},
    "barge": {},
}
KEYS = (MASS, *CG, *ADDED_MASS, *LINEAR, *QUADRATIC, CROSS_FLOW, *GAINS, LAG, *AREAS)
INSTEAD_OF_ZERO = {"rigid_body.cg": 0.02, "added_mass": 9.0, "linear": 7.0, "quadratic": 11.0, "windage": 0.8}


def hull(name):
    """A model of `HULLS`, steps of 0.02 s."""
    return load_vehicle(name.split()[-1], 0.02, 5, **HULLS[name])


def changed(model):
    """Every number by its own factor, from 1.01 to 1.2; one that is zero, to something."""
    factors, values = np.linspace(1.01, 1.2, len(model.varying)), {}
    for factor, (key, value) in zip(factors, model.nominal.items(), strict=True):
        instead = next((x for part, x in INSTEAD_OF_ZERO.items() if part in key), 1.0)
        values[key] = factor * (value or instead)
    return values


def run(model, bench, envs=1, vary=None):
    """Final states [env, 13] of the same motion in waves, current and wind."""
    sea = Sea.from_config(SeaConfig(hs=0.2, tp=4.0, components=4, realisations=1), seed=5)
    team = bench(model, sea, air=AirConfig(speed=6.0, direction_deg=200.0), envs=envs)
    team.current[:] = torch.tensor([0.2, -0.3], dtype=torch.float64)
    team.put((3.0, -2.0, 0.0), (0.0, 0.0, 0.7), (0.5, 0.0, 0.0))
    if vary:
        team.fleet.set_numbers(vary)
    rng = np.random.default_rng(4)
    for _ in range(STEPS // HELD):
        team.step(rng.uniform(-1, 1, 2), HELD)
    return team.state[:, 0].numpy().copy()


def other(model, values):
    """The model of a vehicle file that differs in `values`."""
    return type(model)(model.with_numbers(values), model.dt, model.substeps)


@pytest.fixture(scope="module")
def otters(f64, bench):
    """The Otter, and final states [2 + number, 13] of the fleet."""
    model = hull("otter")
    envs, values, vary = len(model.varying) + 2, changed(model), {}
    for k, key in enumerate(model.varying):
        vary[key] = torch.full((envs, 1), model.nominal[key], dtype=torch.float64)
        vary[key][[k + 1, -1]] = values[key]
    return model, run(model, bench, envs, vary)


@pytest.mark.slow
def test_an_environment_is_what_a_vehicle_file_of_its_numbers_is(otters, bench):
    model, states = otters
    assert states[-1] == pytest.approx(run(other(model, changed(model)), bench)[0], abs=ROUNDING)
    assert states[0] == pytest.approx(run(model, bench)[0], abs=ROUNDING)


def test_each_number_does_something(otters):
    model, states = otters
    moved = np.abs(states[1:-1] - states[0]).max(axis=1)
    nothing = [key for key, by in zip(model.varying, moved, strict=True) if by < 1e3 * ROUNDING]
    assert nothing == [DECK_FRICTION], "which counts for what stands on it: test_contact.py"


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name != "otter")) for name in HULLS])
def test_numbers_are_those_of_a_vehicle_file(name):
    """What kernels work with, of one vehicle for every number changed and of one for all, both ways there are."""
    model = hull(name)
    values = changed(model)
    cases = [{key: value} for key, value in values.items()] + [values]
    rows = torch.tensor([list((model.nominal | case).values()) for case in cases], dtype=torch.float64)
    ours = model.numbers(rows).numpy()
    for case, row in zip(cases, ours, strict=True):
        assert row == pytest.approx(np.array(other(model, case).constants), rel=1e-9, abs=1e-9), case


def test_a_hull_without_propellers_varies_without_them(make_model):
    model = make_model("barge", thrusters=None)
    assert not [key for key in model.varying if "thrusters" in key]
    assert model.numbers(torch.tensor([list(model.nominal.values())])).shape == (1, len(model.constants))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["linear otter", "wamv", "barge"])
def test_other_hulls_are_what_a_vehicle_file_of_their_numbers_is(name, bench):
    model = hull(name)
    values = changed(model)
    assert run(model, bench, vary=values) == pytest.approx(run(other(model, values), bench), abs=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize("key", KEYS)
def test_one_number_is_that_of_a_vehicle_file(key, otters, bench):
    model, states = otters
    assert model.varying == (*KEYS, DECK_FRICTION)
    ours = states[1 + KEYS.index(key)]
    assert ours == pytest.approx(run(other(model, {key: changed(model)[key]}), bench)[0], abs=ROUNDING)
