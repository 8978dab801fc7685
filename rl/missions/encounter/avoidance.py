"""SB-MPC: of 39 offsets of course and speed the one with the least cost, by the danger of all tracks and by the rules.

Johansen, Perez & Cristofaro (2016), Ship collision avoidance and COLREGS compliance using simulation-based control
behavior selection with predictive hazard assessment, IEEE T-ITS 17(12), 3407-3422. Candidates are course offsets x of
-90 to 90 degrees in steps of 15 and speed factors P of 1, 0.5 and 0. Each is held over the horizon T, and others go
straight on:

    H = max_i (C_i R_i + rule mu_i) + slow (1 - P) + turn x^2 + hold_speed |P - P'| + hold_(starboard, port) (x - x')^2
    R_i = max_t (safe / d)^sharpness T / t  where d < safe, else 0;    C_i = collision |v - v_i|^2 / U^2
    mu_i = 1 where d < close and the other is to starboard, and we meet head-on or cross (rules 14 and 15)

with P', x' those in force, U the planned speed. Unlike the paper, t and speeds are dimensionless (T, U), so that one
set of numbers serves boats and ships; d is the gap from a circle about the shorter hull to the longer, a capsule,
and is taken where straight lines are nearest, in `SAMPLES` moments; and the vessel's turn is taken into account by
its lag: a change of velocity begins (v - v') lag further on (acceleration-velocity obstacles, van den Berg et al.
2011, ICRA).

With l the direction to the other, it is to starboard where v x l > 0; we meet head-on or cross where v.v_i < cos 68.5
|v||v_i|, a condition that head-on courses meet, too, and that one who overtakes does not.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import math
from typing import Protocol

import taichi as ti
import torch
from torch import Tensor

from rl.missions.encounter.bodies import Body, Track
from rl.missions.encounter.config import EncounterConfig
from taichi_sim.config import NonNegative, Positive, Strict
from taichi_sim.kernels import runtime
from taichi_sim.kernels.packs import struct_of, values_at
from taichi_sim.kernels.runtime import array1, array3, array4

TURNS, SLOWS = 13, 3  # candidates: course offsets, speed factors
TURN = math.radians(15.0)
CANDIDATES = TURNS * SLOWS
SAMPLES = 7  # moments about the nearest one
NEAREST = 0.2  # of `safe`: nearer gaps are no more dangerous
SOONEST = 0.05  # of the horizon: earlier dangers are no greater
STILL = 0.05  # m/s: slower bodies have no course
ABEAM_COS = math.cos(math.radians(68.5))  # of the angle between two courses that cross


class SbmpcGains(Strict):
    """Numbers of SB-MPC; `[TEAM.control]` of a scenario sets them, and taichi-sim tune tunes."""

    horizon: Positive = 150.0  # T, s
    close: Positive = 120.0  # m
    safe: Positive = 40.0  # m
    collision: Positive = 0.1
    rule: Positive = 3.0
    slow: Positive = 2.5
    turn: Positive = 1.3  # of rad^2
    hold_speed: Positive = 2.0
    hold_starboard: Positive = 0.9
    hold_port: Positive = 1.2
    sharpness: Positive = 4.0
    lag: NonNegative = 3.0  # s


@ti.func
def danger(start, v, hull, tracks: ti.template(), e, i, j, planned, g: ti.template()):
    """C R + rule mu of track j for a vessel that sails from `start` with velocity v, and the least gap (m)."""
    its = ti.Vector([tracks[e, i, j, Track.V_NORTH], tracks[e, i, j, Track.V_EAST]])
    p = ti.Vector([tracks[e, i, j, Track.NORTH], tracks[e, i, j, Track.EAST]]) - start
    w, long, beam = v - its, tracks[e, i, j, Track.LENGTH], tracks[e, i, j, Track.BEAM]
    speed, own, theirs = ti.sqrt(ti.max(w.dot(w), ti.static(STILL * STILL))), v.norm(), its.norm()
    nearest = ti.min(ti.max(p.dot(w) / (speed * speed), 0.0), g.horizon)
    size, cost = 0.5 * (hull[0] + long), p[0] * 0.0
    gap = (p - nearest * w).norm() - size
    if gap < g.close:
        fore, fast, broad = its, theirs, beam  # of the longer of the two
        if hull[0] > long:
            fore, fast, broad, long = v, own, hull[1], hull[0]
        along = ti.Vector([1.0, 0.0])
        if fast > STILL:
            along = fore / fast
        half, off = 0.5 * (long - broad), 0.5 * broad + size - 0.5 * long
        step = (size + g.safe) / (ti.static(SAMPLES // 2) * speed)
        across = v.dot(its)
        crossing = across < ti.static(ABEAM_COS) * own * theirs and own > STILL and theirs > STILL
        risk, breaks = cost, cost
        gap = cost + 1e9
        for k in range(SAMPLES):
            t = ti.min(ti.max(nearest + (k - ti.static(SAMPLES // 2)) * step, 0.0), g.horizon)
            r = t * w - p  # own place from the other's
            x, y = r.dot(along), along[0] * r[1] - along[1] * r[0]
            x = ti.max(ti.abs(x) - half, 0.0)
            d = ti.sqrt(x * x + y * y) - off
            gap = ti.min(gap, d)
            if d < g.safe:
                share = g.safe / ti.max(d, NEAREST * g.safe)
                soon = ti.max(t / g.horizon, SOONEST)
                risk = ti.max(risk, ti.pow(share, g.sharpness) / soon)
            if d < g.close and crossing and r[0] * v[1] - r[1] * v[0] > 0:
                breaks = 1.0
        cost = g.collision * speed * speed / (planned * planned) * risk + g.rule * breaks
    return cost, gap


@ti.func
def offset_of(k):
    """Course offset (rad) and speed factor of candidate k: starboard and full speed first."""
    return (k % TURNS - ti.static(TURNS // 2)) * TURN, 1.0 - 0.5 * (k // TURNS)


def nearest(offsets: Tensor) -> Tensor:
    """The candidates, int64 [..], nearest to offsets [.., 2] of course (rad) and speed (factor)."""
    turn = (offsets[..., 0] / TURN).round().clamp(-(TURNS // 2), TURNS // 2) + TURNS // 2
    return (turn + TURNS * (2.0 * (1.0 - offsets[..., 1])).round().clamp(0, SLOWS - 1)).long()


@ti.func
def danger_of(k, here, now, hull, lag, route, without, planned, tracks: ti.template(), e, i, g: ti.template()):
    """Greatest danger of candidate k for a vessel at `here` with velocity `now`, over all tracks, and the least gap.

    Its course is `route` with an offset, and `without` one.
    """
    x, P = offset_of(k)
    course = ti.select(x == 0.0, without, route + x)
    v = P * planned * ti.Vector([ti.cos(course), ti.sin(course)])
    start, worst, clear = here + lag * (now - v), here[0] * 0.0, here[0] * 0.0 + 1e9
    for j in range(tracks.shape[2]):
        if tracks[e, i, j, Track.AGE] >= 0:
            cost, gap = danger(start, v, hull, tracks, e, i, j, planned, g)
            worst, clear = ti.max(worst, cost), ti.min(clear, gap)
    return worst, clear


@ti.func
def effort(k, held_x, held_P, g: ti.template()):
    """Cost of candidate k without danger, while (held_x, held_P) is in force."""
    x, P = offset_of(k)
    change = x - held_x
    hold = ti.select(change > 0, g.hold_starboard, g.hold_port)
    return g.slow * (1.0 - P) + g.turn * x * x + g.hold_speed * ti.abs(P - held_P) + hold * change * change


@ti.kernel
def _weigh(
    fan: array4, best: array3, tracks: array4, bodies: array3, courses: array3, held: array3, numbers: array1,
    kind: ti.template(),
):  # fmt: skip
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(fan.shape[0], fan.shape[1]):
        g = values_at(kind, numbers)
        here = ti.Vector([bodies[e, i, Body.NORTH], bodies[e, i, Body.EAST]])
        now = ti.Vector([bodies[e, i, Body.V_NORTH], bodies[e, i, Body.V_EAST]])
        hull = ti.Vector([bodies[e, i, Body.LENGTH], bodies[e, i, Body.BEAM]])
        least, which = here[0] * 0.0 + 1e30, 0
        for k in range(CANDIDATES):
            worst, clear = danger_of(
                k, here, now, hull, g.lag, courses[e, i, 0], courses[e, i, 1], g.planned, tracks, e, i, g
            )
            fan[e, i, k, 0], fan[e, i, k, 1] = worst, clear
            cost = worst + effort(k, held[e, i, 0], held[e, i, 1], g)
            if cost < least:
                least, which = cost, k
        x, P = offset_of(which)
        best[e, i, 0], best[e, i, 1] = x, P


class Decides(Protocol):
    """What `Plans` read of a team of own ships (team.py)."""

    part: EncounterConfig
    offsets: Tensor

    @property
    def here(self) -> Tensor:
        """Bodies of the own ships [env, own ship, Body]."""
        ...

    @property
    def courses(self) -> Tensor:
        """Course of the route, and the course without an offset (rad), [env, own ship, 2]."""
        ...

    @property
    def tracks(self) -> Tensor:
        """Tracks [env, own ship, body, Track]."""
        ...


class Plans:
    """The candidates of a team of own ships, weighed by these `gains`."""

    def __init__(self, gains: SbmpcGains):
        """Take the gains."""
        self.gains = gains
        self._launch = runtime.Launcher(_weigh, plain=True, few=runtime.LARGE)

    def __call__(self, team: Decides) -> tuple[Tensor, Tensor]:
        """Danger and least gap (m) of each candidate [env, own ship, CANDIDATES, 2], and the offsets [.., 2] of least
        cost: of course (rad), and the factor of speed.
        """
        here = team.here.contiguous()
        numbers = {"planned": team.part.speed, **self.gains.model_dump()}
        fan = here.new_empty((*here.shape[:2], CANDIDATES, 2))
        best = torch.empty_like(team.offsets)
        kind = struct_of(tuple(numbers), runtime.current().precision)
        self._launch.once(
            fan, best, team.tracks, here, team.courses, team.offsets.contiguous(),
            here.new_tensor(tuple(numbers.values())), kind,
        )  # fmt: skip
        return fan, best
