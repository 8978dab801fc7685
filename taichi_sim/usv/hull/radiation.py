"""What a hull's own waves do to it: added mass that counts as inertia, memory, and what damping the memory has already.

With `radiation = "constant"` the added mass of the vehicle file is inertia, and damping and added mass on the motion
relative to the water stand for radiation and diffraction. With "memory" the equations of motion (hull_6dof.py) are

    (M_rb + A_inf) nu_dot = tau + tau_FK + tau_D - mu - D_v(nu_r) nu_r - C_rb nu - C_a(nu_r) nu_r

(Cummins 1962; Fossen 2021, sec. 5.4 and 6.3): A_inf and mu (memory.py) are a boundary-element code's radiation, tau_D
its diffraction (diffraction.py), tau_FK the pressure on the panels, nonlinear as before. What slow motion and friction
add is counted beside it: C_a by the file's own added mass; D_v by its damping, of which heave, roll and pitch lose what
radiation takes at their natural frequency, so that nothing is counted twice.

Not modelled: the change of added mass, damping and diffraction with forward speed (zero speed at the frequency of the
waves at rest is used at any speed), and with the depth of the water (one depth a database).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.usv.hull.database import HydroDatabase
from taichi_sim.usv.hull.memory import Memory

Array = NDArray[np.float64]
OSCILLATING = (2, 3, 4)  # heave, roll, pitch: they have a stiffness
ROUNDS = 30  # of the fixed point of a natural frequency


class Radiation(NamedTuple):
    """See the module."""

    inertia: Array  # [6, 6] that adds to M_rb
    counted: Array  # [6] linear damping (N s/m, N m s) that the memory has
    memory: Memory

    @classmethod
    def constant(cls, added_mass: tuple[float, ...]) -> "Radiation":
        """Of a diagonal added mass."""
        return cls(np.diag(added_mass), np.zeros(6), Memory.none())

    @classmethod
    def of(cls, database: HydroDatabase, M_rb: Array, stiffness: Array) -> "Radiation":
        """Of a database, for a hull of M_rb [6, 6] whose stiffness in heave, roll, pitch is [3, 3], about CO.

        Raises:
            ConfigError: if the database has no memory.
        """
        if database.memory is None:
            raise ConfigError("the database has no memory: make it anew with tools/hydrodynamics.py")
        counted, known = np.zeros(6), database.settings.get("resonances")
        for place, mode in enumerate(OSCILLATING):  # known ones are the design's, whatever a vehicle carries
            omega = known[place] if known else None
            omega = omega or natural_frequency(database, mode, M_rb[mode, mode], stiffness[place, place])
            counted[mode] = max(float(database.memory.damps(omega)[0, mode, mode]), 0.0)
        inertia = database.added_mass_inf if database.memory_inf is None else database.memory_inf
        return cls(inertia, counted, database.memory)


def natural_frequency(database: HydroDatabase, mode: int, mass: float, stiffness: float) -> float:
    """omega (rad/s) of omega^2 (mass + A(omega)) = stiffness, of one uncoupled mode."""
    added = database.added_mass[:, mode, mode]
    omega = np.sqrt(stiffness / (mass + added.mean()))
    for _ in range(ROUNDS):
        omega = 0.5 * omega + 0.5 * np.sqrt(stiffness / (mass + np.interp(omega, database.omega, added)))
    return float(omega)
