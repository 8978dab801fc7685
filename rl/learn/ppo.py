"""rsl-rl's PPO with the same mathematics in fewer and faster operations (test_ppo.py compares the two).

The differences:

- The gradient is written out instead of traced (`Perceptron`). Batches have features first, [feature, sample]. The long
  dimension is then innermost in all three products of a layer (output, gradient of the weights, gradient of the input),
  which is the fastest order.
- A rollout is shuffled once, not once an epoch: rsl-rl uses one order for all epochs.
- A mini-batch is processed in pieces that stay in a core's cache.
- All gradients and the divergence lie in one tensor, so that clipping, and sharing them with other processes, is one
  operation each.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn import functional

from rl.runs import ranks

SLOWER, FASTER, STEP = 1e-5, 1e-2, 1.5  # rsl-rl's limits of an adaptive learning rate, and its factor
PIECE = 6144  # samples at a time: more leave the cache, fewer cost overhead
LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)
_WIDE = torch.backends.cpu.get_cpu_capability() == "AVX512" and torch.backends.mkldnn.is_available()
_ONEDNN = getattr(torch.ops.mkldnn, "_linear_pointwise", None) if _WIDE else None

_Backward = Callable[[Tensor, Tensor], object]
ACTIVATIONS: dict[type[nn.Module], tuple[Callable[[Tensor], Tensor], _Backward]] = {
    nn.ELU: (
        # torch's elu_ takes twice the time
        lambda x: torch.maximum(x, x.clamp(max=0.0).exp_().sub_(1.0), out=x),
        lambda grad, y: torch.ops.aten.elu_backward.grad_input(grad, 1.0, 1.0, 1.0, True, y, grad_input=grad),
    ),
    nn.ReLU: (
        functional.relu_,
        lambda grad, y: torch.ops.aten.threshold_backward.grad_input(grad, y, 0.0, grad_input=grad),
    ),
    nn.Tanh: (torch.tanh_, lambda grad, y: torch.ops.aten.tanh_backward.grad_input(grad, y, grad_input=grad)),
}
"""By module: the function in place, and the gradient [.] of its input, in the place of that of its output, for its
output y."""


def linear(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """x [n, in] times weight [out, in] transposed, plus bias: [n, out].

    On CPUs with AVX-512 it uses oneDNN. MKL, torch's default, uses half the vector width on AMD's: 100 instead of 220
    Gflop/s on one core. On an EPYC with AVX2, MKL is faster, 65 to 55. The precision is float32 in both.
    """
    if _ONEDNN is not None and x.device.type == "cpu":
        return _ONEDNN(x, weight, bias, "none", [], "")
    return functional.linear(x, weight, bias)


def product(a: Tensor, b: Tensor) -> Tensor:
    """a [n, k] times b [k, m]: [n, m]."""
    return linear(a, b.t())


def gradient(weights: Tensor) -> Tensor:
    """The tensor that accumulates the gradient of `weights`."""
    assert weights.grad is not None, "gradients are zeroed, not forgotten"
    return weights.grad


class Perceptron:
    """Forward and backward passes of an MLP; weights and gradients stay in rsl-rl's model."""

    def __init__(self, model: MLPModel):
        """Take the layers of `model`."""
        layers = list(model.mlp)
        self.layers = [layer for layer in layers[::2] if isinstance(layer, nn.Linear)]
        between = {type(layer) for layer in layers[1::2]}
        plain = len(layers) % 2 == 1 and len(self.layers) == len(layers[::2])
        if not plain or len(between) > 1 or not between <= ACTIVATIONS.keys() or model.obs_normalization:
            raise TypeError(f"no passes for {model}: allowed are linear layers with ELU, ReLU or tanh between")
        self._activate, self._backward = ACTIVATIONS[between.pop()] if between else (lambda x: x, lambda grad, y: None)
        self._inputs: list[Tensor] = []

    @torch.no_grad()
    def rows(self, x: Tensor) -> Tensor:
        """Outputs [sample, out] for x [sample, in]; nothing is stored for a backward pass."""
        for layer in self.layers[:-1]:
            x = self._activate(linear(x, layer.weight, layer.bias))
        return linear(x, self.layers[-1].weight, self.layers[-1].bias)

    @torch.no_grad()
    def forward(self, x: Tensor) -> Tensor:
        """Outputs [out, sample] for x [in, sample], stored for the backward pass."""
        self._inputs = []
        for layer in self.layers:
            if self._inputs:
                self._activate(x)
            self._inputs.append(x)
            x = product(layer.weight, x).add_(layer.bias.unsqueeze(1))
        return x

    @torch.no_grad()
    def backward(self, grad: Tensor) -> None:
        """Accumulate gradients of all weights, for `grad` [out, sample] of the last forward pass's outputs."""
        for layer, x in zip(reversed(self.layers), reversed(self._inputs), strict=True):
            gradient(layer.weight).add_(product(grad, x.t()))
            gradient(layer.bias).add_(grad.sum(1))
            if layer is not self.layers[0]:
                grad = product(layer.weight.t(), grad)
                self._backward(grad, x)
        self._inputs = []


