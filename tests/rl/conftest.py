"""Missions, and commands in this process, shared by the tests of training and task."""

import pytest
from command_line import here, place_of_the_tiny_run, run  # noqa: F401 fixtures
from small_missions import make

from rl.missions.formation.mission import Formation


@pytest.fixture(scope="module")
def shared() -> Formation:
    """Return one task for all tests that begin with `begin`."""
    return make()


@pytest.fixture(scope="module")
def paper() -> Formation:
    """Return a task with the observations and rewards of the paper on a calm sea without obstacles."""
    return make('observations="paper"', 'reward="paper"', "sea.hs=0", "obstacles.count=0")
