"""How an episode ends: [env, vehicle] flags with a reason each, kept apart from running out of time."""

from functools import reduce
from operator import or_
from typing import NamedTuple

from torch import Tensor

from taichi_sim.conventions import ELEVATION

LARGEST_STALL = 3.0  # s beyond the stall angle: a stall that is not recovered by then is an end; assumed


class UsvEndings(NamedTuple):
    """Why USVs stop, each [env, vehicle] bool."""

    collided: Tensor  # with an obstacle or a team mate
    lost: Tensor  # too far from its slot
    capsized: Tensor  # heeled past the angle from which the hull rights itself
    swamped: Tensor  # its deck is under water
    grounded: Tensor  # its keel touches the sea bed
    left: Tensor  # out of the area
    diverged: Tensor  # its state is no longer finite

    @property
    def any(self) -> Tensor:
        """[env, vehicle]: this vehicle's episode has terminated."""
        return reduce(or_, self)


class UavEndings(NamedTuple):
    """Why UAVs stop, each [env, vehicle] bool."""

    collided: Tensor  # with an obstacle or a team mate
    lost: Tensor  # too far from its slot
    crashed: Tensor  # into the sea, a wave's crest included
    stalled: Tensor  # and not recovered
    left: Tensor  # out of the area
    diverged: Tensor  # its state is no longer finite

    @property
    def any(self) -> Tensor:
        """[env, vehicle]: this vehicle's episode has terminated."""
        return reduce(or_, self)


Endings = UsvEndings | UavEndings


def collided(gap: Tensor) -> Tensor:
    """Contact with an obstacle or a team mate: the gap (m) has closed."""
    return gap < 0.0


def lost(distance: Tensor, limit: float) -> Tensor:
    """Further than `limit` (m) from the slot."""
    return distance > limit


def capsized(quaternion_nb: Tensor, vanishing_cosine: float) -> Tensor:
    """The cosine of the tilt, R_nb[2, 2], has reached that of the angle of vanishing stability."""
    x, y = quaternion_nb[..., 1], quaternion_nb[..., 2]
    return 1 - 2 * (x * x + y * y) <= vanishing_cosine


def swamped(position_n: Tensor, surface: Tensor, deck_height: float) -> Tensor:
    """The mean surface under the hull (`surface` as in conventions.py) stands above the deck, `deck_height` (m) up."""
    return position_n[..., 2] + surface[..., ELEVATION] > deck_height


def grounded(position_n: Tensor, draft: float, depth: float | None) -> Tensor:
    """The keel, `draft` (m) below the origin, reaches the bottom of water `depth` (m) deep; None is deep."""
    return position_n[..., 2] > (float("inf") if depth is None else depth - draft)


def lowest_point(position_n: Tensor, derived: Tensor, span: float) -> Tensor:
    """Height (m) above mean sea level of an aircraft's lower wing tip, or its middle where that is lower.

    `derived` as in kinematics.py: its R_nb[2, 1] is the sine of the wings' tilt.
    """
    return -position_n[..., 2] - 0.5 * span * derived[..., 7].abs()


def in_the_sea(height: Tensor, elevation: Tensor) -> Tensor:
    """`height` (m) above mean sea level has met the surface, `elevation` (m) above it."""
    return height <= elevation


def stalled(stall_time: Tensor) -> Tensor:
    """Beyond the stall angle for too long: `stall_time` in s."""
    return stall_time > LARGEST_STALL


def outside(position_n: Tensor, area: float) -> Tensor:
    """Horizontally outside the square of side `area` (m)."""
    return position_n[..., :2].abs().amax(-1) > area / 2


def diverged(state: Tensor, distance: Tensor) -> Tensor:
    """The state, or the distance to a slot behind a diverged leader, is not finite: every other test is false then."""
    return ~(state.sum(-1) + distance).isfinite()
