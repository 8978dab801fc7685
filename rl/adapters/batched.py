"""All vehicles of a mission in thousands of environments, as torch tensors: what a learner of whole teams takes.

Dictionaries are by team, for the teams that act; the leader is vehicle 0:

    observations  [env, vehicle, n], of order one; `observation_names[team]` names the n
    actions       [env, vehicle, a] in [-1, 1], tensors or arrays; clipped to that range; named by
                  `action_names[team]`
    rewards       [env, vehicle]
    terminated    bool [env, vehicle]: an ending of this vehicle
    truncated     bool [env, vehicle]: the episode is over, but not by an ending of this vehicle: time is up, or another
                  vehicle's episode ended, of its team or another
    infos         name -> [env, vehicle]: the mission's (`distance`, m, from the slot) and why vehicles ended, as of the
                  end of the step, before any episode begins anew

An environment's episode is over for all its vehicles at once, when time is up or any vehicle's episode ends.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from gymnasium.error import ResetNeeded
from torch import Tensor

from rl.adapters.other_teams import ABSENT, OTHERS, policy_of_other
from rl.mission import Mission
from rl.missions import load_scenario, make_mission
from taichi_sim.config.explain import nearly
from taichi_sim.config.io import find_config
from taichi_sim.kernels import runtime

ByTeam = dict[str, Tensor]


class Stepped(NamedTuple):
    """What one decision brought, by team; see the module."""

    observations: ByTeam
    rewards: ByTeam
    terminated: ByTeam
    truncated: ByTeam
    infos: dict[str, dict[str, Tensor]]


class BatchedEnv:
    """`num_envs` environments that step together; see the module.

    With `autoreset` an environment whose episode is over begins anew in the same step: the observations are of its new
    episode. Without it, they are the last ones of the old, and `reset(envs=...)` begins the new.

    Worlds (tracks, obstacles, seas, starts) are made from the constructor's seed; `reset(seed=...)` fixes which of them
    later episodes get. The same two seeds, `num_envs` and actions give the same bits.

    Attributes:
        mission: the simulated mission (rl/mission.py). num_envs: environments. device: where tensors live.
        vehicles: team -> number of its vehicles, of the teams that act. observations: as of now.
        observation_names, action_names: team -> names. num_states: numbers of `state`.
    """

    def __init__(
        self,
        scenario: str | Path = "escort",
        num_envs: int = 1,
        *,
        teams: str | Sequence[str] | None = None,
        others: Mapping[str, str | Path] | None = None,
        overrides: Iterable[str] = (),
        seed: int | None = None,
        autoreset: bool = True,
    ):
        """Build the mission of a scenario and begin an episode in every environment.

        Args:
            scenario: a TOML file or a shipped name. num_envs: environments. overrides: KEY=VALUE each.
            teams: those that act; default all that the scenario's stages train (of one without stages, all) and that
                `others` does not name.
            others: team -> what it does: "absent" (not simulated), "constant" (every command 0), "classical", or the
                path of a run folder or of a checkpoint in one, whose frozen policy acts. Teams named neither here nor
                in `teams` are absent.
            seed: of the worlds; default the scenario's. autoreset: see the class.

        Raises:
            ValueError: for a wrong argument; ConfigError, ControllerError, RunError, CheckpointError: for an unusable
                file, or a team without a controller.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs} must be at least 1")
        config, source = load_scenario(scenario, overrides), find_config(scenario)
        acting, others = _parts(config, teams, {} if others is None else others)
        there = [name for name in config.teams if name in acting or others.get(name, ABSENT) != ABSENT]
        worlds_seed = config.seed if seed is None else seed
        self.mission: Mission = make_mission(config, num_envs, seed=worlds_seed, teams=there, source=source)
        self.num_envs, self.autoreset, self.device = num_envs, autoreset, self.mission.device
        self._acting = {name: self.mission.teams[name] for name in acting}
        self._others = {
            name: policy_of_other(others[name], team, config, f"others[{name!r}]")
            for name, team in self.mission.teams.items()
            if name not in acting
        }
        self.vehicles = {name: team.fleet.count for name, team in self._acting.items()}
        self.action_names = {name: team.action_names for name, team in self._acting.items()}
        self.observation_names = {name: team.observation_names for name, team in self._acting.items()}
        self._over = torch.zeros(num_envs, dtype=torch.bool, device=self.device)  # and not begun anew
        self._look()
        self.num_states = self.state().shape[1]

    def reset(self, seed: int | None = None, *, envs: Tensor | None = None) -> ByTeam:
        """Begin new episodes in environments `envs` (numbers, or a bool [env]; default: all); return observations.

        Episodes continue one random sequence, the constructor's seed's at first, until `seed` begins another.
        """
        if seed is not None:
            self.mission.reseed(seed)
        if envs is not None:
            given: Tensor = torch.as_tensor(envs, device=self.device)
            envs = given.nonzero().squeeze(1) if given.dtype == torch.bool else given.long()
        self.mission.reset(envs)
        self._over = torch.zeros_like(self._over) if envs is None else self._over.index_fill(0, envs, False)
        return self._look()

    def step(self, actions: Mapping[str, Any]) -> Stepped:
        """One decision in every environment; see the module.

        Raises:
            ValueError: for a team too many or too few, a wrong shape, or an action that is not finite; nothing has
                moved then. ResetNeeded: where an episode is over, without autoreset.
        """
        if self._over.any():
            raise ResetNeeded(f"the episodes of environments {self._over.nonzero().squeeze(1).tolist()} are over")
        with runtime.torch_at_rest():
            return self._step(self._checked(actions))

    def _step(self, given: ByTeam) -> Stepped:
        mission = self.mission
        joint = {name: policy(mission.teams[name]) for name, policy in self._others.items()}
        joint |= {name: team.command(given[name]) for name, team in self._acting.items()}
        step = mission.step(joint)
        over = step.terminated | step.truncated
        terminated = {name: step.endings[name].any for name in self._acting}
        truncated = {name: over.unsqueeze(1) & ~ended for name, ended in terminated.items()}
        told = {name: mission.info(team) for name, team in self._acting.items()}
        infos = {
            name: {key: value.clone() for key, value in values.items()} | dict(step.endings[name])
            for name, values in told.items()
        }
        rewards = {name: step.reward[name] for name in self._acting}
        if self.autoreset:
            mission.reset(over.nonzero().squeeze(1))
        else:
            self._over = over
        return Stepped(self._look(), rewards, terminated, truncated, infos)

    def state(self) -> Tensor:
        """What a central critic may be told now, [env, num_states]: for each team that acts the observations of its
        vehicles, one after the other, then, of each vehicle, the truth that it does not know (`Team.privileged`).
        """
        parts = []
        with runtime.torch_at_rest():
            for name, team in self._acting.items():
                truth = team.privileged
                parts += [self.observations[name]] if truth is None else [self.observations[name], truth]
            return torch.cat([part.flatten(1) for part in parts], dim=1)

    def _look(self) -> ByTeam:
        with runtime.torch_at_rest():
            self.observations = {name: team.observe() for name, team in self._acting.items()}
        return dict(self.observations)

    def _checked(self, actions: Mapping[str, Any]) -> ByTeam:
        if not isinstance(actions, Mapping) or set(actions) != set(self._acting):
            given = sorted(actions) if isinstance(actions, Mapping) else type(actions).__name__
            raise ValueError(f"actions are for {given}, expected is one tensor for each of {[*self._acting]}")
        return {name: self._finite(name, actions[name]) for name in self._acting}

    def _finite(self, team: str, action: Any) -> Tensor:
        """An action of the policy, as a tensor."""
        names = self.action_names[team]
        shape = self.num_envs, self.vehicles[team], len(names)
        action = torch.as_tensor(action, device=self.device).detach().to(self._acting[team].action.dtype)
        if tuple(action.shape) != shape:
            raise ValueError(f"actions of {team} have shape {tuple(action.shape)}, expected {shape}")
        if not math.isfinite(action.sum()) and not (finite := action.isfinite()).all():
            env, vehicle, index = (~finite).nonzero()[0].tolist()
            raise ValueError(
                f"action {names[index]!r} of {team}_{vehicle} in environment {env} is "
                f"{action[env, vehicle, index].item()}: actions must be finite"
            )
        return action


