"""Avoidance of obstacles and team mates: of many velocities, the one with the lowest cost, which includes risk.

A desired velocity v* that passes everything sensed with room to spare is kept. Otherwise a fan of velocities is tried.
They are turned from v* by up to `FAN` to either side, and slowed down (velocity obstacles, Fiorini & Shiller 1998, Int.
J. Robotics Research 17(7), sampled). With v the present velocity, the v' of least cost is taken:

    J = |v' - v*| / |v*| + lean |v' - v| / |v*| + slowing (1 - |v'| / |v*|) + turning (1 - cos a)
        + the risks of all bodies,

where a is the angle between v' and the heading. Without the third term a vehicle that comes up from behind would stay
there, slowly, instead of passing. Without the fourth a vessel in waves keeps changing the side on which it passes: its
velocity swings with the waves, its heading does not.

A vehicle whose slot surrounds a target, itself an obstacle, also tries shares of its closing velocity: at full speed
the risks say that it cannot stop in time. It then evades at its own speed, not the slot's, which may be far away and
differ.

A vehicle changes its velocity with an acceleration a, in T = |v' - v| / a. It is then where it would be if it had begun
(v - v') T / 2 further on (acceleration-velocity obstacles, van den Berg, Snape, Guy & Manocha 2011, ICRA). The risk of
a body is the greater of the risks from that place and from the present one. Body and vehicle continue, the vehicle
turning as its formation does, to their least distance d at time t (s):

    risk = (1 - t / horizon)^2 (soft sat(1 - (d - R) / berth) + hard (1 - d / R) where d < R),

R is the sum of the radii. For team mates the risk at t = `parting` also counts, if given and greater: a mate that
approaches so slowly that it is nearest after the horizon is left in time. Bodies above or below by more than the
vehicle's radius and the berth are ignored.

Followers keep clear of their leader. The leader avoids followers only at the last moment, because their slots move
with it. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportOptionalCall=false, reportIndexIssue=false

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.guidance.knowledge import Knowledge, KnownPack, TeamKernel
from rl.guidance.targets_and_errors import COURSE_RATE, SLOT_VELOCITY, row_of
from rl.guidance.targets_and_errors import V as VELOCITY
from rl.perception.sensors import Mate, Obstacle
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import EAST, NORTH
from taichi_sim.kernels.packs import values_at
from taichi_sim.kernels.rotation import HEADING_COS
from taichi_sim.kernels.runtime import array3
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle

FAN, RAYS = math.radians(100.0), 20  # to either side, and how many
PACES = (1.0, 0.75, 0.5)
"""Shares of the desired or the slot's speed, whichever is less; a vehicle that cannot stop tries the first alone."""
CHASES, CALM = (0.7, 0.45, 0.25, 0.1), 0.5  # shares of the velocity to a slot about a target; cost of staying
SLOWEST = 0.1  # m/s: a slower velocity has no direction
STEPS = 5  # number of shares of a correction that are tried
SOONEST = 0.5  # s: lower bound of t, so that leaving a berth is better than moving along it
ROUNDING = 1e-3  # of a bound that must hold in spite of rounding
WITHOUT_END = 1e30  # more than any risk


class AvoidanceGains(Strict):
    """Gains of avoidance. Controllers add their own; `[TEAM.control]` of a scenario sets them, and taichi-sim tune
    tunes."""

    lengths: ClassVar[tuple[str, ...]] = ("berth", "margin")
    """Gains that a vehicle of another size scales by its length."""

    acceleration: Positive  # a, m/s^2
    horizon: Positive = 8.0  # s
    berth: Positive = 3.0  # m, beyond contact with an obstacle
    margin: Positive = 2.0  # m, likewise, with a team mate
    follower_horizon: Positive = 6.0  # s that a follower looks ahead for team mates, which do likewise
    leader_horizon: Positive = 2.0  # s that a leader looks ahead
    soft: Positive = 4.0
    hard: Positive = 20.0
    lean: Positive = 0.2
    slowing: NonNegative = 0.6
    turning: NonNegative = 0.0
    parting: NonNegative = 0.0  # s from now at which a gap to a team mate inside the margin counts too; 0: at the least


class Wanted(NamedTuple):
    """Demand of a controller's guidance to its inner loops; some controllers add fields."""

    velocity: Tensor  # [env, vehicle, 2 or 3] v*, NED, m/s


