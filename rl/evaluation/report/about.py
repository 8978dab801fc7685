"""The parts of a report on what was trained: table, learning curves, figures against the other controllers,
and sweeps: figures over each axis with bands of their intervals, and a table of all cells.
"""

import shlex
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from rl.evaluation.headroom import headroom, read_bounds
from rl.evaluation.intervals import Interval, differences, intervals
from rl.evaluation.report.numbers import NOTHING, number
from rl.evaluation.store import Run, StoredEvaluation
from rl.evaluation.sweeps import AxisTable, CellRow, SweepTable, named, value_text
from rl.evaluation.training_figures import (
    LOSS,
    REWARD,
    TERMS,
    draw_axes,
    draw_checkups,
    draw_iterations,
    draw_terms,
    judged,
    terms_of,
)
from rl.runs.folder import StageResult, resuming
from taichi_sim.config.io import toml_text
from taichi_sim.visualisation.plotting import log_where_spread
from taichi_sim.visualisation.plotting.page import COLOURS, blank, folded, missing, panel, paragraph, svg, table, text

FEW = 8  # up to this many values get a tick each


def about(run: Run) -> str:
    """Table of a run's scenario, teams, times and machine."""
    config, meta = run.config, run.meta or {}
    machine = meta.get("machine", {})
    stages = [] if run.summary is None else run.summary["stages"]
    rows = [("scenario", f"{config.name}, mission {config.mission}, seed {config.seed}")]
    for name, team in config.teams.items():
        if name in config.trained:
            untrained = "" if stages else ", not trained yet"
            rows.append((f"team {name}", f"{team.count} x {team.vehicle}{untrained}"))
        elif name in config.given:
            rows.append((f"team {name}", f"{team.count} x {team.vehicle}, by the policy of the package"))
    rows += [(f"stage {stage['name']}", _learned(stage)) for stage in stages]
    if run.summary is not None:
        rows.append(("all of it", f"{_duration(run.summary['wall_time_s'])}, with evaluation and recording"))
    rows.append(
        ("on", f"{machine.get('processor', '?')}, {machine.get('cpus', '?')} CPUs, {machine.get('system', '?')}")
    )
    rows.append(("commit", str(meta.get("git_commit") or "not known")[:19]))
    parts = table(("", run.name), [(text(a), text(b)) for a, b in rows], numbers=False)
    if run.summary is None:
        parts += missing("The training is not finished.", resuming(run.folder))
    if config.replaced:
        lines = "".join(f"<li>{text(line)}</li>" for line in config.replaced)
        parts += f"<h3>Another vehicle</h3><ul>{lines}</ul>"
    return parts


def configuration(run: Run) -> str:
    """Every key of a run's scenario."""
    return folded("every key of the scenario", f"<pre>{text(toml_text(run.config))}</pre>")


def _learned(stage: StageResult) -> str:
    """One line on a stage: teams, iterations, time, verdict."""
    teams = " and ".join((stage["team"], *stage.get("joint", ())))
    line = f"{teams}: {stage['iterations']} iterations, {stage['agent_steps'] / 1e6:.3g} million agent-steps"
    line += f", {_duration(stage['wall_time_s'])}"
    if verdict := stage.get("verdict"):
        kept = "kept" if verdict["kept"] else "dropped"
        line += f"; {kept}: loss {verdict['loss']:.3f}, before the stage {verdict['loss_before']:.3f}"
    return line


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def figures(run: Run, other: Run | None) -> str:
    """A table for each team: the figures of the last evaluations, with intervals."""
    parts = [_what_is_missing(r) for r in (run, other) if r is not None]
    columns = {f"{run.name}: {who}" if other else who: of for who, of in run.evaluations.items()}
    if other is not None and "policy" in other.evaluations:
        columns[f"{other.name}: policy"] = other.evaluations["policy"]
    parts += [paragraph(f"{who}: {_conditions(of)}", "faint") for who, of in columns.items()]
    if other is not None and (differing := _differing(run, other)):
        parts.append(paragraph(f"The scenarios differ in {', '.join(differing)}: this also changes the figures."))
    teams = list(dict.fromkeys(team for of in columns.values() for team in of.episodes))
    parts += [_of_team(run, team, columns) for team in teams]
    if columns:
        meanings = [(f"<code>{text(key)}</code>", text(words)) for key, words in run.judge.definitions.items()]
        parts.append(
            paragraph(
                "Brackets hold 95 % intervals: of shares of episodes by Wilson's method, and Newcombe's for their "
                "differences; of others by the bootstrap over episodes. A difference is bold if its interval excludes "
                "zero. A figure without an interval depends on single moments.",
                "faint",
            )
        )
        parts.append(folded("what each figure means", table(("figure", "definition"), meanings, numbers=False)))
    return "\n".join(parts)


