"""Missions in whose world autopilots drive vehicles (taichi_sim/applications/sitl/lockstep.py), and who drives the
others.
"""

import re
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import torch

from rl.evaluation.episodes import mission_class
from rl.learn.policy import ClassicalPolicy, load_policy
from rl.learn.policy_sources import shipped_policies
from rl.mission import Mission, Policy, Team, VehicleActions
from rl.scenario import PRETRAINED, Scenario, derive_seed
from taichi_sim.applications.sitl.channels import changes_for
from taichi_sim.applications.sitl.lockstep import LockstepWorld
from taichi_sim.config import ConfigError
from taichi_sim.errors import refuse
from taichi_sim.kernels import runtime

Vehicle = tuple[str, int]
"""Team and number."""
PORTS = 1024, 65535  # allowed


def read_autopilots(texts: Sequence[str], config: Scenario) -> dict[Vehicle, int]:
    """Ports of autopilots, by vehicle, from texts TEAM.NUMBER=PORT."""
    found: dict[Vehicle, int] = {}
    for text in texts:
        match = re.fullmatch(r"(\w+)\.(\d+)=(\d+)", text)
        team, number, port = (match[1], int(match[2]), int(match[3])) if match else ("", 0, 0)
        known = team in config.teams and number < config.teams[team].count
        there = ", ".join(f"{name}.0 to {name}.{of.count - 1}" for name, of in config.teams.items())
        twice = (team, number) in found or port in found.values()
        refuse(
            ConfigError,
            (not match, f"--autopilot {text}: expected TEAM.NUMBER=PORT, for example usv.0=9002"),
            (not known, f"--autopilot {text}: there is no such vehicle; there are {there}"),
            (not PORTS[0] <= port <= PORTS[1], f"--autopilot {text}: ports are {PORTS[0]} to {PORTS[1]}"),
            (twice, f"--autopilot {text}: a vehicle has one autopilot, and this a port of its own"),
        )
        found[team, number] = port
    return found


@runtime.own_settings()
def shared_mission(
    config: Scenario, driven: Sequence[Vehicle], *, seed: int, rate: float, source: Path | None = None, envs: int = 1
) -> Mission:
    """A mission at the start of a held-out episode, in whose world (`LockstepWorld`) autopilots drive `driven`; or of
    `envs` such episodes.
    """
    whole = [name for name, of in config.teams.items() if all((name, k) in driven for k in range(of.count))]
    kind = mission_class(config, source)
    shared = type(kind.__name__, (kind,), {"make_world": staticmethod(partial(LockstepWorld, direct=whole, rate=rate))})
    mission: Mission = shared(kind.one_each(config, envs), envs, seed=derive_seed(seed, "evaluation", 0), source=source)
    for name in {name for name, _ in driven if name not in whole}:
        if changes_for(mission.world.teams[name].model):
            raise ConfigError(
                f"{name}: autopilots of aircraft command actuators, and these are actions of a whole team: give each "
                f"of its {config.teams[name].count} an autopilot, or make teams of them"
            )
    mission.begin_each()
    return mission


def decks_for(mission: Mission, driven: Sequence[Vehicle]) -> dict[Vehicle, Vehicle]:
    """Vessel on whose deck each aircraft with legs of those `driven` begins: each has a deck of its own, in order."""
    teams = mission.world.teams
    legged = [(name, k) for name, k in driven if teams[name].model.legs is not None]
    decks = [
        (name, k)
        for name, fleet in teams.items()
        if fleet.model.deck is not None and fleet.model.legs is None
        for k in range(fleet.count)
    ]
    if not legged or len(legged) > len(decks):
        raise ConfigError(
            f"--on-deck: {len(legged)} aircraft with legs have an autopilot, and there are {len(decks)} decks: each "
            "begins on a deck of its own"
        )
    return dict(zip(legged, decks, strict=False))


def idle(team: Team) -> VehicleActions:
    """A policy of zero actions of the vehicles."""
    return VehicleActions(torch.zeros_like(team.fleet.action))


def others(controller: str, mission: Mission, driven: Sequence[Vehicle]) -> Mapping[str, Policy]:
    """A policy for each team: `controller` is "classical", "zero", "pretrained" (of the package), or a run folder.

    Teams that autopilots drive as a whole have none. A team without a policy there is sailed
    classically.
    """
    found: dict[str, Policy] = {}
    folder = Path(controller)
    shipped = shipped_policies(mission.config.name) if controller == PRETRAINED else {}
    for name, team in mission.teams.items():
        if controller == "zero" or all((name, k) in driven for k in range(team.fleet.count)):
            found[name] = idle
        elif name in shipped:
            found[name] = shipped[name]
        elif controller in ("classical", PRETRAINED) or (not (folder / name).is_dir() and folder.is_dir()):
            found[name] = ClassicalPolicy()
        else:
            found[name] = load_policy(folder, mission.config, name)
    return found
