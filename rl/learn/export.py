"""Export of a policy to TorchScript and ONNX, with actions clipped to [-1, 1]."""

# torch types a module's weights as tensors or modules.
# pyright: reportArgumentType=false

import json
import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import onnx
import torch
from rsl_rl.models import MLPModel, RNNModel
from torch import Tensor, nn
from torch.nn import functional

from taichi_sim.config.io import replacing

TORCHSCRIPT, ONNX = "policy.pt", "policy.onnx"
SIGNATURE = "signature.json"


class Recurrent(nn.Module):
    """An actor with a memory: observations [row, n] and memory [row, unit] to actions and the memory after them.

    The GRU's equations (torch.nn.GRU) stand here in products, which every reader of ONNX knows.
    """

    def __init__(self, actor: RNNModel):
        """Take the weights of an actor."""
        super().__init__()
        self.rnn, self.mlp = actor.rnn, actor.mlp

    def forward(self, obs: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Mean action of each row, and its memory."""
        gru = self.rnn.rnn
        seen = functional.linear(obs, gru.weight_ih_l0, gru.bias_ih_l0).split(gru.hidden_size, -1)
        kept = functional.linear(memory, gru.weight_hh_l0, gru.bias_hh_l0).split(gru.hidden_size, -1)
        new = torch.tanh(seen[2] + torch.sigmoid(seen[0] + kept[0]) * kept[2])
        memory = new + torch.sigmoid(seen[1] + kept[1]) * (memory - new)
        return self.mlp(memory), memory


class _Clipped(nn.Module):
    """The exported network: observations [row, n] to actions [row, action] in [-1, 1]; see `Recurrent`."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network

    def forward(self, obs: Tensor, *memory: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        """Mean action of each row."""
        if not memory:
            return self.network(obs).clamp(-1.0, 1.0)
        actions, after = self.network(obs, *memory)
        return actions.clamp(-1.0, 1.0), after


def export_policy(actor: MLPModel, folder: Path, signature: Mapping[str, Sequence[str]]) -> None:
    """Write `policy.pt` (TorchScript) and `policy.onnx` (any number of rows) into `folder`.

    Actors with a memory take it as a second input [row, unit], zero as an episode begins, and give it back as a second
    output.

    Both files hold the names of observations and actions in order (`signature`) as JSON lists: TorchScript in its extra
    file `signature.json`, ONNX in its metadata `observations` and `actions`.
    """
    network, units = network_of(actor)
    script = torch.jit.trace(_Clipped(network).eval(), _example(actor.obs_dim, units))
    with replacing(folder / TORCHSCRIPT) as part:
        torch.jit.save(script, str(part), _extra_files={SIGNATURE: json.dumps(dict(signature))})
    export_onnx(network, actor.obs_dim, folder / ONNX, signature, units)


def network_of(actor: MLPModel) -> tuple[nn.Module, int]:
    """The network of an actor to be exported, and the units of its memory."""
    recurrent = isinstance(actor, RNNModel)
    return (Recurrent(actor), actor.rnn.rnn.hidden_size) if recurrent else (actor.as_onnx(verbose=False), 0)


def _example(inputs: int, units: int) -> tuple[Tensor, ...]:
    return (torch.zeros(2, inputs), torch.zeros(2, units))[: 2 if units else 1]


def export_onnx(
    network: nn.Module, inputs: int, file: Path, signature: Mapping[str, Sequence[str]] | None = None, units: int = 0
) -> None:
    """Write a network of any library, observations [row, `inputs`] to actions [row, action], as ONNX.

    Its actions are clipped to [-1, 1]. `signature` as of `export_policy`; default: the file names nothing. With a
    memory of `units`, it takes and gives that, too (`Recurrent`).
    """
    names = ("obs", "memory")[: 2 if units else 1], ("actions", "memory_after")[: 2 if units else 1]
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with replacing(file) as part, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _Clipped(network).eval(), _example(inputs, units), str(part), input_names=names[0],
            output_names=names[1], dynamic_axes={name: {0: "row"} for of in names for name in of}, opset_version=18,
            dynamo=False, verbose=False,
        )  # fmt: skip
        model = onnx.load(str(part))
        onnx.helper.set_model_props(model, {key: json.dumps(list(names)) for key, names in (signature or {}).items()})
        onnx.save(model, str(part))
