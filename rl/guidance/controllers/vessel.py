"""Classical control of displacement vessels (`hull_6dof`, `manoeuvring_3dof`): track control by surge force and yaw
moment, with gains that follow from a model of the vessel in the plane.

    m11 (u' - v r) = X - d_u(u),   m33 r' = N - d_r(r),   d(x) = (a + b |x| + c x^2) x.

The largest moment limits how quickly a vessel can turn. The heading loop has both poles at

    w = sqrt(N_max / (m33 heading_error)),

so that a heading error of heading_error takes the whole moment. The bandwidths of the slower loops around it are shares
of w. Sway decays at s = d_v / m22, and so the course chi follows the heading psi: chi' = s (psi - chi) + ... Where that
is slower than COURSE_SHARE w, the nose leads the course by `lead` times the course error, which gives
chi' = s (1 + lead) (chi* - chi). There is no lead where a yaw rate first pushes the hull outward: it would do harm.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportOptionalCall=false

import math
from typing import NamedTuple

import taichi as ti
import torch
from torch import Tensor

from rl.guidance.avoidance import AvoidanceGains, Avoider, SlotController
from rl.guidance.controllers.laws import approach, limited, push_of_waves, swung, wrapped, yaw_rate
from rl.guidance.controllers.sampled import decaying, place_poles
from rl.guidance.knowledge import Knowledge, KnownPack, TeamKernel
from rl.guidance.targets_and_errors import COS, COURSE_RATE, ERROR, SLOT_VELOCITY, SPEED, row_of
from rl.guidance.targets_and_errors import V as VELOCITY
from rl.team import ControllerError
from taichi_sim.config import NonNegative, Positive
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import EAST, NORTH, ROLL_RATE
from taichi_sim.kernels.packs import values_at
from taichi_sim.kernels.rotation import HEADING_COS
from taichi_sim.kernels.runtime import array3
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.hull.thruster_set import moment_alone
from taichi_sim.models.usv.hull.thrusters import PropellerPair
from taichi_sim.models.usv.manoeuvring_3dof import Manoeuvring3dof, Manoeuvring3dofParams
from taichi_sim.models.usv.vessel_base import steady_speed
from taichi_sim.state.memory import Remembers

SAMPLED_SHARE = 0.5  # limit of w times the decision interval; assumed
COURSE_SHARE = 0.3  # desired bandwidth of the course, as a share of w; assumed
MOST_LEAD = 3.0  # assumed
LAG_SHARE = 0.25  # limit of the poles of the position loop, as a share of s (1 + lead); assumed
LIFT_SHARE = 0.5  # speed at which the hull's lift counts, as a share of the top speed; assumed
SWAY_SHARE = 0.05  # sway at which its resistance is linearised, as a share of the top speed; assumed
LEAST_SHARE = 0.1  # a shorter velocity has no direction to follow; share of the top speed; assumed
RATE_SHARE = 0.9  # largest desired yaw rate, as a share of the top yaw rate; assumed
COURSE_TIME = 8.0  # s of the integral of the course error; assumed
COURSE_ERROR = 0.5  # sine of the course error: larger ones are turns; assumed
DRIFT_SHARE = 0.2  # of the top speed, the greatest drift; assumed
EVADING = 1e-3  # m/s: less of a change by avoidance is rounding
NO_SWAY = 1e-9  # 1/m: less of a sway force with a moment is rounding
NO_LIMIT = 1e6  # rad/s, of a vessel that nothing keeps from turning
MOST = 1e6  # m/s: a greater drift is that of a state that is not finite
SLOT, SHARE = 2, 4  # columns of what leads to the slots, behind the velocity
CHANGE = 2  # column of a command, behind the velocity
DRIFT, GIVEN, PLACE, MOVED = 0, 2, 4, 6  # columns of `Course.drift`


class CourseGains(AvoidanceGains):
    """Gains of track control (`Course`), besides those of avoidance."""

    heading_error: Positive = 0.35  # rad
    position_share: Positive = 0.11  # both poles of the position loop, as a share of w
    speed_bandwidth: Positive = 2.0  # rad/s, of the speed loop
    closing_share: Positive = 0.35  # limit of what an error adds to the slot's velocity, as a share of the top speed
    speed_share: Positive = 0.95  # largest desired speed, as a share of the top speed; above 1: full thrust from afar
    wave_share: NonNegative = 0.15  # share of the waves' push to starboard that a turn compensates


class Resistance(NamedTuple):
    """d(x) = (a + b |x| + c x^2) x (N, N m) against a motion x (m/s, rad/s) relative to the water."""

    a: float
    b: float = 0.0
    c: float = 0.0

    def steady(self, load: float) -> float:
        """The x > 0 with d(x) = `load` > 0; infinite without resistance."""
        return steady_speed(load, self.a, self.b, self.c)


class VesselDynamics(NamedTuple):
    """Inertia with added mass, resistance, and limits of the actuators."""

    m11: float  # kg
    m22: float  # kg
    m33: float  # kg m^2
    surge: Resistance
    sway: Resistance
    yaw: Resistance
    thrust: float  # N, ahead
    moment: float  # N m, to either side
    sway_yaw: float = 0.0  # d23, N s: sway force lost to a yaw rate

    @property
    def top_speed(self) -> float:
        """Steady speed (m/s) under full thrust."""
        return self.surge.steady(self.thrust)

    @property
    def top_rate(self) -> float:
        """Steady yaw rate (rad/s) under the full moment."""
        return self.yaw.steady(self.moment)

    @property
    def sway_decay(self) -> float:
        """Decay rate of sway, s in the module's equations, 1/s."""
        v = SWAY_SHARE * self.top_speed
        return (self.sway.a + self.sway.b * v + self.sway.c * v * v) / self.m22

    @property
    def turns_outward(self) -> bool:
        """Whether a yaw rate first pushes the hull out of the turn: (1 - m11 / m22) u < d23 / m22 at half speed."""
        return (self.m22 - self.m11) * self.top_speed / 2 < self.sway_yaw


