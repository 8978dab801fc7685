"""The contract of a script, which commands a team without a policy: traffic, a ferry, a drifting object.

A team's section names it, `script = "module:Class"`; the module is looked for as those of plug-ins are (plugins.py). A
mission simulates scripted teams, and neither trains nor judges them.
"""

from typing import TYPE_CHECKING, Any

from torch import Tensor

if TYPE_CHECKING:
    from taichi_sim.world import World


class Script:
    """Commands the team `name` of a world (world.py).

    What it remembers between steps is saved and copied with the world: state.py says how.
    """

    STATE: tuple[str, ...] = ()

    def __init__(self, world: "World", name: str):
        """Take a team that `world` has just added; later teams are not there yet."""
        self.name = name

    def begin(self, world: "World", envs: Tensor) -> None:
        """Place the team's vehicles in environments `envs` [n], where an episode begins (`world.place`).

        Their sea, time, current and wind have been drawn. Default: they stay where the last episode left them.
        """

    def __call__(self, world: "World") -> Any:
        """Actions [env, vehicle, action] in [-1, 1] for the coming step."""
        raise NotImplementedError
