"""Response amplitude operators of the box in regular waves, with points of the boundary-element code: with constant
added mass and damping, and with memory and diffraction.
"""

from collections.abc import Callable

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.surroundings.sea.spectrum import wavenumber
from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Case, Folder
from tests.validation.plots.style import FAINT, OTHER, OURS, THIRD, legend, points
from tests.validation.rao import BARGE, COLUMN, JUDGED, REMEMBERED, is_the_barge, measure, radiation_of
from tests.validation.regular import motions
from tests.validation.remembering import hull_of, slowest_decay
from tests.validation.tables import Table, TableError, read_csv

FREQUENCIES = 30
MARGIN = 0.12  # rad/s, beyond the table
HEADINGS = {180.0: ("head sea", OURS), 135.0: ("bow sea, 45° off", THIRD), 90.0: ("beam sea", OTHER)}
LEGEND = "lines: this package, let go in time;  circles: boundary elements;  grey: beyond the band that is judged"
ROLL_RANGE = (0.02, 100.0)  # rad/rad
SHOWN = {"heave": (180.0, 90.0), "pitch": (180.0, 135.0), "roll": (90.0, 135.0)}


def draw(folder: Folder) -> Figure:
    """Heave in m/m, pitch and roll over the wave's slope, against frequency; constant added mass and damping."""
    case = _case(folder)
    radiation = radiation_of(case)
    title = "A box in regular waves, constant added mass and damping: motion per wave amplitude"
    return _charts(case, lambda omega, heading: measure(radiation, omega, heading), title, (None, JUDGED))


def remembered(folder: Folder) -> Figure:
    """The same charts of the shipped barge, which is the box of the tables, with memory and diffraction."""
    case = _case(folder)
    if not is_the_barge(radiation_of(case)):
        raise TableError(f"{case.path.name} is of another box than the shipped barge")
    model, database = hull_of(case, BARGE)
    slowest = slowest_decay(model, database)
    title = "The barge in regular waves, memory and diffraction of its database: motion per wave amplitude"
    return _charts(case, lambda omega, heading: np.abs(motions(model, omega, heading, slowest)), title, REMEMBERED)


def _case(folder: Folder) -> Case:
    found = sorted(folder.root.rglob("box_*_rao.csv"))
    if not found:
        raise TableError("no box_*_rao.csv")
    return Case(folder, found[0], "f64")


def _charts(
    case: Case, run: Callable[[np.ndarray, np.ndarray], np.ndarray], title: str, judged: tuple[float | None, float]
) -> Figure:
    """Of amplitudes [row, 6] that `run` finds at frequencies and headings (rad) [row]."""
    table, radiation = read_csv(case.path), radiation_of(case)
    omega = np.linspace(table["omega"].min(), table["omega"].max(), FREQUENCIES)
    # denser at the resonances, where curves bend
    omega = np.unique(
        np.concatenate([omega, *(r.omega + np.linspace(-0.24, 0.24, 7) for r in radiation.resonances.values())])
    )
    headings = [h for h in HEADINGS if (table["heading_deg"] == h).any()]
    rows = [(w, h) for h in headings for w in omega]
    ours = run(*(np.array(v) for v in zip(*((w, np.deg2rad(h)) for w, h in rows), strict=True)))
    figure = new_figure(12.5, 4.4, title)
    axes = figure.subplots(1, 3)
    for chart, mode in zip(axes, SHOWN, strict=True):
        w_n = radiation.resonances[mode].omega
        chart.axvspan(judged[1] * w_n, omega[-1] + MARGIN, color=FAINT, zorder=0)
        if judged[0]:
            chart.axvspan(omega[0] - MARGIN, judged[0] * w_n, color=FAINT, zorder=0)
        chart.axvline(w_n, color="#9AA5B1", lw=0.9, ls=":", zorder=1)
        for heading in SHOWN[mode]:
            if heading in headings:
                use = np.array([h == heading for _, h in rows])
                label, colour = HEADINGS[heading]
                line = ours[use, COLUMN[mode]]
                scale = 1.0 if mode == "heave" else wavenumber(omega)
                chart.plot(omega, line / scale, color=colour, lw=2, label=label)
                _table_points(chart, table, mode, heading, colour)
        unit = "heave amplitude / a (m/m)" if mode == "heave" else f"{mode} amplitude / k a (rad/rad)"
        dress(chart, mode.capitalize(), "wave frequency (rad/s)", unit)
        chart.set_xlim(omega[0] - MARGIN, omega[-1] + MARGIN)
        if mode == "roll":  # hardly damped: over two decades
            chart.set_yscale("log")
            chart.set_ylim(*ROLL_RANGE)
        else:
            chart.set_ylim(0)
        chart.text(w_n, 0.02, "resonance ", transform=chart.get_xaxis_transform(), fontsize=8, color=INK, ha="right")
        legend(chart, loc="upper left" if mode == "pitch" else "upper right")
    figure.supxlabel(LEGEND, fontsize=9, color=INK)
    return figure


def _table_points(chart, table: Table, mode: str, heading: float, colour: str) -> None:
    rows = table.where(table["heading_deg"] == heading)
    scale = 1.0 if mode == "heave" else wavenumber(rows["omega"])
    points(chart, rows["omega"], rows[f"{mode}_abs"] / scale, colour)
