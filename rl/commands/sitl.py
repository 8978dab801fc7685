"""Be the physics of several ArduPilots: a scenario's world, some of whose vehicles they drive, in lockstep.

    taichi-sim sitl SCENARIO --autopilot TEAM.NUMBER=PORT ... [options]

    taichi-sim sitl otter --autopilot usv.0=9002 usv.1=9012         # sim_vehicle -v Rover --model JSON -I 0; -I 1
    taichi-sim sitl landing --autopilot uav.0=9002 --on-deck        # a copter begins on the deck of a boat under way
    taichi-sim sitl otter --autopilot usv.0=9002 --controller RUN   # the others by the policies of a run
    taichi-sim sitl encounter --autopilot usv.0=9002 --ais udp:127.0.0.1:14570    # among ships

Vehicles without an autopilot are driven by their classical controller, a run's policy, or not at all. Ctrl-C ends it.
A scenario needs --autopilot. Without it, the argument is a VEHICLE: taichi-sim sitl --help. All else: docs/sitl.md.
"""

import argparse
import sys
import time
from contextlib import ExitStack, closing

from rl.commands import shared
from taichi_sim.errors import refuse
from taichi_sim.options import address, output, parser_of, port, positive_float, seed

AUTOPILOT = "--autopilot"
PRINT_EVERY = 5.0  # s between lines of progress
HOME = -35.363262, 149.165237  # deg, of ArduPilot's SITL without another
PART = 0.5  # s of motion that a live view shows at a time
FIRST_PART = 3.0  # s of its first one, which sets its layout


def parser() -> argparse.ArgumentParser:
    """The parser of the arguments of a world."""
    p = parser_of(__doc__, "taichi-sim sitl")
    p.add_argument("config", metavar="SCENARIO", help="a file, or the name of a shipped scenario")
    p.add_argument(AUTOPILOT, nargs="*", action="extend", default=[], metavar="TEAM.N=PORT",
                   help="vehicles that autopilots drive, and the UDP port of each")  # fmt: skip
    p.add_argument("--controller", default="classical", metavar="WHO",
                   help="drives the others: classical, zero (all 0), pretrained, a run folder [classical]")  # fmt: skip
    p.add_argument("--on-deck", action="store_true", help="copters with an autopilot begin on the decks of vessels")
    p.add_argument("--rate", type=positive_float, default=400.0, metavar="HZ",
                   help="steps of the world per second; an output acts at most one step late [400]")  # fmt: skip
    p.add_argument("--address", type=address, default="127.0.0.1", help="to listen on [127.0.0.1: this machine only]")
    p.add_argument("--timeout", type=positive_float, default=0.0, metavar="S",
                   help="end when an autopilot has been silent for so long [never: the world waits]")  # fmt: skip
    p.add_argument("--ais", metavar="ADDRESS", help="tell ships of an encounter there, as AIS_VESSEL: udp:ADDRESS:PORT")
    p.add_argument("--home", type=float, nargs=2, metavar=("LAT", "LON"), default=None,
                   help="of the autopilots, for --ais [where ArduPilot's SITL begins]")  # fmt: skip
    p.add_argument("--seed", type=seed, help="of the held-out episode [the scenario's]")
    p.add_argument("--log", type=output, metavar="FILE.csv",
                   help="a CSV of all frames of each autopilot, with its vehicle in the name")  # fmt: skip
    p.add_argument("--record", metavar="PLACE", help="a recording: FILE.rrd, FILE.mcap or FOLDER/, as of `play`")
    p.add_argument("--live", action="store_true", help="show it in a rerun viewer as it moves")
    p.add_argument("--live-port", type=port, default=9876, metavar="PORT", help="of the view [9876]")
    p.add_argument("--duration", type=positive_float, metavar="S",
                   help="end after this much simulated time [never]")  # fmt: skip
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    given = sys.argv[1:] if argv is None else argv
    if AUTOPILOT not in given:
        from taichi_sim.applications.commands import sitl

        sys.exit(sitl.main(given))
    serve(parser().parse_args(given))


