"""skrl's view of a mission: a multi-agent environment whose agents are the vehicles, in thousands of environments.

(`skrl.envs.wrappers.torch.wrap_env` takes the environment of pettingzoo.py as it is: one environment.)
"""

from typing import Any

from torch import Tensor

from rl.adapters.agents import Agents
from rl.adapters.batched import BatchedEnv
from taichi_sim.config.extras import MissingExtraError

try:
    from skrl.envs.wrappers.torch import MultiAgentEnvWrapper
except ModuleNotFoundError as error:
    raise MissingExtraError("skrl", "skrl") from error

ByAgent = dict[str, Tensor]


class SkrlEnv(MultiAgentEnvWrapper):
    """`BatchedEnv` under skrl's names: everything is a dictionary by agent (`usv_0`, ...), observations and actions
    [env, n], rewards and endings [env, 1]. Environments whose episode is over begin anew in the same step.

    Attributes:
        possible_agents, observation_spaces, action_spaces, state_spaces: by agent; all share one state.
    """

    def __init__(self, env: BatchedEnv):
        """Adapt `env`.

        Raises:
            ValueError: if it has no autoreset: skrl's trainers count on it.
        """
        if not env.autoreset:
            raise ValueError("autoreset = False: skrl's trainers count on environments that begin anew by themselves")
        self._by = Agents(env)
        super().__init__(env)

    @property
    def possible_agents(self) -> list[str]:
        """All agents."""
        return self._by.names

    @property
    def agents(self) -> list[str]:
        """The same: an episode is over for all at once, and the next begins."""
        return self._by.names

    @property
    def observation_spaces(self) -> dict[str, Any]:
        """By agent."""
        return self._by.observation_spaces

    @property
    def action_spaces(self) -> dict[str, Any]:
        """By agent."""
        return self._by.action_spaces

    @property
    def state_spaces(self) -> dict[str, Any]:
        """By agent: of the one state."""
        return dict.fromkeys(self._by.names, self._by.state_space)

    def reset(self, seed: int | None = None) -> tuple[ByAgent, dict[str, Any]]:
        """Begin new episodes everywhere; `seed` as of `BatchedEnv.reset`."""
        return self._by.split(self._env.reset(seed)), {}

    def step(self, actions: ByAgent) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, dict[str, Any]]:
        """One decision of every agent: observations, rewards, terminated, truncated, infos by agent."""
        stepped = self._env.step(self._by.stacked(actions))
        rewards, terminated, truncated = (
            {name: value.unsqueeze(1) for name, value in self._by.split(values).items()}
            for values in (stepped.rewards, stepped.terminated, stepped.truncated)
        )
        return self._by.split(stepped.observations), rewards, terminated, truncated, self._by.split_infos(stepped.infos)

    def state(self) -> dict[str, Tensor | None]:
        """What a central critic may be told now."""
        return dict.fromkeys(self._by.names, self._env.state())

    def render(self, *args: Any, **kwargs: Any) -> None:
        """Nothing: there is no rendering."""

    def close(self) -> None:
        """Nothing is held."""