def possible(run: Run) -> str:
    """Tables that compare the run's policies and the classical controller with an oracle, on the oracle's episodes."""
    bounds, parts = read_bounds(run.config), []
    for team in (name for name in run.headroom if name in bounds):
        bound, learned = bounds[team], run.headroom[team]
        if len(next(iter(learned.values()))) != bound.episodes:
            continue  # the oracle has run again since
        found = {who: intervals(run.judge, of) for who, of in
                 (("classical", bound.classical), ("policy", learned), ("oracle", bound.oracle))}  # fmt: skip
        taken = headroom(run.judge, learned, bound)
        rows = [
            [f"<code>{text(key)}</code>", *(number(of[key]) for of in found.values()), number(taken[key])]
            for key in run.judge.plotted
            if key in taken and found["oracle"][key].value is not None
        ]
        parts.append(f"<h3>{text(team)}</h3>" + table(("", *found, "headroom taken"), rows))
    if not parts:
        return missing("This scenario has no oracle. Run one, then train or evaluate again:",
                       f"python tools/oracle.py {shlex.quote(run.config.name)}")  # fmt: skip
    lead = (
        "An oracle plans in forks of the simulation and knows the future: its result is near the best possible. "
        "Headroom taken is (classical - policy) / (classical - oracle), on the oracle's episodes."
    )
    return paragraph(lead, "faint") + "\n".join(parts)


def _differing(run: Run, other: Run) -> list[str]:
    """The sections in which the scenarios of two runs differ, apart from the training."""
    one, two = (r.config.model_dump(exclude={"name", "seed", "stages"}) for r in (run, other))
    return [key for key in {**one, **two} if one.get(key) != two.get(key)]


def _what_is_missing(run: Run) -> str:
    if "policy" not in run.evaluations:
        return missing(f"{run.name} is not evaluated yet. Evaluate it, then make this report again:",
                       run.command("evaluate"))  # fmt: skip
    if "classical" not in run.evaluations:
        command = run.command("evaluate", "--controller", "classical")
        return missing("No evaluation of the classical controller. If the vehicles have one, evaluate it, then make "
                       "this report again:", command)  # fmt: skip
    return ""


def _conditions(of: StoredEvaluation) -> str:
    conditions = f", {of.conditions}" if str(of.conditions) else ""
    return f"{of.result['episodes']} held-out episodes, seed {of.result['seed']}{conditions}"


def _of_team(run: Run, team: str, columns: Mapping[str, StoredEvaluation]) -> str:
    """A row for each figure: each evaluation's value, and differences from the first on the same episodes."""
    having = {who: of for who, of in columns.items() if team in of.episodes}
    (first, of_first), *others = having.items()
    found = {who: intervals(run.judge, of.episodes[team]) for who, of in having.items()}
    compared = {
        f"{first} - {who}": differences(run.judge, of_first.episodes[team], of.episodes[team])
        for who, of in others
        if of.trial == of_first.trial
    }
    rows = []
    for key in run.judge.definitions:
        row = [f"<code>{text(key)}</code>"]
        for who, of in having.items():
            alone = Interval(of.result["teams"][team].get(key), None, None)
            row.append(number(found[who].get(key, alone)))
        if all(cell == NOTHING for cell in row[1:]):
            continue  # no evaluation has this figure
        row += [number(of[key], against_zero=True) if key in of else NOTHING for of in compared.values()]
        rows.append(row)
    return f"<h3>{text(team)}</h3>" + table(("", *having, *compared), rows)


def curves(runs: Sequence[Run]) -> str:
    """A row of panels for each team; each panel shows all runs."""
    teams = list(dict.fromkeys(team for run in runs for team in run.histories))
    if not teams:
        return missing("No training yet.", resuming(runs[0].folder))
    known = {team: [run for run in runs if team in run.histories] for team in teams}
    columns = {
        team: list(
            dict.fromkeys(
                [
                    REWARD,
                    *([TERMS] if any(terms_of(run.histories[team]) for run in of) else ()),
                    *(key for run in of for key in judged(run.histories[team])),
                    LOSS,
                ]
            )
        )
        for team, of in known.items()
    }
    wide = max(map(len, columns.values()))
    figure = blank(3.0 * wide, 2.6 * len(teams) + 0.3)
    grid = figure.subplots(len(teams), wide, squeeze=False)
    for team, line in zip(teams, grid, strict=True):
        for axes in line[len(columns[team]) :]:
            axes.set_visible(False)
        for column, axes in zip(columns[team], line, strict=False):
            for run, colour in zip(runs, (COLOURS["policy"], COLOURS["other"]), strict=False):
                if run not in known[team]:
                    continue
                history = run.histories[team]
                if column in (REWARD, LOSS):
                    draw_iterations(axes, history, column, colour, "")
                if column == TERMS:
                    draw_terms(axes, history, "-" if run is runs[0] else ":", run is runs[0])
                draw_checkups(axes, history, column, colour, run.name, levels=run is runs[0])
            draw_axes(axes, [run.histories[team] for run in known[team]], column)
            panel(axes, f"{team}: {column.replace('_', ' ')}", "million agent-steps" if team == teams[-1] else "", "")
            handles, labels = axes.get_legend_handles_labels()
            shown = [(handle, label) for handle, label in zip(handles, labels, strict=True)
                     if ":" in label or len(runs) > 1]  # fmt: skip
            if shown:
                axes.legend(*zip(*shown, strict=True), framealpha=0.0, fontsize=7)
    lead = (
        "Dots: the mean policy on held-out episodes, which nothing else uses; hollow: most episodes ended before the "
        "error could be measured; crosses: all did. Thin lines: each iteration of the training, and their moving mean. "
        "Dashed: the classical controller; dotted: the policy before its training. Terms: the mean part of each in the "
        "reward per decision, weighted, and its last value; dotted: of the second run. Above: minutes of training."
    )
    return paragraph(lead, "faint") + svg(figure, "learning curves")


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
            log_where_spread(axes, np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines]))
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
