"""What the teams of a landing ask of their mission."""

from typing import Protocol

from torch import Tensor

from rl.missions.landing.config import LandingScenario
from rl.team import Host


class Parts(Host, Protocol):
    """What the mission, and the model of it (planning_model.py), share with their teams; `hs` is [env], m, live."""

    hs: Tensor

    @property
    def config(self) -> LandingScenario:
        """The scenario."""
        ...
