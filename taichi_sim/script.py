"""The contract of a script, which commands a team without a policy: traffic, a ferry, a drifting object.

A team's section names its script, `script = "module:Class"`; the module is searched like that of a plug-in
(config/plugins.py). A mission simulates scripted teams, but neither trains nor judges them.
"""

from typing import Protocol

from numpy.typing import ArrayLike
from torch import Tensor

from taichi_sim.arguments import Envs
from taichi_sim.config import WorldConfig
from taichi_sim.fleet import Fleet
from taichi_sim.memory import Remembers


class Scene(Protocol):
    """What a script may ask of its world; a `World` (world.py) is more, and describes each in full.

    Attributes:
        config: the world's. teams: name -> fleet. num_envs: number of environments. time: float64 [env], s.
    """

    config: WorldConfig
    teams: dict[str, Fleet]
    num_envs: int
    time: Tensor

    def place(self, name: str, envs: Envs, state: Tensor) -> None:
        """Place the vehicles of a team in environments `envs` at `state` [n, vehicle, 13]."""
        ...

    def elevation(self, envs: Tensor, north: Tensor, east: Tensor) -> Tensor:
        """Elevation of the sea (m, up) in environments `envs` [n] at points [n, point]."""
        ...


class Script(Remembers):
    """Commands the team `name` of a world (world.py).

    State that it keeps between steps is saved and copied with the world; memory.py explains how.
    """

    def __init__(self, world: Scene, name: str):
        """Take a team that `world` has just added; later teams do not exist yet."""
        self.name = name

    def begin(self, world: Scene, envs: Tensor) -> None:
        """Place the team's vehicles in environments `envs` [n], where an episode begins (`world.place`).

        Sea, time, current and wind of these environments have been drawn. Default: the vehicles stay where they are.
        """

    def __call__(self, world: Scene) -> ArrayLike | Tensor:
        """Actions [env, vehicle, action] in [-1, 1] for the coming step."""
        raise NotImplementedError
