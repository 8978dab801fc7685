"""Let ArduCopter land on the deck of a boat at sea, many times, and judge it as the landing benchmark judges policies.

    python tools/firmware_landings.py --autopilot ardupilot/build/sitl/bin/arducopter --landings 64
    python tools/firmware_landings.py --autopilot ... --companion landing     a policy steers, as in `taichi-sim pilot`

Each landing is an episode of its own. The copter stands in the air where the mission places it, arms, takes off and
flies to the deck in GUIDED, by a script that does what a user could by MAVLink: it knows the deck's place and velocity
exactly, follows them 10 times a second, waits over the deck, sinks with it, and stops the motors once it stands there:
LAND would brake to a stop over ground, and tip it over on a deck that moves. With --precision, it comes down by the
firmware's precision landing, for which our camera sends what it sees of the marker, ten times a second. The boat
sails by the mission's helm. An episode is measured from where the copter is as near as the mission's episodes begin.
With --companion a policy takes over there: it hears the copter by MAVLink, and the boat's exact motion as the boat's
autopilot would tell it, ten times a second, and sends velocities.

Needs pymavlink: pip install "taichi-sim[ardupilot]". docs/sitl.md says what has been confirmed with real firmware.
"""

import argparse
import json
import math
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from copy import copy
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.options import output, positive_int, seed

if __package__ in (None, ""):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

HOME = 63.48, 10.40  # deg, of the world's origin
METRES = 111_319.5  # per degree of latitude, as ArduPilot has it
RATE = 200  # Hz, of the world, of the program's frames and of its loops
PARAMETERS = {
    "FRAME_CLASS": 1, "FRAME_TYPE": 1, "SIM_RATE_HZ": RATE, "SCHED_LOOP_RATE": RATE, "ARMING_CHECK": 0,
    "INS_GYR_CAL": 0, "FS_THR_ENABLE": 0, "FS_GCS_ENABLE": 0, "FS_EKF_ACTION": 1, "LOG_BACKEND_TYPE": 0,
    "MOT_THST_EXPO": 1, "WPNAV_SPEED": 1000, "WPNAV_SPEED_UP": 500, "WPNAV_SPEED_DN": 500, "WPNAV_ACCEL": 500,
    "WPNAV_ACCEL_Z": 500, "PSC_JERK_XY": 20, "PSC_JERK_Z": 50,
}  # fmt: skip
"""ArduCopter's; a file of --defaults comes after them. By its own limits it cannot follow a deck: 1 m/s^2 upwards."""
PRECISION = {
    "PLND_ENABLED": 1, "PLND_TYPE": 1, "PLND_EST_TYPE": 1, "PLND_OPTIONS": 1, "PLND_ALT_MIN": 0, "PLND_ALT_MAX": 0,
}  # fmt: skip
"""Those of --precision: LANDING_TARGET messages of a target that moves, Kalman filter, at any distance."""
GUIDED, LAND = 4, 9  # modes of ArduCopter
INSTANCES = 256  # ArduPilot keeps the number in 8 bits
SPEEDUP = 1000  # times real time, that the program does not wait for
COMES_WITHIN = 60.0  # s, of the clock, for the first frame, and for any other
READY_WITHIN = 120.0  # s, of simulated time, for arming
CLIMB = 3.0  # m, of the take-off
AGAIN = 1.0  # s between two tries of a command
BOAT = 2  # system of the boat
AWAY = 60.0  # s to come near, for each 100 m; assumed
BODY_FRAME = 12  # MAV_FRAME_BODY_FRD
HOVER, NEAR, WAITS = 3.0, 0.3, 1.0  # m over the deck, m from its middle, s near it before sinking; assumed
SINKS, PRESSES = 0.4, -0.3  # m/s over the deck; height in m that it is told at last, on the deck; assumed
STANDS = 0.15, 0.5  # m over the deck at the most, and for how long, s, until the motors are stopped; assumed
FORCED = 21196  # disarms in flight, too, as MAV_CMD_COMPONENT_ARM_DISARM documents
POSITION_AND_VELOCITY = 0b1100_0000_0000 | 0b1_1100_0000  # type_mask: no acceleration, yaw and its rate
EARTH_FRAME = 5  # MAV_FRAME_GLOBAL_INT: latitude, longitude, height above mean sea level


