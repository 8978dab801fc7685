"""Motions of ships in regular waves, run in time, with points of the other code's table."""

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Case, Folder
from tests.validation.plots.style import OTHER, OURS, THIRD, legend, points
from tests.validation.regular import motions
from tests.validation.remembering import hull_of, slowest_decay
from tests.validation.ships import MODES, SHOWN
from tests.validation.tables import TableError, read_csv

CHARTS = ("surge", "heave", "pitch", "sway", "roll", "yaw")
HEADINGS = {180.0: ("head sea", OURS), 120.0: ("bow sea, 60° off", THIRD), 90.0: ("beam sea", OTHER)}
LEGEND = "lines: this package, run in time;  circles: the table"
PERIODS = 40
ABSENT = 1e-3  # of the largest response of the mode: by symmetry there is none
LOGARITHMIC = ("roll",)


def draw(folder: Folder) -> Figure:
    """The first ship's six motions in head, bow and beam seas."""
    found = sorted(path for path in folder.root.rglob("*_rao.csv") if path.parent.name == "ships")
    if not found:
        raise TableError("no ships/*_rao.csv")
    case = Case(folder, found[0], "f64")
    table, name = read_csv(found[0]), found[0].name.removesuffix("_rao.csv")
    model, database = hull_of(case, name)
    shown = [h for h in HEADINGS if (table["heading_deg"] == h).any()]
    roll = 2 * np.pi / float(database.resonances[1])
    period = np.unique(np.concatenate([np.geomspace(*SHOWN, PERIODS), roll * np.linspace(0.94, 1.06, 9)]))
    rows = np.array([(2 * np.pi / t, h) for h in shown for t in period])
    ours = np.abs(motions(model, rows[:, 0], -np.deg2rad(rows[:, 1]), slowest_decay(model, database)))
    figure = new_figure(13.0, 7.6, f"{name.upper()} in regular waves: motion per metre of wave amplitude")
    for chart, mode in zip(figure.subplots(2, 3).flat, CHARTS, strict=True):
        column = MODES.index(mode)
        unit = 1.0 if column < 3 else np.rad2deg(1.0)
        for heading in shown:
            label, colour = HEADINGS[heading]
            there = table.where(table["heading_deg"] == heading)
            if there[f"{mode}_abs"].max() < ABSENT * table[f"{mode}_abs"].max():
                continue
            chart.plot(period, unit * ours[rows[:, 1] == heading, column], color=colour, lw=2, label=label)
            t = 2 * np.pi / there["omega"]
            use = (t >= SHOWN[0]) & (t <= SHOWN[1])
            points(chart, t[use], unit * there[f"{mode}_abs"][use], colour)
        dress(chart, mode.capitalize(), "wave period (s)", "m/m" if column < 3 else "deg/m")
        if mode in LOGARITHMIC:
            chart.set_yscale("log")
        else:
            chart.set_ylim(0)
        chart.set_xlim(*SHOWN)
        legend(chart, loc="best")
    figure.supxlabel(LEGEND, fontsize=9, color=INK)
    return figure
