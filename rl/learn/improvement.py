"""Policies improved by planning: an algorithm beside PPO for rsl-rl's runner, `[stages.NAME.planning]`.

The policy acts in its environments. Where its actions have an effect, a planner (`Improver`) looks in forks of
the truth for what it should do, and the network is fitted to that: one step of approximate policy iteration (Bertsekas
2011, J. Control Theory Appl. 9(3)) an iteration, by dataset aggregation over the last few (DAgger: Ross, Gordon &
Bagnell 2011, AISTATS). A sample's weight is the square root of the costs at stake in it, so that actions beside an
obstacle are learnt more exactly than actions far from all obstacles.

A plan is a correction of the policy's own actions, and the policy acts in the model, too: what is found is the next
step from what it does now, not another way of doing the task. So the policy learns nothing that depends on what it does
not observe, such as the plan of a moment before.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from rl.learn.env import Extras, MissionEnv
from rl.learn.ppo import LeanPPO
from rl.planning.planner import PlanConfig, Planner, path_integral_mean
from rl.runs import ranks
from rl.scenario import StageConfig
from rl.team import Team

BATCH = 1024  # rows in a step of the optimiser; assumed
DECAY = 1e-3  # of the network's weights; assumed
MOST = 5.0  # weight of a sample, over the mean; assumed
DEVIATING = 2  # knots of a plan that deviate from the policy
TEMPERATURE = 0.5  # of the costs, as a share of their spread: a planner follows one plan, here many are averaged


class Improver(Planner):
    """Plans corrections of a policy by forks of the truth; the mean of the plans is what it suggests.

    Attributes:
        stakes: [env, vehicle], how much an average sample costs more than the best one; 0 where nothing was planned.
    """

    stakes: Tensor

    def __init__(self, config: PlanConfig, policy: Any, others: Mapping[str, Any] | None = None, *, seed: int = 0):
        """Improve `policy`: it gives a team's actions [env, vehicle, `Team.action_names`]."""
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
        return (self._policy(team) + correction).clamp(-1.0, 1.0)

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
    """Pairs of slices: samples, and the vehicles that deviate in them.

    In half of the samples the leader deviates, in the other half its followers. Slots of followers move with the
    leader, so otherwise what the leader tries would blur what its followers try.
    """
    if vehicles == 1:
        return ((slice(None), slice(None)),)
    return ((slice(0, None, 2), slice(0, 1)), (slice(1, None, 2), slice(1, None)))


class Lesson(NamedTuple):
    """The planner's suggestions in an iteration."""

    observed: Tensor  # [row, n]
    wanted: Tensor  # [row, action]
    weight: Tensor  # [row, 1]


class PlannedImprovement(LeanPPO):
    """An algorithm for rsl-rl's runner: `update` fits the actor to the planner's suggestions; the critic stays."""

    def begin(self, env: MissionEnv, stage: StageConfig, done: int) -> None:
        """Improve the policy of `env`; `done` iterations of the stage have been completed."""
        assert stage.planning is not None
        self._env, self._stage, self._done = env, stage, done
        self._lessons: deque[Lesson] = deque(maxlen=stage.planning.rounds)
        self._noted: list[Lesson] = []
        own = env.mission.teams[env.team]
        plan = getattr(own.section, "plan", None) or PlanConfig()
        plan = plan.model_copy(update={"samples": stage.planning.samples, "rounds": 1})
        self._planner = Improver(plan, self._mean, env.frozen, seed=int(torch.randint(2**31, ())))
        self._planner.bind(own)
        self._aim()

    def _aim(self) -> None:
        """Plan with the spread of the iteration that begins."""
        assert self._stage.planning is not None
        first, last = self._stage.planning.spread
        self._planner.aim(first + (last - first) * min(1.0, self._done / max(1, self._stage.iterations - 1)))

    def _mean(self, team: Team) -> Tensor:
        """Mean actions [env, vehicle, a] of the policy."""
        observed = team.observations()
        rows = observed.flatten(0, 1)
        mean = self._actor.rows(self.actor.get_latent(TensorDict({"policy": rows}, batch_size=[len(rows)])))
        return mean.view(*observed.shape[:2], -1).clamp(-1.0, 1.0)

    @torch.no_grad()
    def act(self, obs: TensorDict) -> Tensor:
        """Return the policy's mean actions [row, action], and note what the planner suggests."""
        own, planning = self._env.mission.teams[self._env.team], self._stage.planning
        assert planning is not None
        self._planner.renew(own)
        observed = self.actor.get_latent(obs)
        mean = self._actor.rows(observed).clamp(-1.0, 1.0)
        self._policy.update(mean)
        better = (mean + planning.step * self._planner.correction().flatten(0, 1)).clamp(-1.0, 1.0)
        effective = own.in_effect.flatten()
        weight = self._planner.stakes.flatten()[effective].sqrt().unsqueeze(1)
        self._noted.append(Lesson(observed[effective], better[effective], weight))
        return mean

    def process_env_step(self, obs: TensorDict, rewards: Tensor, dones: Tensor, extras: Extras) -> None:
        """Ignore rewards; planning does not learn from them."""

    def compute_returns(self, obs: TensorDict) -> None:
        """Ignore returns; planning does not learn from them."""

    def update(self) -> dict[str, float]:
        """Fit the actor to the noted suggestions; the mean squared error stands for PPO's surrogate loss."""
        noted = Lesson(*(torch.cat(part) for part in zip(*self._noted, strict=True)))
        mean = noted.weight.mean().clamp(min=1e-9) if len(noted.weight) else 1.0
        self._lessons.append(noted._replace(weight=(noted.weight / mean).clamp(max=MOST)))
        error = self._fit(Lesson(*(torch.cat(part) for part in zip(*self._lessons, strict=True))))
        self._noted = []
        self._done += 1
        self._aim()
        return {"value": 0.0, "surrogate": error, "entropy": 0.0}

    def _fit(self, lesson: Lesson) -> float:
        """Fit the actor to a lesson; return the last epoch's weighted mean squared error."""
        weights = [p for name, p in self.actor.named_parameters() if not name.startswith("distribution")]
        count = len(lesson.weight)
        fewest = -ranks.greatest(-count)  # of all processes: all take as many steps
        if not fewest:
            return 0.0
        size = min(BATCH, fewest)
        batches = fewest // size
        epochs, rate = self.num_learning_epochs, self._stage.learning_rate
        optimizer = torch.optim.AdamW(weights, rate, weight_decay=DECAY, fused=True)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=epochs * batches + 1)
        error = 0.0
        for _ in range(epochs):
            error = 0.0
            for rows in torch.randperm(count)[: batches * size].split(size):
                self._shared.zero_()
                observed, wanted, weight = (part[rows].t() for part in lesson)
                miss = self._actor.forward(observed.contiguous()) - wanted
                error += float((weight * miss.square()).mean()) / batches
                self._actor.backward(miss.mul_(weight).mul_(2 / miss.numel()))
                ranks.average_(self._gradients[0])
                optimizer.step()
                schedule.step()
        return error
