"""The part of a report on the odds of failures that have been computed for a run (rl/evaluation/odds)."""

from collections.abc import Mapping
from typing import Any

from rl.evaluation.report.numbers import NOTHING
from rl.evaluation.store import EvaluationConditions, Run
from taichi_sim.visualisation.plotting.page import missing, paragraph, table, text

HEAD = "failure", "probability per episode", "per hour", "episodes", "more often, times"
OFTEN = 3  # conditions in a row


def odds(run: Run) -> str:
    """A row for each question that has been answered."""
    if not run.odds:
        return missing("How likely a failure is has not been computed.", run.command("odds", "--of", "collided"))
    lead = "In brackets 95 % intervals; episodes that began; conditions in which failures are more frequent."
    return paragraph(lead, "faint") + table(HEAD, [[text(cell) for cell in row(of)] for of in run.odds], numbers=False)


def row(told: Mapping[str, Any]) -> list[str]:
    """Stored odds (`as_json` of rl/evaluation/odds/report.py) as cells below `HEAD`."""
    under = EvaluationConditions(told["under"]["config"], tuple(told["under"]["set"]))
    p, low, high = (told[key] for key in ("probability", "low", "high"))
    interval = "" if low is None else f" ({low:.2e} to {high:.2e})"
    often = [one for one in told["conditions"] if one["low"] > 1][:OFTEN]
    return [
        f"{told['team']} {told['ending']}, {told['controller']} {under}".strip(),
        "no figure: decided at the start" if p is None else f"{p:.2e}{interval}",
        NOTHING if p is None else f"{told['per_hour']:.2g}",
        f"{told['beginnings']}{', counted' if len(told['levels']) == 1 else ''}",
        "; ".join(f"{one['condition']} {one['begins']:.3g} to {one['ends']:.3g}: {one['ratio']:.2g}" for one in often),
    ]
