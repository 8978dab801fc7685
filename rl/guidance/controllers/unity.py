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
"""

import math

import torch
from torch import Tensor

from rl.guidance.avoidance import AvoidanceGains, Avoider, SlotController, Wanted
from rl.guidance.controllers.sampled import held, place_poles
from rl.guidance.geometry import approach, course_of, cross, turning, wrap
from rl.guidance.knowledge import Knowledge
from taichi_sim.config import Positive
from taichi_sim.conventions import AHEAD, DOWN, EAST, GRAVITY, NORTH
from taichi_sim.uav.unity_aircraft import DEG, UnityAircraft
from taichi_sim.usv.unity_boat import UnityBoat

SPEED_SHARE = 0.95  # largest desired speed, as a share of the top speed; assumed
MAX_CLIMB = math.radians(60.0)  # of an aircraft's nose: yaw means little near the vertical; assumed
LEAST_FORCE = 0.5  # m/s^2: a shorter force vector has no direction to follow; assumed


class ForceGains(AvoidanceGains):
    """Gains of the position loop, besides those of avoidance."""

    bandwidth: Positive = 2.0  # rad/s
    closing: Positive = 6.0  # m/s, limit of what an error adds to the slot's velocity
    braking: Positive = 3.0  # m/s^2, deceleration near the slot: sqrt(2 braking |e|) is a limit, too


class ForceVector:
    """The outer loop of a vehicle with top acceleration `thrust` (m/s^2) and `drag` (1/s)."""

    def __init__(self, model, gains: "ForceGains", *, thrust: float):
        """Compute what follows from the `gains`."""
        self.interval = model.dt * model.substeps
        self.hold = held(model.dt, model.substeps, model.params.drag)
        self.k_e, self.k_v = place_poles(held(model.dt, model.substeps), gains.bandwidth, self.interval)
        self.top_speed = SPEED_SHARE * thrust * self.hold.gain / max(1 - self.hold.keep, 1e-6)
        self.closing, self.braking, self.avoid = gains.closing, gains.braking, Avoider(gains)

    def velocity(self, team: Knowledge) -> Tensor:
        """v* [env, vehicle, 2 or 3], m/s."""
        n = team.axes
        slot = team.now.slot_velocity[..., :n]
        chase = self.k_e / self.k_v * team.now.error[..., :n]
        limit = (self.top_speed - slot.norm(dim=-1, keepdim=True)).clamp(0.1 * self.closing, self.closing)
        distance = team.now.error[..., :n].norm(dim=-1, keepdim=True)
        limit = torch.minimum(limit, torch.sqrt(2 * self.braking * distance))
        chase = chase * (limit / chase.norm(dim=-1, keepdim=True).clamp(min=1e-6)).clamp(max=1.0)
        return self.avoid(team, slot + chase)

    def wanted(self, team: Knowledge, velocity: Tensor, disturbance: Tensor | float = 0.0) -> Tensor:
        """f* [env, vehicle, 2 or 3], m/s^2, towards v* = `velocity`, against an acceleration `disturbance` d."""
        n = team.axes
        slot, v = team.now.slot_velocity[..., :n], team.fleet.velocity_n[..., :n]
        acceleration = turning(team, slot) + self.k_v * (velocity - v)
        return ((1 - self.hold.keep) * v + self.interval * acceleration) / self.hold.gain - disturbance

    def change(self, team: Knowledge, force: Tensor, disturbance_rate: Tensor | float = 0.0) -> Tensor:
        """f*' [env, vehicle, 2 or 3], m/s^3, when `force` (m/s^2, disturbance included) acts now."""
        n = team.axes
        slot, v = team.now.slot_velocity[..., :n], team.fleet.velocity_n[..., :n]
        a = (self.hold.gain * force - (1 - self.hold.keep) * v) / self.interval
        slot_a = turning(team, slot)
        a_rate = turning(team, slot_a) + self.k_v * (slot_a - a) + self.k_e * team.now.error_rate[..., :n]
        return ((1 - self.hold.keep) * a + self.interval * a_rate) / self.hold.gain - disturbance_rate


class UnityAircraftGains(ForceGains):
    """Gains, tuned by rl/tune.py on `paper`."""

    acceleration: Positive = 5.1
    horizon: Positive = 5.2
    berth: Positive = 0.7
    margin: Positive = 1.3
    soft: Positive = 4.3
    attitude_bandwidth: Positive = 8.0  # rad/s, of pitch and yaw


