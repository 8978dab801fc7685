"""Let a trained policy steer real vehicles, or simulated ones, as the MAVLink companion of their autopilots.

    taichi-sim pilot RUN --team usv --connect udp:127.0.0.1:14550 --connect udp:127.0.0.1:14560 ...
    taichi-sim pilot landing --connect udp:127.0.0.1:14550 --follow udp:127.0.0.1:14560

One --connect for each vehicle of the team, in the order of their slots, the leader first; one --follow for each vehicle
that it must know, but does not steer: the boat on which a copter lands. Nothing is armed, and no mode is changed unless
--guided asks for it; motors are stopped by --disarm alone. Ctrl-C stops the vehicles and ends. It runs on one thread,
unless --threads asks for more (docs/pilot.md).
"""

import argparse
import math
import selectors
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from rl.commands import shared
from taichi_sim.errors import refuse
from taichi_sim.options import parser_of, positive_float, seed

SLOWEST = 0.01  # of real time; a slower simulation is looked at as often as this one


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command's arguments."""
    p = parser_of(__doc__)
    p.add_argument("policy", type=Path, metavar="RUN",
                   help="run folder of rl/train.py, or a scenario whose policies come with the package")  # fmt: skip
    p.add_argument("--team", default=None, help="team whose policy acts (default: the only one there is)")
    p.add_argument(
        "--connect",
        action="append",
        required=True,
        metavar="ADDRESS",
        help="udp:ADDRESS:PORT, which listens, or tcp:ADDRESS:PORT, which connects; one for each vehicle; with #SYSTEM "
        "where several share a connection",
    )
    p.add_argument(
        "--follow",
        action="append",
        default=[],
        metavar="ADDRESS",
        help="the same of a vehicle that is not steered: of a landing, each copter's boat, in the order of the copters",
    )
    p.add_argument(
        "--ais",
        metavar="ADDRESS",
        help="where AIS_VESSEL messages come from besides (default: from the autopilot's own receiver alone)",
    )
    p.add_argument(
        "--disarm",
        action="store_true",
        help="stop the motors of a copter once it rests on its deck (default: hold it down until somebody does)",
    )
    p.add_argument("--guided", action="store_true", help="ask for GUIDED (default: wait until somebody else has)")
    p.add_argument("--origin", type=float, nargs=2, default=None, metavar=("LAT", "LON"),
                   help="where the course begins, degrees (default: at the first vehicle)")  # fmt: skip
    p.add_argument("--heading", type=float, default=None, metavar="DEG",
                   help="its direction there (default: the first vehicle's heading)")  # fmt: skip
    p.add_argument("--seed", type=seed, default=None, help="seed of the course (default: the scenario's)")
    p.add_argument("--duration", type=positive_float, default=None, metavar="S",
                   help="end after this time (default: never)")  # fmt: skip
    shared.add_common(p)
    return p


def policy_of(args: argparse.Namespace):
    """Start Taichi; return the scenario that the policy was trained in, its file, the team, and the policy.

    The one place that knows where policies come from.
    """
    from rl.learn.policy import CheckpointError, load_policy
    from rl.learn.policy_sources import shipped_policies

    config, source = shared.scenario_of(argparse.Namespace(run=args.policy, overrides=args.overrides, config=None))
    shipped = {} if shared.is_run(args.policy) else shipped_policies(config.name)
    there = [team for team in config.trained if team in shipped or (args.policy / team).is_dir()]
    team = args.team or (there[0] if len(there) == 1 else None)
    if team not in there:
        given = "which team?" if team is None else f"no policy of a team {team!r}"
        raise CheckpointError(f"{args.policy}: {given} --team {' or --team '.join(there) or '...: there is none'}")
    shared.start(args)
    return config, source, team, shipped.get(team) or load_policy(args.policy, config, team)


