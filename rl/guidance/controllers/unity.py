"""Classical control of `unity_boat` and `unity_aircraft`: the nose follows the force that the vehicle needs.

Both Unity vehicles push along the nose only, against an isotropic drag: v' = f - drag v + d. A desired acceleration is
therefore a desired force vector. The nose should point along it; the thrust is its projection on the nose. With the
error e = slot - position, and the slot's velocity and centripetal acceleration as feed-forward,

    v* = v_s + sat(k_e / k_v e), kept clear by ../avoidance.py        desired velocity
    a* = chi' x v_s + k_v (v* - v)                                    desired acceleration
    f* = ((v + a* T) - keep v) / gain - d                             force per mass, exact over the interval T

k_e and k_v place both poles of the double integrator e at exp(-bandwidth T). The attitude loop needs the rate of f* as
feed-forward. It follows from the acceleration a that the vehicle is about to have:

    f*' = ((1 - keep) a + T a*') / gain - d',   a*' = chi' x (chi' x v_s) + k_v (chi' x v_s - a) + k_e e'

Each law is one kernel: as operations of torch, it took a third of the step of a single environment.
"""

# Kernels are another language inside Python syntax.
# pyright: reportInvalidTypeForm=false, reportOptionalCall=false, reportIndexIssue=false

import math
from typing import Any, cast

import taichi as ti
from torch import Tensor

from rl.guidance.avoidance import AvoidanceGains, Avoider, SlotController, Wanted
from rl.guidance.controllers.laws import approach, cross, limited, push_of_waves, swung, turn_to, yaw_rate
from rl.guidance.controllers.sampled import held, place_poles
from rl.guidance.knowledge import Knowledge, KnownPack, TeamKernel
from rl.guidance.targets_and_errors import COURSE_RATE, ERROR, ERROR_RATE, SLOT_VELOCITY, row_of
from rl.guidance.targets_and_errors import V as VELOCITY
from taichi_sim.config import Positive
from taichi_sim.kernels import runtime
from taichi_sim.kernels.abreast import taken
from taichi_sim.kernels.conventions import DOWN, EAST, NORTH, ROLL_RATE
from taichi_sim.kernels.packs import values_at
from taichi_sim.kernels.rotation import HEADING_COS
from taichi_sim.kernels.runtime import array3
from taichi_sim.models.uav.unity_aircraft import DEG, UnityAircraft
from taichi_sim.models.usv.unity_boat import UnityBoat

SPEED_SHARE = 0.95  # largest desired speed, as a share of the top speed; assumed
MAX_CLIMB = math.radians(60.0)  # of an aircraft's nose: yaw means little near the vertical; assumed
LEAST_FORCE = 0.5  # m/s^2: a shorter force vector has no direction to follow; assumed
NEAR = 1e-6  # m: a slot nearer than this has no direction


@ti.func
def wanted_force(known: ti.template(), velocity: ti.template(), e, i, g: ti.template(), form: ti.template()):
    """f* (m/s^2) towards v* = `velocity`, without disturbance."""
    slot, v = taken(known.table, e, i, SLOT_VELOCITY, form.axes), taken(known.derived, e, i, VELOCITY, form.axes)
    turn = known.target[e, row_of(known.target, i), COURSE_RATE]
    acceleration = swung(slot, turn) + g.k_v * (taken(velocity, e, i, NORTH, form.axes) - v)
    return ((1.0 - g.keep) * v + g.interval * acceleration) / g.gain


@ti.func
def force_rate(known: ti.template(), force, e, i, g: ti.template(), form: ti.template()):
    """f*' (m/s^3), without disturbance, when `force` (m/s^2, disturbance included) acts now."""
    slot, v = taken(known.table, e, i, SLOT_VELOCITY, form.axes), taken(known.derived, e, i, VELOCITY, form.axes)
    turn = known.target[e, row_of(known.target, i), COURSE_RATE]
    a = (g.gain * force - (1.0 - g.keep) * v) / g.interval
    slot_a = swung(slot, turn)
    a_rate = swung(slot_a, turn) + g.k_v * (slot_a - a) + g.k_e * taken(known.table, e, i, ERROR_RATE, form.axes)
    return ((1.0 - g.keep) * a + g.interval * a_rate) / g.gain


