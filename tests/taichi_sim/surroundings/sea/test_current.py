"""The current: mean, profile, and the law of its random part."""

import math

import numpy as np
import pytest
import torch

from taichi_sim.config import ConfigError, CurrentConfig
from taichi_sim.surroundings.sea import Current

pytestmark = pytest.mark.usefixtures("f64")
ENVS = 20_000
STD, T = 0.2, 50.0  # m/s, s
RANDOM = CurrentConfig(speed=0.5, direction_deg=120.0, std=STD, time_constant=T)
MEAN = 0.5 * np.array([math.cos(math.radians(120)), math.sin(math.radians(120))])
SIGMAS = 4.0  # allowed distance from a closed form, in standard errors


def _snapshot(current):
    return current.velocity.clone().numpy() - MEAN


def test_no_current_is_still_water_and_stays_so():
    current = Current(None, 5, seed=1)
    current.advance(10.0)
    current.reset(torch.tensor([1, 2]))
    assert current.velocity.shape == (5, 2)
    assert not current.velocity.any()


def test_a_steady_current_flows_towards_its_direction():
    current = Current(CurrentConfig(speed=0.5, direction_deg=120.0), 3, seed=1)
    before = current.velocity.clone()
    current.advance(1.0)
    assert np.allclose(before, MEAN) and torch.equal(before, current.velocity)


def test_random_part_is_stationary_with_its_deviation_and_autocorrelation():
    """Standard deviation sigma, correlation exp(-t / T), components and environments independent."""
    current = Current(RANDOM, ENVS, seed=3)
    first = _snapshot(current)
    for _ in range(10):
        current.advance(2.0)
    last = _snapshot(current)
    error = SIGMAS / math.sqrt(2 * ENVS)
    for x in (first, last):
        assert x.mean(axis=0) / STD == pytest.approx([0, 0], abs=SIGMAS / math.sqrt(ENVS))
        assert x.std() == pytest.approx(STD, rel=error)
        assert np.corrcoef(x.T)[0, 1] == pytest.approx(0, abs=SIGMAS / math.sqrt(ENVS))
    assert (first * last).mean() / STD**2 == pytest.approx(math.exp(-20.0 / T), abs=2 * error)


@pytest.mark.parametrize("steps", [1, 2, 50])
def test_the_step_is_exact(steps):
    """However 50 s are cut, v - e^-1 v0 is normal noise of deviation sigma sqrt(1 - e^-2)."""
    current = Current(RANDOM, ENVS, seed=4)
    first = _snapshot(current)
    for _ in range(steps):
        current.advance(T / steps)
    noise = _snapshot(current) - math.exp(-1) * first
    error = SIGMAS / math.sqrt(2 * ENVS)
    assert noise.std() == pytest.approx(STD * math.sqrt(1 - math.exp(-2)), rel=error)
    assert np.corrcoef(noise.reshape(-1), first.reshape(-1))[0, 1] == pytest.approx(0, abs=error)
    assert (noise**4).mean() / noise.var() ** 2 == pytest.approx(3.0, abs=0.15)


def test_reset_draws_anew_and_leaves_the_others():
    current = Current(RANDOM, ENVS, seed=5)
    memory, before = current.velocity.data_ptr(), current.velocity.clone()
    envs = torch.arange(0, ENVS, 2)
    current.reset(envs)
    assert torch.equal(current.velocity[1::2], before[1::2])
    drawn, old = _snapshot(current)[::2], before.numpy()[::2] - MEAN
    assert drawn.std() == pytest.approx(STD, rel=SIGMAS / math.sqrt(ENVS))
    assert (drawn * old).mean() / STD**2 == pytest.approx(0, abs=SIGMAS / math.sqrt(ENVS))
    current.advance(1.0)
    assert current.velocity.data_ptr() == memory and current.velocity.is_contiguous()


def test_same_seed_same_bits_whatever_the_threads():
    def run(seed, threads):
        torch.set_num_threads(threads)
        current = Current(RANDOM, ENVS, seed)
        current.advance(0.1)
        current.reset(torch.tensor([3, 1]))
        return current.velocity

    threads = torch.get_num_threads()
    try:
        assert torch.equal(run(7, 1), run(7, 2))
        assert not torch.equal(run(7, 1), run(8, 1))
    finally:
        torch.set_num_threads(threads)


@pytest.mark.parametrize("draft", [0.01, 1.0, 7.5, 10.0])
def test_mean_factor_is_the_mean_of_the_profile(draft):
    """Gauss-Legendre mean of (1 - d / 10)^(1/7) over the draft."""
    node, weight = np.polynomial.legendre.leggauss(200)
    depths = draft * (node + 1) / 2
    mean = (weight * (1 - depths / 10.0) ** (1 / 7)).sum() / 2
    power = Current(CurrentConfig(speed=1.0, profile="power"), 1, seed=1, depth=10.0)
    assert power.mean_factor(draft) == pytest.approx(mean, rel=1e-5)
    assert power.mean_factor(0.0) == 1.0
    assert Current(CurrentConfig(speed=1.0), 1, seed=1, depth=10.0).mean_factor(draft) == 1.0


def test_a_power_profile_needs_water_to_float_in():
    power = CurrentConfig(speed=1.0, profile="power")
    with pytest.raises(ConfigError, match=r"sea\.depth"):
        Current(power, 1, seed=1)
    with pytest.raises(ConfigError, match=r"draft of 3 m.*sea\.depth = 2 m"):
        Current(power, 1, seed=1, depth=2.0).mean_factor(3.0)
