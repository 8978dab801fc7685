"""Export of a policy to TorchScript and ONNX, with actions clipped to [-1, 1]."""

import json
import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import onnx
import torch
from rsl_rl.models import MLPModel
from torch import Tensor, nn

from taichi_sim.config.io import replacing

TORCHSCRIPT, ONNX = "policy.pt", "policy.onnx"
SIGNATURE = "signature.json"


class _Clipped(nn.Module):
    """The exported network: observations [row, n] to actions [row, action] in [-1, 1]."""

    def __init__(self, network: nn.Module):
        super().__init__()
        self.network = network

    def forward(self, obs: Tensor) -> Tensor:
        """Mean action of each row."""
        return self.network(obs).clamp(-1.0, 1.0)


def export_policy(actor: MLPModel, folder: Path, signature: Mapping[str, Sequence[str]]) -> None:
    """Write `policy.pt` (TorchScript) and `policy.onnx` (any number of rows) into `folder`.

    Both files hold the names of observations and actions in order (`signature`) as JSON lists: TorchScript in its extra
    file `signature.json`, ONNX in its metadata `observations` and `actions`.
    """
    script = torch.jit.trace(_Clipped(actor.as_jit()).eval(), torch.zeros(2, actor.obs_dim))
    with replacing(folder / TORCHSCRIPT) as part:
        torch.jit.save(script, str(part), _extra_files={SIGNATURE: json.dumps(dict(signature))})
    export_onnx(actor.as_onnx(verbose=False), actor.obs_dim, folder / ONNX, signature)


def export_onnx(
    network: nn.Module, inputs: int, file: Path, signature: Mapping[str, Sequence[str]] | None = None
) -> None:
    """Write a network of any library, observations [row, `inputs`] to actions [row, action], as ONNX.

    Its actions are clipped to [-1, 1]. `signature` as of `export_policy`; default: the file names nothing.
    """
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with replacing(file) as part, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _Clipped(network).eval(), (torch.zeros(2, inputs),), str(part), input_names=["obs"],
            output_names=["actions"], dynamic_axes={"obs": {0: "row"}, "actions": {0: "row"}}, opset_version=18,
            dynamo=False, verbose=False,
        )  # fmt: skip
        model = onnx.load(str(part))
        onnx.helper.set_model_props(model, {key: json.dumps(list(names)) for key, names in (signature or {}).items()})
        onnx.save(model, str(part))