class SlotController(Remembers, ABC):
    """A classical controller that holds slots, in two steps between which a residual policy may correct it.

    `Gains` is the class of its gains; `gains` are those that it was built from.
    """

    Gains: ClassVar[type[AvoidanceGains]]
    gains: AvoidanceGains

    @abstractmethod
    def __init__(self, model: Vehicle, gains: AvoidanceGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains` (default: those of `Gains`)."""

    def __call__(self, team: Knowledge) -> Tensor:
        """Actions [env, vehicle, action] in [-1, 1]."""
        return self.act(team, self.wanted(team))

    @abstractmethod
    def wanted(self, team: Knowledge) -> Wanted:
        """The velocity command that leads to the slots, and what else the controller adds to it."""

    @abstractmethod
    def act(self, team: Knowledge, wanted: Wanted) -> Tensor:
        """Actions [env, vehicle, action] in [-1, 1] that follow the command."""


@ti.func
def nearest(place, v, its, turn, horizon):
    """Time (s) and distance (m) of the closest approach to a body at `place` (m), which moves with `its`."""
    w = v - its
    t = ti.min(ti.max(place.dot(w) / ti.max(w.dot(w), 1e-6), SOONEST), horizon)
    half = 0.5 * turn * t
    w = ti.Vector([v[0] - half * v[1], v[1] + half * v[0]]) - its  # on the chord of its arc
    t = ti.min(ti.max(place.dot(w) / ti.max(w.dot(w), 1e-6), SOONEST), horizon)
    return t, (place - t * w).norm()


@ti.func
def danger(d, R, berth, part, g: ti.template()):
    """Risk of being d (m) away from a body when the share `part` of the horizon has passed."""
    soft = ti.min(ti.max(1.0 - (d - R) / berth, 0.0), 1.0)
    share = ti.max(1.0 - part, 0.0)
    return share * share * (g.soft * soft + g.hard * ti.max(1.0 - d / R, 0.0))


@ti.func
def risk(place, v, its, turn, shift, R, berth, horizon, g: ti.template()):
    """Risk of a body at `place` (m, relative) for a vehicle that begins `shift` (m) from its present place."""
    worst = R * 0.0
    for k in ti.static(range(2)):
        t, d = nearest(place - k * shift, v, its, turn, horizon)
        worst = ti.max(worst, danger(d, R, berth, t / horizon, g))
    return worst


@ti.func
def risks(v, now, around: ti.template(), e, i, enough, g: ti.template(), form: ti.template()):
    """Sum of the risks of all bodies near vehicle i, if it changed from velocity `now` to v (m/s).

    Bodies are left out once the sum reaches `enough`.
    """
    change, turn = v - now, around.target[e, row_of(around.target, i), COURSE_RATE]
    shift = change * (-0.5 * change.norm() / g.acceleration)
    total = g.radius * 0.0
    for k in ti.static(range(form.obstacles)):
        n = ti.Vector([around.obstacles[e, i, k, Obstacle.NORTH], around.obstacles[e, i, k, Obstacle.EAST]])
        level = around.obstacles[e, i, k, Obstacle.LEVEL]
        aside = around.obstacles[e, i, k, Obstacle.DISTANCE] - ti.max(level, 0.0)  # above or below
        if n.dot(n) > 0 and aside < g.radius + g.berth and total < enough:
            its = ti.Vector([around.obstacles[e, i, k, Obstacle.V_NORTH], around.obstacles[e, i, k, Obstacle.V_EAST]])
            size = around.obstacles[e, i, k, Obstacle.RADIUS]
            total += risk((level + size) * n, v, its, turn, shift, size + g.radius, g.berth, g.horizon, g)
    for k in ti.static(range(form.mates)):
        n = ti.Vector([around.mates[e, i, k, Mate.NORTH], around.mates[e, i, k, Mate.EAST]])
        its = ti.Vector([around.mates[e, i, k, Mate.V_NORTH], around.mates[e, i, k, Mate.V_EAST]])
        away = around.mates[e, i, k, Mate.DISTANCE]
        beside = away * ti.abs(around.mates[e, i, k, Mate.DOWN]) < 2 * g.radius + g.margin
        if n.dot(n) > 0 and beside and total < enough:
            horizon = ti.min(g.horizon, ti.select(i > 0, g.follower_horizon, g.leader_horizon))
            R, place = 2 * g.radius, away * n
            worst = risk(place, v, its, 0.0, shift, R, g.margin, horizon, g)
            if g.parting > 0:
                worst = ti.max(
                    worst, danger((place - g.parting * (v - its)).norm(), R, g.margin, g.parting / horizon, g)
                )
            total += worst
    return total


@ti.func
def off_heading(v, heading):
    """1 - cosine of the angle between v and the unit vector `heading`."""
    return 1.0 - v.dot(heading) / ti.max(v.norm(), SLOWEST)


@ti.func
def apart(a, b):
    """|a - b|."""
    return (a - b).norm()


@ti.kernel
def _avoid(velocity: array3, around: KnownPack, kind: ti.template(), form: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(velocity.shape[0], velocity.shape[1]):
        g = values_at(kind, around.numbers)
        direct = taken(velocity, e, i, NORTH, 2)
        now = taken(around.derived, e, i, VELOCITY, 2)
        slot = taken(around.table, e, i, SLOT_VELOCITY, 2)
        speed = ti.max(direct.norm(), SLOWEST)
        least = risks(direct, now, around, e, i, WITHOUT_END, g, form)
        if least > 0:
            share, best = ti.min(ti.max(slot.norm(), SLOWEST) / speed, 1.0), direct
            straight = ti.Vector([share * direct[0], share * direct[1]])
            heading = taken(around.derived, e, i, HEADING_COS, 2)
            least += g.lean * apart(direct, now) / speed + g.turning * off_heading(direct, heading)
            stay = least * 0.0  # the cost of not closing at all
            if ti.static(form.about):
                stay = CALM * apart(direct, slot) / speed
                straight = direct
                chases = ti.Vector(CHASES)
                for k in range(ti.static(len(CHASES))):
                    v = slot + chases[k] * (direct - slot)
                    cost = stay * (1.0 - chases[k]) + g.lean * apart(v, now) / speed
                    if cost < least:
                        cost += risks(v, now, around, e, i, least - cost, g, form)
                        if cost < least:
                            least, best = cost, v
            paces, length = ti.Vector(PACES), straight.norm()
            for j in range(2 * RAYS + 1):  # from the middle outwards, to either side in turn
                ray = (j + 1) // 2
                angle = (ray - 2 * ray * (j % 2)) * ti.static(FAN / RAYS)
                c, s = ti.cos(angle), ti.sin(angle)
                if ti.select(c > 0, ti.abs(s), 1.0) * length >= ti.static(1.0 + ROUNDING) * least * speed:
                    break  # this ray and those further out are too far from `straight`
                along = ti.Vector([c * straight[0] - s * straight[1], s * straight[0] + c * straight[1]])
                for p in range(ti.static(len(PACES) if form.stops else 1)):
                    v = paces[p] * along
                    cost = (apart(v, straight) + g.lean * apart(v, now)) / speed
                    cost += g.slowing * (1.0 - paces[p]) + g.turning * off_heading(v, heading)
                    if cost < least:
                        cost += risks(v, now, around, e, i, least - cost, g, form)
                        if cost < least:
                            least, best = cost, v
            velocity[e, i, NORTH], velocity[e, i, EAST] = best[0], best[1]


@ti.kernel
def _shield(velocity: array3, correction: array3, around: KnownPack, kind: ti.template(), form: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(velocity.shape[0], velocity.shape[1]):
        g = values_at(kind, around.numbers)
        own, change = taken(velocity, e, i, NORTH, 2), taken(correction, e, i, NORTH, 2)
        now = taken(around.derived, e, i, VELOCITY, 2)
        speed = ti.max(own.norm(), SLOWEST)
        best = ti.Vector([own[0] + change[0], own[1] + change[1]])
        least = risks(best, now, around, e, i, WITHOUT_END, g, form)
        if least > 0:
            for k in range(1, ti.static(STEPS + 1)):
                back = k * ti.static(1.0 / STEPS)
                cost = back * change.norm() / speed
                if cost < least:
                    cost += risks(own + (1.0 - back) * change, now, around, e, i, least - cost, g, form)
                    if cost < least:
                        least, best = cost, own + (1.0 - back) * change
        velocity[e, i, NORTH], velocity[e, i, EAST] = best[0], best[1]


class Avoider:
    """Collision avoidance of a team."""

    def __init__(self, gains: AvoidanceGains, kernel: Callable[..., object] = _avoid):
        """Use these gains; `kernel` chooses among velocities."""
        self._kernel = TeamKernel(kernel, gains.model_dump(include=set(AvoidanceGains.model_fields)), runtime.MEDIUM)

    def __call__(self, team: Knowledge, velocity: Tensor, *correction: Tensor) -> Tensor:
        """The velocity [env, vehicle, 2 or 3] (m/s) nearest to `velocity` with which `team` keeps clear."""
        return self._kernel(team, velocity.clone(memory_format=torch.contiguous_format), *correction)


class Shield(Avoider):
    """Scales down a correction of the velocity command where it adds more collision risk than it is worth.

    Of a correction c to the velocity v, it keeps the share s in [0, 1] that minimises  (1 - s) |c| / |v| + the sum of
    the risks of all bodies at the velocity v + s c. It is called with the correction (level, m/s), too.
    """

    def __init__(self, gains: AvoidanceGains):
        """Use these gains."""
        super().__init__(gains, _shield)
