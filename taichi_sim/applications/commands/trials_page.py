"""The HTML page of taichi_sim/applications/commands/trials.py: figures in tables, curves as pictures, IMO's limits."""

import math
from typing import TYPE_CHECKING

import numpy as np

from taichi_sim.applications.trials.results import Outcome, Panel, TrialsReport
from taichi_sim.visualisation.plotting.page import blank, page, panel, paragraph, section, style, svg, table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def page_of(report: TrialsReport) -> str:
    """HTML of a `TrialsReport`, self-contained."""
    with style():
        parts = [section(out.title, _figures(out), _pictures(out)) for out in report.outcomes if not out.refused]
    if report.criteria:
        rows = [
            (c.name, c.case, shown(c.value, c.unit), shown(c.limit, c.unit), c.judgement.lower())
            for c in report.criteria
        ]
        limits = table(("criterion", "case", "figure", "at most", "met"), rows, numbers=False)
        parts.insert(0, section("IMO MSC.137(76)", limits))
    if report.doubts:
        rows = [(d.trial, d.case, d.name, shown(d.value, d.unit), d.why) for d in report.doubts]
        told = table(("trial", "case", "figure", "value", "why"), rows, numbers=False)
        parts.insert(0, section("No vessel has these figures: a number of the file is wrong, or missing", told))
    refused = [(out.title, out.refused) for out in report.outcomes if out.refused]
    if refused:
        parts.append(section("Not done", table(("trial", "why"), refused, numbers=False)))
    lead = f"A {report.kind} of {report.length:g} m; {report.conditions}. Definitions: docs/trials.md."
    return page(f"Trials of {report.vehicle}", paragraph(lead, "faint"), parts)


def shown(value: float, unit: str) -> str:
    """A figure in common units: degrees for radians."""
    if math.isnan(value):
        return "-"
    if unit == "rad":
        return f"{math.degrees(value):.5g} deg"
    return f"{value:.5g} {unit}".rstrip()


def _figures(out: Outcome) -> str:
    cases = list(dict.fromkeys(f.case for f in out.figures))
    names = list(dict.fromkeys((f.name, f.unit) for f in out.figures))
    cells = {}
    for f in out.figures:
        cells.setdefault((f.case, f.name), []).append(f.value)

    def cell(case: str, name: str, unit: str) -> str:
        values = np.array(cells.get((case, name), [math.nan]))
        told, n = shown(float(values.mean()), unit), len(values)
        return told if n == 1 else f"{told} (std {shown(float(values.std(ddof=1)), unit)}, {n} runs)"

    if len(cases) > len(names):
        head = ("case", *(name for name, _ in names))
        return table(head, [(case, *(cell(case, *name) for name in names)) for case in cases])
    return table(("figure", *cases), [(name, *(cell(case, name, unit) for case in cases)) for name, unit in names])


def _pictures(out: Outcome) -> str:
    if not out.curves or not out.panels:
        return ""
    figure = blank(4.2 * len(out.panels), 3.4)
    for axes, wanted in zip(figure.subplots(1, len(out.panels), squeeze=False)[0], out.panels, strict=True):
        _draw(axes, out, wanted)
    return svg(figure, out.name)


def _draw(axes: "Axes", out: Outcome, wanted: Panel) -> None:
    for k, curve in enumerate(out.curves):
        x, y = curve.columns[wanted.x], curve.columns[wanted.y]
        colour = COLOURS[k % len(COLOURS)]
        few = len(x) < 50
        axes.plot(x, y, color=colour, label=curve.case, marker="o" if few else None, markersize=3, linewidth=1.2)
        if wanted.y == "heading deg" and "helm rad" in curve.columns:
            helm = curve.columns["helm rad"]
            axes.plot(x, np.degrees(helm), color=colour, linewidth=0.8, linestyle="--")
    name, unit = (axis.rsplit(" ", 1) for axis in (wanted.x, wanted.y))
    panel(axes, wanted.title, ", ".join(name).replace(", 1", ""), ", ".join(unit).replace(", 1", ""))
    if wanted.equal:
        axes.set_aspect("equal", adjustable="datalim")
    if len(out.curves) > 1:
        axes.legend(frameon=False)
