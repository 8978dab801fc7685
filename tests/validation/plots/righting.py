"""Righting arms: the box against the wall-sided formula, and the shipped hulls."""

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.config.io import validate
from taichi_sim.models.usv.hull.geometry import HullGeometry
from taichi_sim.models.usv.hull.hydrostatic_stability import Hydrostatics
from taichi_sim.models.usv.hull.mesh import mesh
from taichi_sim.models.usv.hull.params import Hull6DofParams
from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.box import box_of
from tests.validation.case import Case, Folder
from tests.validation.hydrostatics import PANELS
from tests.validation.parameters import shipped
from tests.validation.plots.style import OTHER, OURS, THIRD, legend, points
from tests.validation.tables import TableError, read_csv

HULLS = {
    "otter.toml": ("Otter, 80 kg", OURS),
    "wamv.toml": ("WAM-V 16, 211 kg", THIRD),
    "barge.toml": ("box, 4100 kg", OTHER),
}
HEEL_DEG = np.arange(0.0, 181.0)
SMALL_DEG = np.linspace(0.0, 30.0, 61)


def draw(folder: Folder) -> Figure:
    """GZ over heel: up to 30 deg beside gz_wall_sided*.csv, and to 180 deg of the shipped vehicles."""
    found = sorted(folder.root.rglob("gz_wall_sided*.csv"))
    if not found:
        raise TableError("no gz_wall_sided*.csv")
    table, box = read_csv(found[0]), box_of(Case(folder, found[0], "f64"))
    figure = new_figure(11.0, 4.2, "Righting arm GZ, free to heave and trim")
    small, large = figure.subplots(1, 2)
    hull = Hydrostatics(mesh(box.shape(*PANELS)), box.mass, box.cg)
    GM = hull.metacentric_heights[0]
    small.plot(SMALL_DEG, hull.righting_arm(np.deg2rad(SMALL_DEG)), color=OURS, lw=2, label="this package")
    small.plot(SMALL_DEG, GM * np.sin(np.deg2rad(SMALL_DEG)), color="#9AA5B1", lw=1.2, ls="--", label="GM sin φ")
    points(small, table["heel_deg"], table["GZ_m"], OTHER, "wall-sided formula", clip=False)
    dress(small, f"Box {box.length:g} x {box.beam:g} x {box.draft:g} m draft, GM {GM:.3f} m", "heel (deg)", "GZ (m)")
    small.set(xlim=(0, SMALL_DEG[-1]), ylim=(0, None))
    legend(small, loc="upper left")
    for file, (name, colour) in HULLS.items():
        p = validate(Hull6DofParams, shipped(file), file)
        hydrostatics = HullGeometry.of(p.hull, p.rigid_body.mass, p.rigid_body.cg).hydrostatics
        GZ = hydrostatics.righting_arm(np.deg2rad(HEEL_DEG))
        lost = np.rad2deg(hydrostatics.angle_of_vanishing_stability)
        large.plot(HEEL_DEG, GZ, color=colour, lw=2, label=f"{name}: to {lost:.0f}°")
        large.plot([lost], [0.0], "o", color=colour, ms=5)
    large.axhline(0, color=INK, lw=0.8)
    dress(large, "Shipped hulls; dots: stability vanishes", "heel (deg)", "GZ (m)")
    large.set(xlim=(0, 180), xticks=range(0, 181, 30))
    legend(large, loc="upper right")
    return figure
