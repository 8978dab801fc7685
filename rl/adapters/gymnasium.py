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
from collections.abc import Iterable
from pathlib import Path
from typing import TypedDict, Unpack

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from rl.adapters.batched import policy_of_other
from rl.adapters.render import MODES, Pictures, frames_per_second
from rl.mission import Mission, Step
from rl.missions import load_scenario, make_mission
from taichi_sim.config.arguments import ActionError, checked_action, numbers, whole_number
from taichi_sim.config.io import find_config
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

        Raises:
            ValueError: if an argument is wrong.
            ConfigError, RunError, CheckpointError: if a file cannot be used.
        """
        self.num_envs, self.team = whole_number(num_envs, "num_envs", 1), team
        seed = None if seed is None else whole_number(seed, "seed")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}

        config, source = load_scenario(scenario, overrides), find_config(scenario)
        if max_episode_steps is not None:
            seconds = max_episode_steps * config.decision_interval
            raise ValueError(
                f"max_episode_steps = {max_episode_steps}: episodes end by the scenario's time: give "
                f"overrides=['episode_duration={seconds:g}'], s"
            )
        commanded = [name for name in config.teams if name not in config.scripted]
        if team not in commanded:
            raise ValueError(f"team = {team!r}: allowed are {', '.join(commanded)}")
        teams = (team,) if other == "absent" else tuple(commanded)
        worlds_seed = config.seed if seed is None else seed
        self.task: Mission = make_mission(config, num_envs, seed=worlds_seed, teams=teams, source=source)
        others = [rival for name, rival in self.task.teams.items() if name != team]
        self._frozen = {rival.name: policy_of_other(other, rival, config) for rival in others}
        self._ended = np.zeros(num_envs, dtype=bool)  # ended and not yet reset

        self.render_mode = render_mode
        self.metadata["render_fps"] = frames_per_second(config.decision_interval)
        self._pictures = Pictures(self.task, render_size, render_mode)

        own = self.task.teams[team]
        self._action_shape = (num_envs, own.fleet.count, len(own.action_names))
        self.single_action_space = Box(-1.0, 1.0, (math.prod(self._action_shape[1:]),), np.float32)
        self.single_observation_space = Box(-np.inf, np.inf, self._observe().shape[1:], np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    @runtime.torch_at_rest()
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
        if seed is not None:
            self.task.reseed(seed)
        self._restart(mask)
        self._pictures.keep()
        return self._observe(), _masked(self._info(), mask)

    @runtime.torch_at_rest()
    def step(self, actions: np.ndarray | Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Infos]:
        """Take one decision in every environment; `actions` is [num_envs, vehicles * a].

        Raises:
            ValueError: if an action has a wrong shape or is not finite. Nothing has moved.
            ResetNeeded: if an episode ended and the mode is DISABLED.
            ProgramError: if another Taichi program runs than when the environments were made.
        """
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            ended = self._ended.nonzero()[0].tolist()
            raise ResetNeeded(f"the episodes of environments {ended} ended: reset them")
        begins = self._ended  # these reset in this step and ignore their action
        given = self._unstacked(actions, begins)
        joint = {name: policy(self.task.teams[name]) for name, policy in self._frozen.items()}
        joint[self.team] = self.task.teams[self.team].command(given)
        step = self.task.step(joint)

        terminated = _numpy(step.endings[self.team].any.any(dim=1)) & ~begins
        truncated = _numpy(step.terminated | step.truncated) & ~terminated & ~begins
        reward = np.where(begins, 0.0, _numpy(step.reward[self.team].mean(dim=1)).astype(np.float64))
        infos = _masked(self._step_info(step), ~begins)
        ended = terminated | truncated
        self._ended = ended
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            infos |= self._final(step, ended)
            self._restart(ended)
        else:
            self._restart(begins)
        self._pictures.keep()
        infos |= _masked(self._info(), np.ones(self.num_envs, dtype=bool))
        return self._observe(), reward, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Pictures of all environments, uint8 [height, width, 3]; None unless the mode is "rgb_array"."""
        return self._pictures.render()

    def close_extras(self, **kwargs: object) -> None:
        """Close the window, if there is one."""
        self._pictures.close()

    # -- reset -----------------------------------------------------------------------------------------------

    def _restart(self, mask: np.ndarray) -> None:
        """Begin new episodes where `mask` is true."""
        self.task.reset(torch.from_numpy(mask))
        self._ended = self._ended & ~mask

    def _reset_mask(self, options: Options) -> np.ndarray:
        if unknown := options.keys() - {"reset_mask"}:
            raise ValueError(f"reset options {sorted(unknown)} are unknown: allowed is 'reset_mask'")
        mask = options.get("reset_mask", np.ones(self.num_envs, dtype=bool))
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ValueError(f"reset_mask = {mask!r} must be a bool array of shape ({self.num_envs},)")
        if not mask.any():
            raise ValueError("reset_mask must be true somewhere")
        return mask.copy()

    def _final(self, step: Step, ended: np.ndarray) -> Infos:
        """Last observation and info of the environments that `ended`, before they reset."""
        if not ended.any():
            return {}
        rows, final_obs = self._observe(), np.full(self.num_envs, None, dtype=object)
        for env in ended.nonzero()[0]:
            final_obs[env] = rows[env].copy()
        final_info = _masked(self._step_info(step) | self._info(), ended)
        masks = {"_final_obs": ended.copy(), "_final_info": ended.copy()}
        return {"final_obs": final_obs, "final_info": final_info} | masks

    # -- torch [env, vehicle, n] to NumPy [env, vehicle * n] and back ---------------------------------------

    def _observe(self) -> np.ndarray:
        return _numpy(self.task.teams[self.team].observations().flatten(1).to(torch.float32))

    def _unstacked(self, actions: np.ndarray | Tensor, ignored: np.ndarray) -> Tensor:
        """Check actions and reshape them to [env, vehicle, a], with 0 in environments to be `ignored`."""
        own, rows = self.task.teams[self.team], numbers(actions, "actions")
        if tuple(rows.shape) != self.action_space.shape:
            raise ActionError(f"actions have shape {tuple(rows.shape)}, expected {self.action_space.shape}")
        if ignored.any():
            rows = rows.masked_fill(torch.from_numpy(ignored).to(rows.device).unsqueeze(1), 0)
        shape = self._action_shape
        return checked_action(rows.reshape(shape), self.team, own.action_names, shape[:2], own.action.dtype)

    def _step_info(self, step: Step) -> dict[str, np.ndarray]:
        ends = {reason: _numpy(flags) for reason, flags in step.endings[self.team].items()}
        return {"reward_vehicle": _numpy(step.reward[self.team])} | ends

    def _info(self) -> dict[str, np.ndarray]:
        return {key: _numpy(value) for key, value in self.task.teams[self.team].infos().items()}


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


def _masked(values: dict[str, np.ndarray], mask: np.ndarray) -> Infos:
    """Gymnasium's infos: values [env, vehicle], 0 where `mask` [env] is false, and a mask for each key."""
    infos: Infos = {}
    for key, value in values.items():
        infos[key] = np.where(mask[:, None], value, np.zeros_like(value))
        infos[f"_{key}"] = mask.copy()
    return infos


def _first_env(infos: Infos) -> Infos:
    return {key: value[0] for key, value in infos.items() if isinstance(value, np.ndarray) and key[0] != "_"}
