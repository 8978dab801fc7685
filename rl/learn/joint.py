"""Teams that learn at the same time: one runner leads through rsl-rl's loop, the others learn from its steps.

Each team has its own policy, critic, optimiser and reward; all act in the same environments, and each is updated once
an iteration (independent PPO, de Witt et al. 2020, arXiv:2011.09533).
"""

import time
from typing import Any

import torch
from torch import Tensor

from rl.learn.env import Told
from rl.learn.runner import StageRunner


class Companion:
    """A team that learns while another one's runner leads: its policy in the other's environment."""

    def __init__(self, runner: StageRunner):
        """Learn by `runner`, whose environment is about the same mission."""
        self.runner, self.env = runner, runner.env
        self._observations = self.env.get_observations()
        self._collected = time.time()

    def begin(self) -> None:
        """Go on from where the runner is."""
        self.runner.alg.train_mode()
        self.runner.go_on()
        self.runner.logger.init_logging_writer()
        self._first = self.runner.current_learning_iteration
        self._collected = time.time()

    def __call__(self, team: Any) -> Tensor:
        """Explore."""
        return self.env.commanded(self.runner.alg.act(self._observations))

    def take(self, told: Told) -> None:
        """What its actions came to; the mission has been reset where episodes ended."""
        self.env.look()
        self._observations = self.env.get_observations()
        reward, dones, extras = told
        self.runner.alg.process_env_step(self._observations, reward, dones, extras)
        self.runner.logger.process_env_step(reward, dones, extras, None)

    def update(self) -> None:
        """Learn from the steps since the last time."""
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
        """Write a checkpoint of so many iterations of the stage, those that its leader has completed."""
        self.runner.logger.completed = self.runner.first + iterations
        self.runner.save("")

    def end(self) -> None:
        """Close its log."""
        if self.runner.logger.writer is not None:
            self.runner.logger.stop_logging_writer()
