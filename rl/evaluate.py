"""Evaluate a run's policies, or a classical controller, on episodes never trained on, and print the figures."""

import argparse
import json
import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl import cli
    from rl.missions import find_mission, shipped

    p = argparse.ArgumentParser(
        prog="evaluate.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="figures, for each team, measured after the first evaluation.settle (20 s) of each episode\n"
        + "\n".join(
            f"of the mission {name!r}:\n"
            + "\n".join(f"  {key}:\n      {text}" for key, text in find_mission(name).Judge.definitions.items())
            for name in shipped()
        ),
    )
    cli.add_run(p)
    p.add_argument("--episodes", type=cli.positive_int, default=None, help="default: the scenario's (256)")
    p.add_argument("--json", type=Path, default=None, metavar="FILE", help="also write the figures to FILE")
    p.add_argument(
        "--sweep",
        default=None,
        metavar="FILE",
        help="policy and classical controller on the same episodes under each condition of a sweep "
        "(configs/sweeps/*.toml, by name: default); an interrupted one goes on",
    )
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl import cli
    from rl.runs import folder as run_folder
    from rl.runs.evaluation import judge_episodes
    from rl.runs.kept import keep
    from rl.runs.main_job import report

    if args.sweep:
        sweep(args)
        return
    config, source, policies, seed = cli.open_run(args)
    outcome = judge_episodes(
        config,
        policies,
        episodes=args.episodes or config.evaluation.episodes,
        seed=seed,
        controller=args.controller,
        source=source,
        show_progress=not args.quiet,
        look=True,
    )
    print(report(outcome.result, config, source), file=sys.stderr)
    print(json.dumps(outcome.result, indent=2))
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        run_folder.write_json(args.json, outcome.result)
    try:
        keep(args.run, outcome, args.config, args.overrides)
    except OSError as error:  # somebody else's run may be read-only
        print(f"not kept for a report or --worst: {error}", file=sys.stderr)


def sweep(args: argparse.Namespace) -> None:
    """Run --sweep, and write the run's report anew."""
    from rl import cli
    from rl.runs.folder import RunError
    from rl.runs.report import write_report
    from rl.runs.sweep.config import find_sweep, load_sweep
    from rl.runs.sweep.run import run_sweep

    if args.controller != "policy" or args.json:
        raise RunError(
            "--sweep compares both controllers, and writes its own tables: leave out --controller and --json"
        )
    file = find_sweep(args.sweep)
    wanted = load_sweep(file, episodes=args.episodes, seed=args.seed)
    out = run_sweep(wanted, file, cli.open_both(args), show_progress=not args.quiet)
    print(f"sweep:  {out}\nreport: {write_report([args.run])}")


if __name__ == "__main__":
    from rl.cli import run

    sys.exit(run(main))
