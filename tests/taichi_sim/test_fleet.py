"""Numbers and loads of single vehicles: who gets them, when, and what is refused."""

import math

import pytest
import torch

from taichi_sim.bench import Bench
from taichi_sim.config import ConfigError

pytestmark = pytest.mark.usefixtures("f64")
FAST = (0.0, 0.0, 1.0)


@pytest.fixture
def bench():
    return Bench("unity_aircraft", envs=3, count=2, substeps=5)


def speeds(bench):
    """[env, vehicle] after a step, m/s."""
    return bench.put().step(FAST).state[..., 7].clone()


def test_numbers_are_those_of_the_vehicles_that_were_given_them_until_given_others(bench):
    alike = speeds(bench)
    bench.fleet.set_numbers({"mass": 250.0}, torch.tensor([2, 0]))
    halved = speeds(bench)
    assert halved[[0, 2]].numpy() == pytest.approx(2 * alike[[0, 2]].numpy())
    assert halved[1].numpy() == pytest.approx(alike[1].numpy())
    bench.fleet.set_numbers({"thrust": torch.tensor([[1e5, 2e5]])}, torch.tensor([0]))  # of each vehicle
    assert speeds(bench)[0].numpy() == pytest.approx((halved[0] * torch.tensor([1, 2])).numpy())
    assert bench.fleet.vary["mass"].tolist() == [[250, 250], [500, 500], [250, 250]]
    bench.fleet.set_numbers(bench.model.nominal)
    assert speeds(bench).numpy() == pytest.approx(alike.numpy())


def test_vary_is_what_there_is_and_not_to_be_written_to(bench):
    assert {key: value.unique().item() for key, value in bench.fleet.vary.items()} == bench.model.nominal
    assert not bench.fleet.varied
    bench.fleet.vary["mass"].zero_()
    bench.fleet.set_numbers({"drag": 4.0})
    bench.fleet.vary["mass"].zero_()
    assert bench.fleet.varied and bool((bench.fleet.vary["mass"] == 500.0).all())


@pytest.mark.parametrize(
    ("values", "error", "message"),
    [
        ({"mas": 1.0}, ConfigError, "UnityAircraft: 'mas' cannot vary, did you mean 'mass'.; allowed are mass, thrust"),
        ({"length": 1.0}, ConfigError, "'length' cannot vary"),
        ({"mass": math.nan}, ValueError, "fleet: mass = nan: must be finite"),
        ({"mass": torch.ones(3)}, ValueError, "has shape"),
    ],
)
def test_numbers_that_cannot_be_are_refused(values, error, message, bench):
    with pytest.raises(error, match=message):
        bench.fleet.set_numbers({"drag": 1.0} | values)
    assert bool((bench.fleet.vary["drag"] == 5.0).all())


def test_a_load_is_none_until_it_is_asked_for_and_acts_on_its_vehicle_alone(bench):
    before = speeds(bench)
    assert not bench.fleet.loaded
    bench.fleet.load[1, 0, 0] = 1e5
    assert bench.fleet.loaded
    faster = speeds(bench) - before
    assert faster[1, 0] > 1.0 and faster.sum().item() == pytest.approx(faster[1, 0].item(), abs=1e-9)
    bench.fleet.load.zero_()  # in place: what is launched reads it
    assert speeds(bench).numpy() == pytest.approx(before.numpy())
