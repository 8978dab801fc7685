"""The boats, whether they take part or not: the courses they are ordered to hold, their decks, their radio messages.

The classical controller of a boat's model sails its course, without collision avoidance. Where the boats take no part,
they hold the ordered course; a team of boats (deck_steadying.py) may deviate from it. A vessel without a classical
controller, such as an FPSO, coasts with zero actions from its initial motion; it cannot take part.
"""

import math

import torch
from torch import Tensor

from rl.guidance.controllers import controller_of
from rl.guidance.controllers.vessel import CourseCommand, Hull6DofController, Manoeuvring3dofController
from rl.guidance.targets_and_errors import SLOT_SIZE, TARGET_SIZE, SlotErrors, Target, wrap
from rl.missions.landing.config import LandingScenario
from rl.missions.landing.deck_motion import DeckMotion, Decks, deck_motion
from rl.perception.instruments import Readings
from rl.perception.sensors import Nearby
from rl.step import Due
from rl.team import ControllerError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels.conventions import AHEAD, DOWN, STARBOARD
from taichi_sim.kernels.rotation import torch_euler_from_rotation
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle
from taichi_sim.world import Script, World

SMOOTH = 5.0  # s, over which the velocity of a deck is averaged, from which its swing counts; assumed
QUICK = 0.3  # s, over which what the boat measures of its deck's acceleration is averaged; assumed
REMEMBERED = 20.0  # s, over which a boat knows how much its deck moves; assumed
SLOWEST = 0.05  # m/s: a boat that is to stay still is to have a course, too
COURSE, SPEED = 0, 1  # columns of what boats are ordered, sail for, and deviate by


class Message:
    """Columns of what a boat sends, 3 each: place, velocity and acceleration of the deck (NED); roll, pitch and heading
    of the boat, its rates (b).
    """

    PLACE, VELOCITY, ACCELERATION, ATTITUDE, RATES, SIZE = range(0, 18, 3)