class UnityAircraftController(SlotController):
    """Acts for a team of aircraft: the nose follows the desired force, the boost is its projection. It has no state.

    Pitch and yaw rates are commanded. A rate changes by at most `smooth_rate` of its range per second: an angle is a
    double integrator with a bounded acceleration, and within that bound a rate command is obeyed at once:

        psi' = psi*' + approach(psi* - psi),   theta' likewise,   k = (1 - exp(-attitude_bandwidth T)) / T.

    The boost inverts the drag exactly over the interval, and the action inverts the geometric mapping of the boost. The
    bank does not affect the path.
    """

    STATE = ()
    Gains = UnityAircraftGains

    def __init__(self, model: UnityAircraft, gains: UnityAircraftGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains`."""
        p, gains = model.params, gains or UnityAircraftGains()
        self.gains = gains
        self.interval = model.dt * model.substeps
        self.per_boost = p.thrust_factor * p.thrust / p.mass  # m/s^2
        self.boost_min, self.boost_max = p.boost_min, p.boost_max
        self.force = ForceVector(model, gains, thrust=self.per_boost * p.boost_max)
        self.k = (1 - math.exp(-gains.attitude_bandwidth * self.interval)) / self.interval
        self.top_rate = DEG * p.pitch_speed_deg, DEG * p.yaw_speed_deg
        self.smooth_rate = p.smooth_rate
        self.max_climb = min(MAX_CLIMB, DEG * p.max_pitch_deg)

    def wanted(self, team: Knowledge) -> Wanted:
        """The velocity command that leads to the slots."""
        return Wanted(self.force.velocity(team))

    def act(self, team: Knowledge, wanted: Wanted) -> Tensor:
        """Actions [env, vehicle, (pitch, yaw, boost)] in [-1, 1]."""
        pull, nose = self.force.wanted(team, wanted.velocity), team.fleet.R_nb[..., AHEAD]
        force = (pull * nose).sum(-1).clamp(self.per_boost * self.boost_min, self.per_boost * self.boost_max)
        climb_rate, turn_rate = _turn(pull, self.force.change(team, force.unsqueeze(-1) * nose))

        level = torch.hypot(pull[..., NORTH], pull[..., EAST]).clamp(min=LEAST_FORCE)
        climb = torch.atan2(-pull[..., DOWN], level).clamp(-self.max_climb, self.max_climb)
        _, theta, psi = team.fleet.euler.unbind(-1)
        pitch = self._command(climb - theta, climb_rate, self.top_rate[0])
        yaw = self._command(wrap(course_of(pull) - psi), turn_rate, self.top_rate[1])
        boost = torch.log(force / (self.per_boost * self.boost_min)) / math.log(self.boost_max / self.boost_min)
        return torch.stack((pitch, yaw, 2 * boost - 1), dim=-1).clamp(-1.0, 1.0)

    def _command(self, error: Tensor, rate: Tensor, top_rate: float) -> Tensor:
        """The action in [-1, 1] that turns by `error` (rad) towards a target that turns at `rate` (rad/s)."""
        error = error - 0.5 * self.interval * rate
        return ((rate + approach(error, self.k, self.smooth_rate * top_rate)) / top_rate).clamp(-1.0, 1.0)


def _turn(vector: Tensor, change: Tensor) -> tuple[Tensor, Tensor]:
    """Rates (rad/s) of the climb angle and the course of `vector` (NED), which changes by `change` per second."""
    level2 = vector[..., :2].square().sum(-1).clamp(min=LEAST_FORCE**2)
    along = (vector[..., :2] * change[..., :2]).sum(-1) / level2  # relative growth of the level part
    down = vector[..., DOWN]
    climb = level2.sqrt() * (down * along - change[..., DOWN]) / (level2 + down.square())
    return climb, cross(vector, change) / level2


class UnityBoatGains(ForceGains):
    """Gains, tuned by rl/tune.py on `paper`."""

    acceleration: Positive = 9.5
    horizon: Positive = 5.3
    berth: Positive = 1.1
    margin: Positive = 2.4
    soft: Positive = 3.8
    hard: Positive = 10.5
    heading_bandwidth: Positive = 6.0  # rad/s


class UnityBoatController(SlotController):
    """Acts for a team of boats: the heading follows the desired force, the thrust is its projection. It has no state.

    The waves push the hull down their slope. The hull floats on that slope, so its own tilt measures the push,
    d = -g (R_nb e_3)_{n,e}. The rate of that vector comes from the body rates; it predicts the push half an interval
    ahead, because the command is held. The heading loop, with the rate of the desired force as feed-forward, is

        r* = psi*' + approach(psi* - psi),   N = I_z (k_r (r* - r) + damping r*),

    with its poles at exp(-heading_bandwidth T) for the yaw inertia and angular drag of the vehicle.
    """

    STATE = ()
    Gains = UnityBoatGains

    def __init__(self, model: UnityBoat, gains: UnityBoatGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains`."""
        p, gains = model.params, gains or UnityBoatGains()
        self.gains = gains
        self.thrust = p.force_factor / p.mass
        self.interval = model.dt * model.substeps
        self.force = ForceVector(model, gains, thrust=self.thrust)
        yaw = held(model.dt, model.substeps, p.angular_drag)
        self.k_psi, self.k_r = place_poles(yaw, gains.heading_bandwidth, self.interval)
        self.damping = (1 - yaw.keep) / yaw.gain
        self.yaw_acceleration = p.yaw_factor / p.inertia[2]

    def wanted(self, team: Knowledge) -> Wanted:
        """The velocity command that leads to the slots."""
        return Wanted(self.force.velocity(team))

    def act(self, team: Knowledge, wanted: Wanted) -> Tensor:
        """Actions [env, vehicle, (acceleration, yaw)] in [-1, 1]."""
        R, omega = team.fleet.R_nb, team.fleet.angular_velocity_b
        down_rate = R[..., :2, 0] * omega[..., 1:2] - R[..., :2, 1] * omega[..., 0:1]  # of R e_3: R (omega x e_3)
        push_rate = -GRAVITY * down_rate
        push = -GRAVITY * R[..., :2, 2] + 0.5 * self.interval * push_rate
        force = self.force.wanted(team, wanted.velocity, push)

        nose = torch.stack(team.fleet.heading, dim=-1)
        thrust = (force * nose).sum(-1).clamp(0.0, self.thrust)
        change = self.force.change(team, thrust.unsqueeze(-1) * nose + push, push_rate)
        square = force.square().sum(-1).clamp(min=LEAST_FORCE**2)
        rate = cross(force, change) / square

        error = wrap(course_of(force) - course_of(nose)) - 0.5 * self.interval * rate
        r = (R[..., 2, :] * omega).sum(-1)
        r_wanted = rate + approach(error, self.k_psi / self.k_r, self.yaw_acceleration)
        torque = (self.k_r * (r_wanted - r) + self.damping * r_wanted) / self.yaw_acceleration
        return torch.stack((2 * thrust / self.thrust - 1, torque.clamp(-1.0, 1.0)), dim=-1)
