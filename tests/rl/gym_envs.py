"""Small Gymnasium environments and what tests do with them."""

from __future__ import annotations

import functools
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import rl.adapters.gymnasium  # noqa: F401  registers the environments

IDS = ("taichi_sim/UsvFormation-v0", "taichi_sim/UavFormation-v0")
MORE = tuple(
    f"taichi_sim/{name}-v0"
    for name in ("OtterUsv", "AerosondeUav", "EscortUsv", "EscortUav", "LandingUav", "StationUsv")
)
SMALL = ("track.worlds=4", "sea.realisations=4", "obstacles.count=4")
SHORT = (*SMALL, "episode_duration=1.0")  # 10 decisions
ESCORT = ("escort.worlds=8", "sea.realisations=4", "sea.components=6", "episode_duration=2.0")  # the same
LANDING = ("sea.realisations=4", "sea.components=6", "episode_duration=1.0")  # 10 decisions
STATION = ("sea.realisations=4", "sea.components=6", "episode_duration=2.0")
REASONS = ("collided", "lost", "left")
both = pytest.mark.parametrize("env_id", IDS)


def short(env_id: str) -> tuple[str, ...]:
    if "Station" in env_id:
        return STATION
    return ESCORT if "Escort" in env_id else LANDING if "Landing" in env_id else SHORT


def make_vec(env_id: str, num_envs: int = 3, overrides=None, **options):
    return gymnasium.make_vec(env_id, num_envs=num_envs, overrides=overrides or short(env_id), **options)


def gymnasium_accepts(env_id: str) -> None:
    """Gymnasium's checker passes, and warns of unbounded observations only."""
    env = gymnasium.make(env_id, overrides=short(env_id))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=True)  # it opens a window: test_render.py draws
    assert len(caught) == 2
    for warning in caught:
        assert "A Box observation space m" in str(warning.message)
        assert "infinity" in str(warning.message)


@functools.cache
def shared(env_id: str):
    """An environment that several tests use, each after a seeded reset: building one compiles its kernels."""
    return make_vec(env_id)


def rollout(env, seed: int | None, steps: int = 14) -> list[np.ndarray]:
    """Observations, rewards and endings of `steps` steps after a reset, under seeded random actions."""
    env.action_space.seed(5)
    history = [env.reset(seed=seed)[0]]
    for _ in range(steps):
        history += env.step(env.action_space.sample())[:4]
    return history


def same(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def place_on_an_obstacle(env, row: int) -> None:
    """Put the leader of one environment of the USV team on its first obstacle."""
    task = env.unwrapped.task
    centre = task.obstacles[task.env_world[row], 0, :2]
    task.teams["usv"].fleet.state[row, 0, :2] = centre
