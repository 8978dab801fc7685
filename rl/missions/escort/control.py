"""Classical controllers of the escort's teams, for vehicles that bring none of their own."""

from typing import Any

from rl.guidance.controllers import CONTROLLERS
from rl.missions.escort.boats import EscortBoats
from rl.missions.escort.orbit import OrbitController
from taichi_sim.config.io import validate
from taichi_sim.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF


def controller_of(team: Any) -> Any:
    """The controller of formations for boats, the orbit (orbit.py) for aircraft; None if there is none for the vehicle.

    Raises:
        ConfigError: if [TEAM.control] has a number that the controller lacks.
    """
    model = team.fleet.model
    if isinstance(team, EscortBoats):
        kind = next((CONTROLLERS[base] for base in type(model).__mro__ if base in CONTROLLERS), None)
    else:
        kind = OrbitController if isinstance(model, FixedWing6DOF) else None
    if kind is None:
        return None
    return kind(model, validate(kind.Gains, dict(team.section.control), f"{team.name}.control"))
