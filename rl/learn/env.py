"""rsl-rl's view of one team: each vehicle of each environment is one row, all sharing one policy."""

from collections.abc import Mapping

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from rl.learn.policy import Policy
from rl.missions.formation.mission import FormationTask, Step


class FormationEnv(VecEnv):
    """Row `env * vehicles + vehicle`; actions and observations are [row, n].

    The learning team's vehicles act by the rows; every other team acts by its frozen policy. An environment starts
    anew, in the same step, when any vehicle's episode ends: rows whose own vehicle ended are terminated, the rest
    (time is up, or a team mate or the other team ended) are truncated, which rsl-rl takes as `extras["time_outs"]`.
    """

    def __init__(self, task: FormationTask, team: str, frozen: Mapping[str, Policy] | None = None):
        """Adapt `task` for `team`; `frozen` holds a policy for each other team in the task."""
        self.task, self.team, self.frozen = task, team, dict(frozen or {})
        missing = set(task.teams) - {team} - set(self.frozen)
        if missing:
            raise ValueError(f"no policy for {sorted(missing)}: teams that do not learn act by frozen policies")
        self.vehicles = task.teams[team].section.count
        self.num_envs = task.num_envs * self.vehicles
        self.num_actions = len(task.teams[team].action_names)
        self.max_episode_length = task.config.episode_steps
        self.device = str(task.env_world.device)
        self.cfg = task.config.model_dump()
        self._observations = task.teams[team].observe()
        self.last: Step | None = None
        task.steps.copy_(torch.randint(task.config.episode_steps, (task.num_envs,), generator=task.generator))

    @property
    def episode_length_buf(self) -> Tensor:
        """Decisions since the episode began, [row]."""
        return self.task.steps.repeat_interleave(self.vehicles)

    @episode_length_buf.setter
    def episode_length_buf(self, value: Tensor) -> None:
        self.task.steps.copy_(value[:: self.vehicles])

    def get_observations(self) -> TensorDict:
        """Current observations under the key "policy"."""
        rows = self._observations.flatten(0, 1)
        return TensorDict({"policy": rows}, batch_size=[self.num_envs], device=self.device)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict]:
        """One decision of every row; see the class for endings."""
        joint = {name: policy(self.task.teams[name]) for name, policy in self.frozen.items()}
        joint[self.team] = actions.view(-1, self.vehicles, self.num_actions)
        self.last = step = self.task.step(joint)
        done_env = step.terminated | step.truncated
        own = step.endings[self.team].any
        time_outs = done_env.unsqueeze(1) & ~own
        log = self._log(step)  # before the reset: of the step, not of fresh starts
        self.task.reset(done_env.nonzero().squeeze(1))
        self._observations = self.task.teams[self.team].observe()
        extras = {"time_outs": time_outs.flatten().float(), "log": log}
        dones = done_env.repeat_interleave(self.vehicles)
        return self.get_observations(), step.reward[self.team].flatten(), dones.long(), extras

    def _log(self, step: Step) -> dict[str, Tensor]:
        team, ended = self.task.teams[self.team], step.endings[self.team]
        log = {
            "/reward": step.reward[self.team].mean(),
            "/leader_error_m": team.distance[:, 0].mean(),
            "/collisions": ended.collided.float().sum(),
            "/lost": ended.lost.float().sum(),
        }
        if self.vehicles > 1:
            log["/follower_error_m"] = team.distance[:, 1:].mean()
        return log
