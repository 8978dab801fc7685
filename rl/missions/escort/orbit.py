"""Classical control of aircraft that circle a moving point: a Lyapunov guidance vector field in wind.

With x = position - centre, of length r, the field is the direction of flight relative to the centre, for a circle of
radius R (Frew, Lawrence & Morris 2008, J. Guidance, Control, and Dynamics 31(2), eq. 7; sigma = 1 turns clockwise):

    d = -(r^2 - R^2) / (r^2 + R^2) e_r + 2 r R / (r^2 + R^2) sigma e_theta.

It leads to the circle from anywhere, and around it. The centre moves with v_c and the air with w. The velocity over
ground v* = v_c + s d is the one with |v* - w| = V (wind triangle). The field turns as

    chi' = theta' + 2 sigma R r' / (r^2 + R^2),

which is fed forward to the bank. Each aircraft chooses its airspeed to fly midway between those ahead and behind,
V = cruise + sat(k_phase R (gap ahead - gap behind) / 2) (loc. cit., sec. IV, by speed). The formations' controller
flies the command and evades obstacles (rl/guidance/controllers/fixed_wing_6dof.py).
"""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rl.guidance.controllers.fixed_wing_6dof import (
    EVADING,
    FixedWing6DofController,
    FixedWing6DofGains,
    FlightCommand,
    velocity_through_air,
)
from rl.guidance.geometry import cross, to_starboard
from taichi_sim.config import Positive
from taichi_sim.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF

if TYPE_CHECKING:
    from rl.missions.escort.aircraft import MeasuredAircraft

LEAST_SHARE = 0.2  # of the airspeed, the least speed relative to the centre; assumed


class OrbitGains(FixedWing6DofGains):
    """Gains of the orbit, besides those of flight and avoidance."""

    leader_share: Positive = 2.0  # there is no leader
    phase_gain: Positive = 0.05  # 1/s
    phase_speed: Positive = 4.0  # m/s, greatest change of airspeed for phases
    field_radius: Positive = 1.0  # without effect; tuned scenarios may hold it


class OrbitController:
    """Controller of aircraft that circle; it has no memory."""

    STATE = ()
    Gains = OrbitGains

    def __init__(self, model: FixedWing6DOF, gains: OrbitGains | None = None):
        """Derive gains from those of the autopilot."""
        self.gains = gains or self.Gains()
        self.flight = FixedWing6DofController(model, self.gains)

    def __call__(self, team: "MeasuredAircraft") -> Tensor:
        """Actions [env, aircraft, action] in [-1, 1]; none where the state is not finite."""
        return self.act(team, self.wanted(team))

    def act(self, team: "MeasuredAircraft", wanted: FlightCommand) -> Tensor:
        """Actions [env, aircraft, action] in [-1, 1] that follow the command."""
        return self.flight.act(team, wanted)

    def wanted(self, team: "MeasuredAircraft") -> FlightCommand:
        """The velocity command of the field above, its change, and whether it evades."""
        loops, limits = self.flight.loops, self.flight.limits
        v, air, R = team.fleet.velocity_n, velocity_through_air(team), team.orbit.radius
        low, cruise, high = limits.speeds
        faster = (self.gains.phase_gain * R * team.gap_error).clamp(-self.gains.phase_speed, self.gains.phase_speed)
        airspeed = (cruise + faster).clamp(low, high)
        x = team.fleet.position_n[..., :2] - team.centre
        r = x.norm(dim=-1).clamp(min=1.0)
        sigma, square = team.orbit.turn, r * r + R * R
        out, along = -(r * r - R * R) / square, 2 * r * R / square * sigma
        e = x / r.unsqueeze(-1)
        e_theta = to_starboard(e)
        d = out.unsqueeze(-1) * e + along.unsqueeze(-1) * e_theta
        against = v[..., :2] - air[..., :2] - team.centre_velocity
        ahead = (against * d).sum(-1)
        across = cross(d, against)
        through = (airspeed * airspeed - across * across).clamp(min=0.0).sqrt()
        s = torch.maximum(ahead + through, LEAST_SHARE * airspeed)
        down = (loops.height * team.height_error).clamp(-limits.climb, limits.climb)
        level = team.centre_velocity + s.unsqueeze(-1) * d
        direct = torch.cat((level, down.unsqueeze(-1)), dim=-1)
        team.now.slot_velocity.copy_(direct)
        velocity = self.flight.avoid(team, direct)
        moves = v[..., :2] - team.centre_velocity
        turn = (moves * e_theta).sum(-1) / r + 2 * sigma * R / square * (moves * e).sum(-1)
        change = (s * turn).unsqueeze(-1) * to_starboard(d)
        speed = air[..., :2].norm(dim=-1).clamp(min=limits.floor)
        nose = air[..., :2] / speed.unsqueeze(-1)
        evading = (velocity - direct).norm(dim=-1) > EVADING
        return FlightCommand(velocity, ((change * nose).sum(-1), cross(nose, change)), evading)
