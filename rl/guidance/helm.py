"""A helm: holds vessels of any model on ordered courses at ordered speeds.

Vessels with a classical controller (controllers/) sail by its inner loops. Vessels that are steered by rudders
(`Vessel. steer`) sail by a course autopilot with rate feedback, and revolutions in proportion to the speed:

    delta = e - T r,   T = `RATE_TIME` L / U (Fossen 2021, Handbook of Marine Craft Hydrodynamics and Motion Control,
    ch. 15.3: a PD heading autopilot; its gain of 1 rad of rudder per rad is usual for ships).
"""

from contextlib import suppress

import torch
from torch import Tensor

from rl.guidance.controllers import controller_of
from rl.guidance.controllers.vessel import CourseCommand, CourseController
from rl.guidance.targets_and_errors import SLOT_SIZE, TARGET_SIZE, SlotErrors, Target, wrap
from rl.perception.instruments import Readings
from rl.perception.sensors import Nearby
from rl.team import ControllerError
from taichi_sim.errors import refuse
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import YAW_RATE
from taichi_sim.kernels.rotation import torch_heading
from taichi_sim.models.usv.vessel_base import Vessel
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle

RATE_TIME = 1.5  # assumed


class Alone(Remembers):
    """Knowledge (knowledge.py) of boats that have no slots, no target, and nobody around."""

    axes, radio = 2, None

    def __init__(self, own: Readings | Fleet[Vehicle], steps: Tensor):
        """Know the boats as `own`; `steps` int64 [env], decisions since the episode began."""
        state = own.state
        self.fleet, self.steps, self.radius = own, steps, own.model.collision_radius
        self.now = self.remember(SlotErrors(state, self.axes))
        self.slot_table = state.new_zeros((*state.shape[:2], SLOT_SIZE))
        self.target = self.remember(Target(state.new_zeros((len(state), 1, TARGET_SIZE)), self.now.slot[:, 0]))
        self.sensor = self.remember(Nearby(state, 0, 0, 0.0, self.radius, self.axes))


class Helm(Remembers):
    """Holds a team of vessels on courses; see the module."""

    def __init__(self, fleet: Fleet[Vehicle], steps: Tensor, key: str):
        """Steer `fleet`; `steps` int64 [env] are the decisions since the episode began, `key` names its vehicle."""
        self._fleet, model = fleet, fleet.model
        self._alone = self.remember(Alone(fleet, steps))
        found = None
        with suppress(ControllerError):
            found = controller_of(model, {}, key)
        self._loops = self.remember(found if isinstance(found, CourseController) else None)
        rudder = isinstance(model, Vessel) and model.helm_max is not None
        why = f"{key}: no vessel that holds a course: name one with a rudder, or thrusters that drive and turn it"
        refuse(ControllerError, (self._loops is None and not rudder, why))

    def __call__(self, course: Tensor, speed: Tensor) -> Tensor:
        """Actions [env, vehicle, a] for courses (rad, of the nose) and speeds (m/s) [env, vehicle]."""
        if self._loops is not None:
            wanted = speed.unsqueeze(-1) * torch.stack((course.cos(), course.sin()), dim=-1)
            return self._loops.act(self._alone, CourseCommand(wanted, torch.zeros_like(wanted)))  # pyright: ignore
        fleet, model = self._fleet, self._fleet.model
        assert isinstance(model, Vessel) and model.helm_max is not None
        u = fleet.velocity_b[..., 0].clamp(min=0.1 * model.limits.speeds[2])
        error = wrap(course - torch_heading(fleet.quaternion_nb))
        rudder = error - RATE_TIME * model.size[0] / u * fleet.state[..., YAW_RATE]
        helm = (rudder / model.helm_max).clamp(-1.0, 1.0)
        ahead = (speed / model.limits.speeds[2]).clamp(0.0, 1.0)
        given = model.steer(ahead.cpu().numpy(), helm.cpu().numpy())
        return torch.as_tensor(given, dtype=fleet.state.dtype, device=fleet.state.device)
