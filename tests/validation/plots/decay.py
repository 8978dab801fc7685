"""Free decays of the Otter in heave, roll and pitch: linear model, hull of panels, and the table."""

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.bench import Bench
from taichi_sim.config.io import validate
from taichi_sim.models.usv.hull.params import Hull6DofParams
from taichi_sim.visualisation.plotting import dress, new_figure
from tests.validation.case import Case, Folder
from tests.validation.otter import POSE, fly, place
from tests.validation.otter_numbers import FILE, model, parameters
from tests.validation.otter_steady import rest
from tests.validation.parameters import shipped
from tests.validation.plots.style import OTHER, OURS, THIRD, legend, points
from tests.validation.tables import TableError, read_csv

MODES = {"heave": ("z", 100.0, "cm"), "roll": ("phi", 180 / np.pi, "deg"), "pitch": ("theta", 180 / np.pi, "deg")}
DT = 0.02  # s
SHOWN = 4.0  # s


def draw(folder: Folder) -> Figure:
    """Departure from rest over time, after decay_heave, decay_roll and decay_pitch *_converged.csv."""
    figure = new_figure(12.5, 3.9, "Otter: free decay from a push")
    for axes, (mode, (name, scale, unit)) in zip(figure.subplots(1, 3), MODES.items(), strict=True):
        found = sorted(folder.root.rglob(f"decay_{mode}_converged.csv"))
        if not found:
            raise TableError(f"no decay_{mode}_converged.csv")
        case, table = Case(folder, found[0], "f64"), read_csv(found[0])
        p = parameters(case)
        level = dict(zip(POSE, (0.0, 0.0, rest(p)[0], 0.0, rest(p)[1], 0.0), strict=True))[name]
        shown = table["t"] <= SHOWN
        t = table["t"][shown]
        push = table[name][0] - level
        axes.plot(t, scale * _panels(name, push, t), color=THIRD, lw=1.8, label="this package, hull of panels")
        axes.plot(t, scale * (fly(case, table)[name][shown] - level), color=OURS, lw=2, label="this package, linear")
        some = slice(None, None, max(1, shown.sum() // 34))
        theirs = scale * (table[name][shown][some] - level)
        points(axes, table["t"][shown][some], theirs, OTHER, "reference, converged", clip=False)
        axes.axhline(0, color="#9AA5B1", lw=0.8, zorder=1)
        dress(axes, mode.capitalize(), "time (s)", f"from rest ({unit})")
        axes.set_xlim(0, SHOWN)
        if mode == "heave":
            legend(axes, loc="upper right")
    return figure


def _panels(name: str, push: float, t: np.ndarray) -> np.ndarray:
    """The same departure of the shipped hull of panels, pushed off its own rest; at evenly spaced times t (s)."""
    numbers = shipped(FILE) | {"actions": "left_right", "windage": {}}
    hull = model(validate(Hull6DofParams, numbers, FILE), DT, round((t[1] - t[0]) / DT))
    z, phi, theta = hull.geometry.hydrostatics.equilibrium
    eta = np.array([0.0, 0.0, z, phi, theta, 0.0])
    column = POSE.index(name)
    level = eta[column]
    eta[column] += push
    bench = Bench(hull)
    place(bench, eta)
    values = []
    for _ in t:
        motion = bench.read()
        values.append(np.concatenate((motion.position[0], motion.euler[0]))[column])
        bench.step([0.0, 0.0])
    return np.array(values) - level
