"""Files that a scenario names besides vehicle files: where they are searched, and which files belong together.

    sea.spectrum                    measured spectra (sea/measured); naming one text file of an NDBC set names them all
    sea.current.series, air.series  current and wind over time (series.py)
    track.file                      waypoints of a formation's track (rl/guidance/course/route.py)

A path is relative to the folder of the scenario's file, or else to the working folder, like those of vehicles, or else
to that of the shipped scenarios. Reading a scenario makes it absolute.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel

from taichi_sim.config.base import ConfigError, Table
from taichi_sim.config.explain_errors import source_of
from taichi_sim.config.sea import is_measured, path_like
from taichi_sim.config.world import WorldConfig

Model = TypeVar("Model", bound=BaseModel)

KEYS = ("sea.spectrum", "sea.current.series", "air.series", "track.file")

# Content of an NDBC file, by the end of its name (last 45 days), or by the letter after the station's name (a year).
KINDS = ("density", "alpha1", "alpha2", "r1", "r2")
ENDINGS = dict(zip((".data_spec", ".swdir", ".swdir2", ".swr1", ".swr2"), KINDS, strict=True))
LETTERS = dict(zip("wdijk", KINDS, strict=True))
OF_A_YEAR = re.compile(r"(\w{5})([wdijk])(\d.*\.txt(?:\.gz)?)")


def config_folder() -> Path:
    """Folder of the shipped configurations: beside the packages in a checkout, inside an installed package."""
    here = Path(__file__).resolve().parent.parent
    beside = here.parent / "configs"
    return beside if (beside / "paper.toml").is_file() else here / "configs"


def ndbc_set(path: Path) -> dict[str, Path]:
    """Existing files of the NDBC set that `path` belongs to, by kind of content; empty if it belongs to none."""
    if path.suffix in ENDINGS:
        members = {kind: path.with_suffix(ending) for ending, kind in ENDINGS.items()}
    elif match := OF_A_YEAR.fullmatch(path.name):
        members = {kind: path.with_name(match[1] + letter + match[3]) for letter, kind in LETTERS.items()}
    else:
        return {}
    return {kind: file for kind, file in members.items() if file.is_file()}


def resolve_files(data: Table, scenario_file: Path, sources: Mapping[str, str]) -> None:
    """Make the paths in a scenario's `data` absolute, those in its stages included."""
    for holder, key, name, shown in _places(data):
        value = holder[name]
        if not isinstance(value, str) or (key == "sea.spectrum" and (not is_measured(value) or not path_like(value))):
            continue
        folders = scenario_file.parent, Path(), config_folder()
        found = next((file for folder in folders if (file := folder / value).is_file()), None)
        if found is None:
            raise ConfigError(
                f"{source_of(shown, str(scenario_file), sources)}: {shown} = {value!r}: no such file, neither beside "
                f"{scenario_file.name} nor in the current folder"
            )
        holder[name] = str(found.resolve())


def named_files(world: WorldConfig) -> dict[str, list[Path]]:
    """Each key that names a file, with the files that belong to it."""
    return files_of({key: reduce(lambda node, name: getattr(node, name, None), key.split("."), world) for key in KEYS})


def files_of(values: Mapping[str, object]) -> dict[str, list[Path]]:
    """Each key that names a file, with its files, from values by full key, as in the `set` of a stage."""
    found: dict[str, list[Path]] = {}
    for key in KEYS:
        value = values.get(key)
        if not isinstance(value, str) or not value or (key == "sea.spectrum" and not is_measured(value)):
            continue
        path = Path(value)
        others = ndbc_set(path).values() if key == "sea.spectrum" else ()
        found[key] = [path, *(file for file in others if file != path)]
    return found


def with_files(world: Model, places: Mapping[str, str]) -> Model:
    """Copy of a world configuration with the given paths, by key."""
    for key in KEYS:
        if key in places:
            world = _with(world, key.split("."), places[key])
    return world


def _with(model: Model, names: Sequence[str], value: str) -> Model:
    own = _with(getattr(model, names[0]), names[1:], value) if names[1:] else value
    return model.model_copy(update={names[0]: own})


def _places(data: Table) -> Iterator[tuple[Table, str, str, str]]:
    """Every path in `data`: its table, key, the key's name in the table, and its name in error messages."""
    stages = data.get("stages")
    sets = {f"stages.{name}.set.": stage.get("set") for name, stage in stages.items() if isinstance(stage, dict)} \
        if isinstance(stages, dict) else {}  # fmt: skip
    for where, table in {"": data, **sets}.items():
        for key in KEYS:
            node, parts = table, key.split(".")
            while isinstance(node, dict) and parts:
                if ".".join(parts) in node:
                    yield node, key, ".".join(parts), where + key
                    break
                node, parts = node.get(parts[0]), parts[1:]
