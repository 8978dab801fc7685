"""Be the physics of an autopilot's SITL: a vehicle in our sea and wind, driven by its outputs.

    taichi-sim sitl VEHICLE [--protocol ardupilot|px4] [--port N] [options]
    taichi-sim sitl SCENARIO --autopilot TEAM.NUMBER=PORT ...              # a world; --autopilot --help explains it

    taichi-sim sitl otter --set 'actions="left_right"' --sea hs=0.5,tp=4   # sim_vehicle -v Rover --model JSON
    taichi-sim sitl kvlcc2 --wind 6 270 --log run.csv --record run.rrd
    taichi-sim sitl aerosonde --wind 8 200                                 # sim_vehicle -v ArduPlane --model JSON
    taichi-sim sitl x500 --wind 6 270 --air 'turbulence="dryden",gust={amplitude=[0,5,0],start_time=60,rise_time=2}'
    taichi-sim sitl x500 --instances 3                                     # ports 9002, 9012, 9022: -I 0, 1, 2
    taichi-sim sitl x500 --protocol px4                                    # PX4's HIL by MAVLink (extra px4)

VEHICLE is a vehicle file, or the name of a shipped one. It moves in lockstep: at the frame rate that ArduPilot asks for
(SIM_RATE_HZ; JSON interface over UDP), or at 250 Hz with PX4 (MAVLink over TCP). Ctrl-C ends it. Channels, conventions,
and what real autopilots have confirmed: docs/sitl.md.

Exit status: 0 ended, 2 bad input.
"""

import argparse
import csv
import math
import selectors
import signal
import socket
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from taichi_sim.applications.commands.trials import changes_of, conditions_of, pairs
from taichi_sim.applications.sitl.ardupilot import FIRST_RATE, LARGEST, Session, answer_all
from taichi_sim.applications.sitl.channels import PWM, changes_for, read_channels
from taichi_sim.applications.sitl.craft import Craft, Servos
from taichi_sim.applications.sitl.driven import Sensors
from taichi_sim.config import AirConfig, ConfigError
from taichi_sim.config.io import validate
from taichi_sim.errors import command
from taichi_sim.kernels import runtime
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.options import address, output, parser_of, port, ranged, seed

if TYPE_CHECKING:
    from taichi_sim.applications.sitl.craft_recording import CraftRecording
    from taichi_sim.applications.sitl.px4 import Px4Session

PORTS = {"ardupilot": (9002, 10), "px4": (4560, 1)}  # protocol -> first port, difference of consecutive instances
PRINT_EVERY = 5.0  # s between lines of progress
COLUMNS = (
    "t", "north", "east", "down", "roll", "pitch", "yaw", "v_north", "v_east", "v_down", "p", "q", "r", "a_x", "a_y",
    "a_z",
)  # fmt: skip


def craft_of(args: argparse.Namespace) -> Craft:
    """The vehicle that the arguments describe."""
    sea, air, _ = conditions_of(args)
    changes = changes_of(args.overrides)
    if args.air is not None:
        given = {} if air is None else air.model_dump(exclude_unset=True)
        air = validate(AirConfig, given | pairs(args.air), "--air")
        unfelt = air.turbulence != "none" or air.gust is not None
        if unfelt and load_vehicle(args.vehicle, 1e-3, 1, **changes).medium == "water":
            raise ConfigError(
                f"--air {args.air}: vessels feel the mean wind alone; leave out turbulence and gust for {args.vehicle}"
            )
    channels = None
    if args.channels:
        first = load_vehicle(args.vehicle, 1e-3, 1, **changes)
        direct = {k: v | changes.get(k, {}) | v for k, v in changes_for(first).items()}
        channels = read_channels(args.channels, load_vehicle(args.vehicle, 1e-3, 1, **(changes | direct)))
    return Craft(args.vehicle, changes, sea=sea, air=air, channels=channels, pwm=tuple(args.pwm),
                 heading=math.radians(args.heading), seed=args.seed)  # fmt: skip


def row(sensors: Sensors) -> tuple[float, ...]:
    """A row of the log."""
    return (sensors.timestamp, *sensors.position, *sensors.attitude, *sensors.velocity, *sensors.gyro,
            *sensors.accel_body)  # fmt: skip


