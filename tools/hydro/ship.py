"""The database of a ship that is known by a table of its panels only, to compare with another code's."""

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hydro import mesh_file
from hydro.lids import inner_lid
from hydro.problem import Tank
from hydro.run import Floating, database, require_capytaine, solve_all
from taichi_sim.usv.hull.database import HydroDatabase

Array = NDArray[np.float64]
STEP = 30.0  # deg, of headings


def ship_database(panels: Path, M: Array, C: Array, rho: float, g: float, omega: Array) -> HydroDatabase:
    """On the panels of a CSV, at the given frequencies; M and C [6, 6] about the origin of the panels, z up.

    Raises:
        MissingExtraError: if capytaine is not installed.
    """
    code = require_capytaine()
    surface = mesh_file.checked(mesh_file.read(panels), panels.name, None)
    size = float(np.median(surface.edge))
    tank = Tank(surface, inner_lid(surface, size), np.empty((0, 4, 3)), rho, g, np.inf, 0.0)
    heading = -np.arange(0, 180 + STEP / 2, STEP)
    floating = Floating(M, C)
    *loads, endless = solve_all(tank, floating, [*omega, np.inf], heading, os.cpu_count() or 1)
    return database(tank, floating, loads, endless, omega, heading, hull="", code=code, settings={"mesh": panels.name})
