"""A policy as a MAVLink companion, against a peer that has ArduPilot's documented behaviour (pilot_peer.py)."""

import math
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import ROOT
from phases import check_followed
from pilot_peer import FRAME, GUIDED, HOLD, MANUAL, NO_AXIS, PARAMETERS, Copter, Flotilla, kinds

from rl.adapters.pilot.ais import Heard, Teller
from rl.adapters.pilot.autopilot_link import Attitude, Fix, Link
from rl.adapters.pilot.clock import Clock
from rl.adapters.pilot.companion import LOST, STALE, Companion
from rl.adapters.pilot.connections import Address, Wire, check_different, read_address
from rl.adapters.pilot.laid_course import LaidCourse, quaternion
from rl.adapters.pilot.set_points import Sticks, orders_of
from rl.learn.actor import Actor
from rl.learn.policy import ClassicalPolicy, write_checkpoint
from rl.missions import load_scenario
from rl.missions.encounter.mission import Encounter
from rl.missions.formation.mission import Formation
from rl.runs import folder
from taichi_sim.bench import Bench
from taichi_sim.config import AirConfig, ConfigError, SeaConfig
from taichi_sim.config.io import find_config
from taichi_sim.kernels.rotation import numpy_rotation_matrix
from taichi_sim.visualisation.recording.east_north_up import FJORD, Origin, geodetic

HEADING = math.radians(70.0)  # of the boats, and of their course on the sea
SIDE = np.array([-math.sin(HEADING), math.cos(HEADING)])  # to starboard
SPACING = 6.0  # m
STARTS = [(*(k * SPACING * SIDE), HEADING) for k in (0, 1, -1)]  # the slots of `abreast`


def piloted(scenario: str, *overrides: str, team: str = "usv") -> Formation:
    return Formation(Formation.piloted(load_scenario(scenario, overrides), team), 1, seed=1, teams=(team,))


class Fleet:
    """A companion and the boats that it steers, in simulated time."""

    def __init__(self, mission: Formation, boats: Flotilla, policy):
        self.mission, self.boats, self.policy = mission, boats, policy
        ((self.name, self.team),) = mission.teams.items()
        self.orders, self.airy = orders_of(self.team), bool(self.team.observed_air)

    def begin(self, mode: int, *, armed: bool = True, guided: bool = False, starts=STARTS) -> "Fleet":
        self.boats.begin(starts, mode, armed=armed)
        self.mission.begin_each()
        self.links = [
            Link(f"boat {k + 1}", self.boats.sender(k), station=self.orders.station, airy=self.airy)
            for k in range(len(starts))
        ]
        self.boats.receivers = [link.receive for link in self.links]
        self.news: list[str] = []
        self.errors: list[np.ndarray] = []
        self.pilot = Companion(
            self.mission, self.name, self.policy, self.orders, self.links, tell=self.news.append, guided=guided
        )
        return self

    def run(self, seconds: float) -> "Fleet":
        ends = self.boats.clock.now + seconds
        while self.boats.clock.now < ends and self.pilot.ended is None:
            self.boats.step()
            before = self.pilot.decisions
            self.pilot.tick(self.boats.clock.now)
            if self.pilot.decisions > before:
                self.errors.append(self.team.distance[0].numpy().copy())
        return self

    def heard(self, k: int, kind: str) -> list:
        return self.boats.autopilots[k].heard.get(kind, [])

    def ends(self, *words: str, fault: bool) -> None:
        assert self.pilot.ended is not None and self.pilot.ended.fault is fault
        for word in words:
            assert word in self.pilot.ended.why


@pytest.fixture(scope="module")
def boats() -> Flotilla:
    return Flotilla(3)


@pytest.fixture(scope="module")
def sticks(boats) -> Fleet:
    """Three Otters in MANUAL; the classical controller of `cruise` commands their thrust and yaw."""
    return Fleet(piloted("cruise"), boats, ClassicalPolicy())


@pytest.fixture(scope="module")
def guided(boats) -> Fleet:
    """Three Otters in GUIDED; a policy of `otter` that corrects nothing."""
    return Fleet(piloted("otter"), boats, lambda team: torch.zeros(1, 3, 2))


