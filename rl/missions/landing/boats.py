"""The boats: the courses they are ordered to hold, their decks, their radio messages.

The classical controller of a boat's model sails its course, without collision avoidance. A vessel without a classical
controller, such as an FPSO, coasts with zero actions from its initial motion.
"""

from contextlib import suppress

import torch
from torch import Tensor

from rl.guidance.controllers import controller_of
from rl.guidance.controllers.vessel import CourseCommand, Hull6DofController, Manoeuvring3dofController
from rl.guidance.helm import Alone
from rl.missions.landing.config import LandingScenario
from rl.missions.landing.decks import DeckMotion, Decks, deck_motion
from rl.perception.instruments import Readings
from rl.step import Due
from rl.team import ControllerError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.rotation import torch_euler_from_rotation
from taichi_sim.vehicle import Vehicle
from taichi_sim.world import Script, World

QUICK = 0.3  # s, over which what the boat measures of its deck's acceleration is averaged; assumed
SLOWEST = 0.05  # m/s: a boat that is to stay still is to have a course, too


class Message:
    """Columns of what a boat sends, 3 each: place, velocity and acceleration of the deck (NED); roll, pitch and heading
    of the boat, its rates (b).
    """

    PLACE, VELOCITY, ACCELERATION, ATTITUDE, RATES, SIZE = range(0, 18, 3)


class Boats(Decks):
    """The boats and their decks; every tensor is [env, boat, ...].

    Attributes:
        own: what the boats measure of themselves. deck: the truth. seen: the deck as measured; acceleration of it.
        course, speed: that are ordered for the episode, rad, m/s.
    """

    def __init__(self, fleet: Fleet[Vehicle], steps: Tensor, config: LandingScenario):
        """Sail `fleet`; `steps` int64 [env] are the decisions since the episode began."""
        section, model, state = config.parts[fleet.name], fleet.model, fleet.state
        if model.medium != "water":
            raise ControllerError(f"{fleet.name}.vehicle = {section.vehicle!r}: no vessel that the mission could sail")
        super().__init__(fleet)
        self.helm: Hull6DofController | Manoeuvring3dofController | None = self.remember(None)
        with suppress(ControllerError):
            helm = controller_of(model, section.control, f"{fleet.name}.control")
            self.helm = helm if isinstance(helm, Hull6DofController | Manoeuvring3dofController) else None
        self.interval = config.decision_interval
        self.own = self.remember(Readings(fleet, section.sensors, self.interval, config.first_number(fleet.name)))
        self.seen: DeckMotion = deck_motion(self.own, self.centre)
        self._alone = self.remember(Alone(self.own, steps))
        shape = state.shape[:2]
        self.course, self.speed = (self.remember(state.new_zeros(shape)) for _ in range(2))
        self.acceleration, self._before = (self.remember(state.new_zeros((*shape, 3))) for _ in range(2))

    # -- sailing ---------------------------------------------------------------------------------------------------

    def sail(self) -> Tensor:
        """Vessel actions [env, boat, a] that hold the ordered course and speed."""
        if self.helm is None:
            return torch.zeros_like(self.fleet.action)
        wanted = self.speed.unsqueeze(-1) * torch.stack((self.course.cos(), self.course.sin()), dim=-1)
        return self.helm.act(self._alone, CourseCommand(wanted, torch.zeros_like(wanted)))

    def begin(self, envs: Tensor, course: Tensor, speed: Tensor) -> None:
        """Begin episodes in environments `envs` [n] with the ordered `course` and `speed` [n, boat] (rad, m/s)."""
        self.course[envs], self.speed[envs] = course.to(self.course), speed.clamp(min=SLOWEST).to(self.speed)

    # -- measuring -------------------------------------------------------------------------------------------------

    def perceive(self, due: Due) -> None:
        """Read the instruments, and follow the deck by them."""
        dt, fresh, on = self.interval, due.begins.view(-1, 1, 1), due.goes_on.view(-1, 1, 1)
        self.own.read(due)
        self.seen = deck_motion(self.own, self.centre)
        v, a = self.seen.velocity, self.acceleration
        a = a + dt / (QUICK + dt) * ((v - self._before) / dt - a)
        self.acceleration = torch.where(on, a, torch.where(fresh, 0.0, self.acceleration))
        self._before = v.clone()

    def restored(self) -> None:
        """Compute the motion of the decks, true and measured, again after a snapshot was restored."""
        super().restored()
        self.seen = deck_motion(self.own, self.centre)

    def message(self) -> Tensor:
        """What each boat sends about its deck and itself, [env, boat, Message.SIZE]."""
        seen, attitude = self.seen, torch_euler_from_rotation(self.seen.R)
        return torch.cat((seen.place, seen.velocity, self.acceleration, attitude, self.own.angular_velocity_b), dim=-1)


class Helm(Script):
    """Holds the boats on their ordered courses."""

    def __init__(self, boats: Boats):
        """Steer `boats`."""
        self.name, self._boats = boats.fleet.name, boats

    def __call__(self, world: World) -> Tensor:
        """See `Boats.sail`."""
        return self._boats.sail()