class Loops(NamedTuple):
    """Gains of the position loop e' = -k_e e - k_i (integral of e), the speed loop, and the heading loop; all 1/s."""

    k_e: float
    k_i: float  # 1/s^2
    k_u: float
    k_psi: float  # wanted yaw rate per heading error
    k_r: float  # yaw acceleration per error of the yaw rate, besides the resistance to the wanted one
    lead: float  # of the nose over the course, per course error; no unit


def loops(vessel: VesselDynamics, gains: CourseGains, interval: float) -> Loops:
    """Gains of the loops for decisions every `interval` s.

    The heading loop, N = m33 k_r (r* - r) + d_r(r*) with r* = k_psi (psi* - psi), has both its poles at
    exp(-w interval), with the resistance linear (k_r + d) k_psi = k of place_poles.
    """
    w = min(math.sqrt(vessel.moment / (vessel.m33 * gains.heading_error)), SAMPLED_SHARE / interval)
    d = vessel.yaw.a / vessel.m33
    k, k_r = place_poles(decaying(interval, d), w, interval)
    s = max(vessel.sway_decay, 1e-6)
    lead = 0.0 if vessel.turns_outward else min(max(COURSE_SHARE * w / s - 1, 0.0), MOST_LEAD)
    p = min(gains.position_share * w, LAG_SHARE * s * (1 + lead))
    return Loops(
        k_e=2 * p, k_i=p * p, k_u=(1 - math.exp(-gains.speed_bandwidth * interval)) / interval, k_psi=k / (k_r + d),
        k_r=k_r, lead=lead,
    )  # fmt: skip


class Load(NamedTuple):
    """Loads demanded of the actuators, without limits, each [env, vehicle]."""

    X: Tensor  # N
    Y: Tensor  # N, for vessels that can push to the side
    N: Tensor  # N m


@ti.func
def resisted(x, a, b, c):
    """d(x) of the module's equations."""
    return (a + b * ti.abs(x) + c * x * x) * x


@ti.func
def ahead_aside(v, heading):
    """Parts of v (NED) along the nose and to starboard of it; `heading`: its cosine and sine."""
    c, s = heading[0], heading[1]
    return c * v[NORTH] + s * v[EAST], c * v[EAST] - s * v[NORTH]


