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
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl import cli
    from rl.runs import folder as run_folder
    from rl.runs.evaluation import evaluate
    from rl.runs.main_job import report

    config, source, policies, seed = cli.open_run(args)
    result = evaluate(
        config,
        policies,
        episodes=args.episodes or config.evaluation.episodes,
        seed=seed,
        controller=args.controller,
        source=source,
        show_progress=not args.quiet,
    )
    print(report(result, config, source), file=sys.stderr)
    print(json.dumps(result, indent=2))
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        run_folder.write_json(args.json, result)


if __name__ == "__main__":
    from rl.cli import run

    sys.exit(run(main))
