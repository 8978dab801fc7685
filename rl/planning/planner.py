"""A planner as a policy: sampling MPC in forks of the mission itself.

A plan is a correction of what the team's classical controller asks for (`Team.planned`), at evenly spaced knots with
straight lines between them: in a formation of its velocity, ahead and to starboard of the target's course. Every
`every` seconds the environment is forked into `samples` copies, each follows a plan of its own for the `horizon`, and
the costs (`Mission.plan_cost`) of what happens choose: the path-integral update (Williams, Drews, Goldfain, Rehg &
Theodorou 2018, IEEE Trans. Robotics 34(6)) for each vehicle of the team by its own cost, and for the leader also by a
share of its followers', whose slots go where it goes. Later rounds draw about that mean with half the spread. Among the
samples are always the plan of before or the mean of the round before, the classical controller alone, and, if there is
one, a learned policy. At last the mean is tried against the best sample, the classical controller and the learned
policy; what costs the team least is followed. So a plan is never worse in the model than the classical controller.
"""

import math
import time
from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar

import torch
from pydantic import Field
from torch import Tensor

from rl.guidance.course.obstacles import AWAY, BOTTOM, CARRIED, EAST, NORTH, RADIUS, TOP, V_EAST, V_NORTH
from rl.mission import Mission
from rl.perception.sensors import Obstacle
from rl.step import VehicleActions
from rl.team import ControllerError, Policy, Team
from taichi_sim.config import ConfigError, NonNegative, Positive, Strict
from taichi_sim.config.plausible import Plausible
from taichi_sim.kernels import runtime

MOST = 8192  # environments of a fork: more are planned for in turn
MEAN, CLASSICAL, LEARNED = range(3)  # numbers of samples: the mean so far, no correction, a policy's own actions
PARTS = 4  # of all environments, whole ones of which are planned for at a time
FINAL = 4  # plans that are compared at last: these three, and the best sample
SHRINK = 0.5  # of the spread, from round to round
TEMPERATURE = 0.1  # of the costs, over the spread of the better half of them


class PlanConfig(Strict):
    """Sampling MPC over knots of a correction of the classical controller: `[TEAM.plan]`."""

    samples: Annotated[int, Field(ge=4, le=65536)] = 64  # futures tried in each round, of each environment
    rounds: Annotated[int, Field(ge=1, le=50)] = 3  # of samples for each plan
    horizon: Annotated[Positive, Plausible(0.1, 3600.0, "s")] = 6.0
    every: Annotated[Positive, Plausible(0.02, 600.0, "s")] = 0.5  # s between plans
    knots: Annotated[int, Field(ge=2, le=50)] = 5  # of a plan, evenly spaced over the horizon, linear in between
    # standard deviation of a knot in the first round: m/s, or share of an action's range
    spread: Annotated[Positive, Plausible(5e-3, 100.0)] = 3.0
    # m of clearance: a plan that comes nearer to anything costs more
    berth: Annotated[NonNegative, Plausible(0.01, 200.0, "m")] = 0.5
    share: Annotated[NonNegative, Plausible(2e-3, 50.0)] = 0.2  # of its followers' costs in a leader's own

    def _mistakes(self) -> Iterator[str]:
        if self.every >= self.horizon:
            yield f"every = {self.every} s must be below horizon = {self.horizon} s"


