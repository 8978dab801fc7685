"""One team of a mission as an environment of rsl-rl: each vehicle of each environment is a row, and all share one
policy. Further teams may learn in the same environments, as `Companion`s.
"""

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple, TypedDict

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from rl.learn.policy import Policy
from rl.mission import Mission, Step
from rl.team import Team
from taichi_sim.arguments import checked_action

if TYPE_CHECKING:
    from rl.learn.runner import StageRunner

Watch = Callable[[Mission, Step, Mapping[str, Mapping[str, Tensor]]], None]
"""Called after each step and before the resets: the mission, the step, and the logs of each learning team."""


class Extras(TypedDict):
    """What rsl-rl reads besides rewards and dones."""

    time_outs: Tensor  # [row]: 1 where the episode was truncated, not terminated
    log: dict[str, Tensor]  # "/" and a name -> its value


class LearnerStep(NamedTuple):
    """The result of one step for the learner of one team."""

    reward: Tensor  # [row], scaled
    dones: Tensor  # [row] int64
    extras: Extras


class MissionEnv(VecEnv):
    """Environment of rsl-rl whose row is `env * vehicles + vehicle`; actions and observations are [row, n].

    The rows act for the learning team. Every other team acts by its frozen policy, or learns in the same episodes as
    one of the `companions`. When any vehicle's episode ends, its environment resets in the same step. Rows
    whose own vehicle ended are terminated; the other rows are truncated, which rsl-rl reads from `extras["time_outs"]`.

    The learner gets rewards times `scale`. With scale = 1 - discount, returns have the size of one reward, which a
    value network learns faster. Logs are not scaled.
    """

    def __init__(
        self, mission: Mission, team: str, frozen: Mapping[str, Policy | None] | None = None, *, scale: float = 1.0
    ):
        """Adapt `mission` for the learning `team`, with rewards times `scale`.

        `frozen` holds a policy of each other team; None for the team in whose environment `team` is a companion.

        Raises:
            ValueError: if a team has no policy.
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
        self.observe()
        self.last: Step | None = None
        self.watch: Watch | None = None
        self.companions: list[Companion] = []
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

    def commanded(self, actions: Tensor) -> Tensor:
        """The vehicles' actions [env, vehicle, action] for the learner's actions [row, n]."""
        own, shape = self.mission.teams[self.team], (self.mission.num_envs, self.vehicles)
        given = actions.view(*shape, self.num_actions)
        return own.command(checked_action(given, self.team, own.action_names, shape, own.action.dtype))

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, Extras]:
        """Take one decision in every row and reset the environments whose episodes end (see the class)."""
        mission, own = self.mission, self.commanded(actions)  # before other teams, whose policies may remember
        joint = {name: policy(mission.teams[name]) for name, policy in self.frozen.items() if policy is not None}
        joint[self.team] = own
        self.last = step = mission.step(joint)
        reward, dones, extras = self.learner_step(step)
        others = [(companion, companion.env.learner_step(step)) for companion in self.companions]
        if self.watch is not None:
            logs = {companion.env.team: its_step.extras["log"] for companion, its_step in others}
            self.watch(mission, step, {self.team: extras["log"], **logs})
        mission.reset(step.terminated | step.truncated)
        self.observe()
        for companion, its_step in others:
            companion.take(its_step)
        return self.get_observations(), reward, dones, extras

    def learner_step(self, step: Step) -> LearnerStep:
        """The learner's view of `step`, before the mission resets."""
        mission, own = self.mission, self.mission.teams[self.team]
        done_env = step.terminated | step.truncated
        time_outs = done_env.unsqueeze(1) & ~step.endings[self.team].any
        reward = step.reward[self.team]
        log = {f"/{key}": value.float() for key, value in mission.log(own, step).items()}
        extras: Extras = {"time_outs": time_outs.flatten().float(), "log": {"/reward": reward.mean(), **log}}
        return LearnerStep(self.scale * reward.flatten(), done_env.repeat_interleave(self.vehicles).long(), extras)

    def observe(self) -> None:
        """Update the team's observations."""
        own = self.mission.teams[self.team]
        self._observations, self._truth = own.observe(), own.privileged


class Companion:
    """A team that learns while another team's runner drives rsl-rl's loop; called, it is the team's policy there.

    Each team has its own policy, critic, optimiser and reward, and is updated once an iteration (independent PPO, de
    Witt et al. 2020, arXiv:2011.09533).
    """

    def __init__(self, runner: "StageRunner"):
        """Learn with `runner`, whose environment has the same mission."""
        self.runner, self.env = runner, runner.env
        self._observations = self.env.get_observations()
        self._collected = time.time()

    def begin(self) -> None:
        """Continue from the runner's last iteration."""
        self.runner.alg.train_mode()
        self.runner.continue_history()
        self.runner.logger.init_logging_writer()
        self._first = self.runner.current_learning_iteration
        self._collected = time.time()

    def __call__(self, team: Team) -> Tensor:
        """Explore: sample actions [env, vehicle, action]."""
        return self.env.commanded(self.runner.alg.act(self._observations))

    def take(self, step: LearnerStep) -> None:
        """Store the result of the last actions; call this after the mission has reset."""
        self.env.observe()
        self._observations = self.env.get_observations()
        reward, dones, extras = step
        self.runner.alg.process_env_step(self._observations, reward, dones, {"time_outs": extras["time_outs"]})
        self.runner.logger.process_env_step(reward, dones, extras)

    def update(self) -> None:
        """Update the policy from the steps since the last update."""
        runner, start = self.runner, time.time()
        with torch.inference_mode():
            runner.alg.compute_returns(self._observations)
        losses, it = runner.alg.update(), runner.current_learning_iteration
        now = time.time()
        runner.logger.log(
            it=it, start_it=self._first, total_it=runner.last, collect_time=start - self._collected,
            learn_time=now - start, loss_dict=losses, learning_rate=runner.alg.learning_rate,
            action_std=runner.alg.get_policy().output_std, rnd_weight=None,
        )  # fmt: skip
        runner.current_learning_iteration = it + 1
        self._collected = now

    def save(self, iterations: int) -> None:
        """Write a checkpoint after `iterations` of the stage, as many as the driving runner has completed."""
        self.runner.logger.completed = self.runner.first + iterations
        self.runner.save("")

    def end(self) -> None:
        """Close the log."""
        if self.runner.logger.writer is not None:
            self.runner.logger.stop_logging_writer()