@ti.func
def slide(g: ti.template(), u, rate):
    """Sway (m/s, to port positive) in a steady turn at `rate` (rad/s): d_v(slide) = (m11 u + d23) rate."""
    load = (g.m11 * u + g.sway_yaw) * rate
    return 2.0 * load / ti.max(g.sway_a + ti.sqrt(g.sway_a * g.sway_a + 4.0 * g.sway_b * ti.abs(load)), 1e-6)


@ti.kernel
def _follow(load: array3, velocity: array3, change: array3, known: KnownPack, kind: ti.template(), form: ti.template()):
    """Write the loads [env, vehicle, (X, Y, N)] that follow a command; see `Course`."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(load.shape[0], load.shape[1]):
        g = values_at(kind, known.numbers)
        omega, R = taken(known.state, e, i, ROLL_RATE, 3), taken(known.derived, e, i, 0, 9)  # R_nb by rows
        push, _ = push_of_waves(R, omega, 0.5 * g.interval)
        heading, wanted = taken(known.derived, e, i, HEADING_COS, 2), taken(velocity, e, i, NORTH, 2)
        u, sway = ahead_aside(taken(known.derived, e, i, VELOCITY, 2), heading)
        ahead, aside = ahead_aside(wanted, heading)
        change_x, change_y = ahead_aside(taken(change, e, i, NORTH, 2), heading)
        push_x, push_y = ahead_aside(push, heading)
        X = g.m11 * (change_x + g.k_u * (ahead - u) - push_x) + resisted(ahead, g.surge_a, g.surge_b, g.surge_c)
        Y = g.m22 * (change_y + g.k_u * (aside - sway) - push_y) + resisted(aside, g.sway_a, g.sway_b, g.sway_c)

        speed, turn = ti.max(wanted.norm(), g.least_speed), known.target[e, row_of(known.target, i), COURSE_RATE]
        off, slip = ti.atan2(aside, ahead), ti.atan2(sway, ti.max(u, g.least_speed))
        error = wrapped(off + ti.atan2(slide(g, speed, turn), speed) + g.lead * wrapped(off - slip))
        rate = (change_y - g.wave_share * push_y) / speed + approach(error, g.k_psi, g.turn)
        rate = limited(rate, -g.top_rate, g.top_rate)
        N = g.m33 * g.k_r * (rate - yaw_rate(R, omega)) + resisted(rate, g.yaw_a, g.yaw_b, g.yaw_c)
        load[e, i, 0], load[e, i, 1], load[e, i, 2] = X, Y, N


class CourseCommand(NamedTuple):
    """The velocity command, each [env, vehicle, 2], NED."""

    velocity: Tensor  # v*, m/s
    change: Tensor  # v*', m/s^2


@ti.func
def formation_velocity(known: ti.template(), e, i, form: ti.template()):
    """Velocity (m/s, NED) of slot i: about a leader that keeps to its own, or about the target."""
    slot = taken(known.table, e, i, SLOT_VELOCITY, 2)
    if ti.static(not form.about):
        r = row_of(known.target, i)
        about = (slot - taken(known.derived, e, 0, VELOCITY, 2)) * ti.min(i, 1)
        slot = about + known.target[e, r, SPEED] * taken(known.target, e, r, COS, 2)
    return slot


@ti.func
def fastest(slot, chase, top, form: ti.template()):
    """Limit (m/s) of `chase`: its sum with the velocity of the slot stays below the `top` speed.

    The sum is limited in any direction; for slots about a target, which may be far, in the chase's own direction
    (constant bearing guidance: Breivik & Fossen 2009, Guidance laws for autonomous underwater vehicles, sec. 5.2).
    """
    limit = top - slot.norm()
    if ti.static(form.about):
        toward = slot.dot(chase) / ti.max(chase.norm(), 1e-6)
        limit = ti.sqrt(ti.max(top * top - slot.dot(slot) + toward * toward, 0.0)) - toward
    return limit


@ti.kernel
def _lead(
    led: array3, drift: array3, steps: ti.types.ndarray(dtype=ti.i64, ndim=1), known: KnownPack, kind: ti.template(),
    form: ti.template(),
):  # fmt: skip
    """Write the velocity that leads to the slots, theirs, and the share of k_e e in it [.., 5]; begin with `drift`."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(led.shape[0], led.shape[1]):
        g = values_at(kind, known.numbers)
        fresh, moved = steps[e] == 0, 0
        for a in ti.static(range(2)):
            if drift[e, i, PLACE + a] != known.state[e, i, a]:
                moved = 1
            drift[e, i, PLACE + a] = known.state[e, i, a]
            if fresh:
                drift[e, i, DRIFT + a] = 0.0
        drift[e, i, MOVED] = ti.select(fresh, 0, moved)
        if fresh or moved == 1:  # or this is a second call at the same moment
            for a in ti.static(range(2)):
                drift[e, i, GIVEN + a] = drift[e, i, DRIFT + a]

        slot = formation_velocity(known, e, i, form)
        chase = g.k_e * taken(known.table, e, i, ERROR, 2)
        limit = limited(fastest(slot, chase, g.top_speed, form), g.least_speed, g.closing)
        share = ti.min(limit / ti.max(chase.norm(), 1e-6), 1.0)
        for a in ti.static(range(2)):
            led[e, i, a], led[e, i, SLOT + a] = slot[a] + share * chase[a], slot[a]
        led[e, i, SHARE] = share


