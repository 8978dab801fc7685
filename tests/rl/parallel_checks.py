"""What PettingZoo asks of a parallel environment."""

import warnings
from collections.abc import Iterable

import numpy as np
from pettingzoo.test import parallel_api_test, parallel_seed_test

from rl.adapters.pettingzoo import parallel_env


def pettingzoo_accepts(scenario: str, overrides: Iterable[str]) -> None:
    """Its own tests pass without a warning, and the state is in its space."""

    def make():
        return parallel_env(scenario, overrides=overrides)

    env = make()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(env, num_cycles=30)
        parallel_seed_test(make, num_cycles=30)
    observations, infos = env.reset(seed=4)
    assert env.state() in env.state_space
    assert np.isfinite(env.state()).all()
    assert list(observations) == list(infos) == env.agents == env.possible_agents
    assert all(observations[agent] in env.observation_space(agent) for agent in env.agents)
