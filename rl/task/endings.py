"""How an episode ends: [env, vehicle] flags with a reason each, kept apart from running out of time."""

from typing import NamedTuple

from torch import Tensor

CRASH_ALTITUDE = 0.0  # m above the wave-free sea: a UAV's origin below it has touched the water
CAPSIZE_COSINE = 0.0  # of the tilt: the mast is level or below


class Endings(NamedTuple):
    """Why vehicles stop, each [env, vehicle] bool."""

    collided: Tensor  # with an obstacle or a team mate
    lost: Tensor  # too far from its slot
    crashed: Tensor  # USV capsized, UAV in the sea
    left: Tensor  # out of the area
    diverged: Tensor  # its state is no longer finite

    @property
    def any(self) -> Tensor:
        """[env, vehicle]: this vehicle's episode has terminated."""
        return self.collided | self.lost | self.crashed | self.left | self.diverged


def collided(gap: Tensor) -> Tensor:
    """Contact with an obstacle or a team mate: the gap (m) has closed."""
    return gap < 0.0


def lost(distance: Tensor, limit: float) -> Tensor:
    """Further than `limit` (m) from the slot."""
    return distance > limit


def capsized(quaternion_nb: Tensor) -> Tensor:
    """The body's down axis points up or level: R_nb[2, 2] <= 0."""
    x, y = quaternion_nb[..., 1], quaternion_nb[..., 2]
    return 1 - 2 * (x * x + y * y) <= CAPSIZE_COSINE


def in_the_sea(position_n: Tensor) -> Tensor:
    """A UAV at or below the sea."""
    return position_n[..., 2] >= -CRASH_ALTITUDE


def outside(position_n: Tensor, area: float) -> Tensor:
    """Horizontally outside the square of side `area` (m)."""
    return position_n[..., :2].abs().amax(-1) > area / 2


def diverged(state: Tensor, distance: Tensor) -> Tensor:
    """The state, or the distance to a slot behind a diverged leader, is not finite: every other test is false then."""
    return ~(state.sum(-1) + distance).isfinite()