class Boats(Decks):
    """The boats and their decks; every tensor is [env, boat, ...].

    Attributes:
        own: what the boats measure of themselves. deck: the truth. seen: the deck as measured; acceleration of it.
        ordered: [.., 2] course (rad) and speed (m/s) of the episode. aim: those that are sailed for. steered: course
            now, rad. mean: [.., 3] velocity of the deck, averaged. squares: [.., 3] of the deck's vertical speed, roll
            and pitch as measured, averaged.
    """

    def __init__(self, fleet: Fleet[Vehicle], steps: Tensor, config: LandingScenario, *, manned: bool):
        """Sail `fleet`; `steps` int64 [env] are the decisions since the episode began.

        Raises:
            ControllerError: for an aircraft; where they are `manned`, for a vessel that no classical controller sails.
        """
        section, model, state = config.parts[fleet.name], fleet.model, fleet.state
        if model.medium != "water":
            raise ControllerError(f"{fleet.name}.vehicle = {section.vehicle!r}: no vessel that the mission could sail")
        super().__init__(fleet)
        self.helm: Hull6DofController | Manoeuvring3dofController | None = self.remember(None)
        try:
            helm = controller_of(model, section.control, f"{fleet.name}.control")
            if not isinstance(helm, Hull6DofController | Manoeuvring3dofController):
                raise ControllerError(
                    f"{fleet.name}.vehicle = {section.vehicle!r}: the mission sails manoeuvring_3dof and hull_6dof "
                    "alone"
                )
            self.helm = helm
        except ControllerError:
            if manned:
                raise
        self.interval, self._way = config.decision_interval, config.course
        self.own = self.remember(Readings(fleet, section.sensors, self.interval, config.first_number(fleet.name)))
        self.seen: DeckMotion = deck_motion(self.own, self.centre)
        self._alone = self.remember(Alone(self.own, steps))
        shape = state.shape[:2]
        self.ordered, self.aim = (self.remember(state.new_zeros((*shape, 2))) for _ in range(2))
        self.steered = self.remember(state.new_zeros(shape))
        self.mean, self.acceleration, self._before, self.squares = (
            self.remember(state.new_zeros((*shape, 3))) for _ in range(4)
        )

    # -- sailing ---------------------------------------------------------------------------------------------------

    def sail(self, deviation: Tensor) -> Tensor:
        """Vessel actions [env, boat, a] for deviations [env, boat, 2] in [-1, 1] from the ordered course and speed."""
        way = self._way
        course = self.ordered[..., COURSE] + math.radians(way.turn_deg) * deviation[..., COURSE]
        speed = (self.ordered[..., SPEED] + way.change * deviation[..., SPEED]).clamp(min=SLOWEST)
        self.aim = torch.stack((course, speed), dim=-1)
        if self.helm is None:
            return torch.zeros_like(self.fleet.action)
        wanted = speed.unsqueeze(-1) * torch.stack((self.steered.cos(), self.steered.sin()), dim=-1)
        return self.helm.act(self._alone, CourseCommand(wanted, torch.zeros_like(wanted)))

    def begin(self, envs: Tensor, course: Tensor, speed: Tensor) -> None:
        """Begin episodes in environments `envs` [n] with the ordered `course` and `speed` [n, boat] (rad, m/s)."""
        self.ordered[envs] = torch.stack((course, speed.clamp(min=SLOWEST)), dim=-1).to(self.ordered)
        self.aim[envs], self.steered[envs] = self.ordered[envs], course.to(self.steered)

    # -- measuring -------------------------------------------------------------------------------------------------

    @property
    def swing(self) -> Tensor:
        """Horizontal speed [env, boat] (m/s) of the deck relative to its mean velocity."""
        return (self.deck.velocity - self.mean)[..., :2].norm(dim=-1)

    def truth(self, due: Due) -> None:
        """Measure the decks, and turn on towards the course that is sailed for."""
        dt, fresh, on = self.interval, due.begins.view(-1, 1, 1), due.goes_on.view(-1, 1, 1)
        self.follow()
        mean = self.mean + dt / (SMOOTH + dt) * (self.deck.velocity - self.mean)
        self.mean = torch.where(on, mean, torch.where(fresh, self.deck.velocity, self.mean))
        most = math.radians(self._way.turn_rate_deg) * dt
        turn = wrap(self.aim[..., COURSE] - self.steered).clamp(-most, most)
        self.steered = torch.where(on.squeeze(-1), self.steered + turn, self.steered)

    def perceive(self, due: Due) -> None:
        """Read the instruments, and follow how much the deck moves by them."""
        dt, fresh, on = self.interval, due.begins.view(-1, 1, 1), due.goes_on.view(-1, 1, 1)
        self.own.read(due)
        self.seen = deck_motion(self.own, self.centre)
        v, a, R = self.seen.velocity, self.acceleration, self.seen.R
        a = a + dt / (QUICK + dt) * ((v - self._before) / dt - a)
        self.acceleration = torch.where(on, a, torch.where(fresh, 0.0, self.acceleration))
        self._before = v.clone()
        moves = torch.stack((v[..., DOWN], R[..., DOWN, STARBOARD], R[..., DOWN, AHEAD]), dim=-1)
        squares = self.squares + dt / (REMEMBERED + dt) * (moves.square() - self.squares)
        self.squares = torch.where(on, squares, torch.where(fresh, moves.square(), self.squares))

    def restored(self) -> None:
        """Compute the motion of the decks, true and measured, again after a snapshot was restored."""
        super().restored()
        self.seen = deck_motion(self.own, self.centre)

    def message(self) -> Tensor:
        """What each boat sends about its deck and itself, [env, boat, Message.SIZE]."""
        seen, attitude = self.seen, torch_euler_from_rotation(self.seen.R)
        return torch.cat((seen.place, seen.velocity, self.acceleration, attitude, self.own.angular_velocity_b), dim=-1)


class Alone(Remembers):
    """Knowledge (rl/guidance/knowledge.py) of boats that have no slots, no target, and nobody around."""

    axes, radio = 2, None

    def __init__(self, own: Readings, steps: Tensor):
        """Know the boats as they measure themselves; `steps` int64 [env], decisions since the episode began."""
        state = own.state
        self.fleet, self.steps, self.radius = own, steps, own.model.collision_radius
        self.now = self.remember(SlotErrors(state, self.axes))
        self.slot_table = state.new_zeros((*state.shape[:2], SLOT_SIZE))
        self.target = self.remember(Target(state.new_zeros((len(state), 1, TARGET_SIZE)), self.now.slot[:, 0]))
        self.sensor = self.remember(Nearby(state, 0, 0, 0.0, self.radius, self.axes))


class Helm(Script):
    """Steers the boats of a mission in which they take no part."""

    def __init__(self, boats: Boats):
        """Steer `boats`."""
        self.name, self._boats = boats.fleet.name, boats

    def __call__(self, world: World) -> Tensor:
        """Hold the ordered course and speed."""
        return self._boats.sail(torch.zeros_like(self._boats.ordered))
