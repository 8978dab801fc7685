"""The contract of one team of a mission: its whole life.

A mission names the class of its teams. It derives from `Team` and implements `observe` and `reward`; every other method
has a default here. The mission calls, phase by phase (rl/mission.py), and the team answers:

    truth     errors and gaps of its vehicles, as they are
    endings, reward, log, info     by the truth
    sense     instruments and cameras        conclude     what its vehicles know
    observe   named terms, by what they know

Observation terms are named: `observe` returns an ordered dictionary. Checkpoints and exported policies store names and
widths. A policy refuses observations other than those of its training, and names the difference (learn/policy.py).
"""

from collections.abc import Callable, Mapping
from itertools import chain
from typing import ClassVar, Generic, Protocol, TypeVar, cast

import torch
from torch import Tensor

from rl.perception.due import Due
from rl.scenario import Scenario
from rl.step import COLLIDED, DIVERGED, Endings
from taichi_sim.config import TeamConfig
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle
from taichi_sim.world import World

S = TypeVar("S", bound=TeamConfig)

Controller = Callable[..., Tensor]
"""A classical controller: what a team knows (`Team.known`) -> actions [env, vehicle, action] in [-1, 1]."""


class ControllerError(RuntimeError):
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

    def perceive(self) -> None:
        """Make what teams know current."""
        ...

    def finite(self, values: Tensor, about: Callable[[], str], again: Callable[[], Tensor]) -> Tensor:
        """Values that are finite, or computed `again` after their environments were put to rest."""
        ...


M = TypeVar("M", bound=Host)
FLOATS = torch.float32, torch.float64


class Team(Remembers, Generic[M, S]):
    """One team of a mission; see the module.

    Type parameters: what the team asks of its mission, and the class of its section of the scenario.

    Class attributes: `logged`, the names that `log` returns; `meanings`, term of `observe` -> what it is, with unit and
    scale, for users of the policy (`taichi-sim describe`).

    Attributes:
        mission: the mission. name: of the team. section: the team's section of the scenario. fleet: the vehicles.
        action, previous_action: [env, vehicle, action] of the last two steps, zero at the start of an episode.
        ordered: velocity command [env, vehicle, axes] (NED, m/s) of the last `command`, where a policy corrects one.
    """

    logged: ClassVar[tuple[str, ...]] = ()
    meanings: ClassVar[Mapping[str, str]] = {}
    ordered: Tensor | None = None

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

    def sense(self, due: Due) -> None:
        """Read instruments and look. Writes nothing that another team knows."""

    def exchange(self, due: Due) -> None:
        """Send and receive the messages of this team."""

    def conclude(self, due: Due) -> None:
        """Update what the vehicles know, by what they sensed and heard. Writes nothing of another team's."""

    def endings(self) -> dict[str, Tensor]:
        """Endings beside those of the vehicle itself, by the truth: name -> bool [env, vehicle]."""
        return {}

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
        self.mission.perceive()
        return self.knowledge

    @property
    def knowledge(self) -> object:
        """Where `known` lies, as it was when the vehicles last perceived; a team that measures overrides this."""
        return self

    def ended(self) -> Endings:
        """All endings of the last step: the team's, those of its vehicles, and where they are no vehicles any more."""
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
        return self.mission.finite(reward, lambda: f"the reward of {self.name!r}", lambda: self.reward(ended))

    def infos(self) -> dict[str, Tensor]:
        """`info`, finite."""
        told = self.info()
        for key, value in told.items():
            self._checked(f"info()[{key!r}]", value, "[env, vehicle]", 2)
        return {
            key: self.mission.finite(
                value, lambda key=key: f"{key!r} of {self.name!r}", lambda key=key: self.info()[key]
            )
            for key, value in told.items()
        }

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

    def command(self, action: Tensor) -> Tensor:
        """Vehicle actions [env, vehicle, a] for policy actions [env, vehicle, `action_names`]; finite if these are.

        Callers convert a policy's actions by this method before `Mission.step`.
        """
        self.mission.perceive()
        taken = self.commanded(action)
        if taken is action or not bool(action.isfinite().all()):
            return taken
        return self.mission.finite(taken, lambda: f"the command of {self.name!r}", lambda: self.commanded(action))

    def commanded(self, action: Tensor) -> Tensor:
        """Compute `command`. Default: the same. What is not finite in `action` must stay so."""
        return action

    def classical(self, controller: Controller) -> Tensor:
        """Vehicle actions [env, vehicle, a], finite, of a classical controller that acts on what the team knows."""
        return self.mission.finite(
            controller(self.known), lambda: f"the classical command of {self.name!r}", lambda: controller(self.known)
        )

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
            self.mission.perceive()
            return self.mission.finite(self.observations_now(), self._about_observations, self.observations_now)

    def observations_now(self) -> Tensor:
        """Compute `observations`, a fresh tensor."""
        terms = self.observe()
        for term, value in terms.items():
            self._checked(f"observe()[{term!r}]", value, "float [env, vehicle, n]", 3, *FLOATS)
        return torch.cat(list(terms.values()), dim=-1)

    def _about_observations(self) -> str:
        """What is observed and not finite, for a message."""
        seen = self.observations_now()
        bad = (~seen.isfinite()).flatten(0, -2).any(0).nonzero().flatten().tolist()
        return f"observation {self.observation_names[bad[0]].partition('.')[0]!r} of {self.name!r}"

    @property
    def privileged(self) -> Tensor | None:
        """Privileged information for a critic in training, [env, vehicle, n], a fresh tensor; None: there is none."""
        truth = self.truth_now()
        if truth is None:
            return None
        again = cast(Callable[[], Tensor], self.truth_now)
        return self.mission.finite(truth, lambda: f"privileged information of {self.name!r}", again)

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