class Script:
    """What a user's script does on the copter, by MAVLink; every number is NED, m, m/s, from the world's origin.

    Attributes:
        phase: "arms", "comes", "sinks", "stands". place: of the copter, as it tells. texts: its last words.
    """

    def __init__(self, link: Any, soles: float, height: float, *, precision: bool = False):
        """Fly by `link` (pymavlink) a copter whose soles are `soles` below its origin, to a deck `height` m below."""
        self.link, self.soles, self.height, self.precision = link, soles, height, precision
        self.phase, self.place, self.start = "arms", None, None
        self.texts: list[str] = []
        self._armed, self._asked, self._near, self._down, self._gap = False, -math.inf, 0.0, 0.0, HOVER

    def __call__(
        self, time: float, interval: float, deck: NDArray[np.float64], moves: NDArray[np.float64],
        marker: NDArray[np.float64] | None = None,
    ) -> None:  # fmt: skip
        """Act at `time` (s) by what has come since the last `interval` (s); `deck` and how it `moves` [3].

        `marker`: [3] from the copter, b, m, if its camera sees it.
        """
        self._hear()
        if self.phase == "arms":
            if self._armed and self.place is not None and time - self._asked > AGAIN:
                self._command("MAV_CMD_NAV_TAKEOFF", 0, 0, 0, 0, 0, 0, CLIMB)
                self._asked = time
            elif not self._armed and time - self._asked > AGAIN:
                self._mode(GUIDED)
                self._command("MAV_CMD_SET_MESSAGE_INTERVAL", 33, 1e6 * interval)  # GLOBAL_POSITION_INT
                self._command("MAV_CMD_COMPONENT_ARM_DISARM", 1)
                self._asked = time
            if self.place is not None:
                self.start = self.place if self.start is None or not self._armed else self.start
                if self._armed and self.start[2] - self.place[2] > 0.8 * CLIMB:
                    self.phase = "comes"
            return
        assert self.place is not None
        off = math.hypot(*(self.place - deck)[:2])
        gap = HOVER
        if self.phase == "comes":
            gap = HOVER if off < 3 * HOVER else self.height
            self._near = self._near + interval if off < NEAR and abs(deck[2] - self.place[2]) < 2 * HOVER else 0.0
            if self._near > WAITS:
                self.phase, self._asked = "sinks", -math.inf
        elif self.phase == "sinks":
            if off < NEAR or self.precision:
                self._gap = max(self._gap - SINKS * interval, PRESSES)
            gap = self._gap
            low = gap == PRESSES and deck[2] - self.place[2] - self.soles < STANDS[0]
            self._down = self._down + interval if low else 0.0
            if self._down > STANDS[1]:
                self.phase, self._asked = "stands", -math.inf
        if self.phase == "stands":
            if self._armed and time - self._asked > AGAIN:
                self._command("MAV_CMD_COMPONENT_ARM_DISARM", 0, FORCED)
                self._asked = time
            return
        if self.phase == "sinks" and self.precision:
            if time - self._asked > AGAIN:
                self._mode(LAND)
                self._asked = time
            if marker is not None:
                away = float(np.linalg.norm(marker))
                across = math.atan2(marker[1], marker[2]), math.atan2(-marker[0], marker[2])
                self.link.mav.landing_target_send(
                    round(1e6 * time), 0, BODY_FRAME, *across, away, 0, 0, *marker, (1, 0, 0, 0), 2, 1
                )
            return
        north, east, down = deck - [0.0, 0.0, gap + self.soles]
        v = moves + [0.0, 0.0, SINKS if self.phase == "sinks" else 0.0]
        self.link.mav.set_position_target_global_int_send(
            0, 1, 1, EARTH_FRAME, POSITION_AND_VELOCITY, round(1e7 * (HOME[0] + north / METRES)),
            round(1e7 * (HOME[1] + east / east_metres())), -down, *v, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def _hear(self) -> None:
        while (told := self.link.recv_match(blocking=False)) is not None:
            kind = told.get_type()
            if kind == "HEARTBEAT":
                self._armed = bool(told.base_mode & 128)
            elif kind == "GLOBAL_POSITION_INT" and told.lat:
                north = (told.lat / 1e7 - HOME[0]) * METRES
                east = (told.lon / 1e7 - HOME[1]) * east_metres()
                self.place = np.array([north, east, -told.alt / 1e3])
            elif kind == "STATUSTEXT":
                self.texts = [*self.texts[-4:], told.text]

    def _command(self, name: str, *values: float) -> None:
        from pymavlink import mavutil

        number = getattr(mavutil.mavlink, name)
        self.link.mav.command_long_send(1, 1, number, 0, *(*values, *(0.0,) * (7 - len(values))))

    def _mode(self, mode: int) -> None:
        self._command("MAV_CMD_DO_SET_MODE", 1, mode)


def program(path: Path) -> Path:
    """The autopilot's file."""
    from taichi_sim.config import ConfigError

    if not path.is_file() or not os.access(path, os.X_OK):
        raise ConfigError(f"--autopilot {path}: no program that could be run; docs/sitl.md says how to build one")
    return path.resolve()


def free_port() -> int:
    """A UDP port of this machine that nobody has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.bind(("127.0.0.1", 0))
        return wire.getsockname()[1]


class PolicyFlight:
    """What `taichi-sim pilot` does on the copter, in simulated time; the boat's telemetry is its exact motion.

    Attributes:
        pilot: the companion.
    """

    def __init__(self, policies: Mapping[str, Any], mission: Any):
        """Steer the aircraft of a `mission` with one environment (`Landing.piloted`) by one of `policies`."""
        from rl.adapters.pilot.autopilot_link import Link, dialect
        from rl.adapters.pilot.companion import Companion
        from rl.adapters.pilot.set_points import orders_of

        kinds, name = dialect(), mission.aircraft.name
        self._boat, self._out = kinds.MAVLink(None, srcSystem=BOAT, srcComponent=1), ignored
        team = mission.teams[name]
        self._links = Link("the copter", self._send), Link("the boat", ignored)
        followed = {mission.boats.fleet.name: [self._links[1]]}
        orders = orders_of(team)
        self.pilot = Companion(
            mission, name, policies[name], orders, [self._links[0]], tell=ignored, followed=followed, disarm=True
        )
        self.pilot.rehearse()

    def _send(self, data: bytes) -> None:
        self._out(data)

    def __call__(self, link: Any, time: float, boat: NDArray[np.float64]) -> None:
        """Act at `time` (s) by what has come over `link` (pymavlink), and the `boat`'s state [13]."""
        self._out = link.write
        while data := link.recv():
            self._links[0].receive(data, time)
        for data in boat_tells(self._boat, time, boat):
            self._links[1].receive(data, time)
        self.pilot.tick(time)


def boat_tells(writer: Any, time: float, state: NDArray[np.float64]) -> list[bytes]:
    """What the autopilot of a boat in `state` [13] says at `time` (s), packed by `writer` (MAVLink)."""
    import torch

    from taichi_sim.kernels.rotation import torch_euler_from_quaternion, torch_rotation_matrix

    q, clock = torch.from_numpy(state[3:7]), round(1e3 * time)
    v = [round(100 * x) for x in (torch_rotation_matrix(q) @ torch.from_numpy(state[7:10])).tolist()]
    north, east, down = state[:3]
    places = round(1e7 * (HOME[0] + north / METRES)), round(1e7 * (HOME[1] + east / east_metres()))
    height = round(-1e3 * down)
    return [
        message.pack(writer)
        for message in (
            writer.heartbeat_encode(11, 3, 128, 0, 4),
            writer.global_position_int_encode(clock, *places, height, height, *v, 0),
            writer.attitude_encode(clock, *torch_euler_from_quaternion(q).tolist(), *state[10:13]),
        )
    ]


def east_metres() -> float:
    """Metres per degree of longitude at the home, as ArduPilot has it."""
    return METRES * math.cos(math.radians(HOME[0]))


class Flight:
    """One copter: the program that flies it, the script that tells it what to do, and the judge of its episode.

    Attributes:
        script: the script. companion: steers in its place, once its episode has begun; None: nothing does. judge: None
            until its episode begins. decisions: of the episode.
    """

    def __init__(
        self, path: Path, instance: int, defaults: Sequence[Path], folder: Path, *, soles: float, height: float,
        precision: bool,
    ):  # fmt: skip
        """Start the program as `instance`, in a `folder` of its own; the others are those of `Script`."""
        from pymavlink import mavutil

        port = free_port()
        self.instance, self.judge, self.decisions = instance, None, 0
        self.companion: PolicyFlight | None = None
        self.link = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=255)
        self.script = Script(self.link, soles, height, precision=precision)
        folder.mkdir()
        self._log = (folder / "log.txt").open("w+b")
        words = [path, "--wipe", "--speedup", SPEEDUP, "--model", "JSON:127.0.0.1", "--instance", instance, "--home",
                 f"{HOME[0]},{HOME[1]},0,0", "--defaults", ",".join(map(str, defaults)),
                 "--serial0", f"udpclient:127.0.0.1:{port}"]  # fmt: skip
        self._process = subprocess.Popen(
            [*map(str, words)], cwd=folder, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log
        )

    def last(self) -> str:
        """How the program has ended, if it has, and its last line."""
        self._log.seek(0)
        line = self._log.read().decode(errors="replace").strip().splitlines()[-1:]
        ended = "" if self._process.poll() is None else f" It has ended with status {self._process.returncode}."
        return f"{ended} {' '.join(line)}"

    def close(self) -> None:
        """End the program."""
        self._process.kill()
        self._process.wait()
        self.link.close()
        self._log.close()


