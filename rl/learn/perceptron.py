"""Forward and backward passes of rsl-rl's MLPs without autograd: fewer operations, and products that use the whole CPU.

Batches for learning have features first, [feature, sample]. The long dimension is then innermost in all three products
of a layer (output, gradient of the weights, gradient of the input), which is the fastest order.
"""

from collections.abc import Callable

import torch
from rsl_rl.models import MLPModel
from torch import Tensor, nn
from torch.nn import functional

_ONEDNN = getattr(torch.ops.mkldnn, "_linear_pointwise", None) if torch.backends.mkldnn.is_available() else None

_Backward = Callable[[Tensor, Tensor], object]
ACTIVATIONS: dict[type[nn.Module], tuple[Callable[[Tensor], Tensor], _Backward]] = {
    nn.ELU: (
        functional.elu_,
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

    On CPUs it uses oneDNN. MKL, torch's default, uses half the vector width on AMD's CPUs: 100 instead of 220 Gflop/s
    on one core of an EPYC with AVX-512. On other CPUs both are equally fast. The precision is float32, as with MKL.
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
        """Take the layers of `model`.

        Raises:
            TypeError: if it has other layers than linear ones with ELU, ReLU or tanh between, or normalises its input.
        """
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
