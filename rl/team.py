"""The contract of one team of a mission: all that stages, Gymnasium, evaluation and controllers may use."""

from collections.abc import Callable, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Generic, TypeVar, cast

import torch
from torch import Tensor

from taichi_sim.config import TeamConfig
from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime

if TYPE_CHECKING:
    from rl.mission import Mission

M = TypeVar("M", bound="Mission")
S = TypeVar("S", bound=TeamConfig)

Controller = Callable[..., Tensor]
"""A classical controller: what a team knows (`Team.known`) -> actions [env, vehicle, action] in [-1, 1]."""


class ControllerError(RuntimeError):
    """There is no classical controller for a team's vehicles."""


class Team(Generic[M, S]):
    """One team of a mission, as its policy sees it; a mission may derive a class of its own.

    Type parameters: the class of the mission, and that of the team's section (`Team["Ferry", FerrySection]`).

    Attributes:
        mission: the mission. name: of the team. section: the team's section of the scenario. fleet: the vehicles.
        action, previous_action: [env, vehicle, action] of the last two steps, zero at the start of an episode.
        known: what the vehicles know, the input of classical controllers. It has the attributes of a team; by default
        it is the team itself, the ground truth.
    """

    STATE: tuple[str, ...] = ("action", "previous_action", "_in_use")
    SHARED: tuple[str, ...] = ()

    def __init__(self, mission: M, name: str):
        """Make team `name` of a mission whose world exists."""
        self.mission, self.name = mission, name
        self.section = cast(S, mission.config.teams[name])
        self.fleet: Fleet = mission.world.teams[name]
        self.action = self.fleet.state.new_zeros(
            (mission.num_envs, self.fleet.count, len(self.fleet.model.action_names))
        )
        self.previous_action = self.action
        self.known: object = self
        self._controller: Controller | None = None

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self.mission.steps

    @property
    def controller(self) -> Controller | None:
        """The mission's classical controller of this team, made at its first use; None if there is none."""
        if self._controller is None:
            self._controller = self.mission.controller(self)
        return self._controller

    @property
    def _in_use(self) -> Controller | None:
        """The controller, if it has been made; its memory is part of the state."""
        return self._controller

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the policy's actions, each in [-1, 1]."""
        return self.fleet.model.action_names

    def command(self, action: Tensor) -> Tensor:
        """Vehicle actions [env, vehicle, a] for policy actions [env, vehicle, `action_names`]; finite if these are.

        Callers convert a policy's actions by this method before `Mission.step`.
        """
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

    def observe(self) -> Tensor:
        """Observations [env, vehicle, n] for the next decision, finite: a fresh tensor each time."""
        with runtime.torch_at_rest():
            return self.mission.finite(self.observations_now(), self._about_observations, self.observations_now)

    def observations_now(self) -> Tensor:
        """Compute `observe`, a fresh tensor. Default: the terms of `Mission.observe`, side by side."""
        return torch.cat(list(self.mission.observe(self).values()), dim=-1)

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
        """Terms of the observations and their widths, in order. Default: those that `Mission.observe` gives now."""
        return {term: value.shape[-1] for term, value in self.mission.observe(self).items()}

    def terms(self) -> dict[str, Tensor]:
        """The team's observations by term, as views of one `observe`."""
        layout = self.layout
        return dict(zip(layout, self.observe().split(list(layout.values()), dim=-1), strict=True))

    @property
    def observation_names(self) -> tuple[str, ...]:
        """A name for each of the n observations: the term's, with a number if it has several values ("error.1")."""
        named = ([term] if width == 1 else [f"{term}.{k}" for k in range(width)] for term, width in self.layout.items())
        return tuple(chain.from_iterable(named))
