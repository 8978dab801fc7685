"""Where a team's vehicles are relative to their slots: one kernel from state to errors.

The leader's slot is the target. A follower's is the leader's position plus an offset in the path frame, whose first
axis is the target's course (slots.py); it moves with the leader, and swings about it as the course turns.

Errors are vectors in n, and in the vehicle's own frame: its body frame (3 axes), or the heading frame (2: ahead,
starboard), which stays level.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import taichi as ti
import torch
from torch import Tensor

from rl.missions.formation.targets import COS, COURSE_RATE, DOWN, EAST, NORTH, SIN, SPEED
from taichi_sim.fleet import Fleet
from taichi_sim.kinematics import HEADING_COS, HEADING_SIN, VELOCITY_N
from taichi_sim.runtime import Launcher

DISTANCE_SCALE = 10.0  # m, where squashed distances are half way to 1
NEAR = 1e-3  # m: nearer than this a slot is in no direction
V = VELOCITY_N.start

# Columns of the table of errors, each three wide but for the distance and what is seen (distance and direction).
SLOT, SLOT_VELOCITY, ERROR, ERROR_RATE, ERROR_B, ERROR_RATE_B, COURSE_B = range(0, 21, 3)
DISTANCE, SIGHT, PREVIOUS_SIGHT, SIZE = 21, 22, 26, 30


@ti.func
def slot_of(target: ti.template(), e, ahead, starboard):
    """Offset in n (m) of a follower's slot from the leader, and its velocity (m/s) about it."""
    c, s, rate = target[e, COS], target[e, SIN], target[e, COURSE_RATE]
    north, east = c * ahead - s * starboard, s * ahead + c * starboard
    return ti.Vector([north, east, 0.0]), ti.Vector([-rate * east, rate * north, 0.0])


@ti.func
def own_frame(derived: ti.template(), e, i, axes: ti.template(), v):
    """v [3] in n as a vector of vehicle i's own frame; its third part is 0 in the heading frame."""
    own = ti.Vector([0.0, 0.0, 0.0])
    if ti.static(axes == 3):
        for a in ti.static(range(3)):
            own[a] = derived[e, i, a] * v[0] + derived[e, i, 3 + a] * v[1] + derived[e, i, 6 + a] * v[2]
    else:
        c, s = derived[e, i, HEADING_COS], derived[e, i, HEADING_SIN]
        own = ti.Vector([c * v[0] + s * v[1], c * v[1] - s * v[0], 0.0])
    return own


@ti.kernel
def _measure(
    table: ti.types.ndarray(ndim=3),
    target: ti.types.ndarray(ndim=2),
    down: ti.types.ndarray(ndim=1),
    offsets: ti.types.ndarray(ndim=2),
    state: ti.types.ndarray(ndim=3),
    derived: ti.types.ndarray(ndim=3),
    which: ti.types.ndarray(dtype=ti.i32, ndim=1),
    axes: ti.template(),
):
    for e, i in ti.ndrange(state.shape[0], state.shape[1]):
        if which[e] != 0:
            offset, swing = slot_of(target, e, offsets[i, 0], offsets[i, 1])
            place = ti.Vector([target[e, NORTH], target[e, EAST], target[e, DOWN] + down[0]])
            moves = target[e, SPEED] * ti.Vector([target[e, COS], target[e, SIN], 0.0])
            if i > 0:
                for a in ti.static(range(3)):
                    place[a], moves[a] = state[e, 0, a] + offset[a], derived[e, 0, V + a] + swing[a]
            error, rate = place, moves
            for a in ti.static(range(3)):
                error[a], rate[a] = place[a] - state[e, i, a], moves[a] - derived[e, i, V + a]
            error_b, rate_b = own_frame(derived, e, i, axes, error), own_frame(derived, e, i, axes, rate)
            course_b = own_frame(derived, e, i, axes, ti.Vector([target[e, COS], target[e, SIN], 0.0]))
            distance = error_b.norm()
            seen = ti.Vector([distance / (distance + DISTANCE_SCALE), 0.0, 0.0, 0.0])
            for a in ti.static(range(3)):
                seen[1 + a] = error_b[a] / ti.max(distance, NEAR)
            for k in ti.static(range(4)):
                table[e, i, PREVIOUS_SIGHT + k] = ti.select(which[e] == 1, table[e, i, SIGHT + k], seen[k])
                table[e, i, SIGHT + k] = seen[k]
            table[e, i, DISTANCE] = distance
            for a in ti.static(range(3)):
                table[e, i, SLOT + a], table[e, i, SLOT_VELOCITY + a] = place[a], moves[a]
                table[e, i, ERROR + a], table[e, i, ERROR_RATE + a] = error[a], rate[a]
                table[e, i, ERROR_B + a], table[e, i, ERROR_RATE_B + a] = error_b[a], rate_b[a]
                table[e, i, COURSE_B + a] = course_b[a]


class Geometry:
    """Errors of a team as of the last step or reset: live views of one table, overwritten by the next.

    Attributes, [env, vehicle, ..]:
        slot, slot_velocity: [.., 3] position and velocity of the slot, NED, m and m/s.
        error, error_rate: [.., 3] slot minus vehicle, NED, m and m/s. distance: [..] length of `error_b`, m.
        error_b, error_rate_b, course_b: [.., axes] both, and the unit vector of the target's course, in its own frame.
        sight, previous_sight: [.., 1 + axes] squashed distance and unit direction in its own frame, as of the last
            step and of the one before.
    """

    def __init__(self, fleet: Fleet, target: Tensor, down: float, offsets: Tensor, axes: int):
        """Measure `fleet` against `target` (targets.py) at `down` (m), slots at `offsets` [vehicle, 2] from it."""
        state = fleet.state
        self.table = state.new_zeros((*state.shape[:2], SIZE))
        self.axes, self._launch = axes, Launcher(_measure)
        down_n = state.new_tensor([down])
        self._args = target, down_n, offsets.to(state).contiguous(), state, fleet.derived
        self.slot, self.slot_velocity = self._view(SLOT, 3), self._view(SLOT_VELOCITY, 3)
        self.error, self.error_rate = self._view(ERROR, 3), self._view(ERROR_RATE, 3)
        self.error_b, self.error_rate_b = self._view(ERROR_B, axes), self._view(ERROR_RATE_B, axes)
        self.course_b, self.distance = self._view(COURSE_B, axes), self.table[..., DISTANCE]
        self.sight, self.previous_sight = self._view(SIGHT, 1 + axes), self._view(PREVIOUS_SIGHT, 1 + axes)

    def _view(self, first: int, width: int) -> Tensor:
        return self.table[..., first : first + width]

    def measure(self, which: Tensor) -> None:
        """Measure environments [env] int32: 0 not at all, 1 after a step, 2 at the beginning of an episode."""
        self._launch(self.table, *self._args, which, self.axes)


def squash(x: Tensor, scale: float) -> Tensor:
    """x / (|x| + scale): linear near zero, bounded by 1."""
    return x / (x.abs() + scale)


def to_body(vectors: Tensor, derived: Tensor, axes: int) -> Tensor:
    """NED vectors [env, vehicle, k, 3] in the body frame (axes 3) or the heading frame (axes 2)."""
    if axes == 3:
        R_nb = derived[..., :9].unflatten(-1, (3, 3))
        return vectors @ R_nb
    c, s = derived[..., HEADING_COS, None], derived[..., HEADING_SIN, None]
    north, east = vectors[..., 0], vectors[..., 1]
    return torch.stack((c * north + s * east, c * east - s * north), dim=-1)