@ti.kernel
def _chase(velocity: array3, known: KnownPack, kind: ti.template(), form: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(velocity.shape[0], velocity.shape[1]):
        g = values_at(kind, known.numbers)
        slot, error = taken(known.table, e, i, SLOT_VELOCITY, form.axes), taken(known.table, e, i, ERROR, form.axes)
        distance = error.norm()
        limit = limited(g.top_speed - slot.norm(), 0.1 * g.closing, g.closing)
        limit = ti.min(limit, ti.sqrt(2.0 * g.braking * distance))
        v = slot + error * ti.min(g.k_e / g.k_v, limit / ti.max(distance, NEAR))
        for a in ti.static(range(form.axes)):
            velocity[e, i, a] = v[a]


@ti.kernel
def _fly(action: array3, velocity: array3, known: KnownPack, kind: ti.template(), form: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(action.shape[0], action.shape[1]):
        g = values_at(kind, known.numbers)
        nose = ti.Vector([known.derived[e, i, 3 * a] for a in ti.static(range(3))])  # first column of R_nb
        pull = wanted_force(known, velocity, e, i, g, form)
        force = limited(pull.dot(nose), g.least, g.most)
        change = force_rate(known, force * nose, e, i, g, form)

        level2 = ti.max(pull[NORTH] * pull[NORTH] + pull[EAST] * pull[EAST], LEAST_FORCE * LEAST_FORCE)
        level, down = ti.sqrt(level2), pull[DOWN]
        along = (pull[NORTH] * change[NORTH] + pull[EAST] * change[EAST]) / level2  # relative growth of the level part
        climb_rate = level * (down * along - change[DOWN]) / (level2 + down * down)
        turn_rate = cross(pull, change) / level2

        climb = limited(ti.atan2(-down, level), -g.max_climb, g.max_climb)
        theta = ti.atan2(-nose[DOWN], ti.sqrt(nose[NORTH] * nose[NORTH] + nose[EAST] * nose[EAST]))
        action[e, i, 0] = rate_action(climb - theta, climb_rate, g.top_pitch, g)
        action[e, i, 1] = rate_action(turn_to(nose, pull), turn_rate, g.top_yaw, g)
        action[e, i, 2] = limited(2.0 * ti.log(force / g.least) / ti.log(g.most / g.least) - 1.0, -1.0, 1.0)


@ti.func
def rate_action(error, rate, top_rate, g: ti.template()):
    """The action in [-1, 1] that turns by `error` (rad) towards a target that turns at `rate` (rad/s)."""
    left = error - 0.5 * g.interval * rate
    return limited((rate + approach(left, g.k_attitude, g.smooth_rate * top_rate)) / top_rate, -1.0, 1.0)


@ti.kernel
def _steer(action: array3, velocity: array3, known: KnownPack, kind: ti.template(), form: ti.template()):
    ti.loop_config(serialize=runtime.loop.serial)
    for e, i in ti.ndrange(action.shape[0], action.shape[1]):
        g = values_at(kind, known.numbers)
        omega, R = taken(known.state, e, i, ROLL_RATE, 3), taken(known.derived, e, i, 0, 9)  # R_nb by rows
        push, push_rate = push_of_waves(R, omega, 0.5 * g.interval)
        force = wanted_force(known, velocity, e, i, g, form) - push

        nose = taken(known.derived, e, i, HEADING_COS, 2)
        thrust = limited(force.dot(nose), 0.0, g.most)
        change = force_rate(known, thrust * nose + push, e, i, g, form) - push_rate
        rate = cross(force, change) / ti.max(force.dot(force), LEAST_FORCE * LEAST_FORCE)

        left = turn_to(nose, force) - 0.5 * g.interval * rate
        r_wanted = rate + approach(left, g.k_psi / g.k_r, g.yaw_acceleration)
        torque = (g.k_r * (r_wanted - yaw_rate(R, omega)) + g.damping * r_wanted) / g.yaw_acceleration
        action[e, i, 0], action[e, i, 1] = 2.0 * thrust / g.most - 1.0, limited(torque, -1.0, 1.0)


class ForceGains(AvoidanceGains):
    """Gains of the position loop, besides those of avoidance."""

    bandwidth: Positive = 2.0  # rad/s
    closing: Positive = 6.0  # m/s, limit of what an error adds to the slot's velocity
    braking: Positive = 3.0  # m/s^2, deceleration near the slot: sqrt(2 braking |e|) is a limit, too


class ForceController(SlotController):
    """A controller whose kernel `law` follows the desired force. It has no state."""

    def _set_up(self, model: UnityAircraft | UnityBoat, law: Any, *, most: float, **numbers: float) -> None:
        """Compute what follows from `gains`; `most` is the top acceleration, m/s^2, `numbers` are the law's own."""
        gains, interval = cast(ForceGains, self.gains), model.dt * model.substeps
        hold = held(model.dt, model.substeps, model.params.drag)
        k_e, k_v = place_poles(held(model.dt, model.substeps), gains.bandwidth, interval)
        top_speed = SPEED_SHARE * most * hold.gain / max(1 - hold.keep, 1e-6)
        numbers |= {
            "interval": interval, "keep": hold.keep, "gain": hold.gain, "k_e": k_e, "k_v": k_v, "most": most,
            "top_speed": top_speed, "closing": gains.closing, "braking": gains.braking,
        }  # fmt: skip
        self._avoid, self._actions = Avoider(gains), len(model.action_names)
        self._chase, self._law = TeamKernel(_chase, numbers), TeamKernel(law, numbers)

    def wanted(self, team: Knowledge) -> Wanted:
        """The velocity command that leads to the slots."""
        return Wanted(self._avoid(team, self._chase(team, team.axes)))

    def act(self, team: Knowledge, wanted: Wanted) -> Tensor:
        """Actions [env, vehicle, action] in [-1, 1] that follow the command."""
        return self._law(team, self._actions, wanted.velocity)


class UnityAircraftGains(ForceGains):
    """Gains, tuned by taichi-sim tune on `paper`."""

    acceleration: Positive = 5.1
    horizon: Positive = 5.2
    berth: Positive = 0.7
    margin: Positive = 1.3
    soft: Positive = 4.3
    attitude_bandwidth: Positive = 8.0  # rad/s, of pitch and yaw


class UnityAircraftController(ForceController):
    """Acts for a team of aircraft: the nose follows the desired force, the boost is its projection.

    Pitch and yaw rates are commanded. A rate changes by at most `smooth_rate` of its range per second: an angle is a
    double integrator with a bounded acceleration, and within that bound a rate command is obeyed at once:

        psi' = psi*' + approach(psi* - psi),   theta' likewise,   k = (1 - exp(-attitude_bandwidth T)) / T.

    The boost inverts the drag exactly over the interval, and the action inverts the geometric mapping of the boost. The
    bank does not affect the path.
    """

    Gains = UnityAircraftGains

    def __init__(self, model: UnityAircraft, gains: UnityAircraftGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains`."""
        p, gains = model.params, gains or UnityAircraftGains()
        self.gains = gains
        interval = model.dt * model.substeps
        per_boost = p.thrust_factor * p.thrust / p.mass  # m/s^2
        self._set_up(
            model, _fly, most=per_boost * p.boost_max, least=per_boost * p.boost_min,
            k_attitude=(1 - math.exp(-gains.attitude_bandwidth * interval)) / interval, smooth_rate=p.smooth_rate,
            top_pitch=DEG * p.pitch_speed_deg, top_yaw=DEG * p.yaw_speed_deg,
            max_climb=min(MAX_CLIMB, DEG * p.max_pitch_deg),
        )  # fmt: skip


class UnityBoatGains(ForceGains):
    """Gains, tuned by taichi-sim tune on `paper`."""

    acceleration: Positive = 9.5
    horizon: Positive = 5.3
    berth: Positive = 1.1
    margin: Positive = 2.4
    soft: Positive = 3.8
    hard: Positive = 10.5
    heading_bandwidth: Positive = 6.0  # rad/s


class UnityBoatController(ForceController):
    """Acts for a team of boats: the heading follows the desired force, the thrust is its projection.

    The waves push the hull down their slope. The hull floats on that slope, so its own tilt measures the push,
    d = -g (R_nb e_3)_{n,e}. The rate of that vector comes from the body rates; it predicts the push half an interval
    ahead, because the command is held. The heading loop, with the rate of the desired force as feed-forward, is

        r* = psi*' + approach(psi* - psi),   N = I_z (k_r (r* - r) + damping r*),

    with its poles at exp(-heading_bandwidth T) for the yaw inertia and angular drag of the vehicle.
    """

    Gains = UnityBoatGains

    def __init__(self, model: UnityBoat, gains: UnityBoatGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains`."""
        p, gains = model.params, gains or UnityBoatGains()
        self.gains = gains
        yaw = held(model.dt, model.substeps, p.angular_drag)
        k_psi, k_r = place_poles(yaw, gains.heading_bandwidth, model.dt * model.substeps)
        self._set_up(
            model, _steer, most=p.force_factor / p.mass, k_psi=k_psi, k_r=k_r,
            damping=(1 - yaw.keep) / yaw.gain, yaw_acceleration=p.yaw_factor / p.inertia[2],
        )  # fmt: skip