def serve(args: argparse.Namespace) -> None:
    """Let the world go on until Ctrl-C, or for --duration; then write the recording."""
    from rl.evaluation.episode_recording import EpisodeReel, events_of, output_of
    from rl.missions import load_scenario
    from rl.runs.autopilots import decks_for, others, read_autopilots, shared_mission
    from taichi_sim.applications.commands.sitl import logger
    from taichi_sim.applications.sitl.lockstep import LockstepWorld, Station
    from taichi_sim.config import ConfigError
    from taichi_sim.config.io import find_config
    from taichi_sim.kernels import runtime
    from taichi_sim.visualisation.recording.live import Live

    source = find_config(args.config)
    config = load_scenario(source, args.overrides)
    shared.tell_replaced(config, args.overrides)
    places = read_autopilots(args.autopilot, config)
    refuse(
        ConfigError,
        (args.home and not args.ais, "--home is where --ais tells ships: give that, too"),
        (not places, "--autopilot: name at least one vehicle, for example --autopilot usv.0=9002"),
    )
    written = None if args.record is None else output_of(args.record)
    args.threads = args.threads or 1
    shared.start(args)
    seed = config.evaluation.seed if args.seed is None else args.seed
    mission = shared_mission(config, list(places), seed=seed, rate=args.rate, source=source)
    policies = others(args.controller, mission, list(places))
    decks = decks_for(mission, list(places)) if args.on_deck else {}
    world = mission.world
    assert isinstance(world, LockstepWorld)
    with ExitStack() as open_things:
        station = open_things.enter_context(
            closing(Station(world, places, decks, address=args.address, timeout=args.timeout, tell=tell))
        )
        mission.measure_anew()
        if mission.origin is not None:
            tell("the route is where its file says, for autopilots with home {:.7f},{:.7f}".format(*mission.origin))
        teller = open_things.enter_context(closing(teller_of(args, mission))) if args.ais else None
        live = open_things.enter_context(Live("sitl", port=args.live_port)) if args.live else None
        if live is not None:
            tell(live.told)
        for session in station.sessions:
            if args.log is not None:
                file = args.log.with_stem(f"{args.log.stem}-{session.craft.name}")
                session.seen.append(logger(open_things.enter_context(file.open("w", newline=""))))
            craft = session.craft
            driven = ", ".join(f"{abs(c)}{' reversed' if c < 0 else ''} {name}" for name, c in craft.channels.items())
            tell(f"{craft.name} on {args.address}:{places[craft.team, craft.number]}, channels {driven}")
        reel, shown = EpisodeReel(mission), EpisodeReel(mission)
        # There is no time limit, and to stand on a deck from the beginning is no landing.
        known = {(name, k, "late") for name, team in mission.teams.items() for k in range(team.fleet.count)}
        known |= {(*vehicle, "landed") for vehicle in decks}
        events, count = [], 0
        begun = printed = time.monotonic()
        try:
            with runtime.torch_at_rest():
                while not args.duration or count * config.decision_interval < args.duration - 1e-9:
                    step = mission.step({name: policies[name] for name in mission.teams}, begin=False, observe=())
                    count += 1
                    if teller is not None:
                        teller()
                    touches = {(name, k): world.teams[name].touch for name, k in decks}
                    known -= {(*v, "landed") for v, of in touches.items() if of is not None and not of.on[0, v[1]]}
                    new = events_of(step, count * config.decision_interval, known, mission.Judge.goals, 0)
                    events += new
                    for event in new:
                        tell(f"t {event.time_s:.1f} s: {event.text}")
                    if written is not None:
                        reel.add(step)
                    if live is not None:
                        shown.add(step)
                        if len(shown) * config.decision_interval >= (FIRST_PART if live.like is None else PART):
                            live.show(shown.part(like=live.like))
                    if not args.quiet and time.monotonic() - printed > PRINT_EVERY:
                        printed = time.monotonic()
                        for session in station.sessions:
                            tell(f"{session.craft.name}: {session.state(printed - begun)}")
        except KeyboardInterrupt:
            tell("ended")
        finally:
            if written is not None and written.place is not None and len(reel):
                tell(f"recording: {written.write(reel.episode(events=events), written.place)}")


def teller_of(args: argparse.Namespace, mission):
    """What tells the ships of the mission, an encounter, as --ais says."""
    from rl.adapters.pilot.ais import Teller
    from rl.adapters.pilot.connections import read_address
    from rl.missions.encounter.mission import Encounter
    from taichi_sim.config import ConfigError
    from taichi_sim.visualisation.recording.east_north_up import Origin

    to, config = read_address(args.ais), mission.config
    north, east = args.home or (0.0, 0.0)
    refuse(
        ConfigError,
        (not isinstance(mission, Encounter), f"--ais: there are no ships in {config.mission!r}"),
        (abs(north) > 90 or abs(east) > 180,
         f"--home {north:g} {east:g}: latitude is -90 to 90, longitude -180 to 180"),
        (to.kind != "udp", f"--ais {to}: is told by UDP: udp:ADDRESS:PORT"),
    )
    home = Origin(*(args.home or mission.origin or HOME))
    return Teller(mission.ships, config.ais, (to.host, to.port), home, config.decision_interval, mission.seed)


def tell(text: str) -> None:
    """Print a line at once."""
    print(text, flush=True)
