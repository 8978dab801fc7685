"""Compare A with B on the same held-out episodes: every figure of the mission's judge, paired, with 95 % intervals.

    compare A B              two runs; B also: classical, pretrained
    compare A1 A2 -- B1 B2   training seeds of two recipes, as groups
    compare RUN              a run, or three and more, each against the classical controller

In the last case it prints a Markdown table of figures, as follows.
Runs of one scenario with different training seeds are also judged together, in the last row of a team. Its intervals
draw episodes, each with the results of all runs.

If an oracle's episodes are stored for the scenario (tools/oracle.py), the policies run them too. A second table gives
the share of the headroom between classical controller and oracle that they take. A third has the odds of failures that
`taichi-sim odds RUN` has found for the runs.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from taichi_sim.options import positive_int, seed

VERSUS = "versus"  # stands for --, which argparse takes for itself


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared

    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("runs", nargs="+", type=Path, metavar="RUN",
                   help="run folders of rl/train.py")  # fmt: skip
    p.add_argument("--seed", type=seed, default=None, help="seed of the held-out episodes (default: the scenario's)")
    p.add_argument("--episodes", type=positive_int, default=None, help="episodes of each run (default: the scenario's)")
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    given = [VERSUS if text == "--" else text for text in (sys.argv[1:] if argv is None else argv)]
    args = parser().parse_intermixed_args(given)
    from rl.commands import shared

    shared.start(args)
    names = [str(run) for run in args.runs]
    cut = names.index(VERSUS) if VERSUS in names else 1
    if VERSUS in names or len(names) == 2:
        sides = names[:cut], [name for name in names[cut:] if name != VERSUS]
        if not all(sides):
            parser().error("a side has no run")
        return against(sides, args)
    found: dict[tuple[str, str], list[tuple[str, Any, Any]]] = {}
    classical: dict[str, Any] = {}
    kinds: dict[str, Any] = {}
    taken: dict[tuple[str, str], tuple[Any, list[Any]]] = {}
    for run in args.runs:
        config, judge, learned, opponent = contest(run, args, classical)
        kinds[config.name] = judge
        for team, (bound, episodes) in on_bounds(run, args).items():
            taken.setdefault((config.name, team), (bound, []))[1].append(episodes)
        for team, episodes in learned.items():
            found.setdefault((config.name, team), []).append((run.name, episodes, opponent[team]))
    print(table(found, kinds))
    if taken:
        print("\n" + headroom_table(taken, kinds))
    if odds := odds_table(args.runs):
        print("\n" + odds)


def against(sides: tuple[list[str], list[str]], args: argparse.Namespace) -> None:
    """Print the figures of two sides on the same episodes."""
    from rl.evaluation import comparison

    of = comparison.contest(
        sides, args.overrides, episodes=args.episodes, seed=args.seed, show_progress=not args.quiet
    )  # fmt: skip
    print("\n".join(f"{letter}: {', '.join(side)}" for letter, side in zip("AB", sides, strict=True)))
    print("\n".join(of.notes))
    for team in of.numbers[0]:
        print(f"\n{comparison.table(of, team)}")


def on_bounds(run: Path, args: argparse.Namespace) -> dict[str, tuple[Any, Any]]:
    """Judge a run's policies on the oracle's episodes: team -> the bound, and the numbers of each episode."""
    from rl.evaluation.headroom import judge_on_bounds, read_bounds
    from rl.learn.policy import policies_of
    from rl.runs.folder import load_config

    config, source = load_config(run, args.overrides)
    if not (bounds := read_bounds(config)):
        return {}
    found = judge_on_bounds(bounds, config, policies_of("policy", run, config), source)
    return {team: (bounds[team], episodes) for team, episodes in found.items()}


def headroom_table(taken: dict[tuple[str, str], tuple[Any, list[Any]]], kinds: dict[str, Any]) -> str:
    """Markdown: classical, learned, oracle, and the share of the headroom that learning takes, for each team.

    Of the figure that a task of the benchmark judges, it is the score.
    """
    from rl.evaluation.benchmark import read_tasks
    from rl.evaluation.headroom import headroom
    from rl.evaluation.intervals import intervals

    lines = []
    for (name, team), (bound, rows) in taken.items():
        judge, learned = kinds[name], joined(rows)
        scored = [task.figure for task in read_tasks().values() if task.scenario == name and team in task.teams]
        keys = tuple(dict.fromkeys((*scored, *judge.plotted)))
        if not lines:
            heads = [f"{key}: classical / learned / oracle: headroom taken" for key in keys]
            lines = [f"| {bound.episodes} episodes | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
        of_each = [intervals(judge, of) for of in (bound.classical, learned, bound.oracle)]
        share, cells = headroom(judge, learned, bound, times=len(rows)), []
        for key in keys:
            values = [of[key].value for of in of_each]
            text = " / ".join("-" if x is None else f"{x:.3g}" for x in values)
            if (s := share[key]).value is not None and s.low is not None and s.high is not None:
                text += f": {100 * s.value:.0f} % ({100 * s.low:.0f} to {100 * s.high:.0f})"
            cells.append(text)
        lines.append(f"| `{name}`, {team} | {' | '.join(cells)} |")
    return "\n".join(lines)


def odds_table(runs: list[Path]) -> str:
    """Markdown: the odds of failures that `taichi-sim odds` has stored in the folders of `runs`; empty without any."""
    from rl.evaluation.report.odds import HEAD, row
    from rl.evaluation.store import load_odds

    rows = [[run.name, *row(of)] for run in runs for of in load_odds(run)]
    lines = [("run", *HEAD), ["---"] * (1 + len(HEAD)), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) if rows else ""


def contest(run: Path, args: argparse.Namespace, classical: dict[str, Any]) -> tuple[Any, Any, Any, Any]:
    """Judge a run's policies and the classical controller: scenario, judge, and the episodes of either by team.

    The dictionary `classical` keeps the latter for other runs of the same scenario.
    """
    from rl.evaluation.episodes import judge_episodes, mission_class
    from rl.learn.policy import policies_of
    from rl.learn.policy_sources import given_policies
    from rl.runs.folder import load_config
    from taichi_sim.config.io import toml_text

    config, source = load_config(run, args.overrides)
    given = given_policies(config)
    key = toml_text(config.model_copy(update={"seed": 0, "stages": {}}))

    def judged(controller: str) -> Any:
        policies = {**policies_of(controller, run, config), **(given if controller == "policy" else {})}
        return judge_episodes(
            config, {team: policies[team] for team in config.acting},
            episodes=args.episodes or config.evaluation.episodes,
            seed=config.evaluation.seed if args.seed is None else args.seed,
            controller=controller, source=source, show_progress=not args.quiet,
        ).episodes  # fmt: skip

    learned = judged("policy")
    if key not in classical:
        classical[key] = judged("classical")
    return config, mission_class(config, source).Judge, learned, classical[key]


def table(found: dict[tuple[str, str], list[tuple[str, Any, Any]]], kinds: dict[str, Any]) -> str:
    """Markdown: a row for each run and team, and one for all runs together."""
    lines = []
    for (name, team), rows in found.items():
        judge = kinds[name]
        if not lines:
            lines = [
                "| run, team | " + " | ".join(f"{key}: learned / classical" for key in judge.plotted) + " |",
                "|---" * (1 + len(judge.plotted)) + "|",
            ]
        together = [("all", *(joined([row[k] for row in rows]) for k in (1, 2)))] if len(rows) > 1 else []
        for run, learned, opponent in rows + together:
            times = len(rows) if run == "all" else 1
            cells = [cell(key, judge, learned, opponent, times) for key in judge.plotted]
            lines.append(f"| `{name}`, {team}, {run} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def joined(parts: list[Any]) -> dict[str, Any]:
    """Join the episodes of several runs into one set."""
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def cell(key: str, judge: Any, learned: Any, opponent: Any, times: int) -> str:
    """One figure of both controllers, and their difference (shares, in points, and figures that may be
    negative) or ratio (others), with interval.
    """
    from rl.evaluation.intervals import differences, intervals, ratios

    one, other = intervals(judge, learned)[key].value, intervals(judge, opponent)[key].value
    if one is None or other is None:
        return "-"
    if key in judge.signed:
        middle, low, high = (x or 0.0 for x in differences(judge, learned, opponent, times)[key])
        return f"{one:.3f} / {other:.3f}: {middle:+.3f} ({low:+.3f} to {high:+.3f})"
    if key in judge.shares:
        middle, low, high = (100 * (x or 0.0) for x in differences(judge, learned, opponent, times)[key])
        return f"{100 * one:.1f} / {100 * other:.1f} %: {middle:+.1f} ({low:+.1f} to {high:+.1f})"
    middle, low, high = (x or 0.0 for x in ratios(judge, learned, opponent, times)[key])
    return f"{one:.3f} / {other:.3f}: {middle:.2f} ({low:.2f} to {high:.2f})"


if __name__ == "__main__":
    from rl.commands.shared import run

    sys.exit(run(main))
