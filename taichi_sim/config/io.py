"""Reading, overriding, and writing configurations, with errors that name file, key, value and what is allowed."""

import contextlib
import math
import os
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ValidationError

from taichi_sim.config.base import ConfigError, Strict, Table
from taichi_sim.config.explain_errors import explain, nearly, source_of
from taichi_sim.config.files import config_folder, resolve_files
from taichi_sim.config.sea import is_measured
from taichi_sim.config.vary import CONDITIONS, FIXED_BY, flattened, with_range
from taichi_sim.config.world import TeamConfig, WorldConfig
from taichi_sim.errors import named

Model = TypeVar("Model", bound=Strict)
DEEPEST = 20  # levels of tables in a file; ours have 5
MEASURED = "sea.record"  # stands for a measured spectrum among the alternatives that define a sea


def find_config(path: str | Path) -> Path:
    """`path` if it is a file, otherwise the shipped scenario of that name ("paper", "configs/paper.toml")."""
    path = Path(path)
    if path.is_file():
        return path
    if path.name and path.parent in (Path("."), Path("configs")):
        shipped = config_folder() / path.with_suffix(".toml").name
        if shipped.is_file():
            return shipped
    names = sorted(p.stem for p in config_folder().glob("*.toml"))
    raise ConfigError(f"{path}: no such configuration file; shipped scenarios: {', '.join(names)}")


def load_world(path: str | Path = "paper", overrides: Iterable[str] = ()) -> WorldConfig:
    """The world of a scenario file (or of a shipped one, by name) with `KEY=VALUE` overrides.

    Keys that do not belong to a world (those of a mission, stages, evaluation) are ignored, unless one looks like a
    misspelling of a key of the world.
    """
    file = find_config(path)
    data, overrides = read_toml(file), list(overrides)
    drop_ranges(data, map(key_of, overrides))
    sources = apply_overrides(data, overrides)
    teams = {key: value for key, value in data.items() if isinstance(value, dict) and nearly("vehicle", value)}
    resolve_files(data, file, sources)
    kept = _known(data, set(WorldConfig.model_fields) | set(teams), str(file), sources)
    for name, team in teams.items():
        kept[name] = _known(team, set(TeamConfig.model_fields), str(file), sources, f"{name}.")
    config = validate(WorldConfig, kept, str(file), sources)
    for name, team in config.teams.items():
        with named(f"{sources.get(f'{name}.vehicle', file)}: {name}.", ConfigError):
            vehicle_file(team, file)
    return config


def _known(data: dict, known: set[str], file: str, sources: Mapping[str, str], section: str = "") -> Table:
    """Entries of `data` whose keys are in `known`."""
    for key in data.keys() - known:
        if close := nearly(key, known):
            raise ConfigError(
                f"{source_of(section + key, file, sources)}: {section}{key} = {data[key]!r}: unknown key, did you mean "
                f"{close!r}?"
            )
    return {key: value for key, value in data.items() if key in known}


def vehicle_file(team: TeamConfig, scenario_file: Path | None = None) -> Path:
    """The vehicle file of a team: a path, or a name in `vehicles/` beside the scenario or among the shipped ones."""
    name = Path(team.vehicle)
    folders = [scenario_file.parent / "vehicles"] if scenario_file else []
    folders.append(config_folder() / "vehicles")
    beside = [scenario_file.parent / name] if scenario_file else []
    candidates = [
        *beside,
        name,
        *(folder / file for folder in folders for file in (team.vehicle, f"{team.vehicle}.toml")),
    ]
    for file in candidates:
        if file.suffix == ".toml" and file.is_file():
            return file
    known = sorted({p.stem for folder in folders for p in folder.glob("*.toml")})
    what = "a scenario, not a vehicle" if (config_folder() / f"{name.stem}.toml").is_file() else "no such vehicle file"
    raise ConfigError(f"vehicle = {team.vehicle!r}: {what}; known vehicles: {', '.join(known)}, or a path to a .toml")