def fit_out(args: argparse.Namespace, open_things: ExitStack, session: "Session[Craft] | Px4Session", k: int) -> None:
    """Give instance k its log, recording and live view, and say where it listens."""
    if args.log is not None:
        file = _of_instance(args, args.log, k)
        session.seen.append(logger(open_things.enter_context(file.open("w", newline=""))))
    if args.record is not None:
        from taichi_sim.applications.sitl.craft_recording import CraftRecording  # importing rerun takes a second

        reel = CraftRecording(_of_instance(args, args.record, k), session.craft)
        open_things.callback(_finish, reel)
        session.seen.append(reel.see)
    if args.live and k == 0:
        from taichi_sim.applications.sitl.craft_recording import CraftView
        from taichi_sim.visualisation.recording.live import Live

        live = open_things.enter_context(Live("sitl", port=args.live_port))
        print(live.told, flush=True)
        session.seen.append(CraftView(live, session.craft).see)
    driven = ", ".join(f"{abs(c)}{' reversed' if c < 0 else ''} {name}" for name, c in session.craft.channels.items())
    print(f"{args.vehicle} on {args.address}:{port_of(args, k)}, channels {driven}", flush=True)


def port_of(args: argparse.Namespace, k: int) -> int:
    """Port of instance k."""
    first, step = PORTS[args.protocol]
    return (args.port or first) + step * k


def serve(args: argparse.Namespace) -> None:
    """Serve autopilots until Ctrl-C, or for --duration seconds of simulated time."""
    with ExitStack() as open_things:
        wires = open_things.enter_context(selectors.DefaultSelector())
        sessions = [_opened(args, k, wires, open_things) for k in range(args.instances)]
        if not ip_address(args.address).is_loopback:
            print(f"{args.address} is open to other machines: whoever sends first drives the vehicle", file=sys.stderr)
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends like Ctrl-C, so that files are completed
        printed, began = time.monotonic(), time.monotonic()
        while True:
            for key, _ in wires.select(timeout=min(PRINT_EVERY, *(s.tick() for s in sessions))):
                key.data()
            for k, session in enumerate(sessions):
                for news in session.craft.news:
                    print(f"{args.vehicle} on {port_of(args, k)}, t {session.craft.time:.1f} s: it {news}", flush=True)
                session.craft.news.clear()
            if not args.quiet and time.monotonic() - printed > PRINT_EVERY:
                printed = time.monotonic()
                for session in sessions:
                    print(session.state(printed - began), flush=True)
            if args.duration and all(s.last and s.craft.time > args.duration - 0.5 / s.craft.rate for s in sessions):
                return


def _opened(
    args: argparse.Namespace, k: int, wires: selectors.BaseSelector, open_things: ExitStack
) -> "Session[Craft] | Px4Session":
    """Instance k, compiled, which listens: for packets of an ArduPilot, or for the connection of a PX4."""
    px4 = args.protocol == "px4"
    wire = socket.socket(socket.AF_INET, socket.SOCK_STREAM if px4 else socket.SOCK_DGRAM)
    open_things.enter_context(wire)
    if px4:
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        wire.bind((args.address, port_of(args, k)))
    except OSError as error:
        raise ConfigError(f"--address {args.address} --port {port_of(args, k)}: {error.strerror or error}") from None
    craft = craft_of(args)
    if px4:
        from taichi_sim.applications.sitl.px4 import RATE, Px4Session

        session = Px4Session(craft, seed=args.seed)
        craft.compile(RATE)
        wire.listen(1)
        wires.register(wire, selectors.EVENT_READ, partial(_let_in, wire, session, wires, open_things))
    else:
        session = Session(craft)
        craft.compile(FIRST_RATE)
        wire.setblocking(False)
        wires.register(wire, selectors.EVENT_READ, partial(answer_all, wire, session, _complain))
    fit_out(args, open_things, session, k)
    return session


def _let_in(door: socket.socket, session: "Px4Session", wires: selectors.BaseSelector, open_things: ExitStack) -> None:
    """Accept a connection, unless a PX4 drives the vehicle already."""
    wire, sender = door.accept()
    if session.connected:
        print(f"refused {sender[0]}:{sender[1]}: another PX4 drives this vehicle", file=sys.stderr, flush=True)
        wire.close()
        return
    open_things.callback(wire.close)
    wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(data: bytes) -> None:
        try:
            wire.sendall(data)
        except OSError:  # it has gone; reading says so, too
            session.disconnect()

    wires.register(wire, selectors.EVENT_READ, partial(_hear, wire, session, wires))
    session.connect(send)


def _hear(wire: socket.socket, session: "Px4Session", wires: selectors.BaseSelector) -> None:
    """Handle the bytes that have arrived, or the end of the connection."""
    data = b""
    with suppress(OSError):
        data = wire.recv(LARGEST)
    if data:
        session.receive(data)
    if not data or not session.connected:
        session.disconnect()
        wires.unregister(wire)
        wire.close()


