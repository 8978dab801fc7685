"""Strict pydantic models of a world's TOML sections.

Every key has a unit, a range and a default; unknown keys are refused. SI units and radians, except names that
say so (`_deg`). Reading, overriding and writing TOML is in config/io.py.
"""

from taichi_sim.config.air import AirConfig, GustConfig
from taichi_sim.config.base import ConfigError, Finite, Fraction, NonNegative, Positive, Strict
from taichi_sim.config.current import CurrentConfig, TideConfig
from taichi_sim.config.sea import SeaConfig, SwellConfig
from taichi_sim.config.vary import Range
from taichi_sim.config.world import TeamConfig, WorldConfig

__all__ = [
    "AirConfig",
    "ConfigError",
    "CurrentConfig",
    "Finite",
    "Fraction",
    "GustConfig",
    "NonNegative",
    "Positive",
    "Range",
    "SeaConfig",
    "Strict",
    "SwellConfig",
    "TeamConfig",
    "TideConfig",
    "WorldConfig",
]
