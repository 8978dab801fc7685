"""Episodes of a mission as a process that splits: rl/evaluation/odds/splitting.py.

A path is an episode of one environment, until it is over. Its importance is that of the vehicle of the team that is
nearest to the ending (`Team.importance`). States are kept by `Mission.keep`, after all vehicles have perceived, and
come back by `Mission.put` with random numbers of their own.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from rl.evaluation.odds.splitting import HAPPENED, NEW, Floats, Ints, Run
from rl.learn.policy import Policy
from rl.mission import Mission, Step
from taichi_sim.kernels import runtime
from taichi_sim.state.snapshot import Archive

REFILL = 1 / 16  # share of environments that wait for a path before any gets one: each time costs milliseconds


class Decided(NamedTuple):
    """What a decision did, [env]."""

    importance: Tensor  # float64, `HAPPENED` where a vehicle of the team ended so, lowest where the episode is over
    vehicle: Tensor  # int64, that vehicle, or the nearest to it
    over: Tensor  # bool, the episode is over
    step: Step


class Moments(NamedTuple):
    """When and with whom states were kept."""

    time: Floats  # [state] s since the episode began
    vehicle: Ints  # [state] number of the vehicle that was nearest to the ending


Watch = Callable[[int, Ints, Ints, Step], None]
"""Called after each decision with the number of this run, paths, environments [n] in which they are, and the step."""


class EpisodePaths:
    """Episodes of `mission` under `policies` as paths to `ending` of `team`."""

    def __init__(
        self,
        mission: Mission,
        policies: Mapping[str, Policy],
        team: str,
        ending: str,
        tick: Callable[[int], object] = lambda _: None,
    ):
        """Take a mission, whose episodes begin anew. `tick` is called with the steps of vehicles of each decision."""
        self.mission, self._policies, self._team, self._ending = mission, policies, mission.teams[team], ending
        self._vehicles = sum(each.fleet.count for each in mission.teams.values())
        self._kept: list[Archive] = []
        self._at = np.zeros((0, 4), dtype=np.int64)  # of each state: its archive, its row, decisions, vehicle
        self._tick, self.watch = tick, None
        self.conditions: list[dict[str, Floats]] = []
        self.runs = self.begun = self.failed_at_once = 0
        self.duration = 0.0  # s, mean of the episodes of the first run

    watch: Watch | None

    # -- the process -----------------------------------------------------------------------------------------------

    def run(self, starts: Ints, level: float) -> Run:
        """See `Process`."""
        with runtime.torch_at_rest():
            return self._run(starts, level)

    def _run(self, starts: Ints, level: float) -> Run:
        envs, n = self.mission.num_envs, len(starts)
        highest = np.full(n, -np.inf)
        path_of = np.full(envs, -1)  # -1: waits for a path
        lives = 0
        paths, states, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
        next_, cost = 0, 0.0
        while next_ < n or (path_of >= 0).any():
            free = np.flatnonzero(path_of < 0)[: n - next_]
            if len(free) and (len(free) >= REFILL * envs or len(free) == n - next_):
                path_of[free] = np.arange(next_, next_ + len(free))
                self._start(free, starts[next_ : next_ + len(free)])
                next_ += len(free)
            told = decide(self.mission, self._policies, self._team.name, self._ending)
            cost += envs * self._vehicles
            self._tick(envs * self._vehicles)
            importance, over = told.importance.cpu().numpy(), told.over.cpu().numpy()
            going = np.flatnonzero(path_of >= 0)
            if self.watch is not None:
                self.watch(self.runs, path_of[going], going, told.step)
            lives += len(going)
            highest[path_of[going]] = np.maximum(highest[path_of[going]], importance[going])
            there = going[importance[going] >= level]
            if len(there):
                paths.append(path_of[there])
                states.append(self._keep(there, told.vehicle.cpu().numpy()))
                values.append(importance[there])
            path_of[there] = -1
            path_of[going[over[going]]] = -1
        if not self.runs:
            self.duration = lives / max(1, n) * self.mission.config.decision_interval
        self.runs += 1
        path = np.concatenate(paths)
        order = np.argsort(path, kind="stable")
        return Run(path[order], np.concatenate(states)[order], np.concatenate(values)[order], highest, cost)

    # -- beginning and keeping -------------------------------------------------------------------------------------

    def _start(self, envs: Ints, states: Ints) -> None:
        """Let paths from `states` [n] begin in environments `envs` [n]."""
        new = states == NEW
        if new.any():
            rows = torch.from_numpy(envs[new])
            self.mission.reset(rows)
            self.begun += len(rows)
            self.failed_at_once += int(self._team.ended()[self._ending].any(1)[rows].sum())
            self.conditions.append(conditions_of(self.mission, self._team.name, self._ending, rows))
        for archive in np.unique(self._at[states[~new], 0]):
            mine = ~new & (self._at[np.maximum(states, 0), 0] == archive if len(self._at) else ~new)
            kept = self._kept[archive].pick(torch.from_numpy(self._at[states[mine], 1]))
            self.mission.put(kept, torch.from_numpy(envs[mine]))

    def _keep(self, envs: Ints, vehicles: Ints) -> Ints:
        """Keep the states of environments `envs` [n], whose nearest `vehicles` are [env]; their names."""
        first, count = len(self._at), len(envs)
        steps = self.mission.steps.cpu().numpy()[envs]
        where = np.column_stack((np.full(count, len(self._kept)), np.arange(count), steps, vehicles[envs]))
        self._at = np.concatenate((self._at, where))
        self._kept.append(self.mission.keep(torch.from_numpy(envs)))
        return first + np.arange(count)

    def moments(self, states: Ints) -> Moments:
        """When and with whom `states` [n] were kept."""
        return Moments(self._at[states, 2] * self.mission.config.decision_interval, self._at[states, 3])


def decide(mission: Mission, policies: Mapping[str, Policy], team: str, ending: str) -> Decided:
    """Make one decision of all teams; episodes that are over go on as they are."""
    step = mission.step({name: policies[name] for name in mission.teams}, begin=False, observe=())
    near = importance_of(mission, team, ending).masked_fill(step.over.unsqueeze(1), -torch.inf)
    each = near.masked_fill(step.endings[team][ending], HAPPENED)
    nearest, vehicle = each.max(dim=1)
    return Decided(nearest, vehicle, step.over, step)


def importance_of(mission: Mission, team: str, ending: str) -> Tensor:
    """How near vehicles of a team are to an ending, float64 [env, vehicle]; what is not finite counts as far."""
    value = mission.teams[team].importance(ending).double()
    return torch.where(value.isfinite(), value, -torch.inf)


def conditions_of(mission: Mission, team: str, ending: str, envs: Tensor) -> dict[str, Floats]:
    """Conditions of episodes that begin in environments `envs` [n]: name with unit -> [n]."""
    world = mission.world
    truth = world.truth[team][envs].double()
    column = {name: truth[..., k] for k, name in enumerate(world.truth_names[team])}
    found = {"significant wave height, m": column.pop("sea.hs"), "wave period, s": 10 * column.pop("sea.tp")}
    north, east = column.pop("sea.direction.cos"), column.pop("sea.direction.sin")
    blows = torch.stack((column.pop("air.north"), column.pop("air.east")))
    flows = torch.stack((column.pop("sea.current.north"), column.pop("sea.current.east")))
    found["current, m/s"], found["wind, m/s"] = flows.norm(dim=0), 10 * blows.norm(dim=0)
    found["wind with the waves (1) or against (-1)"] = (blows * torch.stack((north, east))).sum(0) / (
        blows.norm(dim=0).clamp(min=1e-9)
    )
    found["turbulence, of the scenario's"] = column.pop("air.turbulence")
    of_team = {name: value.mean(1) for name, value in found.items()}
    of_team |= {f"{name}, mean deviation": value.mean(1) for name, value in column.items()}
    of_team["nearness at the start"] = importance_of(mission, team, ending)[envs].amax(dim=1)
    return {name: value.cpu().numpy() for name, value in of_team.items()}