@ti.kernel
def _steer(
    command: array3, evaded: array3, led: array3, drift: array3, known: KnownPack, kind: ti.template(),
    form: ti.template(),
):  # fmt: skip
    """Write the command [env, vehicle, (v*, v*')] of a velocity that was led and `evaded`, and integrate the drift."""
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(command.shape[0], command.shape[1]):
        g = values_at(kind, known.numbers)
        slot, share, v = taken(led, e, i, SLOT, 2), led[e, i, SHARE], taken(known.derived, e, i, VELOCITY, 2)
        error, wanted = taken(known.table, e, i, ERROR, 2), taken(evaded, e, i, NORTH, 2)
        able = share >= 1.0 and (wanted - taken(led, e, i, NORTH, 2)).norm() <= EVADING
        turning = swung(slot, known.target[e, row_of(known.target, i), COURSE_RATE])
        for a in ti.static(range(2)):
            command[e, i, a] = wanted[a] + drift[e, i, GIVEN + a]
            command[e, i, CHANGE + a] = turning[a] + ti.select(able, g.k_e * (slot[a] - v[a]), 0.0)

        more, learns = g.k_i * g.interval * error, able and g.k_e * error.norm() < g.most_drift
        if ti.static(form.about):
            if share < 1.0:
                speed = ti.max(wanted.norm(), 1e-6)
                side = ti.Vector([-wanted[EAST] / speed, wanted[NORTH] / speed])
                off = v.dot(side)
                more = ti.static(-1.0 / COURSE_TIME) * g.interval * off * side
                learns = ti.abs(off) < COURSE_ERROR * v.norm()
        value = taken(drift, e, i, DRIFT, 2) + more
        size = value.norm()
        if learns and drift[e, i, MOVED] == 1 and size < MOST:
            for a in ti.static(range(2)):
                drift[e, i, DRIFT + a] = value[a] * ti.min(g.most_drift / ti.max(size, 1e-6), 1.0)


