"""What the entry points share: arguments, error messages, exit statuses, and the start of Taichi."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from taichi_sim.errors import message
from taichi_sim.options import option, output, positive_float, positive_int, refuse_unwritable, seed

CONTROLLERS = ("policy", "untrained", "classical", "plan", "oracle", "honest")  # see rl.learn.policy.policies_of


def add_common(parser: argparse.ArgumentParser) -> None:
    """Add --set, --threads, --arch and --quiet."""
    parser.add_argument("--set", dest="overrides", metavar="KEY=VALUE", action="append", default=[],
                        help="override a key of the scenario, for example --set usv.count=5; repeatable")  # fmt: skip
    parser.add_argument("--threads", type=positive_int, default=0,
                        help="CPU threads of each process (default: all cores, shared among processes)")  # fmt: skip
    parser.add_argument("--arch", choices=("cpu", "cuda"), default="cpu", help="where kernels run (default: cpu)")
    parser.add_argument("--quiet", action="store_true", help="no progress bars")


def add_processes(parser: argparse.ArgumentParser, shared: str) -> None:
    """Add --processes; `shared` names what the processes share."""
    parser.add_argument(
        "--processes",
        type=positive_int,
        default=None,
        metavar="N",
        help=f"number of processes, started by torchrun's engine, that share the {shared} (default: one for each core "
        "where that is faster; 1 with --threads)",
    )


def agree(config, source: Path) -> None:
    """Refuse processes with different scenarios or versions."""
    from rl.runs import folder as run_folder
    from rl.runs import ranks

    if ranks.here().count > 1:
        of_ranks = ranks.gather(lambda: (run_folder.digest(config, source), config, run_folder.versions()))
        ranks.broadcast(lambda: _refuse_differences(of_ranks))


def _refuse_differences(of_ranks: list) -> None:
    from rl.runs.folder import RunError

    first, config, versions = of_ranks[0]
    for rank, (digest, other, theirs) in enumerate(of_ranks):
        who = f"process {rank} of {len(of_ranks)}"
        for name, version in versions.items():
            if theirs[name] != version:
                raise RunError(
                    f"{who} has {name} {theirs[name]}, process 0 has {version}: all processes need the same version"
                )
        if digest != first:
            ours, its = config.model_dump(mode="json"), other.model_dump(mode="json")
            keys = sorted(key for key in ours.keys() | its.keys() if ours.get(key) != its.get(key))
            differ = ", ".join(keys) or "a vehicle"
            raise RunError(f"{who} has another scenario than process 0: they differ in {differ}")


def tell_corrected(config) -> None:
    """Print a line where classical controllers act with the policies of a scenario."""
    if config.corrected:
        teams = " and ".join(config.corrected)
        print(f"a classical controller acts with the policy of {teams} (residual.velocity > 0)", file=sys.stderr)


def tell_replaced(config, overrides: list[str]) -> None:
    """Print what changed in the scenario with the vehicles that `overrides` have set, once for all processes."""
    from rl.runs import ranks

    if ranks.here().first and any(text.partition("=")[0].strip().endswith(".vehicle") for text in overrides):
        print("\n  ".join(("another vehicle:", *config.replaced)), file=sys.stderr)


def add_run(parser: argparse.ArgumentParser, controllers: Sequence[str] = CONTROLLERS) -> None:
    """Add the arguments of commands on policies: RUN, --policy, --controller, --seed, --config, and the common ones."""
    parser.add_argument("run", type=Path, metavar="RUN",
                        help="run folder of rl/train.py, or a scenario (file, or a shipped one's name)")  # fmt: skip
    parser.add_argument(
        "--policy",
        action="append",
        default=[],
        metavar="[TEAM=]POLICY",
        help="a run's folder, pretrained, FILE.onnx or module:function; repeatable; teams without one act by their "
        "classical controller (default: the run's own policies; for a scenario, pretrained: those of the package)",
    )
    parser.add_argument("--controller", choices=controllers, default="policy",
                        help="controller of the vehicles (default: policy; docs/planning.md)")  # fmt: skip
    parser.add_argument("--seed", type=seed, default=None,
                        help="seed of the held-out episodes (default: the scenario's)")  # fmt: skip
    parser.add_argument("--config", type=Path, default=None, help="run the policies in another scenario")
    add_common(parser)


def is_run(place: Path) -> bool:
    """Whether a command's argument RUN is a run's folder, not a scenario."""
    from rl.runs.folder import CONFIG

    return (place / CONFIG).is_file()


def scenario_of(args: argparse.Namespace):
    """The scenario of the arguments, and its file."""
    from rl.missions import load_scenario
    from rl.runs import folder as run_folder
    from taichi_sim.config import ConfigError
    from taichi_sim.config.io import find_config

    if is_run(args.run):
        return run_folder.load_config(args.run, args.overrides, args.config)
    try:
        source = find_config(args.run)
    except ConfigError as error:
        raise run_folder.RunError(
            f"{args.run}: not a run folder (no {run_folder.CONFIG} in it), nor a scenario: {error}"
        ) from None
    source = source if args.config is None else find_config(args.config)
    return load_scenario(source, args.overrides), source


def open_run(args: argparse.Namespace):
    """Start Taichi; return the scenario of the arguments, its file, the teams' policies, the seed of the episodes."""
    config, source = scenario_of(args)
    tell_replaced(config, args.overrides)
    start(args)
    of_worlds = config.evaluation.seed if args.seed is None else args.seed
    if args.controller == "plan":
        args.controller = "oracle"
    return config, source, controllers_of(args, args.controller, config, source), of_worlds


