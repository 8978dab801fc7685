"""The part of a report on sweeps: figures over each axis with bands of their intervals, and a table of all cells."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from rl.evaluation.intervals import Interval
from rl.evaluation.report.about import number
from rl.evaluation.report.sources import Run
from rl.evaluation.sweeps import AxisTable, CellRow, SweepTable, named, value_text
from taichi_sim.plotting.page import COLOURS, blank, folded, missing, panel, paragraph, svg, table, text

FEW = 8  # up to this many values get a tick each
SPAN = 20.0  # ratio of largest to least value above which a panel's scale is logarithmic


def sweeps(run: Run, other: Run | None) -> str:
    """Every sweep of a run; where the other run has the same sweep, also its policy."""
    if not run.sweeps:
        return missing("No sweep yet:", run.command("evaluate", "--sweep", "default"))
    parts = []
    for name, content in run.sweeps.items():
        if content is None:
            parts.append(missing(f"The sweep {name} is not finished.", run.command("evaluate", "--sweep", name)))
            continue
        also = None if other is None else other.sweeps.get(name)
        same = also is not None and all(also[key] == content[key] for key in ("axes", "grid"))
        parts.append(_sweep(run, content, other.name if other and same else "", also if same else None))
    return "\n".join(parts)


def _sweep(run: Run, content: SweepTable, beside: str, also: SweepTable | None) -> str:
    base = "all axes against each other" if content["grid"] else "each axis alone, about the run's own scenario"
    head = f"<h3>Sweep {text(content['sweep'])}</h3>" + paragraph(
        f"{content['episodes']} episodes under each condition, seed {content['seed']}; {base}; bands: 95 % intervals",
        "faint",
    )
    drawn = [_axis(run, content, k, beside, also) for k in range(len(content["axes"]))]
    return head + "".join(drawn) + folded("all cells", _table(run, content))


def _axis(run: Run, content: SweepTable, k: int, beside: str, also: SweepTable | None) -> str:
    """Panels of one axis, a row for each team. In a grid, the other axes have their first value."""
    axis = content["axes"][k]
    rows, others = _along(content, k), None if also is None else _along(also, k)
    unit = f" ({axis['unit']})" if axis["unit"] else ""
    teams = list(dict.fromkeys(team for row in rows for team in row["teams"]))
    notes = _reasons(axis, rows)
    if not teams:
        return paragraph(f"{axis['name']}: nothing could be simulated.") + notes
    figures = run.judge.plotted
    figure = blank(2.9 * len(figures), 2.1 * len(teams) + 0.3)
    grid = figure.subplots(len(teams), len(figures), squeeze=False)
    for team, line in zip(teams, grid, strict=True):
        for key, axes in zip(figures, line, strict=True):
            for who in ("policy", content["opponent"]):
                _band(axes, axis, rows, team, who, key, COLOURS["policy" if who == "policy" else "classical"], who)
            if others is not None:
                _band(axes, axis, others, team, "policy", key, COLOURS["other"], beside)
            _scale(axes)
            panel(axes, f"{team}: {key}", f"{axis['name']}{unit}" if team == teams[-1] else "", "")
    grid[0][0].legend(loc="upper left")
    if content["grid"] and len(content["axes"]) > 1:
        fixed = ", ".join(f"{a['name']} {value_text(a['values'][0])}" for i, a in enumerate(content["axes"]) if i != k)
        notes = paragraph(f"at {fixed}; the other cells are in the table", "faint") + notes
    return svg(figure, f"sweep over {axis['name']}") + notes


def _along(content: SweepTable, k: int) -> list[CellRow]:
    """The cells along an axis, in its order."""
    names = [axis["name"] for axis in content["axes"]]
    first = {axis["name"]: axis["values"][0] for i, axis in enumerate(content["axes"]) if i != k}
    return [
        row
        for row in content["cells"]
        if names[k] in row["values"] and all(row["values"].get(name, value) == value for name, value in first.items())
    ]


def _band(
    axes: Axes, axis: AxisTable, rows: Sequence[CellRow], team: str, who: str, key: str, colour: str, label: str
) -> None:
    values = [row["values"][axis["name"]] for row in rows]
    numeric = all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    x = np.array(values, dtype=float) if numeric else np.arange(len(values), dtype=float)
    found = [row["teams"].get(team, {}).get(who, {}).get(key) or [None] * 3 for row in rows]
    y, low, high = np.array(found, dtype=float).T
    axes.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.plot(x, y, "o-", color=colour, markersize=3.0, linewidth=1.3, label=label)
    if not numeric or len(x) <= FEW:
        axes.set_xticks(x, [value_text(value) for value in values])


def _scale(axes: Axes) -> None:
    """Make the axis logarithmic where values span more than SPAN, so that the smaller controller stays visible."""
    values = np.concatenate([[1.0], *(np.asarray(line.get_ydata(), dtype=float) for line in axes.lines)])[1:]
    values = values[np.isfinite(values)]
    if len(values) and values.min() > 0 and values.max() > SPAN * values.min():
        axes.set_yscale("log")


def _reasons(axis: AxisTable, rows: Sequence[CellRow]) -> str:
    """Paragraphs on the cells that cannot be simulated, with the reasons."""
    notes = []
    for row in rows:
        values, why = f"{axis['name']} {value_text(row['values'][axis['name']])}", row["cannot_be"]
        if len(set(why.values())) == 1 and len(why) == 2:
            notes.append(f"{values} cannot be: {next(iter(why.values()))}")
        else:
            notes += [f"{values}, {who}, cannot be: {reason}" for who, reason in why.items()]
    return "".join(paragraph(line, "faint") for line in notes)


def _table(run: Run, content: SweepTable) -> str:
    units = {axis["name"]: f" {axis['unit']}".rstrip() for axis in content["axes"]}
    keys = [key for key in run.judge.definitions if key in _figures(content)]
    rows = []
    for row in content["cells"]:
        condition = ", ".join(f"{name} {value_text(value)}{units[name]}" for name, value in row["values"].items())
        condition = condition or "as in the run"
        rows += [
            [text(condition), "", text(who), f'<span class="why">cannot be: {text(why)}</span>']
            for who, why in row["cannot_be"].items()
        ]
        for team, of_team in row["teams"].items():
            for who, of in of_team.items():
                numbers = [number(Interval(*of[key]), who == "difference") for key in keys]
                rows.append([text(condition), text(team), text(named(who, content["opponent"])), *numbers])
    return table(("condition", "team", "controller", *keys), rows)


def _figures(content: SweepTable) -> set[str]:
    return {key for row in content["cells"] for team in row["teams"].values() for of in team.values() for key in of}
