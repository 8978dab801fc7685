"""Who steers a team of the escort without a policy, where its vehicle brings nobody."""

from typing import Any

from rl.guidance.controllers import CONTROLLERS
from rl.missions.escort.boats import Boats
from rl.missions.escort.orbit import OrbitController
from taichi_sim.config.io import validate
from taichi_sim.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF


def controller_of(team: Any) -> Any:
    """For boats that of formations, for aircraft the orbit (orbit.py); None where there is none for the vehicle.

    Raises:
        ConfigError: for gains that it does not have.
    """
    model = team.fleet.model
    if isinstance(team, Boats):
        kind = next((CONTROLLERS[base] for base in type(model).__mro__ if base in CONTROLLERS), None)
    else:
        kind = OrbitController if isinstance(model, FixedWing6DOF) else None
    if kind is None:
        return None
    return kind(model, validate(kind.Gains, dict(team.section.control), f"{team.name}.control"))
