"""PettingZoo's view of a mission: a parallel environment whose agents are the vehicles (made by rl/adapters/marl.py).

    agents       usv_0 (the leader), usv_1, ..., uav_2: all vehicles of all teams that act
    action       float32 [a] in [-1, 1]; clipped to that range; refused if not finite
    observation  float32 [n], unbounded but of order one
    state        float32 [m]: what a central critic may be told (BatchedEnv.state)
    terminated   an ending of this vehicle
    truncated    the episode is over, but not by an ending of this vehicle
    info         distance, m, from the slot, and why the vehicle ended (collided, ...), as numbers and flags

All agents live as long as the episode, which is over for all at once, when time is up or any vehicle's episode ends.
"""

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium import logger
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Space
from torch import Tensor

from rl.adapters.agents import Agents
from rl.adapters.batched import BatchedEnv
from rl.adapters.render import MODES, Pictures, frames_per_second
from rl.mission import Mission
from taichi_sim.config.extras import MissingExtraError

try:
    from pettingzoo.utils.env import ParallelEnv
except ModuleNotFoundError as error:
    raise MissingExtraError("pettingzoo", "marl") from error


class ParallelMission(ParallelEnv[str, np.ndarray, np.ndarray]):
    """One environment of a mission; see the module.

    Attributes:
        agents: those that are alive: all, or none before the first `reset` and after an episode.
        possible_agents: all. observation_spaces, action_spaces: by agent. state_space: of `state`.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": MODES, "name": "taichi_sim", "is_parallelizable": True}

    def __init__(
        self,
        env: BatchedEnv,
        name: str,
        render_mode: str | None = None,
        render_size: tuple[int, int] | None = None,
    ):
        """Adapt `env`, of one environment without autoreset, of the scenario `name`; render.py draws its pictures.

        Raises:
            ValueError: for a render mode or size that cannot be.
        """
        self._env, self._by = env, Agents(env)
        self.render_mode = render_mode
        self._pictures = None if render_mode is None else Pictures(env.mission, render_size, render_mode)
        fps = frames_per_second(env.mission.config.decision_interval)
        self.metadata = {  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]
            **self.metadata, "name": f"taichi_sim/{name}", "render_fps": fps,
        }  # fmt: skip
        self.agents: list[str] = []
        self.possible_agents = self._by.names[:]
        self.observation_spaces, self.action_spaces = dict(self._by.observation_spaces), dict(self._by.action_spaces)
        self.state_space = self._by.state_space

    @property
    def task(self) -> Mission:
        """The simulated mission."""
        return self._env.mission

    def observation_space(self, agent: str) -> Space[np.ndarray]:
        """Of an agent."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space[np.ndarray]:
        """Of an agent."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Begin a new episode: the next of one random sequence, which `seed` begins anew. There are no options."""
        observations = self._env.reset(seed)
        self._look()
        self.agents = self.possible_agents[:]
        told = {team: self.task.info(self.task.teams[team]) for team in self._env.vehicles}
        return self._arrays(observations), self._infos(told)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, np.ndarray], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:  # fmt: skip
        """One decision of every agent.

        Raises:
            ValueError: for an agent too many or too few, a wrong shape, or an action that is not finite; nothing has
                moved then. ResetNeeded: before the first reset, and after an episode.
        """
        if not self.agents:
            raise ResetNeeded("there is no agent: reset begins an episode")
        rows = {name: np.asarray(action, dtype=np.float32)[None] for name, action in actions.items()}
        stepped = self._env.step(self._by.stacked(rows))
        self._look()
        rewards = {name: float(value) for name, value in self._by.split(stepped.rewards).items()}
        terminated = {name: bool(value) for name, value in self._by.split(stepped.terminated).items()}
        truncated = {name: bool(value) for name, value in self._by.split(stepped.truncated).items()}
        if any(terminated.values()) or any(truncated.values()):
            self.agents = []
        return self._arrays(stepped.observations), rewards, terminated, truncated, self._infos(stepped.infos)

    def state(self) -> np.ndarray:
        """What a central critic may be told now."""
        return _array(self._env.state()[0])

    def render(self) -> np.ndarray | None:
        """In mode "rgb_array" a picture as it is now, uint8 [high, wide, 3]."""
        if self._pictures is None:
            logger.warn("render() without a render_mode: there is none, so there is nothing to see")
            return None
        return self._pictures.draw()[0] if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._pictures is not None:
            self._pictures.close()

    def _look(self) -> None:
        if self._pictures is not None:
            self._pictures.keep()

    def _arrays(self, values: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
        return {name: _array(value[0]) for name, value in self._by.split(values).items()}

    def _infos(self, infos: Mapping[str, Mapping[str, Tensor]]) -> dict[str, dict[str, Any]]:
        """By agent: name -> number or flag."""
        by_agent = self._by.split_infos(infos).items()
        return {name: {key: value.item() for key, value in told.items()} for name, told in by_agent}


def _array(values: Tensor) -> np.ndarray:
    """A copy, which no later step changes."""
    return values.cpu().numpy().astype(np.float32)
