"""Classical controllers of the escort, for vehicles that have none of their own."""

from rl.guidance.controllers import CONTROLLERS
from rl.missions.escort.aircraft import EscortAircraft
from rl.missions.escort.boats import EscortBoats
from rl.missions.escort.orbit import OrbitController, OrbitGains
from rl.team import Controller
from taichi_sim.config.io import validate
from taichi_sim.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF


def controller_of(team: EscortBoats | EscortAircraft) -> Controller | None:
    """The controller of formations for boats, of the orbit (orbit.py) for aircraft; None if the vehicle has none.

    Raises:
        ConfigError: for unknown gains.
    """
    model = team.fleet.model
    gains, key = dict(team.section.control), f"{team.name}.control"
    if isinstance(team, EscortAircraft):
        flies = isinstance(model, FixedWing6DOF)
        return OrbitController(model, validate(OrbitGains, gains, key)) if flies else None
    kind = next((CONTROLLERS[base] for base in type(model).__mro__ if base in CONTROLLERS), None)
    return None if kind is None else kind(model, validate(kind.Gains, gains, key))
