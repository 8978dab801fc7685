"""Numbers of a hull's thrusters, as vehicle files give them, and what kernels make of them: units.

    [thrusters]        two propellers of one kind that push along the hull, one to port and one to starboard
    [actuators.NAME]   up to eight, each by itself: a propeller (direction_deg = 0), a tunnel thruster (90), or one that
                       turns (turn_rate_deg)

Either way a unit's thrust is k |n| n at the speed n, which follows its command with a first-order lag; one that turns
does so at no more than its rate. Not modelled: what a thruster loses to inflow, to the wake of another, along the hull
(Coanda), or when a wave lays it bare.
"""

from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from taichi_sim.config import Finite, NonNegative, Positive, Strict

Vector3 = tuple[Finite, Finite, Finite]
NonPositive = Annotated[float, Field(le=0, allow_inf_nan=False)]
MOST = 8  # units
DIGITS = 12  # to which cosines and sines of directions are rounded, so that 90 degrees have no part ahead


class Unit(NamedTuple):
    """One thruster; `direction` is the cosine and sine of where it pushes when it is not turned, `turn_rate` (rad/s) is
    0 where it cannot turn, `turns` the lowest and greatest angle (rad) from there, None of one that turns all round.
    """

    name: str
    position: Vector3  # m, b
    direction: tuple[float, float]
    k_positive: float  # N over the speed squared
    k_negative: float
    n_max: float  # speed; rad/s, or 1
    n_min: float
    turn_rate: float = 0.0
    turns: tuple[float, float] | None = None

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


class Thrusters(Strict):
    """Two propellers that push along the hull: thrust gain k |n| n, first-order lag and limits of the shaft speed.

    The gains are what nobody at the controls knows: commands (`actions`) are made as if they were 1.
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
    def units(self) -> tuple[Unit, ...]:
        """Left and right."""
        return tuple(
            Unit(name, at, (1.0, 0.0), self.k_positive, self.k_negative, self.n_max, self.n_min)
            for name, at in (("left", self.left), ("right", self.right))
        )


class Actuator(Strict):
    """A thruster by itself: `thrust_max` at the speed n_max, `thrust_min` at n_min, as the square of it between.

    The gain is what nobody at the controls knows: commands (`actions`) are made as if it were 1.
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

    def unit(self, name: str) -> Unit:
        """What kernels work with."""
        n_max = self.n_max or 1.0
        n_min = 0.0 if self.thrust_min == 0 else -n_max if self.n_min is None else self.n_min
        k_positive, angle = self.thrust_max / n_max**2, np.deg2rad(self.direction_deg)
        return Unit(
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