class Course(Remembers):
    """Computes the loads for a team of one kind of vessel; its only state is the drift.

    Over ground, with the error e = slot - position, the drift z, and evasion (../avoidance.py) of what is near:

        v* = v_s + sat(k_e e) + z,   v*' = chi' x v_s + k_e (v_s - v).

    The slot's velocity v_s is that of the formation (the target's, plus the swing about the leader). The leader's
    measured velocity also contains its motion in waves, which a follower would chase in vain. Speed, where u* is the
    part of v* along the nose and a the waves' push:

        X = m11 (v*'_x + k_u (u* - u) - a_x) + d_u(u*).

    The nose follows the direction chi* of v*, turned inwards by the drift angle beta of a steady turn at the target's
    rate. It leads further (`lead`) where the course is slow to follow:

        r* = (v*'_y - wave_share a_y) / |v*| + approach(chi* + beta - psi + lead (chi* - chi)),
        N = m33 k_r (r* - r) + d_r(r*).

    Waves: the hull floats on the water's slope, so its tilt measures a = -g (R_nb e_3)_{n,e}. Thrust cancels the part
    along the nose. Only a turn can cancel the part to starboard, and a turn in every wave costs moment and thrust that
    steering needs: wave_share is small or 0. The heading is fed back and not the course over ground, which contains the
    sway in waves.

    The drift compensates current, wind and sway. It is the integral of the position error in n, z' = k_i e: in n a
    current is constant however the hull turns. Against wind-up it is limited, and held while the hull cannot follow its
    command or is farther off than a drift explains. Far from a slot about a target, the course over ground is held
    instead, by the integral of the velocity error to the side of the command: the integral action of line-of-sight
    guidance (Børhaug, Pavlov & Pettersen 2008, IEEE CDC, eq. 7, in terms of velocities). An episode begins without a
    drift.

    Attributes:
        drift: [env, vehicle, 7] z and the z of the last decision (m/s), the place of the vehicle then (m), and whether
            it was another than the time before. None before the first decision.
    """

    def __init__(self, vessel: VesselDynamics, gains: CourseGains, interval: float):
        """Compute what follows from the `gains` for decisions every `interval` s."""
        self.gains = gains
        self.loops, self.avoid = loops(vessel, gains, interval), Avoider(gains)
        self.drift: Tensor | None = self.remember(None)
        top_speed = vessel.top_speed
        numbers = {
            "m11": vessel.m11, "m22": vessel.m22, "m33": vessel.m33, "sway_yaw": vessel.sway_yaw,
            "interval": interval, "k_u": self.loops.k_u, "k_psi": self.loops.k_psi, "k_r": self.loops.k_r,
            "lead": self.loops.lead, "wave_share": gains.wave_share, "least_speed": LEAST_SHARE * top_speed,
            "top_rate": min(RATE_SHARE * vessel.top_rate, NO_LIMIT), "turn": vessel.moment / vessel.m33,
            "k_e": self.loops.k_e, "k_i": self.loops.k_i, "top_speed": gains.speed_share * top_speed,
            "closing": gains.closing_share * gains.speed_share * top_speed, "most_drift": DRIFT_SHARE * top_speed,
        }  # fmt: skip
        for axis in ("surge", "sway", "yaw"):
            numbers |= {f"{axis}_{x}": number for x, number in getattr(vessel, axis)._asdict().items()}
        self._lead, self._steer, self._follow = (TeamKernel(x, numbers) for x in (_lead, _steer, _follow))

    def load(self, team: Knowledge, wanted: CourseCommand) -> Load:
        """Loads that follow the command."""
        return Load(*self._follow(team, len(Load._fields), wanted.velocity, wanted.change).unbind(-1))

    def wanted(self, team: Knowledge) -> CourseCommand:
        """The velocity command v*, and its rate of change v*', that lead the vessels to their slots."""
        place = team.fleet.position_n[..., :2]
        if self.drift is None or self.drift.shape[:2] != place.shape[:2]:
            nothing = place.new_zeros((*place.shape[:2], PLACE))
            self.drift = torch.cat((nothing, place, nothing[..., :1]), dim=-1)
        led = self._lead(team, SHARE + 1, self.drift, team.steps)
        evaded = self.avoid(team, led[..., :SLOT])  # without the drift, which is no motion over ground
        command = self._steer(team, CHANGE + 2, evaded, led, self.drift)
        return CourseCommand(command[..., :CHANGE], command[..., CHANGE:])


class Hull6DofGains(CourseGains):
    """Gains, tuned by taichi-sim tune on `otter`."""

    acceleration: Positive = 0.94
    horizon: Positive = 26.0
    berth: Positive = 0.6
    margin: Positive = 0.4
    hard: Positive = 84.0
    lean: Positive = 0.16


class CourseController(SlotController):
    """Acts for a team of vessels; its only state is their drift."""

    course: Course

    def wanted(self, team: Knowledge) -> CourseCommand:
        """The velocity command that leads to the slots."""
        return self.course.wanted(team)


