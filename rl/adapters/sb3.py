"""Stable-Baselines3's view of one team: its VecEnv, of the environments that `gymnasium.make_vec` gives.

All environments are one simulation in this process: no SubprocVecEnv, no DummyVecEnv. The vehicles of the team are
stacked in one action and one observation, as in rl/adapters/gymnasium.py.
"""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from rl.adapters.gymnasium import TeamVectorEnv
from taichi_sim.config.extras import MissingExtraError

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv
except ModuleNotFoundError as error:
    raise MissingExtraError("stable-baselines3", "sb3") from error


class TeamVecEnv(VecEnv):
    """`TeamVectorEnv` under Stable-Baselines3's names. Infos of a step are those of Gymnasium, one dictionary for each
    environment; where an episode ended, with `terminal_observation`, `TimeLimit.truncated` and `episode` (its return
    `r` and its length `l`), which the learner averages and logs.

    `seed(n)` fixes the episodes from the next `reset` on: all environments draw from one sequence.
    """

    def __init__(self, envs: Any):
        """Adapt `envs`, of `gymnasium.make_vec("taichi_sim/...")` or `TeamVectorEnv(...)`.

        Raises:
            ValueError: for other environments, or another autoreset mode than "SameStep".
        """
        self.envs: TeamVectorEnv = envs.unwrapped
        if not isinstance(self.envs, TeamVectorEnv):
            raise ValueError(f"{envs}: not a vector environment of taichi_sim")
        if self.envs.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode = {self.envs.autoreset_mode.value!r}: only 'SameStep' is allowed")
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._actions = np.zeros(self.envs.action_space.shape or (), np.float32)
        self._return, self._length = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.int64)

    def reset(self) -> np.ndarray:
        """Begin a new episode everywhere; the infos are then in `reset_infos`."""
        observations, infos = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._return[:], self._length[:] = 0.0, 0
        self.reset_infos = self._listed(infos)
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One decision in every environment: observations, rewards, dones, infos."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        dones, told = terminated | truncated, self._listed(infos)
        self._return += rewards
        self._length += 1
        for env in dones.nonzero()[0]:
            told[env]["terminal_observation"] = infos["final_obs"][env]
            told[env]["TimeLimit.truncated"] = bool(truncated[env])
            told[env]["episode"] = {"r": float(self._return[env]), "l": int(self._length[env])}
        self._return[dones], self._length[dones] = 0.0, 0
        return observations, rewards.astype(np.float32), dones, told

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the environments, which they share, once for each of `indices`."""
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environments, which they share."""
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call a method of all environments at once; its result, once for each of `indices`."""
        result = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Whether environments are in a wrapper: none is."""
        return [False for _ in self._get_indices(indices)]

    def _listed(self, infos: dict[str, Any]) -> list[dict[str, Any]]:
        """A dictionary for each environment, of Gymnasium's one, without the values masked out."""
        values = {key: value for key, value in infos.items() if f"_{key}" in infos and not key.startswith("final_")}
        return [
            {key: value[env] for key, value in values.items() if infos[f"_{key}"][env]} for env in range(self.num_envs)
        ]