class Piece(NamedTuple):
    """A part of a mini-batch, [feature, sample] or [sample]."""

    actor_input: Tensor
    critic_input: Tensor
    actions: Tensor
    mean: Tensor  # of the policy that acted
    log_prob: Tensor  # of the actions under that policy
    values: Tensor  # of the critic at that time
    returns: Tensor
    advantages: Tensor


class RecurrentPPO(PPO):
    """rsl-rl's own update, for actors with a memory: stretches between two beginnings pass through it as a whole."""

    def reduce_parameters(self) -> None:
        """Average the gradients of all processes."""
        gradients = [p.grad for part in (self.actor, self.critic) for p in part.parameters() if p.grad is not None]
        whole = torch.cat([of.flatten() for of in gradients])
        ranks.average_(whole)
        for of, mean in zip(gradients, whole.split([of.numel() for of in gradients]), strict=True):
            of.copy_(mean.view_as(of))


class LeanPPO(PPO):
    """PPO (Schulman et al. 2017, arXiv:1707.06347) as rl.learn.runner.ppo_config configures it.

    The policy is Gaussian with deviations that do not depend on the state; the value loss is clipped and the learning
    rate adapts. With several processes, every update uses the mean gradient, and the mean divergence adapts the
    learning rate.
    """

    def __init__(self, *args, **options):
        """Take rsl-rl's arguments."""
        super().__init__(*args, **options)
        self._actor, self._critic = Perceptron(self.actor), Perceptron(self.critic)
        policy = self.actor.distribution
        if type(policy) is not GaussianDistribution or policy.std_type != "scalar":
            raise TypeError(f"no update for {policy}: only a Gaussian whose deviations are weights is allowed")
        self._policy, self._std_param = policy, policy.get_parameter("std_param")
        owned = [list(self.actor.parameters()), list(self.critic.parameters())]
        sizes = [sum(p.numel() for p in part) for part in owned]
        self._shared = torch.zeros(sum(sizes) + 1, device=self.device)  # gradients, and the divergence
        self._gradients = self._shared[:-1].split(sizes)
        begin = 0
        for p in [*owned[0], *owned[1]]:
            p.grad = self._shared[begin : begin + p.numel()].view_as(p)
            begin += p.numel()
        self._by_std = gradient(self._std_param)

    @torch.no_grad()
    def act(self, obs: TensorDict) -> Tensor:
        """Sample actions [row, action] and store what the update needs."""
        now = self.transition
        mean = self._actor.rows(self.actor.get_latent(obs))
        self._policy.update(mean)
        std = self._policy.std
        noise = torch.randn_like(mean)
        now.hidden_states = (None, None)
        actions = torch.addcmul(mean, std, noise)
        now.actions = actions
        now.values = self._critic.rows(self.critic.get_latent(obs))
        now.actions_log_prob = noise.square_().sum(-1).mul_(-0.5).sub_(self._log_scale(std[0]))
        now.distribution_params = (mean, std)
        now.observations = obs
        return actions

    @staticmethod
    def _log_scale(std: Tensor) -> Tensor:
        """Logarithm of a Gaussian's normalising constant for deviations [action]."""
        return std.log().sum() + len(std) * LOG_SQRT_2PI

    @torch.no_grad()
    def update(self) -> dict[str, float]:
        """Update the networks from the rollout; return mean losses."""
        batches, old_std = self._ordered()
        losses = torch.zeros(3, device=self.device)
        for _ in range(self.num_learning_epochs):
            for batch in batches:
                losses += self._learn(batch, old_std)
        self.storage.clear()
        mean = (losses / (self.num_learning_epochs * len(batches))).tolist()
        return dict(zip(("value", "surrogate", "entropy"), mean, strict=True))

    def _ordered(self) -> tuple[list[list[Piece]], Tensor]:
        """The rollout's mini-batches in random order, and the deviations [action] of the policy that acted."""
        st = self.storage
        samples = st.num_envs * st.num_transitions_per_env
        size = max(1, samples // self.num_mini_batches)
        order = torch.randperm(min(samples, self.num_mini_batches * size), device=self.device)
        rows = st.observations.flatten(0, 1)
        inputs = [self.actor.get_latent(rows)]
        if self.critic.obs_groups != self.actor.obs_groups:
            inputs.append(self.critic.get_latent(rows))
        assert st.distribution_params is not None, "there is a rollout"
        mean, std = st.distribution_params
        single = (st.actions_log_prob, st.values, st.returns, st.advantages)
        rest = torch.cat([part.flatten(0, 1) for part in (st.actions, mean, *single)], 1)
        actions = st.actions.shape[-1]

        def piece(of_it: Tensor) -> Piece:
            taken = [x.index_select(0, of_it).t().contiguous() for x in (*inputs, rest)]
            own = taken.pop()
            return Piece(taken[0], taken[-1], own[:actions], own[actions : 2 * actions], *own[2 * actions :])

        pieces = -(-size // PIECE)
        return [[piece(part) for part in whole.chunk(pieces)] for whole in order.split(size)], std[0, 0]

    def _learn(self, batch: list[Piece], old_std: Tensor) -> Tensor:
        """Take one step of the optimiser; return the losses of value, surrogate and entropy, [3]."""
        low, high = self._policy.std_range
        std = self._std_param.clamp(low, high)
        count = sum(len(piece.returns) for piece in batch)
        self._shared.zero_()
        losses = torch.stack([self._trace(piece, std, count) for piece in batch]).sum(0)
        value, surrogate, moved = losses[0], losses[1], losses[2:]
        within = (self._std_param >= low) & (self._std_param <= high)
        self._by_std.sub_(self.entropy_coef / std).mul_(within)
        self._shared[-1] = ((std / old_std).log() + (old_std.square() + moved) / (2 * std.square()) - 0.5).sum()
        if self.is_multi_gpu:
            ranks.average_(self._shared)
        self._adapt(float(self._shared[-1]))
        for of_network in self._gradients:
            of_network.mul_((self.max_grad_norm / (of_network.norm() + 1e-6)).clamp_(max=1.0))
        self.optimizer.step()
        return torch.stack([value, surrogate, self._log_scale(std) + 0.5 * len(std)])

    def _trace(self, piece: Piece, std: Tensor, count: int) -> Tensor:
        """Add one piece to the gradients of a mini-batch of `count` samples.

        Returns its part of the value loss, of the surrogate loss, and of the mean square change of the policy's mean,
        [2 + action].
        """
        mean = self._actor.forward(piece.actor_input)
        error = (piece.actions - mean).div_(std.unsqueeze(1))
        squared = error.square()
        log_prob = squared.sum(0).mul_(-0.5).sub_(self._log_scale(std))
        moved = (piece.mean - mean).square_().sum(1)
        surrogate, by_log_prob = self._surrogate(log_prob, piece)
        by_log_prob.div_(count)
        self._actor.backward(error.mul_(by_log_prob).div_(std.unsqueeze(1)))
        self._by_std.add_(squared.sub_(1).mul_(by_log_prob).sum(1) / std)
        value, by_value = self._value(self._critic.forward(piece.critic_input)[0], piece)
        self._critic.backward(by_value.mul_(self.value_loss_coef / count).unsqueeze(0))
        return torch.cat([torch.stack([value, surrogate]), moved]) / count

    def _surrogate(self, log_prob: Tensor, piece: Piece) -> tuple[Tensor, Tensor]:
        """Sum of the clipped surrogate loss, and its gradient [sample] by the log probability of the actions."""
        ratio = (log_prob - piece.log_prob).exp_()
        free = ratio * piece.advantages
        clipped = ratio.clamp_(1 - self.clip_param, 1 + self.clip_param).mul_(piece.advantages)
        loss = torch.minimum(free, clipped).sum().neg_()
        return loss, free.mul_(free <= clipped).neg_()

    def _value(self, values: Tensor, piece: Piece) -> tuple[Tensor, Tensor]:
        """Sum of the clipped value loss, and its gradient [sample] with respect to the values."""
        moved = values - piece.values
        near = moved.abs() <= self.clip_param
        error = values - piece.returns
        clipped = moved.clamp_(-self.clip_param, self.clip_param).add_(piece.values).sub_(piece.returns)
        free, clipped = error.square(), clipped.square_()
        counts = near.logical_or_(free >= clipped)
        return torch.maximum(free, clipped).sum(), error.mul_(counts).mul_(2)

    def _adapt(self, divergence: float) -> None:
        """Adapt the learning rate, so that the divergence stays near its desired value."""
        if divergence > 2 * self.desired_kl:
            self.learning_rate = max(SLOWER, self.learning_rate / STEP)
        elif 0 < divergence < self.desired_kl / 2:
            self.learning_rate = min(FASTER, self.learning_rate * STEP)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate
