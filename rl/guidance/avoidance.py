"""Velocities that keep clear of obstacles and of team mates: the best of many, by where each would lead.

A wanted velocity that passes all that is sensed with room to spare is left as it is. Else a fan of velocities is tried,
turned from the wanted one by up to `FAN` to either side and slowed down (velocity obstacles, Fiorini & Shiller 1998,
Int. J. Robotics Research 17(7), sampled), and the one v' of the least cost is taken, v being the one there is:

    J = |v' - v*| / |v*| + lean |v' - v| / |v*| + slowing (1 - |v'| / |v*|) + the risks of all bodies.

Without its third term a vehicle that comes up from behind would rather stay there, slowly, than pass. Whose slot is
about a target that is itself to be kept clear of also tries to go there with a share of the chase: at full speed it
would not stop in time, as far as the risks know; and evades at its own speed, not at the slot's, from which it may be
far.

A vehicle does not change its velocity at once: with an acceleration a it takes T = |v' - v| / a, and is then where it
would be if it had begun (v - v') T / 2 further on (acceleration-velocity obstacles, van den Berg, Snape, Guy & Manocha
2011, ICRA). The risk of a body is the greater of what it is from there and from where the vehicle is. Each goes on, the
vehicle turning as its formation does, to the least distance d between them, t seconds from now:

    risk = (1 - t / horizon)^2 (soft sat(1 - (d - R) / berth) + hard (1 - d / R) where d < R),

R being the sum of the radii. Of team mates the same at t = `parting`, if that is given, counts where it is more: one
that comes nearer so slowly that it will be nearest after the horizon is left in time. Above or below by more than the
own radius and the berth nothing is in the way.

Followers keep clear of their leader, and it of them in the last moment alone: their slots go where it goes. Frame: NED.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false

import math
from typing import NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.guidance.geometry import SLOT_VELOCITY, row_of
from rl.guidance.geometry import V as VELOCITY
from rl.guidance.knowledge import Knowledge
from rl.guidance.targets import COURSE_RATE
from rl.perception.columns import Mate, Obstacle
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of, values_at

FAN, RAYS = math.radians(100.0), 20  # to either side, and how many
PACES = (1.0, 0.75, 0.5)  # of the wanted speed, or of the slot's, if that is less; of who can stop, else the first
CHASES, CALM = (0.7, 0.45, 0.25, 0.1), 0.5  # of the way to a slot about a target; the cost of not going all of it
SLOWEST = 0.1  # m/s: less has no direction
STEPS = 5  # in which a correction is taken back
SOONEST = 0.5  # s: t is at least that, so that out of a berth is better than along it
AVOID = 1500.0  # ns of one vehicle, about: few have something in their way

_array1, _array2, _array3, _array4 = (ti.types.ndarray(ndim=n) for n in (1, 2, 3, 4))
AroundPack = ti.types.argpack(
    obstacles=_array4, mates=_array4, table=_array3, derived=_array3, target=_array3, numbers=_array1
)


class Gains(Strict):
    """Numbers of a controller that may be tuned, `[TEAM.control]` of a scenario; these are of avoidance."""

    acceleration: Positive  # a, m/s^2
    horizon: Positive = 8.0  # s
    berth: Positive = 3.0  # m, beyond contact with an obstacle
    margin: Positive = 2.0  # m, likewise, with a team mate
    follower_horizon: Positive = 6.0  # s that a follower looks ahead for its mates, who do likewise
    leader_horizon: Positive = 2.0  # s that a leader does
    soft: Positive = 4.0
    hard: Positive = 20.0
    lean: Positive = 0.2
    slowing: NonNegative = 0.6
    parting: NonNegative = 0.0  # s from now at which a gap to a team mate inside the margin counts too; 0: at the least


class Numbers(NamedTuple):
    """What the kernel works with: `Gains`, and the vehicle's radius, m."""

    acceleration: float
    horizon: float
    berth: float
    margin: float
    follower_horizon: float
    leader_horizon: float
    soft: float
    hard: float
    lean: float
    slowing: float
    parting: float
    radius: float


class Wanted(NamedTuple):
    """What a controller wants to be flown; some have more in it."""

    velocity: Tensor  # [env, vehicle, 2 or 3] v*, NED, m/s


class Form(NamedTuple):
    """What the kernel is compiled for."""

    obstacles: int
    mates: int
    paces: tuple[float, ...]
    chases: tuple[float, ...]  # shares of the chase of a slot that is about a target
    serial: bool  # on the calling thread


