"""Missions for multi-agent learning: one PettingZoo environment, or thousands of environments at once
(docs/interfaces.md).

Both are made of `rl.adapters.batched.BatchedEnv`. Its argument `others` chooses the policies of the teams that do not
act.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

from rl.adapters.batched import BatchedEnv
from taichi_sim.config.io import find_config

if TYPE_CHECKING:  # PettingZoo is an extra
    from rl.adapters.pettingzoo import ParallelMission


class BatchedOptions(TypedDict, total=False):
    """Further arguments of `BatchedEnv`."""

    teams: str | Sequence[str] | None
    others: Mapping[str, str | Path] | None
    overrides: Iterable[str]
    seed: int | None
    autoreset: bool


def parallel_env(
    scenario: str | Path = "escort",
    *,
    teams: str | Sequence[str] | None = None,
    others: Mapping[str, str | Path] | None = None,
    overrides: Iterable[str] = (),
    seed: int | None = None,
    render_mode: str | None = None,
    render_size: tuple[int, int] | None = None,
) -> "ParallelMission":
    """A scenario as a PettingZoo parallel environment in which each vehicle that acts is an agent.

    Args:
        scenario: a TOML file or the name of a shipped scenario.
        teams, others: the teams that act and the policies of the others, as for `BatchedEnv`.
        overrides: KEY=VALUE each.
        seed: of the worlds; default the scenario's.
        render_mode: None, "rgb_array" (`render` returns a picture), or "human" (a window).
        render_size: width and height of the picture, px; default 640x480.

    Raises:
        MissingExtraError: if PettingZoo is not installed.
        ValueError: if the render mode or the size is not allowed.
        ConfigError, ControllerError, RunError, CheckpointError: as for `BatchedEnv`.
    """
    from rl.adapters.pettingzoo import ParallelMission

    env = BatchedEnv(scenario, 1, teams=teams, others=others, overrides=overrides, seed=seed, autoreset=False)
    return ParallelMission(env, find_config(scenario).stem, render_mode, render_size)


def batched_env(scenario: str | Path = "escort", num_envs: int = 1, **options: Unpack[BatchedOptions]) -> BatchedEnv:
    """`num_envs` environments of a scenario as torch tensors by team.

    Arguments, options and errors are those of `BatchedEnv`.
    """
    return BatchedEnv(scenario, num_envs, **options)
