"""Plans about a policy: what it should do, for it to learn (rl/learn/improvement.py).

A plan is a correction of the policy's own actions, and the policy acts in the model, too: what is found is the next
step from what it does now, not another way of doing the task. So the policy learns nothing that depends on what it does
not observe, such as the plan of a moment before.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from rl.planning.config import PlanConfig
from rl.planning.planner import Planner, path_integral_mean

DEVIATING = 2  # knots of a plan that deviate from the policy
TEMPERATURE = 0.5  # of the costs, as a share of their spread: a planner follows one plan, here many are averaged


class Improver(Planner):
    """Plans corrections of a policy by forks of the truth; the mean of the plans is what it suggests.

    Attributes:
        stakes: [env, vehicle], how much an average sample costs more than the best one; 0 where nothing was planned.
    """

    stakes: Tensor

    def __init__(self, config: PlanConfig, policy: Any, others: Mapping[str, Any] | None = None, *, seed: int = 0):
        """Improve `policy`: it gives a team's actions [env, vehicle, `action_names`], before `Team.command`."""
        super().__init__(config, others, seed=seed)
        self._policy = policy

    def aim(self, spread: float) -> None:
        """Plan with this standard deviation of a knot from now on, and at once."""
        self.config = self.config.model_copy(update={"spread": spread})
        self._age.fill_(self._every)

    def bind(self, team: Any) -> None:
        """See `Planner.bind`."""
        if self._mission is not team.mission:
            self.stakes = team.fleet.state.new_zeros(team.fleet.never.shape)
        super().bind(team)

    def _width(self, team: Any) -> int:
        return len(team.action_names)

    def _action(self, team: Any, correction: Tensor) -> Tensor:
        return team.command((self._policy(team) + correction).clamp(-1.0, 1.0))

    def _plan(self, team: Any, envs: Tensor) -> None:
        """Plan where the actions of the policy have an effect, beginning with no correction."""
        self._knots[envs], self._age[envs], self.stakes[envs] = 0.0, 0, 0.0
        envs = envs[team.in_effect[envs].any(-1)]
        if len(envs):
            super()._plan(team, envs)

    def _noise(self, shape: tuple[int, ...], like: Tensor) -> Tensor:
        """Deviations [n, sample, knot, vehicle, a] of the first knots, after which the policy goes on by itself."""
        drawn, noise = super()._noise(shape, like), like.new_zeros(shape)
        for samples, vehicles in _parts(shape[3]):
            part = drawn[:, samples, :DEVIATING, vehicles]
            half = part.shape[1] // 2
            part[:, half : 2 * half] = -part[:, :half]  # opposite pairs: where none is better, their mean is zero
            noise[:, samples, :DEVIATING, vehicles] = part
        return noise

    def _updated(self, plans: Tensor, costs: Tensor) -> Tensor:
        means, stakes = [], []
        for samples, vehicles in _parts(plans.shape[3]):
            cost = costs[:, samples, vehicles]
            stakes.append(cost.mean(1) - cost.amin(1))
            means.append(path_integral_mean(plans[:, samples, :, vehicles], cost, TEMPERATURE))
        self._at_stake = torch.cat(stakes, 1)
        return torch.cat(means, 2)

    def _conclude(self, team: Any, envs: Tensor, rows: Tensor, mean: Tensor, best: Tensor) -> None:
        n = len(envs)
        self._knots[envs], self.stakes[envs] = mean[:n], self._at_stake[:n]


def _parts(vehicles: int) -> tuple[tuple[slice, slice], ...]:
    """Which samples deviate for which vehicles: half of them for the leader, half for its followers, whose slots go
    where it goes; so what the leader tries does not blur what its followers try.
    """
    if vehicles == 1:
        return ((slice(None), slice(None)),)
    return ((slice(0, None, 2), slice(0, 1)), (slice(1, None, 2), slice(1, None)))
