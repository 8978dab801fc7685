"""Gymnasium's view of one team, `taichi_sim/UsvFormation-v0` and others (registered in taichi_sim/__init__.py).

The vehicles of the team are stacked in one action and one observation, vehicle 0 (the leader) first:

    action       float32 [vehicles * a] in [-1, 1]; clipped to that range; refused if not finite
    observation  float32 [vehicles * n], unbounded but of order one: the mission's terms, named in order by
                 task.teams[team].observation_names
    reward       mean over the team's vehicles
    terminated   an ending of a vehicle of the team
    truncated    time is up, or the other team's mission ended: nothing that the action could have prevented

    info         each [vehicles]; of many environments [num_envs, vehicles], with a mask `_KEY` [num_envs]
      distance                        m, from the slot (the leader's: from the target), now
      reward_vehicle                  of this step
      collided, lost, ...             why vehicles ended in this step: the mission's endings and the vehicle's

`gymnasium.make_vec` gives `TeamVectorEnv`, all environments in one simulation; `gymnasium.make` gives
`TeamEnv`. Both end their episodes themselves (`episode_duration`), so no TimeLimit is registered.
"""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import logger
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from rl.adapters.other_teams import policy_of_other
from rl.adapters.render import MODES, Pictures, frames_per_second
from rl.mission import Mission, Step
from rl.missions import load_scenario, make_mission
from taichi_sim.config.io import find_config


class TeamVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """One team in `num_envs` environments that step together.

    An environment whose episode ended begins anew in the same step (`AutoresetMode.SAME_STEP`; the last
    observation and info are then in `infos["final_obs"]` and `infos["final_info"]`), in the next step, whose
    action is ignored there (`NEXT_STEP`), or when `reset(options={"reset_mask": ...})` says so (`DISABLED`).

    Worlds (tracks, obstacles, seas, starts) are made from the constructor's seed; `reset(seed=...)` fixes
    which of them later episodes get. The same two seeds, `num_envs` and actions give the same bits.

    Attributes:
        task: the simulated mission.
    """

    metadata: dict[str, Any] = {
        "render_modes": MODES, "render_fps": 10, "autoreset_mode": AutoresetMode.SAME_STEP
    }  # fmt: skip

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
    ):
        """Build the mission of `team`, one of the scenario's.

        Args:
            team: the one that acts. num_envs: environments.
            scenario: a TOML file or a shipped name. overrides: KEY=VALUE each.
            seed: of the worlds; default the scenario's.
            other: what the other team does: "absent" (not simulated), "constant" (every command 0),
                "classical", or the path of a run folder or of a checkpoint in one, whose frozen policy acts.
            autoreset_mode: see the class.
            render_mode: None, "rgb_array" (`render` gives a picture of each environment), or "human" (a window).
            render_size: width and height of each environment's picture, px; default 640x480 of one environment, less
                of many (rl/adapters/render.py).

        Raises:
            ValueError: for a wrong argument; ConfigError, RunError, CheckpointError: for an unusable file.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs} must be at least 1")
        self.num_envs, self.team = num_envs, team
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}

        config, source = load_scenario(scenario, overrides), find_config(scenario)
        commanded = [name for name in config.teams if name not in config.scripted]
        if team not in commanded:
            raise ValueError(f"team = {team!r}: allowed are {', '.join(commanded)}")
        teams = (team,) if other == "absent" else tuple(commanded)
        worlds_seed = config.seed if seed is None else seed
        self.task: Mission = make_mission(config, num_envs, seed=worlds_seed, teams=teams, source=source)
        others = [rival for name, rival in self.task.teams.items() if name != team]
        self._frozen = {rival.name: policy_of_other(other, rival, config) for rival in others}
        self._ended = np.zeros(num_envs, dtype=bool)  # and not yet begun anew

        self.render_mode = render_mode
        self.metadata["render_fps"] = frames_per_second(config.decision_interval)
        self._pictures = None if render_mode is None else Pictures(self.task, render_size, render_mode)

        own = self.task.teams[team]
        self._action_shape = (num_envs, own.fleet.count, len(own.action_names))
        self.single_action_space = Box(-1.0, 1.0, (math.prod(self._action_shape[1:]),), np.float32)
        self.single_observation_space = Box(-np.inf, np.inf, self._observe().shape[1:], np.float32)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin new episodes: everywhere, or where `options["reset_mask"]` (bool [num_envs]) is true.

        Episodes continue one random sequence, the constructor's seed's at first, until `seed` begins another.

        Raises:
            ValueError: for another option or an unusable mask.
        """
        mask = self._reset_mask(options or {})
        super().reset(seed=seed)
        if seed is not None:
            self.task.reseed(seed)
        self._restart(mask)
        self._look()
        return self._observe(), _masked(self._told(), mask)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One decision in every environment; `actions` is [num_envs, vehicles * a].

        Raises:
            ValueError: for a wrong shape or an action that is not finite; nothing has moved then.
            ResetNeeded: where an episode ended, in mode DISABLED.
        """
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            ended = self._ended.nonzero()[0].tolist()
            raise ResetNeeded(f"the episodes of environments {ended} ended: reset them")
        begins = self._ended  # in this step, whatever the action
        joint = {name: policy(self.task.teams[name]) for name, policy in self._frozen.items()}
        joint[self.team] = self.task.teams[self.team].command(self._unstacked(actions, begins))
        step = self.task.step(joint)

        terminated = _numpy(step.endings[self.team].any.any(dim=1)) & ~begins
        truncated = _numpy(step.terminated | step.truncated) & ~terminated & ~begins
        reward = np.where(begins, 0.0, _numpy(step.reward[self.team].mean(dim=1)).astype(np.float64))
        infos = _masked(self._happened(step), ~begins)
        ended = terminated | truncated
        self._ended = ended
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            infos |= self._final(step, ended)
            self._restart(ended)
        else:
            self._restart(begins)
        self._look()
        infos |= _masked(self._told(), np.ones(self.num_envs, dtype=bool))
        return self._observe(), reward, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """In mode "rgb_array" a picture of each environment as it is now, uint8 [high, wide, 3]."""
        if self._pictures is None:
            logger.warn("render() without a render_mode: there is none, so there is nothing to see")
        return self._pictures.draw() if self._pictures is not None and self.render_mode == "rgb_array" else None

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one."""
        if self._pictures is not None:
            self._pictures.close()

    def _look(self) -> None:
        if self._pictures is not None:
            self._pictures.keep()

    # -- episodes --------------------------------------------------------------------------------------------

    def _restart(self, mask: np.ndarray) -> None:
        """Begin new episodes where `mask` is true."""
        self.task.reset(torch.from_numpy(mask.nonzero()[0]).to(self.task.device))
        self._ended = self._ended & ~mask

    def _reset_mask(self, options: dict[str, Any]) -> np.ndarray:
        if unknown := options.keys() - {"reset_mask"}:
            raise ValueError(f"reset options {sorted(unknown)} are unknown: allowed is 'reset_mask'")
        mask = options.get("reset_mask", np.ones(self.num_envs, dtype=bool))
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ValueError(f"reset_mask = {mask!r} must be a bool array of shape ({self.num_envs},)")
        if not mask.any():
            raise ValueError("reset_mask must be true somewhere")
        return mask.copy()

    def _final(self, step: Step, ended: np.ndarray) -> dict[str, Any]:
        """The last observation and info of the environments that `ended`, if any, before they begin anew."""
        if not ended.any():
            return {}
        rows, final_obs = self._observe(), np.full(self.num_envs, None, dtype=object)
        for env in ended.nonzero()[0]:
            final_obs[env] = rows[env].copy()
        final_info = _masked(self._happened(step) | self._told(), ended)
        masks = {"_final_obs": ended.copy(), "_final_info": ended.copy()}
        return {"final_obs": final_obs, "final_info": final_info} | masks

    # -- between torch [env, vehicle, n] and NumPy [env, vehicle * n] --------------------------------------

    def _observe(self) -> np.ndarray:
        return _numpy(self.task.teams[self.team].observe().flatten(1).to(torch.float32))

    def _unstacked(self, actions: np.ndarray, ignored: np.ndarray) -> Tensor:
        """Actions [env, vehicle, a] of stacked ones, 0 in environments to be `ignored`."""
        rows = np.array(actions, dtype=np.float32)
        if rows.shape != self.action_space.shape:
            raise ValueError(f"actions have shape {rows.shape}, expected {self.action_space.shape}")
        rows[ignored] = 0.0
        return torch.from_numpy(rows.reshape(self._action_shape)).to(self.task.device)

    def _happened(self, step: Step) -> dict[str, np.ndarray]:
        ends = {reason: _numpy(flags) for reason, flags in step.endings[self.team].items()}
        return {"reward_vehicle": _numpy(step.reward[self.team])} | ends

    def _told(self) -> dict[str, np.ndarray]:
        return {key: _numpy(value) for key, value in self.task.info(self.task.teams[self.team]).items()}


class TeamEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One team in one environment, without autoreset; options are those of `TeamVectorEnv`."""

    metadata: dict[str, Any] = {"render_modes": MODES, "render_fps": 10}

    def __init__(self, team: str, **options: Any):
        """Build the mission of `team`; `options` are scenario, overrides, seed, other, render_mode and render_size."""
        self._vector = TeamVectorEnv(team, 1, autoreset_mode=AutoresetMode.DISABLED, **options)
        self.action_space = self._vector.single_action_space
        self.observation_space = self._vector.single_observation_space
        self.render_mode = self._vector.render_mode
        self.metadata = {**self.metadata, "render_fps": self._vector.metadata["render_fps"]}

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """In mode "rgb_array" a picture as it is now, uint8 [high, wide, 3]."""
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
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin a new episode; see `TeamVectorEnv.reset`."""
        super().reset(seed=seed)
        if options:
            raise ValueError(f"reset options {sorted(options)} are unknown: there are none")
        observations, infos = self._vector.reset(seed=seed)
        return observations[0], _alone(infos)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One decision; `action` is [vehicles * a].

        Raises:
            ValueError: for a wrong shape or an action that is not finite. ResetNeeded: if the episode ended.
        """
        shape = np.shape(action)
        if shape != self.action_space.shape:
            raise ValueError(f"the action has shape {shape}, expected {self.action_space.shape}")
        observations, reward, terminated, truncated, infos = self._vector.step(np.asarray(action)[None])
        return observations[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _alone(infos)


def _numpy(values: Tensor) -> np.ndarray:
    """A copy, which no later step changes."""
    return values.cpu().numpy().copy()


def _masked(values: dict[str, np.ndarray], mask: np.ndarray) -> dict[str, Any]:
    """Gymnasium's infos: values [env, vehicle], 0 where `mask` [env] is false, each beside its mask."""
    infos: dict[str, Any] = {}
    for key, value in values.items():
        infos[key] = np.where(mask[:, None], value, np.zeros_like(value))
        infos[f"_{key}"] = mask.copy()
    return infos


def _alone(infos: dict[str, Any]) -> dict[str, Any]:
    return {key: value[0] for key, value in infos.items() if not key.startswith("_")}
