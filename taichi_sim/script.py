"""The contract of a script, which commands a team without a policy: traffic, a ferry, a drifting object.

A team's section names its script, `script = "module:Class"`; the module is searched like that of a plug-in
(config/plugins.py). A mission simulates scripted teams, but neither trains nor judges them.
"""

from typing import TYPE_CHECKING

from numpy.typing import ArrayLike
from torch import Tensor

if TYPE_CHECKING:
    from taichi_sim.world import World


class Script:
    """Commands the team `name` of a world (world.py).

    State that it keeps between steps is saved and copied with the world; state.py explains how.
    """

    STATE: tuple[str, ...] = ()

    def __init__(self, world: "World", name: str):
        """Take a team that `world` has just added; later teams do not exist yet."""
        self.name = name

    def begin(self, world: "World", envs: Tensor) -> None:
        """Place the team's vehicles in environments `envs` [n], where an episode begins (`world.place`).

        Sea, time, current and wind of these environments have been drawn. Default: the vehicles stay where they are.
        """

    def __call__(self, world: "World") -> ArrayLike | Tensor:
        """Actions [env, vehicle, action] in [-1, 1] for the coming step."""
        raise NotImplementedError
