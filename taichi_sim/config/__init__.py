"""Strict pydantic models of a world's TOML sections.

Every key has a unit, a range and a default; unknown keys are refused. Units are SI and radians, except in names that
say so (`_deg`). config/io.py reads, overrides and writes TOML.
"""

from taichi_sim.config.base import (
    ConfigError,
    Finite,
    Fraction,
    NonNegative,
    NonPositive,
    Ordered,
    Positive,
    Span,
    Strict,
)
from taichi_sim.config.sea import CurrentConfig, SeaConfig, SwellConfig, TideConfig
from taichi_sim.config.vary import Range
from taichi_sim.config.world import AirConfig, GustConfig, TeamConfig, WorldConfig

__all__ = [
    "AirConfig", "ConfigError", "CurrentConfig", "Finite", "Fraction", "GustConfig", "NonNegative", "NonPositive",
    "Ordered", "Positive", "Range", "SeaConfig", "Span", "Strict", "SwellConfig", "TeamConfig", "TideConfig",
    "WorldConfig",
]  # fmt: skip