# -- what is observed, and what is ordered -----------------------------------------------------------------------------


def test_what_is_followed_is_observed_as_what_is_stepped():
    check_followed(piloted("paper", "radio.loss=0.1"), piloted("paper", "radio.loss=0.1"))


def _link(place, velocity=(0.0, 0.0, 0.0), euler=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0), now=0.0) -> Link:
    """A link that has just heard of a place (north, east of the fjord, m)."""
    link = Link("boat", lambda data: None)
    lat, lon, _ = geodetic(np.array((place[1], place[0], 0.0)), FJORD)
    link.place, link.attitude = Fix(lat, lon, 0.0, 0.0, velocity), Attitude(euler, rates)
    link.placed = link.turned = now
    return link


def test_a_chart_is_a_rigid_motion_that_lays_the_course_where_it_is_asked_to():
    origin, heading, course = Origin(*geodetic(np.array((80.0, -200.0, 0.0)), FJORD)[:2]), 1.2, -0.7
    chart = LaidCourse(origin, heading, (300.0, 40.0), course, afloat=True)
    links = [_link((-200.0, 80.0), (math.cos(1.2), math.sin(1.2), 0.0), (0.1, -0.05, heading)), _link((-170.0, 40.0))]
    at, there = chart.states(links, 0.0)
    np.testing.assert_allclose(at[:3], (300.0, 40.0, 0.0), atol=1e-6)  # the origin is where the course begins
    np.testing.assert_allclose(at[3:7], quaternion(0.1, -0.05, course), atol=1e-12)  # along it
    R = numpy_rotation_matrix(at[3:7])
    np.testing.assert_allclose(R @ at[7:10], (math.cos(course), math.sin(course), 0.0), atol=1e-12)
    assert np.hypot(*(there - at)[:2]) == pytest.approx(50.0, abs=1e-3)  # the plane leaves the round Earth
    ahead = np.array((math.cos(course), math.sin(course)))
    np.testing.assert_allclose(chart.over_sea(ahead), (math.cos(heading), math.sin(heading)), atol=1e-12)


def test_telemetry_is_moved_on_by_its_age():
    chart = LaidCourse(FJORD, 0.0, (0.0, 0.0), 0.0, afloat=True)
    link = _link((10.0, 5.0), (1.5, -0.5, 0.2), (0.0, 0.0, 0.3), (0.0, 0.0, 0.1), now=7.0)
    (state,) = chart.states([link], 7.2)
    np.testing.assert_allclose(state[:3], (10.3, 4.9, 0.0), atol=1e-5)
    np.testing.assert_allclose(state[3:7], quaternion(0.0, 0.0, 0.32), atol=1e-12)


def test_throttle_and_steering_turn_the_shafts_as_the_action_does(sticks):
    """Left = throttle + steering, right = throttle - steering: their thrusts k |n| n are those of surge and yaw."""
    team = sticks.mission.teams["usv"]
    t = team.fleet.model.params.thrusters
    action = torch.tensor([[[-1.0, 0.0], [0.2, 0.3], [-0.6, -0.35]]], dtype=torch.float64)
    orders = Sticks(team.fleet.model).of(team, action, LaidCourse(FJORD, 0.0, (0.0, 0.0), 0.0, afloat=True))
    shares = np.stack((orders.sum(1), orders[:, 0] - orders[:, 1]), axis=1)
    n = np.where(shares > 0, shares * t.n_max, -shares * t.n_min)
    thrust = np.where(n > 0, t.k_positive, t.k_negative) * np.abs(n) * n
    surge, yaw = action[0].numpy().T
    np.testing.assert_allclose(thrust.sum(1), (surge + 1) * t.thrust_max, atol=1e-9)
    np.testing.assert_allclose(thrust[:, 0] - thrust[:, 1], yaw * (t.thrust_max - t.thrust_min), atol=1e-9)
    assert np.abs(orders).sum(1).max() <= 1.0  # nothing for the autopilot to scale


def test_actions_without_set_points_are_refused_by_name():
    for scenario, team, words in (
        ("cruise", "uav", ("pitch, yaw, boost", "FixedWing6DOF")),
        ("paper", "usv", ("acceleration, yaw", "UnityBoat")),
    ):
        with pytest.raises(ConfigError) as error:
            orders_of(piloted(scenario, team=team).teams[team])
        assert all(word in str(error.value) for word in words)


