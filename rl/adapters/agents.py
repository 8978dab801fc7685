"""Vehicles as agents with names: `usv_0` (the leader), `usv_1`, ..., `uav_2`. Between what is by team and by agent."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from torch import Tensor

from rl.adapters.batched import BatchedEnv, ByTeam


class Agents:
    """Agents of an environment, in the order of its teams.

    Attributes:
        names: of all. observation_spaces, action_spaces: name -> Box, one each. state_space: of `BatchedEnv.state`.
    """

    def __init__(self, env: BatchedEnv):
        """Name the vehicles of the teams that act."""
        self._rows, self._vehicles = env.num_envs, env.vehicles
        self._of = {f"{team}_{k}": (team, k) for team, count in env.vehicles.items() for k in range(count)}
        self.names = list(self._of)
        observed = {team: (len(names),) for team, names in env.observation_names.items()}
        commanded = {team: (len(names),) for team, names in env.action_names.items()}
        self.observation_spaces = {
            name: Box(-np.inf, np.inf, observed[team], np.float32) for name, (team, _) in self._of.items()
        }
        self.action_spaces = {name: Box(-1.0, 1.0, commanded[team], np.float32) for name, (team, _) in self._of.items()}
        self.state_space = Box(-np.inf, np.inf, (env.num_states,), np.float32)

    def split(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """By agent [env, ...], what is by team [env, vehicle, ...]."""
        return {name: values[team][:, k] for name, (team, k) in self._of.items()}

    def split_infos(self, infos: Mapping[str, Mapping[str, Tensor]]) -> dict[str, dict[str, Tensor]]:
        """By agent, name -> [env], what is by team, name -> [env, vehicle]."""
        return {name: {key: value[:, k] for key, value in infos[team].items()} for name, (team, k) in self._of.items()}

    def stacked(self, actions: Mapping[str, Any]) -> ByTeam:
        """Actions by team [env, vehicle, a], of those by agent [env, a], tensors or arrays.

        Raises:
            ValueError: for an agent too many or too few, or a wrong shape.
        """
        if set(actions) != set(self._of):
            missing, unknown = sorted(set(self._of) - set(actions)), sorted(set(actions) - set(self._of))
            told = f"{missing} are missing" if missing else f"there is no agent {unknown}"
            raise ValueError(f"actions: {told}; expected one for each of {', '.join(self.names)}")
        rows: dict[str, list[Tensor]] = {team: [] for team in self._vehicles}
        for name, (team, _) in self._of.items():
            row, shape = torch.as_tensor(actions[name]), (self._rows, *self.action_spaces[name].shape)
            if tuple(row.shape) != shape:
                raise ValueError(f"the action of {name} has shape {tuple(row.shape)}, expected {shape}")
            rows[team].append(row)
        return {team: torch.stack(of_team, dim=1) for team, of_team in rows.items()}