@ti.func
def nearest(place, v, its, turn, horizon):
    """When (s) a vehicle that moves with v and turns (rad/s) is nearest to a body at `place` (m) that moves with `its`,
    and how near that is (m).
    """
    w = v - its
    t = ti.min(ti.max(place.dot(w) / ti.max(w.dot(w), 1e-6), SOONEST), horizon)
    half = 0.5 * turn * t
    w = ti.Vector([v[0] - half * v[1], v[1] + half * v[0]]) - its  # on the chord of its arc
    t = ti.min(ti.max(place.dot(w) / ti.max(w.dot(w), 1e-6), SOONEST), horizon)
    return t, (place - t * w).norm()


@ti.func
def danger(d, R, berth, part, g: ti.template()):
    """Of being d (m) away from a body when that part of the horizon has passed."""
    soft = ti.min(ti.max(1.0 - (d - R) / berth, 0.0), 1.0)
    share = ti.max(1.0 - part, 0.0)
    return share * share * (g.soft * soft + g.hard * ti.max(1.0 - d / R, 0.0))


@ti.func
def risk(place, v, its, turn, shift, R, berth, horizon, g: ti.template()):
    """Of a body at `place` (m, relative) for a vehicle that will have begun from `shift` (m)."""
    worst = R * 0.0
    for k in ti.static(range(2)):
        t, d = nearest(place - k * shift, v, its, turn, horizon)
        worst = ti.max(worst, danger(d, R, berth, t / horizon, g))
    return worst


@ti.func
def risks(v, now, around: ti.template(), e, i, g: ti.template(), form: ti.template()):
    """Of all bodies near vehicle i, if it went on with v instead of `now` (m/s)."""
    change, turn = v - now, around.target[e, row_of(around.target, i), COURSE_RATE]
    shift = change * (-0.5 * change.norm() / g.acceleration)
    total = g.radius * 0.0
    for k in ti.static(range(form.obstacles)):
        n = ti.Vector([around.obstacles[e, i, k, Obstacle.NORTH], around.obstacles[e, i, k, Obstacle.EAST]])
        level = around.obstacles[e, i, k, Obstacle.LEVEL]
        aside = around.obstacles[e, i, k, Obstacle.DISTANCE] - ti.max(level, 0.0)  # above or below
        if n.dot(n) > 0 and aside < g.radius + g.berth:
            its = ti.Vector([around.obstacles[e, i, k, Obstacle.V_NORTH], around.obstacles[e, i, k, Obstacle.V_EAST]])
            size = around.obstacles[e, i, k, Obstacle.RADIUS]
            total += risk((level + size) * n, v, its, turn, shift, size + g.radius, g.berth, g.horizon, g)
    for k in ti.static(range(form.mates)):
        n = ti.Vector([around.mates[e, i, k, Mate.NORTH], around.mates[e, i, k, Mate.EAST]])
        its = ti.Vector([around.mates[e, i, k, Mate.V_NORTH], around.mates[e, i, k, Mate.V_EAST]])
        away = around.mates[e, i, k, Mate.DISTANCE]
        if n.dot(n) > 0 and away * ti.abs(around.mates[e, i, k, Mate.DOWN]) < 2 * g.radius + g.margin:
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
def apart(a, b):
    """|a - b|."""
    return (a - b).norm()


@ti.kernel
def _avoid(velocity: ti.types.ndarray(ndim=3), around: AroundPack, kind: ti.template(), form: ti.template()):
    ti.loop_config(serialize=form.serial)
    for e, i in ti.ndrange(velocity.shape[0], velocity.shape[1]):
        g = values_at(kind, around.numbers)
        direct = ti.Vector([velocity[e, i, 0], velocity[e, i, 1]])
        now = ti.Vector([around.derived[e, i, VELOCITY], around.derived[e, i, VELOCITY + 1]])
        slot = ti.Vector([around.table[e, i, SLOT_VELOCITY], around.table[e, i, SLOT_VELOCITY + 1]])
        speed = ti.max(direct.norm(), SLOWEST)
        least = risks(direct, now, around, e, i, g, form)
        if least > 0:
            share, best = ti.min(ti.max(slot.norm(), SLOWEST) / speed, 1.0), direct
            straight = ti.Vector([share * direct[0], share * direct[1]])
            least += g.lean * apart(direct, now) / speed
            stay = least * 0.0  # the cost of no chase at all
            if ti.static(len(form.chases) > 0):
                stay = CALM * apart(direct, slot) / speed
                straight = direct
            for k in ti.static(range(len(form.chases))):
                v = slot + ti.static(form.chases[k]) * (direct - slot)
                cost = stay * ti.static(1.0 - form.chases[k]) + g.lean * apart(v, now) / speed
                if cost < least:
                    cost += risks(v, now, around, e, i, g, form)
                    if cost < least:
                        least, best = cost, v
            for j in range(2 * RAYS + 1):
                angle = (j - RAYS) * ti.static(FAN / RAYS)
                c, s = ti.cos(angle), ti.sin(angle)
                along = ti.Vector([c * straight[0] - s * straight[1], s * straight[0] + c * straight[1]])
                for p in ti.static(range(len(form.paces))):
                    v = ti.static(form.paces[p]) * along
                    cost = (apart(v, straight) + g.lean * apart(v, now)) / speed
                    cost += g.slowing * ti.static(1.0 - form.paces[p])
                    if cost < least:
                        cost += risks(v, now, around, e, i, g, form)
                        if cost < least:
                            least, best = cost, v
            velocity[e, i, 0], velocity[e, i, 1] = best[0], best[1]


