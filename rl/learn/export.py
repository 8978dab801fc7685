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
    example = torch.zeros(2, actor.obs_dim)
    script = torch.jit.trace(_Clipped(actor.as_jit()).eval(), example)
    with replacing(folder / TORCHSCRIPT) as part:
        torch.jit.save(script, str(part), _extra_files={SIGNATURE: json.dumps(dict(signature))})
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with replacing(folder / ONNX) as part, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _Clipped(actor.as_onnx(verbose=False)).eval(), (example,), str(part), input_names=["obs"],
            output_names=["actions"], dynamic_axes={"obs": {0: "row"}, "actions": {0: "row"}}, opset_version=18,
            dynamo=False, verbose=False,
        )  # fmt: skip
        model = onnx.load(str(part))
        onnx.helper.set_model_props(model, {key: json.dumps(list(names)) for key, names in signature.items()})
        onnx.save(model, str(part))
