"""Missions, and commands in this process, shared by the tests of training and task."""

import importlib
import os
import shutil
import traceback
from pathlib import Path

import command_line
import pytest
from command_line import Ending, tiny_run
from small_missions import make

from rl.commands import shared as commands
from rl.missions.formation.mission import Formation

PLAIN = ("rl.commands.report", "rl.commands.export")  # commands without the common arguments


@pytest.fixture(scope="session", autouse=True)
def _place_of_the_tiny_run(tmp_path_factory):
    """Put the tiny run where all workers of a session find it."""
    own = tmp_path_factory.getbasetemp()
    command_line.place = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="module")
def shared() -> Formation:
    """Return one task for all tests that begin with `begin`."""
    return make()


@pytest.fixture(scope="module")
def paper() -> Formation:
    """Return a task with the observations and rewards of the paper on a calm sea without obstacles."""
    return make('observations="paper"', 'reward="paper"', "sea.hs=0", "obstacles.count=0")


@pytest.fixture
def here(capsys):
    """Return a function that runs a command in this process: enough for messages."""

    def run(module: str, *arguments: object) -> Ending:
        capsys.readouterr()
        main = importlib.import_module(module).main
        try:
            common = [] if module in PLAIN else ["--quiet", "--threads", "1"]
            status = commands.run(main, [*map(str, arguments), *common])
        except SystemExit as ending:
            status = int(ending.code or 0)
        except Exception:  # what a user would see of it
            status = 1
            traceback.print_exc()
        return Ending(status, *capsys.readouterr())

    return run


@pytest.fixture
def run(tmp_path) -> Path:
    """Return a copy of the tiny run."""
    return Path(shutil.copytree(tiny_run(), tmp_path / "run"))
