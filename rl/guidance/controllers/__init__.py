"""Classical controllers that hold slots, by the class of the vehicle model they are made for.

A controller is a class, built from the model and its `Gains`. It acts by what a team knows (rl/guidance/knowledge.py),
in two steps between which a policy may correct it: `wanted(team)` gives a tuple whose `velocity` is the velocity
command v* [env, vehicle, 2 or 3] (m/s, NED); `act(team, wanted)` gives the actions that follow it. `gains` are those it
was built from. A vehicle may bring a controller of its own (`Vehicle.controller`), which then takes precedence.
"""

from rl.guidance.avoidance import SlotController
from rl.guidance.controllers.fixed_wing_6dof import FixedWing6DofController
from rl.guidance.controllers.hull_6dof import Hull6DofController
from rl.guidance.controllers.manoeuvring_3dof import Manoeuvring3dofController
from rl.guidance.controllers.unity_aircraft import UnityAircraftController
from rl.guidance.controllers.unity_boat import UnityBoatController
from taichi_sim.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.uav.unity_aircraft import UnityAircraft
from taichi_sim.usv.hull.hull_6dof import Hull6Dof
from taichi_sim.usv.manoeuvring_3dof import Manoeuvring3dof
from taichi_sim.usv.unity_boat import UnityBoat
from taichi_sim.vehicle import Vehicle

CONTROLLERS: dict[type[Vehicle], type[SlotController]] = {
    UnityBoat: UnityBoatController,
    Hull6Dof: Hull6DofController,
    Manoeuvring3dof: Manoeuvring3dofController,
    UnityAircraft: UnityAircraftController,
    FixedWing6DOF: FixedWing6DofController,
}
