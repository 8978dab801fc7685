"""Classical control of `unity_boat`: the heading follows the desired force, the thrust is its projection.

The waves push the hull down their slope. The hull floats on that slope, so its own tilt measures the push,
d = -g (R_nb e_3)_{n,e}. The rate of that vector comes from the body rates; it predicts the push half an interval ahead,
because the command is held. The heading loop, with the rate of the desired force (force_vector.py) as feed-forward, is

    r* = psi*' + approach(psi* - psi),   N = I_z (k_r (r* - r) + damping r*),

with its poles at exp(-heading_bandwidth T) for the yaw inertia and angular drag of the vehicle.
"""

import torch
from torch import Tensor

from rl.guidance.avoidance import SlotController, Wanted
from rl.guidance.controllers.force_vector import ForceGains, ForceVector, approach, course_of, cross, wrap
from rl.guidance.controllers.sampled import held, place_poles
from rl.guidance.knowledge import Knowledge
from taichi_sim.config import Positive
from taichi_sim.conventions import GRAVITY
from taichi_sim.usv.unity_boat import UnityBoat

LEAST_FORCE = 0.5  # m/s^2: a shorter force vector has no direction to follow; assumed


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
    """Acts for a team of boats; it has no state."""

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
