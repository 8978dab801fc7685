"""A policy lands a copter as its MAVLink companion: copter and boat are those of a mission, and speak MAVLink."""

import math
import socket
from contextlib import ExitStack

import pytest
import torch
from phases import check_followed
from pilot_peer import kinds

from rl.adapters.pilot.autopilot_link import Link
from rl.adapters.pilot.companion import Companion
from rl.adapters.pilot.laid_course import quaternion, rotated
from rl.adapters.pilot.set_points import orders_of
from rl.commands.pilot import parser
from rl.learn.policy import ClassicalPolicy
from rl.missions import load_scenario, make_mission
from rl.missions.landing.mission import Landing
from taichi_sim.kernels.conventions import DOWN
from taichi_sim.kernels.rotation import torch_euler_from_quaternion
from tools.firmware_landings import boat_tells

CALM = (
    "vary={}", "sea.sea_state=1", "sea.realisations=1", "air.speed=1", "landing.distance=[6, 8]",
    "landing.height=[4, 5]",
)  # fmt: skip
GUIDED, FORCED = 4, 21196


class Sea:
    """A landing whose aircraft obeys the velocities that it is sent, a decision later, and a companion that sends them.

    Attributes:
        real: the mission. sent: messages to the copter and to the boat, by kind. armed: as the copter says.
    """

    def __init__(self, *, disarm: bool):
        config = load_scenario("landing", CALM)
        piloted = Landing.piloted(config, "uav")
        assert piloted is not None
        self.real, follows = (
            make_mission(config, 1, seed=3, teams=("uav",)),
            Landing(piloted, 1, seed=1, teams=("uav",)),
        )
        self.real.begin_each()
        self.team, self.armed, self.time, self.news = self.real.teams["uav"], True, 0.0, []
        self.obeys, self.told_off = True, (0.0, 0.0, 0.0)  # whether it disarms; how far off the boat's place is told, m
        self.sent: tuple[dict, dict] = ({}, {})
        self._out = [kinds.MAVLink(None, srcSystem=k + 1, srcComponent=1) for k in range(2)]
        self._links = [Link(name, lambda data, k=k: self._hear(k, data)) for k, name in enumerate(("copter", "boat"))]
        team = follows.teams["uav"]
        self.pilot = Companion(
            follows, "uav", ClassicalPolicy(), orders_of(team), self._links[:1], tell=self.news.append,
            followed={"usv": self._links[1:]}, disarm=disarm,
        )  # fmt: skip
        self.pilot.rehearse()

    def _hear(self, k: int, data: bytes) -> None:
        for m in kinds.MAVLink(None).parse_buffer(data):
            self.sent[k].setdefault(m.get_type(), []).append(m)
            if k == 0 and m.get_type() == "COMMAND_LONG" and m.command == 400:
                assert (m.param1, m.param2) == (0.0, FORCED)
                self.armed = not self.obeys

    def _tell(self) -> None:
        fleets = self.team.fleet, self.real.boats.fleet
        for link, out, fleet, kind in zip(self._links, self._out, fleets, (2, 11), strict=True):
            state = fleet.state[0, 0].double().numpy()
            state[:3] += self.told_off if kind == 11 else 0.0
            for data in boat_tells(out, self.time, state):
                link.receive(data, self.time)
            mode, armed = (GUIDED, 128 * self.armed) if kind == 2 else (0, 0)
            link.receive(out.heartbeat_encode(kind, 3, armed, mode, 4).pack(out), self.time)

    def run(self, seconds: float) -> "Sea":
        model, dt = self.team.fleet.model.demands, self.real.config.decision_interval
        for _ in range(round(seconds / dt)):
            self._tell()
            self.pilot.tick(self.time)
            asked = self.sent[0].get("SET_POSITION_TARGET_LOCAL_NED")
            if self.pilot.ended or not asked:
                action = (0.0, 0.0, 1.0 if self.pilot.ended else 0.0, 0.0)
            else:
                m = asked[-1]
                down = m.vz / (model.descent if m.vz > 0 else model.climb)
                action = (m.vx / model.speed, m.vy / model.speed, down, m.yaw_rate / model.yaw_rate)
            self.real.drive({"uav": torch.tensor([[action]])}, begin=False)
            self.time += dt
        return self


