"""Export of a policy to TorchScript and ONNX, with actions clipped to [-1, 1]."""

import json
import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import onnx
import torch
from torch import Tensor, nn

from rl.learn.actor import Actor
from taichi_sim.config.io import replacing

TORCHSCRIPT, ONNX = "policy.pt", "policy.onnx"
SIGNATURE = "signature.json"


class _Clipped(nn.Module):
    """The exported network: observations [row, n] to actions [row, action] in [-1, 1]; see `Actor`."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network

    def forward(self, obs: Tensor, *memory: Tensor) -> Tensor | tuple[Tensor, Tensor]:
        """Mean action of each row."""
        if not memory:
            return self.network(obs).clamp(-1.0, 1.0)
        actions, after = self.network(obs, *memory)
        return actions.clamp(-1.0, 1.0), after


def export_policy(actor: Actor, folder: Path, signature: Mapping[str, Sequence[str]]) -> None:
    """Write `policy.pt` (TorchScript) and `policy.onnx` (any number of rows) into `folder`.

    Actors with a memory take it as a second input [row, unit], zero as an episode begins, and give it back as a second
    output.

    Both files hold the names of observations and actions in order (`signature`) as JSON lists: TorchScript in its extra
    file `signature.json`, ONNX in its metadata `observations` and `actions`.
    """
    script = torch.jit.trace(_Clipped(actor).eval(), _example(actor.inputs, actor.memory))
    with replacing(folder / TORCHSCRIPT) as part:
        torch.jit.save(script, str(part), _extra_files={SIGNATURE: json.dumps(dict(signature))})
    export_onnx(actor, actor.inputs, folder / ONNX, signature, actor.memory)


def _example(inputs: int, units: int) -> tuple[Tensor, ...]:
    return (torch.zeros(2, inputs), torch.zeros(2, units))[: 2 if units else 1]


def export_onnx(
    network: nn.Module, inputs: int, file: Path, signature: Mapping[str, Sequence[str]] | None = None, units: int = 0
) -> None:
    """Write a network of any library, observations [row, `inputs`] to actions [row, action], as ONNX.

    Its actions are clipped to [-1, 1]. `signature` as of `export_policy`; default: the file names nothing. With a
    memory of `units`, it takes and gives that, too (`Actor.forward`).
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
