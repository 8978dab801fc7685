"""Vehicle file of a hull that was given as a mesh."""

import numpy as np

from taichi_sim.hydro.hull import FloatingHull
from taichi_sim.hydro.surface import WettedSurface
from taichi_sim.usv.hull.database import SUFFIX, HydroDatabase

VISCOUS = (0.02, 0.1, 0.0, 0.03, 0.0, 0.02)  # viscous damping over 2 x mass x resonance; assumed
LEVEL = [0, 1, 5]  # surge, sway, yaw have no stiffness; slow motions radiate nothing


def vehicle_text(
    craft: FloatingHull, surface: WettedSurface, found: HydroDatabase, resonance: float, command: str
) -> str:
    """Return the TOML: hull by offsets, rigid body as given, radiation from the database in the same folder.

    It also has constant added mass and, in heave, roll and pitch, constant damping at `resonance` (rad/s). They are
    used in addition, or with `radiation = "constant"`.
    """
    assert craft.shape is not None
    whole = surface.whole.reshape(-1, 3)
    length, beam, draft = np.ptp(whole[:, 0]), np.ptp(whole[:, 1]), -whole[:, 2].min()
    freeboard = -craft.shape.points[0, -1, 2]
    at = int(np.abs(found.omega - resonance).argmin())
    added = np.maximum(np.diag(found.added_mass[at]), 0.0)
    linear = np.maximum(np.diag(found.damping[at]), 0.0)
    linear[LEVEL] = 0.0
    viscous = np.array(VISCOUS) * 2 * (np.diag(craft.M) + added) * resonance
    gyration = np.sqrt((np.diag(craft.M)[3:] - _moved(craft)) / craft.mass)
    rows = "\n".join(
        f"  [{x:g}, [{', '.join(f'[{y:g}, {z:g}]' for y, z in section)}]]," for x, section in craft.shape.stations
    )
    return f'''# {craft.name}: made of a mesh by
#   {command}
# Added mass and damping below are those of its hydrodynamic database at {found.omega[at]:.3g} rad/s, with assumed
# viscous shares; put in measured ones where you have them. To drive it, add a section [thrusters] or [actuators.NAME]
# (docs/thrusters.md).
model = "hull_6dof"
length = {length:.6g}
beam = {beam:.6g}
height = {draft + freeboard:.6g}                # m, keel to deck
collision_radius = {np.hypot(length, beam) / 2:.6g}  # m, half the diagonal
restoring = "panels"

[rigid_body]
mass = {craft.mass:.9g}  # kg
cg = {_row(craft.cg)}  # m
gyration = {_row(gyration)}  # m

[hydrodynamics]
radiation = "memory"
database = "{craft.name}{SUFFIX}"
added_mass = {_row(added)}
linear = {_row(linear + viscous)}

# x, then y, z (down) from the keel to the deck edge, m
[hull]
shape = "stations"
stations = [
{rows}
]
'''


def _row(values) -> str:
    return "[" + ", ".join(f"{float(v):.6g}" if v else "0.0" for v in values).replace("e+", "e") + "]"


def _moved(craft: FloatingHull) -> np.ndarray:
    """Moments of inertia due to the distance of the CG from CO, kg m^2."""
    x, y, z = craft.cg
    return craft.mass * np.array([y * y + z * z, x * x + z * z, x * x + y * y])