def test_what_a_landing_follows_is_observed_as_what_moves():
    """Boat and aircraft are written; there are no errors."""
    piloted = Landing.piloted(load_scenario("landing", CALM), "uav")
    assert piloted is not None
    check_followed(*(Landing(piloted, 1, seed=1, teams=("uav",)) for _ in range(2)))


def test_soles_near_a_deck_stand_on_it_by_telemetry():
    config = load_scenario("landing", CALM)
    piloted = Landing.piloted(config, "uav")
    assert piloted is not None
    mission = Landing(piloted, 1, seed=1, teams=("uav",))
    team = mission.teams["uav"]
    boat, craft = (mission.world.teams[name].state.clone() for name in ("usv", "uav"))
    mission.follow({"usv": boat})
    for height, away, on in ((0.05, 0.0, True), (0.15, 0.0, False), (0.05, 1.5, False)):
        craft[0, 0, :3] = team.deck.place[0, 0] + torch.tensor((away, 0.0, -height - team.soles_below))
        craft[0, 0, 3:] = torch.tensor((*boat[0, 0, 3:7].tolist(), *(0.0,) * 6))
        mission.follow({"usv": boat, "uav": craft}, {"uav": torch.zeros(1, 1, 4)})
        assert bool(team.touches) is on and bool(team.standing) is on
    assert float(team.stood) == 0.0 and not bool(team.rests)


def test_rates_turn_an_attitude_as_small_steps_do():
    q, rates = quaternion(0.2, -0.1, 1.0), torch.tensor((0.3, -0.2, 0.5)).double().numpy()
    small, start = q, torch.tensor((0.2, -0.1, 1.0), dtype=torch.float64)
    for _ in range(1000):
        small = rotated(small, 1e-3 * rates)
    torch.testing.assert_close(torch.tensor(rotated(q, rates)), torch.tensor(small), rtol=0.0, atol=1e-12)
    still = torch_euler_from_quaternion(torch.tensor(rotated(q, 0 * rates)))
    torch.testing.assert_close(still, start, rtol=0.0, atol=1e-12)


