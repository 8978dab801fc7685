"""The contract of one team of a mission: its whole life.

A mission names the class of its teams. It derives from `Team`, implements `observe`, and gives `terms` or implements
`reward`; every other method has a default here. The mission calls, by phases (rl/mission.py), and the team answers:

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
from pathlib import Path
from typing import ClassVar, Generic, Protocol, TypeVar, cast

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from rl.scenario import Scenario, TeamSection
from rl.step import COLLIDED, DIVERGED, Due, Endings, VehicleActions
from rl.terms import Door, Paid, Term, added_observations, check_names, meaning, paid_terms
from taichi_sim.config.arguments import checked_action
from taichi_sim.errors import UserError
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime
from taichi_sim.state.divergence import Divergence
from taichi_sim.state.memory import Remembers
from taichi_sim.vehicle import Vehicle
from taichi_sim.world import World

S = TypeVar("S", bound=TeamSection)

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
    source: Path | None
    """The scenario's file."""
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
OBSERVATION, REWARD, TERM = "observation", "the reward", "term."


def refuse_moved(kind: type, moved: Mapping[str, str]) -> None:
    """Refuse a class with an attribute of another name or place now, as `moved` says."""
    for name, now in moved.items():
        if name in kind.__dict__:
            raise TypeError(f"{kind.__name__}.{name}: {now} (rl/mission.py, rl/team.py)")


