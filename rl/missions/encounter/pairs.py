"""What happens between an own ship and each other body, by the truth: gaps, roles by the rules, and manoeuvres.

A pair has a role as soon as there is risk of collision: within `DETECTED` times `notice` of the nearest approach, and
closer than `clear` there, if both went on. It is latched until they are past and clear (rule 13(d)). With b the
bearing of the other, C its course less ours, b' our bearing from it:

    overtaking  b' more than 22.5 degrees abaft its beam, |C| <= 67.5, faster than it along our course    (rule 13)
    overtaken   the same of it
    head-on     |b| <= 10, |C| >= 170                                                                     (rule 14)
    give way    it crosses from starboard, 0 <= b <= 112.5                                                (rule 15, 16)
    stand on    it crosses from port                                                                      (rule 17)

(Xu et al. 2020 has 5 degrees for head-on; "when in doubt", rule 14(c), it is head-on.) Courses are headings, averaged
over `STEADY` against waves; those that count are from the latch to the nearest approach. Gaps between rectangles are
taken in `MOMENTS` moments of a decision.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false, reportOptionalCall=false

import math
from enum import IntEnum
from typing import NamedTuple

import taichi as ti
from torch import Tensor

from rl.missions.encounter.bodies import Body, rectangle_gap
from rl.missions.encounter.config import EncounterScenario
from rl.step import BEGINS, NOT_DUE, Due
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.runtime import array1, array3, array4, whole1
from taichi_sim.state.memory import Remembers

MOMENTS = 4
STEADY = 5.0  # s, assumed
DEG = math.pi / 180
FARTHEST = 1e6  # m, gap to nobody
ACTS = 10.0 * DEG  # change of course that is a manoeuvre; assumed
SLOWS = 0.2  # share of the speed, likewise
DETECTED = 2.0  # times `notice` before the nearest approach; assumed
PAST = 1.0  # of `notice`: longer after the nearest approach, or `clear` apart, a pair is past and clear


class Role(IntEnum):
    """Of an own ship towards another body."""

    NONE, HEAD_ON, GIVE_WAY, STAND_ON, OVERTAKING, OVERTAKEN = range(6)


class Pair(IntEnum):
    """Columns of a pair.

    GAP now and LEAST of the episode (m); RISK in [0, 1]; ROLE now. Of the first role of the episode, KIND: RANGE (m,
    between centres) and COURSE, SPEED of the own ship at the latch, ACTED the range at its first manoeuvre (0: none),
    FIRST the change of course then (rad), STARBOARD, PORT (rad) and SLOWED the greatest changes, EARLY the greatest
    of them before the middle stage (rad), NEAR the least gap, NEAR_RANGE the range there, CONTACT and BEARING there
    (rad: ours from it, it from us).
    """

    (
        GAP, LEAST, RISK, ROLE, KIND, RANGE, COURSE, SPEED, ACTED, FIRST, STARBOARD, PORT, SLOWED, EARLY, NEAR,
        NEAR_RANGE, CONTACT, BEARING, SIZE,
    ) = range(19)  # fmt: skip


class PairNumbers(NamedTuple):
    """Numbers of the kernel, SI."""

    interval: float
    clear: float
    notice: float
    reach: float


@ti.func
def within(x):
    """Angle x (rad) in (-pi, pi]."""
    return x - ti.static(2 * math.pi) * ti.round(x / ti.static(2 * math.pi))


@ti.func
def role_of(b, C, back, own, its):
    """The role by bearing b, difference of courses C, bearing `back` of us from it, and speeds (m/s)."""
    role = ti.cast(int(Role.NONE), ti.i32)
    if ti.abs(back) > 112.5 * DEG and ti.abs(C) <= 67.5 * DEG and own > its * ti.cos(C):
        role = ti.cast(int(Role.OVERTAKING), ti.i32)
    elif ti.abs(b) > 112.5 * DEG and ti.abs(C) <= 67.5 * DEG and its > own * ti.cos(C):
        role = ti.cast(int(Role.OVERTAKEN), ti.i32)
    elif ti.abs(b) <= 10.0 * DEG and ti.abs(C) >= 170.0 * DEG:
        role = ti.cast(int(Role.HEAD_ON), ti.i32)
    elif b >= 0 and b <= 112.5 * DEG:
        role = ti.cast(int(Role.GIVE_WAY), ti.i32)
    elif b < 0 and b >= -112.5 * DEG:
        role = ti.cast(int(Role.STAND_ON), ti.i32)
    return role


@ti.kernel
def _measure(
    pairs: array4, steady: array3, bodies: array3, before: array3, numbers: array1, which: whole1, kind: ti.template()
):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(pairs.shape[0], pairs.shape[1]):
        if which[e] != NOT_DUE:
            g = values_at(kind, numbers)
            begins = which[e] == BEGINS
            a0, a1 = ti.Vector([before[e, i, 0], before[e, i, 1]]), ti.Vector([bodies[e, i, 0], bodies[e, i, 1]])
            ac, as_ = bodies[e, i, Body.COS], bodies[e, i, Body.SIN]
            al, ab = bodies[e, i, Body.LENGTH], bodies[e, i, Body.BEAM]
            v = ti.Vector([bodies[e, i, Body.V_NORTH], bodies[e, i, Body.V_EAST]])
            share = ti.select(begins, 1.0, g.interval / (STEADY + g.interval))
            steady[e, i, 0] += share * (ac - steady[e, i, 0])
            steady[e, i, 1] += share * (as_ - steady[e, i, 1])
            steady[e, i, 2] += share * (v.norm() - steady[e, i, 2])
            course, speed = ti.atan2(steady[e, i, 1], steady[e, i, 0]), steady[e, i, 2]
            for j in range(pairs.shape[2]):
                if begins:
                    for c in ti.static(range(Pair.SIZE)):
                        pairs[e, i, j, c] = 0.0
                    pairs[e, i, j, Pair.LEAST], pairs[e, i, j, Pair.NEAR] = FARTHEST, FARTHEST
                if j == i:
                    pairs[e, i, j, Pair.GAP] = FARTHEST
                    continue
                b0, b1 = ti.Vector([before[e, j, 0], before[e, j, 1]]), ti.Vector([bodies[e, j, 0], bodies[e, j, 1]])
                bc, bs = bodies[e, j, Body.COS], bodies[e, j, Body.SIN]
                bl, bb = bodies[e, j, Body.LENGTH], bodies[e, j, Body.BEAM]
                its = ti.Vector([bodies[e, j, Body.V_NORTH], bodies[e, j, Body.V_EAST]])
                to, w = b1 - a1, v - its
                far, gap = to.norm(), a0[0] * 0.0 + FARTHEST
                if far < 0.5 * (al + ab + bl + bb) + g.reach:
                    gap = rectangle_gap(a1, ac, as_, al, ab, b1, bc, bs, bl, bb)
                    if not begins:
                        for m in range(1, MOMENTS):
                            s = m / ti.static(float(MOMENTS))
                            a, b = a0 + s * (a1 - a0), b0 + s * (b1 - b0)
                            gap = ti.min(gap, rectangle_gap(a, ac, as_, al, ab, b, bc, bs, bl, bb))
                else:
                    gap = far - 0.5 * (al + bl)
                closing = to.dot(w) / ti.max(w.dot(w), 1e-4)  # s until the nearest approach
                miss = (to - ti.max(closing, 0.0) * w).norm() - 0.5 * (ab + bl)
                risk = 0.0
                if closing > 0:
                    soon = ti.max(1.0 - closing / g.notice, 0.0)
                    risk = soon * ti.min(ti.max(1.0 - miss / g.clear, 0.0), 1.0)
                pairs[e, i, j, Pair.GAP], pairs[e, i, j, Pair.RISK] = gap, risk
                pairs[e, i, j, Pair.LEAST] = ti.min(pairs[e, i, j, Pair.LEAST], gap)
                bearing = within(ti.atan2(to[1], to[0]) - course)
                its_course = ti.atan2(bs, bc)
                back = within(ti.atan2(-to[1], -to[0]) - its_course)
                role = ti.cast(pairs[e, i, j, Pair.ROLE], ti.i32)
                if role == 0 and closing > 0 and closing < ti.static(DETECTED) * g.notice and miss < g.clear:
                    role = role_of(bearing, within(its_course - course), back, speed, its.norm())
                    if role != 0 and pairs[e, i, j, Pair.RANGE] == 0:  # the first encounter of an episode is scored
                        pairs[e, i, j, Pair.RANGE], pairs[e, i, j, Pair.KIND] = far, role
                        pairs[e, i, j, Pair.COURSE], pairs[e, i, j, Pair.SPEED] = course, ti.max(speed, 0.1)
                elif role != 0 and closing < 0 and (gap > g.clear or closing < -PAST * g.notice):
                    role = 0
                pairs[e, i, j, Pair.ROLE] = role
                if role != 0 and gap < pairs[e, i, j, Pair.NEAR]:
                    pairs[e, i, j, Pair.NEAR], pairs[e, i, j, Pair.NEAR_RANGE] = gap, far
                    pairs[e, i, j, Pair.CONTACT], pairs[e, i, j, Pair.BEARING] = back, bearing
                if role != 0 and closing > 0:
                    turned = within(course - pairs[e, i, j, Pair.COURSE])
                    slowed = ti.max(1.0 - speed / pairs[e, i, j, Pair.SPEED], 0.0)
                    pairs[e, i, j, Pair.STARBOARD] = ti.max(pairs[e, i, j, Pair.STARBOARD], turned)
                    pairs[e, i, j, Pair.PORT] = ti.max(pairs[e, i, j, Pair.PORT], -turned)
                    pairs[e, i, j, Pair.SLOWED] = ti.max(pairs[e, i, j, Pair.SLOWED], slowed)
                    if closing > 0.5 * g.notice:
                        pairs[e, i, j, Pair.EARLY] = ti.max(pairs[e, i, j, Pair.EARLY], ti.abs(turned))
                    if pairs[e, i, j, Pair.ACTED] == 0 and (ti.abs(turned) > ACTS or slowed > SLOWS):
                        pairs[e, i, j, Pair.ACTED], pairs[e, i, j, Pair.FIRST] = far, turned


class Pairs(Remembers):
    """All pairs, [env, own ship, body, Pair]; see the module.

    Attributes:
        table: the pairs. steady: [env, own ship, 3], averaged heading (cosine, sine) and speed (m/s).
    """

    def __init__(self, config: EncounterScenario, bodies: Tensor, own: int):
        """Measure the pairs of the first `own` of `bodies` [env, body, Body] with all."""
        self.table = self.remember(bodies.new_zeros((bodies.shape[0], own, bodies.shape[1], Pair.SIZE)))
        self.steady = self.remember(bodies.new_zeros((bodies.shape[0], own, 3)))
        part = config.encounter
        numbers = PairNumbers(config.decision_interval, part.clear, part.notice, 4 * part.clear)
        self._numbers = bodies.new_tensor(numbers)
        self._launch = runtime.Launcher(_measure, plain=True, few=runtime.MEDIUM)

    def measure(self, bodies: Tensor, before: Tensor, due: Due) -> None:
        """Measure where it is `due`; `before` are the bodies a decision ago."""
        kind = struct_of(PairNumbers._fields, runtime.current().precision)
        self._launch(self.table, self.steady, bodies, before, self._numbers, due.which, kind, envs=due.count)

    def of(self, column: int) -> Tensor:
        """A column [env, own ship, body], a live view."""
        return self.table[..., column]

    @property
    def gap(self) -> Tensor:
        """Least gap (m) of each own ship now, [env, own ship]."""
        return self.of(Pair.GAP).amin(-1)
