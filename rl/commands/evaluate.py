"""Evaluate a run's policies or a classical controller on held-out episodes, and print the figures as JSON."""

import argparse
import json
import sys
from contextlib import nullcontext
from pathlib import Path

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared
    from rl.missions import find_mission, shipped
    from taichi_sim.options import output, positive_int, table

    p = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="figures of each team, measured after the first evaluation.settle of each episode\n"
        + "\n".join(
            f"of the mission {name!r}:\n"
            + "\n".join(f"  {key}:\n      {text}" for key, text in find_mission(name).Judge.definitions.items())
            for name in shipped()
        ),
    )
    shared.add_run(p)
    p.add_argument("--episodes", type=positive_int, default=None, help="number of episodes (default: the scenario's)")
    p.add_argument("--json", type=output, default=None, metavar="FILE", help="write the figures to FILE, not to stdout")
    p.add_argument(
        "--export",
        type=table,
        default=None,
        metavar="FILE",
        help="write vehicles' motion to FILE (.parquet or .csv), and conditions and figures of each episode beside it",
    )
    p.add_argument(
        "--sweep",
        default=None,
        metavar="FILE",
        help="evaluate the policy and --controller (default: classical) on the same episodes under each condition of a "
        "sweep: FILE, or a name in configs/sweeps, such as default; an interrupted sweep continues",
    )
    shared.add_processes(p, "episodes (by 256), or the conditions of a sweep,")
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.runs import ranks, torchrun

    if (number := torchrun.process_count(args.processes, args.threads, units(args), args.arch, enough=1)) > 1:
        torchrun.run(Path(__file__), sys.argv[1:] if argv is None else argv, number)
        return
    with ranks.joined(args.arch):
        (sweep if args.sweep else evaluate)(args)


def units(args: argparse.Namespace) -> int:
    """Number of parts of the work that processes can share."""
    from rl.commands import shared
    from rl.evaluation.episodes import CHUNK
    from rl.evaluation.sweeps import count_cells, find_sweep, load_sweep
    from rl.runs import folder as run_folder

    config, _ = shared.scenario_of(args)
    if not args.sweep:
        return 1 if args.export else -(-(args.episodes or config.evaluation.episodes) // CHUNK)  # one writes the table
    if args.json or args.export:
        raise run_folder.RunError("--sweep writes its own tables: leave out --json and --export")
    return count_cells(load_sweep(find_sweep(args.sweep), episodes=args.episodes, seed=args.seed))


def evaluate(args: argparse.Namespace) -> None:
    """Evaluate; rank 0 prints the figures, writes them to --json, and stores them in the run's folder."""
    from rl.commands import shared
    from rl.evaluation.episodes import EvaluationOutcome, Trial, judge_trials, told
    from rl.evaluation.export import export_conditions, exported
    from rl.evaluation.store import save_evaluation
    from rl.runs import folder as run_folder

    config, source, policies, seed = shared.open_run(args)
    shared.agree(config, source)
    stored = shared.stores(args)
    trial = Trial(config, policies, args.episodes or config.evaluation.episodes, seed, args.controller, source)
    with exported(args.export) if args.export else nullcontext() as export:
        watch = export.chunk if export else None
        outcomes = judge_trials([trial], show_progress=not args.quiet, excerpts=True, watch=watch)
    for outcome in outcomes:
        assert isinstance(outcome, EvaluationOutcome)  # judge_trials raises all errors
        if args.export:
            beside = export_conditions(args.export, outcome.conditions, outcome.episodes)
            print(f"export: {args.export}, {beside}", file=sys.stderr)
        if args.controller == "policy":
            shared.tell_corrected(config)
        print(told(outcome.result, config, source), file=sys.stderr)
        for team, policy in policies.items():
            if (price := getattr(policy, "price", None)) is not None:
                print(f"  {team}: {price:.2f} s of computation for each second of an episode", file=sys.stderr)
        if args.json:
            run_folder.write_json(args.json, outcome.result)
        else:
            print(json.dumps(outcome.result, indent=2))
        if stored:
            save_evaluation(args.run, outcome, args.config, args.overrides)


def sweep(args: argparse.Namespace) -> None:
    """Run --sweep and rewrite the run's report."""
    from rl.commands import shared
    from rl.evaluation.report import write_report
    from rl.evaluation.sweeps import find_sweep, load_sweep, run_sweep
    from rl.runs import ranks

    file = find_sweep(args.sweep)
    wanted, contest = load_sweep(file, episodes=args.episodes, seed=args.seed), shared.open_both(args)
    shared.agree(contest.config, contest.source)
    out = run_sweep(wanted, file, contest, show_progress=not args.quiet)
    if ranks.here().first:
        print(f"sweep:  {out}\nreport: {write_report([args.run])}")


if __name__ == "__main__":
    from rl.commands.shared import script

    script(main)
