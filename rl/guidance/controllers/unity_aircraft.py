"""Classical control of `unity_aircraft`: the nose follows the desired force, the boost is its projection.

Pitch and yaw rates are commanded. A rate changes by at most `smooth_rate` of its range per second: an angle is a double
integrator with a bounded acceleration, and within that bound a rate command is obeyed at once:

    psi' = psi*' + approach(psi* - psi),   theta' likewise,   k = (1 - exp(-attitude_bandwidth T)) / T.

The boost inverts the drag exactly over the interval (force_vector.py), and the action inverts the geometric mapping of
the boost. The bank does not affect the path.
"""

import math

import torch
from torch import Tensor

from rl.guidance.avoidance import SlotController, Wanted
from rl.guidance.controllers.force_vector import ForceGains, ForceVector, approach, course_of, cross, wrap
from rl.guidance.knowledge import Knowledge
from taichi_sim.config import Positive
from taichi_sim.conventions import AHEAD, DOWN, EAST, NORTH
from taichi_sim.uav.unity_aircraft import DEG, UnityAircraft

MAX_CLIMB = math.radians(60.0)  # of the nose: yaw means little near the vertical; assumed
LEAST_FORCE = 0.5  # m/s^2: a shorter force vector has no direction to follow; assumed


class UnityAircraftGains(ForceGains):
    """Gains, tuned by rl/tune.py on `paper`."""

    acceleration: Positive = 5.1
    horizon: Positive = 5.2
    berth: Positive = 0.7
    margin: Positive = 1.3
    soft: Positive = 4.3
    attitude_bandwidth: Positive = 8.0  # rad/s, of pitch and yaw


class UnityAircraftController(SlotController):
    """Acts for a team of aircraft; it has no state."""

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