def test_a_companion_lands_a_copter_on_a_boat_and_stops_its_motors_if_it_may():
    sea = Sea(disarm=True).run(20.0)
    assert sea.pilot.ended is not None and not sea.pilot.ended.fault and "rest" in sea.pilot.ended.why
    assert not sea.armed and bool(sea.team.standing) and float(sea.team.offset[0, 0, :2].norm()) < 0.2  # m
    assert float(sea.team.touch_speed) < sea.real.config.landing.hard_speed
    assert set(sea.sent[1]) <= {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"}  # nothing is ordered of the boat
    assert {m.command for m in sea.sent[1].get("COMMAND_LONG", [])} <= {511}


@pytest.mark.slow
def test_without_leave_to_disarm_it_is_held_down_until_somebody_does():
    sea = Sea(disarm=False).run(20.0)
    assert sea.pilot.ended is None and sea.armed and bool(sea.team.standing)
    assert "copter rests: disarm it, it is held there until then" in sea.news
    last = sea.sent[0]["SET_POSITION_TARGET_LOCAL_NED"][-1]
    assert last.vz == pytest.approx(sea.team.fleet.model.demands.descent)  # its rotors idle
    sea.armed = False
    sea.run(1.0)
    assert sea.pilot.ended is not None and not sea.pilot.ended.fault and "rest, and are" in sea.pilot.ended.why


@pytest.mark.slow
def test_motors_that_do_not_stop_are_told_again_and_then_named():
    sea = Sea(disarm=True)
    sea.obeys = False
    sea.run(25.0)
    assert sea.pilot.ended is not None and sea.pilot.ended.fault and "does not stop its motors" in sea.pilot.ended.why
    orders = [m for m in sea.sent[0]["COMMAND_LONG"] if m.command == 400]
    assert 5 <= len(orders) <= 6  # one a second
    last = sea.sent[0]["SET_POSITION_TARGET_LOCAL_NED"][-1]
    assert last.vz == pytest.approx(sea.team.fleet.model.demands.descent)  # it is not told to hover on the deck


@pytest.mark.slow
def test_one_that_is_stopped_near_the_deck_rises_from_it():
    sea = Sea(disarm=True)
    while float(sea.team.distance) > 1.0:
        sea.run(0.1)
    sea.pilot.end("interrupted")
    assert sea.sent[0]["SET_POSITION_TARGET_LOCAL_NED"][-1].vz < 0.0


@pytest.mark.slow
@pytest.mark.parametrize("up", [1.5, -1.5])
def test_a_copter_whose_boat_tells_another_height_is_not_disarmed_in_the_air(up):
    """Its height over the deck by telemetry is wrong by 1.5 m, either way."""
    sea = Sea(disarm=True)
    sea.told_off = (0.0, 0.0, -up)
    for _ in range(200):
        armed = sea.armed
        sea.run(0.1)
        assert sea.armed or not armed or float(sea.team.height) < 0.1
    assert not sea.pilot.ended or not sea.armed or sea.pilot.ended.fault


def test_a_boat_that_is_elsewhere_is_named_before_anything_is_ordered():
    sea = Sea(disarm=True)
    sea.told_off = (500.0, 0.0, 0.0)
    sea.run(1.0)
    assert sea.pilot.phase == "waiting"
    assert sea.news[-1].startswith("waiting for copter within 8 m of boat, 2 m above it (it is 49")
    assert "SET_POSITION_TARGET_LOCAL_NED" not in sea.sent[0]


@pytest.mark.slow
@pytest.mark.parametrize("silent", [0, 1])
def test_a_boat_that_falls_silent_stops_the_copter_in_the_air(silent):
    """Of either vehicle, the copter's approach is stopped, and ends."""
    sea = Sea(disarm=True).run(1.0)
    sea._links[silent].receive = lambda data, now: None
    sea.run(1.0)
    assert sea.pilot.phase == "holding"
    assert sea.news[-1].startswith(f"holding: the telemetry of {('copter', 'boat')[silent]}")
    last = sea.sent[0]["SET_POSITION_TARGET_LOCAL_NED"][-1]
    assert (last.vx, last.vy, last.vz) == (0.0, 0.0, 0.0)
    sea.run(3.0)
    assert sea.pilot.ended is not None and sea.pilot.ended.fault
    assert float(sea.team.fleet.position_n[0, 0, DOWN]) < -1.0 and not math.isnan(sea.time)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("landing",), ("0 x --follow", "1 of usv")),
        (("landing", "--set", "uav.count=2", "--connect", "udp:127.0.0.1:{}"), ("uav.count = 2", "usv.count = 1")),
        (("cruise", "--team", "usv", "--set", "usv.count=1", "--disarm"), ("--disarm", "landings")),
        (
            ("cruise", "--team", "usv", "--set", "usv.count=1", "--follow", "udp:127.0.0.1:{}"),
            ("--follow", "follows none"),
        ),
        (("landing", "--follow", "udp:127.0.0.1:{}", "--heading", "90"), ("--heading", "no course")),
        (("landing", "--follow", "udp:127.0.0.1"), ("connection udp:127.0.0.1", "expected")),
    ],
)
def test_what_a_landing_needs_is_named(arguments, words, here):
    with ExitStack() as held:
        sockets = [held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        first, second = (one.getsockname()[1] for one in sockets)
    filled = [word.format(first) for word in arguments]
    here("rl.commands.pilot", *filled, "--connect", f"udp:127.0.0.1:{second}").fails(*words)


def test_the_help_tells_of_landings():
    assert "--follow" in parser().format_help() and "--disarm" in parser().format_help()
