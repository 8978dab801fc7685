"""The conditions of each episode: its sea, current and wind as drawn, and the numbers of its vehicles that vary."""

import numpy as np
from numpy.typing import NDArray

from rl.mission import Mission
from taichi_sim.config.vary import CONDITIONS

CIRCLE = 360.0  # deg
ALL = slice(None)
DIGITS = 5  # significant ones, of what is stored
UNITS = {"hs": "m", "tp": "s", "speed": "m/s"}
DRAWN = tuple(key for key in CONDITIONS if key != "sea.sea_state")  # in the order of `World.conditions`

Conditions = dict[str, NDArray[np.float64]]
"""Key of the scenario -> [episode], or of a number of a vehicle file, TEAM.KEY -> [episode, vehicle]."""


def conditions_of(mission: Mission, envs: slice = ALL) -> Conditions:
    """The conditions in environments of a mission, which has begun; directions from 0 to 360 deg."""
    seas, world = mission.world.env_sea.cpu().numpy()[envs], mission.world
    found = {key: np.asarray(of)[seas] for key, of in zip(DRAWN, world.conditions, strict=True)}
    found = {key: of % CIRCLE if key.endswith("_deg") else of for key, of in found.items()}
    for name in mission.teams:
        numbers = world.teams[name].vary
        found |= {f"{name}.{key}": numbers[key][envs].double().cpu().numpy() for key in mission.config.teams[name].vary}
    return {key: np.array([float(f"{x:.{DIGITS}g}") for x in of.flat]).reshape(of.shape) for key, of in found.items()}


def unit(key: str) -> str:
    """The unit of a condition, in brackets; nothing where its name says it, and for numbers of vehicle files."""
    found = UNITS.get(key.rpartition(".")[2]) if key in CONDITIONS else None
    return f" ({found})" if found else ""
