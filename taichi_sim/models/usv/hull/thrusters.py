"""Thrusters as vehicle files describe them, and as kernels use them (thruster_set.py).

    [thrusters]        two equal propellers that push along the hull, one to port and one to starboard [actuators.NAME]
    up to eight thrusters, each by itself: a propeller (direction_deg = 0), a tunnel thruster (90), or
                       an azimuth thruster (turn_rate_deg)

In both cases the thrust is T = k |n| n at the speed n (Fossen 2021, sec. 9.1), with one k ahead and one astern. Losses
due to inflow, to the wake of another thruster, along the hull (Coanda) and to ventilation in waves are not modelled.
"""

from collections.abc import Iterator
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import model_validator

from taichi_sim.config import Finite, NonNegative, NonPositive, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.models.usv.vessel_base import Lag

Vector3 = tuple[Finite, Finite, Finite]
Along = Annotated[Finite, Plausible(1e-3, 0.6, "m", of="length", either=True)]
Across = Annotated[Finite, Plausible(1e-3, 0.6, "m", of="beam", either=True)]
Depth = Annotated[Finite, Plausible(-0.1, 1.5, "m", of="height")]  # propellers are under water
Port = Annotated[Finite, Plausible(-0.6, -0.03, "m", of="beam")]
Starboard = Annotated[Finite, Plausible(0.03, 0.6, "m", of="beam")]
TurnLeft = Annotated[NonPositive, Plausible(-180.0, -3.0, "deg")]
TurnRight = Annotated[NonNegative, Plausible(3.0, 180.0, "deg")]
MOST_THRUSTERS = 8
DIGITS = 12  # digits of cosines and sines of directions, so that 90 degrees have no part ahead


