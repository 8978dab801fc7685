"""Boats made by the command for hydrodynamics from a mesh, mass and thrusters alone, beside boats whose truth is known.

| boat | mesh | truth |
|---|---|---|
| Otter, WAM-V 16 | the [hull] of the shipped file | the shipped model: published (Otter), assumed by VRX (WAM-V) |
| CyberShip II | an analytic form (`supply_vessel`) | the model identified by Skjetne, Smogeli and Fossen (2004) |
| KVLCC2 of 7 m | the [hull] of the shipped file | the MMG model of Yasukawa and Yoshimura (2015); free-running tests of MARIN |

Both are put through the same trials (taichi_sim/applications/trials). KVLCC2 gets its published propeller and rudder.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from taichi_sim.applications.hydro.hull_input import of_vehicle
from taichi_sim.applications.trials import ship
from taichi_sim.applications.trials.basin import Setting, vessel_of
from taichi_sim.applications.trials.results import Outcome
from taichi_sim.config.io import config_folder
from taichi_sim.models.usv.hull.mesh import Panels, StationsHull, mesh

Array = NDArray[np.float64]
AIM = 0.25  # of each figure
FLIPPED = np.array([1.0, -1.0, -1.0])  # from b to the frame of meshes: y to port, z up
HELM, HEADING = 20.0, 20.0  # deg, of the zigzag

# CyberShip II (Skjetne, Smogeli and Fossen 2004) [S]; the supply vessel of MSS (Fossen; ShipX data) has lines of its kind
LENGTH, BEAM, MASS, X_G = 1.255, 0.29, 23.8, 0.046  # m, m, kg, m: [S]
BLOCK, PRISMATIC, WATERPLANE = 0.651, 0.656, 0.870  # C_B, C_P, C_WP of MSS's supply vessel
FRESH = 1000.0  # kg/m^3, of the basin
STERN_WATERPLANE = 0.97  # C_WP of the after half: a broad stern over the propellers; assumed
FREEBOARD = 0.05  # m, assumed
STATIONS, LEVELS = 41, 11
SHALLOWEST, FULLEST = 0.12, 0.993  # fullness of a section: at the ends, and amidships
SURGE, YAW = 1.0, 0.3  # N, N m, of the trials: those of [S]'s reference turn (docs/trials.md)
STERN, BOW = (-0.5, 0.08), 0.47  # m, places of thrusters; assumed, where the model has its own
UNIT = 1.0  # N, of each


def supply_vessel() -> Panels:
    """A hull with L, B, mass and x_G of CyberShip II, and C_B, C_P, C_WP of MSS's supply vessel.

    Along each half of the length, with s from 0 amidships to 1 at the end, sections have the area 1 - s^p and the
    waterline the half-breadth 1 - s^q of those amidships. Across, the half-breadth is y(z) = b (1 - (z / T)^n), with n
    from the section's fullness n / (n + 1).
    """
    draught = MASS / FRESH / (BLOCK * LENGTH * BEAM)

    def powers(mean: float, fore: float) -> tuple[float, float]:
        """p of the after and the fore half, from their coefficients p / (p + 1)."""
        aft = 2 * mean - fore
        return aft / (1 - aft), fore / (1 - fore)

    def lcb(fore: float) -> float:
        (p_a, p_f) = powers(PRISMATIC, fore)
        moments = [0.5 - 1 / (p + 2) for p in (p_f, p_a)]
        return LENGTH / 2 * (moments[0] - moments[1]) / (2 * PRISMATIC) - X_G

    areas = powers(PRISMATIC, brentq(lcb, PRISMATIC - 0.2, PRISMATIC + 0.2))
    breadths = powers(WATERPLANE, 2 * WATERPLANE - STERN_WATERPLANE)
    x = np.linspace(-1, 1, STATIONS)
    x = np.sign(x) * (1 - (1 - np.abs(x)) ** 1.5) * (1 - 1e-3)  # closer at the ends
    level = np.sin(np.linspace(0, np.pi / 2, LEVELS)) * draught
    rows = []
    for s in x:
        k = int(s > 0)
        breadth = BEAM / 2 * (1 - abs(s) ** breadths[k])
        full = (PRISMATIC / BLOCK) ** -1 * (1 - abs(s) ** areas[k]) / (1 - abs(s) ** breadths[k])
        full = float(np.clip(full, SHALLOWEST, FULLEST))
        y = breadth * (1 - (level[::-1] / draught) ** (full / (1 - full)))
        points = [*zip(y, level[::-1], strict=True), (y[-1], -FREEBOARD)]
        rows.append((float(s * LENGTH / 2), tuple((max(float(b), 0.0), float(z)) for b, z in points)))
    return mesh(StationsHull(stations=tuple(rows)))


def shipped_hull(name: str) -> Callable[[], Panels]:
    """The panels of a shipped vehicle file."""
    return lambda: of_vehicle(config_folder() / "vehicles" / f"{name}.toml")[0].panels


def write_stl(panels: Panels, file: Path) -> None:
    """Write a hull as a text STL (m, x forward, y to port, z up)."""
    lines = ["solid hull"]
    for corners, centre in zip(panels.corners * FLIPPED, panels.centre * FLIPPED, strict=True):
        for one, other in zip(corners, np.roll(corners, -1, axis=0), strict=True):  # alike to port and starboard
            points = "\n".join("      vertex " + " ".join(f"{v:.9g}" for v in point) for point in (one, other, centre))
            lines.append(f"  facet normal 0 0 0\n    outer loop\n{points}\n    endloop\n  endfacet")
    file.write_text("\n".join([*lines, "endsolid hull", ""]), encoding="utf-8")