# -- on the sea --------------------------------------------------------------------------------------------------------


def test_a_boat_follows_a_route_where_its_file_says(tmp_path):
    """It begins beside the middle of a leg, 3 m off, and goes on along that leg, where it lies on the sea."""
    corners = np.array([(0.0, -30.0), (200.0, -30.0), (200.0, 60.0), (0.0, 60.0)])  # north, east of the fjord, m
    places = [geodetic(np.array((east, north, 0.0)), FJORD) for north, east in corners]
    file = tmp_path / "route.csv"
    file.write_text("latitude,longitude\n" + "".join(f"{p[0]:.9f},{p[1]:.9f}\n" for p in places))
    mission = piloted("otter", "usv.count=1", f"track.file={file}", "track.min_radius=15")
    fleet = Fleet(mission, Flotilla(1), lambda team: torch.zeros(1, 1, 2))
    fleet.begin(GUIDED, starts=[(80.0, -27.0, 0.0)]).run(40.0)
    assert fleet.pilot.ended is None and any("along the route about 63.48" in line for line in fleet.news)
    north, east = fleet.boats.motion()[0][0][:2]
    assert abs(east + 30.0) < 1.0 and 80.0 + 30 * 1.5 < north < 80.0 + 41 * 1.5


@pytest.mark.slow
def test_a_boat_gives_way_to_a_ship_that_it_hears_by_ais():
    """Head-on: SB-MPC orders a course to starboard, and leads back to the route when the ship has passed."""
    sea = load_scenario("encounter", ("usv.vehicle=otter", "encounter.speed=1.5"))
    mission = Encounter(Encounter.piloted(sea, "usv"), 1, seed=1, teams=("usv",))
    fleet = Fleet(mission, Flotilla(1), ClassicalPolicy()).begin(GUIDED, starts=[(0.0, 0.0, 0.0)])
    ship, heard = Bench("merchant_ship", dt=0.1, envs=1), Heard(60.0)
    wire = Wire(Address("udp", "127.0.0.1", _free_port()))
    ship.put((220.0, 3.0, 0.0), (0.0, 0.0, math.pi), (2.0, 0.0, 0.0))
    tells = Teller(ship.fleet, sea.ais.model_copy(update={"carried": 1.0}), wire.address[1:3], FJORD, 1.0, seed=1)
    fleet.pilot.ais, gaps, aside = heard, [], []
    with closing(wire), closing(tells):
        for second in range(140):
            ship.step((1.0, 2 * 2.0 / ship.model.limits.speeds[2] - 1.0), times=10)
            tells()
            while fleet.boats.clock.now < second:
                fleet.boats.step()
                fleet.pilot.tick(fleet.boats.clock.now)
            heard.receive(wire.receive(), fleet.boats.clock.now)
            gaps.append(np.linalg.norm(fleet.boats.motion()[0][0][:2] - ship.fleet.position_n[0, 0, :2].numpy()))
            aside.append(fleet.boats.motion()[0][0][1])
    assert fleet.pilot.ended is None and len(heard.reports) == 1
    assert min(gaps) > 30.0 and max(aside) > 20.0 and min(aside) > -3.0
    assert aside[-1] < 0.7 * max(aside)


def test_a_boat_far_from_its_route_waits(tmp_path):
    """Latitude and longitude are exchanged, in a place where that is one, too."""
    (file := tmp_path / "route.csv").write_text("latitude,longitude\n10.4,63.48\n10.4,63.483\n10.403,63.483\n")
    mission = piloted("otter", "usv.count=1", f"track.file={file}", "track.min_radius=15")
    fleet = Fleet(mission, Flotilla(1), lambda team: torch.zeros(1, 1, 2))
    fleet.begin(GUIDED, starts=[(0.0, 0.0, 0.0)]).run(1.0)
    assert fleet.pilot.phase == "waiting" and re.search(
        r"near the route about 10.4\d* 63.4\d* \(it is [67]\d\d\d km away: .* exchanged", "".join(fleet.news)
    )


