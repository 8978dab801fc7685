"""taichi-sim: a sea, an atmosphere, and vehicles in them, for thousands of environments at once.

`import taichi_sim as ts` gives the names below; each is imported at its first use.
"""

import importlib as _importlib
import os as _os
from typing import Any as _Any

# Taichi prints a banner on import; a library does not.
_os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "0")
# OpenMP threads of torch spin while they wait for each other. On a machine that does anything else at the same time
# that made PPO 10 to 20 times slower; sleeping after a short spin costs nothing when it is idle. Counts before torch
# is imported.
_os.environ.setdefault("GOMP_SPINCOUNT", "30000")

__version__ = "0.1.0"

_NAMES = {
    "taichi_sim.surroundings.air": "Wind",
    "taichi_sim.config.arguments": "ActionError",
    "taichi_sim.bench": "Bench calm_sea",
    "taichi_sim.config": (
        "AirConfig ConfigError CurrentConfig Finite Fraction GustConfig NonNegative Positive Range SeaConfig "
        "Strict SwellConfig TeamConfig WorldConfig"
    ),
    "taichi_sim.config.io": "load_world",
    "taichi_sim.config.plausible": "NumberWarning Plausible",
    "taichi_sim.fleet": "Fleet",
    "taichi_sim.kernels.packs": "AroundPack Build FleetPack load_at numbers_at own_numbers",
    "taichi_sim.kernels.runtime": "ProgramError init",
    "taichi_sim.visualisation.recording": "Episode Recorder",
    "taichi_sim.visualisation.recording.rrd": "write_recording",
    "taichi_sim.surroundings.sea": "Sea",
    "taichi_sim.surroundings.sea.current": "Current",
    "taichi_sim.surroundings.around_vehicles": "Surroundings",
    "taichi_sim.models.uav.aircraft": "Aircraft",
    "taichi_sim.models.usv.vessel_base": "Vessel",
    "taichi_sim.vehicle": "Limits Vehicle",
    "taichi_sim.models.catalogue": "load_vehicle shipped_vehicles",
    "taichi_sim.world": "Script World replay",
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
