"""Reading, overriding, and writing configurations, with errors that name file, key, value and what is allowed."""

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ValidationError

from taichi_sim.config import ConfigError, ScenarioConfig, Strict, TeamConfig

Model = TypeVar("Model", bound=Strict)

# Sections whose size is given in one of several ways: an override of one way takes the file's other ways back.
WAYS = {
    "sea": (("hs", "tp"), ("sea_state",), ("wind_speed", "fetch"), ("follows_wind",)),
    "air": (("speed",), ("beaufort",)),
}


def config_folder() -> Path:
    """The shipped configs: beside the packages in a checkout, inside the package when installed."""
    here = Path(__file__).resolve().parent.parent
    beside = here.parent / "configs"
    return beside if (beside / "paper.toml").is_file() else here / "configs"


def find_config(path: str | Path) -> Path:
    """`path` if it is a file; else the shipped scenario of that name ("paper", "configs/paper.toml").

    Raises:
        ConfigError: if there is neither.
    """
    path = Path(path)
    if path.is_file():
        return path
    if path.name and path.parent in (Path("."), Path("configs")):
        shipped = config_folder() / path.with_suffix(".toml").name
        if shipped.is_file():
            return shipped
    names = sorted(p.stem for p in config_folder().glob("*.toml"))
    raise ConfigError(f"{path}: no such configuration file; shipped scenarios: {', '.join(names)}")


def load_scenario(path: str | Path = "paper", overrides: Iterable[str] = ()) -> ScenarioConfig:
    """A scenario from a TOML file (or the name of a shipped one) and `KEY=VALUE` overrides.

    Raises:
        ConfigError: naming file, key, value and what is allowed.
    """
    file = find_config(path)
    data = read_toml(file)
    overrides = list(overrides)
    _take_other_ways_back(data, [text.partition("=")[0].strip() for text in overrides])
    sources = {_override(data, text): f"--set {text}" for text in overrides}
    config = validate(ScenarioConfig, data, str(file), sources)
    for team in ("usv", "uav"):
        try:
            vehicle_file(config.team(team), file)
        except ConfigError as error:
            key = f"{team}.vehicle"
            raise ConfigError(f"{sources.get(key, file)}: {team}.{error}") from None
    return config


def vehicle_file(team: TeamConfig, scenario_file: Path | None = None) -> Path:
    """The TOML of a team's vehicle: a path, or a name in `vehicles/` beside the scenario or as shipped.

    Raises:
        ConfigError: if it is missing, listing what there is.
    """
    name = Path(team.vehicle)
    folders = [scenario_file.parent / "vehicles"] if scenario_file else []
    folders.append(config_folder() / "vehicles")
    beside = [scenario_file.parent / name] if scenario_file else []
    candidates = [*beside, name, *(folder / f"{team.vehicle}.toml" for folder in folders)]
    for file in candidates:
        if file.suffix == ".toml" and file.is_file():
            return file
    known = sorted({p.stem for folder in folders for p in folder.glob("*.toml")})
    raise ConfigError(
        f"vehicle = {team.vehicle!r}: no such vehicle file; known vehicles: {', '.join(known)}, or a path to a .toml"
    )


def read_toml(file: Path) -> dict[str, Any]:
    """The content of a TOML file, or a ConfigError that says where it is malformed."""
    try:
        return tomllib.loads(Path(file).read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{file}: not valid TOML: {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: cannot be read: {error}") from None


def write_toml(model: BaseModel, file: Path) -> None:
    """Write every key of a model, defaults included, as TOML."""
    file.write_text(toml_text(model), encoding="utf-8")


def toml_text(model: BaseModel) -> str:
    """Every key of a model, defaults included, as TOML."""
    return tomli_w.dumps(model.model_dump(mode="json", exclude_none=True))


def validate(model: type[Model], data: dict[str, Any], source: str, sources: Mapping[str, str] | None = None) -> Model:
    """`model` from data; a ConfigError names the source, each wrong key, its value and what is allowed.

    `sources` names another source for single keys ("usv.count"), those that an override has set.
    """
    try:
        return model.model_validate(_with_tuples(data))
    except ValidationError as error:
        lines = []
        for item in error.errors():
            key = ".".join(str(part) for part in item["loc"])
            lines.append(f"{(sources or {}).get(key, source)}: {_explain(item, model)}")
        raise ConfigError("\n".join(lines)) from None


def _with_tuples(value: Any) -> Any:
    """TOML arrays as tuples, which is what strict models take."""
    if isinstance(value, dict):
        return {key: _with_tuples(item) for key, item in value.items()}
    return tuple(_with_tuples(item) for item in value) if isinstance(value, list) else value


def _explain(item: Any, model: type[BaseModel]) -> str:
    key = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        siblings = _keys_at(model, item["loc"][:-1])
        close = difflib.get_close_matches(str(item["loc"][-1]), siblings, n=1)
        hint = f", did you mean {close[0]!r}?" if close else ""
        return f"{key} = {item['input']!r}: unknown key{hint}; allowed here: {', '.join(siblings)}"
    if item["type"] == "missing":
        return f"{key}: missing, and it has no default"
    message = item["msg"].removeprefix("Value error, ")
    if not key or isinstance(item["input"], dict | BaseModel):
        return f"{key}: {message}" if key else message
    return f"{key} = {item['input']!r}: {message[0].lower()}{message[1:]}"


def _keys_at(model: Any, loc: tuple) -> list[str]:
    """Names of the fields where `loc` points, as far as it can be followed."""
    for part in loc:
        field = getattr(model, "model_fields", {}).get(part)
        annotation = field.annotation if field else model
        arguments = [a for a in getattr(annotation, "__args__", ()) if hasattr(a, "model_fields")]
        model = annotation if hasattr(annotation, "model_fields") else (arguments[0] if arguments else annotation)
    return sorted(getattr(model, "model_fields", {}))


def _take_other_ways_back(data: dict[str, Any], keys: list[str]) -> None:
    """Remove from the file's `data` the ways of sizing a section that none of the overridden `keys` belongs to."""
    for section, ways in WAYS.items():
        chosen = [way for way in ways if any(f"{section}.{name}" in keys for name in way)]
        for name in [name for way in ways if chosen and way not in chosen for name in way]:
            if isinstance(data.get(section), dict):
                data[section].pop(name, None)


def _override(data: dict[str, Any], text: str) -> str:
    """Apply one `a.b.c=VALUE` and return the key; VALUE is TOML, or a bare string."""
    key, equals, value = text.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise ConfigError(f"--set {text}: expected KEY=VALUE, for example --set usv.count=5")
    node = data
    for depth, part in enumerate(parts[:-1]):
        node = node.setdefault(part, {})
        if not isinstance(node, dict):
            raise ConfigError(f"--set {text}: {'.'.join(parts[: depth + 1])} is a value, not a section")
    node[parts[-1]] = _parse_value(value.strip())
    return ".".join(parts)


def _parse_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