def controllers_of(args: argparse.Namespace, kind: str, config, source: Path) -> dict:
    """What controls the teams that some stage trains, of `kind` (rl.learn.policy.policies_of): team -> policy."""
    from rl.learn.policy import policies_of
    from rl.learn.policy_sources import given_policies, policies_from
    from rl.runs.folder import RunError
    from rl.scenario import PRETRAINED

    if args.policy and args.controller != "policy":
        raise RunError(f"--policy {args.policy[0]}: --controller {args.controller} controls: leave one of them out")
    if kind == "untrained" and not is_run(args.run):
        raise RunError(f"{args.run}: only a run's folder holds untrained policies")
    if kind == "policy" and not args.policy:
        return policies_from([str(args.run) if is_run(args.run) else PRETRAINED], config)
    found = policies_of("classical" if kind == "policy" else kind, args.run, config)
    if kind in ("policy", "untrained"):
        found |= given_policies(config)
    if kind == "policy":
        given = policies_from(args.policy, config, beside=[source.parent])
        tell_unnamed(given)
        found |= given
    return {name: of for name, of in found.items() if name in config.acting}


def tell_unnamed(policies) -> None:
    """Print a line for each policy that does not name its observations."""
    for team, policy in policies.items():
        if getattr(policy, "named", True) is False:
            told = f"names no observations: its inputs count as those of {team}, in their order"
            print(f"{policy.source}: {told}", file=sys.stderr)


def stores(args: argparse.Namespace) -> bool:
    """Whether this process stores what a run's own policies do in its folder; where it cannot, that is said at once."""
    from rl.runs import ranks

    if args.policy or not is_run(args.run) or not ranks.here().first:
        return False
    try:
        refuse_unwritable(args.run)
        return True
    except OSError as error:
        print(f"{message(error)}: nothing is stored for a report or --worst", file=sys.stderr)
        return False


def open_both(args: argparse.Namespace):
    """Start Taichi; return the controllers that a sweep of `args.run` compares."""
    from rl.evaluation.sweeps import Contest
    from rl.missions import load_scenario
    from rl.runs.folder import RunError

    if not is_run(args.run):
        raise RunError(f"{args.run}: a sweep is written into a run's folder, and this is none")
    config, source = scenario_of(args)
    tell_replaced(config, args.overrides)
    start(args)
    rival: str = {"policy": "classical", "plan": "oracle"}.get(args.controller) or args.controller
    controllers = {kind: controllers_of(args, kind, config, source) for kind in ("policy", rival)}

    def load(overrides: tuple[str, ...]):
        return load_scenario(source, args.overrides, overrides)

    return Contest(args.run, config, source, load, controllers)


def add_shown(parser: argparse.ArgumentParser) -> None:
    """Add --worst, --median and --episode, which repeat an episode of the last evaluation."""
    again = parser.add_mutually_exclusive_group()
    for name in ("worst", "median"):
        again.add_argument(
            f"--{name}",
            dest="shown",
            action="store_const",
            const=name,
            help=f"repeat the {name} episode of the last evaluation (default out: RUN/{name}.rrd)",
        )
    again.add_argument(
        "--episode",
        dest="shown",
        type=int,
        metavar="N",
        help="repeat episode N of the last evaluation, from 0 (default out: RUN/episode-N.rrd)",
    )