class Hull6DofController(CourseController):
    """Acts for a team of hulls with two propellers, or with thrusters that a wrench commands.

    Half the difference of two propellers' thrusts makes the moment, their mean the surge force. The moment has
    priority: the mean is limited so that both propellers stay within their range with the desired difference. A wrench
    is allocated to the thrusters by the vehicle (`Steering`).
    """

    Gains = Hull6DofGains

    def __init__(self, model: Hull6Dof, gains: Hull6DofGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains`."""
        self.actions, self.gains = model.params.actions, gains or Hull6DofGains()
        self.steering = Steering.of(model) if self.actions == "wrench" else None
        if model.params.thrusters is not None and self.actions in ("surge_yaw", "left_right"):
            self.thrusters = t = model.params.thrusters
            thrust, moment = pair_limits(t)
        elif self.steering is not None and min(self.steering.thrust, self.steering.moment) > 0:
            thrust, moment = self.steering.thrust, self.steering.moment
        else:
            raise ControllerError(
                "the classical controller of a hull_6dof needs thrusters that drive and turn it, commanded together: "
                '[thrusters], with actions = "surge_yaw" or "left_right", or [actuators.NAME], with actions = "wrench"'
            )
        dynamics = hull_dynamics(model, thrust, moment)
        self.course = self.remember(Course(dynamics, self.gains, model.dt * model.substeps))

    def act(self, team: Knowledge, wanted: CourseCommand) -> Tensor:
        """Actions [env, vehicle, 2 or 3] in [-1, 1]; 0 where they would be NaN, as for a state that is not finite."""
        if self.steering is not None:
            return torch.nan_to_num(self.steering.actions(self.course.load(team, wanted))).clamp(-1.0, 1.0)
        left, right = shares(self.thrusters, self.course.load(team, wanted), astern=self.actions == "left_right")
        if self.actions == "left_right":
            action = torch.stack((shaft(self.thrusters, left), shaft(self.thrusters, right)), dim=-1)
        else:
            t = self.thrusters
            action = torch.stack(
                ((left + right) / t.thrust_max - 1, (left - right) / (t.thrust_max - t.thrust_min)), dim=-1
            )
        return torch.nan_to_num(action).clamp(-1.0, 1.0)


class Steering(NamedTuple):
    """How a hull with `actions = "wrench"` is steered: by surge force and moment, with the sway force that the least
    thrust for the moment makes beside it.

    So a boat with azimuth thrusters astern turns them, in place of driving one astern. The moment has priority: the
    surge force is limited to the share of its range that the moment leaves. With azimuth thrusters it is never astern,
    for they would have to turn about.
    """

    most: tuple[float, ...]  # X, Y (N), N (N m) of actions of 1
    least: tuple[float, ...]  # of actions of -1
    sway: float  # Y of a moment, 1/m
    moment: float  # the largest to either side, N m
    astern: float  # the least surge force, N

    @property
    def thrust(self) -> float:
        """The largest surge force, N."""
        return self.most[0]

    @classmethod
    def of(cls, model: Hull6Dof) -> "Steering":
        """Of a hull whose actions are a wrench."""
        thrusters, most, least = model.thrusters.thrusters, model.wrench_max, model.wrench_min
        sway, moment = moment_alone(thrusters)
        limits = [moment, most[2], -least[2]]
        limits += [min(most[1], -least[1]) / abs(sway)] if abs(sway) > NO_SWAY else []
        azimuth = any(thruster.azimuth for thruster in thrusters)
        return cls(most, least, sway, min(limits), 0.0 if azimuth else least[0])

    def actions(self, load: Load) -> Tensor:
        """Actions [env, vehicle, 3] that make `load` as far as the thrusters can."""
        N = load.N.clamp(-self.moment, self.moment)
        left = 1.0 - N.abs() / self.moment
        X = torch.minimum(torch.maximum(load.X, self.astern * left), self.thrust * left)
        shares = [
            torch.where(value > 0, value / (most or 1.0), value / (-least or 1.0))
            for value, most, least in zip((X, self.sway * N, N), self.most, self.least, strict=True)
        ]
        return torch.stack(shares, dim=-1)


def hull_dynamics(model: Hull6Dof, thrust: float, moment: float) -> VesselDynamics:
    """The hull in the plane, with the largest surge force (N) and moment (N m) of its thrusters.

    Cross-flow drag of pure sway and of pure yaw: L and L^4 / 32 in the strip integral.
    """
    h, M = model.params.hydrodynamics, model.slow_mass
    section = 0.5 * h.cross_flow_density * h.cross_flow_draft * h.cross_flow_coefficient
    L, u = h.cross_flow_length, LIFT_SHARE * model.top_speed
    return VesselDynamics(
        m11=float(M[0, 0]), m22=float(M[1, 1]), m33=float(M[5, 5]), surge=Resistance(h.linear[0], h.quadratic[0]),
        sway=Resistance(h.linear[1] - h.lift.Y_uv * u, h.quadratic[1] + section * L),
        yaw=Resistance(h.linear[5] - h.lift.N_ur * u, h.quadratic[5] + section * L**4 / 32),
        thrust=thrust, moment=moment,
    )  # fmt: skip


def pair_limits(t: PropellerPair) -> tuple[float, float]:
    """Largest surge force (N) and moment (N m) of two propellers."""
    return 2 * t.thrust_max, _arm(t) * (t.thrust_max - t.thrust_min)


def shares(t: PropellerPair, load: Load, *, astern: bool) -> tuple[Tensor, Tensor]:
    """Thrusts (N) of the left and the right propeller; their mean is not negative unless `astern`."""
    most = 0.5 * (t.thrust_max - t.thrust_min)
    half = (0.5 * load.N / _arm(t)).clamp(-most, most)
    mean = (0.5 * load.X).clamp(min=t.thrust_min if astern else 0.0)
    mean = torch.minimum(torch.maximum(mean, t.thrust_min + half.abs()), t.thrust_max - half.abs())
    return mean + half, mean - half


def shaft(t: PropellerPair, thrust: Tensor) -> Tensor:
    """Shaft speed in [-1, 1], as a share of the greatest ahead or astern, whose thrust k |n| n is `thrust` (N)."""
    ahead = (thrust.clamp(min=0.0) / t.thrust_max).sqrt()
    if t.thrust_min == 0:
        return ahead
    return ahead - (thrust.clamp(max=0.0) / t.thrust_min).sqrt()


def _arm(t: PropellerPair) -> float:
    """Half the distance (m) between the propellers."""
    return 0.5 * (t.right[1] - t.left[1])


class Manoeuvring3dofGains(CourseGains):
    """Gains, named as those of `hull_6dof`; not tuned."""

    acceleration: Positive = 0.3
    horizon: Positive = 25.0
    berth: Positive = 0.6
    margin: Positive = 0.4


class Manoeuvring3dofController(CourseController):
    """Acts for a team of vessels with surge force and yaw moment, each clipped to its limit."""

    Gains = Manoeuvring3dofGains

    def __init__(self, model: Manoeuvring3dof, gains: Manoeuvring3dofGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains`."""
        self.params = model.params
        self.gains = gains or Manoeuvring3dofGains()
        self.course = self.remember(Course(planar_dynamics(model.params), self.gains, model.dt * model.substeps))

    def act(self, team: Knowledge, wanted: CourseCommand) -> Tensor:
        """Actions [env, vehicle, 2 or 3] in [-1, 1]; 0 where they would be NaN, as for a state that is not finite."""
        p, load = self.params, self.course.load(team, wanted)
        X, N = load.X / p.surge_force_max, load.N / p.yaw_moment_max
        if p.actions == "acceleration_yaw":
            action = torch.stack((2 * X - 1, N), dim=-1)
        else:
            Y = load.Y / p.sway_force_max if p.sway_force_max else torch.zeros_like(X)
            action = torch.stack((X, Y, N), dim=-1)
        return torch.nan_to_num(action).clamp(-1.0, 1.0)


def planar_dynamics(p: Manoeuvring3dofParams) -> VesselDynamics:
    """The vessel for its controller: with the sway force due to yaw, without the yaw moment due to sway."""
    M = p.M
    return VesselDynamics(
        m11=float(M[0, 0]), m22=float(M[1, 1]), m33=float(M[2, 2]), surge=Resistance(-p.X_u, -p.X_uu, -p.X_uuu),
        sway=Resistance(-p.Y_v, -p.Y_vv), yaw=Resistance(-p.N_r, -p.N_rr, -p.N_rrr),
        thrust=p.surge_force_max, moment=p.yaw_moment_max, sway_yaw=-p.Y_r,
    )  # fmt: skip
