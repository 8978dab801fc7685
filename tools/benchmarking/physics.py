"""Each vehicle model alone: its kernel over many environments, no mission around it."""

import math
from pathlib import Path

import torch

from benchmarking.timing import Case
from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, WorldConfig
from taichi_sim.config.io import read_toml
from taichi_sim.usv.hull.model import HullModel
from taichi_sim.vehicle import Vehicle
from taichi_sim.vehicles import find_model, load_vehicle, shipped_vehicles

COMPONENTS = (16, 32)
COUNT = 3  # vehicles in an environment
SPREAD, HEIGHT = 1000.0, 60.0  # m: half the side of the square where they start, and the height of aircraft
AIR = AirConfig(speed=7.72, turbulence="dryden")  # 15 kt; what does not feel it pays nothing
SEED = 7


def panel_count(model: Vehicle) -> int | None:
    """Panels of the hull, or None if the model has none."""
    return model.panels if isinstance(model, HullModel) else None


def measured_vehicles(quick: bool) -> list[tuple[Path, int]]:
    """Vehicle files and numbers of wave components to measure: an aircraft in one sea, `quick` one vehicle a model."""
    files = shipped_vehicles()
    kind = {file: find_model(read_toml(file)["model"], file) for file in files}
    if quick:
        files = list({kind[file]: file for file in files}.values())
    return [
        (file, components)
        for file in files
        for components in (COMPONENTS if kind[file].medium == "water" and not quick else COMPONENTS[:1])
    ]


def physics_cases(config: WorldConfig, num_envs: int, quick: bool) -> list[tuple[Case, dict]]:
    """A case and its description for each of `measured_vehicles`, in the sea of `config` and at its times."""
    return [_case(config, file, components, num_envs) for file, components in measured_vehicles(quick)]


def _case(config: WorldConfig, file: Path, components: int, num_envs: int) -> tuple[Case, dict]:
    model = load_vehicle(file, config.dt, config.substeps)
    sea = config.sea.model_copy(update={"components": components})
    bench = Bench(model, sea=sea, air=AIR, envs=num_envs, count=COUNT, seed=SEED, name=file.stem)
    _spread(bench)
    memory = [(tensor, tensor.clone()) for tensor in (bench.state, bench.aux, bench.fleet.derived, bench.surface)]

    def begin() -> None:
        for tensor, start in memory:
            tensor.copy_(start)

    def call() -> None:
        model.step(bench.fleet, bench.around)

    work = num_envs * COUNT * config.substeps
    description = {"vehicle": file.stem, "panels": panel_count(model), "components": components}
    return Case("physics", f"{file.stem}, {components} components", call, work, begin), description


def _spread(bench: Bench) -> None:
    """Put vehicles anywhere, in trim at cruise, or afloat."""
    generator = torch.Generator().manual_seed(SEED)
    where, psi = (torch.rand((*bench.state.shape[:2], n), generator=generator) for n in (3, 1))
    position = SPREAD * (2 * where - 1)
    position[..., 2] = -HEIGHT if bench.model.medium == "air" else 0.0
    euler = torch.nn.functional.pad(2 * math.pi * psi, (2, 0))
    bench.put(position, euler, (bench.model.limits.speeds[1], 0.0, 0.0), settle=True)
