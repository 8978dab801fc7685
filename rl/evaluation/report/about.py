"""What was trained, on what, how long; and the figures against the classical controller."""

import shlex
from collections.abc import Mapping
from typing import Any

from rl.evaluation.headroom import headroom, read_bounds
from rl.evaluation.intervals import Interval, differences, intervals
from rl.evaluation.report.sources import Run
from rl.evaluation.store import Kept
from taichi_sim.config.io import toml_text
from taichi_sim.plotting.page import folded, missing, paragraph, table, text

NOTHING = "-"


def about(run: Run) -> str:
    """A run's scenario, teams, times and origin."""
    config, machine = run.config, run.meta.get("machine", {})
    stages = [] if run.summary is None else run.summary["stages"]
    rows = [("scenario", f"{config.name}, mission {config.mission}, seed {config.seed}")]
    for name, team in config.teams.items():
        if name in config.trained:
            untrained = "" if stages else ", not trained yet"
            rows.append((f"team {name}", f"{team.count} x {team.vehicle}{untrained}"))
    rows += [(f"stage {stage['name']}", _learned(stage)) for stage in stages]
    if run.summary is not None:
        rows.append(("all of it", f"{_duration(run.summary['wall_time_s'])}, with evaluation and recording"))
    rows.append(
        ("on", f"{machine.get('processor', '?')}, {machine.get('cpus', '?')} CPUs, {machine.get('system', '?')}")
    )
    rows.append(("commit", str(run.meta.get("git_commit") or "not known")[:19]))
    told = table(("", run.name), [(text(a), text(b)) for a, b in rows], numbers=False)
    if run.summary is None:
        told += missing("The training is not finished.", f"python rl/train.py --out {run.folder} --resume")
    return told + folded("every key of the scenario", f"<pre>{text(toml_text(config))}</pre>")


def _learned(stage: Mapping[str, Any]) -> str:
    """What a stage has been."""
    teams = " and ".join((stage["team"], *stage.get("joint", ())))
    told = f"{teams}: {stage['iterations']} iterations, {stage['agent_steps'] / 1e6:.3g} million agent-steps"
    told += f", {_duration(stage['wall_time_s'])}"
    if verdict := stage.get("verdict"):
        kept = "kept" if verdict["kept"] else "dropped"
        told += f"; {kept}: its loss was {verdict['loss']:.3f}, before it {verdict['loss_before']:.3f}"
    return told


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def figures(run: Run, other: Run | None) -> str:
    """Tables of the last evaluations, with intervals, a team each."""
    parts = [_what_is_missing(r) for r in (run, other) if r is not None]
    columns = {f"{run.name}: {who}" if other else who: of for who, of in run.evaluations.items()}
    if other is not None and "policy" in other.evaluations:
        columns[f"{other.name}: policy"] = other.evaluations["policy"]
    parts += [paragraph(f"{who}: {_told(of)}", "faint") for who, of in columns.items()]
    if other is not None and (differing := _differing(run, other)):
        told = f"The scenarios differ in {', '.join(differing)}: differences between the runs are of that too."
        parts.append(paragraph(told))
    teams = list(dict.fromkeys(team for of in columns.values() for team in of.episodes))
    parts += [_of_team(run, team, columns) for team in teams]
    if columns:
        told = [(f"<code>{text(key)}</code>", text(words)) for key, words in run.judge.definitions.items()]
        parts.append(
            paragraph(
                "In brackets 95 % intervals, by the bootstrap over episodes; a difference whose interval leaves out "
                "zero is bold. Where all episodes were alike the interval has no width: of n episodes 3 / n may "
                "still be otherwise. A figure without one depends on single moments, not on episodes.",
                "faint",
            )
        )
        parts.append(folded("what each figure means", table(("figure", "definition"), told, numbers=False)))
    return "\n".join(parts)


def possible(run: Run) -> str:
    """How far the run's policies and the classical controller are from an oracle, on the oracle's episodes."""
    bounds, parts = read_bounds(run.config), []
    for team in (name for name in run.headroom if name in bounds):
        bound, learned = bounds[team], run.headroom[team]
        if len(next(iter(learned.values()))) != bound.episodes:
            continue  # the oracle was run anew since
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
        return missing("No oracle has done this scenario's episodes. Let one, then train or evaluate again:",
                       f"python tools/oracle.py {shlex.quote(run.config.name)}")  # fmt: skip
    told = (
        "An oracle plans in forks of the simulation itself and knows all that will happen: what can be done at all, or "
        "near it. Headroom taken is (classical - policy) / (classical - oracle), on the oracle's episodes."
    )
    return paragraph(told, "faint") + "\n".join(parts)


def _differing(run: Run, other: Run) -> list[str]:
    """Sections of the scenario in which two runs differ, beside how they were trained."""
    one, two = (r.config.model_dump(exclude={"name", "seed", "stages"}) for r in (run, other))
    return [key for key in {**one, **two} if one.get(key) != two.get(key)]


def _what_is_missing(run: Run) -> str:
    if "policy" not in run.evaluations:
        return missing(f"{run.name} was not evaluated yet. Make it, then this report again:", run.command("evaluate"))
    if "classical" not in run.evaluations:
        command = run.command("evaluate", "--controller", "classical")
        return missing("Nothing to compare with: there is no classical evaluation. Make it, if the vehicles have "
                       "controllers, then this report again:", command)  # fmt: skip
    return ""


def _told(of: Kept) -> str:
    conditions = f", {of.conditions}" if str(of.conditions) else ""
    return f"{of.result['episodes']} episodes of unseen worlds, seed {of.result['seed']}{conditions}"


def _of_team(run: Run, team: str, columns: Mapping[str, Kept]) -> str:
    """A row for each figure: each evaluation, and differences from the first where they are of the same episodes."""
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
            continue  # another part's
        row += [number(of[key], against_zero=True) if key in of else NOTHING for of in compared.values()]
        rows.append(row)
    return f"<h3>{text(team)}</h3>" + table(("", *having, *compared), rows)


def number(of: Interval, against_zero: bool = False) -> str:
    """A figure with its interval."""
    if of.value is None:
        return NOTHING
    value = f"{of.value:+.3g}" if against_zero else f"{of.value:.3g}"
    if of.low is None or of.high is None:
        return value
    clear = against_zero and (of.low > 0 or of.high < 0)
    return f"{f'<b>{value}</b>' if clear else value} <i>({of.low:.3g} to {of.high:.3g})</i>"
