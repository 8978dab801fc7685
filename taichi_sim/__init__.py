"""taichi-sim: a sea, an atmosphere, and vehicles in them, for thousands of environments at once.

`import taichi_sim as ts` gives the names below; each is imported at its first use.
"""

import importlib as _importlib
import os as _os
from typing import Any as _Any

import gymnasium as _gymnasium

from taichi_sim.commands.bundle import find_rl as _find_rl
from taichi_sim.commands.moved import put_up as _put_up

_find_rl()
_put_up()
# Taichi prints a banner on import; a library does not.
_os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
# OpenMP threads of torch spin while they wait for each other. On a machine that does anything else at the same time
# that made PPO 10 to 20 times slower; sleeping after a short spin costs nothing when it is idle. Counts before torch
# is imported.
_os.environ.setdefault("GOMP_SPINCOUNT", "30000")

__version__ = "0.1.0"

# Only names are registered: Gymnasium imports the adapters when an environment is made.
for _name, _scenario, _team, _other in (
    ("UsvFormation", "paper", "usv", "absent"),
    ("UavFormation", "paper", "uav", "absent"),
    ("OtterFormation", "otter", "usv", "absent"),
    ("AerosondeFormation", "aerosonde", "uav", "absent"),
    ("EscortUsv", "escort", "usv", "absent"),  # scripted scouts replace the aircraft
    (
        "EscortUav",
        "escort",
        "uav",
        "classical",
    ),  # the aircraft's reward depends on what the boats do with their messages
    ("LandingUav", "landing", "uav", "absent"),  # a helm holds the boat's course
):
    _gymnasium.register(
        id=f"taichi_sim/{_name}-v0",
        entry_point="rl.adapters.gymnasium:TeamEnv",
        vector_entry_point="rl.adapters.gymnasium:TeamVectorEnv",
        kwargs={"team": _team, "scenario": _scenario, "other": _other},
    )

# Names of rl too: none of its modules is imported before its first use.
_PUBLIC = {
    "rl.adapters.batched": ("BatchedEnv",),
    "rl.adapters.marl": ("batched_env", "parallel_env"),
    "taichi_sim.air": ("Wind",),
    "taichi_sim.bench": ("Bench", "calm_sea"),
    "taichi_sim.config": (
        "AirConfig", "ConfigError", "CurrentConfig", "Finite", "Fraction", "GustConfig", "NonNegative", "Positive",
        "Range", "SeaConfig", "Strict", "SwellConfig", "TeamConfig", "WorldConfig",
    ),
    "taichi_sim.config.io": ("load_world",),
    "taichi_sim.fleet": ("Fleet",),
    "taichi_sim.kernels.packs": ("AroundPack", "Build", "FleetPack", "load_at", "numbers_at"),
    "taichi_sim.recording": ("Episode", "Recorder", "write_recording"),
    "taichi_sim.replay": ("replay",),
    "taichi_sim.kernels.runtime": ("init",),
    "taichi_sim.script": ("Script",),
    "taichi_sim.sea": ("Sea",),
    "taichi_sim.sea.current": ("Current",),
    "taichi_sim.surroundings": ("Surroundings",),
    "taichi_sim.uav.aircraft": ("Aircraft",),
    "taichi_sim.usv.vessel": ("Vessel",),
    "taichi_sim.vehicle": ("Limits", "Vehicle"),
    "taichi_sim.vehicles": ("load_vehicle", "shipped_vehicles"),
    "taichi_sim.world": ("ActionError", "World"),
}  # fmt: skip
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}
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
