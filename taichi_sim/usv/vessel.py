"""What every vessel has in common: how it may end, whatever its mission."""

import math
from typing import Any

from torch import Tensor

from taichi_sim.conventions import ELEVATION
from taichi_sim.kinematics import UPRIGHT
from taichi_sim.vehicle import Vehicle


class Vessel(Vehicle):
    """A vehicle on the water; it may capsize, be swamped, and touch the ground."""

    medium = "water"
    ending_names = ("capsized", "swamped", "grounded")

    @property
    def capsize_cosine(self) -> float:
        """Cosine of the tilt from which the hull no longer rights itself."""
        return 0.0

    @property
    def deck_height(self) -> float:
        """Lowest height of the deck above the origin, m; infinite of a vessel that cannot be swamped."""
        return math.inf

    def endings(self, fleet: Any, world: Any) -> dict[str, Tensor]:
        """Capsized: tilted past the angle of vanishing stability. Swamped: the mean surface under the hull stands above
        the deck. Grounded: the keel reaches the bottom.
        """
        depth, down = world.config.sea.depth, fleet.state[..., 2]
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
