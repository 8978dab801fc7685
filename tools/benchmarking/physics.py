"""Each vehicle model alone: its kernel over many environments, no mission around it."""

from pathlib import Path

from benchmarking.timing import Case
from rl.missions.formation.mission import FormationTask
from taichi_sim.config import AirConfig, ScenarioConfig
from taichi_sim.config.io import config_folder, read_toml
from taichi_sim.vehicles import MODELS, load_vehicle

COMPONENTS = (16, 32)
MIN_RADIUS = 150.0  # m, of the track: the fastest aircraft turns downwind
AIR = AirConfig(speed=7.72, turbulence="dryden")  # 15 kt; what does not feel it pays nothing


def shipped_vehicles() -> list[Path]:
    """The vehicle files, by name."""
    return sorted((config_folder() / "vehicles").glob("*.toml"))


def panel_count(model) -> int | None:
    """Panels of the hull, or None if the model has none."""
    panels = getattr(model, "panels", getattr(model.params, "panels", None))
    return panels if panels is None or isinstance(panels, int) else len(panels)


def measured_vehicles(quick: bool) -> list[tuple[Path, int]]:
    """Vehicle files and numbers of wave components to measure: an aircraft in one sea, `quick` one vehicle a model."""
    files = shipped_vehicles()
    model = {file: read_toml(file)["model"] for file in files}
    if quick:
        files = list({model[file]: file for file in files}.values())
    return [
        (file, components)
        for file in files
        for components in (COMPONENTS if MODELS[model[file]].team == "usv" and not quick else COMPONENTS[:1])
    ]


def physics_cases(config: ScenarioConfig, num_envs: int, quick: bool) -> list[tuple[Case, dict]]:
    """A case and its description for each of `measured_vehicles`."""
    return [_case(config, file, components, num_envs) for file, components in measured_vehicles(quick)]


def _case(config: ScenarioConfig, file: Path, components: int, num_envs: int) -> tuple[Case, dict]:
    name = MODELS[read_toml(file)["model"]].team
    section = config.team(name).model_copy(update={"vehicle": str(file)})
    sea = config.sea.model_copy(update={"components": components})
    model = load_vehicle(file, name, config.dt, config.substeps)
    cruise = getattr(model, "speed_range", (0.0, config.track.target_speed, 0.0))[1]
    track = {"target_speed": cruise, "speed_over": "air" if name == "uav" else "ground", "min_radius": MIN_RADIUS}
    changes = {name: section, "sea": sea, "track": config.track.model_copy(update=track), "air": AIR}
    task = FormationTask(config.model_copy(update=changes), num_envs, seed=config.seed, teams=(name,))
    world, team = task.world, task.world.teams[name]
    action = team.state.new_zeros(task.teams[name].action.shape)
    memory = [(t, t.clone()) for t in (team.state, team.aux, team.derived, team.surface)]
    world.sea.phases(world.env_sea, world.time, out=world.around.phase)

    def begin() -> None:
        for tensor, start in memory:
            tensor.copy_(start)

    def call() -> None:
        team.model.step(team, action, world.around)

    work = num_envs * section.count * config.substeps
    description = {"vehicle": file.stem, "panels": panel_count(team.model), "components": components}
    return Case("physics", f"{file.stem}, {components} components", call, work, begin), description
