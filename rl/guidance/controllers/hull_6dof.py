"""Classical control of `hull_6dof`: track control (course.py), with its loads allocated to two propellers.

Half the difference of the two thrusts makes the moment, their mean the surge force. The moment has priority: the mean
is limited so that both propellers stay within their range with the desired difference.
"""

import torch
from torch import Tensor

from rl.guidance.avoidance import SlotController
from rl.guidance.controllers.course import Course, CourseCommand, Load
from rl.guidance.controllers.vessel import CourseGains, Resistance, VesselDynamics
from rl.guidance.knowledge import Knowledge
from rl.mission import ControllerError
from taichi_sim.config import Positive
from taichi_sim.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.usv.hull.thrusters import PropellerPair


class Hull6DofGains(CourseGains):
    """Gains, tuned by rl/tune.py on `otter`."""

    acceleration: Positive = 0.94
    horizon: Positive = 26.0
    berth: Positive = 0.6
    margin: Positive = 0.4
    hard: Positive = 84.0
    lean: Positive = 0.16


class Hull6DofController(SlotController):
    """Acts for a team of hulls; its only state is their drift."""

    STATE = ("course",)
    Gains = Hull6DofGains

    def __init__(self, model: Hull6Dof, gains: Hull6DofGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains`.

        Raises:
            ControllerError: if it has no propellers, or is not commanded by them.
        """
        if model.params.thrusters is None or model.params.actions not in ("surge_yaw", "left_right"):
            raise ControllerError(
                "the classical controller of a hull_6dof needs two propellers, [thrusters], with actions = "
                '"surge_yaw" or "left_right"'
            )
        self.thrusters, self.actions = model.params.thrusters, model.params.actions
        craft = vessel(model, self.thrusters)
        self.gains = gains or Hull6DofGains()
        self.course = Course(craft, self.gains, model.dt * model.substeps)

    def wanted(self, team: Knowledge) -> CourseCommand:
        """The velocity command that leads to the slots."""
        return self.course.wanted(team)

    def act(self, team: Knowledge, wanted: CourseCommand) -> Tensor:
        """Actions [env, vehicle, 2] in [-1, 1]; none for a vehicle whose state is not finite."""
        left, right = shares(self.thrusters, self.course.load(team, wanted), astern=self.actions == "left_right")
        if self.actions == "left_right":
            action = torch.stack((shaft(self.thrusters, left), shaft(self.thrusters, right)), dim=-1)
        else:
            t = self.thrusters
            action = torch.stack(
                ((left + right) / t.thrust_max - 1, (left - right) / (t.thrust_max - t.thrust_min)), dim=-1
            )
        return torch.nan_to_num(action).clamp(-1.0, 1.0)


def vessel(model: Hull6Dof, thrusters: PropellerPair) -> VesselDynamics:
    """The hull in the plane; cross-flow drag of pure sway and of pure yaw: L and L^4 / 32 in the strip integral."""
    h, M = model.params.hydrodynamics, model.slow_mass
    section = 0.5 * h.cross_flow_density * h.cross_flow_draft * h.cross_flow_coefficient
    L = h.cross_flow_length
    return VesselDynamics(
        m11=float(M[0, 0]), m22=float(M[1, 1]), m33=float(M[5, 5]), surge=Resistance(h.linear[0], h.quadratic[0]),
        sway=Resistance(h.linear[1], h.quadratic[1] + section * L),
        yaw=Resistance(h.linear[5], h.quadratic[5] + section * L**4 / 32), thrust=2 * thrusters.thrust_max,
        moment=_arm(thrusters) * (thrusters.thrust_max - thrusters.thrust_min),
    )  # fmt: skip


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
