"""Train the teams of a scenario stage by stage, evaluate them on held-out episodes, record and draw an episode."""

import argparse
import contextlib
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rl.scenario import Scenario

if __package__ in (None, ""):  # run as a script: the packages are beside this file's folder
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared
    from taichi_sim.options import port, seed

    p = argparse.ArgumentParser(
        description=__doc__,
        epilog="With no argument it runs the main job: configs/cruise.toml. Ctrl-C saves a checkpoint; --resume "
        "continues. Watch the curves with: tensorboard --logdir runs. On several machines: "
        "torchrun --nnodes=2 --nproc-per-node=8 --rdzv-backend=c10d --rdzv-endpoint=HOST:PORT --rdzv-id=NAME "
        "rl/train.py ...; with --nnodes=1:2 machines may come and go.",
    )
    p.add_argument("--config", default=None, metavar="FILE", help="scenario (default: configs/cruise.toml)")
    p.add_argument("--out", type=Path, default=None, help="run folder (default: runs/SCENARIO-DATE-TIME)")
    p.add_argument("--seed", type=seed, default=None, help="seed of the run (default: the scenario's)")
    p.add_argument("--resume", action="store_true", help="continue the run in --out (default: the newest in runs/)")
    p.add_argument("--watch", action="store_true", help="show the training in a rerun viewer on this machine")
    p.add_argument("--port", type=port, default=9876, help="port of --watch (default: %(default)s)")
    p.add_argument("--logger", choices=("tensorboard", "wandb", "none"), default="tensorboard",
                   help="where curves go besides files (default: %(default)s; wandb: extra `wandb`)")  # fmt: skip
    p.add_argument("--no-evaluation", action="store_true",
                   help="end when training ends; --resume then evaluates, records and reports")  # fmt: skip
    shared.add_common(p)
    shared.add_processes(p, "stages' environments")
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.commands import shared
    from rl.runs import folder as run_folder
    from rl.runs import ranks, torchrun
    from taichi_sim.errors import needs

    if args.logger == "wandb":
        with needs("wandb", "wandb"):
            import wandb  # noqa: F401  # pyright: ignore[reportMissingImports]
    if args.watch and ranks.here().first and not torchrun.launched():
        from rl.runs.watch import refuse_used

        refuse_used(args.port)
    config, source, out = run_of(args)
    fewest = min((stage.num_envs for stage in config.stages.values()), default=1)
    if (number := torchrun.process_count(args.processes, args.threads, fewest, args.arch)) > 1:
        if not args.resume:
            run_folder.refuse_existing(out)
        torchrun.run(Path(__file__), [*(sys.argv[1:] if argv is None else argv), "--out", str(out)], number)
        return
    from rl.evaluation.episodes import told
    from rl.runs.main_job import FIGURES, run_main_job
    from rl.runs.watch import training_view

    with ranks.joined(args.arch) as place:
        shared.agree(config, source)
        if not args.resume:
            ranks.broadcast(lambda: run_folder.begin(out, config, source))
            config, source = run_folder.load_config(out)  # its copies, whatever becomes of the files they were made of
        with contextlib.ExitStack() as held:
            if place.first:
                held.enter_context(run_folder.lock(out))
                if args.resume and args.overrides:
                    run_folder.keep_changes(out, args.overrides)
            watch = held.enter_context(training_view(args.watch and place.first, args.port))
            shared.start(args)
            if place.first:
                print(f"run folder: {out}")
                shared.tell_corrected(config)
                shared.tell_replaced(config, args.overrides)
            summary = run_main_job(
                config, out, show_progress=not args.quiet, watch=watch, logger=args.logger,
                evaluated=not args.no_evaluation,
            )  # fmt: skip
            if place.first and args.no_evaluation:
                print(f"trained; evaluate it by: {run_folder.resuming(out)}")
    if summary is None:
        return
    print(told(summary["evaluation"], config, source))
    print(f"summary:   {out / 'summary.json'}")
    if (out / FIGURES).exists():
        print(f"figures:   {out / FIGURES}")
    print(f"report:    {out / 'report.html'}")
    print(f"recording: {shlex.join(('rerun', str(out / 'episode.rrd')))}")


def run_of(args: argparse.Namespace) -> tuple["Scenario", Path, Path]:
    """The scenario of the arguments, its file, and the run's folder."""
    from rl.missions import load_scenario
    from rl.runs import folder as run_folder
    from rl.runs import ranks
    from taichi_sim.config.io import find_config

    overrides = args.overrides + ([f"seed={args.seed}"] if args.seed is not None else [])
    if args.resume:
        out = args.out or run_folder.newest(Path("runs"))
        config, source = run_folder.continued(out, args.config, overrides)
        if not ranks.engine() and (other := run_folder.other_versions(out)):
            print(f"warning: {other}: its figures will not be the same as without the change", file=sys.stderr)
        return config, source, out
    source = find_config(args.config or "configs/cruise.toml")
    config = load_scenario(source, overrides)
    name = ranks.engine() or time.strftime("%Y%m%d-%H%M%S")
    if args.out is None and name == "none":  # torchrun's default
        raise run_folder.RunError("several machines need one run folder: give --out, or torchrun's --rdzv-id")
    return config, source, args.out or Path("runs") / f"{config.name}-{name}"


if __name__ == "__main__":
    from rl.commands.shared import script

    script(main)
