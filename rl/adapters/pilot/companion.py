"""The companion: from telemetry to what a policy observes, and from what it does to set points, once a decision.

The mission itself makes the observations: one environment of it, whose vehicles are written from telemetry instead of
being stepped (`Mission.follow`). So a policy observes what it was trained with, by the same code.

    waiting    until every autopilot has been heard, is one of the policy's vehicle, tells place and attitude, is armed,
               and is in the mode that obeys; then the course is laid, and the episode begins. Those that are
               followed, but not steered (in a landing the boat), need only tell
    acting     a decision every interval, set points to all
    holding    a vehicle's place or attitude is older than `STALE` decisions: all vehicles are ordered to stop. It goes
               on when all are fresh again
    ended      somebody has taken over, or something is wrong (`fault`); those that still obey are ordered to stop.
               Or all vehicles have rested where they were to go (`Team.rests`), and are disarmed: by somebody, or
               by the companion, if it may

The companion arms nobody, and asks for a mode only if told to. It reads no clock but `now`: tests give it theirs.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import torch

from rl.adapters.pilot.ais import Heard
from rl.adapters.pilot.autopilot_link import ARM, SET_MODE, Link
from rl.adapters.pilot.laid_course import LaidCourse
from rl.adapters.pilot.set_points import BOAT, Orders
from rl.guidance.course.route import FARTHEST
from rl.mission import Mission, Policy
from taichi_sim.config.arguments import ActionError
from taichi_sim.errors import UserError
from taichi_sim.kernels.conventions import QUATERNION, VELOCITY
from taichi_sim.kernels.rotation import torch_rotation_matrix
from taichi_sim.visualisation.recording.east_north_up import Origin, from_geodetic

ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
STALE = 5  # decisions; older telemetry stops the vehicles
LOST = 3.0  # s without new telemetry, after which it ends
SLOW = 0.97  # of our clock's pace; the clock of an autopilot that is slower is not a real one; assumed
COMES = 30.0  # s, within which the first HEARTBEAT of each autopilot and the parameters that orders need must come
OBEYS = 3.0  # s, within which a mode that was asked for must be taken
TELEMETRY = 4  # messages of each kind a decision, at least `SLOWEST`, at most `FASTEST` a second
SLOWEST, FASTEST = 10.0, 50.0  # Hz
POLL = 0.1  # s between looks while it waits
AGAIN = 1.0  # s between two tries to stop motors
REPORT = 5.0  # s between lines of progress
REPEATS = 3  # of a last order, against loss
RESTED = 0.5  # s at rest, after which a vehicle is where it was to go; assumed
STOPS = 5.0  # s, within which motors that were told to stop must do so
ABOVE = 2.0  # m, that a vehicle must be higher than the one which it follows, to begin
REHEARSAL = 3  # decisions
RESULTS = {1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 6: "cancelled"}  # MAV_RESULT


class PilotError(UserError, RuntimeError):
    """A companion that has ended because something was wrong; the message says what."""


class Ended(NamedTuple):
    """Why a companion has ended, and whether something was wrong."""

    why: str
    fault: bool


class Figures(NamedTuple):
    """Median, 95th percentile and worst of something in ms."""

    median: float
    p95: float
    worst: float

    @classmethod
    def of(cls, seconds: Sequence[float]) -> "Figures":
        """Figures of times (s)."""
        return cls(*(float(np.percentile(seconds, share)) * 1e3 for share in (50, 95, 100)))

    def __str__(self) -> str:
        """As text."""
        return f"median {self.median:.1f}, p95 {self.p95:.1f}, worst {self.worst:.1f} ms"


class Companion:
    """Acts for a team by a policy.

    Attributes:
        phase: "waiting", "acting" or "holding". ended: None until it has.
        decisions, late: decisions made; those that were skipped because the machine was late.
        links, followed: of the team's vehicles; of the vehicles of other teams, by team.
        delays: from reading the telemetry of a decision until its last set point was sent, s.
        ages: of the oldest telemetry of a decision, s.
    """

    def __init__(
        self, mission: Mission, name: str, policy: Policy, orders: Orders, links: Sequence[Link], *,
        tell: Callable[[str], None], origin: Origin | None = None, heading: float | None = None, guided: bool = False,
        progress: bool = True, followed: Mapping[str, Sequence[Link]] = MappingProxyType({}), disarm: bool = False,
        ais: Heard | None = None,
    ):  # fmt: skip
        """Act for team `name` of a `mission` with one environment, whose vehicle k is behind `links[k]`.

        The course begins at `origin`, along `heading` (rad); default: at the first vehicle, along its heading. With
        `guided`, vehicles are asked for the mode that obeys. `tell` takes a line of news, and of `progress`.
        `followed`: links of the vehicles of the other teams that the mission follows. With `disarm`, the motors of
        a vehicle are stopped once it rests where it was to go. `ais`: ships that are heard.
        """
        self.mission, self.team, self.policy = mission, mission.teams[name], policy
        self.orders, self.links, self.followed, self.disarm, self.ais = orders, links, followed, disarm, ais
        self.tell, self.origin, self.heading, self.guided, self.progress = tell, origin, heading, guided, progress
        self.interval = mission.config.decision_interval
        self.phase, self.ended = "waiting", None
        self.decisions = self.late = 0
        self.delays: list[float] = []
        self.ages: list[float] = []
        self._asked: dict[str, float] = {}  # vehicle -> when its mode was asked for, s
        self._squares: dict[str, np.ndarray] = {}  # sums over decisions, of each entry of the mission's info [vehicle]
        self._laid: LaidCourse | None = None
        self._taken: torch.Tensor | None = None
        self._begun: float | None = None
        self._due = self._reported = 0.0
        self._missing = ""
        self._rested = np.zeros(len(links))  # s that each vehicle has been at rest
        self._arrived = np.zeros(len(links), dtype=bool)  # those that have been for long enough
        self._told = np.full(len(links), math.inf)  # when it was first told to stop its motors, s
        self._again = 0.0  # when that is told again, s
        self._done: set[Link] = set()

    @property
    def heard(self) -> list[Link]:
        """All links, those of the team first."""
        return [*self.links, *chain.from_iterable(self.followed.values())]

    def rehearse(self) -> None:
        """Make some decisions for the vehicles of the simulation, so that the first real one waits for no compiler."""
        fleet, taken = self.team.fleet, None
        laid = LaidCourse(Origin(0.0, 0.0), 0.0, (0.0, 0.0), 0.0)
        for _ in range(REHEARSAL):
            self.mission.follow({self.team.name: fleet.state.clone()}, taken)
            self.team.gives_up()
            action = self._acted()
            self.orders.of(self.team, action, laid)
            taken = {self.team.name: action}
        self.mission.begin_each()

    # -- from call to call -----------------------------------------------------------------------------------------

    def tick(self, now: float) -> float:
        """Do what is due at `now` (s); return the seconds until something is due again."""
        if self._begun is None:
            self._begun = now
        if self.ended:
            return math.inf
        rate = min(max(TELEMETRY / self.interval, SLOWEST), FASTEST)
        for link in self.heard:
            link.converse(now, 1.0 / rate, self.orders.parameters if link in self.links else ())
        self._check_vehicles(now)
        if self.ended:
            return math.inf
        if self.phase != "waiting":
            self._check_obedience()
            if not self.ended and now >= self._due:
                self._turn(now)
            return math.inf if self.ended else max(min(self._due - now, POLL), 0.0)
        if self._ready(now):
            self._begin(now)
            return 0.0
        return POLL

    def end(self, why: str, *, fault: bool = False) -> None:
        """Stop the vehicles that obey, if it acts, leave the others to whom they obey, and end; once."""
        if self.ended:
            return
        for k, link in enumerate(self.links if self.phase != "waiting" else ()):
            for _ in range(REPEATS if link not in self._done else 0):
                self._stop(k) if self._obeys(link) else self.orders.release(link)
        self.ended = Ended(why, fault)

    def _stop(self, k: int) -> None:
        """Order vehicle k to stop, but for the vertical velocity that its team wants then."""
        self.orders.stop(self.links[k], float(self.team.stopped_down[0, k]))

    def _mode(self, mode: int) -> str:
        """The name of a mode, or its number."""
        return self.orders.modes.get(mode, f"mode {mode}")

    def _obeys(self, link: Link) -> bool:
        return link.heart is not None and link.heart.armed and link.heart.mode == self.orders.mode

    # -- checks ----------------------------------------------------------------------------------------------------

    def _check_vehicles(self, now: float) -> None:
        """End if an autopilot is another one than the policy's vehicle needs, or does not come."""
        wanted = " or ".join(f"{name} ({kind})" for kind, name in self.orders.kinds.items())
        late = self._begun is not None and now - self._begun > COMES
        for link in self.heard:
            heart = link.heart
            if heart is None:
                if late:
                    self.end(f"{link.name}: no autopilot has been heard within {COMES:g} s", fault=True)
                continue
            if link.other and self.phase == "waiting":
                self.end(f"{link.name}: autopilots of the systems {link.system} and {link.other} are heard there: name "
                         f"one, for example #{link.system} after the address", fault=True)  # fmt: skip
            elif link not in self.links:
                if heart.kind not in BOAT:
                    what = f"its HEARTBEAT has MAV_TYPE {heart.kind}; what is followed is a boat, {min(BOAT)}"
                    self.end(f"{link.name}: {what}", fault=True)
            elif heart.autopilot != ARDUPILOT:
                self.end(f"{link.name}: MAV_AUTOPILOT {heart.autopilot}: only ArduPilot ({ARDUPILOT}) is supported",
                         fault=True)  # fmt: skip
            elif heart.kind not in self.orders.kinds:
                policy = f"this policy is of {self.team.section.vehicle!r}"
                self.end(f"{link.name}: its HEARTBEAT has MAV_TYPE {heart.kind}; {policy}, which needs {wanted}",
                         fault=True)  # fmt: skip
            elif wrong := self._wrong_parameters(link, late):
                self.end(f"{link.name}: {wrong}", fault=True)

    def _wrong_parameters(self, link: Link, late: bool) -> str:
        """What of the parameters is not as the orders need it; empty if nothing is, or they are not all known yet."""
        needed, told = self.orders.parameters, link.parameters
        unknown = [name for name in needed if name not in told]
        if unknown:
            return f"it does not tell the parameter {unknown[0]} within {COMES:g} s" if late else ""
        wrong = [f"{name} {value:g} (it is {told[name]:g})" for name, value in needed.items() if told[name] != value]
        return f"thrust and yaw need {', '.join(wrong)}" if wrong else ""

    def _check_obedience(self) -> None:
        """End if somebody has taken a vehicle over. One that is disarmed at rest is done; so is all, if all are."""
        for k, link in enumerate(self.links):
            if link in self._done:
                continue
            if link.heart is not None and not link.heart.armed and self._arrived[k]:
                self._done.add(link)
                self.tell(f"{link.name} rests, and is disarmed")
                if len(self._done) == len(self.links):
                    self.ended = Ended("all vehicles rest, and are disarmed", False)
            elif link.heart is not None and not self._obeys(link):
                what = f"in {self._mode(link.heart.mode)}" if link.heart.armed else "disarmed"
                return self.end(f"{link.name} is {what}: somebody has taken over; no more set points")

    def _ready(self, now: float) -> bool:
        """Whether all vehicles are there, fresh, and obey; ask for their mode if told to, and tell what is missing."""
        missing = []
        for link in self.heard:
            ours = link in self.links
            if link.heart is None:
                missing.append(f"the HEARTBEAT of {link.name}")
            elif ours and any(name not in link.parameters for name in self.orders.parameters):
                missing.append(f"parameters of {link.name}")
            elif link.age(now) > self._stale:
                missing.append(f"{link.missing} of {link.name}")
            elif ours:
                if link.heart.mode != self.orders.mode:
                    missing.append(
                        f"{link.name} in {self._mode(self.orders.mode)} (it is {self._mode(link.heart.mode)})"
                    )
                    if self.guided and self._refuses(link, now):
                        return False
                if not link.heart.armed:
                    missing.append(f"{link.name} armed")
        if not missing:
            missing = self._far()
        news = f"waiting for {', '.join(missing)}" if missing else ""
        if news != self._missing:
            self._missing = news
            if news:
                self.tell(news)
        return not missing

    def _far(self) -> list[str]:
        """Vehicles that are not near enough, or not high enough, over those that they follow; or far from a route."""
        missing, route = [], self.mission.origin if self.origin is None and self.heading is None else None
        for link in self.links:
            if route is not None and (away := _apart(link, route)) > FARTHEST:
                where = f"{route.latitude:.4f} {route.longitude:.4f}"
                missing.append(f"{link.name} near the route about {where} (it is {away / 1e3:.0f} km away: a route of "
                               "another place, or latitude and longitude are exchanged)")  # fmt: skip
        for name, most in self.mission.followed(self.team).items():
            for link, other in zip(self.links, self.followed[name], strict=True):
                (here, _), (there, _) = link.last, other.last
                away = _apart(link, Origin(there.latitude, there.longitude))
                up = here.altitude - there.altitude
                if away > most or up < ABOVE:
                    where = f"it is {away:.0f} m away, {up:.1f} m above"
                    missing.append(f"{link.name} within {most:g} m of {other.name}, {ABOVE:g} m above it ({where})")
        return missing

    def _refuses(self, link: Link, now: float) -> bool:
        """Ask a vehicle for the mode that obeys; end if it refuses, or does not take it."""
        mode = self._mode(self.orders.mode)
        if link.name not in self._asked:
            self._asked[link.name] = now
            link.set_mode(self.orders.mode)
        elif SET_MODE in link.refused:
            result = link.refused[SET_MODE]
            self.end(f"{link.name} refuses {mode}: {RESULTS.get(result, f'MAV_RESULT {result}')}", fault=True)
        elif now - self._asked[link.name] > OBEYS:
            self.end(f"{link.name} has not taken {mode} within {OBEYS:g} s", fault=True)
        return self.ended is not None

    @property
    def _stale(self) -> float:
        """Age of telemetry that stops the vehicles, s."""
        return STALE * self.interval

    # -- acting ----------------------------------------------------------------------------------------------------

    def _begin(self, now: float) -> None:
        """Lay the course on the sea."""
        there, faced = self.links[0].last
        origin = self.origin or Origin(there.latitude, there.longitude)
        heading = faced.euler[2] if self.heading is None else self.heading
        self.phase, self._due, self._reported, self._taken = "acting", now, now, None
        laid = self.mission.course(self.team)
        if laid is None:
            self._laid = LaidCourse(origin, 0.0, (0.0, 0.0), 0.0, level=self.heard[-1].last[0].altitude)
            return self.tell("acting")
        afloat, own = self.team.fleet.model.medium == "water", self.mission.origin
        if own is not None and self.origin is None and self.heading is None:  # the course is where it is
            self._laid = LaidCourse(own, 0.0, (0.0, 0.0), 0.0, afloat=afloat)
            begin = torch.from_numpy(self._laid.states(self.links[:1], now)[0, :2])
            self.mission.join(self.team, begin.to(self.team.fleet.state))
            return self.tell(f"acting: along the route about {own.latitude:.7f} {own.longitude:.7f}")
        place, course = laid
        (north, east), chi = place[0].tolist(), float(course[0])
        self._laid = LaidCourse(origin, heading, (north, east), chi, afloat=afloat)
        toward, along = (math.degrees(angle) % 360.0 for angle in (heading, chi))
        self.tell(
            f"acting: the course begins at {origin.latitude:.7f} {origin.longitude:.7f}, along {toward:.0f} deg "
            f"(in the mission at {north:.1f} {east:.1f} m, along {along:.0f} deg)"
        )

    def _turn(self, now: float) -> None:
        """Decide, or hold: the time for it has come."""
        turns = 1 + int((now - self._due) / self.interval)
        self.late += turns - 1
        self._due += turns * self.interval
        each = zip(self.links, *self.followed.values(), strict=True)  # vehicles, with those that they follow
        ages = {link: link.age(now) for row in each if row[0] not in self._done for link in row}
        worst = max(ages, key=lambda link: ages[link])
        if ages[worst] > LOST:
            silent = now - worst.heard
            how = "its link is silent"
            if silent <= LOST:
                how = f"though it was heard {silent:.1f} s ago: its messages tell no later time"
                if (pace := worst.pace.value) < SLOW:
                    how += (
                        f", or its clock runs at {pace:.2f} of ours: a simulation slower than real time "
                        "(docs/sitl.md, Pace), or a link that lags ever more"
                    )
            return self.end(f"{worst.name}: no new telemetry for {ages[worst]:.1f} s, {how}", fault=True)
        if ages[worst] > self._stale:
            if self.phase == "acting":
                self.tell(f"holding: the telemetry of {worst.name} is {ages[worst]:.1f} s old")
            self.phase = "holding"
            for k, link in enumerate(self.links):
                if link not in self._done:
                    self._stop(k)
            return
        if self.phase == "holding":
            self.tell("acting again: all telemetry is fresh")
        self.phase = "acting"
        self._decide(now, ages[worst])

    def _decide(self, now: float, age: float) -> None:
        began, name, like = time.perf_counter(), self.team.name, self.team.fleet.state
        assert self._laid is not None, "no course"
        states = {
            team: torch.from_numpy(self._laid.states(links, now))[None].to(like)
            for team, links in {name: self.links, **self.followed}.items()
        }
        self._blow(self._laid, states[name])
        self.mission.follow(states, None if self._taken is None else {name: self._taken})
        if self.ais is not None:
            self.mission.hear(self.team, self.ais.tracks(self._laid, now, states[name][0, 0, :2]))
        for ending, flags in self.team.gives_up().items():
            given = flags[0].cpu().numpy() & ~self._arrived
            if given.any():
                who = self.links[int(given.argmax())].name
                return self.end(f"{who}: {ending!r}, which ends an episode of {self.mission.config.name!r}", fault=True)
        try:
            self._taken = self._acted()
        except ActionError as error:
            return self.end(str(error), fault=True)
        given = self.orders.of(self.team, self._taken, self._laid)
        for link, order in zip(self.links, given, strict=True):
            if link not in self._done:
                self.orders.give(link, order)
        self._rest(now)
        self.delays.append(time.perf_counter() - began)
        self.ages.append(age)
        self.decisions += 1
        self._report(now)

    def _acted(self) -> torch.Tensor:
        """Vehicle actions [1, vehicle, a] by the policy."""
        return self.team.taken(self.team.checked(self.policy(self.team)))

    def _rest(self, now: float) -> None:
        """Follow which vehicles rest where they were to go; stop their motors, if it may, until they say so."""
        rests = self.team.rests[0].cpu().numpy()
        self._rested = np.where(rests, self._rested + self.interval, 0.0)
        again = now >= self._again
        for k, link in enumerate(self.links):
            if link in self._done or self._rested[k] < RESTED:
                continue
            if not self._arrived[k]:
                self._arrived[k] = True
                self.tell(f"{link.name} rests" + ("" if self.disarm else ": disarm it, it is held there until then"))
            if self.disarm and again:
                self._again = now + AGAIN
                self._told[k] = min(self._told[k], now)
                if now - self._told[k] > STOPS:
                    result = RESULTS.get(link.refused.get(ARM, 0), "no answer")
                    return self.end(f"{link.name} rests, and does not stop its motors: {result}", fault=True)
                link.disarm()

    def _blow(self, laid: LaidCourse, states: torch.Tensor) -> None:
        """Write airspeed and wind, if the team's vehicles measure them, by their `states` [1, vehicle, 13]."""
        fleet, columns = self.team.fleet, self.team.observed_air
        if not columns:
            return
        wind = np.stack([laid.in_mission(link.wind) for link in self.links])
        R = torch_rotation_matrix(states[0, :, QUATERNION]).double().cpu().numpy()
        through = np.einsum("vij,vj->vi", R, states[0, :, VELOCITY].double().cpu().numpy()) - wind
        air = np.column_stack((np.linalg.norm(through, axis=1), wind))
        fleet.aux[0, :, list(columns)] = torch.from_numpy(air).to(fleet.aux)

    def _report(self, now: float) -> None:
        """Add up what the mission's info says of each vehicle, and tell it from time to time."""
        info = {key: value[0].double().cpu().numpy() for key, value in self.team.infos().items()}
        self._squares = {key: self._squares.get(key, 0.0) + value**2 for key, value in info.items()}
        if self.progress and now - self._reported >= REPORT:
            self._reported = now
            told = (f"{key} {' '.join(f'{x:.2f}' for x in value)}" for key, value in info.items())
            self.tell("; ".join((f"{self.decisions} decisions", *told)))

    def summary(self) -> str:
        """What was done, in lines; empty if nothing was."""
        if not self.decisions:
            return ""
        rms = {key: np.sqrt(value / self.decisions) for key, value in self._squares.items()}
        return "\n".join((
            f"{self.decisions} decisions of {self.interval:g} s, {self.late} skipped",
            f"from telemetry to set points: {Figures.of(self.delays)}",
            f"age of the telemetry then: {Figures.of(self.ages)}",
            *(f"{key}, rms: {' '.join(f'{x:.2f}' for x in value)}" for key, value in rms.items()),
        ))  # fmt: skip


def _apart(link: Link, place: Origin) -> float:
    """Distance of a vehicle from `place`, by its telemetry, m."""
    here = link.last[0]
    return float(np.linalg.norm(from_geodetic(np.array((here.latitude, here.longitude, 0.0)), place)))