def add_film(parser: argparse.ArgumentParser) -> None:
    """Add --film and its options."""

    film = parser.add_argument_group("film", "drawn without a display or a GPU; without --out, no recording is written")
    film.add_argument("--film", type=output, metavar="FILE", help=".mp4 (extra `film`), or animated .png, .gif, .webp")
    film.add_argument("--film-size", type=picture_size, metavar="WxH", help="size in px (default: 640x480)")
    film.add_argument("--film-speed", type=positive_float, metavar="X", help="speed relative to real time (default: 1)")
    film.add_argument("--film-fps", type=positive_float, metavar="N", help="frames/s (default: 25)")
    film.add_argument("--film-view", metavar="VIEW", help="show only 'overview', 'map', or a team")


FILM = {"size": (640, 480), "speed": 1.0, "fps": 25.0, "view": "auto"}


def film_options(args: argparse.Namespace) -> dict[str, Any]:
    """How a film is drawn, by the arguments of `add_film`."""
    from rl.runs.folder import RunError

    given = {name: value for name in FILM if (value := getattr(args, f"film_{name}")) is not None}
    if given and not args.film:
        raise RunError(f"--film-{next(iter(given))}: there is no --film FILE to draw")
    return FILM | given


def _size(text: str) -> tuple[int, int]:
    wide, high = text.lower().split("x")
    return int(wide), int(high)


picture_size = option(
    _size,
    lambda size: 64 <= size[0] <= 4096 and 48 <= size[1] <= 4096,
    "wanted WIDTHxHEIGHT from 64x48 to 4096x4096, for example 1280x720",
)


def recall(args: argparse.Namespace) -> tuple[int, int] | None:
    """Set the conditions of the evaluation that --worst, --median or --episode repeats.

    Returns the number of the episode and the number of all episodes; None without any of these.
    """
    from rl.evaluation.store import shown_episode
    from rl.runs.folder import RunError

    if args.shown is None:
        return None
    asked = f"--{args.shown}" if isinstance(args.shown, str) else "--episode"
    if args.policy or not is_run(args.run):
        raise RunError(f"{asked} repeats an episode of a run's evaluation: give a run's folder alone")
    if args.overrides or args.config or args.seed is not None:
        raise RunError(f"{asked} repeats an episode as it was evaluated: leave out --config, --seed and --set")
    found, number = shown_episode(args.run, args.controller, args.shown)
    args.config = None if found.conditions.config is None else Path(found.conditions.config)
    args.overrides, args.seed = list(found.conditions.overrides), found.result["seed"]
    return number, found.result["episodes"]


def start(args: argparse.Namespace) -> None:
    """Start Taichi and torch with the threads and device of the arguments."""
    import torch

    from rl.runs import ranks
    from taichi_sim.kernels import runtime

    place = ranks.here()
    if args.arch == "cuda" and place.local_count > 1:
        os.environ.setdefault("CUDA_VISIBLE_DEVICES", str(place.local_rank))  # before CUDA starts
    threads = args.threads or (ranks.cores() if place.local_count > 1 else 0)
    runtime.init(arch=args.arch, threads=threads)
    if threads:
        torch.set_num_threads(threads)


def run(main: Callable[[list[str] | None], None], argv: list[str] | None = None) -> int:
    """Run an entry point and return its exit status.

    The status is 0, 1 after an error of the user (printed as one message), 130 after Ctrl-C, 143 after SIGTERM. A
    process that torchrun started also writes the reason of a failure to a file (rl/runs/torchrun.py).
    """
    from rl.runs import signals

    if "TORCHELASTIC_RUN_ID" in os.environ:
        from rl.runs import torchrun

        return torchrun.run_worker(main, argv)
    with signals.sigterm_as_interrupt():
        try:
            main(argv)
            return 0
        except KeyboardInterrupt as interrupt:
            print(f"\ninterrupted{': ' * bool(str(interrupt))}{interrupt}", file=sys.stderr)
            return signals.status(interrupt)
        except Exception as error:
            text = message(error)
            if text is None:
                raise
            print(f"error: {text}", file=sys.stderr)
            return 1


def script(main: Callable[[list[str] | None], None]) -> None:
    """Run an entry point as a script and exit; signals during the exit are ignored."""
    from rl.runs import signals

    status = run(main)
    signals.ignore()
    sys.exit(status)
