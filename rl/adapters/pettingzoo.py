"""A mission as a PettingZoo parallel environment whose agents are the vehicles; `parallel_env` makes it.

    agents       usv_0 (the leader), usv_1, ..., uav_2: all vehicles of all teams that act
    action       float32 [a], clipped to [-1, 1]; must be finite
    observation  float32 [n], unbounded but of order one
    state        float32 [m], privileged information for a central critic (BatchedEnv.state)
    terminated   this vehicle's episode ended
    truncated    the episode is over for another reason
    info         distance, m, from the slot, and the reasons why the vehicle ended (collided, ...), as numbers and flags

The episode is over for all agents at once: when its time is up or when any vehicle's episode ends.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Space
from torch import Tensor

from rl.adapters.batched import Agents, BatchedEnv
from rl.adapters.render import MODES, Pictures, frames_per_second
from rl.mission import Mission
from taichi_sim.config.io import find_config
from taichi_sim.errors import needs

with needs("pettingzoo", "marl"):
    from pettingzoo.utils.env import ParallelEnv


class ParallelMission(ParallelEnv[str, np.ndarray, np.ndarray]):
    """One environment of a mission; the module describes the values.

    Attributes:
        agents: all agents during an episode; empty before the first `reset` and after an episode.
        possible_agents: all agents.
        observation_spaces, action_spaces: agent -> space. state_space: of `state`.
    """

    metadata: ClassVar[dict[str, object]] = {"render_modes": MODES, "name": "taichi_sim", "is_parallelizable": True}

    def __init__(
        self, env: BatchedEnv, name: str, render_mode: str | None = None, render_size: tuple[int, int] | None = None
    ):
        """Adapt a `BatchedEnv` of one environment without autoreset.

        Args:
            env: that environment.
            name: name of the scenario.
            render_mode: None, "rgb_array" or "human".
            render_size: width and height of the picture, px.
        """
        self._env, self._vehicles = env, Agents(env)
        self.render_mode = render_mode
        self._pictures = Pictures(env.mission, render_size, render_mode)
        fps = frames_per_second(env.mission.config.decision_interval)
        self.metadata = {  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]
            **self.metadata, "name": f"taichi_sim/{name}", "render_fps": fps,
        }  # fmt: skip
        self.agents: list[str] = []
        self.possible_agents = self._vehicles.names[:]
        self.observation_spaces, self.action_spaces = (
            dict(self._vehicles.observation_spaces),
            dict(self._vehicles.action_spaces),
        )
        self.state_space = self._vehicles.state_space

    @property
    def task(self) -> Mission:
        """The simulated mission."""
        return self._env.mission

    def observation_space(self, agent: str) -> Space[np.ndarray]:
        """The observation space of an agent."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Space[np.ndarray]:
        """The action space of an agent."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, object] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, float | bool]]]:
        """Begin the next episode of one random sequence, which `seed` starts anew. There are no options: any are taken,
        as PettingZoo's own tests ask.
        """
        observations = self._env.reset(seed)
        self._pictures.keep()
        self.agents = self.possible_agents[:]
        return self._arrays(observations), self._infos(self._env.infos())

    def step(
        self, actions: Mapping[str, np.ndarray]
    ) -> tuple[
        dict[str, np.ndarray], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, float | bool]]
    ]:  # fmt: skip
        """Take one decision of every agent.

        Raises:
            ValueError: if an agent is missing or unknown, or an action has a wrong shape or is not finite. Nothing has
                moved.
            ResetNeeded: before the first reset and after an episode.
        """
        if not self.agents:
            raise ResetNeeded("no episode is running: call reset first")
        stepped = self._env.step(self._vehicles.stacked(actions, alone=True))
        self._pictures.keep()
        rewards = {name: float(value) for name, value in self._vehicles.split(stepped.rewards).items()}
        terminated = {name: bool(value) for name, value in self._vehicles.split(stepped.terminated).items()}
        truncated = {name: bool(value) for name, value in self._vehicles.split(stepped.truncated).items()}
        if any(terminated.values()) or any(truncated.values()):
            self.agents = []
        return self._arrays(stepped.observations), rewards, terminated, truncated, self._infos(stepped.infos)

    def state(self) -> np.ndarray:
        """Observations and privileged information for a central critic, float32, one axis."""
        return _array(self._env.state()[0])

    def render(self) -> np.ndarray | None:
        """A picture, uint8 [height, width, 3]; None unless the mode is "rgb_array"."""
        frames = self._pictures.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close the window, if there is one."""
        self._pictures.close()

    def _arrays(self, values: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
        return {name: _array(value[0]) for name, value in self._vehicles.split(values).items()}

    def _infos(self, infos: Mapping[str, Mapping[str, Tensor]]) -> dict[str, dict[str, float | bool]]:
        """Infos by agent: name -> number or flag."""
        by_agent = self._vehicles.split_infos(infos).items()
        return {name: {key: value.item() for key, value in values.items()} for name, values in by_agent}


def parallel_env(
    scenario: str | Path = "escort",
    *,
    teams: str | Sequence[str] | None = None,
    others: Mapping[str, str | Path] | None = None,
    overrides: Iterable[str] = (),
    seed: int | None = None,
    render_mode: str | None = None,
    render_size: tuple[int, int] | None = None,
) -> ParallelMission:
    """A scenario as a PettingZoo parallel environment in which each vehicle that acts is an agent.

    Args:
        scenario: a TOML file or the name of a shipped scenario.
        teams, others: the teams that act and the policies of the others, as for `BatchedEnv`.
        overrides: KEY=VALUE each.
        seed: of the worlds; default the scenario's.
        render_mode: None, "rgb_array" (`render` returns a picture), or "human" (a window).
        render_size: width and height of the picture, px; default 640x480.
    """
    env = BatchedEnv(scenario, 1, teams=teams, others=others, overrides=overrides, seed=seed, autoreset=False)
    return ParallelMission(env, find_config(scenario).stem, render_mode, render_size)


def _array(values: Tensor) -> np.ndarray:
    """Copy a tensor to a float32 array; later steps do not change it."""
    return values.cpu().numpy().astype(np.float32)
