"""One thruster: its numbers, as vehicle files give them and as kernels take them, and its thrust.

    [thrusters]        two propellers of one kind that push along the hull, one to port and one to starboard
    [actuators.NAME]   up to eight, each by itself: a propeller (direction_deg = 0), a tunnel thruster (90), or one that
                       turns (turn_rate_deg)

Either way the thrust is T = k |n| n at the speed n (Fossen 2021, sec. 9.1), with one k ahead and one astern. Not
modelled: losses to inflow, to the wake of another thruster, along the hull (Coanda), or when a wave lays it bare. How
thrusters follow their commands, and their loads on the hull: thruster_set.py.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

from typing import Annotated, NamedTuple

import numpy as np
import taichi as ti
from pydantic import Field, model_validator

from taichi_sim.config import Finite, NonNegative, Positive, Strict

Vector3 = tuple[Finite, Finite, Finite]
NonPositive = Annotated[float, Field(le=0, allow_inf_nan=False)]
MOST_THRUSTERS = 8
DIGITS = 12  # to which cosines and sines of directions are rounded, so that 90 degrees have no part ahead


class Thruster(NamedTuple):
    """A thruster as kernels take it. Without a `turn_rate` it cannot turn; without `turns` it turns all round."""

    name: str
    position: Vector3  # m, b
    direction: tuple[float, float]  # cosine and sine of where it pushes when it is not turned
    k_positive: float  # N over the speed squared
    k_negative: float
    n_max: float  # speed; rad/s, or 1
    n_min: float
    turn_rate: float = 0.0  # rad/s
    turns: tuple[float, float] | None = None  # lowest and greatest angle from `direction`, rad

    @property
    def azimuth(self) -> bool:
        """Whether it can turn."""
        return self.turn_rate > 0

    @property
    def all_round(self) -> bool:
        """Whether it turns without a stop."""
        return self.azimuth and self.turns is None

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and greatest angle that can be commanded, rad."""
        return self.turns or (-np.pi, np.pi)

    @property
    def thrust_max(self) -> float:
        """N."""
        return self.k_positive * self.n_max**2

    @property
    def thrust_min(self) -> float:
        """N, not above 0."""
        return -self.k_negative * self.n_min**2

    @property
    def arm(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Loads (six numbers, about CO, b) of a push of 1 N ahead, and of one to starboard."""
        x, y, z = self.position
        return (1.0, 0.0, 0.0, 0.0, z, -y), (0.0, 1.0, 0.0, -z, 0.0, x)

    @property
    def wrench(self) -> tuple[float, ...]:
        """Load (six numbers, about CO, b) of a thrust of 1 N when it is not turned."""
        c, s = self.direction
        return tuple(c * ahead + s * right for ahead, right in zip(*self.arm, strict=True))

    @property
    def ahead(self) -> float:
        """The most that it pushes ahead, N."""
        low, high = self.span if self.azimuth else (0.0, 0.0)
        share = np.cos(np.arctan2(self.direction[1], self.direction[0]) + np.linspace(low, high, 361))
        return float(max(share.max() * self.thrust_max, share.min() * self.thrust_min, 0.0))


class PropellerPair(Strict):
    """`[thrusters]`: two propellers that push along the hull.

    Commands are made as if the gains were 1: nobody who steers knows them.
    """

    left: Vector3  # m, position of the left one
    right: Vector3  # m
    k_positive: Positive  # N / (rad/s)^2, ahead
    k_negative: Positive  # N / (rad/s)^2, astern
    n_max: Positive  # rad/s
    n_min: NonPositive  # rad/s
    lag: NonNegative  # s, time constant of the shaft speed
    gain_left: NonNegative = 1.0  # of its thrust at a shaft speed: below 1, it is fouled or damaged
    gain_right: NonNegative = 1.0

    @model_validator(mode="before")
    @classmethod
    def _not_by_name(cls, given):
        tables = [key for key, value in given.items() if isinstance(value, dict)] if isinstance(given, dict) else []
        if tables:
            raise ValueError(
                "[thrusters] is two propellers, left and right; thrusters with names are sections of their own, "
                f"[actuators.{tables[0]}]"
            )
        return given

    @property
    def thrust_max(self) -> float:
        """Of one thruster ahead whose gain is 1, N."""
        return self.k_positive * self.n_max**2

    @property
    def thrust_min(self) -> float:
        """Of one thruster astern whose gain is 1 (negative), N."""
        return -self.k_negative * self.n_min**2

    @property
    def both(self) -> tuple[Thruster, Thruster]:
        """Left and right, as kernels take them."""
        left, right = (
            Thruster(name, at, (1.0, 0.0), self.k_positive, self.k_negative, self.n_max, self.n_min)
            for name, at in (("left", self.left), ("right", self.right))
        )
        return left, right


class NamedThruster(Strict):
    """`[actuators.NAME]`: one thruster. Its thrust goes with the square of its speed, to thrust_max at n_max and to
    thrust_min at n_min.

    Commands are made as if the gain were 1: nobody who steers knows it.
    """

    position: Vector3  # m, b
    direction_deg: Finite = 0.0  # where a thrust above 0 pushes the hull (if it turns: unturned): 0 ahead, 90 starboard
    thrust_max: Positive  # N
    thrust_min: NonPositive  # N, the other way; 0: none
    n_max: Positive | None = None  # rad/s; without it speeds are shares of the greatest
    n_min: NonPositive | None = None  # rad/s, default -n_max
    lag: NonNegative  # s, time constant of the speed
    turn_rate_deg: NonNegative = 0.0  # deg/s, the fastest that it turns; 0: it does not
    range_deg: tuple[NonPositive, NonNegative] | None = None  # that it turns in, clockwise from above; None: all round
    gain: NonNegative = 1.0  # of its thrust at a speed: below 1, it is fouled or damaged

    @model_validator(mode="after")
    def _consistent(self):
        if self.range_deg and not self.turn_rate_deg:
            raise ValueError("range_deg is of a thruster that turns: give turn_rate_deg (deg/s) too")
        if self.range_deg and max(map(abs, self.range_deg)) > 180.0:
            raise ValueError(f"range_deg = {list(self.range_deg)} must lie between -180 and 180")
        if self.n_min is not None and self.n_max is None:
            raise ValueError("n_min needs n_max")
        if self.thrust_min < 0 and self.n_min == 0:
            raise ValueError(f"n_min = 0 makes no thrust_min = {self.thrust_min}")
        return self

    def thruster(self, name: str) -> Thruster:
        """As kernels take it."""
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


@ti.func
def thrust(t: ti.template(), n):
    """Thrust (N) of a Thruster, of gain 1, at the speed n (rad/s), limited to its range."""
    n = ti.max(ti.min(n, t.n_max), t.n_min)
    k = ti.select(n > 0, t.k_positive, t.k_negative)
    return k * ti.abs(n) * n


@ti.func
def shaft_speed(t: ti.template(), force):
    """Speed (rad/s) at which the thrust is `force` (N)."""
    k = ti.select(force > 0, t.k_positive, t.k_negative)
    n = ti.sqrt(ti.abs(force) / k)
    return ti.select(force > 0, n, -n)
