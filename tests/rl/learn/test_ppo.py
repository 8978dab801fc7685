"""Our update against rsl-rl's own: the same rollout, the same order, gradients by autograd there."""

import copy

import pytest
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from rl.learn import ppo
from rl.learn.ppo import LeanPPO, Perceptron, linear
from rl.learn.runner import ppo_config
from rl.missions import load_scenario

ROWS, STEPS, SIZES = 30, 8, {"policy": 7, "truth": 3}
GAUSSIAN = {"class_name": "GaussianDistribution", "init_std": 0.7}


def observations() -> TensorDict:
    return TensorDict({name: torch.randn(ROWS, size) for name, size in SIZES.items()}, batch_size=[ROWS])


def learner(kind: type[PPO], activation: str, hidden: tuple[int, ...], privileged: bool) -> PPO:
    """One that begins, by the paper's settings; equal for the same seed."""
    torch.manual_seed(4)
    stage = load_scenario("paper").stages["usv"]
    settings = {k: v for k, v in ppo_config(stage)["algorithm"].items() if k != "class_name"}
    groups = {"actor": ["policy"], "critic": ["policy", "truth"] if privileged else ["policy"]}
    example = observations()
    actor = MLPModel(example, groups, "actor", 2, hidden, activation, distribution_cfg=copy.deepcopy(GAUSSIAN))
    critic = MLPModel(example, groups, "critic", 1, hidden, activation)
    storage = RolloutStorage("rl", ROWS, STEPS, example, [2], "cpu")
    return kind(actor, critic, storage, **settings)


def rollout(alg: PPO, rewarded: float) -> None:
    """Random observations; rewards for the first action, some endings."""
    with torch.inference_mode():
        for _ in range(STEPS):
            actions = alg.act(observations())
            reward = rewarded * actions[:, 0] + torch.randn(ROWS)
            over = (torch.rand(ROWS) < 0.1).long()
            alg.process_env_step(observations(), reward, over, {"time_outs": over.float()})
        alg.compute_returns(observations())


@pytest.mark.parametrize(
    ("activation", "hidden", "privileged", "piece"),
    [("elu", (16, 16), False, 6144), ("tanh", (16,), True, 7), ("relu", (8, 12, 4), False, 20)],
)
def test_an_update_is_that_of_rsl_rl(activation, hidden, privileged, piece, monkeypatch):
    monkeypatch.setattr(ppo, "PIECE", piece)
    of_all = []
    for kind in (PPO, LeanPPO):
        alg, told = learner(kind, activation, hidden, privileged), []
        for k in range(3):  # the later ones clip: the value's change, the ratio, the gradient
            torch.manual_seed(k)
            rollout(alg, 30.0)
            torch.manual_seed(k)  # rsl-rl draws from its policy in between, too
            told.append(alg.update())
        weights = [p.detach().clone() for p in (*alg.actor.parameters(), *alg.critic.parameters())]
        of_all.append((told, alg.learning_rate, weights))
    theirs, ours = of_all
    assert ours[1] == theirs[1] != 1e-3  # it has adapted, and in the same way
    for a, b in zip(ours[0], theirs[0], strict=True):
        assert a == pytest.approx(b, rel=2e-4, abs=1e-5)
    begin = [p.detach() for p in learner(PPO, activation, hidden, privileged).actor.parameters()]
    moved = max(float((a - b).abs().max()) for a, b in zip(theirs[2], begin, strict=False))
    assert moved > 0.02
    for a, b in zip(ours[2], theirs[2], strict=True):
        assert float((a - b).abs().max()) < 1e-3 * moved


@pytest.mark.parametrize(("rate", "desired", "limit"), [(1.2e-5, 1e-12, 1e-5), (9e-3, 1e9, 1e-2)])
def test_the_learning_rate_stops_where_that_of_rsl_rl_does(rate, desired, limit):
    for kind in (PPO, LeanPPO):
        alg = learner(kind, "elu", (8,), False)
        alg.learning_rate, alg.desired_kl = rate, desired
        rollout(alg, 30.0)
        alg.update()
        assert alg.learning_rate == limit and {group["lr"] for group in alg.optimizer.param_groups} == {limit}


def test_what_it_does_is_sampled_and_judged_by_its_policy():
    alg = learner(LeanPPO, "elu", (16, 16), False)
    seen = observations()
    actions = alg.act(seen)
    alg.actor(seen, stochastic_output=True)
    noted = alg.transition
    assert noted.actions_log_prob is not None and noted.values is not None
    assert torch.allclose(noted.actions_log_prob, alg.actor.get_output_log_prob(actions), atol=1e-5)
    assert torch.allclose(noted.values, alg.critic(seen), atol=1e-6)
    spread = torch.stack([alg.act(seen) for _ in range(400)]).std(0)
    assert float(spread.mean()) == pytest.approx(0.7, rel=0.01)


def test_products_are_float32(monkeypatch):
    x, w, b = torch.randn(300, 50), torch.randn(20, 50), torch.randn(20)
    exact = (x.double() @ w.double().t() + b.double()).float()
    assert torch.allclose(linear(x, w, b), exact, atol=2e-5)
    monkeypatch.setattr("rl.learn.ppo._ONEDNN", None)  # as on a GPU
    assert torch.allclose(linear(x, w, b), exact, atol=2e-5)


def test_networks_without_passes_are_refused():
    example = observations()
    model = MLPModel(example, {"actor": ["policy"]}, "actor", 2, (8,), "selu")
    with pytest.raises(TypeError, match="allowed are linear layers with ELU, ReLU or tanh between"):
        Perceptron(model)
