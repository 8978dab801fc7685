"""A mission as a multi-agent environment of skrl: the agents are the vehicles, in thousands of environments.

For a single environment, `skrl.envs.wrappers.torch.wrap_env` takes that of pettingzoo.py as it is.
"""

from gymnasium.spaces import Space
from torch import Tensor

from rl.adapters.batched import Agents, BatchedEnv
from taichi_sim.errors import needs

with needs("skrl", "skrl"):
    from skrl.envs.wrappers.torch import MultiAgentEnvWrapper

ByAgent = dict[str, Tensor]
Infos = dict[str, dict[str, Tensor]]


class SkrlEnv(MultiAgentEnvWrapper):
    """`BatchedEnv` as skrl's multi-agent environment.

    Every value is a dictionary by agent (`usv_0`, ...): observations and actions [env, n], rewards and endings
    [env, 1]. Environments whose episode is over reset in the same step.

    Attributes:
        possible_agents, observation_spaces, action_spaces, state_spaces: by agent; all agents share one state.
    """

    def __init__(self, env: BatchedEnv):
        """Adapt `env`."""
        if not env.autoreset:
            raise ValueError("autoreset = False: skrl's trainers need environments that reset by themselves")
        self._vehicles = Agents(env)
        super().__init__(env)

    @property
    def possible_agents(self) -> list[str]:
        """All agents."""
        return self._vehicles.names

    @property
    def agents(self) -> list[str]:
        """All agents: an episode is over for all at once, and the next begins."""
        return self._vehicles.names

    @property
    def observation_spaces(self) -> dict[str, Space]:
        """Agent -> observation space."""
        return dict(self._vehicles.observation_spaces)

    @property
    def action_spaces(self) -> dict[str, Space]:
        """Agent -> action space."""
        return dict(self._vehicles.action_spaces)

    @property
    def state_spaces(self) -> dict[str, Space]:
        """Agent -> the space of the shared state."""
        return {name: self._vehicles.state_space for name in self._vehicles.names}

    def reset(self, seed: int | None = None) -> tuple[ByAgent, Infos]:
        """Begin new episodes in every environment; `seed` as in `BatchedEnv.reset`."""
        return self._vehicles.split(self._env.reset(seed)), {}

    def step(self, actions: ByAgent) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, Infos]:
        """Take one decision of every agent; return observations, rewards, terminated, truncated and infos by agent."""
        stepped = self._env.step(self._vehicles.stacked(actions))
        rewards, terminated, truncated = (
            {name: value.unsqueeze(1) for name, value in self._vehicles.split(values).items()}
            for values in (stepped.rewards, stepped.terminated, stepped.truncated)
        )
        return (
            self._vehicles.split(stepped.observations),
            rewards,
            terminated,
            truncated,
            self._vehicles.split_infos(stepped.infos),
        )

    def state(self) -> dict[str, Tensor | None]:
        """Privileged information for a central critic."""
        return dict.fromkeys(self._vehicles.names, self._env.state())

    def render(self, *args: object, **kwargs: object) -> None:
        """Draw nothing: skrl's environments are not rendered."""

    def close(self) -> None:
        """Do nothing: there is nothing to close."""
