"""Autoregressive forecasts: of signals that follow such a model exactly, and of those that nothing foretells."""

import math

import pytest
import torch

from rl.guidance.forecast import Autoregression

STEP = 0.2  # s


def test_two_sines_are_foretold_once_they_are_learnt():
    # A sum of two sines follows x[k] = 2 (c1 + c2) x[k-1] - (2 + 4 c1 c2) x[k-2] + ..., an exact model of order 4.
    t = STEP * torch.arange(400, dtype=torch.float64)
    x = torch.stack((torch.sin(0.9 * t) + 0.4 * torch.sin(1.7 * t + 1.0), torch.cos(0.6 * t)))
    model = Autoregression(x[:, 0], 4, forgetting=1.0, prior=1e8)
    for sample in x[:, :350].T:
        model.learn(sample)
    ahead = model.predict(40)
    assert torch.allclose(ahead, x[:, 350:390], atol=0.02)


def test_coefficients_of_a_noisy_model_are_found():
    generator = torch.Generator().manual_seed(3)
    e = torch.randn((64, 3000), generator=generator, dtype=torch.float64)
    x = torch.zeros_like(e)
    for k in range(2, x.shape[1]):
        x[:, k] = 1.6 * x[:, k - 1] - 0.8 * x[:, k - 2] + e[:, k]
    model = Autoregression(x[:, 0], 2, forgetting=1.0)
    for sample in x.T:
        model.learn(sample)
    spread = math.sqrt((1 - 0.8**2) / x.shape[1])  # of each coefficient (Box & Jenkins 1976, sec. 7.2)
    error = (model.coefficients - torch.tensor([1.6, -0.8], dtype=torch.float64)).square().mean(0).sqrt()
    assert (error < 1.3 * spread).all()


def test_only_rows_that_are_due_learn_and_begin_anew():
    model = Autoregression(torch.zeros(2, 1), 2)
    for k in range(8):
        model.learn(torch.full((2, 1), float(k)), torch.tensor([[True], [k % 2 == 0]]))
    assert model.count.flatten().tolist() == [8, 4] and model.ready.flatten().tolist() == [True, False]
    assert model.past[1, 0].tolist() == [6.0, 4.0]
    model.begin(torch.tensor([0]))
    assert model.count.flatten().tolist() == [0, 4] and not model.coefficients[0].any()


def test_an_order_below_one_is_refused():
    with pytest.raises(ValueError, match="order = 0: must be at least 1"):
        Autoregression(torch.zeros(1), 0)


def test_no_forecast_is_beyond_three_times_the_rms():
    model = Autoregression(torch.zeros(1, dtype=torch.float64), 2)
    for k in range(20):
        model.learn(torch.tensor([1.3**k], dtype=torch.float64))  # a model that grows without bound is learnt
    rms = sum(1.3 ** (2 * k) for k in range(20)) ** 0.5 / 20**0.5
    assert float(model.predict(50).abs().max()) == pytest.approx(3 * rms)
