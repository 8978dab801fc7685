"""Force-vector tracking: the force a vehicle needs to follow its slot, and how fast that vector turns.

Both Unity vehicles push along the nose only, against an isotropic drag: v' = f - drag v + d. A desired acceleration is
therefore a desired force vector. The nose should point along it; the thrust is its projection on the nose. With the
error e = slot - position, and the slot's velocity and centripetal acceleration as feed-forward,

    v* = v_s + sat(k_e / k_v e), kept clear by ../avoidance.py       desired velocity
    a* = chi' x v_s + k_v (v* - v)                                    desired acceleration
    f* = ((v + a* T) - keep v) / gain - d                             force per mass, exact over the interval T

k_e and k_v place both poles of the double integrator e at exp(-bandwidth T). The attitude loop needs the rate of f* as
feed-forward. It follows from the acceleration a that the vehicle is about to have:

    f*' = ((1 - keep) a + T a*') / gain - d',   a*' = chi' x (chi' x v_s) + k_v (chi' x v_s - a) + k_e e'
"""

import torch
from torch import Tensor

from rl.guidance.avoidance import AvoidanceGains, Avoider
from rl.guidance.controllers.sampled import held, place_poles
from rl.guidance.knowledge import Knowledge
from taichi_sim.config import Positive
from taichi_sim.conventions import EAST, NORTH

SPEED_SHARE = 0.95  # largest desired speed, as a share of the top speed; assumed


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


def turning(team: Knowledge, vector: Tensor) -> Tensor:
    """Rate of change of a `vector` [env, vehicle, 2 or 3] that turns with the target's course."""
    rate = team.target.course_rate
    change = torch.zeros_like(vector)
    change[..., NORTH], change[..., EAST] = -rate * vector[..., EAST], rate * vector[..., NORTH]
    return change


def to_starboard(vector: Tensor) -> Tensor:
    """A level `vector` [.., 2] (NED), turned to starboard by a right angle."""
    north, east = vector.unbind(-1)
    return torch.stack((-east, north), dim=-1)


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Cross product [..] of the level parts of `a` and `b` [.., 2 or more] (NED): above 0 where b is to starboard."""
    return a[..., NORTH] * b[..., EAST] - a[..., EAST] * b[..., NORTH]


def course_of(vector: Tensor) -> Tensor:
    """Course [..] (rad) of vectors [.., 2 or more] (NED)."""
    return torch.atan2(vector[..., EAST], vector[..., NORTH])


def approach(error: Tensor, gain: float, acceleration: float) -> Tensor:
    """Rate towards a zero of `error` that can still be stopped: min(gain |e|, sqrt(2 acceleration |e|))."""
    size = error.abs()
    return error.sign() * torch.minimum(gain * size, torch.sqrt(2 * acceleration * size))


def wrap(angle: Tensor) -> Tensor:
    """`angle` (rad) in [-pi, pi)."""
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi
