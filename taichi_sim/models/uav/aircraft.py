"""What fixed-wing aircraft and multirotors share: endings of an aircraft in flight, and the error of a trim."""

from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import DOWN
from taichi_sim.kernels.rotation import WING_TILT
from taichi_sim.vehicle import Vehicle, Waters

LARGEST_STALL = 3.0  # s: a longer stall ends the episode; assumed
STALL_TIME = "stall_time"  # the instrument that shows how long the wing has been stalled


class TrimError(ConfigError):
    """There is no steady flight under the given conditions; the message names the limits in the way."""


class Aircraft(Vehicle):
    """A vehicle in the air that may crash into the sea or stall. Its width is its span."""

    medium = "air"
    ending_names = ("crashed", "stalled")

    def endings(self, fleet: Fleet, world: Waters) -> dict[str, Tensor]:
        """Endings [env, vehicle] of an episode.

        `crashed`: the lower wing tip, or the fuselage if that is lower, has touched the water, a crest included.
        `stalled`: the wing has been stalled for longer than `LARGEST_STALL`.
        """
        height = -fleet.state[..., DOWN] - 0.5 * self.size[1] * fleet.derived[..., WING_TILT].abs()
        stalled = fleet.never
        if STALL_TIME in self.aux_names:
            stalled = fleet.reading(STALL_TIME) > LARGEST_STALL
        return {"crashed": height <= world.elevation_below(fleet, height), "stalled": stalled}
