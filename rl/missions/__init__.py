"""The missions there are, a package each, and how a scenario file becomes one; the contract is rl/mission.py."""

import importlib
import pkgutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rl.mission import Mission
from rl.missions.other_vehicle import fit_other_vehicles
from rl.scenario import Scenario, at_stage
from rl.team import Team
from rl.terms import Door
from taichi_sim.config import ConfigError
from taichi_sim.config.explain_errors import source_of
from taichi_sim.config.files import resolve_files
from taichi_sim.config.io import apply_overrides, find_config, key_of, read_toml, validate, vehicle_file
from taichi_sim.config.plausible import judge
from taichi_sim.config.plugins import is_plugin, load_class
from taichi_sim.errors import named
from taichi_sim.kernels import runtime


def shipped() -> tuple[str, ...]:
    """Names of the missions that come with the package."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__) if module.ispkg))


def find_mission(name: object, beside: Sequence[Path] = ()) -> type[Mission]:
    """The class of a mission: a package of rl/missions by name, or `module:Class`, looked for in `beside` first."""
    if isinstance(name, str) and is_plugin(name):
        return load_class(name, Mission, beside)
    if name not in shipped():
        raise ConfigError(f"{name!r}: allowed are {', '.join(shipped())}, and module:Class of your own")
    return importlib.import_module(f"{__name__}.{name}.mission").MISSION


def load_scenario(path: str | Path = "paper", overrides: Iterable[str] = (), then: Iterable[str] = ()) -> Scenario:
    """A scenario from a TOML file (or the name of a shipped one) and `KEY=VALUE` overrides: its mission's `Config`.

    Overrides in `then` take the place of earlier ones (of another way to size a sea, too).
    """
    file = find_config(path)
    data, overrides, then = read_toml(file), list(overrides), list(then)
    sources = apply_overrides(data, [text for text in overrides + then if key_of(text) == "mission"])
    with named(f"{sources.get('mission', file)}: mission = ", ConfigError):
        kind = find_mission(data.get("mission", Scenario.model_fields["mission"].default), [file.parent])
    fit_other_vehicles(data, overrides + then, file, kind.Config)
    sources = apply_overrides(data, overrides, kind.Config)
    sources |= apply_overrides(data, then, kind.Config)
    resolve_files(data, file, sources)
    for key in data.keys() - kind.Config.model_fields.keys():
        if "vehicle" not in (data[key] if isinstance(data[key], dict) else ()) and (others := _with_key(key)):
            raise ConfigError(
                f"{source_of(key, str(file), sources)}: {key}: unknown key: it belongs to the mission "
                f"{' or '.join(others)}, and this scenario's is {kind.__name__}"
            )
    config = validate(kind.Config, data, str(file), sources)
    judge(config, str(file), sources)
    for name, team in config.teams.items():
        with named(f"{sources.get(f'{name}.vehicle', file)}: {name}.", ConfigError):
            vehicle_file(team, file)
    _check_teams(kind, config, str(file), [file.parent], sources)
    for name, stage in config.stages.items():
        with named(f"{file}: ", ConfigError):
            changed = at_stage(config, name)
        if stage.set:
            judge(changed, f"{file}: stages.{name}.set")
            _check_teams(kind, changed, f"{file}: stages.{name}.set", [file.parent], {})
    return config


def _check_teams(
    kind: type[Mission], config: Scenario, file: str, beside: Sequence[Path], sources: Mapping[str, str]
) -> None:
    """Refuse changes of what the teams of a mission are paid for and observe."""
    kinds = kind.kinds(config)
    for name in config.teams:
        kinds.get(name, Team).check_section(config, Door(file, beside, name, sources), name in kinds)


def _with_key(key: str) -> list[str]:
    """Shipped missions whose scenarios have the key."""
    return [name for name in shipped() if key in find_mission(name).Config.model_fields]


@runtime.own_settings()
def make_mission(
    config: Scenario, num_envs: int, *, seed: int, teams: Sequence[str] | None = None, source: Path | None = None
) -> Mission:
    """The mission of a scenario in `num_envs` environments; arguments as of `Mission`."""
    kind = find_mission(config.mission, [source.parent] if source else [])
    mission = kind(config, num_envs, seed=seed, teams=teams, source=source)
    for team in mission.teams.values():
        team.check()
    return mission
