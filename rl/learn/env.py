"""rsl-rl's view of one team: each vehicle of each environment is one row, all sharing one policy."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from rl.learn.policy import Policy
from rl.mission import Step

Watch = Callable[[Any, Step, Mapping[str, Mapping[str, Tensor]]], None]
"""Told of each step before what has ended begins anew: the mission, the step, what each learning team logs of it."""


class Told(NamedTuple):
    """What a team's learner is told of a step."""

    reward: Tensor  # [row], scaled
    dones: Tensor  # [row] int64
    extras: dict[str, Any]  # time_outs, log


class MissionEnv(VecEnv):
    """Row `env * vehicles + vehicle`; actions and observations are [row, n].

    The learning team's vehicles act by the rows; every other team acts by its frozen policy, or learns in the same
    episodes (`companions`, joint.py: they act like the frozen, and are told of each step too). An environment starts
    anew, in the same step, when any vehicle's episode ends: rows whose own vehicle ended are terminated, the rest
    (time is up, or a team mate or the other team ended) are truncated, which rsl-rl takes as `extras["time_outs"]`.

    Rewards are told to the learner `scale` times as large: with 1 - discount, returns are of the size of one reward,
    which a value network learns at once (what is logged is not scaled).
    """

    def __init__(
        self, mission: Any, team: str, frozen: Mapping[str, Policy | None] | None = None, *, scale: float = 1.0
    ):
        """Adapt `mission` (rl/mission.py) for `team`; `frozen` holds a policy for each other team in it, None for one
        in whose environment this team is a companion.

        Raises:
            ValueError: if a team has none.
        """
        self.mission, self.team, self.scale = mission, team, scale
        self.frozen: dict[str, Any] = dict(frozen or {})
        missing = set(mission.teams) - {team} - set(self.frozen)
        if missing:
            raise ValueError(f"no policy for {sorted(missing)}: teams that do not learn act by frozen policies")
        own = mission.teams[team]
        self.vehicles = own.fleet.count
        self.num_envs = mission.num_envs * self.vehicles
        self.num_actions = len(own.action_names)
        self.max_episode_length = mission.config.episode_steps
        self.device = str(mission.device)
        self.cfg = mission.config.model_dump()
        self.look()
        self.last: Step | None = None
        self.watch: Watch | None = None
        self.companions: list[Any] = []
        steps = torch.randint(mission.config.episode_steps, (mission.num_envs,), generator=mission.generator)
        mission.steps.copy_(steps)

    @property
    def episode_length_buf(self) -> Tensor:
        """Decisions since the episode began, [row]."""
        return self.mission.steps.repeat_interleave(self.vehicles)

    @episode_length_buf.setter
    def episode_length_buf(self, value: Tensor) -> None:
        self.mission.steps.copy_(value[:: self.vehicles])

    def get_observations(self) -> TensorDict:
        """Current observations under the key "policy"; what a critic alone is told under "truth", if there is such."""
        groups = {"policy": self._observations.flatten(0, 1)}
        if self._truth is not None:
            groups["truth"] = self._truth.flatten(0, 1)
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def commanded(self, actions: Tensor) -> Tensor:
        """The vehicles' actions by the learner's [row, n]."""
        return self.mission.teams[self.team].command(actions.view(-1, self.vehicles, self.num_actions))

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict]:
        """One decision of every row; see the class for endings."""
        mission = self.mission
        joint = {name: policy(mission.teams[name]) for name, policy in self.frozen.items()}
        joint[self.team] = self.commanded(actions)
        self.last = step = mission.step(joint)
        told = self.told(step)
        others = [(companion, companion.env.told(step)) for companion in self.companions]
        if self.watch is not None:
            logs = {companion.env.team: of_it.extras["log"] for companion, of_it in others}
            self.watch(mission, step, {self.team: told.extras["log"], **logs})
        mission.reset((step.terminated | step.truncated).nonzero().squeeze(1))
        self.look()
        for companion, of_it in others:
            companion.take(of_it)
        reward, dones, extras = told
        return self.get_observations(), reward, dones, extras

    def told(self, step: Step) -> Told:
        """What the learner is told of `step`, before the mission is reset."""
        mission, own = self.mission, self.mission.teams[self.team]
        done_env = step.terminated | step.truncated
        time_outs = done_env.unsqueeze(1) & ~step.endings[self.team].any
        reward = step.reward[self.team]
        log = {f"/{key}": value.float() for key, value in mission.log(own, step).items()}
        extras = {"time_outs": time_outs.flatten().float(), "log": {"/reward": reward.mean(), **log}}
        return Told(self.scale * reward.flatten(), done_env.repeat_interleave(self.vehicles).long(), extras)

    def look(self) -> None:
        """Observe the team as it is now."""
        own = self.mission.teams[self.team]
        self._observations, self._truth = own.observe(), own.privileged
