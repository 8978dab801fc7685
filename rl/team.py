"""What stages, Gymnasium, evaluation and controllers may ask of one team of a mission (mission.py)."""

from collections.abc import Mapping
from itertools import chain
from typing import Any

import torch
from torch import Tensor

from taichi_sim.fleet import Fleet
from taichi_sim.kernels import runtime


class Team:
    """One team of a mission, as its policy sees it; a mission may use a class of its own that derives from this.

    Attributes:
        mission, name, section: whose it is, what it is called, its section of the scenario. fleet: the vehicles.
        action, previous_action: [env, vehicle, action] of the last two steps, zero at the start of an episode.
        known: what classical controllers are handed, with the attributes of a team: what its vehicles know. Default:
            the team itself.
    """

    STATE: tuple[str, ...] = ("action", "previous_action", "_in_use")
    SHARED: tuple[str, ...] = ()

    def __init__(self, mission: Any, name: str):
        """See team `name` of a mission whose world exists."""
        self.mission, self.name = mission, name
        self.section: Any = mission.config.teams[name]
        self.fleet: Fleet = mission.world.teams[name]
        self.action = self.fleet.state.new_zeros(
            (mission.num_envs, self.fleet.count, len(self.fleet.model.action_names))
        )
        self.previous_action = self.action
        self.known: Any = self
        self._controller: Any = None

    @property
    def steps(self) -> Tensor:
        """int64 [env], decisions since the episode began."""
        return self.mission.steps

    @property
    def controller(self) -> Any:
        """The mission's classical controller of this team, made at the first use; None if there is none."""
        if self._controller is None:
            self._controller = self.mission.controller(self)
        return self._controller

    @property
    def _in_use(self) -> Any:
        """The controller, whose memory is state, once it has been used."""
        return self._controller

    @property
    def action_names(self) -> tuple[str, ...]:
        """What its policy commands, each in [-1, 1]."""
        return self.fleet.model.action_names

    def command(self, action: Tensor) -> Tensor:
        """Actions of the vehicles [env, vehicle, a] for those of the policy [env, vehicle, `action_names`].

        Default: the same. Whoever acts by a policy asks this before `Mission.step`.
        """
        return action

    @property
    def in_effect(self) -> Tensor:
        """Where actions of the policy have an effect now, bool [env, vehicle]. Default: everywhere."""
        return torch.ones_like(self.fleet.state[..., 0], dtype=torch.bool)

    def observe(self) -> Tensor:
        """Observations [env, vehicle, n] for the next decision: a fresh tensor each time."""
        with runtime.torch_at_rest():
            return torch.cat(list(self.mission.observe(self).values()), dim=-1)

    @property
    def privileged(self) -> Tensor | None:
        """What a critic is told besides, in training alone [env, vehicle, n], a fresh tensor; None is nothing."""
        return None

    @property
    def layout(self) -> Mapping[str, int]:
        """Terms of its observations and their widths, in order. Default: those that `Mission.observe` gives now."""
        return {term: value.shape[-1] for term, value in self.mission.observe(self).items()}

    def terms(self) -> dict[str, Tensor]:
        """Its observations by term, views of one `observe`."""
        layout = self.layout
        return dict(zip(layout, self.observe().split(list(layout.values()), dim=-1), strict=True))

    @property
    def observation_names(self) -> tuple[str, ...]:
        """A name for each of the n observations: the term's, with a number if it has several values ("error.1")."""
        named = ([term] if width == 1 else [f"{term}.{k}" for k in range(width)] for term, width in self.layout.items())
        return tuple(chain.from_iterable(named))
