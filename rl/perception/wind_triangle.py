"""The wind triangle: how fast something that flies at a constant airspeed moves along a course over ground.

The velocity over ground is that through the air plus the wind's. On a course at the angle D from where the wind blows
to, with airspeed V_a and wind w, the nose is turned into the wind by the crab angle c, and the speed over ground is v:

    sin c = (w / V_a) sin D,    v = w cos D + V_a cos c       (so |v - w| = V_a; Beard & McLain 2012, sec. 2.4)

On a path of curvature k the heading turns at v k v / (V_a cos c), hence the acceleration, normal to the velocity
through the air, is v^2 k / cos c. That is largest straight downwind, where v = V_a + w and c = 0.
"""

import taichi as ti
import torch
from torch import Tensor

from taichi_sim.air.wind import wind_factor, wind_shear
from taichi_sim.config import WorldConfig
from taichi_sim.randomisation.conditions import bounds

SIGMAS = 3.0  # standard deviations of the slow variation in the strongest wind
LEAST_SHARE = 0.2  # of the airspeed, the least speed over ground; assumed: the wind must leave that much


@ti.func
def speed_over_ground(airspeed, north, east, cos, sin):
    """Speed over ground (m/s) on a course (cos, sin) at an airspeed in the wind (north, east), m/s.

    It is held at `LEAST_SHARE` of the airspeed where the wind would leave less.
    """
    along, across = cos * north + sin * east, cos * east - sin * north
    through = ti.sqrt(ti.max(airspeed * airspeed - across * across, 0.0))
    return ti.max(along + through, LEAST_SHARE * airspeed)


def crab(airspeed: float, wind: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Heading less course [..] (rad) that keeps to a course in the wind [.., 2] at an airspeed (m/s)."""
    across = cos * wind[..., 1] - sin * wind[..., 0]  # to starboard
    return -torch.asin((across * (1 / airspeed)).clamp(-1.0, 1.0))


def strongest_wind(config: WorldConfig, height: float) -> float:
    """The strongest mean wind of any realisation plus `SIGMAS` of its slow variation (m/s) at `height` (m)."""
    air = config.air
    factor = float(wind_factor(air.profile, wind_shear(air), height))
    return factor * (bounds(config, "air.speed")[1] + SIGMAS * air.std)
