"""The ship of docs/thrusters.md, as it stands there: it keeps its place and heading, even with a dead bow thruster."""

import re

import pytest
import torch
from folders import ROOT

from taichi_sim.world import World

PAGE = ROOT / "docs" / "thrusters.md"
BLOCK = re.compile(r"^```\w+ file=(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ON, OFF, HURT = range(3)  # environments


@pytest.mark.slow
def test_a_ship_keeps_its_place_and_heading(tmp_path):
    """From 10 m off, in wind, waves and current: within 3 m and 8 degrees from 3 minutes on; uncontrolled it drifts."""
    for name, text in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        (tmp_path / name).write_text(text, encoding="utf-8")
    world = World.from_scenario(tmp_path / "station.toml", 3, ["sea.realisations=3", "sea.components=12"])
    ship, keeper, turned = world.teams["ship"], world.scripts["ship"], torch.zeros(3)
    ship.set_numbers({"actuators.bow_1.gain": [[1.0], [1.0], [0.0]]})
    for step in range(720):
        action = keeper(world)
        action[OFF] = 0.0
        world.step({"ship": action})
        away, heading = ship.position_n[:, 0, :2].norm(dim=-1), ship.euler[:, 0, 2].rad2deg().abs()
        if step > 360:
            assert away[[ON, HURT]].max() < 3.0, step
            turned = torch.maximum(turned, heading)
    assert turned[[ON, HURT]].max() < 8.0
    assert away[OFF] > 30.0
    assert ship.reading("thrust_bow_1")[HURT].abs().max() == 0.0 and ship.reading("thrust_bow_1")[ON].abs().max() > 1e3