def test_three_boats_hold_their_formation_in_manual(sticks):
    sticks.begin(MANUAL).run(16.0)
    assert sticks.pilot.ended is None and sticks.pilot.decisions >= 75
    assert np.sqrt(np.mean(np.square(sticks.errors[40:]), axis=0)).max() < 0.3  # m
    place, *_ = sticks.boats.motion()[0]
    along = place[:2] @ np.array([math.cos(HEADING), math.sin(HEADING)])
    assert along == pytest.approx(1.5 * 15.8, rel=0.15)  # m: the target's way, along the boats' first heading
    orders = sticks.heard(0, "MANUAL_CONTROL")
    assert {m.get_srcSystem() for m in orders} == {255} and {m.target for m in orders} == {1}
    assert not any(sticks.heard(k, kind) for k in range(3) for kind in ("PARAM_SET", "RC_CHANNELS_OVERRIDE"))
    assert {m.command for m in sticks.heard(0, "COMMAND_LONG")} == {511}  # it asks for messages, for nothing else
    told = sticks.pilot.summary()
    for figures in re.findall(r"median ([\d.]+), p95 ([\d.]+), worst ([\d.]+) ms", told):
        assert 0.0 <= float(figures[0]) <= float(figures[1]) <= float(figures[2])
    assert told.count("p95") == 2


def test_a_policy_that_corrects_velocities_steers_by_guided(guided):
    guided.begin(HOLD, guided=True).run(12.0)
    assert guided.pilot.ended is None and [a.mode for a in guided.boats.autopilots] == [GUIDED] * 3
    assert np.mean(guided.errors[30:]) < 0.6  # m
    m = guided.heard(1, "SET_POSITION_TARGET_LOCAL_NED")[-1]
    assert (m.type_mask, m.coordinate_frame, m.target_system) == (0b110111000111, 1, 2)
    assert m.get_srcSystem() == 2  # a companion of the vehicle's own system


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sticks", "guided"])
def test_three_boats_hold_their_formation_in_waves(kind, request):
    fleet = request.getfixturevalue(kind)
    sea = SeaConfig(hs=0.5, tp=4.0, components=16, realisations=3)
    full = {"restoring": "panels", "hydrodynamics": {"radiation": "memory"}}
    seaway = Fleet(fleet.mission, Flotilla(3, sea, **full), fleet.policy)
    seaway.begin(fleet.orders.mode).run(120.0)
    assert seaway.pilot.ended is None
    assert np.sqrt(np.mean(np.square(seaway.errors[150:]), axis=0)).max() < 0.8  # m


def _chase(team) -> torch.Tensor:
    """A policy of multirotors: the velocity of the slot, and toward it."""
    control = team.fleet.model.params.control
    ahead, right, down = team.fleet.to_level(team.now.slot_velocity + 0.5 * team.now.error).unbind(-1)
    most = torch.where(down > 0, control.descent, control.climb)
    return torch.stack((ahead / control.speed, right / control.speed, down / most, 0.0 * down), dim=-1).clamp(-1.0, 1.0)


@pytest.mark.slow
def test_two_copters_fly_by_velocities_and_observe_their_wind():
    speed, height = 3.0, 30.0
    mission = piloted("paper", "uav.vehicle=x500", "uav.count=2", f"uav.target_speed={speed}", "uav.spacing=10",
                      f"track.flight_height={height}", team="uav")  # fmt: skip
    air = AirConfig(speed=5.0, direction_deg=300.0)
    copters = Fleet(mission, Flotilla(2, vehicle="x500", autopilot=Copter, air=air), _chase)
    begun = copters.begin(4, starts=[(0.0, 0.0, HEADING, height), (*(10.0 * SIDE), HEADING, height)])
    for autopilot in copters.boats.autopilots:
        autopilot.wind = 300.0, 5.0
    begun.run(25.0)
    assert copters.pilot.ended is None and np.sqrt(np.mean(np.square(copters.errors[125:]))) < 0.5  # m
    fleet = copters.team.fleet
    wind = torch.stack([fleet.reading(f"wind_{way}")[0] for way in ("north", "east", "down")], dim=-1)
    assert wind.norm(dim=-1).tolist() == pytest.approx([5.0, 5.0], rel=1e-5)
    through = fleet.velocity_n[0] - wind
    torch.testing.assert_close(fleet.reading("airspeed")[0], through.norm(dim=-1), rtol=1e-5, atol=1e-5)
    north, east, _ = copters.pilot._chart.over_sea(wind[0].double().numpy())
    assert math.degrees(math.atan2(east, north)) == pytest.approx(300.0 - 180.0, abs=1e-3)