def companions(policy: str, config: Any, source: Path, count: int) -> list[Callable[[], PolicyFlight]]:
    """What makes companions of the `policy` (a run folder, or a scenario's name), each in one of `count` missions."""
    from rl.commands import shared
    from rl.learn.policy import CheckpointError
    from rl.learn.policy_sources import policies_from, shipped_policies
    from rl.missions.landing.mission import Landing

    name = config.landing.aircraft
    found = policies_from([policy], config) if shared.is_run(Path(policy)) else shipped_policies(policy)
    if name not in found:
        raise CheckpointError(f"--companion {policy}: no policy of {name}, but of {' and '.join(found)}")
    sea: Any = Landing.piloted(config, name)
    missions = [Landing(sea, 1, seed=config.seed, teams=(name,), source=source)]
    missions += [missions[0]._alike(1) for _ in range(count - 1)]
    return [partial(PolicyFlight, found, mission) for mission in missions]


def land(
    args: argparse.Namespace,
    config: Any,
    source: Path,
    seed: int,
    count: int,
    steer: Sequence[Callable[[], PolicyFlight]] = (),
) -> list[Any]:
    """The judges of `count` landings, each in an environment of its own, all at once.

    They are steered by what `steer` makes, or by the script.
    """
    from rl.runs.autopilots import others, shared_mission
    from taichi_sim.applications.sitl.lockstep import SilentError, Station
    from taichi_sim.config import ConfigError

    name = config.landing.aircraft
    longest = config.episode_duration + READY_WITHIN + 1e3
    mission: Any = shared_mission(
        config.model_copy(update={"episode_duration": longest}), [(name, 0)], seed=seed, rate=RATE, source=source,
        envs=count,
    )  # fmt: skip
    policies = others("classical", mission, [(name, 0)])
    acting = {team: policies[team] for team in mission.teams}
    mission.step(acting, begin=False, observe=())  # compiles, before anybody waits
    mission.begin_each()
    parameters = PARAMETERS | (PRECISION if args.precision else {})
    limit, dt, far = config.episode_steps, config.decision_interval, config.landing.distance[1]
    ports = {(name, 0, env): 9002 + 10 * (args.instance + env) for env in range(count)}
    with ExitStack() as open_things:
        folder = Path(open_things.enter_context(tempfile.TemporaryDirectory()))
        files = [folder / "landing.parm", *(file.resolve() for file in args.defaults)]
        files[0].write_text("".join(f"{key} {value}\n" for key, value in parameters.items()))
        station = open_things.enter_context(
            closing(Station(mission.world, ports, {}, address="127.0.0.1", timeout=COMES_WITHIN, tell=ignored))
        )
        flights, script = {}, {"soles": mission.aircraft.soles_below, "height": config.landing.height[0]}
        script["precision"] = args.precision
        for env, session in enumerate(station.sessions):
            flight = Flight(args.autopilot, args.instance + env, files, folder / str(env), **script)
            open_things.callback(flight.close)
            flights[session] = flight
        mission.measure_anew()
        time = 0.0
        while station.sessions:
            try:
                step = mission.step(acting, begin=False, observe=())
            except SilentError as error:
                silent = next(flights[session] for session in station.sessions if session.craft.ready)
                told = f"{error}.{silent.last()}"
                raise ConfigError(f"--autopilot {args.autopilot}: no ArduPilot? {told}") from None
            time += dt
            deck, distance = mission.aircraft.deck, mission.aircraft.distance[:, 0].tolist()
            place, moves, boats = (
                x[:, 0].double().cpu().numpy() for x in (deck.place, deck.velocity, mission.boats.fleet.state)
            )
            found, marker = (x[:, 0].double().cpu().numpy() for x in mission.aircraft.seen_marker)
            for session in [*station.sessions]:
                flight, env = flights[session], session.craft.env
                if flight.companion is not None:
                    flight.companion(flight.link, time, boats[env])
                else:
                    flight.script(time, dt, place[env], moves[env], marker[env] if found[env] else None)
                arms, away = flight.script.phase == "arms", distance[env]
                if flight.judge is not None:
                    flight.decisions += 1
                    flight.judge.see(step, flight.decisions)
                    if flight.decisions >= limit or (flight.judge.outcome[env] >= 0).all():
                        station.leave(session)
                        flight.close()
                elif not arms and (away < far or time > READY_WITHIN + AWAY * away / 100):
                    flight.judge = mission.Judge(mission, name)
                    flight.companion = steer[env]() if steer else None
                elif arms and time > READY_WITHIN:
                    told = f"after {time:.0f} s of its time it has not taken off; it says {flight.script.texts}"
                    raise ConfigError(f"{args.autopilot}: {told}")
    return [of_one(flight.judge, session.craft.env) for session, flight in flights.items()]