def read_toml(file: Path) -> dict[str, Any]:
    """The content of a TOML file."""
    try:
        if Path(file).exists() and not Path(file).is_file():
            raise ConfigError(f"{file}: cannot be read: not a file")
        content = tomllib.loads(Path(file).read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: cannot be read: {error}") from None
    except (ValueError, RecursionError) as error:  # ValueError: malformed, or a number of thousands of digits
        raise ConfigError(f"{file}: not valid TOML: {error}") from None
    level: list[Any] = [content]
    for _ in range(DEEPEST):
        inside = (part.values() if isinstance(part, dict) else part for part in level)
        level = [value for values in inside for value in values if isinstance(value, dict | list)]
    if level:
        raise ConfigError(f"{file}: tables inside tables go deeper than {DEEPEST}")
    return content


@contextlib.contextmanager
def replacing(file: Path) -> Iterator[Path]:
    """A temporary file beside `file` to write to, which takes its place after the block.

    So a file under its name is complete. After an error the old one stays.
    """
    part = file.with_name(f".{file.stem}.part{file.suffix}")
    file.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield part
        os.replace(part, file)
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def write_toml(model: BaseModel, file: Path) -> None:
    """Write every key of a model, defaults included, as TOML."""
    file.write_text(toml_text(model), encoding="utf-8")


def toml_text(model: BaseModel) -> str:
    """Every key of a model, defaults included, as TOML."""
    return tomli_w.dumps(model.model_dump(mode="json", exclude_none=True))


def validate(model: type[Model], data: Table, source: str, sources: Mapping[str, str] | None = None) -> Model:
    """`model` from `data`. `sources` names another source for single keys ("usv.count"): the override that set it."""
    try:
        return model.model_validate(with_tuples(data))
    except ValidationError as error:
        raise ConfigError(explain(error, model, source, sources or {})) from None


def with_tuples(value: object) -> object:
    """Turn TOML arrays into tuples, as strict models require."""
    if isinstance(value, dict):
        return {key: with_tuples(item) for key, item in value.items()}
    return tuple(with_tuples(item) for item in value) if isinstance(value, list) else value


def apply_overrides(data: Table, overrides: Iterable[str], kind: type[WorldConfig] = WorldConfig) -> dict[str, str]:
    """Apply `KEY=VALUE` overrides to a file's `data` of type `kind`; return each key's source for error messages."""
    values, sources = {}, {}
    for text in [overrides] if isinstance(overrides, str) else overrides:
        key, (_, equals, value) = key_of(text), text.partition("=")
        if not equals or not all(key.split(".")):
            raise ConfigError(f"--set {text}: expected KEY=VALUE, for example --set usv.count=5")
        values[key], sources[key] = parse_value(value.strip()), f"--set {text}"
    set_values(data, values, kind, sources)
    return sources


def set_values(data: Table, values: Mapping[str, object], kind: type[WorldConfig], sources: Mapping[str, str]) -> None:
    """Set dotted keys to `values` in a file's `data` of type `kind`, and remove the keys that they replace.

    `sources` gives the source of each key for error messages.
    """
    keys = list(values)
    if "sea.spectrum" in values and is_measured(values["sea.spectrum"]):
        keys.append(MEASURED)
        _take_variation_back(data, MEASURED)
        if "sea.components" not in keys and isinstance(sea := data.get("sea"), dict):
            sea.pop("components", None)  # they belong to another spectrum
    for section in dict.fromkeys(key.rpartition(".")[0] for key in keys):
        _take_other_ways_back(data, section, keys, kind)
    for section in ("sea", "sea.swell"):
        if f"{section}.hs" in values and f"{section}.tp" not in values:
            _keep_steepness(data, section, values[f"{section}.hs"])
    for key in keys:
        _take_variation_back(data, key)
    for key, value in values.items():
        _set_value(data, key, value, kind, sources[key])


def key_of(override: str) -> str:
    """KEY of an override `KEY=VALUE`, without quotes around its parts."""
    if not isinstance(override, str):
        raise ConfigError(f"override {override!r}: a text KEY=VALUE is expected, as 'sea.hs=1.0'")
    return override.partition("=")[0].strip().replace('"', "")


def _take_other_ways_back(data: Table, section: str, keys: list[str], kind: type[WorldConfig]) -> None:
    """Remove the file's alternatives to what an override gives (its `hs` if `sea_state` is set)."""
    ways, node = kind.ways.get(section.rpartition(".")[2], ()), data
    for part in section.split("."):
        node = node.get(part) if isinstance(node, dict) else None
    chosen = [way for way in ways if any(f"{section}.{name}" in keys for name in way)]
    if not isinstance(node, dict) or not chosen:
        return
    for name in [name for way in ways if way not in chosen for name in way]:
        node.pop(name, None)
    if section == "sea" and "sea.spectrum" not in keys and is_measured(node.get("spectrum")) \
            and not any("record" in way for way in chosen):  # fmt: skip
        del node["spectrum"]


def _keep_steepness(data: Table, section: str, hs: object) -> None:
    """Give the waves of `section` the period with which a new height `hs` (m) has the steepness of the old one.

    Without a period beside the old height, the section's own default follows the new height (`SeaConfig`).
    """
    node: object = data
    for part in section.split("."):
        node = node.get(part) if isinstance(node, dict) else None
    old, tp = (node.get(key) for key in ("hs", "tp")) if isinstance(node, dict) else (None, None)
    given = [x for x in (hs, old, tp) if isinstance(x, int | float) and x > 0]
    if isinstance(node, dict) and len(given) == 3:  # others are judged where they are read
        shortest, longest = CONDITIONS["sea.tp"]
        node["tp"] = min(max(given[2] * math.sqrt(given[0] / given[1]), shortest), longest)


def _take_variation_back(data: Table, key: str) -> None:
    """Remove the range of an overridden condition of sea or air."""
    fixed = {key, *FIXED_BY.get(key, ())}
    if isinstance(ranges := data.get("vary"), dict):
        kept = flattened(ranges).items()
        data["vary"] = {k: v for k, v in kept if k not in fixed and not k.startswith(f"{key}.")}


def drop_ranges(data: Table, keys: Iterable[str]) -> None:
    """Remove `[TEAM.vary]`, of the old vehicle's numbers, of teams that get another one: TEAM.vehicle in `keys`."""
    for team in (key.removesuffix(".vehicle") for key in keys if key.endswith(".vehicle")):
        if isinstance(section := data.get(team), dict) and section.pop("vary", None):
            print(f"{team}.vary: its ranges were of another vehicle, and are dropped", file=sys.stderr)


def _set_value(data: Table, key: str, value: object, kind: type[WorldConfig], source: str) -> None:
    """Set one dotted key."""
    parts, node = key.split("."), data
    for depth, part in enumerate(parts[:-1]):
        if part == "vary" and depth < 2 and isinstance(ranges := node.get("vary", {}), dict):
            node["vary"] = with_range(ranges, ".".join(parts[depth + 1 :]), value)
            return
        inner = node.setdefault(part, {})
        if not isinstance(inner, dict) and part in kind.plain:
            inner = node[part] = {kind.plain[part]: inner}
        if not isinstance(inner, dict):
            raise ConfigError(f"{source}: {'.'.join(parts[: depth + 1])} is a value, not a section")
        node = inner
    node[parts[-1]] = value


def parse_value(text: str) -> object:
    """The value of an override: TOML, or else the text itself."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