def _parts(
    config: Any, teams: str | Sequence[str] | None, others: Mapping[str, str | Path]
) -> tuple[list[str], Mapping[str, str | Path]]:
    """The teams that act, in the order of the scenario, and what the others do.

    Raises:
        ValueError: for a team that is not there, has a script, or is named as both; or if none acts.
    """
    if not isinstance(others, Mapping):
        raise ValueError(f"others = {others!r}: a dictionary is expected, team -> {OTHERS}")
    allowed = [name for name in config.teams if name not in config.scripted]
    if teams is None:
        teams = [name for name in config.trained or allowed if name not in others]
    acting = [teams] if isinstance(teams, str) else list(teams)
    for told, names in (("teams", acting), ("others", others)):
        for name in names:
            _check_commanded(config, told, name, allowed)
    if both := [name for name in acting if name in others]:
        raise ValueError(f"others: {', '.join(both)} is also named in teams: it either acts or is one of the others")
    if not acting:
        raise ValueError(f"teams: none acts; allowed are {', '.join(allowed)}")
    return [name for name in allowed if name in acting], others


def _check_commanded(config: Any, told: str, name: str, allowed: Sequence[str]) -> None:
    """Refuse a team that is none of those `allowed`."""
    if name in config.scripted:
        raise ValueError(f"{told}: a script acts for {name!r}; allowed are {', '.join(allowed)}")
    if name not in allowed:
        close = nearly(name, allowed)
        hint = f", did you mean {close!r}?" if close else ""
        raise ValueError(f"{told}: there is no team {name!r}{hint}; allowed are {', '.join(allowed)}")