# -- what ends it ------------------------------------------------------------------------------------------------------


def test_nothing_is_ordered_before_all_are_armed_and_in_the_mode_that_obeys(guided):
    guided.begin(HOLD, armed=False).run(2.0)
    assert guided.pilot.phase == "waiting" and "boat 1 in GUIDED (it is HOLD), boat 1 armed" in guided.news[-1]
    for k, autopilot in enumerate(guided.boats.autopilots):
        autopilot.mode, autopilot.armed = GUIDED, k != 2
    guided.run(2.0)
    assert guided.news[-1] == "waiting for boat 3 armed"
    assert not any(guided.heard(k, "SET_POSITION_TARGET_LOCAL_NED") for k in range(3))
    assert not any(m.command == 176 for k in range(3) for m in guided.heard(k, "COMMAND_LONG"))
    guided.boats.autopilots[2].armed = True
    assert guided.run(2.0).pilot.phase == "acting"


@pytest.mark.parametrize("change", [{"mode": HOLD}, {"armed": False}])
def test_a_takeover_ends_it_and_stops_the_others(guided, change):
    guided.begin(GUIDED).run(3.0)
    for name, value in change.items():
        setattr(guided.boats.autopilots[1], name, value)
    guided.run(1.5)
    guided.ends("boat 2", "in HOLD" if "mode" in change else "disarmed", "taken over", fault=False)
    before = [len(guided.heard(k, "SET_POSITION_TARGET_LOCAL_NED")) for k in range(3)]
    guided.boats.step()
    after = [guided.heard(k, "SET_POSITION_TARGET_LOCAL_NED") for k in range(3)]
    assert len(after[1]) == before[1]  # not a word to the one that was taken over
    for k in (0, 2):
        last, heading = after[k][-1], guided.links[k].attitude.euler[2]
        assert (last.vx, last.vy) == (0.0, 0.0) and last.yaw == pytest.approx(heading, abs=0.05)  # no turn to the north
    guided.pilot.tick(guided.boats.clock.now + 1.0)
    guided.boats.step()
    assert [len(guided.heard(k, "SET_POSITION_TARGET_LOCAL_NED")) for k in range(3)] == list(map(len, after))


def test_sticks_are_given_back_at_once_to_whoever_takes_over(sticks):
    sticks.begin(MANUAL).run(3.0)
    sticks.boats.autopilots[0].mode = HOLD
    sticks.run(1.5)
    sticks.boats.step()
    sticks.ends("boat 1 is in HOLD", fault=False)
    mine, other = sticks.heard(0, "MANUAL_CONTROL")[-1], sticks.heard(1, "MANUAL_CONTROL")[-1]
    assert (mine.y, mine.z) == (NO_AXIS, NO_AXIS) and (other.y, other.z) == (0, 0)


@pytest.mark.parametrize("how", ["silent", "frozen"])
def test_a_link_that_dies_stops_all_boats_and_ends_it_after_three_seconds(guided, how):
    guided.begin(GUIDED).run(3.0)
    setattr(guided.boats.autopilots[2], how, True)
    guided.run(STALE * 0.2 + 0.5)
    assert guided.pilot.phase == "holding" and "boat 3" in guided.news[-1]
    last = guided.heard(0, "SET_POSITION_TARGET_LOCAL_NED")[-1]
    assert (last.vx, last.vy) == (0.0, 0.0)
    guided.run(LOST)
    guided.ends("boat 3", "no new telemetry", "silent" if how == "silent" else "it was heard", fault=True)