class Team(Remembers, Generic[M, S]):
    """One team of a mission; see the module.

    Type parameters: what the team asks of its mission, and the class of its section of the scenario.

    Class attributes: `terms`, name -> reward term (rl/terms.py); `logged`, the names that `log` returns; `meanings`,
    term of `observe` -> what it is, with unit and scale, for users of the policy (`taichi-sim describe`).

    Attributes:
        mission: the mission. name: of the team. section: the team's section of the scenario. fleet: the vehicles.
        action, previous_action: [env, vehicle, action] of the last two steps, zero at the start of an episode.
        policy_memory: [env, vehicle, n] that its policy has kept; None: it keeps nothing (`recall`).
        ordered: velocity command [env, vehicle, axes] (NED, m/s) of the last step, where a policy corrects one.
        paid_by: name -> reward term, as the scenario has it. parts: those of the last reward, weighted.
    """

    terms: ClassVar[Mapping[str, Term]] = {}
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
        self.policy_memory: Tensor | None = self.remember(None)
        self._controller: Controller | None = self.remember(None)
        source = mission.source
        self._door = Door(str(source or mission.config.name), [source.parent] if source else [], name)
        self.paid_by: dict[str, Paid] = paid_terms(self.declared(mission.config), self.section, self._door)
        self.added = added_observations(self.section, self._door)
        self.parts: dict[str, Tensor] = self.scratch({})

    @classmethod
    def declared(cls, config: Scenario) -> Mapping[str, Term]:
        """The reward terms of the class in a scenario. Default: `terms`."""
        return cls.terms

    @classmethod
    def check_section(cls, config: Scenario, door: Door, acts: bool = True) -> None:
        """Refuse changes of terms and observations in a section of a scenario that was read; any, if no policy `acts`.
        """
        section = cast(S, config.teams[door.team])
        if not acts and (section.terms or section.observe):
            raise door.refuse("terms" if section.terms else "observe", ": no policy acts for this team")
        paid_terms(cls.declared(config), section, door)
        added_observations(section, door)

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self.mission.steps

    def recall(self, width: int) -> Tensor:
        """What its policy has kept since the last decision [env, vehicle, width]; zero where an episode begins."""
        if self.policy_memory is None:
            return self.fleet.state.new_zeros((*self.fleet.never.shape, width), dtype=torch.float32)
        return torch.where(self.steps.view(-1, 1, 1) > 0, self.policy_memory, 0.0)

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
        """Reward of each vehicle for the last step, by the truth, [env, vehicle]. Default: the weighted sum of its
        terms; one of weight 0 is not computed.
        """
        if not self.paid_by:
            raise NotImplementedError(f"{type(self).__name__}.reward, or terms")
        weighted = {name: paid.term.weight for name, paid in self.paid_by.items() if paid.term.weight}
        self.parts = {name: weight * self.paid_by[name].of(self, ended) for name, weight in weighted.items()}
        return sum(self.parts.values(), self.fleet.state.new_zeros(self.fleet.never.shape))

    def plan_cost(self, ended: Tensor) -> Tensor:
        """Cost [env, vehicle] of the last step for each vehicle, by which plans are compared (rl/planning).

        `ended` bool [env, vehicle]: vehicles that ended in this step. Default: minus the reward while a vehicle goes
        on; afterwards only the penalty that the reward contains.
        """
        return -self.reward(Endings({COLLIDED: ended, DIVERGED: torch.zeros_like(ended)}))

    def log(self, ended: Endings) -> dict[str, Tensor]:
        """Numbers of a step for the training's history, `logged`: name -> a scalar."""
        return {}

    @property
    def all_logged(self) -> tuple[str, ...]:
        """The names of `logs`."""
        return (*self.logged, *(f"{TERM}{name}" for name in self.paid_by))

    def logs(self, ended: Endings) -> dict[str, Tensor]:
        """`log`, and the mean part of each term in the last reward, weighted, under "term.NAME"."""
        return self.log(ended) | {f"{TERM}{name}": part.mean() for name, part in self.parts.items()}

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
        """Refuse what a team's class returns and is no tensor of all its vehicles, with `axes`, of one of `kinds`."""
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

    def check(self) -> None:
        """Refuse terms and observations of the scenario's that do not fit, as episodes have just begun."""
        own = self.observe() if self.section.observe else {}
        check_names(tuple(own), self.section, self._door)
        for name, function in self.added.items():
            self._fits(f"observe.{name}", function(self), "float [env, vehicle, n]", 3)
        if not self.paid_by:
            return
        ended = self.ended()
        for name, paid in self.paid_by.items():
            if paid.term.weight:
                self._fits(f"terms.{name}", paid.of(self, ended), "float [env, vehicle]", 2)
        self.reward(ended)
        if not self.parts and self.section.terms:
            raise self._door.refuse("terms", f": {type(self).__name__}.reward does not use them")
        if not self.parts:
            self.paid_by = {}

    def _fits(self, key: str, value: object, expected: str, axes: int) -> None:
        """Refuse a value of another shape, or one that is not finite, of a term or an observation."""
        try:
            self._checked("term", value, expected, axes, *FLOATS)
        except TypeError as error:
            raise self._door.refuse(key, f": {error}") from None
        if not bool(cast(Tensor, value).isfinite().all()):
            raise self._door.refuse(key, ": it is not finite as an episode begins")

    def paid(self, ended: Endings) -> Tensor:
        """`reward`, finite."""
        reward = self.reward(ended)
        self._checked("reward()", reward, "float [env, vehicle]", 2, *FLOATS)
        return self.finite(reward, REWARD)

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
        if what == REWARD and (wrong := [name for name, part in self.parts.items() if not part.isfinite().all()]):
            what = f"{what}'s term {wrong[0]!r}"
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
        """Actions as `taken` wants them: tensors in run precision, clipped to [-1, 1]."""
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
        terms = self.observed()
        for term, value in terms.items():
            self._checked(f"observe()[{term!r}]", value, "float [env, vehicle, n]", 3, *FLOATS)
        return torch.cat(list(terms.values()), dim=-1)

    def observed(self) -> dict[str, Tensor]:
        """The terms of `observe` with the scenario's changes: those left out, then those added."""
        terms, changes = self.observe(), self.section.observe
        if changes is None:
            return terms
        kept = {term: value for term, value in terms.items() if term not in changes.without}
        return kept | {term: function(self) for term, function in self.added.items()}

    def meaning_of(self, term: str) -> str:
        """What an observation is, with unit and scale."""
        return meaning(self.added[term]) if term in self.added else self.meanings.get(term, "of order one")

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
        return {term: value.shape[-1] for term, value in self.observed().items()}

    @property
    def observation_names(self) -> tuple[str, ...]:
        """A name for each of the n observations: the term's, with a number if it has several values ("error.1")."""
        named = ([term] if width == 1 else [f"{term}.{k}" for k in range(width)] for term, width in self.layout.items())
        return tuple(chain.from_iterable(named))