class Thruster(NamedTuple):
    """A thruster as kernels use it. Without a `turn_rate` it is fixed; without `turns` it turns all round."""

    name: str
    position: Vector3  # m, b
    direction: tuple[float, float]  # cosine and sine of the direction of its push when it is not turned
    k_positive: float  # thrust over speed squared, N / (rad/s)^2, or N
    k_negative: float
    n_max: float  # highest speed, rad/s, or 1
    n_min: float
    turn_rate: float = 0.0  # rad/s
    turns: tuple[float, float] | None = None  # smallest and largest angle from `direction`, rad

    @property
    def azimuth(self) -> bool:
        """Whether it can turn."""
        return self.turn_rate > 0

    @property
    def all_round(self) -> bool:
        """Whether it turns without a limit."""
        return self.azimuth and self.turns is None

    @property
    def reaches_round(self) -> bool:
        """Whether an azimuth thruster can push in every direction: it turns all round, or half round with thrust both
        ways.
        """
        return self.turns is None or (self.thrust_min < 0 and self.turns[1] - self.turns[0] >= np.pi - 1e-9)

    @property
    def span(self) -> tuple[float, float]:
        """Smallest and largest angle that can be commanded, rad."""
        return self.turns or (-np.pi, np.pi)

    @property
    def thrust_max(self) -> float:
        """Largest thrust, N."""
        return self.k_positive * self.n_max**2

    @property
    def thrust_min(self) -> float:
        """Smallest thrust, N, not above 0."""
        return -self.k_negative * self.n_min**2

    @property
    def arm(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Loads (six numbers, about CO, b) of a push of 1 N ahead, and of 1 N to starboard."""
        x, y, z = self.position
        return (1.0, 0.0, 0.0, 0.0, z, -y), (0.0, 1.0, 0.0, -z, 0.0, x)

    @property
    def wrench(self) -> tuple[float, ...]:
        """Load (six numbers, about CO, b) of a thrust of 1 N when the thruster is not turned."""
        c, s = self.direction
        return tuple(c * ahead + s * right for ahead, right in zip(*self.arm, strict=True))

    @property
    def ahead(self) -> float:
        """Largest push ahead, N."""
        low, high = self.span if self.azimuth else (0.0, 0.0)
        share = np.cos(np.arctan2(self.direction[1], self.direction[0]) + np.linspace(low, high, 361))
        return float(max(share.max() * self.thrust_max, share.min() * self.thrust_min, 0.0))


class PropellerPair(Strict):
    """`[thrusters]`: two propellers that push along the hull.

    Commands are made as if the gains were 1, because a controller does not know them.
    """

    left: tuple[Along, Port, Depth]  # position of the left propeller
    right: tuple[Along, Starboard, Depth]
    k_positive: Annotated[Positive, Plausible(2e-4, 2.0, "N s^2", of="mass g n_max^-2")]  # N / (rad/s)^2, ahead
    k_negative: Annotated[Positive, Plausible(0.03, 3.0, "N s^2", of="k_positive")]  # N / (rad/s)^2, astern
    n_max: Annotated[Positive, Plausible(2.0, 4000.0, "rad/s")]
    n_min: Annotated[NonPositive, Plausible(-2.0, -0.02, "rad/s", of="n_max")]
    lag: Lag  # time constant of the shaft speed
    # factor of its thrust; below 1, the propeller is fouled or damaged
    gain_left: Annotated[NonNegative, Plausible(0.05, 2.0)] = 1.0
    gain_right: Annotated[NonNegative, Plausible(0.05, 2.0)] = 1.0

    @model_validator(mode="before")
    @classmethod
    def _not_by_name(cls, given):
        tables = [key for key, value in given.items() if isinstance(value, dict)] if isinstance(given, dict) else []
        if tables:
            raise ValueError(
                "[thrusters] is two propellers, left and right; thrusters with names have sections of their own, "
                f"[actuators.{tables[0]}]"
            )
        return given

    thrust_max, thrust_min = Thruster.thrust_max, Thruster.thrust_min  # of one propeller with gain 1, N

    @property
    def both(self) -> tuple[Thruster, Thruster]:
        """Left and right propeller as kernels use them."""
        left, right = (
            Thruster(name, at, (1.0, 0.0), self.k_positive, self.k_negative, self.n_max, self.n_min)
            for name, at in (("left", self.left), ("right", self.right))
        )
        return left, right


class NamedThruster(Strict):
    """`[actuators.NAME]`: one thruster. Its thrust is quadratic in its speed: thrust_max at n_max, thrust_min at n_min.

    Commands are made as if the gain were 1, because a controller does not know it.
    """

    position: tuple[Along, Across, Depth]  # b
    # direction of a positive push on the hull, when not turned: 0 ahead, 90 starboard
    direction_deg: Annotated[Finite, Plausible(3.0, 360.0, "deg", either=True)] = 0.0
    thrust_max: Annotated[Positive, Plausible(1e-4, 2.0, "N", of="mass g")]
    # in the opposite direction; 0: none
    thrust_min: Annotated[NonPositive, Plausible(-1.5, -0.02, "N", of="thrust_max")]
    # rad/s; without it, speeds are shares of the highest
    n_max: Annotated[Positive, Plausible(2.0, 4000.0, "rad/s")] | None = None
    n_min: Annotated[NonPositive, Plausible(-2.0, -0.02, "rad/s", of="n_max")] | None = None  # default -n_max
    lag: Lag  # time constant of the speed
    turn_rate_deg: Annotated[NonNegative, Plausible(0.5, 720.0, "deg/s")] = 0.0  # highest turn rate; 0: fixed
    range_deg: tuple[TurnLeft, TurnRight] | None = None  # range of its angle, clockwise; None: all round
    # factor of its thrust; below 1, the thruster is fouled or damaged
    gain: Annotated[NonNegative, Plausible(0.05, 2.0)] = 1.0

    def _mistakes(self) -> Iterator[str]:
        if self.range_deg and not self.turn_rate_deg:
            yield "range_deg is for a thruster that turns: give turn_rate_deg (deg/s), too"
        if self.range_deg and max(map(abs, self.range_deg)) > 180.0:
            yield f"range_deg = {list(self.range_deg)} must lie between -180 and 180"
        if self.n_min is not None and self.n_max is None:
            yield "n_min needs n_max"
        if self.thrust_min < 0 and self.n_min == 0:
            yield f"n_min = 0 cannot make thrust_min = {self.thrust_min}"

    def thruster(self, name: str) -> Thruster:
        """Convert to the form that kernels use."""
        n_max = self.n_max or 1.0
        n_min = 0.0 if self.thrust_min == 0 else -n_max if self.n_min is None else self.n_min
        k_positive, angle = self.thrust_max / n_max**2, np.deg2rad(self.direction_deg)
        return Thruster(
            name,
            self.position,
            (round(float(np.cos(angle)), DIGITS) + 0.0, round(float(np.sin(angle)), DIGITS) + 0.0),
            k_positive,
            -self.thrust_min / n_min**2 if n_min else k_positive,
            n_max,
            n_min,
            float(np.deg2rad(self.turn_rate_deg)),
            self.range_deg and (float(np.deg2rad(self.range_deg[0])), float(np.deg2rad(self.range_deg[1]))),
        )
