"""Cases that time each vehicle model alone: its kernel over many environments, without a mission."""

import math
from pathlib import Path
from typing import Any

import torch

from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, WorldConfig
from taichi_sim.config.io import read_toml
from taichi_sim.models.catalogue import find_model, load_vehicle, shipped_vehicles
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.vehicle import DEFAULT_STEP, Vehicle
from tools.benchmarking.timing import Case

COMPONENTS = (16, 32)
COUNT = 3  # vehicles in an environment
SPREAD, HEIGHT = 1000.0, 60.0  # m: half the side of the square of starts; height of aircraft
AIR = AirConfig(speed=7.72, turbulence="dryden")  # 15 kt; models without wind are not slowed
SEED = 7


def panel_count(model: Vehicle) -> int | None:
    """Panels of the hull, or None if the model has none."""
    return model.panels if isinstance(model, Hull6Dof) else None


OTHER = {"memory": "constant", "constant": "memory"}  # the other kind of radiation, for hulls with a database


def measured_vehicles(quick: bool) -> list[tuple[Path, int, dict[str, Any]]]:
    """Vehicle files with numbers of wave components and overrides.

    Aircraft are measured in one sea, hulls with a database with radiation memory and with constant radiation. `quick`
    measures one vehicle of each model.
    """
    files = shipped_vehicles()
    kind = {file: find_model(read_toml(file)["model"], file) for file in files}
    if quick:
        files = list({kind[file]: file for file in files}.values())
    seas = {file: COMPONENTS if kind[file].medium == "water" and not quick else COMPONENTS[:1] for file in files}
    measured = []
    for file in files:
        water = read_toml(file).get("hydrodynamics", {})
        both = "database" in water and not quick
        other = {"hydrodynamics": {"radiation": OTHER[water.get("radiation", "constant")]}}
        measured += [(file, n, changes) for n in seas[file] for changes in ({}, *([other] if both else []))]
    return measured


def physics_cases(config: WorldConfig, num_envs: int, quick: bool) -> list[tuple[Case, dict]]:
    """A case and its description for each of `measured_vehicles`, in the sea of `config`."""
    return [_case(config, *vehicle, num_envs) for vehicle in measured_vehicles(quick)]


def _case(
    config: WorldConfig, file: Path, components: int, changes: dict[str, Any], num_envs: int
) -> tuple[Case, dict]:
    substeps = round(config.decision_interval / (config.dt or DEFAULT_STEP))
    model = load_vehicle(file, config.decision_interval / substeps, substeps, **changes)
    name = f"{file.stem}, {changes['hydrodynamics']['radiation']}" if changes else file.stem
    sea = config.sea.model_copy(update={"components": components})
    bench = Bench(model, sea=sea, air=AIR, envs=num_envs, count=COUNT, seed=SEED, name=file.stem)
    _spread(bench)
    memory = [(tensor, tensor.clone()) for tensor in (bench.state, bench.aux, bench.fleet.derived, bench.surface)]

    def begin() -> None:
        for tensor, start in memory:
            tensor.copy_(start)

    def call() -> None:
        model.step(bench.fleet, bench.around)

    work = num_envs * COUNT * substeps
    description = {"vehicle": name, "panels": panel_count(model), "components": components}
    return Case("physics", f"{name}, {components} components", call, work, begin), description


def _spread(bench: Bench) -> None:
    """Place vehicles at random, in trim at cruise or afloat."""
    generator = torch.Generator().manual_seed(SEED)
    where, psi = (torch.rand((*bench.state.shape[:2], n), generator=generator) for n in (3, 1))
    position = SPREAD * (2 * where - 1)
    position[..., 2] = -HEIGHT if bench.model.medium == "air" else 0.0
    euler = torch.nn.functional.pad(2 * math.pi * psi, (2, 0))
    bench.put(position, euler, (bench.model.limits.speeds[1], 0.0, 0.0), settle=True)
