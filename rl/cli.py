"""What the entry points share: arguments, clear endings, and where Taichi is started."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path


def add_common(parser: argparse.ArgumentParser) -> None:
    """Add --set, --threads, --arch and --quiet."""
    parser.add_argument(
        "--set",
        dest="overrides",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="override a key of the scenario, for example --set usv.count=5; may be given several times",
    )
    parser.add_argument("--threads", type=positive_int, default=0, help="CPU threads (default: all cores)")
    parser.add_argument("--arch", choices=("cpu", "cuda"), default="cpu", help="where kernels run (default: cpu)")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add what commands about a finished run share: RUN, --controller, --seed, --config, and the common ones."""
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder of rl/train.py")
    parser.add_argument("--controller", choices=("policy", "classical"), default="policy")
    parser.add_argument("--seed", type=seed, default=None, help="of the unseen worlds (default: the scenario's)")
    parser.add_argument("--config", type=Path, default=None, help="another scenario for the run's policies")
    add_common(parser)


def open_run(args: argparse.Namespace):
    """The scenario of `args.run`, its file, a controller for each team, and the seed; Taichi is running then."""
    from rl.learn.policy import policies_of
    from rl.runs import folder as run_folder

    config, source = run_folder.load_config(args.run, args.overrides, args.config)
    start(args)
    of_worlds = config.evaluation.seed if args.seed is None else args.seed
    found = policies_of(args.controller, args.run, config)
    policies = {name: of for name, of in found.items() if name in config.trained}
    return config, source, policies, of_worlds


def open_both(args: argparse.Namespace):
    """What a sweep compares of `args.run` (rl.runs.sweep.run.Contest); Taichi is running then."""
    from rl.learn.policy import policies_of
    from rl.missions import load_scenario
    from rl.runs import folder as run_folder
    from rl.runs.sweep.run import Contest

    config, source = run_folder.load_config(args.run, args.overrides, args.config)
    start(args)
    found = {kind: policies_of(kind, args.run, config) for kind in ("policy", "classical")}
    controllers = {kind: {t: p for t, p in of.items() if t in config.trained} for kind, of in found.items()}

    def load(overrides: tuple[str, ...]):
        return load_scenario(source, args.overrides, overrides)

    return Contest(args.run, config, source, load, controllers)


def add_shown(parser: argparse.ArgumentParser) -> None:
    """Add --worst and --median: an episode of the last evaluation, run again."""
    again = parser.add_mutually_exclusive_group()
    for name in ("worst", "median"):
        again.add_argument(
            f"--{name}",
            dest="shown",
            action="store_const",
            const=name,
            help=f"the {name} episode of the last evaluation, run again (default out: RUN/{name}.rrd)",
        )


def recall(args: argparse.Namespace) -> tuple[int, int] | None:
    """Set the conditions of the evaluation that `args.shown` is of; number of that episode, and of all.

    Raises:
        RunError: if there was no evaluation, or other conditions are given.
    """
    from rl.runs.folder import RunError
    from rl.runs.kept import shown_episode

    if args.shown is None:
        return None
    if args.overrides or args.config or args.seed is not None:
        raise RunError(
            f"--{args.shown} runs an episode again as it was evaluated: leave out --config, --seed and --set"
        )
    found, number = shown_episode(args.run, args.controller, args.shown)
    args.config = None if found.conditions.config is None else Path(found.conditions.config)
    args.overrides, args.seed = list(found.conditions.overrides), found.result["seed"]
    return number, found.result["episodes"]


def start(args: argparse.Namespace) -> None:
    """Start Taichi and torch as the arguments say."""
    import torch

    from taichi_sim import runtime

    runtime.init(arch=args.arch, threads=args.threads)
    if args.threads:
        torch.set_num_threads(args.threads)


def positive_int(text: str) -> int:
    """An argparse type: a whole number of at least 1."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: must be at least 1")
    return value


def positive_float(text: str) -> float:
    """An argparse type: a number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: must be above 0")
    return value


def seed(text: str) -> int:
    """An argparse type: a seed."""
    value = int(text)
    if not 0 <= value < 2**31:
        raise argparse.ArgumentTypeError(f"{text}: a seed is from 0 to 2147483647")
    return value


def user_errors() -> tuple[type[Exception], ...]:
    """Exceptions that are a user's mistake: their message says all."""
    from rl.learn.policy import CheckpointError
    from rl.learn.runner import DivergedError
    from rl.mission import ControllerError
    from rl.runs.folder import RunError
    from taichi_sim.config import ConfigError
    from taichi_sim.extras import MissingExtraError
    from taichi_sim.sea import SteepSeaError
    from taichi_sim.world import ActionError

    wrong_input = ConfigError, ActionError, SteepSeaError
    return *wrong_input, ControllerError, RunError, CheckpointError, DivergedError, MissingExtraError


def run(main: Callable[[list[str] | None], None], argv: list[str] | None = None) -> int:
    """Run an entry point; a user's mistake ends in one message and status 1, Ctrl-C in status 130."""
    try:
        main(argv)
        return 0
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        print(f"error: {place}{error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt as interrupt:
        print(f"\ninterrupted{': ' if str(interrupt) else ''}{interrupt}", file=sys.stderr)
        return 130
    except Exception as error:
        if not isinstance(error, user_errors()):
            raise
        print(f"error: {error}", file=sys.stderr)
        return 1
