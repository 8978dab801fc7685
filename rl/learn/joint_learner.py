"""A team that learns in the same environments as another one, whose runner drives rsl-rl's loop."""

import time

import torch
from torch import Tensor

from rl.learn.env import LearnerStep
from rl.learn.runner import StageRunner
from rl.team import Team


class JointLearner:
    """A team that learns while another team's runner drives rsl-rl's loop; called, it is the team's policy there.

    Each team has its own policy, critic, optimiser and reward, and is updated once an iteration (independent PPO, de
    Witt et al. 2020, arXiv:2011.09533).
    """

    def __init__(self, runner: StageRunner):
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
        return self.env.by_env(self.runner.alg.act(self._observations))

    def take(self, step: LearnerStep, observations: Tensor) -> None:
        """Store the result of the last actions, and the next `observations` [env, vehicle, n]."""
        self.env.observed(observations)
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