def test_a_link_that_comes_back_in_time_is_steered_on(sticks):
    sticks.begin(MANUAL).run(3.0)
    sticks.boats.autopilots[2].silent = True
    sticks.run(2.0)
    decided = sticks.pilot.decisions
    sticks.boats.autopilots[2].silent = False
    sticks.run(4.0)
    assert sticks.pilot.ended is None and sticks.pilot.phase == "acting" and sticks.pilot.decisions > decided + 15
    assert [text.split(":")[0] for text in sticks.news if "holding" in text or "again" in text] == [
        "holding", "acting again",
    ]  # fmt: skip


def test_what_has_waited_in_a_radio_is_as_old_as_it_is():
    sent = kinds.MAVLink(None, srcSystem=1, srcComponent=1)
    link = Link("boat", lambda data: None)

    def attitude(clock: float) -> bytes:
        return sent.attitude_encode(round(1e3 * clock), 0, 0, 0.1, 0, 0, 0).pack(sent)

    link.receive(sent.heartbeat_encode(11, 3, 0, 0, 4).pack(sent), 100.0)
    link.receive(attitude(50.0), 100.02)  # 20 ms on its way
    link.receive(attitude(50.1), 100.1)  # the quickest
    assert link.turned == pytest.approx(100.1)
    link.receive(attitude(50.2), 100.9)  # has waited for 0.7 s
    assert link.turned == pytest.approx(100.2, abs=1e-3)
    link.receive(attitude(50.2), 101.0)  # again
    assert link.turned == pytest.approx(100.2, abs=1e-3)
    link.receive(attitude(1.0), 102.0)  # it has started anew
    assert link.turned == pytest.approx(102.0)


@pytest.mark.parametrize(("pace", "simulated"), [(0.4, True), (3.0, True), (0.4, False)])
def test_time_is_kept_by_the_clock_of_a_simulated_autopilot(guided, pace, simulated):
    """A simulation slower or faster than real time; one that does not tell what it is is ended, with the cause."""
    clock = Clock(0.0)
    guided.begin(GUIDED)
    for autopilot in guided.boats.autopilots:
        autopilot.parameters = PARAMETERS | ({"SIM_SPEEDUP": 1.0} if simulated else {})

    def hear(link):
        def receive(data, now):
            link.receive(data, clock(now / pace))
            if link is guided.links[0] and link.simulated:
                clock.follow(now / pace, link.clock)

        return receive

    guided.boats.receivers = [hear(link) for link in guided.links]
    guided.pilot.tick(clock(guided.boats.clock.now / pace))
    begun = guided.boats.clock.now
    while guided.boats.clock.now < begun + 12.0 and guided.pilot.ended is None:
        guided.boats.step()
        guided.pilot.tick(clock(guided.boats.clock.now / pace))
    if simulated:
        assert guided.pilot.ended is None and clock.pace == pytest.approx(pace, rel=0.02)
        assert guided.pilot.decisions == pytest.approx(12.0 / guided.pilot.interval, abs=12)
        assert max(guided.pilot.ages) < 0.2 and "holding" not in str(guided.news)
    else:
        guided.ends("its clock runs at 0.40 of ours", "a simulation slower than real time", fault=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": 2}, ("boat 1", "MAV_TYPE 2", "'otter'", "a boat (11)")),
        ({"kind": 10}, ("MAV_TYPE 10", "a boat (11)")),
        ({"autopilot": 12}, ("MAV_AUTOPILOT 12", "only ArduPilot")),
        ({"parameters": PARAMETERS | {"PILOT_STEER_TYPE": 0.0, "RC1_DZ": 30.0}},
         ("RC1_DZ 0 (it is 30)", "PILOT_STEER_TYPE 3 (it is 0)")),
        ({"parameters": {}}, ("does not tell the parameter RCMAP_ROLL within 30 s",)),
        ({"silent": True}, ("boat 1: no autopilot has been heard within 30 s",)),
    ],
)  # fmt: skip
def test_another_vehicle_than_the_policys_is_refused(sticks, change, words):
    sticks.begin(MANUAL)
    for name, value in change.items():
        setattr(sticks.boats.autopilots[0], name, value)
    sticks.boats.step()
    sticks.pilot.tick(0.0)
    for _ in range(40):
        sticks.boats.step()
        sticks.pilot.tick(sticks.boats.clock.now)
    sticks.pilot.tick(31.0)
    sticks.ends(*words, fault=True)
    sticks.boats.step()
    assert not any(sticks.heard(k, "MANUAL_CONTROL") for k in range(3))


