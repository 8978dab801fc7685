"""The smallest scenario, and what the refusal of a wrong one says."""

from pathlib import Path

import pytest

from rl.missions import load_scenario
from taichi_sim.config import ConfigError

MINIMAL = """
name = "little"
[usv]
vehicle = "unity_boat"
[uav]
vehicle = "unity_aircraft"
"""


def refusal(path: Path | str, *overrides: str) -> str:
    """Return the message of the ConfigError that loading raises."""
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, overrides)
    return str(caught.value)


def assert_says(message: str, *parts: object) -> None:
    """Fail, showing the message, unless every part is in it."""
    missing = [str(part) for part in parts if str(part) not in message]
    assert not missing, f"{missing} not in: {message}"