class Planner:
    """Plans for one team by forks of the truth (an oracle): all that will happen is known.

    Attributes:
        cost: [env], of the followed plan as last predicted, and classical: of the classical controller in the same
            model. follows_policy: bool [env], whether the learned policy was the best. planned: plans that were made,
            one for each environment and time.
    """

    remembers: ClassVar[bool] = True  # plans of each environment, which are not its mission's state

    def __init__(
        self,
        config: PlanConfig | None = None,
        others: Mapping[str, Policy] | None = None,
        *,
        seed: int = 0,
        proposal: Policy | None = None,
    ):
        """Plan as `config` says, default: `[TEAM.plan]` of the scenario.

        Args:
            others: policies of the other teams, by name; default: their classical controllers. seed: of the samples.
            proposal: a policy of the team that is tried, too.
        """
        self._given, self._others, self._proposal = config, dict(others or {}), proposal
        self._generator = torch.Generator().manual_seed(seed)
        self._mission: Mission | None = None
        self._forks: dict[tuple[int, int], Mission] = {}  # by environments and copies
        self.planned, self._seconds, self._life = 0, 0.0, 0.0

    # -- as a policy -----------------------------------------------------------------------------------------------

    def __call__(self, team: Team) -> VehicleActions:
        """Actions of the team's vehicles."""
        start = time.perf_counter()
        with torch.no_grad():
            self.renew(team)
            action = team.planned(self.correction(), self._view(team))
            if self._proposal is not None and bool(self.follows_policy.any()):
                action = torch.where(self.follows_policy.view(-1, 1, 1), self._proposed(team), action)
        self._seconds += time.perf_counter() - start
        self._life += int(team.plannable.any(-1).sum()) * team.mission.config.decision_interval
        return VehicleActions(action)

    def _proposed(self, team: Team) -> Tensor:
        """Vehicle actions of the learned policy."""
        assert self._proposal is not None
        return team.taken(team.checked(self._proposal(team)))

    def renew(self, team: Team) -> None:
        """Plan anew where the last plan is as old as it may be, and could change something; once a decision."""
        # not in inference mode, in which rsl-rl acts: tensors made there do not tell what has changed since
        with torch.no_grad(), runtime.torch_at_rest():
            self.bind(team)
            begins = team.mission.steps == 0
            self._age = torch.where(begins, self._every, self._age + 1)
            self._knots[begins] = 0.0
            due = ((self._age >= self._every) & team.plannable.any(-1)).nonzero().flatten()
            for envs in due.split(max(1, MOST // self.config.samples)) if len(due) else ():
                self._plan(team, envs)

    @property
    def price(self) -> float:
        """Computing time (s) for a second of one environment in which a plan could change something."""
        return self._seconds / max(self._life, 1e-9)

    def correction(self) -> Tensor:
        """The correction [env, vehicle, n] that the plans hold for now."""
        return self._at(self._knots, self._age)

    def correction_at(self, decisions: int) -> Tensor:
        """The correction [env, vehicle, n] at the given number of decisions after the plans were made."""
        return self._at(self._knots, decisions)

    def bind(self, team: Team) -> None:
        """Prepare for the team's mission, unless the planner already has."""
        if self._mission is team.mission:
            return
        mission = team.mission
        self.config = config = self._given or getattr(team.section, "plan", None) or PlanConfig()
        self._mission, self._forks = mission, {}
        dt, envs, vehicles = mission.config.decision_interval, mission.num_envs, team.fleet.count
        self._every, self._steps = (max(1, round(x / dt)) for x in (config.every, config.horizon))
        if self._steps < 2:
            raise ConfigError(f"{team.name}.plan.horizon = {config.horizon} s: must be two decisions of {dt} s or more")
        if config.horizon > mission.config.episode_duration:
            raise ConfigError(
                f"{team.name}.plan.horizon = {config.horizon} s: must not be beyond episode_duration = "
                f"{mission.config.episode_duration} s"
            )
        self._controllers = [other.controller for other in mission.teams.values()]  # made now: their memory is state
        like = team.fleet.state
        self._knots = like.new_zeros((envs, config.knots, vehicles, self._width(team)))
        self._age = torch.full((envs,), self._every, dtype=torch.int64, device=like.device)
        self.follows_policy = torch.zeros(envs, dtype=torch.bool, device=like.device)
        self.cost, self.classical = like.new_zeros(envs), like.new_zeros(envs)

    # -- a plan ----------------------------------------------------------------------------------------------------

    def _plan(self, team: Team, envs: Tensor) -> None:
        """Plan for environments `envs` [n]."""
        part = -(-team.mission.num_envs // PARTS)  # as many at a time as some other time: a fork is kept for each size
        rows = envs[torch.arange(-(-len(envs) // part) * part, device=envs.device) % len(envs)]
        config, n, samples = self.config, len(rows), self.config.samples
        mean, spread = self._shifted(self._knots[rows], self._age[rows]), config.spread
        self._age[envs] = 0
        self.planned += len(envs)
        model = self._fork(team, rows, samples)
        start = model.snapshot()
        best = mean
        least = mean.new_full((n,), math.inf)
        for number in range(config.rounds):
            if number:
                model.restore(start)
            plans = mean.unsqueeze(1) + spread * self._noise((n, samples, *mean.shape[1:]), mean)
            plans[:, MEAN], plans[:, CLASSICAL] = mean, 0.0
            costs = self._costs(model, team.name, plans)
            cost, plan = _best(costs.sum(-1), plans)
            best = torch.where((cost < least).view(-1, 1, 1, 1), plan, best)
            least = torch.minimum(cost, least)
            leader, followers = costs[..., :1], costs[..., 1:]
            leader += config.share * followers.sum(-1, keepdim=True)  # followers do not move their leader: each its own
            mean, spread = self._updated(plans, costs), spread * SHRINK
        self._conclude(team, envs, rows, mean, best)

    def _conclude(self, team: Team, envs: Tensor, rows: Tensor, mean: Tensor, best: Tensor) -> None:
        """Let environments `envs` [n] follow the mean of the plans [row, knot, vehicle, a], the best sample, the
        classical controller or the policy, whichever costs the team least; `rows` are `envs` first, then some again.
        """
        none, n = torch.zeros_like(mean), len(envs)
        plans = torch.stack((mean, none, none, best), 1)
        total = self._costs(self._fork(team, rows, FINAL), team.name, plans).sum(-1)
        cost, knots = _best(total, plans)
        self.classical[envs], self.cost[envs], self._knots[envs] = total[:n, CLASSICAL], cost[:n], knots[:n]
        if self._proposal is not None:
            self.follows_policy[envs] = total[:n].argmin(1) == LEARNED

    def _updated(self, plans: Tensor, costs: Tensor) -> Tensor:
        """The mean [n, knot, vehicle, a] of plans [n, sample, knot, vehicle, a] by the costs [n, sample, vehicle] that
        count for each vehicle.
        """
        return path_integral_mean(plans, costs)

    def _costs(self, model: Mission, name: str, plans: Tensor) -> Tensor:
        """Costs [n, sample, vehicle] of following each of `plans` [n, sample, knot, vehicle, a]."""
        n, samples = plans.shape[:2]
        knots, team = plans.flatten(0, 1), model.teams[name]
        cost = torch.zeros((n * samples, team.fleet.count), device=plans.device, dtype=plans.dtype)
        ended = torch.zeros_like(cost, dtype=torch.bool)
        own = (torch.arange(n * samples, device=plans.device) % samples == LEARNED).view(-1, 1, 1)
        for k in range(self._steps):
            action = self._action(team, self._at(knots, k))
            if self._proposal is not None:
                action = VehicleActions(torch.where(own, self._proposed(team), team.taken(action)))
            others = {other: self._others.get(other, _classical) for other in model.teams if other != name}
            step = model.step({**others, name: action}, begin=False, observe=())
            now = step.endings[name].any
            cost += team.plan_cost(now & ~ended)
            ended |= now
        cost = torch.where(cost.isfinite(), cost, 1e9)
        return cost.view(n, samples, -1)

    def _width(self, team: Team) -> int:
        """Number of values of each vehicle's correction."""
        return len(team.plan_names)

    def _action(self, team: Team, correction: Tensor) -> Tensor | VehicleActions:
        """Actions in the model by a correction [env, vehicle, n]."""
        return VehicleActions(team.planned(correction))

    def _view(self, team: Team) -> object:
        """Knowledge by which the controller acts: the team itself, which is the truth."""
        return team

    # -- models and knots ------------------------------------------------------------------------------------------

    def _fork(self, team: Team, envs: Tensor, copies: int) -> Mission:
        """Make the model: `copies` of each of the environments `envs`, which share all noise to come."""
        return self._copied(team.mission, envs, copies)

    def _copied(self, mission: Mission, envs: Tensor, copies: int) -> Mission:
        """Fork `mission` in place of the last fork of that size."""
        model = mission.fork(envs, copies, into=self._forks.get((len(envs), copies)))
        self._forks[len(envs), copies] = model
        return model

    def _noise(self, shape: tuple[int, ...], like: Tensor) -> Tensor:
        return torch.randn(shape, generator=self._generator, dtype=torch.float32).to(like)

    def _at(self, knots: Tensor, age: Tensor | int | float) -> Tensor:
        """Plans [row, knot, vehicle, a] `age` decisions (a number or [row]) after they were made: [row, vehicle, a]."""
        where = torch.as_tensor(age, device=knots.device).to(knots) * ((knots.shape[1] - 1) / self._steps)
        where = where.clamp(max=knots.shape[1] - 1).expand(len(knots))
        first = where.floor().long().clamp(max=knots.shape[1] - 2)
        part = (where - first).view(-1, 1, 1)
        rows = torch.arange(len(knots), device=knots.device)
        return knots[rows, first] * (1 - part) + knots[rows, first + 1] * part

    def _shifted(self, knots: Tensor, age: Tensor) -> Tensor:
        """Shift plans, made `age` [row] decisions ago, so that they begin now."""
        step = self._steps / (knots.shape[1] - 1)
        return torch.stack([self._at(knots, age + k * step) for k in range(knots.shape[1])], dim=1)


def _best(total: Tensor, plans: Tensor) -> tuple[Tensor, Tensor]:
    """Return the lowest costs [n] of `total` [n, sample], and their plans [n, ...] of `plans` [n, sample, ...]."""
    chosen, rows = total.argmin(1), torch.arange(len(total), device=total.device)
    return total[rows, chosen], plans[rows, chosen]


def path_integral_mean(plans: Tensor, costs: Tensor, temperature: float = TEMPERATURE) -> Tensor:
    """The path-integral mean [n, knot, vehicle, a] of plans [n, sample, knot, vehicle, a] by the costs [n, sample,
    vehicle] that count for each vehicle.
    """
    least, middle = costs.amin(1, keepdim=True), costs.median(1, keepdim=True).values
    weights = torch.softmax(-(costs - least) / (temperature * (middle - least)).clamp(min=1e-6), dim=1)
    return (weights[:, :, None, :, None] * plans).sum(1)


def _classical(team: Team) -> VehicleActions:
    """Actions of a team's classical controller; 0 without a controller."""
    controller = team.controller
    return VehicleActions(torch.zeros_like(team.fleet.action)) if controller is None else team.classical(controller)


class HonestPlanner(Planner):
    """Plans for one team by what its vehicles know, in a world built from that.

    The model (`Mission.imagined`) has nominal craft, the mean wind and current, calm water, exact sensors, and only
    what has been sensed: `Mission.believe` writes into it what the vehicles of a team measure now. What a plan commands
    is flown by the controller on measured states. A user could run it on a boat.
    """

    def bind(self, team: Team) -> None:
        """See `Planner.bind`."""
        if self._mission is not team.mission:
            self._believed: Mission | None = None
        super().bind(team)

    def renew(self, team: Team) -> None:
        """See `Planner.renew`."""
        with torch.no_grad(), runtime.torch_at_rest():
            self.bind(team)
            self._model(team).notice(team)
        super().renew(team)

    def _view(self, team: Team) -> object:
        """Knowledge by which the controller acts: what the vehicles know."""
        return team.known

    def _fork(self, team: Team, envs: Tensor, copies: int) -> Mission:
        """Make the model: `copies` of what the vehicles of each of the environments `envs` believe."""
        model = self._model(team)
        model.believe(team)
        return self._copied(model, envs, copies)

    def _model(self, team: Team) -> Mission:
        """The model of all environments."""
        mission = team.mission
        if self._believed is None:
            self._believed = mission.imagined(team)
            if self._believed is None:
                raise ControllerError(
                    f"{type(mission).__name__} has no way to build what {team.name} knows (Mission.imagined, "
                    "rl/mission.py): there is no honest planner for it; --controller oracle plans by the truth"
                )
            for other in self._believed.teams.values():
                _ = other.controller  # made now: its memory is state
        return self._believed


def write_obstacles_as_bodies(table: Tensor, position: Tensor, seen: Tensor) -> None:
    """Write sensed obstacles into a table of bodies [env, 8, body] (rl/guidance/course/obstacles.py), from its first
    column on.

    Args:
        position: [env, vehicle, 2 or more] of the vehicles that sensed them, as they know it, m, NED.
        seen: [env, vehicle, k, 9] obstacles as a `Sensor` has them (rl/perception/sensors.py).
    """
    away = seen[..., Obstacle.LEVEL, None] + seen[..., Obstacle.RADIUS, None]
    place = position[:, :, None, :2] + away * seen[..., Obstacle.NORTH : Obstacle.DOWN]
    north, east = torch.where(seen[..., Obstacle.NUMBER, None] >= 0, place, AWAY).unbind(-1)
    bodies = seen.shape[1] * seen.shape[2]
    rows = {NORTH: north, EAST: east, RADIUS: seen[..., Obstacle.RADIUS]}
    rows |= {V_NORTH: seen[..., Obstacle.V_NORTH], V_EAST: seen[..., Obstacle.V_EAST]}
    table[:, BOTTOM, :bodies], table[:, TOP, :bodies], table[:, CARRIED, :bodies] = -AWAY, AWAY, 0.0
    for row, values in rows.items():
        table[:, row, :bodies] = values.flatten(1)
