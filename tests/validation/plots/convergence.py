"""How a hydrodynamic database converges: with panels, by runs of the boundary-element code, and with frequencies."""

import os
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from taichi_sim.errors import MissingExtraError
from taichi_sim.kernels.conventions import GRAVITY, RHO_SEA
from taichi_sim.models.usv.hull.database import SUFFIX, HydroDatabase
from taichi_sim.models.usv.hull.radiation import cubic
from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Folder
from tests.validation.plots.style import OTHER, OURS, THIRD
from tests.validation.remembering import vehicle_file
from tests.validation.tables import TableError

HULL = "barge"
PANELS = (75, 150, 300, 600, 1200)  # of a quarter of the hull; the last is what others are compared with
THINNED = (2, 3, 4, 6, 8)  # of the shipped database's frequencies one in so many is kept
BOUND = (0.25, 2.2)  # of the lowest and the highest resonance: frequencies that are compared
MODES = ((2, "heave", OURS), (3, "roll", OTHER), (4, "pitch", THIRD))
HEADINGS = 45.0  # deg, from one to the next
KINDS = {"added_mass": "-", "damping": "--", "excitation": ":"}
WORDS = {"added_mass": "added mass", "damping": "damping", "excitation": "wave load"}


def draw(folder: Folder) -> Figure:
    """Largest errors of added mass, damping and wave loads in heave, roll and pitch; needs capytaine, no table."""
    del folder
    runs = [_computed(count) for count in PANELS]
    counts = [run.settings["panels"] for run in runs]
    figure = new_figure(12.0, 5.4, f"The {HULL}'s database: what more panels and more frequencies change")
    left, right = figure.subplots(1, 2)
    _curves(left, counts[:-1], [_panel_errors(run, runs[-1]) for run in runs[:-1]])
    title = f"Panels, against {counts[-1]}"
    dress(left, title, "panels of a quarter of the hull", "largest difference, of the largest value")
    left.set_xticks(counts[:-1], [str(count) for count in counts[:-1]])
    shipped = HydroDatabase.read(vehicle_file(HULL).with_suffix(SUFFIX))
    kept = [len(shipped.omega[::step]) for step in THINNED]
    _curves(right, kept, [_thinned_errors(shipped, step) for step in THINNED])
    title = f"Frequencies, of {len(shipped.omega)}: between those kept, by cubics"
    dress(right, title, "frequencies kept", "largest difference, of the largest value")
    right.set_xticks(kept, [str(count) for count in kept])
    handles, labels = right.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9, labelcolor=INK)
    return figure


def _curves(axes: Axes, counts: list[int], errors: list[dict[tuple[str, int], float]]) -> None:
    for mode, name, colour in MODES:
        for kind, style in KINDS.items():
            line = [error[kind, mode] for error in errors]
            axes.plot(counts, line, style, color=colour, lw=1.8, marker="o", ms=3.5, label=f"{WORDS[kind]}, {name}")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.minorticks_off()
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:g} %")


def _computed(panels: int) -> HydroDatabase:
    """The boundary-element code's answer on so many panels, at the shipped database's resonances and some more."""
    from taichi_sim.applications.hydro import hull_input, make_database
    from taichi_sim.applications.hydro.frequency_sweep import require_capytaine

    try:
        code = require_capytaine()
    except MissingExtraError as error:
        raise TableError(str(error)) from None
    craft, _ = hull_input.of_vehicle(vehicle_file(HULL))
    shipped = HydroDatabase.read(vehicle_file(HULL).with_suffix(SUFFIX))
    w = np.asarray(shipped.settings["resonances"], dtype=float)
    spectrum = make_database.Spectrum(9, (BOUND[0] * w.min(), BOUND[1] * w.max()), tuple(w), HEADINGS)
    jobs = os.cpu_count() or 1
    wishes = make_database.Wishes(RHO_SEA, GRAVITY, np.inf, panels, 0, None, True, "direct", spectrum, jobs, True)
    with redirect_stdout(StringIO()):
        return make_database.run(make_database.plan(craft, None, wishes), wishes, code, "convergence")


def _panel_errors(run: HydroDatabase, best: HydroDatabase) -> dict[tuple[str, int], float]:
    out = {}
    for mode, _, _ in MODES:
        for kind in KINDS:
            ours, theirs = (_of(data, kind, mode) for data in (run, best))
            out[kind, mode] = float(np.abs(ours - theirs).max() / np.abs(theirs).max())
    return out


def _thinned_errors(database: HydroDatabase, step: int) -> dict[tuple[str, int], float]:
    w = np.asarray(database.settings["resonances"], dtype=float)
    kept = database.omega[::step]
    use = (database.omega >= max(BOUND[0] * w.min(), kept[0])) & (database.omega <= min(BOUND[1] * w.max(), kept[-1]))
    out = {}
    for mode, _, _ in MODES:
        for kind in KINDS:
            values = _of(database, kind, mode)
            between = cubic(kept, values[::step], database.omega[use])
            out[kind, mode] = float(np.abs(between - values[use]).max() / np.abs(values[use]).max())
    return out


def _of(database: HydroDatabase, kind: str, mode: int) -> np.ndarray:
    """[frequency, ...] of a mode."""
    values = np.asarray(getattr(database, kind))
    return values[:, :, mode] if kind == "excitation" else values[:, mode, mode]
