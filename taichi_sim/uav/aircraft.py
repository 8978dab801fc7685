"""What every aircraft has in common: how it may end, whatever its mission."""

from typing import TYPE_CHECKING

from torch import Tensor

from taichi_sim.conventions import DOWN
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.kinematics import WING_TILT
from taichi_sim.vehicle import Vehicle

if TYPE_CHECKING:
    from taichi_sim.world import World

LARGEST_STALL = 3.0  # s beyond the stall angle: a stall that is not recovered by then is an end; assumed
STALL_TIME = "stall_time"  # the instrument that counts it


class Aircraft(Vehicle):
    """A vehicle in the air; it may crash into the sea, and stall. Its width is its span."""

    medium = "air"
    ending_names = ("crashed", "stalled")

    def endings(self, fleet: Fleet, world: "World") -> dict[str, Tensor]:
        """Crashed: the lower wing tip, or the middle where that is lower, has met the water, a crest included. Stalled:
        for longer than `LARGEST_STALL`.
        """
        height = -fleet.state[..., DOWN] - 0.5 * self.size[1] * fleet.derived[..., WING_TILT].abs()
        stalled = fleet.never
        if STALL_TIME in self.aux_names:
            stalled = fleet.reading(STALL_TIME) > LARGEST_STALL
        return {"crashed": height <= world.elevation_below(fleet, height), "stalled": stalled}
