"""What type checkers see of taichi_sim/__init__.py."""

from taichi_sim.bench import Bench, calm_sea
from taichi_sim.config import (
    AirConfig,
    ConfigError,
    CurrentConfig,
    Finite,
    Fraction,
    GustConfig,
    NonNegative,
    Positive,
    Range,
    SeaConfig,
    Strict,
    SwellConfig,
    TeamConfig,
    WorldConfig,
)
from taichi_sim.config.arguments import ActionError
from taichi_sim.config.io import load_world
from taichi_sim.config.plausible import NumberWarning, Plausible
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.packs import AroundPack, Build, FleetPack, load_at, numbers_at, own_numbers
from taichi_sim.kernels.runtime import ProgramError, init
from taichi_sim.models.catalogue import load_vehicle, shipped_vehicles
from taichi_sim.models.uav.aircraft import Aircraft
from taichi_sim.models.usv.vessel_base import Vessel
from taichi_sim.surroundings.air import Wind
from taichi_sim.surroundings.around_vehicles import Surroundings
from taichi_sim.surroundings.sea import Sea
from taichi_sim.surroundings.sea.current import Current
from taichi_sim.vehicle import Limits, Vehicle
from taichi_sim.visualisation.recording import Episode, Recorder
from taichi_sim.visualisation.recording.rrd import write_recording
from taichi_sim.world import Script, World, replay

__version__: str
__all__ = [
    "ActionError", "AirConfig", "Aircraft", "AroundPack", "Bench", "Build", "ConfigError", "Current", "CurrentConfig",
    "Episode", "Finite", "Fleet", "FleetPack", "Fraction", "GustConfig", "Limits", "NonNegative",
    "NumberWarning", "Plausible", "Positive", "ProgramError", "Range", "Recorder", "Script", "Sea", "SeaConfig",
    "Strict", "Surroundings", "SwellConfig", "TeamConfig", "Vehicle", "Vessel", "Wind", "World", "WorldConfig",
    "calm_sea", "init", "load_at", "load_vehicle", "load_world", "numbers_at", "own_numbers", "replay",
    "shipped_vehicles", "write_recording",
]  # fmt: skip
