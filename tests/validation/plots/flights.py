"""Flights of the Aerosonde after a push, in single precision, over the converged ones; what is between them below."""

import math
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.kernels import runtime
from taichi_sim.models.uav.fixed_wing.fixed_wing_6dof import FixedWing6DOF
from taichi_sim.visualisation.plotting import dress, new_figure
from tests.validation import aerosonde
from tests.validation.aerosonde_numbers import parameters
from tests.validation.case import Case, Folder
from tests.validation.inputs import wind_of
from tests.validation.plots.finer import finer
from tests.validation.plots.style import OTHER, OURS, legend, points
from tests.validation.tables import UNEVEN, Table, TableError, even_interval, read_csv

DEGREES = 180 / math.pi
POINTS = 40  # of the table, at most


class Quantity(NamedTuple):
    """A column, its name, the unit it is shown in, and what turns it into that."""

    column: str
    name: str
    unit: str
    scale: float


class Push(NamedTuple):
    """A flight: which table, what it is, how much of it is shown (s), and of what."""

    pattern: str
    title: str
    end: float
    shown: tuple[Quantity, ...]


DOUBLETS = (
    Push("elevator_doublet_[AB].csv", "Elevator doublet", 6.0,
         (Quantity("q", "pitch rate q", "deg/s", DEGREES), Quantity("alpha", "angle of attack α", "deg", DEGREES))),
    Push("aileron_doublet_[AB].csv", "Aileron doublet", 6.0,
         (Quantity("p", "roll rate p", "deg/s", DEGREES), Quantity("phi", "roll φ", "deg", DEGREES))),
)  # fmt: skip
PHUGOID = Push("phugoid_release_*_[AB].csv", "Phugoid", 40.0,
               (Quantity("Va", "airspeed Va", "m/s", 1.0), Quantity("theta", "pitch θ", "deg", DEGREES)))  # fmt: skip


def doublets(folder: Folder) -> Figure:
    """Answers to a doublet of the elevator and one of the ailerons; a column each."""
    figure = new_figure(12.0, 7.0, f"Aerosonde: answers to doublets, f32 at a step of {aerosonde.DT:g} s")
    grid = figure.add_gridspec(1, len(DOUBLETS))
    for column, push in enumerate(DOUBLETS):
        cells = grid[column].subgridspec(2 * len(push.shown), 1, height_ratios=(2.2, 1) * len(push.shown))
        _draw(folder, push, [figure.add_subplot(cell) for cell in cells])
    return figure


def phugoid(folder: Folder) -> Figure:
    """Let go at another airspeed than the trim's, controls held."""
    figure = new_figure(12.0, 4.4, f"Aerosonde: phugoid, controls held, f32 at a step of {aerosonde.DT:g} s")
    cells = figure.add_gridspec(2, len(PHUGOID.shown), height_ratios=(2.2, 1))
    columns = range(len(PHUGOID.shown))
    _draw(folder, PHUGOID, [figure.add_subplot(cells[row, column]) for column in columns for row in (0, 1)])
    return figure


def _draw(folder: Folder, push: Push, charts: list) -> None:
    """Pairs of charts, one of each quantity and one of our distance to the table."""
    found = sorted(folder.root.rglob(push.pattern))
    if not found:
        raise TableError(f"no {push.pattern}")
    table = read_csv(found[-1])  # B where there are both: it can fly
    table = table.where(table["t"] <= push.end)
    time, ours = _fly(Case(folder, found[-1], "f32"), table)
    every = round((len(time) - 1) / (len(table) - 1))
    some = slice(None, None, max(1, len(table) // POINTS))
    for chart, difference, quantity in zip(charts[::2], charts[1::2], push.shown, strict=True):
        name, unit, scale = quantity.name, quantity.unit, quantity.scale
        theirs = scale * table[quantity.column]
        chart.plot(time, scale * ours[quantity.column], color=OURS, lw=1.8, label="this package")
        points(chart, table["t"][some], theirs[some], OTHER, "reference, converged", clip=False)
        away = scale * ours[quantity.column][::every] - theirs
        difference.plot(table["t"], away, color=OURS, lw=1.2)
        dress(chart, f"{push.title}: {name}", "", f"{name.rsplit(' ', 1)[-1]} ({unit})")
        dress(difference, "", "time (s)", f"difference\n({unit})")
        difference.ticklabel_format(axis="y", style="sci", scilimits=(-2, 2), useMathText=True)
        chart.tick_params(labelbottom=False)
        for axes in (chart, difference):
            axes.set_xlim(0, push.end)
        if chart is charts[0]:
            legend(chart, loc="upper right")


def _fly(case: Case, table: Table) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (s) and our flight at every step, each row's controls held until the next; in single precision."""
    interval = even_interval(table["t"])
    between = round(interval / aerosonde.DT)
    if between < 1 or abs(interval / aerosonde.DT - between) > UNEVEN:
        raise TableError(f"column 't': rows are not a whole number of steps of {aerosonde.DT} s apart")
    steps = finer(table, between)
    before = runtime.current()
    try:
        runtime.init(before.arch, case.precision, before.threads)
        model = FixedWing6DOF(parameters(case, aerosonde.variant(case)), aerosonde.DT, 1)
        flown = aerosonde.Flight(model, steps, wind_of(case, steps)).fly(np.ones(len(steps) - 1, dtype=int))
    finally:
        runtime.init(before.arch, before.precision, before.threads)
    return steps["t"], flown
