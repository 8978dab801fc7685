"""One team of a mission as an environment of rsl-rl: each vehicle of each environment is a row, and all share one
policy. Further teams may learn in the same environments (joint_learner.py).
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol, TypedDict

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from rl.mission import Mission, Policy, Step

Watch = Callable[[Mission, Step, Mapping[str, Mapping[str, Tensor]]], None]
"""Called after each step: the mission, the step, and the logs of each learning team."""


class Extras(TypedDict):
    """What rsl-rl reads besides rewards and dones."""

    time_outs: Tensor  # [row]: 1 where the episode was truncated, not terminated
    log: dict[str, Tensor]  # "/" and a name -> its value


class LearnerStep(NamedTuple):
    """The result of one step for the learner of one team."""

    reward: Tensor  # [row], scaled
    dones: Tensor  # [row] int64
    extras: Extras


class Learner(Protocol):
    """A team that learns while another team's runner drives rsl-rl's loop (joint_learner.py)."""

    @property
    def env(self) -> "MissionEnv":
        """Its rows of the same mission."""
        ...

    def begin(self) -> None:
        """Continue from its last iteration."""
        ...

    def take(self, step: LearnerStep, observations: Tensor) -> None:
        """Store the result of its last actions, and the next observations [env, vehicle, n]."""
        ...

    def update(self) -> None:
        """Learn from the steps since the last update."""
        ...

    def save(self, iterations: int) -> None:
        """Write a checkpoint."""
        ...

    def end(self) -> None:
        """Close its log."""
        ...


class MissionEnv(VecEnv):
    """Environment of rsl-rl whose row is `env * vehicles + vehicle`; actions and observations are [row, n].

    The rows act for the learning team. Every other team acts by its frozen policy, or learns beside it
    (`joint`). When any vehicle's episode ends, its environment resets in the same step. Rows whose own vehicle ended
    are terminated; the other rows are truncated, which rsl-rl reads from `extras["time_outs"]`.

    The learner gets rewards times `scale`. With scale = 1 - discount, returns have the size of one reward, which a
    value network learns faster. Logs are not scaled.
    """

    def __init__(
        self, mission: Mission, team: str, frozen: Mapping[str, Policy | None] | None = None, *, scale: float = 1.0
    ):
        """Adapt `mission` for the learning `team`, with rewards times `scale`.

        `frozen` holds a policy of each other team; None for the team in whose environment `team` learns beside it.
        """
        self.mission, self.team, self.scale = mission, team, scale
        self.frozen = dict(frozen or {})
        missing = set(mission.teams) - {team} - set(self.frozen)
        if missing:
            raise ValueError(f"no policy for {sorted(missing)}: teams that do not learn need a frozen policy")
        own = mission.teams[team]
        self.vehicles = own.fleet.count
        self.num_envs = mission.num_envs * self.vehicles
        self.num_actions = len(own.action_names)
        self.max_episode_length = mission.config.episode_steps
        self.device = str(mission.device)
        self.cfg = mission.config.model_dump()
        self.observed(own.observations())
        self.last: Step | None = None
        self.watch: Watch | None = None
        self.joint: list[Learner] = []
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
        """Current observations under "policy"; privileged information for the critic, if any, under "truth"."""
        groups = {"policy": self._observations.flatten(0, 1)}
        if self._truth is not None:
            groups["truth"] = self._truth.flatten(0, 1)
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def by_env(self, actions: Tensor) -> Tensor:
        """The learner's actions [row, n] as [env, vehicle, n]."""
        return actions.view(self.mission.num_envs, self.vehicles, self.num_actions)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, Extras]:
        """Take one decision in every row; environments whose episodes end begin anew (see the class)."""
        others = {name: policy for name, policy in self.frozen.items() if policy is not None}
        learners, results = [self, *(learner.env for learner in self.joint)], []
        self.last = step = self.mission.step(
            {**others, self.team: self.by_env(actions)},
            observe=[learner.team for learner in learners],
            judged=lambda step: results.extend(learner.learner_step(step) for learner in learners),
        )
        if self.watch is not None:
            logs = {learner.team: result.extras["log"] for learner, result in zip(learners, results, strict=True)}
            self.watch(self.mission, step, logs)
        self.observed(step.observations[self.team])
        for learner, result in zip(self.joint, results[1:], strict=True):
            learner.take(result, step.observations[learner.env.team])
        return self.get_observations(), *results[0]

    def learner_step(self, step: Step) -> LearnerStep:
        """The learner's view of `step`, before episodes begin anew."""
        own = self.mission.teams[self.team]
        time_outs = step.over.unsqueeze(1) & ~step.endings[self.team].any
        reward = step.reward[self.team]
        log = {f"/{key}": value.float() for key, value in own.logs(step.endings[self.team]).items()}
        extras: Extras = {"time_outs": time_outs.flatten().float(), "log": {"/reward": reward.mean(), **log}}
        return LearnerStep(self.scale * reward.flatten(), step.over.repeat_interleave(self.vehicles).long(), extras)

    def observed(self, observations: Tensor) -> None:
        """Take the team's observations [env, vehicle, n], and its privileged information now."""
        self._observations, self._truth = observations, self.mission.teams[self.team].privileged