def of_one(judge: Any, env: int) -> Any:
    """The judge of one environment alone."""
    found = copy(judge)
    for key, value in vars(judge).items():
        if isinstance(value, np.ndarray):
            setattr(found, key, value[env : env + 1])
    found.mission = None  # it would keep the world
    return found


def ignored(text: str) -> None:
    """Take a line of news that nobody reads."""


def table(kind: Any, episodes: Mapping[str, NDArray[np.float64]]) -> dict[str, Sequence[float | None]]:
    """Figures of the landings: name -> value and the ends of its 95 % interval."""
    from rl.evaluation.intervals import intervals

    left_out = ("reward_per_step", "action_change_rms")
    return {key: tuple(of) for key, of in intervals(kind, episodes).items() if key not in left_out}


def parser() -> argparse.ArgumentParser:
    """The arguments."""
    from rl.commands import shared

    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("config", nargs="?", default="landing", metavar="SCENARIO", help="of the landing mission [landing]")
    p.add_argument("--autopilot", type=Path, required=True, metavar="PATH", help="ArduCopter, built for SITL")
    p.add_argument("--companion", metavar="POLICY", help="run folder or scenario whose policy steers [the script does]")
    p.add_argument("--precision", action="store_true", help="the firmware's precision landing, by our marker camera")
    p.add_argument("--landings", type=positive_int, default=64, metavar="N", help="[64]")
    p.add_argument("--defaults", type=Path, action="append", default=[], metavar="FILE", help="more parameters")
    p.add_argument("--at-once", type=positive_int, default=16, metavar="N", help="landings at a time [16]")
    p.add_argument("--instance", type=int, default=0, help="of the first autopilot: ports 9002 + 10 N [0]")
    p.add_argument("--seed", type=seed, help="of the first landing; the next ones follow [the scenario's]")
    p.add_argument("--json", type=output, metavar="FILE", help="also write the figures to FILE")
    shared.add_common(p)
    return p