def test_a_refused_mode_ends_it(guided):
    guided.begin(HOLD, guided=True)
    guided.boats.autopilots[1].refuses = (GUIDED,)
    guided.run(3.0)
    guided.ends("boat 2 refuses GUIDED: failed", fault=True)


def test_a_boat_that_is_far_from_its_slot_ends_it(sticks):
    sticks.begin(MANUAL, starts=[*STARTS[:2], (-60.0, 0.0, HEADING)]).run(2.0)
    sticks.ends("boat 3: 'lost'", "'cruise'", fault=True)


def test_two_autopilots_on_one_connection_must_be_told_apart(guided):
    guided.begin(GUIDED)
    both = guided.links[:2]
    for k in (0, 1):
        guided.boats.receivers[k] = lambda data, now: [link.receive(data, now) for link in both]
    guided.run(1.5)
    guided.ends("boat 1: autopilots of the systems 1 and 2", "#1", fault=True)
    guided.begin(GUIDED)
    named = [Link(f"boat {k + 1}", guided.boats.sender(k), system=k + 1) for k in range(3)]
    guided.pilot.links = named
    guided.boats.receivers = [lambda data, now: [link.receive(data, now) for link in named]] * 3
    assert guided.run(1.5).pilot.phase == "acting" and [link.system for link in named] == [1, 2, 3]


def test_bytes_of_any_kind_leave_a_link_as_it_is():
    link = Link("boat", lambda data: None)
    link.receive(np.random.default_rng(1).bytes(20_000), 0.0)
    assert link.heart is None and link.place is None
    sent = kinds.MAVLink(None, srcSystem=1, srcComponent=1)
    link.receive(sent.heartbeat_encode(11, 3, 0, 0, 4).pack(sent), 0.0)
    for lat, yaw in ((0, math.nan), (0, math.inf)):  # no fix; no attitude
        link.receive(sent.global_position_int_encode(10, lat, 0, 0, 0, 0, 0, 0, 0).pack(sent), 0.0)
        link.receive(sent.attitude_encode(10, 0, 0, yaw, 0, 0, 0).pack(sent), 0.0)
    assert link.heart is not None and link.place is None and link.attitude is None


# -- connections and the command ---------------------------------------------------------------------------------------


def test_connections_are_named_and_told_apart():
    assert read_address("tcp:127.0.0.1:5760") == ("tcp", "127.0.0.1", 5760, 0)
    assert read_address("udp:0.0.0.0:14550#3").system == 3 and not read_address("udp:0.0.0.0:14550").local
    assert read_address("udp:127.0.0.1:14550").local
    for text in ("14550", "udp:14550", "udp:127.0.0.1:0", "udp:127.0.0.1:70000", "udp:boat:1", "udp:1.2.3.999:1",
                 "serial:/dev/ttyACM0", "udp:127.0.0.1:1#256"):  # fmt: skip
        with pytest.raises(ConfigError, match=re.escape(text)):
            read_address(text)
    check_different([read_address("udp:127.0.0.1:1#1"), read_address("udp:127.0.0.1:1#2")])
    for pair in (("udp:127.0.0.1:1", "udp:127.0.0.1:1"), ("udp:127.0.0.1:1#1", "udp:127.0.0.1:1")):
        with pytest.raises(ConfigError, match="tell them apart"):
            check_different(list(map(read_address, pair)))


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def test_a_port_hears_whoever_sent_first_and_sends_to_nobody_else():
    address = read_address(f"udp:127.0.0.1:{_free_port()}")
    wire = Wire(address)
    with pytest.raises(ConfigError, match="in use"):
        Wire(address)
    first, stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    wire.send(b"to nobody")
    for sender, data in ((first, b"one "), (stranger, b"no "), (first, b"two")):
        sender.sendto(data, address[1:3])
    time.sleep(0.05)
    assert wire.receive() == b"one two"
    wire.send(b"back")
    first.settimeout(5.0)
    assert first.recv(100) == b"back"
    for one in (first, stranger):
        one.close()
    wire.close()


