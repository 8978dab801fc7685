"""Train the teams of a scenario stage by stage, evaluate them on unseen worlds, record and draw an episode."""

import argparse
import sys
import time
from pathlib import Path

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl import cli

    p = argparse.ArgumentParser(
        prog="train.py",
        description=__doc__,
        epilog="With no argument it runs the main job: configs/escort.toml. Ctrl-C saves a checkpoint; --resume "
        "continues. Watch the curves with: tensorboard --logdir runs",
    )
    p.add_argument("--config", default=None, metavar="FILE", help="scenario (default: configs/escort.toml)")
    p.add_argument("--out", type=Path, default=None, help="run folder (default: runs/SCENARIO-DATE-TIME)")
    p.add_argument("--seed", type=cli.seed, default=None, help="seed of the run (default: the scenario's)")
    p.add_argument("--resume", action="store_true", help="continue the run in --out (default: the newest in runs/)")
    p.add_argument("--watch", action="store_true", help="show the training in a rerun viewer, on this machine alone")
    p.add_argument("--port", type=cli.positive_int, default=9876, help="of --watch (default: %(default)s)")
    cli.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl import cli
    from rl.missions import load_scenario
    from rl.runs import folder as run_folder
    from rl.runs.main_job import report, run_main_job
    from rl.runs.watch import refuse_used, watching
    from taichi_sim.config.io import find_config

    if args.watch:
        refuse_used(args.port)
    overrides = args.overrides + ([f"seed={args.seed}"] if args.seed is not None else [])
    if args.resume:
        out = args.out or run_folder.newest(Path("runs"))
        run_folder.refuse_changes(args.config, overrides)
        config, _ = run_folder.load_config(out)
    else:
        source = find_config(args.config or "configs/escort.toml")
        config = load_scenario(source, overrides)
        out = args.out or Path("runs") / f"{config.name}-{time.strftime('%Y%m%d-%H%M%S')}"
        run_folder.create(out, config, source)
    with run_folder.lock(out), watching(args.watch, args.port) as watch:
        cli.start(args)
        print(f"run folder: {out}")
        summary = run_main_job(config, out, show_progress=not args.quiet, watch=watch)
    print(report(summary["evaluation"], config, out / run_folder.CONFIG))
    print(f"summary:   {out / 'summary.json'}\nfigures:   {out / 'figures'}")
    print(f"report:    {out / 'report.html'}\nrecording: rerun {out / 'episode.rrd'}")


if __name__ == "__main__":
    from rl.cli import run

    sys.exit(run(main))
