"""Files of measurements (spectra, currents and winds over time) that a scenario and its stages name."""

from collections.abc import Mapping
from pathlib import Path

from rl.scenario import Scenario
from taichi_sim.config.files import files_of, named_files, with_files


def measured_files(config: Scenario) -> dict[str, list[Path]]:
    """The files of measurements of a scenario and of its stages: key -> files; a stage's key is stages.X.set.KEY."""
    found = named_files(config)
    for name, stage in config.stages.items():
        found |= {f"stages.{name}.set.{key}": files for key, files in files_of(stage.set).items()}
    return found


def with_measured(config: Scenario, places: Mapping[str, str]) -> Scenario:
    """The same scenario with new paths for files of measurements, by key."""
    stages = {}
    for name, stage in config.stages.items():
        own = {key: places[full] for key in stage.set if (full := f"stages.{name}.set.{key}") in places}
        stages[name] = stage.model_copy(update={"set": stage.set | own})
    return with_files(config.model_copy(update={"stages": stages}), places)