def made(args: argparse.Namespace, addresses, wires, tell):
    """The companion that the arguments ask for, ready to act; addresses of vehicles that are followed come last."""
    from rl.adapters.pilot.ais import Heard
    from rl.adapters.pilot.autopilot_link import Link
    from rl.adapters.pilot.companion import Companion
    from rl.adapters.pilot.set_points import orders_of
    from rl.mission import Mission
    from rl.missions import find_mission
    from taichi_sim.config import ConfigError
    from taichi_sim.visualisation.recording.east_north_up import Origin

    config, source, team, policy = policy_of(args)
    kind = find_mission(config.mission, [source.parent])
    sea, count, given = kind.piloted(config, team), config.teams[team].count, len(args.connect)
    refuse(
        ConfigError,
        (sea is None,
         f"scenario {config.name!r}: its mission, {kind.__name__}, has no companion for {team} (Mission.piloted)"),
        (given != count, f"{given} x --connect, and {team}.count = {count}: give one for each vehicle, or --set "
         f"{team}.count={given}"),
    )  # fmt: skip
    mission = kind(sea, 1, seed=config.seed if args.seed is None else args.seed, teams=(team,), source=source)
    orders, listens = orders_of(mission.teams[team]), kind.hear is not Mission.hear
    others = mission.followed(mission.teams[team])
    laid = {"--origin": args.origin, "--heading": args.heading, "--seed": args.seed}
    useless = next((name for name, value in laid.items() if value is not None), "")
    members = [(name, k) for name in (team, *others) for k in range(config.teams[name].count)]
    wanted = " and ".join(f"{config.teams[name].count} of {name}" for name in others) or "none"
    north, east = args.origin or (0.0, 0.0)
    refuse(
        ConfigError,
        (args.guided and orders.station,
         "--guided: this policy commands thrust and yaw, which only MANUAL obeys: set it yourself"),
        (useless and mission.course(mission.teams[team]) is None,
         f"{useless}: there is no course in {config.mission!r} that could begin somewhere"),
        (len(members) != len(addresses), f"{len(args.follow)} x --follow: this policy follows {wanted}"),
        (args.ais and not listens, f"--ais: nobody listens in {config.mission!r}"),
        (args.disarm and config.mission != "landing", "--disarm: only landings have an end at which vehicles rest"),
        (abs(north) > 90 or abs(east) > 180,
         f"--origin {north:g} {east:g}: latitude is -90 to 90, longitude -180 to 180"),
    )  # fmt: skip
    links: dict[str, list[Link]] = {}
    for (name, k), address, wire in zip(members, addresses, wires, strict=True):
        title = f"{'vehicle' if name == team else name} {k + 1} ({address})"
        station, airy = orders.station and name == team, name == team and bool(mission.teams[team].observed_air)
        links.setdefault(name, []).append(Link(title, wire.send, station=station, system=address.system, airy=airy))
    heading = None if args.heading is None else math.radians(args.heading)
    origin = None if args.origin is None else Origin(*args.origin)
    return Companion(
        mission, team, policy, orders, links.pop(team), tell=tell, origin=origin, heading=heading, guided=args.guided,
        progress=not args.quiet, followed=links, disarm=args.disarm,
        ais=Heard(sea.tracks.forget) if listens else None,  # pyright: ignore[reportOptionalMemberAccess]
    )  # fmt: skip


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.adapters.pilot.autopilot_link import dialect
    from rl.adapters.pilot.clock import Clock
    from rl.adapters.pilot.companion import PilotError
    from rl.adapters.pilot.connections import Wire, check_different, read_address

    dialect()
    args.threads = args.threads or 1  # a decision is too small for more
    addresses = [read_address(text) for text in (*args.connect, *args.follow)]
    beside = [read_address(args.ais)] if args.ais else []
    check_different([*addresses, *beside])
    for address in (*addresses, *beside):
        if not address.local:
            print(f"{address} reaches beyond this machine: whoever answers there is taken for the vehicle, and MAVLink "
                  "is neither signed nor encrypted here", file=sys.stderr)  # fmt: skip
    began = time.monotonic()

    def tell(text: str) -> None:
        print(f"{time.monotonic() - began:7.1f} s  {text}", flush=True)

    with ExitStack() as open_things:
        opened = {address[:3]: Wire(address) for address in (*addresses, *beside)}
        for wire in opened.values():
            open_things.callback(wire.close)
        wires = [opened[address[:3]] for address in addresses]
        pilot = made(args, addresses, wires, tell)
        pilot.rehearse()
        for wire in opened.values():
            wire.receive()  # old by now
        clock = Clock(time.monotonic())
        ends = math.inf if args.duration is None else clock(time.monotonic()) + args.duration
        tell(f"listening: {', '.join(map(str, (*addresses, *beside)))}")
        try:
            fly(pilot, wires, clock, ends, [opened[address[:3]] for address in beside])
        except BaseException:
            pilot.end("interrupted")
            raise
        finally:
            if text := pilot.summary():
                print(text, flush=True)
    assert pilot.ended is not None, "it goes on until it ends"
    if pilot.ended.fault:
        raise PilotError(pilot.ended.why)
    tell(pilot.ended.why)


def fly(pilot, wires, clock, ends: float, beside=()) -> None:
    """Hear and act until the companion has ended, or its `clock` shows `ends` (s). Ships are heard `beside`, too."""
    lead, told = pilot.links[0], False
    from rl.adapters.pilot.companion import SLOW

    with selectors.DefaultSelector() as ready:
        for wire in {*wires, *beside}:
            links = [link for link, its in zip(pilot.heard, wires, strict=True) if its is wire]
            ready.register(wire.socket, selectors.EVENT_READ, (wire, links))
        wait = 0.0
        while pilot.ended is None:
            for key, _ in ready.select(timeout=wait):
                wire, links = key.data
                data = wire.receive()
                if pilot.ais is not None:
                    pilot.ais.receive(data, clock(time.monotonic()), wire)
                for link in links if data else ():
                    before, real = link.clock, time.monotonic()
                    link.receive(data, clock(real))
                    if link is lead and link.simulated and link.clock != before:
                        clock.follow(real, link.clock)
                if not wire.open:
                    ready.unregister(wire.socket)
            now = clock(time.monotonic())
            if now >= ends:
                pilot.end("the time of --duration is over")
            if not told and clock.pace < SLOW and pilot.phase != "waiting":
                told = True
                pilot.tell(f"{lead.name} is simulated, at {clock.pace:.2f} of real time: time is kept by its clock")
            wait = pilot.tick(now) / max(clock.pace, SLOWEST)
