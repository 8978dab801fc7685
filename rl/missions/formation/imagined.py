"""The model in which an honest planner (rl/planning/honest.py) tries plans for a formation.

It has nominal vehicles, calm water, the scenario's mean wind and current, exact sensors and no radio. Track, target and
slots are the plan, which all vehicles know. Its obstacles are those that the vehicles sense; they keep their velocity.
"""

from rl.missions.formation.config import FormationScenario
from rl.perception.config import SensorsConfig
from taichi_sim.config import AirConfig, SeaConfig

CALM = {"hs": 0.0, "tp": 4.0, "components": 1, "realisations": 1}


def imagined_scenario(config: FormationScenario, name: str) -> FormationScenario:
    """The scenario of the model of team `name`."""
    current = config.sea.current and config.sea.current.model_copy(update={"std": 0.0})
    steady = {"std": 0.0, "turbulence": "none", "gust": None}
    obstacles = config.obstacles.model_copy(update={"count": 0, "fixed": ()})
    section = config.formations[name].model_copy(update={"vary": {}, "residual": None})
    return config.model_copy(
        update={
            "sea": SeaConfig(**CALM, depth=config.sea.depth, current=current),
            "air": config.air.model_copy(update=steady) if config.air else AirConfig(),
            "vary": {},
            "obstacles": obstacles,
            "sensors": SensorsConfig(),
            "radio": None,
            name: section,
        }
    )
