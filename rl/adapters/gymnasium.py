"""One team of a mission as a Gymnasium environment, `taichi_sim/UsvFormation-v0` and others (rl/adapters/__init__.py).

One action and one observation hold all vehicles of the team; vehicle 0 is the leader:

    action       float32 [vehicles * a], clipped to [-1, 1]; must be finite
    observation  float32 [vehicles * n], unbounded but of order one: the mission's terms, named by
                 task.teams[team].observation_names
    reward       mean over the team's vehicles
    terminated   the episode of a vehicle of the team ended
    truncated    time is up, or the other team's episode ended: the action could not prevent it

    info         [vehicles] each; with many environments [num_envs, vehicles], and a mask `_KEY` [num_envs]
      distance              m, from the slot; the leader's is from the target
      reward_vehicle        of this step
      collided, lost, ...   reasons why vehicles ended in this step

`gymnasium.make_vec` gives `TeamVectorEnv`, all environments in one simulation; `gymnasium.make` gives `TeamEnv`. Both
limit the time of an episode themselves (`episode_duration`), so no TimeLimit is registered.
"""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypedDict, Unpack

import gymnasium
import numpy as np
import torch
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from rl.adapters.batched import BatchedEnv
from rl.adapters.render import MODES, Pictures, frames_per_second
from rl.mission import Mission
from taichi_sim.config.arguments import ActionError, numbers, whole_number
from taichi_sim.errors import refuse
from taichi_sim.kernels import runtime

Options = dict[str, np.ndarray]
Infos = dict[str, np.ndarray | dict[str, np.ndarray]]


class TeamVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """One team in `num_envs` environments that step together.

    `autoreset_mode` says when an environment resets after its episode ended:

    - `SAME_STEP`: at once; `infos["final_obs"]` and `infos["final_info"]` hold the last observation and info.
    - `NEXT_STEP`: in the next step, which ignores the action there.
    - `DISABLED`: when `reset(options={"reset_mask": ...})` asks for it.

    The constructor's seed determines the worlds (courses, obstacles, seas, starts). `reset(seed=...)` determines which
    of them the following episodes use. The same two seeds, `num_envs` and actions give the same bits.

    Attributes:
        task: the simulated mission.
    """

    metadata: dict[str, object] = {
        "render_modes": MODES, "render_fps": 10, "autoreset_mode": AutoresetMode.SAME_STEP
    }  # fmt: skip

    @runtime.own_settings()
    def __init__(
        self,
        team: str,
        num_envs: int = 1,
        *,
        scenario: str | Path = "paper",
        overrides: Iterable[str] = (),
        seed: int | None = None,
        other: str | Path = "absent",
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
        render_size: tuple[int, int] | None = None,
        max_episode_steps: int | None = None,
    ):
        """Build the mission of a scenario in which `team` acts.

        Args:
            team: the team that acts.
            num_envs: number of environments.
            scenario: a TOML file or the name of a shipped scenario.
            overrides: KEY=VALUE each.
            seed: of the worlds; default the scenario's.
            other: policy of the other teams: "absent" (not simulated), "constant" (every command 0), "classical", a
                source of rl/learn/policy_sources.py ("pretrained", "FILE.onnx", a run's folder), or a checkpoint in a
                run's folder.
            autoreset_mode: described above.
            render_mode: None, "rgb_array" (`render` returns a picture of each environment), or "human" (a window).
            render_size: width and height of each picture, px. Default: 640x480 for one environment, smaller for more.
            max_episode_steps: refused, what `gymnasium.make_vec` was given: the scenario's `episode_duration` ends
                episodes.
        """
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self._env = BatchedEnv(
            scenario, num_envs, teams=team, others=other, overrides=overrides, seed=seed,
            autoreset=self.autoreset_mode is AutoresetMode.SAME_STEP,
        )  # fmt: skip
        self.num_envs, self.team, config = self._env.num_envs, team, self.task.config
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        if max_episode_steps is not None:
            seconds = max_episode_steps * config.decision_interval
            raise ValueError(
                f"max_episode_steps = {max_episode_steps}: episodes end by the scenario's time: give "
                f"overrides=['episode_duration={seconds:g}'], s"
            )
        self.render_mode = render_mode
        self.metadata["render_fps"] = frames_per_second(config.decision_interval)
        self._pictures = Pictures(self.task, render_size, render_mode)

        shape = self._env.vehicles[team], len(self._env.action_names[team])
        self._action_shape = (self.num_envs, *shape)
        self.single_action_space = Box(-1.0, 1.0, (math.prod(shape),), np.float32)
        rows = _rows(self._env.observations[team])
        self.single_observation_space = Box(-np.inf, np.inf, rows.shape[1:], np.float32)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    @property
    def task(self) -> Mission:
        """The simulated mission."""
        return self._env.mission

    def reset(
        self, *, seed: int | None = None, options: dict[str, np.ndarray] | None = None
    ) -> tuple[np.ndarray, Infos]:
        """Begin new episodes everywhere, or where `options["reset_mask"]` (bool [num_envs]) is true.

        Episodes follow one random sequence. It starts from the constructor's seed; `seed` starts it anew.

        Raises:
            ValueError: if there is another option, or the mask or the seed cannot be used. Nothing has begun.
        """
        mask = self._reset_mask(options or {})
        seed = None if seed is None else whole_number(seed, "seed")
        super().reset(seed=seed)
        observations = self._env.reset(seed, envs=torch.from_numpy(mask))
        self._pictures.keep()
        return _rows(observations[self.team]), _masked(self._env.infos()[self.team], mask)

    def step(self, actions: np.ndarray | Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Infos]:
        """Take one decision in every environment; `actions` is [num_envs, vehicles * a].

        Raises:
            ValueError: if an action has a wrong shape or is not finite. Nothing has moved.
            ResetNeeded: if an episode ended and the mode is DISABLED.
            ProgramError: if another Taichi program runs than when the environments were made.
        """
        begins = np.zeros(self.num_envs, dtype=bool)  # these begin anew in this step and ignore their action
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            begins = _numpy(self._env.over)
            stepped = self._env.decide({self.team: self._unstacked(actions, begins)})
            if begins.any():
                self._env.reset(envs=torch.from_numpy(begins))
        else:
            stepped = self._env.step({self.team: self._unstacked(actions, begins)}, last=self._env.autoreset)
        self._pictures.keep()

        terminated = _numpy(stepped.terminated[self.team].any(1)) & ~begins
        truncated = _numpy(stepped.truncated[self.team].any(1)) & ~terminated & ~begins
        rewards = stepped.rewards[self.team]
        reward = np.where(begins, 0.0, _numpy(rewards.mean(dim=1)).astype(np.float64))
        told, now = {"reward_vehicle": rewards, **stepped.infos[self.team]}, self._env.infos()[self.team]
        infos = _masked({key: value for key, value in told.items() if key not in now}, ~begins)
        if stepped.last is not None:
            infos |= _final(_rows(stepped.last[self.team]), told, terminated | truncated)
        infos |= _masked(now, np.ones(self.num_envs, dtype=bool))
        return _rows(self._env.observations[self.team]), reward, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all environments, uint8 [height, width, 3]; None unless the mode is "rgb_array"."""
        return self._pictures.render()

    def close_extras(self, **kwargs: object) -> None:
        """Close the window, if there is one."""
        self._pictures.close()

    def _reset_mask(self, options: Options) -> np.ndarray:
        unknown, mask = options.keys() - {"reset_mask"}, options.get("reset_mask", np.ones(self.num_envs, dtype=bool))
        fits = isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,) and mask.any()
        refuse(
            ValueError,
            (unknown, f"reset options {sorted(unknown)} are unknown: allowed is 'reset_mask'"),
            (not fits, f"reset_mask = {mask!r} must be a bool array of shape ({self.num_envs},), true somewhere"),
        )
        return mask.copy()

    def _unstacked(self, actions: np.ndarray | Tensor, ignored: np.ndarray) -> Tensor:
        """Reshape actions to [env, vehicle, a], with 0 in environments to be `ignored`."""
        rows = numbers(actions, "actions")
        if tuple(rows.shape) != self.action_space.shape:
            raise ActionError(f"actions have shape {tuple(rows.shape)}, expected {self.action_space.shape}")
        if ignored.any():
            rows = rows.masked_fill(torch.from_numpy(ignored).to(rows.device).unsqueeze(1), 0)
        return rows.reshape(self._action_shape)


class TeamOptions(TypedDict, total=False):
    """Arguments of `TeamVectorEnv` that `TeamEnv` passes on."""

    scenario: str | Path
    overrides: Iterable[str]
    seed: int | None
    other: str | Path
    render_mode: str | None
    render_size: tuple[int, int] | None


class TeamEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One team in one environment, without autoreset."""

    metadata: dict[str, object] = {"render_modes": MODES, "render_fps": 10}

    def __init__(self, team: str, **options: Unpack[TeamOptions]):
        """Build the mission of `team`.

        Args:
            team: the team that acts.
            options: scenario, overrides, seed, other, render_mode and render_size of `TeamVectorEnv`.
        """
        self._vector = TeamVectorEnv(team, 1, autoreset_mode=AutoresetMode.DISABLED, **options)
        self.action_space = self._vector.single_action_space
        self.observation_space = self._vector.single_observation_space
        self.render_mode = self._vector.render_mode
        self.metadata = {**self.metadata, "render_fps": self._vector.metadata["render_fps"]}

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A picture, uint8 [height, width, 3]; None unless the mode is "rgb_array"."""
        frames = self._vector.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close the window, if there is one."""
        self._vector.close()

    @property
    def task(self) -> Mission:
        """The simulated mission."""
        return self._vector.task

    def reset(
        self, *, seed: int | None = None, options: dict[str, np.ndarray] | None = None
    ) -> tuple[np.ndarray, Infos]:
        """Begin a new episode; see `TeamVectorEnv.reset`."""
        seed = None if seed is None else whole_number(seed, "seed")
        super().reset(seed=seed)
        if options:
            raise ValueError(f"reset options {sorted(options)} are unknown: there are none")
        observations, infos = self._vector.reset(seed=seed)
        return observations[0], _first_env(infos)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, Infos]:
        """Take one decision; `action` is [vehicles * a].

        Raises:
            ValueError: if the action has a wrong shape or is not finite.
            ResetNeeded: if the episode ended.
        """
        given = numbers(action, "the action's entries")
        if tuple(given.shape) != self.action_space.shape:
            raise ActionError(f"the action has shape {tuple(given.shape)}, expected {self.action_space.shape}")
        observations, reward, terminated, truncated, infos = self._vector.step(given[None])
        return observations[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first_env(infos)


def _numpy(values: Tensor) -> np.ndarray:
    """Copy a tensor to an array; later steps do not change it."""
    return values.cpu().numpy().copy()


def _rows(observations: Tensor) -> np.ndarray:
    """Observations [env, vehicle, n] as Gymnasium has them, float32 [env, vehicle * n]."""
    return _numpy(observations.flatten(1).to(torch.float32))


def _masked(values: Mapping[str, Tensor], mask: np.ndarray) -> Infos:
    """Gymnasium's infos: values [env, vehicle], 0 where `mask` [env] is false, and a mask for each key."""
    infos: Infos = {}
    for key, value in values.items():
        row = _numpy(value)
        infos[key] = np.where(mask[:, None], row, np.zeros_like(row))
        infos[f"_{key}"] = mask.copy()
    return infos


def _final(rows: np.ndarray, told: Mapping[str, Tensor], ended: np.ndarray) -> Infos:
    """Last observation and info of the environments that `ended`, before they began anew."""
    final_obs = np.full(len(rows), None, dtype=object)
    for env in ended.nonzero()[0]:
        final_obs[env] = rows[env].copy()
    masks = {"_final_obs": ended.copy(), "_final_info": ended.copy()}
    return {"final_obs": final_obs, "final_info": _masked(told, ended)} | masks


def _first_env(infos: Infos) -> Infos:
    return {key: value[0] for key, value in infos.items() if isinstance(value, np.ndarray) and key[0] != "_"}
