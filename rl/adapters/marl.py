"""Missions for multi-agent learning: a PettingZoo environment, or thousands at once (docs/interfaces.md).

Both have `rl.adapters.batched.BatchedEnv` behind them; what teams that do not act do is said by `others` there.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rl.adapters.batched import BatchedEnv
from taichi_sim.config.io import find_config

if TYPE_CHECKING:  # PettingZoo is an extra
    from rl.adapters.pettingzoo import ParallelMission


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
    """A PettingZoo parallel environment of a scenario (rl/adapters/pettingzoo.py): each vehicle that acts is an agent.

    Args:
        scenario: a TOML file or a shipped name. overrides: KEY=VALUE each. seed: of the worlds; default the scenario's.
        teams, others: who acts, and what the others do; see `BatchedEnv`.
        render_mode: None, "rgb_array" (`render` gives a picture), or "human" (a window). render_size: width and height
            of the picture, px; default 640x480.

    Raises:
        MissingExtraError: if PettingZoo is not installed. ValueError: for a render mode or size that cannot be.
            Otherwise as `BatchedEnv`.
    """
    from rl.adapters.pettingzoo import ParallelMission

    env = BatchedEnv(scenario, 1, teams=teams, others=others, overrides=overrides, seed=seed, autoreset=False)
    return ParallelMission(env, find_config(scenario).stem, render_mode, render_size)


def batched_env(scenario: str | Path = "escort", num_envs: int = 1, **options: Any) -> BatchedEnv:
    """`num_envs` environments of a scenario as torch tensors by team; arguments, options and errors of `BatchedEnv`."""
    return BatchedEnv(scenario, num_envs, **options)