@pytest.fixture(scope="module")
def otters(sticks, tmp_path_factory) -> Path:
    """A run of `cruise` whose boats have an actor that has learned nothing."""
    out, source = tmp_path_factory.mktemp("runs") / "otters", find_config("cruise")
    config, team = load_scenario(source), sticks.mission.teams["usv"]
    folder.create(out, config, source)
    actor = Actor(config.stages["usv"], len(team.observation_names), len(team.action_names))
    infos = {"observations": list(team.observation_names), "actions": list(team.action_names)}
    (out / "usv").mkdir()
    write_checkpoint({"actor_state_dict": actor.state_dict(), "iter": 1, "infos": infos}, out / "usv" / "model_1.pt")
    (out / "uav").mkdir()
    return out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("which team?", "--team usv", "--team uav")),
        (("--team", "tug"), ("'tug'", "--team usv")),
        (("--team", "usv"), ("1 x --connect", "usv.count = 3", "--set usv.count=1")),
        (("--team", "usv", "--set", "usv.count=1", "--guided"), ("--guided", "MANUAL")),
        (("--team", "usv", "--set", "usv.count=1", "--origin", "10", "200"), ("--origin 10 200", "-180 to 180")),
        (("--team", "uav"), ("no trained uav policy",)),
    ],
)
def test_bad_input_is_named(arguments, words, here, otters):
    here("rl.commands.pilot", otters, "--connect", f"udp:127.0.0.1:{_free_port()}", *arguments).fails(*words)


def test_a_mission_without_a_companion_is_named(here, otters, monkeypatch):
    monkeypatch.setattr(
        "rl.commands.pilot.policy_of", lambda args: (load_scenario("escort"), find_config("escort"), "usv", None)
    )
    here("rl.commands.pilot", otters, "--connect", f"udp:127.0.0.1:{_free_port()}").fails("'escort'", "no companion")


def test_without_pymavlink_the_extra_is_named(here, otters, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20", None)
    here("rl.commands.pilot", otters, "--connect", "udp:127.0.0.1:14550").fails("pymavlink", "taichi-sim[ardupilot]")


def _deliver(wires: list[socket.socket], boats: Flotilla) -> None:
    """Give boats what has arrived, and let a frame pass."""
    for k, wire in enumerate(wires):
        with suppress(BlockingIOError, ConnectionRefusedError):
            while True:
                boats.sender(k)(wire.recv(65536))
    boats.step()


@pytest.mark.slow
def test_the_command_steers_boats_over_udp_until_it_is_interrupted(boats, otters):
    """In real time: three autopilots send to three ports."""
    ports = [_free_port() for _ in range(3)]
    words = [word for port in ports for word in ("--connect", f"udp:127.0.0.1:{port}")]
    command = [sys.executable, "-m", "rl.commands.main", "pilot", str(otters), "--team", "usv", *words]
    boats.begin(STARTS, MANUAL)
    wires = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in ports]
    for wire in wires:
        wire.setblocking(False)
    boats.receivers = [lambda data, now, wire=wire, port=port: wire.sendto(data, ("127.0.0.1", port))
                       for wire, port in zip(wires, ports, strict=True)]  # fmt: skip
    told: list[str] = []
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        reader = threading.Thread(target=lambda: told.extend(process.stdout or ()), daemon=True)
        reader.start()
        due, interrupted = time.monotonic(), False
        while reader.is_alive():
            _deliver(wires, boats)
            if not interrupted and any("decisions; distance" in line for line in told):  # after 5 s
                interrupted = True
                process.send_signal(signal.SIGINT)
            due += FRAME
            time.sleep(max(due - time.monotonic(), 0.0))
    _deliver(wires, boats)
    for wire in wires:
        wire.close()
    out = "".join(told)
    assert process.returncode == 130, out
    assert "acting: the course begins at 63.48" in out
    assert re.search(r"from telemetry to set points: median [\d.]+, p95 [\d.]+, worst", out)
    for autopilot in boats.autopilots:
        orders = autopilot.heard["MANUAL_CONTROL"]
        assert len(orders) > 25 and all((m.y, m.z) == (0, 0) for m in orders[-3:]) and any(m.z for m in orders)