def main(argv: list[str] | None = None) -> None:
    """Run the command."""
    args = parser().parse_args(argv)
    from rl.commands import shared
    from rl.evaluation.episodes import mission_class
    from rl.missions import load_scenario
    from rl.missions.landing.config import LandingScenario
    from taichi_sim.config import ConfigError
    from taichi_sim.config.io import find_config
    from taichi_sim.errors import needs

    args.autopilot = program(args.autopilot)
    most = min(args.at_once, args.landings)
    if not 0 <= args.instance <= INSTANCES - most:
        raise ConfigError(
            f"--instance {args.instance}: {most} landings at once need as many instances, of 0 to {INSTANCES - 1}"
        )
    with needs("pymavlink", "ardupilot"):
        import pymavlink  # noqa: F401
    source = find_config(args.config)
    config = load_scenario(source, args.overrides)
    if not isinstance(config, LandingScenario) or {part.count for part in config.parts.values()} != {1}:
        raise ConfigError(f"{args.config}: needs the mission landing, with one aircraft and one boat")
    if args.companion is not None and args.precision:
        raise ConfigError("--companion and --precision: either brings the copter down: leave one of them out")
    args.threads = args.threads or 1
    shared.start(args)
    steer = [] if args.companion is None else companions(args.companion, config, source, most)
    first, judges = config.evaluation.seed if args.seed is None else args.seed, []
    kind: Any = mission_class(config, source).Judge
    while len(judges) < args.landings:
        count = min(args.at_once, args.landings - len(judges))
        judges += land(args, config, source, first + len(judges), count, steer)
        if not args.quiet:
            print(f"{len(judges)} of {args.landings}: {kind.line(kind.figures(judges, config))}", flush=True)
    found = table(kind, kind.episodes(judges, config))
    for key, (value, low, high) in found.items():
        if value is not None:
            print(f"{key:22} {value:8.3f}  [{low:.3f}, {high:.3f}]")
    if args.json is not None:
        told = {"landings": args.landings, "seed": first, "figures": found}
        args.json.write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    from rl.commands.shared import run

    sys.exit(run(main))
