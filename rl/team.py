"""The contract of one team of a mission: its whole life.

A mission names the class of its teams. It derives from `Team` and implements `observe` and `reward`; every other method
has a default here. The mission calls, phase by phase (rl/mission.py), and the team answers:

    commanded   vehicle actions, of a policy's
    truth       errors and gaps of its vehicles, as they are
    endings, reward, log, info     by the truth
    perceive    instruments and cameras        exchange     messages        conclude     what its vehicles know
    observe     named terms, by what they know

Observation terms are named: `observe` returns an ordered dictionary. Checkpoints and exported policies store names and
widths. A policy refuses observations other than those of its training, and names the difference (learn/policy.py).
"""

import math
from collections.abc import Callable, Mapping
from itertools import chain
from typing import ClassVar, Generic, Protocol, TypeVar, cast

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from rl.scenario import Scenario
from rl.step import COLLIDED, DIVERGED, Due, Endings, VehicleActions
from taichi_sim.config import TeamConfig
from taichi_sim.config.arguments import checked_action
from taichi_sim.errors import UserError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.state.divergence import Divergence
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle
from taichi_sim.world import World

S = TypeVar("S", bound=TeamConfig)

Controller = Callable[..., Tensor]
"""A classical controller: what a team knows (`Team.known`) -> actions [env, vehicle, action] in [-1, 1]."""


Action = VehicleActions | Tensor | ArrayLike
"""Actions of a team's policy [env, vehicle, `action_names`] in [-1, 1], or of its vehicles."""

Policy = Callable[["Team"], Action]
"""Decides for a team, by what its vehicles know and observe."""


class ControllerError(UserError, RuntimeError):
    """There is no classical controller for a team's vehicles."""


class Host(Protocol):
    """What a team may ask of its mission (rl/mission.py)."""

    @property
    def config(self) -> Scenario:
        """The scenario."""
        ...

    world: World
    num_envs: int
    steps: Tensor
    """int64 [env], decisions since the episode began."""
    divergence: Divergence
    """Environments that end because something in them is not finite."""


M = TypeVar("M", bound=Host)
MOVED = {
    "sense": "it is called `perceive`",
    "knowledge": "it is called `known`",
    "command": "write `commanded`; `Mission.step` takes the actions of policies",
}
"""Names that a team must not have, and what to write instead."""
FLOATS = torch.float32, torch.float64
OBSERVATION = "observation"


def refuse_moved(kind: type, moved: Mapping[str, str]) -> None:
    """Refuse a class with an attribute of another name or place now, as `moved` says."""
    for name, now in moved.items():
        if name in kind.__dict__:
            raise TypeError(f"{kind.__name__}.{name}: {now} (rl/mission.py, rl/team.py)")


