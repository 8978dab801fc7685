"""Fixed-wing aircraft whose numbers differ from environment to environment, and loads on them from outside."""

import numpy as np
import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig
from taichi_sim.kernels.conventions import ANGULAR_VELOCITY, GRAVITY, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.models.uav.fixed_wing.params import VARYING

pytestmark = pytest.mark.usefixtures("f64")
DT, SUBSTEPS, STEPS = 0.02, 5, 40
GUST = {"amplitude": (1.0, 2.0, -3.0), "start_time": 1.0, "rise_time": 0.5}
AIR = AirConfig.model_validate({"speed": 8.0, "direction_deg": 200.0, "profile": "log", "gust": GUST})
LOAD = (2.0, -3.0, 5.0, 0.3, 0.4, -0.2)  # N, N m
RUDDER = {f"lateral.{name}_delta_r" for name in ("C_Y", "C_ell", "C_n")}
OTHER_AIRCRAFT = pytest.param("zagi", marks=pytest.mark.slow)


@pytest.fixture(scope="module")
def nominal(f64, make_model):
    """A shipped aircraft, flown by its autopilot: nominal(name)."""
    return lambda name: make_model(name, DT, SUBSTEPS)


def others(model):
    """Another value for every number that varies: by factors from 1.005 up, and a small one where there is none."""
    factors = 1 + 0.005 * np.arange(1, len(VARYING) + 1)
    return {key: value * x or 0.01 * x for x, (key, value) in zip(factors, model.nominal.items(), strict=True)}


def fly(model, values=None, load=LOAD, envs=1):
    """Turns and climbs of four seconds through a gust, from cruise, under `load`; varied where there are `values`."""
    team = Bench(model, air=AIR, envs=envs).put((0.0, 0.0, -60.0), settle=True)
    if values is not None:
        team.fleet.set_numbers(values)
    if load is not None:
        team.fleet.load[:] = torch.tensor(load)
    for k in range(STEPS):
        team.step([0.4 * np.sin(0.5 * k), 0.8 * np.cos(0.3 * k), 0.5 * np.sin(0.2 * k)])
    return team


def assert_like_a_file_of_its_own(model, values):
    """An aircraft with varied numbers flies as one whose file has them, by the same autopilot; to rounding."""
    own = FixedWing6DOF(model.with_numbers(values), DT, SUBSTEPS, design=model.params)
    ours, theirs = fly(model, values), fly(own)
    assert torch.allclose(ours.state, theirs.state, rtol=0, atol=1e-9)
    assert torch.allclose(ours.aux, theirs.aux, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["aerosonde", OTHER_AIRCRAFT])
def test_varied_numbers_are_those_of_a_file(name, nominal):
    assert_like_a_file_of_its_own(nominal(name), others(nominal(name)))


@pytest.mark.slow
@pytest.mark.parametrize("key", VARYING)
@pytest.mark.parametrize("name", ["aerosonde", "zagi"])
def test_each_varied_number_is_that_of_a_file(name, key, nominal):
    assert_like_a_file_of_its_own(nominal(name), {key: others(nominal(name))[key]})


@pytest.mark.parametrize("name", ["aerosonde", OTHER_AIRCRAFT])
def test_every_number_does_something(name, nominal):
    """Environment k + 1 has number k alone changed; a flying wing has no use for those of a rudder."""
    model, envs = nominal(name), len(VARYING) + 1
    values = {key: torch.full((envs, 1), value, dtype=torch.float64) for key, value in model.nominal.items()}
    for k, (key, value) in enumerate(others(model).items(), 1):
        values[key][k] = value
    state = fly(model, values, envs=envs).state[:, 0]
    moved = (state[1:] - state[0]).abs().amax(dim=1)
    idle = set() if name == "aerosonde" else RUDDER
    assert {key for key, far in zip(VARYING, moved.tolist(), strict=True) if far > 1e-6} == set(VARYING) - idle
    assert all(far == 0 for key, far in zip(VARYING, moved.tolist(), strict=True) if key in idle)


# -- loads from outside ------------------------------------------------------------------------------------------


def test_no_load_is_a_load_of_zero(nominal):
    """In another kernel, so to rounding."""
    model = nominal("aerosonde")
    without, zero = fly(model, {}, load=None), fly(model, {}, load=(0.0,) * 6)
    assert torch.allclose(without.state, zero.state, rtol=0, atol=1e-11)
    assert not torch.allclose(without.state, fly(model, {}).state, rtol=0, atol=0.1)


def test_momentum_and_energy_in_a_vacuum_are_those_of_the_load(nominal):
    """No air: what a load, held in b, adds to the momentum (with gravity), to the angular momentum and to the energy of
    a tumbling aircraft is its impulse, its moment's impulse and its work; by Simpson's rule, to 1e-5 of them.
    """
    model, team = nominal("aerosonde"), Bench(nominal("aerosonde"), air=AIR)
    team.put((0.0, 0.0, -500.0), (0.3, -0.4, 1.0), (20.0, 3.0, -4.0), (0.5, -0.6, 0.4))
    team.fleet.set_numbers({"physical.rho": 1e-30})
    team.fleet.load[:] = torch.tensor(LOAD)
    body, (force, moment) = model.params.physical, np.split(np.array(LOAD), 2)
    J = np.array([[body.Jx, 0, -body.Jxz], [0, body.Jy, 0], [-body.Jxz, 0, body.Jz]])
    held, given = [], []
    for _ in range(STEPS + 1):
        state = team.state[0, 0]
        R, v, omega = (
            torch_rotation_matrix(state[3:7]).numpy(),
            state[VELOCITY].numpy(),
            state[ANGULAR_VELOCITY].numpy(),
        )
        energy = 0.5 * body.mass * v @ v + 0.5 * omega @ J @ omega - body.mass * GRAVITY * float(state[2])
        held.append(np.concatenate((body.mass * R @ v, R @ J @ omega, [energy])))
        weight = [0.0, 0.0, body.mass * GRAVITY]
        given.append(np.concatenate((R @ force + weight, R @ moment, [force @ v + moment @ omega])))
        team.step((0.0, 0.0, 0.0))
    given, h = np.array(given), DT * SUBSTEPS
    total = h / 3 * (given[0] + given[-1] + 4 * given[1:-1:2].sum(axis=0) + 2 * given[2:-1:2].sum(axis=0))
    gained = held[-1] - held[0]
    for part in (slice(0, 3), slice(3, 6), slice(6, 7)):
        assert np.abs(gained[part] - total[part]).max() < 1e-5 * np.abs(total[part]).max()
    assert np.abs(total).min() > 0.1