@ti.kernel
def _shield(velocity: ti.types.ndarray(ndim=3), correction: ti.types.ndarray(ndim=3), around: AroundPack,
            kind: ti.template(), form: ti.template()):  # fmt: skip
    ti.loop_config(serialize=form.serial)
    for e, i in ti.ndrange(velocity.shape[0], velocity.shape[1]):
        g = values_at(kind, around.numbers)
        own = ti.Vector([velocity[e, i, 0], velocity[e, i, 1]])
        change = ti.Vector([correction[e, i, 0], correction[e, i, 1]])
        now = ti.Vector([around.derived[e, i, VELOCITY], around.derived[e, i, VELOCITY + 1]])
        speed = ti.max(own.norm(), SLOWEST)
        best = ti.Vector([own[0] + change[0], own[1] + change[1]])
        least = risks(best, now, around, e, i, g, form)
        if least > 0:
            for k in range(1, ti.static(STEPS + 1)):
                back = k * ti.static(1.0 / STEPS)
                cost = back * change.norm() / speed
                if cost < least:
                    cost += risks(own + (1.0 - back) * change, now, around, e, i, g, form)
                    if cost < least:
                        least, best = cost, own + (1.0 - back) * change
        velocity[e, i, 0], velocity[e, i, 1] = best[0], best[1]


class Avoider:
    """Keeps a team clear."""

    def __init__(self, gains: Gains):
        """By these numbers."""
        self.gains = gains
        self._team: Knowledge | None = None
        self._launch = runtime.Launcher(_avoid)

    def __call__(self, team: Knowledge, velocity: Tensor) -> Tensor:
        """The velocity [env, vehicle, 2 or 3] (m/s) nearest to `velocity` with which `team` keeps clear."""
        if self._team is not team:
            self._bind(team)
        kept = velocity.clone(memory_format=torch.contiguous_format)
        kind = struct_of(Numbers._fields, runtime.current().precision)
        self._launch.once(kept, self._around(), kind, self._form)
        return kept

    def _bind(self, team: Knowledge) -> None:
        self._team, sensor = team, team.sensor
        numbers = Numbers(**{key: getattr(self.gains, key) for key in Numbers._fields[:-1]}, radius=team.radius)
        self._around = runtime.Packed(
            AroundPack, obstacles=sensor.obstacles, mates=sensor.team_mates, table=team.now.table,
            derived=team.fleet.derived, target=team.target.table, numbers=team.fleet.state.new_tensor(numbers),
        )  # fmt: skip
        few = runtime.few(team.fleet.num_envs * team.fleet.count, AVOID)
        paces = PACES if team.fleet.model.limits.stops else PACES[:1]
        chases = CHASES if team.now.about else ()
        self._form = Form(sensor.num_obstacles, sensor.num_mates, paces, chases, few)


class Shield(Avoider):
    """Takes corrections of velocities back as far as they lead where the risks are greater than they are worth.

    What is left of one is the share s of the least  (1 - s) |c| / |v| + the risks of all bodies with v + s c.
    """

    def __init__(self, gains: Gains):
        """By these numbers."""
        super().__init__(gains)
        self._launch = runtime.Launcher(_shield)

    def corrected(self, team: Knowledge, velocity: Tensor, correction: Tensor) -> Tensor:
        """`velocity` [env, vehicle, 2 or 3] (m/s) with what is safe of `correction`, of the same shape, level."""
        if self._team is not team:
            self._bind(team)
        kept = velocity.clone(memory_format=torch.contiguous_format)
        kind = struct_of(Numbers._fields, runtime.current().precision)
        self._launch.once(kept, correction.contiguous(), self._around(), kind, self._form)
        return kept
