"""The boats of the mission: the courses they are ordered to hold, their decks' motion, and their radio messages.

The classical controller of a boat's model sails its course, without collision avoidance. A policy for the boats may
deviate from the ordered course and speed within the limits of `[course]` to steady the deck; it observes what the boat
measures of itself. Without a policy, or where the team does not take part, boats hold the ordered course. A vessel
without a classical controller, such as an FPSO, coasts with zero actions from its initial motion; it cannot have a
policy.
"""

import math
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor

from rl.guidance.controllers import controller_of
from rl.guidance.controllers.vessel import CourseCommand
from rl.guidance.geometry import TARGET_SIZE, Target, wrap
from rl.guidance.observations import squashed
from rl.missions.landing import rewards
from rl.missions.landing.deck_motion import DeckMotion, deck_motion
from rl.missions.landing.level_frame import into_level
from rl.perception.due import Due
from rl.perception.instruments import Readings
from rl.rewards import paid
from rl.team import Controller, ControllerError, Endings, Team
from taichi_sim.conventions import AHEAD, DOWN, STARBOARD
from taichi_sim.kernels.rotation import torch_euler_from_rotation
from taichi_sim.script import Script

SMOOTH = 5.0  # s, over which the velocity of a deck is averaged, from which its swing counts; assumed
QUICK = 0.3  # s, over which what the boat measures of its deck's acceleration is averaged; assumed
REMEMBERED = 20.0  # s, over which a boat knows how much its deck moves; assumed
SLOWEST = 0.05  # m/s: a boat that is to stay still is to have a course, too
MESSAGE = 15  # of the deck: place, velocity, acceleration; of the boat: roll, pitch and heading, rates (b); 3 each
COURSE, SPEED = 0, 1  # columns of what boats are ordered, sail for, and choose


