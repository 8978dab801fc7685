"""The page of taichi_sim/applications/commands/fit.py: fitted numbers, tracks and residuals."""

import numpy as np

from taichi_sim.applications.fit.estimate import Fit, SimulatedWindow, Tested
from taichi_sim.applications.fit.log import Log
from taichi_sim.applications.fit.log_table import EAST, HEADING, NORTH
from taichi_sim.visualisation.plotting.page import (
    COLOURS,
    FAINT,
    blank,
    page,
    panel,
    paragraph,
    section,
    style,
    svg,
    table,
    text,
)

CHANNELS = (("north", "m"), ("east", "m"), ("heading", "deg"), ("yaw rate", "deg/s"))
FITTED, FILE = COLOURS["policy"], COLOURS["classical"]


def page_of(vehicle: str, found: Fit, logs: list[Log], held_out: str, starts: list[str]) -> str:
    """HTML of a fit, self-contained, with sentences on the windows held out and on where the searches ended."""
    with style():
        parts = [
            section("Numbers", _numbers(found), _interval_plot(found)),
            section("Correlation of their errors", _correlation(found)),
            section("Residuals", _residuals(found)),
            section("Starts", *(paragraph(line) for line in starts)),
            *(section(log.name, _about(found, k, log), _tracks(found.tracks, k, log)) for k, log in enumerate(logs)),
        ]
        for k, test in enumerate(found.tests, len(logs)):
            parts.append(section(f"Test: {test.log.name}", _result(test), _tracks(test.tracks, k, test.log)))
    lead = f"{len(logs)} logs, {len(found.tracks)} windows; {held_out}. Method and assumptions: docs/fit.md."
    return page(f"{vehicle}, fitted to logs", paragraph(lead, "faint"), parts)


def _numbers(found: Fit) -> str:
    rows = [
        (text(key), f"{before:.5g}", f"{value:.5g}", f"{low:.5g} to {high:.5g}",
         "the data" if known else "the prior: the data do not tell it")
        for key, before, value, low, high, known in zip(
            found.keys, found.nominal, found.values, found.low, found.high, found.told, strict=True
        )
    ]  # fmt: skip
    return table(("number", "file", "fitted", "95 % interval", "rests on"), rows)


def _interval_plot(found: Fit) -> str:
    """Fitted numbers over the file's."""
    figure = blank(6.5, 0.8 + 0.28 * len(found.keys))
    axes, y = figure.subplots(), np.arange(len(found.keys))[::-1]
    middle, low, high = (x / found.nominal for x in (found.values, found.low, found.high))
    low, high = np.minimum(low, high), np.maximum(low, high)
    axes.errorbar(middle, y, xerr=(middle - low, high - middle), fmt="o", color=FITTED, markersize=4, capsize=3)
    axes.axvline(1.0, color=FAINT, linewidth=0.8)
    axes.set_yticks(y, found.keys)
    panel(axes, "", "fitted number over the file's, 95 % interval", "")
    return svg(figure, "fitted numbers over the file's")


def _correlation(found: Fit) -> str:
    rows = [
        (text(key), *(f"{value:+.2f}" for value in found.correlation[k, : k + 1]), *[""] * (len(found.keys) - k - 1))
        for k, key in enumerate(found.keys)
    ]
    return table(("", *found.keys), rows)


def _residuals(found: Fit) -> str:
    """Distribution of the residuals by channel: of windows that were fitted, and of those that were not."""
    figure = blank(12.0, 2.6)
    for c, (axes, (name, _)) in enumerate(zip(figure.subplots(1, 4), CHANNELS, strict=True)):
        for held, colour, label in ((False, FITTED, "fitted windows"), (True, FILE, "held-out windows")):
            mine = [t for t in found.tracks if (t.by_file is not None) == held]
            if mine:
                left = np.concatenate([_left(t, t.fitted)[:, c] for t in mine]) / found.sigma[c]
                axes.hist(left, np.linspace(-5, 5, 41), density=True, histtype="step", color=colour, label=label)
        x = np.linspace(-5, 5, 101)
        axes.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi), color=FAINT, linewidth=0.8, label="normal")
        panel(axes, name, "residual / standard deviation", "density" if c == 0 else "")
        if c == 0:
            axes.legend(frameon=False)
    return svg(figure, "distribution of residuals")


def _about(found: Fit, k: int, log: Log) -> str:
    north, east = found.currents[k]
    towards = np.degrees(np.arctan2(east, north)) % 360
    odd = "; asks for other numbers than the other logs" if k in found.odd else ""
    return paragraph(f"Current {np.hypot(north, east):.2f} m/s towards {towards:.0f} deg{odd}. sha256 {log.digest}")


def _result(test: Tested) -> str:
    rows = [
        (name, *(f"{np.degrees(x) if c > 1 else x:.3g} {unit}" for x in (test.by_file[c], test.by_fit[c])))
        for c, (name, unit) in enumerate(CHANNELS)
    ]
    return table(("residuals, rms", "by the file", "by the fit"), rows)


def _tracks(tracks: list[SimulatedWindow], k: int, log: Log) -> str:
    """The path of a log, and its channels' residuals over time."""
    mine = [t for t in tracks if t.log == k]
    if not mine:
        return paragraph("No window of this log was long enough.")
    figure = blank(12.0, 3.6)
    path, left = figure.subplots(1, 2)
    path.plot(log.motion[:, EAST], log.motion[:, NORTH], color=FAINT, linewidth=3, alpha=0.4, label="measured")
    named: set[str] = set()
    for track in mine:
        shown = [(track.fitted, FITTED, "by the fit")]
        if track.by_file is not None:
            shown.insert(0, (track.by_file, FILE, "by the file, held-out windows"))
        for motion, colour, label in shown:
            once = "_" if label in named else label
            path.plot(motion[:, EAST], motion[:, NORTH], color=colour, linewidth=1, label=once)
            named.add(label)
    panel(path, "windows, each from a first state of its own", "east, m", "north, m")
    path.set_aspect("equal", adjustable="datalim")
    path.legend(frameon=False)
    for c, (name, unit) in enumerate(CHANNELS):
        rms = np.sqrt(np.mean(np.concatenate([_left(t, t.fitted)[:, c] for t in mine]) ** 2))
        told = f"{name}: {np.degrees(rms) if c > 1 else rms:.2g} {unit} rms"
        values = [np.sqrt(np.mean((_left(t, t.fitted)[:, c] / rms) ** 2)) for t in mine]
        left.plot(values, marker="o", markersize=3, linewidth=0.8, label=told)
    for n, track in enumerate(mine):
        if track.by_file is not None:
            left.axvline(n, color=FILE, linewidth=0.8, linestyle=":")
    panel(left, "residuals of each window (held-out ones last, dotted)", "window", "rms / rms of all windows")
    left.set_ylim(bottom=0)
    left.legend(frameon=False)
    return svg(figure, f"{log.name}: measured and simulated tracks")


def _left(track: SimulatedWindow, motion: np.ndarray) -> np.ndarray:
    """Measured less simulated [sample, 4]; heading in (-pi, pi]."""
    left = track.measured - motion
    left[:, HEADING] = np.angle(np.exp(1j * left[:, HEADING]))
    return left
