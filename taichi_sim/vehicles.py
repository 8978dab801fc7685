"""The vehicles there are: a TOML names its `model`, and this table knows the module that holds its physics."""

from pathlib import Path
from typing import Any

from taichi_sim.config import ConfigError
from taichi_sim.config.io import read_toml, validate
from taichi_sim.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.uav.unity_aircraft import UnityAircraft
from taichi_sim.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.usv.unity_boat import UnityBoat

# Vehicles of the same numbers share one model, and so one compiled kernel: models hold no state.
_models: dict[tuple, Any] = {}

MODELS = {
    "unity_boat": UnityBoat,
    "manoeuvring_3dof": Manoeuvring3dof,
    "hull_6dof": Hull6Dof,
    "unity_aircraft": UnityAircraft,
    "fixed_wing_6dof": FixedWing6DOF,
}


def load_vehicle(file: Path, team: str, dt: float, substeps: int) -> Any:
    """The model of a vehicle file, ready to step.

    Raises:
        ConfigError: for a missing or unknown model, a wrong key or value, or a vehicle of the other team.
    """
    data = read_toml(file)
    name = data.pop("model", None)
    if not isinstance(name, str) or name not in MODELS:
        raise ConfigError(f"{file}: model = {name!r}: allowed are {', '.join(MODELS)}")
    model = MODELS[name]
    if model.team != team:
        allowed = ", ".join(n for n, m in MODELS.items() if m.team == team)
        raise ConfigError(
            f"{file}: model = {name!r} is a {model.team.upper()} and cannot serve in {team}.vehicle: "
            f"allowed are {allowed}"
        )
    params = validate(model.Params, data, str(file))
    key = (name, params.model_dump_json(), dt, substeps)
    if key not in _models:
        try:
            _models[key] = model(params, dt, substeps)
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}") from None
    return _models[key]
