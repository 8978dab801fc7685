"""What all vessels share: their base class with the endings of every mission, and the wind on the part above water."""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import Annotated

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from torch import Tensor

from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import DOWN, ELEVATION
from taichi_sim.kernels.rigid_body import Number
from taichi_sim.kernels.rotation import UPRIGHT
from taichi_sim.vehicle import Vehicle, Waters

__all__ = [
    "RHO_AIR", "Beam", "CollisionRadius", "Height", "Lag", "Length", "Number", "TopSpeed", "Vessel", "WaterDensity",
    "Windage", "steady_speed", "wind_forces",
]  # fmt: skip

RHO_AIR = 1.225  # kg/m^3, standard atmosphere at sea level
WaterDensity = Annotated[float, Field(ge=900, le=1100), Plausible(900.0, 1100.0, "kg/m^3")]  # fresh, warm to salt, cold
Length = Annotated[Positive, Plausible(0.3, 500.0, "m")]
Beam = Annotated[Positive, Plausible(0.03, 2.0, "m", of="length")]
Height = Annotated[Positive, Plausible(0.03, 3.0, "m", of="length")]
CollisionRadius = Annotated[Positive, Plausible(0.25, 3.0, "m", of="length")]
Lag = Annotated[NonNegative, Plausible(5e-3, 20.0, "s", of="length^0.5 g^-0.5")]
TopSpeed = Annotated[float, Plausible(0.02, 3.0, "m/s", of="length^0.5 g^0.5", far=2.0)]
"""Speed of a straight run at full thrust: fast planing boats have Froude numbers of 2 to 3."""
STILL = 1e-9  # m^2/s^2; avoids a division by zero without wind


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

    def endings(self, fleet: Fleet, world: Waters) -> dict[str, Tensor]:
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


class Windage(Strict):
    """Wind on the part above water, from the velocity (u, v) of the air relative to the hull, in b, q = 1/2 rho V^2:

        X = q c_x (u / V) A_f,   Y = q c_y (v / V) A_l,   N = -q c_n (2 u v / V^2) A_l L

    (Fossen 2021, eqs. 10.26-10.28). X and Y act at the height of the centre of the areas.
    """

    frontal_area: Annotated[NonNegative, Plausible(0.02, 2.0, "m^2", of="beam^2")] = 0.0  # A_f
    lateral_area: Annotated[NonNegative, Plausible(0.02, 2.0, "m^2", of="length beam")] = 0.0  # A_l
    c_x: Annotated[NonNegative, Plausible(0.1, 2.0)] = 0.7  # Fossen (2021), sec. 10.1: 0.50-0.90
    c_y: Annotated[NonNegative, Plausible(0.1, 2.0)] = 0.85  # Fossen (2021), sec. 10.1: 0.70-0.95
    c_n: Annotated[NonNegative, Plausible(5e-3, 0.5)] = 0.1  # Fossen (2021), sec. 10.1: 0.05-0.20
    height: Annotated[NonNegative, Plausible(0.03, 1.5, "m", of="height")] = 0.0  # of the centre of the areas above CO


@ti.func
def wind_forces(p: ti.template(), u, v):
    """[X Y N] (N, N m) of the wind that moves by u, v (m/s, b) relative to the hull; see `Windage`.

    `p` has wind_x = rho c_x A_f / 2, wind_y = rho c_y A_l / 2 and wind_n = rho c_n A_l L.
    """
    speed = ti.sqrt(u * u + v * v + STILL)
    # sin(2 gamma) V^2 = -2 u v: the moment acts towards the end that the wind meets first
    return ti.Vector([p.wind_x * speed * u, p.wind_y * speed * v, -p.wind_n * u * v])
