"""Table of our vehicle models, and loading of vehicle files. A vehicle file names its `model` in the table, or gives
`module:Class`.
"""

from pathlib import Path
from typing import Any, TypeAlias

from taichi_sim.config import ConfigError, TeamConfig
from taichi_sim.config.base import Table
from taichi_sim.config.io import config_folder, read_toml, validate, vehicle_file
from taichi_sim.config.plausible import judge
from taichi_sim.config.plugins import is_plugin, load_class
from taichi_sim.errors import named
from taichi_sim.kernels import runtime
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.models.uav.multirotor.multirotor_6dof import Multirotor6DOF
from taichi_sim.models.uav.unity_aircraft import UnityAircraft
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.models.usv.mmg import Mmg3Dof
from taichi_sim.models.usv.steered_ship import SteeredShip
from taichi_sim.models.usv.unity_boat import UnityBoat
from taichi_sim.vehicle import DEFAULT_STEP, LARGEST_STEP, Vehicle

# Vehicles with the same numbers share one model and its compiled kernel, because models hold no state.
_models: dict[tuple, Vehicle] = {}

SHORT_STEP = 1e-3  # s, at which every vehicle is stable; assumed

MODELS: dict[str, type[Vehicle]] = {
    "unity_boat": UnityBoat,
    "manoeuvring_3dof": Manoeuvring3dof,
    "mmg_3dof": Mmg3Dof,
    "hull_6dof": Hull6Dof,
    "steered_ship": SteeredShip,
    "unity_aircraft": UnityAircraft,
    "fixed_wing_6dof": FixedWing6DOF,
    "multirotor_6dof": Multirotor6DOF,
}


Changes: TypeAlias = dict[str, Any]
"""Changed numbers of a vehicle file by key, or sections with their changed keys."""


def find_model(name: object, file: Path, source: Path | None = None) -> type[Vehicle]:
    """Class of the model that a vehicle file names. A user's class is searched beside the file and beside `source`."""
    if isinstance(name, str) and is_plugin(name):
        with named(f"{file}: model = ", ConfigError):
            return load_class(name, Vehicle, [f.parent for f in (file, source) if f is not None])
    if not isinstance(name, str) or name not in MODELS:
        raise ConfigError(f"{file}: model = {name!r}: allowed are {', '.join(MODELS)}, and module:Class of your own")
    return MODELS[name]


def load_vehicle(
    file: str | Path, dt: float = DEFAULT_STEP, substeps: int = 1, *, source: Path | None = None, **changes: Any
) -> Vehicle:
    """Model of a vehicle file (or of a shipped one, by name), ready to step.

    Args:
        file: a path, or a name in configs/vehicles.
        dt: physics step, s.
        substeps: physics steps of a control step.
        source: the scenario's file, beside which a user's model is searched too.
        changes: changed sections or numbers of the file; other numbers of a section stay.
    """
    file = vehicle_file(TeamConfig(vehicle=str(file)))
    data = read_toml(file)
    model = find_model(data.pop("model", None), file, source)
    if changes:
        data = model.following(data, {key: _merged(data.get(key), value) for key, value in changes.items()})
    _resolve_files(data, model.file_keys, file.parent)
    params = validate(model.Params, data, str(file))
    key = (model, params.model_dump_json(), dt, substeps, runtime.current().precision)
    if key not in _models:
        judge(params, str(file))
        try:
            _models[key] = model(params, dt, substeps)
        except ConfigError as error:
            raise type(error)(f"{file}: {error}") from None
    return _models[key]


def describe(file: Path, source: Path | None = None) -> Vehicle:
    """Model of a vehicle file to ask for its size, limits and numbers, not to step.

    Vessels do without Taichi; the trim of aircraft starts it.
    """
    data = read_toml(file)
    model = find_model(data.pop("model", None), file, source)
    _resolve_files(data, model.file_keys, file.parent)
    if model.medium == "air":
        runtime.current()
    return model(validate(model.Params, data, str(file)), SHORT_STEP, 1)


def step_of(file: Path) -> float:
    """Physics step (s) of a vehicle file, its key `dt`, at which its motion errs by 1 % (docs/step.md); DEFAULT_STEP,
    if it has none.
    """
    given = read_toml(file).get("dt", DEFAULT_STEP)
    if not isinstance(given, float) or not 0 < given <= LARGEST_STEP:
        raise ConfigError(f"{file}: dt = {given!r}: must be a number above 0, at most {LARGEST_STEP:g} s")
    return given


def _merged(old: object, new: Any) -> Any:
    """`new`, or a table `old` with the keys of the table `new` changed, in its tables too."""
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return new
    return old | {key: _merged(old.get(key), value) for key, value in new.items()}


def vehicle_files(file: Path, source: Path | None = None) -> list[Path]:
    """A vehicle file and the files that it names: everything needed to load it elsewhere."""
    data = read_toml(file)
    found = [file, *_resolve_files(data, find_model(data.get("model"), file, source).file_keys, file.parent)]
    for other in found:
        if not other.is_file():
            raise ConfigError(f"{file}: {other.name!r} is not beside it")
    return found


def _resolve_files(data: Table, keys: tuple[str, ...], folder: Path) -> list[Path]:
    """Turn values of `keys` ("section.key") that name files in a vehicle's folder into full paths; return these."""
    found = []
    for key in keys:
        *sections, last = key.split(".")
        section: object = data
        for name in sections:
            section = section.get(name) if isinstance(section, dict) else None
        if isinstance(section, dict) and isinstance(name := section.get(last), str):
            found.append(folder / name)
            section[last] = str(found[-1])
    return found


def shipped_vehicles() -> list[Path]:
    """Vehicle files that come with the package, sorted by name."""
    return sorted((config_folder() / "vehicles").glob("*.toml"))
