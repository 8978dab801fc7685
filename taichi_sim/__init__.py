"""taichi-sim: a sea, an atmosphere, and vehicles in them, for thousands of environments at once.

`import taichi_sim as ts` gives the names below; each is imported at its first use.
"""

import ast as _ast
import importlib as _importlib
import os as _os
from pathlib import Path as _Path
from typing import Any as _Any

import gymnasium as _gymnasium

from taichi_sim.commands.bundle import find_rl as _find_rl

_find_rl()
# Taichi prints a banner on import; a library does not.
_os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
# OpenMP threads of torch spin while they wait for each other. On a machine that does anything else at the same time
# that made PPO 10 to 20 times slower; sleeping after a short spin costs nothing when it is idle. Counts before torch
# is imported.
_os.environ.setdefault("GOMP_SPINCOUNT", "30000")

__version__ = "0.1.0"

# Only names are registered: Gymnasium imports the adapters when an environment is made.
for _scenario, _team, _other in (
    ("paper", "usv", "absent"),
    ("paper", "uav", "absent"),
    ("lanes", "usv", "absent"),
    ("lanes", "uav", "absent"),
    ("cruise", "usv", "absent"),
    ("cruise", "uav", "absent"),
    ("otter", "usv", "absent"),
    ("aerosonde", "uav", "absent"),
    ("escort", "usv", "absent"),  # scripted scouts replace the aircraft
    ("escort", "uav", "classical"),  # its reward depends on what boats do with the messages
    ("landing", "uav", "absent"),  # a helm holds the boat's course
):
    _name = f"{_team}_formation" if _scenario == "paper" else f"{_scenario}_{_team}"
    _gymnasium.register(
        id=f"taichi_sim/{_name.title().replace('_', '')}-v0",
        entry_point="rl.adapters.gymnasium:TeamEnv",
        vector_entry_point="rl.adapters.gymnasium:TeamVectorEnv",
        kwargs={"team": _team, "scenario": _scenario, "other": _other},
    )

# The stub lists the names, also those of rl: none of their modules is imported before its first use.
_STUB = _ast.parse(_Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_HOME = {
    alias.name: node.module for node in _STUB.body if isinstance(node, _ast.ImportFrom) and node.module
    for alias in node.names
}  # fmt: skip
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
