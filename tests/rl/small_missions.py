"""Small missions, and how tests begin, drive and copy them."""

import math

import torch
from torch import Tensor

from rl.mission import Step
from rl.missions import load_scenario
from rl.missions.formation.mission import Formation
from taichi_sim.kernels.rotation import torch_quaternion_from_euler

TEAMS = ("usv", "uav")
SMALL = ("track.worlds=4", "sea.realisations=4")
AXES = {"usv": 2, "uav": 3}

# distance and direction, twice; 2 obstacles of (closeness, direction, width, velocity); mates of (closeness, direction)
PAPER_SIZE = {"usv": 2 * 3 + 2 * 6 + 2 * 3, "uav": 2 * 4 + 2 * 7 + 2 * 4}
NORTH, EAST, SOUTH = 0.0, math.pi / 2, math.pi


def make(*overrides: str, envs: int = 4, seed: int = 1, teams: tuple[str, ...] = TEAMS) -> Formation:
    return Formation(load_scenario("paper", (*SMALL, *overrides)), envs, seed=seed, teams=teams)


def begin(task: Formation, seed: int = 5) -> Formation:
    """Begin an episode in every environment, the same for the same seed."""
    task.reseed(seed)
    task.reset()
    return task


def shapes(task: Formation) -> dict[str, tuple[int, ...]]:
    return {n: (task.num_envs, t.section.count, len(t.action_names)) for n, t in task.teams.items()}


def observed(task: Formation) -> dict[str, Tensor]:
    """Observations [env, vehicle, n] of each team."""
    return {name: team.observations() for name, team in task.teams.items()}


def still(task: Formation) -> dict[str, Tensor]:
    return {name: torch.zeros(shape) for name, shape in shapes(task).items()}


def wander(task: Formation, steps: int, seed: int = 0, size: float = 1.0) -> Step:
    """Step with random actions; return the last step."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        actions = {n: size * (2 * torch.rand(s, generator=generator) - 1) for n, s in shapes(task).items()}
        step = task.step(actions, begin=False)
    return step


def state(task: Formation, name: str) -> Tensor:
    return task.teams[name].fleet.state


def only(task: Formation, env: int, vehicle: int) -> Tensor:
    flags = torch.zeros((task.num_envs, 3), dtype=torch.bool)
    flags[env, vehicle] = True
    return flags


def everything(task: Formation, envs: list[int]) -> dict[str, Tensor]:
    """Copy all that an environment's future and observations depend on."""
    world = task.world
    parts = {
        "time": world.time,
        "sea": world.env_sea,
        "world": task.env_world,
        "progress": task.teams["usv"].targets.progress,
        "steps": task.steps,
    }
    for name, team in task.teams.items():
        parts[f"{name} state"], parts[f"{name} aux"] = team.fleet.state, team.fleet.aux
        parts[f"{name} distance"], parts[f"{name} slot"] = team.distance, team.now.slot
        parts[f"{name} offsets"] = team.slots.table
        parts[f"{name} gap"], parts[f"{name} target"] = team.sensor.gap, team.target.position
        parts[f"{name} observations"] = task.teams[name].observations()
    return {key: part[envs].clone() for key, part in parts.items()}


def past_and_present(rows: Tensor, axes: int) -> tuple[Tensor, Tensor]:
    """Current and previous distance and direction [.., 1 + axes], the first columns."""
    n = 1 + axes
    return rows[..., :n], rows[..., n : 2 * n]


def arrange(
    task: Formation,
    name: str,
    offset: tuple[float, float, float],
    psi: float,
    theta: float = 0.0,
    phi: float = 0.0,
) -> Tensor:
    """Begin with the leader at `offset` (NED, m) from its target and an attitude; return its observation."""
    place = task.tracks.at(torch.zeros(1, dtype=torch.int64), task.starts.progress[0, :1])
    height = 0.0 if name == "usv" else 60.0
    start = task.starts.states[name][0, 0]
    start[:, :3] = torch.tensor([*place.position[0].tolist(), -height]) + torch.tensor(offset)
    start[1:, 0] += torch.tensor([20.0, -20.0])  # followers out of the way
    zero = torch.zeros(3)
    start[:, 3:7] = torch_quaternion_from_euler(zero + phi, zero + theta, zero + psi)
    zeros = torch.zeros(task.num_envs, dtype=torch.int64)
    task.reset(worlds=zeros, starts=zeros)
    return task.teams[name].observations()[0, 0]