class Boats(Team):
    """The team of boats, measured with their decks after each step; every tensor is [env, boat, ...].

    Attributes:
        own: what the boats measure of themselves. deck: the truth. seen: the deck as measured; acceleration of it.
        ordered: [.., 2] course (rad) and speed (m/s) of the episode. aim: those that are sailed for. steered: course
            now, rad. chosen, chosen_before: the policy's last two actions. served: bool, its aircraft has landed
            in this step.
    """

    STATE = (
        "own", "ordered", "aim", "steered", "chosen", "chosen_before", "mean", "acceleration", "_before", "_squares",
    )  # fmt: skip

    logged = ("landed",)

    def __init__(self, mission: Any, name: str):
        """Prepare team `name`.

        Raises:
            ControllerError: for an aircraft; where they take part, for a vessel that no classical controller sails.
        """
        super().__init__(mission, name)
        config, state, model = mission.config, self.fleet.state, self.fleet.model
        if model.medium != "water":
            raise ControllerError(f"{name}.vehicle = {self.section.vehicle!r}: no vessel that the mission could sail")
        self.helm = self._helm(mission.manned)
        self.interval = config.decision_interval
        number = list(config.teams).index(name)
        self.own = Readings(self.fleet, self.section.sensors, self.interval, 64 * number)
        shape, deck = state.shape[:2], model.deck
        assert deck is not None
        self.centre = state.new_tensor(deck.centre)
        self.ordered, self.aim = state.new_zeros((*shape, 2)), state.new_zeros((*shape, 2))
        self.steered = state.new_zeros(shape)
        self.chosen = self.chosen_before = state.new_zeros((*shape, 2))
        self.mean, self.acceleration, self._before = (state.new_zeros((*shape, 3)) for _ in range(3))
        self._squares = state.new_zeros((*shape, 3))  # of vertical speed, roll, pitch, averaged over REMEMBERED
        self.served = torch.zeros(shape, dtype=torch.bool, device=state.device)
        table = state.new_zeros((shape[0], 1, TARGET_SIZE))
        blind = dict.fromkeys(("obstacles", "team_mates"), state.new_zeros((1, 1, 1, 1)))
        self._view = SimpleNamespace(
            fleet=self.own, target=Target(table, state[:, 0, :3]), now=SimpleNamespace(table=table, about=False),
            sensor=SimpleNamespace(**blind, num_obstacles=0, num_mates=0), radius=self.fleet.model.collision_radius,
            axes=2,
        )  # fmt: skip
        self.deck: DeckMotion = deck_motion(self.fleet, self.centre)
        self.seen: DeckMotion = deck_motion(self.own, self.centre)

    def _helm(self, manned: bool) -> Any:
        """Return the vessel's classical controller; None without one, if boats take no part (else ControllerError)."""
        try:
            helm = controller_of(self.fleet.model, self.section.control, f"{self.name}.control")
        except ControllerError:
            if manned:
                raise
            return None
        if hasattr(helm, "course"):
            return helm
        if manned:
            raise ControllerError(
                f"{self.name}.vehicle = {self.section.vehicle!r}: the mission sails manoeuvring_3dof and hull_6dof "
                "alone"
            )
        return None

    # -- sailing ---------------------------------------------------------------------------------------------------

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the policy's outputs."""
        return ("course", "speed")

    def commanded(self, action: Tensor) -> Tensor:
        """Vessel actions [env, boat, a] for a policy's deviations [env, boat, 2] from the ordered course and speed."""
        way, chosen = self.mission.config.course, action.clamp(-1.0, 1.0) + 0.0 * action
        self.chosen = chosen
        course = self.ordered[..., COURSE] + math.radians(way.turn_deg) * chosen[..., COURSE]
        speed = (self.ordered[..., SPEED] + way.change * chosen[..., SPEED]).clamp(min=SLOWEST)
        self.aim = torch.stack((course, speed), dim=-1)
        if self.helm is None:
            return torch.zeros_like(self.fleet.action)
        wanted = speed.unsqueeze(-1) * torch.stack((self.steered.cos(), self.steered.sin()), dim=-1)
        return self.helm.act(self._view, CourseCommand(wanted, torch.zeros_like(wanted)))

    def held(self) -> Tensor:
        """The vessels' actions that hold the ordered course and speed."""
        self.mission.perceive()
        return self.commanded(torch.zeros_like(self.chosen))

    def begin(self, envs: Tensor, course: Tensor, speed: Tensor) -> None:
        """Begin episodes in environments `envs` [n] with the ordered `course` and `speed` [n, boat] (rad, m/s)."""
        self.ordered[envs] = torch.stack((course, speed.clamp(min=SLOWEST)), dim=-1).to(self.ordered)
        self.aim[envs], self.steered[envs] = self.ordered[envs], course.to(self.steered)

    def restored(self) -> None:
        """Compute the motion of the decks again after a snapshot was restored."""
        self.deck, self.seen = deck_motion(self.fleet, self.centre), deck_motion(self.own, self.centre)

    @property
    def swing(self) -> Tensor:
        """Horizontal speed [env, boat] (m/s) of the deck relative to its mean velocity."""
        return (self.deck.velocity - self.mean)[..., :2].norm(dim=-1)

    # -- measuring -------------------------------------------------------------------------------------------------

    def truth(self, due: Due) -> None:
        """Measure the decks, and turn on towards the course that is sailed for."""
        dt, fresh, on = self.interval, due.begins.view(-1, 1, 1), due.goes_on.view(-1, 1, 1)
        self.deck = deck_motion(self.fleet, self.centre)
        mean = self.mean + dt / (SMOOTH + dt) * (self.deck.velocity - self.mean)
        self.mean = torch.where(on, mean, torch.where(fresh, self.deck.velocity, self.mean))
        self.chosen = torch.where(fresh, 0.0, self.chosen)
        self.chosen_before = torch.where(fresh, 0.0, self.chosen_before)
        most = math.radians(self.mission.config.course.turn_rate_deg) * dt
        turn = wrap(self.aim[..., COURSE] - self.steered).clamp(-most, most)
        self.steered = torch.where(on.squeeze(-1), self.steered + turn, self.steered)

    def sense(self, due: Due) -> None:
        """Read the instruments, and follow how much the deck moves by them."""
        dt, fresh, on = self.interval, due.begins.view(-1, 1, 1), due.goes_on.view(-1, 1, 1)
        self.own.read(due)
        self.seen = deck_motion(self.own, self.centre)
        v, a, R = self.seen.velocity, self.acceleration, self.seen.R
        a = a + dt / (QUICK + dt) * ((v - self._before) / dt - a)
        self.acceleration = torch.where(on, a, torch.where(fresh, 0.0, self.acceleration))
        self._before = v.clone()
        moves = torch.stack((v[..., DOWN], R[..., DOWN, STARBOARD], R[..., DOWN, AHEAD]), dim=-1)
        squares = self._squares + dt / (REMEMBERED + dt) * (moves.square() - self._squares)
        self._squares = torch.where(on, squares, torch.where(fresh, moves.square(), self._squares))

    def message(self) -> Tensor:
        """What each boat sends about its deck and itself, [env, boat, MESSAGE]."""
        seen, attitude = self.seen, torch_euler_from_rotation(self.seen.R)
        return torch.cat((seen.place, seen.velocity, self.acceleration, attitude, self.own.angular_velocity_b), dim=-1)

    # -- learning --------------------------------------------------------------------------------------------------

    def reward(self, ended: Endings) -> Tensor:
        """See rewards.py."""
        return paid(rewards.BOAT_TERMS, self.section.boat_reward, self, ended)

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """Share of boats whose aircraft landed in this step."""
        return {"landed": self.served.float().mean()}

    def make_controller(self) -> Controller:
        """The boats hold their course."""
        return Hold()

    def observe(self) -> dict[str, Tensor]:
        """Observation terms of each boat."""
        own, R = self.own, self.seen.R
        level = into_level(self.seen.velocity, own.heading)
        (c, s), course = own.heading, self.ordered[..., COURSE]
        off, steered = wrap(torch.atan2(s, c) - course), wrap(self.steered - course)
        return {
            "velocity": squashed(level, 1.0),
            "acceleration": squashed(into_level(self.acceleration, own.heading), 1.0),
            "tilt": 5.0 * R[..., 2, :2],
            "rates": own.angular_velocity_b * 2.0,
            "moves": self._squares.sqrt() * self._squares.new_tensor((1.0, 5.0, 5.0)),
            "heading": torch.stack((off.cos(), off.sin()), dim=-1),
            "steered": torch.stack((steered.cos(), steered.sin()), dim=-1),
            "speed": torch.stack((self.ordered[..., SPEED], self.aim[..., SPEED]), dim=-1) / 2.0,
            "previous_action": self.chosen,
        }

    def truth_now(self) -> Tensor | None:
        """Ground truth [env, boat, n]: the significant wave height, and the numbers and conditions that vary."""
        mission = self.mission
        told = [mission.hs.view(-1, 1, 1).expand(*self.steered.shape, 1) / 4.0]
        if mission.config.varies:
            told.append(mission.world.truth[self.name])
        return torch.cat(told, dim=-1)


class Hold:
    """The classical controller of the boats: it holds the ordered course and speed."""

    STATE = ()

    def __call__(self, team: Boats) -> Tensor:
        """Actions [env, boat, a] of the vessels."""
        return team.held()


class Helm(Script):
    """Steers the boats of a mission in which they take no part."""

    def __init__(self, boats: Boats):
        """Steer `boats`."""
        self.name, self._boats = boats.name, boats

    def __call__(self, world: Any) -> Tensor:
        """Hold the ordered course."""
        return self._boats.held()
