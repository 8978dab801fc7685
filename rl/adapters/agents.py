"""Names of vehicles as agents (`usv_0` is the leader, `usv_1`, ..., `uav_2`); tensors by team to tensors by agent
and back.
"""

from collections.abc import Mapping

import numpy as np
import torch
from gymnasium.spaces import Box
from torch import Tensor

from rl.adapters.batched import BatchedEnv, ByTeam


class Agents:
    """The agents of an environment, in the order of its teams.

    Attributes:
        names: of all agents.
        observation_spaces, action_spaces: agent -> Box.
        state_space: of `BatchedEnv.state`, one for all agents.
    """

    def __init__(self, env: BatchedEnv):
        """Name each vehicle of the teams that act."""
        self._rows, self._vehicles = env.num_envs, env.vehicles
        self._place = {f"{team}_{k}": (team, k) for team, count in env.vehicles.items() for k in range(count)}
        self.names = list(self._place)
        observed = {team: (len(names),) for team, names in env.observation_names.items()}
        commanded = {team: (len(names),) for team, names in env.action_names.items()}
        self.observation_spaces = {
            name: Box(-np.inf, np.inf, observed[team], np.float32) for name, (team, _) in self._place.items()
        }
        self.action_spaces = {
            name: Box(-1.0, 1.0, commanded[team], np.float32) for name, (team, _) in self._place.items()
        }
        self.state_space = Box(-np.inf, np.inf, (env.num_states,), np.float32)

    def split(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Convert tensors by team [env, vehicle, ...] to tensors by agent [env, ...]."""
        return {name: values[team][:, k] for name, (team, k) in self._place.items()}

    def split_infos(self, infos: Mapping[str, Mapping[str, Tensor]]) -> dict[str, dict[str, Tensor]]:
        """Convert infos by team (name -> [env, vehicle]) to infos by agent (name -> [env])."""
        return {
            name: {key: value[:, k] for key, value in infos[team].items()} for name, (team, k) in self._place.items()
        }

    def stacked(self, actions: Mapping[str, Tensor | np.ndarray]) -> ByTeam:
        """Convert actions by agent [env, a], tensors or arrays, to actions by team [env, vehicle, a].

        Raises:
            ValueError: if an agent is missing or unknown, or an action has a wrong shape.
        """
        if set(actions) != set(self._place):
            missing, unknown = sorted(set(self._place) - set(actions)), sorted(set(actions) - set(self._place))
            problem = f"{missing} are missing" if missing else f"there is no agent {unknown}"
            raise ValueError(f"actions: {problem}; expected one for each of {', '.join(self.names)}")
        rows: dict[str, list[Tensor]] = {team: [] for team in self._vehicles}
        for name, (team, _) in self._place.items():
            row, shape = torch.as_tensor(actions[name]), (self._rows, *self.action_spaces[name].shape)
            if tuple(row.shape) != shape:
                raise ValueError(f"the action of {name} has shape {tuple(row.shape)}, expected {shape}")
            rows[team].append(row)
        return {team: torch.stack(of_team, dim=1) for team, of_team in rows.items()}
