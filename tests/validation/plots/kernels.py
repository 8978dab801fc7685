"""Damping of shipped databases, and the memories that were fitted to them."""

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.models.usv.hull.database import SUFFIX, HydroDatabase
from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Folder
from tests.validation.plots.style import OTHER, OURS, legend, points
from tests.validation.remembering import vehicle_file
from tests.validation.tables import TableError

HULLS = {"barge": "Barge", "fpso": "FPSO, 200 m", "otter": "Otter: water resonates between its pontoons"}
ROWS = ((2, "heave", "N s/m"), (4, "pitch", "N m s"))
DENSE, BEYOND = 800, 1.15  # frequencies of a line; of the database's highest
LASTS = 6.0  # periods of the mode's resonance, that a kernel is shown


def draw(folder: Folder) -> Figure:
    """Of each hull damping in heave and pitch over frequency, and the kernel of heave over time; needs no table."""
    del folder
    figure = new_figure(13.0, 9.6, "Radiation: boundary elements and the memory fitted to them")
    axes = figure.subplots(len(ROWS) + 1, len(HULLS))
    for column, (name, title) in zip(axes.T, HULLS.items(), strict=True):
        database = HydroDatabase.read(vehicle_file(name).with_suffix(SUFFIX))
        if database.memory is None:
            raise TableError(f"the database of {name} has no memory")
        omega = np.linspace(0, BEYOND * database.omega[-1], DENSE)
        damps = database.memory.damps(omega)
        for axis, (mode, what, unit) in zip(column, ROWS, strict=False):
            points(axis, database.omega, database.damping[:, mode, mode], OTHER, "boundary elements")
            axis.plot(omega, damps[:, mode, mode], color=OURS, lw=2, label=f"memory of {len(database.memory)} masses")
            dress(axis, title if mode == ROWS[0][0] else "", "frequency (rad/s)", f"damping in {what} ({unit})")
            axis.set_xlim(0, omega[-1])
            legend(axis, loc="upper right")
        _kernel(column[-1], database)
    return figure


def _kernel(axis, database: HydroDatabase) -> None:
    """K(t) of heave: of the memory, and the cosine transform of the computed damping as far as it reaches."""
    mode, what, _ = ROWS[0]
    assert database.memory is not None
    resonance = float(database.resonances[0])
    time = np.linspace(0, LASTS * 2 * np.pi / resonance, 400)
    whole = np.concatenate([[0.0], database.omega])
    B = np.concatenate([[0.0], database.damping[:, mode, mode]])
    fine = np.linspace(0, whole[-1], 4000)
    transform = 2 / np.pi * np.trapezoid(np.interp(fine, whole, B) * np.cos(time[:, None] * fine), fine, axis=1)
    axis.plot(time, transform, color=OTHER, lw=3.5, alpha=0.45, label="transform of boundary elements' damping")
    axis.plot(time, database.memory.kernel(time)[:, mode, mode], color=OURS, lw=1.8, label="memory")
    axis.axhline(0, color=INK, lw=0.6)
    dress(axis, "", "time (s)", f"kernel of {what} (N/m)")
    axis.set_xlim(0, time[-1])
    legend(axis, loc="upper right")
