"""What a scenario may say: strict pydantic models of configs/*.toml.

Every key has a unit, a range and a default; unknown keys are refused. SI units and radians, except names that
say so (`_deg`). Reading, overriding and writing TOML is in config/io.py.
"""

from taichi_sim.config.air import (
    AirConfig,
    GustConfig,
)
from taichi_sim.config.base import (
    ConfigError,
    Finite,
    Fraction,
    NonNegative,
    Positive,
    Strict,
)
from taichi_sim.config.scenario import (
    EvaluationConfig,
    FixedObstacle,
    ObstacleConfig,
    ScenarioConfig,
    SensingConfig,
    StageConfig,
    TeamConfig,
    TrackConfig,
    TrackingReward,
)
from taichi_sim.config.sea import (
    CurrentConfig,
    SeaConfig,
    SwellConfig,
)

__all__ = [
    "AirConfig",
    "ConfigError",
    "CurrentConfig",
    "EvaluationConfig",
    "Finite",
    "FixedObstacle",
    "Fraction",
    "GustConfig",
    "NonNegative",
    "ObstacleConfig",
    "Positive",
    "ScenarioConfig",
    "SeaConfig",
    "SensingConfig",
    "StageConfig",
    "Strict",
    "SwellConfig",
    "TeamConfig",
    "TrackConfig",
    "TrackingReward",
]
