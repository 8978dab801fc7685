"""Be the physics of ArduPilot's SITL: a vehicle in our sea and wind, driven by its servo outputs (JSON interface).

    taichi-sim sitl VEHICLE [--port 9002] [options]

    taichi-sim sitl otter --set 'actions="left_right"' --sea hs=0.5,tp=4   # sim_vehicle -v Rover --model JSON
    taichi-sim sitl kvlcc2 --wind 6 270 --log run.csv --record run.rrd
    taichi-sim sitl aerosonde --wind 8 200                                 # sim_vehicle -v ArduPlane --model JSON
    taichi-sim sitl x500 --instances 3                                     # ports 9002, 9012, 9022: -I 0, 1, 2

VEHICLE is a vehicle file, or the name of a shipped one. It moves in lockstep, at the frame rate that ArduPilot asks for
(SIM_RATE_HZ). Ctrl-C ends it. Channels, conventions, and what no real autopilot has confirmed: docs/sitl.md.

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
from contextlib import ExitStack
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from taichi_sim.commands.trials import changes_of, conditions_of
from taichi_sim.config import ConfigError
from taichi_sim.kernels import runtime
from taichi_sim.sea import SteepSeaError
from taichi_sim.sitl.channels import PWM, changes_for, read_channels
from taichi_sim.sitl.craft import Craft
from taichi_sim.sitl.packets import Sensors, Servos
from taichi_sim.sitl.session import Session
from taichi_sim.vehicles import load_vehicle

if TYPE_CHECKING:
    from taichi_sim.sitl.record import CraftRecording

NEXT_INSTANCE = 10  # difference of the ports of consecutive instances of SITL
LARGEST = 65536  # bytes of the largest packet
TOLD_EVERY = 5.0  # s between lines of progress
COLUMNS = (
    "t",
    "north",
    "east",
    "down",
    "roll",
    "pitch",
    "yaw",
    "v_north",
    "v_east",
    "v_down",
    "p",
    "q",
    "r",
    "a_x",
    "a_y",
    "a_z",
)


def craft_of(args: argparse.Namespace) -> Craft:
    """The vehicle that the arguments describe.

    Raises:
        ConfigError: for bad input.
    """
    sea, air, _ = conditions_of(args)
    changes = changes_of(args.overrides)
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


def listen(args: argparse.Namespace) -> None:
    """Answer autopilots until Ctrl-C, or for --duration seconds of simulated time.

    Raises:
        ConfigError: for bad input, or a port that is taken.
    """
    with ExitStack() as open_things:
        wires = open_things.enter_context(selectors.DefaultSelector())
        sessions: list[Session] = []
        for k in range(args.instances):
            port = args.port + NEXT_INSTANCE * k
            wire = open_things.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            try:
                wire.bind((args.address, port))
            except OSError as error:
                raise ConfigError(f"--address {args.address} --port {port}: {error.strerror or error}") from None
            session = Session(craft_of(args))
            if args.log is not None:
                file = _of_instance(args, args.log, k)
                session.seen.append(_logger(open_things.enter_context(file.open("w", newline=""))))
            if args.record is not None:
                from taichi_sim.sitl.record import CraftRecording  # importing rerun takes a second

                reel = CraftRecording(_of_instance(args, args.record, k), session.craft)
                open_things.callback(_finish, reel)
                session.seen.append(reel.see)
            if args.live and k == 0:
                from taichi_sim.recording.live import Live
                from taichi_sim.sitl.record import CraftView

                live = open_things.enter_context(Live("sitl", port=args.live_port))
                print(live.told, flush=True)
                session.seen.append(CraftView(live, session.craft).see)
            sessions.append(session)
            wires.register(wire, selectors.EVENT_READ, session)
            driven = ", ".join(
                f"{abs(c)}{' reversed' if c < 0 else ''} {name}" for name, c in session.craft.channels.items()
            )
            print(f"{args.vehicle} on {args.address}:{port}, channels {driven}", flush=True)
        if not ip_address(args.address).is_loopback:
            print(f"{args.address} is open to other machines: whoever sends first drives the vehicle", file=sys.stderr)
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends like Ctrl-C, so that files are completed
        told, began = time.monotonic(), time.monotonic()
        while True:
            for key, _ in wires.select(timeout=TOLD_EVERY):
                wire = key.fileobj
                assert isinstance(wire, socket.socket)
                data, sender = wire.recvfrom(LARGEST)
                answer = key.data.receive(data, sender)
                if answer is not None:
                    wire.sendto(answer, sender)
            if not args.quiet and time.monotonic() - told > TOLD_EVERY:
                told = time.monotonic()
                for session in sessions:
                    print(_state_of(session, told - began), flush=True)
            if args.duration and all(s.last and s.craft.frames >= args.duration * s.craft.rate for s in sessions):
                return


def _of_instance(args: argparse.Namespace, file: Path, k: int) -> Path:
    return file if args.instances == 1 else file.with_stem(f"{file.stem}-{k}")


def _finish(reel: "CraftRecording") -> None:
    if (file := reel.write()) is not None:
        print(file, flush=True)


def _logger(file: TextIO) -> Callable[[Servos, Sensors], None]:
    table = csv.writer(file)

    def seen(servos: Servos, sensors: Sensors) -> None:
        if file.tell() == 0:
            table.writerow((*COLUMNS, *(f"pwm_{k + 1}" for k in range(len(servos.pwm)))))
        table.writerow((*row(sensors), *servos.pwm))

    return seen


def _state_of(session: Session, seconds: float) -> str:
    c = session.counts
    refused = "".join(f"; refused {n}: {why}" for why, n in c.refused.items())
    if session.last is None:
        return f"waiting for ArduPilot{refused}"
    words = (
        f"t {session.craft.frames / session.craft.rate:.1f} s at {session.craft.rate} Hz",
        f"{c.frames} frames ({c.frames / seconds:.0f}/s)",
        f"repeated {c.repeated}, lost {c.lost}, late {c.late}, restarts {c.restarts}",
    )
    return ", ".join(words) + refused


def parser() -> argparse.ArgumentParser:
    """The parser of the arguments."""
    summary, _, rest = (__doc__ or "").partition("\n\n")
    p = argparse.ArgumentParser(
        prog="taichi-sim sitl", description=summary, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("vehicle", metavar="VEHICLE", help="vehicle file, or the name of a shipped one")
    p.add_argument("--port", type=int, default=9002, help="UDP port [9002, ArduPilot's]")
    p.add_argument("--address", default="127.0.0.1", help="address to listen on [127.0.0.1: this machine only]")
    p.add_argument("--instances", type=int, default=1, metavar="N", help="number of vehicles, on ports 10 apart [1]")
    p.add_argument("--channels", default="", metavar="NAME=N,...", help="servo channels; -N reverses one")
    p.add_argument(
        "--pwm",
        type=float,
        nargs=2,
        default=PWM,
        metavar=("LOW", "HIGH"),
        help="pulse widths, microseconds [1000 2000]",
    )
    p.add_argument("--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
                   help="override KEY or SECTION.KEY of the vehicle file; several times")  # fmt: skip
    p.add_argument("--sea", metavar="KEY=VALUE,...", help="keys of [sea], for example hs=0.5,tp=4 [calm]")
    p.add_argument("--wind", type=float, nargs=2, metavar=("SPEED", "FROM"), help="m/s at 10 m, deg [none]")
    p.add_argument("--current", type=float, nargs=2, metavar=("SPEED", "TO"), help="m/s, deg [none]")
    p.add_argument("--heading", type=float, default=0.0, metavar="DEG", help="initial heading [0]")
    p.add_argument("--seed", type=int, default=1, help="seed of the sea [1]")
    p.add_argument("--log", type=Path, metavar="FILE", help="a CSV of all frames: motion in SI, and servo outputs")
    p.add_argument("--record", type=Path, metavar="FILE.rrd",
                   help="for rerun, 10 frames a second; written at the end and at restarts")  # fmt: skip
    p.add_argument("--live", action="store_true", help="show it (the first instance) in a rerun viewer as it moves")
    p.add_argument(
        "--live-port", type=int, default=9876, metavar="PORT", help="port of the view, on this machine [9876]"
    )
    p.add_argument(
        "--duration", type=float, default=0.0, metavar="S", help="end after this much simulated time [never]"
    )
    p.add_argument("--quiet", action="store_true", help="print no progress")
    return p


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    p = parser()
    args = p.parse_args(argv)
    for name, low, high in (
        ("port", 1, 65535),
        ("live_port", 1, 65535),
        ("instances", 1, 64),
        ("seed", 0, 2**31 - 1),
        ("duration", 0, 1e6),
    ):
        if not low <= getattr(args, name) <= high:
            p.error(f"--{name.replace('_', '-')} {getattr(args, name):g}: allowed are {low:g} to {high:g}")
    if args.port + NEXT_INSTANCE * (args.instances - 1) > 65535:
        p.error(f"--instances {args.instances}: their ports from {args.port} on go beyond 65535")
    if not args.pwm[0] < args.pwm[1]:
        p.error(f"--pwm {args.pwm[0]:g} {args.pwm[1]:g}: the first must be less")
    if args.record is not None and args.record.suffix != ".rrd":
        p.error(f"--record {args.record}: the file must end in .rrd")
    try:
        ip_address(args.address)
    except ValueError:
        p.error(f"--address {args.address}: not an IP address")
    runtime.init(threads=1)
    try:
        listen(args)
    except KeyboardInterrupt:
        return 0
    except (ConfigError, SteepSeaError, OSError) as error:
        print(f"sitl: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
