"""One team of a mission as a VecEnv of Stable-Baselines3.

It adapts what `gymnasium.make_vec` returns. All environments are one simulation in this process, so that neither
SubprocVecEnv nor DummyVecEnv is needed. One action and one observation hold all vehicles of the team
(rl/adapters/gymnasium.py).
"""

from collections.abc import Sequence
from typing import cast

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

from rl.adapters.gymnasium import Infos, TeamVectorEnv
from taichi_sim.errors import needs, refuse

with needs("stable-baselines3", "sb3"):
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices


class TeamVecEnv(VecEnv):
    """`TeamVectorEnv` as a VecEnv.

    A step returns Gymnasium's infos, one dictionary for each environment. Where an episode ended, it also holds
    `terminal_observation`, `TimeLimit.truncated` and `episode` (return `r` and length `l`), which the learner logs.

    `seed(n)` fixes the episodes from the next `reset` on: all environments draw from one sequence.
    """

    def __init__(self, envs: VectorEnv):
        """Adapt `envs`, made by `gymnasium.make_vec("taichi_sim/...")` or `TeamVectorEnv(...)`."""
        self.envs = envs.unwrapped
        mode = getattr(self.envs, "autoreset_mode", AutoresetMode.SAME_STEP)
        refuse(
            ValueError,
            (not isinstance(self.envs, TeamVectorEnv), f"{envs}: not a vector environment of taichi_sim"),
            (self.envs is not envs, f"{type(envs).__name__} of Gymnasium would not act on the last observations of "
             "episodes: hand over envs.unwrapped, and wrap the result by VecNormalize ... of Stable-Baselines3"),
            (mode is not AutoresetMode.SAME_STEP, f"autoreset_mode = {mode.value!r}: only 'SameStep' is allowed"),
        )  # fmt: skip
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._actions = np.zeros(self.envs.action_space.shape or (), np.float32)
        self._return, self._length = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.int64)

    def reset(self) -> np.ndarray:
        """Begin a new episode in every environment and put the infos into `reset_infos`."""
        if given := sorted({key for options in self._options for key in options}):
            self._reset_options()
            raise ValueError(f"reset options {given} are unknown: there are none")
        observations, infos = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._return[:], self._length[:] = 0.0, 0
        self.reset_infos = self._listed(infos)
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions for the next `step_wait`."""
        self._actions = np.array(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, object]]]:
        """Take one decision in every environment; return observations, rewards, dones and infos."""
        observations, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        dones, listed = terminated | truncated, self._listed(infos)
        self._return += rewards
        self._length += 1
        for env in dones.nonzero()[0]:
            listed[env]["terminal_observation"] = infos["final_obs"][env]
            listed[env]["TimeLimit.truncated"] = bool(truncated[env])
            listed[env]["episode"] = {"r": float(self._return[env]), "l": int(self._length[env])}
        self._return[dones], self._length[dones] = 0.0, 0
        return observations, rewards.astype(np.float32), dones, listed

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Pictures of all environments, for `render` and VecVideoRecorder."""
        return cast(Sequence[np.ndarray], self.envs.render() or ())

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[object]:
        """An attribute that the environments share, once for each of `indices`."""
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: object, indices: VecEnvIndices = None) -> None:
        """Set an attribute that the environments share."""
        setattr(self.envs, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: object, indices: VecEnvIndices = None, **method_kwargs: object
    ) -> list[object]:
        """Call a method for all environments at once; return its result once for each of `indices`."""
        result = getattr(self.envs, method_name)(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Whether environments are wrapped: never."""
        return [False for _ in self._get_indices(indices)]

    def _listed(self, infos: Infos) -> list[dict[str, object]]:
        """Convert Gymnasium's infos to one dictionary for each environment, without masked values."""
        arrays = {key: value for key, value in infos.items() if isinstance(value, np.ndarray)}
        values = {key: value for key, value in arrays.items() if f"_{key}" in arrays and not key.startswith("final_")}
        return [
            {key: value[env] for key, value in values.items() if arrays[f"_{key}"][env]} for env in range(self.num_envs)
        ]