class Team(Remembers, Generic[M, S]):
    """One team of a mission; see the module.

    Type parameters: what the team asks of its mission, and the class of its section of the scenario.

    Class attributes: `logged`, the names that `log` returns; `meanings`, term of `observe` -> what it is, with unit and
    scale, for users of the policy (`taichi-sim describe`).

    Attributes:
        mission: the mission. name: of the team. section: the team's section of the scenario. fleet: the vehicles.
        action, previous_action: [env, vehicle, action] of the last two steps, zero at the start of an episode.
        ordered: velocity command [env, vehicle, axes] (NED, m/s) of the last step, where a policy corrects one.
    """

    logged: ClassVar[tuple[str, ...]] = ()
    meanings: ClassVar[Mapping[str, str]] = {}
    ordered: Tensor | None = None

    def __init_subclass__(cls) -> None:
        """Refuse what has another name."""
        super().__init_subclass__()
        refuse_moved(cls, MOVED)

    def __init__(self, mission: M, name: str):
        """Make team `name` of a mission whose world exists."""
        self.mission, self.name = mission, name
        self.section = cast(S, mission.config.teams[name])
        self.fleet: Fleet[Vehicle] = mission.world.teams[name]
        self.action = self.remember(
            self.fleet.state.new_zeros((mission.num_envs, self.fleet.count, len(self.fleet.model.action_names)))
        )
        self.previous_action = self.remember(self.action)
        self._controller: Controller | None = self.remember(None)

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self.mission.steps

    # -- phases of a step ------------------------------------------------------------------------------------------

    def truth(self, due: Due) -> None:
        """Measure what is: errors, gaps, contacts."""

    def commanded(self, action: Tensor) -> Tensor:
        """Vehicle actions [env, vehicle, a] of a policy's actions [env, vehicle, `action_names`].

        Default: the same.
        """
        return action

    def perceive(self, due: Due) -> None:
        """Read instruments and look. Writes nothing that another team knows."""

    def exchange(self, due: Due) -> None:
        """Send and receive the messages of this team."""

    def conclude(self, due: Due) -> None:
        """Update what the vehicles know, by what they sensed and heard. Writes nothing of another team's."""

    def margins(self) -> dict[str, Tensor]:
        """What is left before an ending, by the truth, [env, vehicle]; below 0 it has happened. Default: none."""
        return {}

    def endings(self) -> dict[str, Tensor]:
        """Endings beside those of the vehicle itself, by the truth: name -> bool [env, vehicle]. Default: `margins`."""
        return {name: left < 0.0 for name, left in self.margins().items()}

    def importance(self, ending: str) -> Tensor:
        """How near each vehicle is to an ending, [env, vehicle]: greater is nearer (rl/evaluation/odds).

        A bad one costs time, never truth. Default: minus the margin; without a margin the same everywhere.
        """
        left = self.margins().get(ending)
        return torch.zeros_like(self.fleet.state[..., 0]) if left is None else -left

    def reward(self, ended: Endings) -> Tensor:
        """Reward of each vehicle for the last step, by the truth, [env, vehicle]."""
        raise NotImplementedError(f"{type(self).__name__}.reward")

    def plan_cost(self, ended: Tensor) -> Tensor:
        """Cost [env, vehicle] of the last step for each vehicle, by which plans are compared (rl/planning).

        `ended` bool [env, vehicle]: vehicles that ended in this step. Default: minus the reward while a vehicle goes
        on; afterwards only the penalty that the reward contains.
        """
        return -self.reward(Endings({COLLIDED: ended, DIVERGED: torch.zeros_like(ended)}))

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """Numbers of a step for the training's history, `logged`: name -> a scalar."""
        return {}

    def info(self) -> dict[str, Tensor]:
        """Entries of Gymnasium's info now, besides the endings: name -> [env, vehicle]."""
        return {}

    def observe(self) -> dict[str, Tensor]:
        """Observations of each vehicle for its next decision: term -> [env, vehicle, n], of order one."""
        raise NotImplementedError(f"{type(self).__name__}.observe")

    # -- what others ask -------------------------------------------------------------------------------------------

    @property
    def known(self) -> object:
        """What the vehicles know, the input of classical controllers: an object with the attributes of a team.

        Default: the team itself, which is the ground truth.
        """
        return self

    def ended(self) -> Endings:
        """All endings of the last step: the team's, the vehicle model's, and divergence."""
        vehicle, own = self.fleet.model.endings(self.fleet, self.mission.world), self.endings()
        for name, flags in own.items():
            self._checked(f"endings()[{name!r}]", flags, "bool [env, vehicle]", 2, torch.bool)
        return Endings({**own, **vehicle, DIVERGED: self.fleet.never})

    @property
    def observed_air(self) -> tuple[int, ...]:
        """Columns of the fleet's `aux` that hold airspeed and velocity of the air, where it observes them."""
        return ()

    def gives_up(self) -> Mapping[str, Tensor]:
        """Endings, bool [env, vehicle], at which a companion (rl/adapters/pilot) ends. Default: all."""
        return self.ended()

    @property
    def rests(self) -> Tensor:
        """Vehicles at rest where they were to go, bool [env, vehicle]: a companion is done. Default: none ever."""
        return self.fleet.never

    @property
    def stopped_down(self) -> Tensor:
        """Vertical velocity [env, vehicle] (down, m/s) at which a companion stops each aircraft. Default: none."""
        return torch.zeros_like(self.fleet.state[..., 0])

    def _checked(self, what: str, value: object, expected: str, axes: int, *kinds: torch.dtype) -> None:
        """Refuse what a team's class returns and is no tensor of all its vehicles, with `axes`, of one of `kinds`.

        Raises:
            TypeError: naming the class, `what`, and what is `expected`.
        """
        rows = (self.mission.num_envs, self.fleet.count)
        if isinstance(value, Tensor) and value.dim() == axes and value.shape[:2] == rows and (
            not kinds or value.dtype in kinds
        ):  # fmt: skip
            return
        given = f"{value.dtype} {list(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(
            f"{type(self).__name__}.{what} is {given}: expected is a tensor {expected} of {rows[0]} environments and "
            f"{rows[1]} vehicles"
        )

    def paid(self, ended: Endings) -> Tensor:
        """`reward`, finite."""
        reward = self.reward(ended)
        self._checked("reward()", reward, "float [env, vehicle]", 2, *FLOATS)
        return self.finite(reward, "the reward")

    def infos(self) -> dict[str, Tensor]:
        """`info`, finite."""
        told = self.info()
        for key, value in told.items():
            self._checked(f"info()[{key!r}]", value, "[env, vehicle]", 2)
        return {key: self.finite(value, repr(key)) for key, value in told.items()}

    def finite(self, values: Tensor, what: str) -> Tensor:
        """`values` [env, vehicle, ...] where they are finite, else 0; there the episode ends as diverged.

        Raises:
            NotFiniteError: where an episode has just begun and no state explains it.
        """
        if math.isfinite(values.sum()) or bool((right := values.isfinite()).all()):
            return values
        if what == OBSERVATION:
            column = int((~right).flatten(0, -2).any(0).nonzero()[0])
            what = f"{what} {self.observation_names[column].partition('.')[0]!r}"
        self.mission.divergence.rest(~right.flatten(1).all(1), f"{what} of {self.name!r} is not finite")
        return torch.where(right, values, 0.0)

    @property
    def controller(self) -> Controller | None:
        """The classical controller of the team, made at its first use; None if there is none."""
        if self._controller is None:
            self._controller = self.make_controller()
        return self._controller

    def make_controller(self) -> Controller | None:
        """Make a classical controller, built from the vehicle model; None if there is none.

        Default: the controller that the vehicle itself offers (`Vehicle.controller`).
        """
        kind = self.fleet.model.controller
        return None if kind is None else kind(self.fleet.model)

    @property
    def uses_controller(self) -> bool:
        """Whether the controller's memory is part of the state. Default: since it has been made."""
        return self._controller is not None

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the policy's actions, each in [-1, 1]."""
        return self.fleet.model.action_names

    def checked(self, given: Action) -> Tensor | VehicleActions:
        """Actions as `taken` wants them: tensors in run precision, clipped to [-1, 1].

        Raises:
            ValueError: for a wrong shape, or an action that is not finite.
        """
        if isinstance(given, VehicleActions):
            return VehicleActions(self.mission.world.checked_action(self.name, given.values))
        rows = (self.mission.num_envs, self.fleet.count)
        return checked_action(given, self.name, self.action_names, rows, self.fleet.state.dtype)

    def taken(self, action: Tensor | VehicleActions) -> Tensor:
        """Vehicle actions [env, vehicle, a] of the team for those of a policy, or for its own, as `checked`."""
        if isinstance(action, VehicleActions):
            return torch.as_tensor(action.values)
        taken = self.commanded(action)
        if taken is action:
            return taken
        return self.mission.world.checked_action(self.name, self.finite(taken, "the command"))

    def classical(self, controller: Controller) -> VehicleActions:
        """Actions, finite, of a classical controller that acts on what the team knows."""
        return VehicleActions(self.finite(controller(self.known), "the classical command"))

    @property
    def plan_names(self) -> tuple[str, ...]:
        """Names of the numbers by which plans of this team (rl/planning) correct its classical controller. Default: its
        vehicles' actions.
        """
        return self.fleet.model.action_names

    def planned(self, correction: Tensor, known: object = None) -> Tensor:
        """Vehicle actions [env, vehicle, a] of the classical controller, corrected [env, vehicle, `plan_names`].

        The controller acts by `known`, default: this team as it is.

        Raises:
            ControllerError: if the team has no classical controller.
        """
        if self.controller is None:
            raise ControllerError(f"{self.name}: there is no classical controller whose actions a plan could correct")
        return (self.controller(self if known is None else known) + correction).clamp(-1.0, 1.0)

    @property
    def plannable(self) -> Tensor:
        """Where a plan could change what its vehicles do, bool [env, vehicle]. Default: everywhere."""
        return ~self.fleet.never

    @property
    def in_effect(self) -> Tensor:
        """Where actions of the policy have an effect now, bool [env, vehicle]. Default: everywhere."""
        return ~self.fleet.never

    def observations(self) -> Tensor:
        """All terms of `observe` side by side [env, vehicle, n], finite: a fresh tensor each time."""
        with runtime.torch_at_rest():
            return self.finite(self.observations_now(), OBSERVATION)

    def observations_now(self) -> Tensor:
        """Compute `observations`, a fresh tensor."""
        terms = self.observe()
        for term, value in terms.items():
            self._checked(f"observe()[{term!r}]", value, "float [env, vehicle, n]", 3, *FLOATS)
        return torch.cat(list(terms.values()), dim=-1)

    @property
    def privileged(self) -> Tensor | None:
        """Privileged information for a critic in training, [env, vehicle, n], a fresh tensor; None: there is none."""
        truth = self.truth_now()
        return None if truth is None else self.finite(truth, "privileged information")

    def truth_now(self) -> Tensor | None:
        """Compute `privileged`. Default: None."""
        return None

    @property
    def layout(self) -> Mapping[str, int]:
        """Terms of the observations and their widths, in order."""
        return {term: value.shape[-1] for term, value in self.observe().items()}

    @property
    def observation_names(self) -> tuple[str, ...]:
        """A name for each of the n observations: the term's, with a number if it has several values ("error.1")."""
        named = ([term] if width == 1 else [f"{term}.{k}" for k in range(width)] for term, width in self.layout.items())
        return tuple(chain.from_iterable(named))
