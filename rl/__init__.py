"""Missions for teams of vehicles, PPO stage by stage, evaluation, recordings.

`import rl` registers the Gymnasium ids (rl/adapters) and gives the names below; each is imported at its first use.
"""

import importlib as _importlib
from typing import Any as _Any

import rl.adapters as _adapters  # noqa: F401  registers the Gymnasium ids
import taichi_sim as _taichi_sim  # noqa: F401  its settings of OpenMP count before torch is imported

_NAMES = {
    "rl.adapters.batched": "BatchedEnv",
    "rl.adapters.gymnasium": "TeamEnv TeamVectorEnv",
    "rl.judge": "Judge",
    "rl.learn.policy": "load_policy",
    "rl.mission": "Endings Mission",
    "rl.missions": "load_scenario make_mission",
    "rl.scenario": "Scenario",
    "rl.team": "Team",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> _Any:
    """Import a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; public names are {', '.join(__all__)}")
    value = getattr(_importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names, for completion."""
    return sorted({name for name in {*globals(), *__all__} if name.startswith("__") or not name.startswith("_")})
