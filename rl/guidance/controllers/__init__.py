"""Classical controllers that hold slots, by the class of the vehicle model.

Each derives from `SlotController` (avoidance.py). A vehicle's own controller (`Vehicle.controller`) takes precedence.
"""

from collections.abc import Mapping

from rl.guidance.avoidance import SlotController
from rl.guidance.controllers.fixed_wing_6dof import FixedWing6DofController
from rl.guidance.controllers.unity import UnityAircraftController, UnityBoatController
from rl.guidance.controllers.vessel import Hull6DofController, Manoeuvring3dofController
from taichi_sim.config.io import validate
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.models.uav.unity_aircraft import UnityAircraft
from taichi_sim.models.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.models.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.models.usv.unity_boat import UnityBoat
from taichi_sim.vehicle import Vehicle

CONTROLLERS: dict[type[Vehicle], type[SlotController]] = {
    UnityBoat: UnityBoatController,
    Hull6Dof: Hull6DofController,
    Manoeuvring3dof: Manoeuvring3dofController,
    UnityAircraft: UnityAircraftController,
    FixedWing6DOF: FixedWing6DofController,
}


def controller_class(model: Vehicle) -> type[SlotController] | None:
    """The class of the controller of a vehicle's `model`; None if there is none here."""
    return next((CONTROLLERS[base] for base in type(model).__mro__ if base in CONTROLLERS), None)


def controller_of(model: Vehicle, gains: Mapping[str, float], key: str) -> SlotController | None:
    """The controller of a vehicle's `model` with `gains`; None if there is none."""
    kind = controller_class(model)
    return None if kind is None else kind(model, validate(kind.Gains, dict(gains), key))
