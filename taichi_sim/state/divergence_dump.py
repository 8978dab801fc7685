"""Dumps: files with the last step of an environment whose state stopped being finite, for running that step again.

`World.dump_folder` turns dumps on; `replay` (world.py) replays one.
"""

from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from taichi_sim.config import ConfigError, WorldConfig
from taichi_sim.config.io import validate

MAX_DUMPS = 20  # largest number in one folder: a repeated fault needs no more


@dataclass(frozen=True)
class Dump:
    """One environment before the failed step; tensors have no environment axis."""

    config: WorldConfig
    seed: int  # seed of the world's seas
    env: int  # number of the environment, which its random numbers depend on
    sea: int  # realisation of the sea
    time: float  # s
    clock: int  # number of control steps that the world had made
    current: Tensor  # [2], m/s
    wind: Tensor  # [3], m/s
    states: dict[str, Tensor]  # team -> [vehicle, 13]
    aux: dict[str, Tensor]  # team -> [vehicle, n]
    actions: dict[str, Tensor]  # team -> [vehicle, action]
    fault: str
    remainders: dict[str, Tensor] = field(default_factory=dict)  # team -> [vehicle, 3] of positions (position.py)
    vary: dict[str, dict[str, Tensor]] = field(default_factory=dict)  # team -> key -> [vehicle], if numbers vary
    loads: dict[str, Tensor] = field(default_factory=dict)  # team -> [vehicle, 6], if loads from outside are in use
    touch: dict[str, dict[str, Tensor]] = field(
        default_factory=dict
    )  # team -> name of what a Touch remembers -> [vehicle, n]


def save_dump(dump: Dump, folder: Path) -> Path | None:
    """Write `dump` to a new file of `folder`; None if the folder holds enough dumps or cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        number = len(list(folder.glob("*.dump")))
        if number >= MAX_DUMPS:
            return None
        path = folder / f"{number:03d}.dump"
        config = dump.config.bare().model_dump(mode="json", exclude_none=True)
        torch.save(vars(dump) | {"config": config}, path)
    except OSError:  # a full disk must not end a training run that is otherwise fine
        return None
    return path


def load_dump(path: Path) -> Dump:
    """Read a dump."""
    try:
        data = torch.load(path, weights_only=True)
        config = validate(WorldConfig, data.pop("config"), str(path))
        return Dump(config=config, **data)
    except Exception as error:  # the unpickler raises errors of many kinds
        raise ConfigError(f"{path}: not a dump of an environment: {error}") from None
