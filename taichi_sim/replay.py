"""Replays the step of a dump (dump.py)."""

from pathlib import Path

import torch

from taichi_sim.dump import Dump
from taichi_sim.world import World


def replay(dump: Dump, source: Path | None = None) -> World:
    """Run the step of a dump again, in a world of one environment; return the world after it.

    `source` is the scenario's file, beside which vehicle files are searched.
    """
    world = World(dump.config, 1, seed=dump.seed, teams=tuple(dump.states), source=source)
    world.env_sea[0], world.time[0] = dump.sea, dump.time
    only = torch.zeros(1, dtype=torch.int64, device=world.env_sea.device)
    world._variation.set_conditions(only, world.env_sea, world.current, world.wind)
    world.around.current[0], world.around.wind[0] = dump.current, dump.wind
    world.noise.keys[0] = dump.env
    world.noise.tick(dump.clock - world.noise.clock)
    for name, fleet in world.teams.items():
        fleet.state[0], fleet.aux[0] = dump.states[name], dump.aux[name]
        if name in dump.vary:
            fleet.set_numbers({key: value.unsqueeze(0) for key, value in dump.vary[name].items()})
        if name in dump.loads:
            fleet.load[0] = dump.loads[name]
        for memory, value in dump.touch.get(name, {}).items():
            assert fleet.touch is not None
            getattr(fleet.touch, memory)[0] = value
        fleet.update()
    world.step({name: action.unsqueeze(0) for name, action in dump.actions.items()})
    return world
