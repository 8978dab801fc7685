"""Base class of all vessels, with the endings that every mission shares."""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from taichi_sim.conventions import DOWN, ELEVATION
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.rigid_body import Number
from taichi_sim.kernels.rotation import UPRIGHT
from taichi_sim.vehicle import Vehicle

if TYPE_CHECKING:
    from taichi_sim.world import World

__all__ = ["Number", "Vessel", "steady_speed"]


def steady_speed(load: float, a: float, b: float = 0.0, c: float = 0.0) -> float:
    """The x > 0 that solves (a + b |x| + c x^2) x = `load` > 0; infinite without resistance."""
    roots = np.roots([c, b, a, -load])
    ahead = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(ahead.min(initial=np.inf))


class Vessel(Vehicle):
    """A vehicle on the water. It may capsize, be swamped, or touch the ground."""

    medium = "water"
    ending_names = ("capsized", "swamped", "grounded")

    helm_max: float | None = None
    """Angle of the rudders at full helm, rad; None for a vessel without rudders."""
    backs: bool = False
    """Whether the vessel can push astern."""

    def steer(self, ahead: ArrayLike, helm: ArrayLike) -> NDArray[np.float64] | None:
        """Return the actions [.., action] of a helmsman's commands, each [..].

        `ahead` runs from 0 (no thrust) to 1 (full ahead), and down to -1 (full astern) if the vessel `backs`. `helm`
        runs from -1 (hard to port) to 1 (hard to starboard). The default, None, means that the vessel has no such
        commands.
        """
        return None

    @property
    def capsize_cosine(self) -> float:
        """Cosine of the tilt beyond which the hull no longer rights itself."""
        return 0.0

    @property
    def deck_height(self) -> float:
        """Lowest height of the deck above the origin, m; infinite for a vessel that cannot be swamped."""
        return math.inf

    def endings(self, fleet: Fleet, world: "World") -> dict[str, Tensor]:
        """Return the endings of each vehicle, bool [env, vehicle].

        Capsized: tilted beyond the angle of vanishing stability. Swamped: the mean surface under the hull is above the
        deck. Grounded: the keel reaches the bottom.
        """
        depth, down = world.config.sea.depth, fleet.state[..., DOWN]
        swamped, grounded = fleet.never, fleet.never
        if math.isfinite(self.deck_height):
            swamped = down + fleet.surface[..., ELEVATION] > self.deck_height
        if depth is not None:
            grounded = down > depth - self.draft
        return {
            "capsized": fleet.derived[..., UPRIGHT] <= self.capsize_cosine,
            "swamped": swamped,
            "grounded": grounded,
        }
