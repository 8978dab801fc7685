"""The network of a trained actor, without rsl-rl, which takes as long to import as torch."""

# torch types a module's weights as tensors or modules.
# pyright: reportArgumentType=false

from collections import OrderedDict
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from rl.scenario import StageConfig

ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}


class Actor(nn.Module):
    """Observations [row, n] to mean actions [row, action], as rsl-rl's MLPModel, or with a memory its RNNModel.

    Weights have the names that they have there, and those of a new actor are drawn in the same way.

    Attributes:
        inputs: observations in a row. memory: units of its memory, 0: it has none.
    """

    def __init__(self, stage: StageConfig, observations: int, actions: int):
        """A stage's actor, with initial weights."""
        super().__init__()
        self.inputs, self.memory = observations, stage.gru
        if stage.gru:
            self.rnn = nn.Sequential(OrderedDict(rnn=nn.GRU(observations, stage.gru)))
        sizes = (stage.gru or observations, *stage.hidden_dims, actions)
        layers = [(nn.Linear(a, b), ACTIVATIONS[stage.activation]()) for a, b in zip(sizes, sizes[1:], strict=False)]
        self.mlp = nn.Sequential(*[layer for pair in layers for layer in pair][:-1])
        self.distribution = nn.ParameterDict({"std_param": torch.full((actions,), stage.initial_std)})

    def forward(self, obs: Tensor, memory: Tensor | None = None) -> Tensor | tuple[Tensor, Tensor]:
        """Actions; of an actor with a `memory` [row, unit], that after it, too.

        The GRU's equations (torch.nn.GRU) stand here in products, which every reader of ONNX knows.
        """
        if memory is None:
            return self.mlp(obs)
        gru = cast(nn.GRU, self.rnn.rnn)
        seen = functional.linear(obs, gru.weight_ih_l0, gru.bias_ih_l0).split(gru.hidden_size, -1)
        kept = functional.linear(memory, gru.weight_hh_l0, gru.bias_hh_l0).split(gru.hidden_size, -1)
        new = torch.tanh(seen[2] + torch.sigmoid(seen[0] + kept[0]) * kept[2])
        memory = new + torch.sigmoid(seen[1] + kept[1]) * (memory - new)
        return self.mlp(memory), memory
