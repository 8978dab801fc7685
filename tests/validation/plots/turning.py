"""The Otter's turning circle, ours over the table's."""

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.visualisation.plotting import dress, new_figure
from tests.validation.case import Case, Folder
from tests.validation.otter import fly
from tests.validation.otter_numbers import shaft_command
from tests.validation.plots.finer import finer
from tests.validation.plots.style import OTHER, OURS, legend, points
from tests.validation.tables import TableError, read_csv

SHOWN = 30.0  # s
BETWEEN = 5  # points of our lines to a row of the table


def draw(folder: Folder) -> Figure:
    """Track, speed, yaw rate and roll of the first turning_*_converged.csv that starts from rest."""
    found = sorted(folder.root.rglob("turning_n*_converged.csv"))
    if not found:
        raise TableError("no turning_n*_converged.csv")
    path = found[0]
    table = read_csv(path)
    table = table.where(table["t"] <= SHOWN)
    fine = finer(table, BETWEEN)
    ours = fly(Case(folder, path, "f64"), fine)
    left, right = shaft_command(path.stem) or (0.0, 0.0)
    figure = new_figure(11.0, 5.2, f"Otter: turning circle from rest, shafts at {left:g} and {right:g} rad/s")
    grid = figure.add_gridspec(3, 2, width_ratios=(1.15, 1))
    track = figure.add_subplot(grid[:, 0])
    some = slice(None, None, max(1, len(table) // 30))
    track.plot(ours["y"], ours["x"], color=OURS, lw=2, label="this package")
    points(track, table["y"][some], table["x"][some], OTHER, "reference, converged")
    dress(track, "Track", "east (m)", "north (m)")
    track.set_aspect("equal", adjustable="datalim")
    legend(track, loc="center")
    series = (
        ("Speed", "m/s", lambda v: np.hypot(v["u"], v["v"])),
        ("Yaw rate", "deg/s", lambda v: np.rad2deg(v["r"])),
        ("Roll", "deg", lambda v: np.rad2deg(v["phi"])),
    )
    t, shared = table["t"], None
    for row, (title, unit, value) in enumerate(series):
        axes = shared = figure.add_subplot(grid[row, 1], sharex=shared)
        axes.plot(fine["t"], value(ours), color=OURS, lw=2)
        points(axes, t[some], value(table)[some], OTHER, clip=False)
        dress(axes, title, "time (s)" if row == 2 else "", unit)
        axes.tick_params(labelbottom=row == 2)
        axes.set_xlim(0, t[-1])
    return figure
