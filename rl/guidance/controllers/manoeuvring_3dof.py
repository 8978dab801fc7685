"""Classical control of `manoeuvring_3dof`: track control (course.py), with each load clipped to its limit."""

import torch
from torch import Tensor

from rl.guidance.avoidance import SlotController
from rl.guidance.controllers.course import Course, CourseCommand
from rl.guidance.controllers.vessel import CourseGains, Resistance, VesselDynamics
from rl.guidance.knowledge import Knowledge
from taichi_sim.config import Positive
from taichi_sim.usv.manoeuvring_3dof import Manoeuvring3dof, Manoeuvring3dofParams


class Manoeuvring3dofGains(CourseGains):
    """Gains, named as those of `hull_6dof`; not tuned."""

    acceleration: Positive = 0.3
    horizon: Positive = 25.0
    berth: Positive = 0.6
    margin: Positive = 0.4


class Manoeuvring3dofController(SlotController):
    """Acts for a team of vessels; its only state is their drift."""

    STATE = ("course",)
    Gains = Manoeuvring3dofGains

    def __init__(self, model: Manoeuvring3dof, gains: Manoeuvring3dofGains | None = None):
        """Compute what follows from the parameters of `model` and the `gains`."""
        self.params = model.params
        self.gains = gains or Manoeuvring3dofGains()
        self.course = Course(vessel(model.params), self.gains, model.dt * model.substeps)

    def wanted(self, team: Knowledge) -> CourseCommand:
        """The velocity command that leads to the slots."""
        return self.course.wanted(team)

    def act(self, team: Knowledge, wanted: CourseCommand) -> Tensor:
        """Actions [env, vehicle, 2 or 3] in [-1, 1]; none for a vehicle whose state is not finite."""
        p, load = self.params, self.course.load(team, wanted)
        X, N = load.X / p.surge_force_max, load.N / p.yaw_moment_max
        if p.actions == "acceleration_yaw":
            action = torch.stack((2 * X - 1, N), dim=-1)
        else:
            Y = load.Y / p.sway_force_max if p.sway_force_max else torch.zeros_like(X)
            action = torch.stack((X, Y, N), dim=-1)
        return torch.nan_to_num(action).clamp(-1.0, 1.0)


def vessel(p: Manoeuvring3dofParams) -> VesselDynamics:
    """The vessel for its controller: with the sway force due to yaw, without the yaw moment due to sway."""
    M = p.M
    return VesselDynamics(
        m11=float(M[0, 0]), m22=float(M[1, 1]), m33=float(M[2, 2]), surge=Resistance(-p.X_u, -p.X_uu, -p.X_uuu),
        sway=Resistance(-p.Y_v, -p.Y_vv), yaw=Resistance(-p.N_r, -p.N_rr), thrust=p.surge_force_max,
        moment=p.yaw_moment_max, sway_yaw=-p.Y_r,
    )  # fmt: skip
