"""Record one held-out episode of a run's policies: for rerun, as a film, or as a ROS 2 bag."""

import argparse
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path

from rl.commands import shared
from taichi_sim.options import port, positive_float, refuse_unwritable


def title(controller: str) -> str:
    """What a film of two controllers calls one of them."""
    return "trained" if controller == "policy" else controller


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command's arguments."""
    p = argparse.ArgumentParser(description=__doc__)
    shared.add_run(p)
    shared.add_shown(p)
    p.add_argument(
        "--out",
        default=None,
        metavar="PLACE",
        help="FILE.rrd for rerun, FILE.mcap for ROS 2 and Foxglove, FOLDER/ for a rosbag2 folder (a name without a "
        "suffix, or one that ends with a slash); default: RUN/play-SEED.rrd, or SCENARIO-SEED.rrd here",
    )
    p.add_argument(
        "--origin",
        type=float,
        nargs=2,
        default=None,
        metavar=("LAT", "LON"),
        help="latitude and longitude of the origin of a bag, or of --ros, degrees (default: 63.48 10.40)",
    )
    other = p.add_mutually_exclusive_group()
    for name, text in (("beside", "on the left"), ("ghost", "as pale vehicles in the same scene")):
        other.add_argument(f"--{name}", choices=shared.CONTROLLERS, default=None,
                           help=f"show the same episode with this controller {text}")  # fmt: skip
    shared.add_film(p)
    p.add_argument("--live", action="store_true", help="show the episode in a rerun viewer while it is simulated")
    p.add_argument("--ros", action="store_true",
                   help="be a node of ROS 2: the topics of a bag in real time, and commands in")  # fmt: skip
    p.add_argument(
        "--web",
        type=port,
        nargs="?",
        const=9090,
        default=None,
        metavar="PORT",
        help="then serve the recording to browsers on this machine until Ctrl-C (default port: 9090)",
    )
    p.add_argument("--speed", type=positive_float, default=1.0,
                   help="speed of --live or --ros relative to real time (default: 1)")  # fmt: skip
    p.add_argument("--port", type=port, default=9876,
                   help="port of --live, and of the data of --web (default: %(default)s)")  # fmt: skip
    p.add_argument("--duration", type=positive_float, default=None, metavar="S",
                   help="duration, s (default: the scenario's episode)")  # fmt: skip
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.evaluation.episode_recording import output_of, record_episode
    from rl.evaluation.store import recording_name
    from rl.runs.folder import RunError
    from rl.runs.ros_node import ros_node
    from rl.runs.watch import episode_view, refuse_used
    from taichi_sim.visualisation.film.files import check_film, write_film
    from taichi_sim.visualisation.recording import Episode
    from taichi_sim.visualisation.recording.east_north_up import FJORD, Origin
    from taichi_sim.visualisation.recording.live import serve_web

    output = output_of(args.out, None if args.ros else args.origin, show_progress=not args.quiet)
    given = {"beside": args.beside, "ghost": args.ghost, "web": args.web}
    name, other = next(((name, value) for name, value in given.items() if value), ("", None))
    if other and (output.reader != "rerun" or (args.film and args.out is None and not args.beside)):
        raise RunError(f"--{name}: needs a recording for rerun: --out FILE.rrd")
    if (args.beside or args.ghost) == args.controller:
        raise RunError(f"--{name} {other}: that is what --controller shows already; give another controller")
    for used in ([args.port] if args.live or args.web else []) + ([args.web] if args.web else []):
        refuse_used(used)
    number = shared.recall(args)
    config, source, policies, seed = shared.open_run(args)
    place = args.run / (f"play-{seed}.rrd" if number is None else recording_name(args.controller, args.shown))
    if not shared.is_run(args.run):
        place = Path(f"{config.name}-{seed}.rrd")
    if args.out is None and not args.film:
        refuse_unwritable(place)
    how = shared.film_options(args)
    if args.film:
        check_film(args.film, **how, teams=config.teams, columns=2 if args.beside else 1)
    record = partial(
        record_episode, config, seed=seed, number=number, duration=args.duration, source=source,
        show_progress=not args.quiet,
    )  # fmt: skip
    if args.ros:
        with ros_node(Origin(*args.origin) if args.origin else FJORD, args.speed) as seen:
            episode = record(seen.listening(policies), seen=seen)
    else:
        with episode_view(args.live, args.port, args.speed) as seen:
            episode = record(policies, seen=seen)
    for event in episode.events:
        print(f"{event.time_s:7.1f} s  {event.text}")
    shown: Episode | dict[str, Episode] = episode
    if args.beside is not None:
        other = record(shared.controllers_of(args, args.beside, config, source))
        shown = {title(args.beside): other, title(args.controller): episode}
    if args.ghost is not None:
        shown = replace(episode, ghost=record(shared.controllers_of(args, args.ghost, config, source)))
    if args.film:
        print(f"film: {write_film(shown, args.film, **how, show_progress=not args.quiet)}")
        if args.out is None:
            return
    path = output.write(shown, output.place or place)
    print(f"recording: {output.reader} {shlex.quote(str(path))}")
    if args.web:
        server, url = serve_web(path, args.port, args.web)
        print(f"web: {url} (Ctrl-C ends)", flush=True)
        server.wait()
