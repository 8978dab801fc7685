"""A 20/20 zig-zag of the Otter by differential thrust: our hull of panels and the linear model (no table)."""

from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from taichi_sim.bench import Bench
from taichi_sim.config.io import validate
from taichi_sim.models.usv.hull.params import Hull6DofParams
from taichi_sim.visualisation.plotting import INK, dress, new_figure
from tests.validation.case import Case, Folder
from tests.validation.otter import as_action
from tests.validation.otter_numbers import FILE, model, parameters
from tests.validation.parameters import shipped
from tests.validation.plots.style import FAINT, OTHER, OURS, legend

SWITCH = np.deg2rad(20.0)  # of heading, at which the command changes sides
MEAN, DIFFERENCE = 60.0, 20.0  # rad/s: mean shaft speed, and half the difference of the shafts
APPROACH, DURATION, SAMPLE = 20.0, 40.0, 0.04  # s; of the straight run before, of the manoeuvre
DT = 0.02  # s


class ZigZag(NamedTuple):
    """Time (s), heading (rad), command (-1, 0, 1: to port, none, to starboard) and yaw rate (rad/s), [k] each."""

    t: np.ndarray
    heading: np.ndarray
    side: np.ndarray
    yaw_rate: np.ndarray

    @property
    def overshoots(self) -> list[tuple[float, float]]:
        """Time (s) and heading (rad) of each turning point beyond the switch."""
        turned = np.flatnonzero((np.diff(np.sign(self.yaw_rate)) != 0) & (np.abs(self.heading[1:]) > SWITCH)) + 1
        return [(self.t[i], self.heading[i]) for i in turned]


def run(params: Hull6DofParams) -> ZigZag:
    """The manoeuvre: to starboard until the heading is 20 deg, then to port until it is -20 deg, and so on."""
    bench = Bench(model(params, DT, round(SAMPLE / DT)))
    bench.step(as_action(params, (MEAN, MEAN)), round(APPROACH / SAMPLE))
    rows, side = [], 1.0
    for i in range(round(DURATION / SAMPLE) + 1):
        motion = bench.read()
        heading = motion.euler[0, 2]
        if side * heading >= SWITCH:
            side = -side
        rows.append((i * SAMPLE, heading, side, motion.nu[0, 5]))
        bench.step(as_action(params, (MEAN + side * DIFFERENCE, MEAN - side * DIFFERENCE)))
    return ZigZag(*np.array(rows).T)


def draw(folder: Folder) -> Figure:
    """Heading and command over time, with overshoot angles."""
    linear = parameters(Case(folder, folder.root, "f64"))
    hull = shipped(FILE) | {"actions": "left_right", "windage": {}}
    runs = {"hull of panels": (run(validate(Hull6DofParams, hull, FILE)), OURS), "linear model": (run(linear), OTHER)}
    figure = new_figure(11.0, 4.8, "Otter: zig-zag 20°/20° by differential thrust")
    axes, command = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1))
    axes.axhspan(-np.rad2deg(SWITCH), np.rad2deg(SWITCH), color=FAINT, zorder=0)
    for name, (found, colour) in runs.items():
        axes.plot(found.t, np.rad2deg(found.heading), color=colour, lw=2, label=name)
        command.step(found.t, DIFFERENCE * found.side, color=colour, lw=1.6, where="post")
    for t, heading in runs["hull of panels"][0].overshoots:
        over = np.rad2deg(abs(heading) - SWITCH)
        axes.annotate(f"{over:.1f}°", (t, np.rad2deg(heading)), (0, 7 if heading > 0 else -7), color=INK, fontsize=8.5,
                      textcoords="offset points", ha="center", va="bottom" if heading > 0 else "top")  # fmt: skip
    dress(axes, "Heading; angles: overshoot of the hull of panels", "", "degrees")
    axes.margins(y=0.16)
    legend(axes, loc="lower right", ncols=2, bbox_to_anchor=(1.0, 0.99))
    dress(command, f"Command: shafts at {MEAN:g} ± this", "time (s)", "rad/s")
    command.set_xlim(0, DURATION)
    command.set_ylim(-1.4 * DIFFERENCE, 1.4 * DIFFERENCE)
    return figure
