"""Environments of a phase, written by hand; missions whose vehicles are written."""

import torch

from rl.mission import Mission
from rl.step import GOES_ON, Due
from taichi_sim.kernels.random import Noise


def due(envs: int, which: int = GOES_ON, *, step: int = 0, noise: Noise | None = None) -> Due:
    """All of `envs` environments, `which` of rl/step.py, after `step` decisions of their episodes."""
    draws = (noise or Noise(envs, 0)).table
    return Due(torch.full((envs,), which, dtype=torch.int32), envs, torch.full((envs,), step), draws)


def check_followed(moves: Mission, follows: Mission) -> None:
    """A mission whose vehicles are written, as another one has moved them, observes the same, to rounding."""
    ((name, team),) = moves.teams.items()
    moves.begin_each()
    follows.begin_each()
    moved = {name: fleet.state for name, fleet in moves.world.teams.items()}
    follows.follow(moved)
    moves.measure_anew()
    generator = torch.Generator().manual_seed(4)
    for _ in range(6):
        seen = [mission.teams[name].observations() for mission in (moves, follows)]
        torch.testing.assert_close(seen[1], seen[0], rtol=0.0, atol=1e-5)
        action = {name: 2 * torch.rand(team.fleet.action.shape, generator=generator) - 1}
        moves.drive(action, begin=False)
        follows.follow(moved, action)
    assert int(follows.steps) == 6