def _complain(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _of_instance(args: argparse.Namespace, file: Path, k: int) -> Path:
    return file if args.instances == 1 else file.with_stem(f"{file.stem}-{k}")


def _finish(reel: "CraftRecording") -> None:
    if (file := reel.write()) is not None:
        print(file, flush=True)


def logger(file: TextIO) -> Callable[[Servos, Sensors], None]:
    """A writer of frames as rows of a table, for `Session.seen`."""
    table = csv.writer(file)

    def seen(servos: Servos, sensors: Sensors) -> None:
        if file.tell() == 0:
            table.writerow((*COLUMNS, *(f"pwm_{k + 1}" for k in range(len(servos.pwm)))))
        table.writerow((*row(sensors), *servos.pwm))

    return seen


def parser() -> argparse.ArgumentParser:
    """The parser of the arguments."""
    p = parser_of(__doc__, "taichi-sim sitl")
    p.add_argument("vehicle", metavar="VEHICLE", help="vehicle file, or the name of a shipped one")
    p.add_argument("--protocol", choices=tuple(PORTS), default="ardupilot",
                   help="ardupilot: its JSON interface; px4: its HIL by MAVLink [ardupilot]")  # fmt: skip
    p.add_argument("--port", type=port, help="UDP port of ArduPilot [9002], TCP port of PX4 [4560]")
    p.add_argument("--address", type=address, default="127.0.0.1",
                   help="address to listen on [127.0.0.1: this machine only]")  # fmt: skip
    p.add_argument("--instances", type=ranged(int, 1, 64), default=1, metavar="N",
                   help="number of vehicles, on ports 10 apart, or 1 with PX4 [1]")  # fmt: skip
    p.add_argument("--channels", default="", metavar="NAME=N,...", help="servo channels; -N reverses one")
    p.add_argument("--pwm", type=float, nargs=2, default=PWM, metavar=("LOW", "HIGH"),
                   help="pulse widths, microseconds [1000 2000]")  # fmt: skip
    p.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
                   help="override KEY or SECTION.KEY of the vehicle file; several times")  # fmt: skip
    p.add_argument("--sea", metavar="KEY=VALUE,...", help="keys of [sea], for example hs=0.5,tp=4 [calm]")
    p.add_argument("--wind", type=float, nargs=2, metavar=("SPEED", "FROM"), help="m/s at 10 m, deg [none]")
    p.add_argument("--air", metavar="KEY=VALUE,...",
                   help="more keys of [air] in TOML, for example 'turbulence=\"dryden\"'")  # fmt: skip
    p.add_argument("--current", type=float, nargs=2, metavar=("SPEED", "TO"), help="m/s, deg [none]")
    p.add_argument("--heading", type=float, default=0.0, metavar="DEG", help="initial heading [0]")
    p.add_argument("--seed", type=seed, default=1, help="seed of the sea [1]")
    p.add_argument("--log", type=output, metavar="FILE", help="a CSV of all frames: motion in SI, and servo outputs")
    p.add_argument("--record", type=output, metavar="FILE.rrd",
                   help="for rerun, 10 frames a second; written at the end and at restarts")  # fmt: skip
    p.add_argument("--live", action="store_true", help="show it (the first instance) in a rerun viewer as it moves")
    p.add_argument("--live-port", type=port, default=9876, metavar="PORT",
                   help="port of the view, on this machine [9876]")  # fmt: skip
    p.add_argument("--duration", type=ranged(float, 0.0, 1e6), default=0.0, metavar="S",
                   help="end after this much simulated time [never]")  # fmt: skip
    p.add_argument("--quiet", action="store_true", help="print no progress")
    return p


@command("sitl")
def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    p = parser()
    args = p.parse_args(argv)
    if port_of(args, args.instances - 1) > 65535:
        p.error(f"--instances {args.instances}: their ports from {port_of(args, 0)} on go beyond 65535")
    if not args.pwm[0] < args.pwm[1]:
        p.error(f"--pwm {args.pwm[0]:g} {args.pwm[1]:g}: the first must be less")
    if args.record is not None and args.record.suffix != ".rrd":
        p.error(f"--record {args.record}: the file must end in .rrd")
    runtime.init(threads=1)
    with suppress(KeyboardInterrupt):
        serve(args)


if __name__ == "__main__":
    sys.exit(main())
