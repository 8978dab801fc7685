"""ArduPilot's JSON interface and PX4's, held to their documented behaviour by peers of our own."""

import contextlib
import csv
import json
import math
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from recorded import column
from sitl_peer import Clock, Copter, PacedPeer, Peer

from taichi_sim.applications.sitl.ardupilot import PacketError, Session, pack, parse
from taichi_sim.applications.sitl.channels import Mixer, default_channels, read_channels
from taichi_sim.applications.sitl.craft import Craft, Servos
from taichi_sim.applications.sitl.craft_recording import CraftRecording, CraftView
from taichi_sim.config import AirConfig, ConfigError, GustConfig, SeaConfig
from taichi_sim.kernels.conventions import GRAVITY
from taichi_sim.kernels.rotation import numpy_rotation_matrix
from taichi_sim.models.catalogue import load_vehicle

ME, OTHER_PORT, STRANGER = ("127.0.0.1", 5501), ("127.0.0.1", 5777), ("10.0.0.9", 5501)


def _pwm(frame):
    """A helm that swings, and thrust that grows."""
    return [round(1500 + 300 * math.sin(frame / 150)), 0, min(1500 + frame, 1850)]


def _session(vehicle="cybership2", clock=time.monotonic, **more):
    return Session(Craft(vehicle, {"actions": "surge_sway_yaw"} if vehicle == "cybership2" else {}, **more), clock)


@pytest.fixture(scope="module")
def copter():
    """An x500 in calm air, until a gust of 3 m/s from the west, which rises within 1 s from its time 100 s on."""
    gust = GustConfig(amplitude=(0.0, 3.0, 0.0), shape="ramp", start_time=100.0, rise_time=1.0)
    return Craft("x500", air=AirConfig(profile="uniform", gust=gust))


@pytest.fixture(scope="module")
def plane():
    """An aerosonde in calm air."""
    return Craft("aerosonde", air=AirConfig(profile="uniform"))


def _wire(session, sender=ME):
    return lambda data: session.receive(data, sender)


def test_packets_are_as_documented():
    for channels, magic in ((16, 18458), (32, 29569)):
        servos = Servos(400, 7, tuple(range(1000, 1000 + channels)))
        data = pack(servos)
        assert len(data) == 8 + 2 * channels and parse(data) == servos
        assert int.from_bytes(data[:2], "little") == magic and int.from_bytes(data[4:8], "little") == 7
        with pytest.raises(PacketError, match="cut short"):
            parse(data[:-1])
    for bad, told in ((b"", "0 bytes"), (b"\1", "1 bytes"), (b"\0\0" + data[2:], "magic 0: allowed are 18458"),
                      (data[:2] + b"\0\0" + data[4:], "frame_rate 0")):  # fmt: skip
        with pytest.raises(PacketError, match=told):
            parse(bad)


@pytest.mark.slow
def test_frames_lost_repeated_late_and_restarted_change_nothing():
    """1,000 frames at 400 Hz over a wire that loses a quarter of the packets each way, against one that loses none."""
    sea, clock = SeaConfig(hs=0.05, tp=1.5), Clock()
    clean, rough = Peer(_wire(_session(sea=sea))), _session(sea=sea, clock=clock)
    peer = Peer(_wire(rough), loss=0.25, seed=3, clock=clock)
    for frame in range(300):
        peer.step(_pwm(2 * frame))  # of a life before the restart
    peer.restart()
    for frame in range(1000):
        assert peer.step(_pwm(frame)) == clean.step(_pwm(frame))
        assert not peer.waiting  # one answer a frame
    assert [peer.heard[k]["timestamp"] for k in (0, 999)] == pytest.approx([1 / 400, 1000 / 400])
    counts = rough.counts
    assert counts.frames == 1300 and counts.restarts == 1 and counts.lost == 0 and not counts.refused
    assert counts.repeated > 200 and counts.late > 100


@pytest.mark.parametrize("rate", [250, 400, 1200])
def test_a_frame_is_answered_once_whoever_stops(rate):
    """The physics stop for 8 s, twice, and the autopilot sends its frame 8 times; a copy crosses its answer."""
    clock = Clock()
    session = _session(clock=clock)
    peer = Peer(_wire(session), rate, clock=clock)
    for frame in range(100):
        if frame in (30, 60):
            peer.stop_them(8.0)
        assert peer.step(_pwm(frame))["timestamp"] == pytest.approx((frame + 1) / rate)
        assert not peer.waiting
        if frame == 80:
            clock.now += 0.3
            assert session.receive(peer.old[-1], ME) is None  # it was on its way
            clock.now += 30.0  # the autopilot stops
    assert session.counts.repeated == 2 * 8 + 1 and session.counts.frames == 100


def test_frames_that_never_come_pass_under_the_last_outputs():
    jumping, whole = Peer(_wire(_session())), Peer(_wire(_session()))
    for frame in range(100):
        pwm = _pwm(40 * (frame // 10))
        whole.step(pwm)
        jumping.frame = frame
        if frame % 10 in (0, 1, 9):
            assert jumping.step(pwm) == whole.heard[frame]


def test_who_drives_and_who_does_not():
    clock = Clock()
    session = _session(clock=clock)
    peer, second = (Peer(_wire(session, sender), clock=clock) for sender in (ME, OTHER_PORT))
    for frame in range(5):
        peer.step(_pwm(frame))
    last = json.loads(session.answer)
    stranger = Peer(_wire(session, STRANGER))
    assert session.receive(stranger.packet(_pwm(0)), STRANGER) is None
    stranger.frame = 6
    assert session.receive(stranger.packet(_pwm(0)), OTHER_PORT) is None
    assert session.receive(b"\x1aH" + b"\0" * 20, ME) is None and session.receive(b"GET / HTTP/1.1", ME) is None
    for _ in range(4):  # a second autopilot on this port, while the first one drives
        assert session.receive(second.packet(_pwm(0)), OTHER_PORT) is None
        last = peer.step(_pwm(peer.frame))
        clock.now += 1.0
    assert last["timestamp"] == pytest.approx(9 / 400) and session.counts.restarts == 0
    assert len(session.counts.refused) == 5 and "(--instances 2" in [*session.counts.refused][-1]
    assert "refused 4: 127.0.0.1" in session.state(1.0) and "refused" not in session.state(1.0)  # it is over
    assert second.step(_pwm(0))["timestamp"] == pytest.approx(1 / 400)  # the first one has gone: it was restarted
    assert session.counts.restarts == 1 and session.peer == OTHER_PORT and clock.now < 8.0
    assert session.receive(peer.packet(_pwm(0)), ME) is None


def test_another_frame_rate_goes_on_from_the_same_motion():
    session = _session()
    peer = Peer(_wire(session), rate=400)
    before = [peer.step([1500, 0, 1900]) for _ in range(800)][-1]
    peer.rate = 50
    after = peer.step([1500, 0, 1900])
    assert after["timestamp"] == pytest.approx(before["timestamp"] + 1 / 50)
    way = np.subtract(after["position"], before["position"])
    assert way == pytest.approx(np.array(before["velocity"]) / 50, rel=0.02, abs=1e-5)


@pytest.mark.parametrize(("start", "target"), [(1200, 1140), (400, 460), (50, 120), (60, 40), (400, 401), (1200, 1200)])
def test_the_rate_of_an_autopilot_reaches_what_it_asks_for(start, target):
    """ArduPilot judges its frames by our time stamps: it gets to its rate in a frame for each Hz, and stays there."""
    _paced("cybership2", start, target)


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", ["otter", "x500", "aerosonde", "kvlcc2"])
@pytest.mark.parametrize(("start", "target"), [(1200, 400), (400, 1200), (50, 400), (400, 20), (20000, 19990)])
def test_the_rate_of_an_autopilot_reaches_what_it_asks_for_by_far(vehicle, start, target):
    _paced(vehicle, start, target)


def _paced(vehicle, start, target):
    session = _session(vehicle)
    peer, whole = PacedPeer(_wire(session), start, target), abs(target - start)
    for _ in range(whole + 20):
        peer.step([1500] * 4)
    way = range(start, target, 1 if target > start else -1)
    assert peer.sent[: whole + 1] == [*way, target] and set(peer.sent[whole:]) == {target}
    assert np.diff(peer.stamps) == pytest.approx(1 / np.array(peer.sent), rel=1e-9)
    assert session.craft.bench.time.item() - peer.stamps[-1] < 0.21  # (the warm-up)
    assert not session.counts.refused


def test_a_rate_that_changes_in_every_frame_leaves_the_motion_as_it_is():
    """Twice the way of a boat at full ahead: at 400 Hz, and from 380 Hz to 420 Hz by 1 Hz a frame."""
    ends = []
    for rates in ([400] * 200, list(range(380, 420)) * 5):
        peer = Peer(_wire(_session("otter_3dof")), 400)
        for rate in rates:
            peer.rate = rate
            last = peer.step([1500, 0, 2000])
        ends.append((last["position"][0], last["velocity"][0], last["timestamp"]))
    assert ends[0] == pytest.approx(ends[1], rel=1e-2)
    assert ends[1][2] == pytest.approx(5 * sum(1 / rate for rate in range(380, 420)))


@pytest.mark.slow
@pytest.mark.parametrize("rate", [50, 400, 1200, 4000])
def test_a_multirotor_is_released_when_its_rotors_lift_it_at_any_rate(copter, rate):
    """At rest, thrust is k_f times the sum of the squares of the rotors' speeds: at half a per cent more than what its
    weight needs, it is released, and at half a per cent less it is not.
    """
    craft, held = copter, []
    craft.begin(rate)
    rotor, hover = craft.model.plan.rotor, craft.model.allocation.hover
    weight = craft.model.p.physical.mass * GRAVITY
    assert rotor.k_f * sum(speed**2 for speed in hover) == pytest.approx(weight, rel=1e-6)
    for share in (0.995, 1.005):
        speeds = share**0.5 * np.array(hover)
        for name, speed in zip(craft.model.control_names, speeds, strict=True):
            craft.bench.fleet.reading(name).fill_(speed)
        width = np.rint(1000 + 1000 * (speeds - rotor.omega_min) / (rotor.omega_max - rotor.omega_min)).astype(int)
        craft.advance(tuple(width.tolist()))
        held.append(craft.held)
    assert held == [True, False]


@pytest.mark.parametrize("rate", [400, 1200])
def test_a_boat_far_away_reports_the_way_of_its_velocity(rate):
    """10 km from where it began, where f32 has 1 mm, at 1.3 m/s."""
    craft = Craft("otter_3dof")
    craft.begin(rate)
    craft.bench.state[0, 0, 0] += 10_000.0
    craft.bench.state[0, 0, 7] = 1.3
    craft.bench.fleet.update()
    begun, speeds = craft.sensors(), []
    for _ in range(rate // 2):
        craft.advance((1500, 0, 1600) + (0,) * 13)
        speeds.append(craft.sensors().velocity[0])
    whole = [begun.velocity[0], *speeds]
    path = sum(0.5 * (a + b) for a, b in zip(whole[:-1], whole[1:], strict=True)) / rate
    assert craft.sensors().position[0] - begun.position[0] == pytest.approx(path, rel=1e-4)


def test_sensors_of_a_vessel_agree_with_each_other():
    """Position is the integral of velocity, heading that of the yaw rate; specific force acceleration less gravity."""
    session = _session("kvlcc2", sea=SeaConfig(hs=0.1, tp=2.0), air=AirConfig(speed=5.0, direction_deg=90.0))
    peer = Peer(_wire(session), 200)
    rows = [peer.step([1700, 0, 2000]) for _ in range(600)]
    p, v, a, angles = (np.array([r[k] for r in rows]) for k in ("position", "velocity", "attitude", "attitude"))
    gyro, force = (np.array([r["imu"][k] for r in rows]) for k in ("gyro", "accel_body"))
    assert np.diff(p, axis=0) == pytest.approx(0.5 * (v[1:] + v[:-1]) / 200, abs=2e-4)
    assert force[:, 2] == pytest.approx(-GRAVITY, abs=0.6) and force[:, 2].mean() == pytest.approx(-GRAVITY, abs=0.05)
    assert np.diff(np.unwrap(angles[:, 2])) == pytest.approx(0.5 * (gyro[1:, 2] + gyro[:-1, 2]) / 200, abs=2e-5)
    assert angles[-1, 2] > 0.01 and rows[-1]["velocity"][0] > 0.005  # ahead, and to starboard
    w, x, y, z = rows[-1]["quaternion"]
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(a[-1, 2], abs=1e-5)
    assert rows[0]["windvane"]["direction"] == pytest.approx(math.pi / 2, abs=0.05)  # from starboard
    assert 3.0 < rows[0]["windvane"]["speed"] < 5.0 and "airspeed" not in rows[0]  # at its own height


def test_a_multirotor_stands_until_its_rotors_lift_it(copter):
    peer = Peer(_wire(Session(copter)))
    for _ in range(200):
        still = peer.step([1000] * 4)
    assert still["position"] == [0.0, 0.0, 0.0] and still["velocity"] == [0.0, 0.0, 0.0]
    assert still["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -GRAVITY], abs=1e-4)
    for _ in range(200):
        up = peer.step([1900] * 4)
    assert up["position"][2] < -0.2 and up["velocity"][2] < -1.0 and up["imu"]["accel_body"][2] < -GRAVITY
    rolled = [peer.step([1850, 1850, 1900, 1850]) for _ in range(20)][-1]  # more of front left: rolls right, nose up
    assert rolled["imu"]["gyro"][0] > 0.1 and rolled["imu"]["gyro"][1] > 0.1


def _felt(answers, lengths):
    """Changes of velocity [frame, 3] (n) that gravity and the felt specific forces make in frames of `lengths`, s."""
    force, q = (np.array([pick(a) for a in answers]) for pick in (
        lambda a: a["imu"]["accel_body"], lambda a: a["quaternion"]))  # fmt: skip
    R = np.array([numpy_rotation_matrix(x) for x in q])
    return (np.einsum("nij,nj->ni", R, force) + [0.0, 0.0, GRAVITY]) * np.reshape(lengths, (-1, 1))


SLOWLY = pytest.mark.slow
SLOW_RATES = ((1200, 1200), (250, 250), (1200, 400))


@pytest.mark.parametrize(("start", "target"), [(400, 400), *(pytest.param(*r, marks=SLOWLY) for r in SLOW_RATES)])
def test_a_multirotor_takes_off_hovers_lands_and_takes_off_again(copter, start, target):
    """The IMU feels the touchdown, and then it stands still, while the frame rate is the autopilot's or on its way."""
    copter.news.clear()
    peer, answers = PacedPeer(_wire(Session(copter)), start, target), []
    pilot = Copter(copter.first.params)

    def fly(height, seconds):
        pilot.goal[2] = -height
        begun = peer.stamps[-1]
        while peer.stamps[-1] < begun + seconds:
            answers.append(peer.step(pilot.outputs(answers[-1]) if answers else [1000] * 4))
        return answers[-1]["position"][2]

    assert 0.3 < -fly(0.5, 2.2) < 0.55 and not copter.held
    fly(-1.0, 1.6)
    for _ in range(target // 5):
        down = peer.step([1000] * 4)
    assert copter.held and not copter.ended and down["velocity"] == [0.0, 0.0, 0.0]
    assert down["position"][2] == pytest.approx(0.0, abs=0.05)
    assert down["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -GRAVITY], abs=1e-4)
    v = np.array([a["velocity"] for a in answers])
    lengths = np.diff(peer.stamps)[: len(answers)]
    assert _felt(answers, lengths)[1:] == pytest.approx(np.diff(v, axis=0), abs=1e-4)
    assert max(-a["imu"]["accel_body"][2] for a in answers) < 2.5 * GRAVITY
    fly(1.0, 0.6)
    assert not copter.held
    assert [news.split(" at ")[0] for news in copter.news] == ["lifts off", "touches down", "lifts off"]


@pytest.mark.slow
@pytest.mark.parametrize("rate", [400, 1200])
def test_a_multirotor_flies_in_wind_turbulence_and_a_gust_and_lands(rate):
    """10 m high, in 6 m/s of wind from the west at 10 m, turbulence, and a gust of 5 m/s from the south at 25 s."""
    gust = GustConfig(amplitude=(5.0, 0.0, 0.0), start_time=25.0, rise_time=1.0)
    craft = Craft("x500", air=AirConfig(speed=6.0, direction_deg=270.0, turbulence="dryden", gust=gust))
    peer, pilot, answers = Peer(_wire(Session(craft)), rate), Copter(craft.first.params), []
    last = peer.step([1000] * 4)
    pilot.goal[:] = 0.0, 0.0, -10.0
    while not (craft.held and last["timestamp"] > 1.0):
        if last["timestamp"] > 30.0:
            pilot.goal[2] = 1.0
        answers.append(last := peer.step(pilot.outputs(last)))
        assert last["timestamp"] < 60.0
    t, place = (np.array([a[key] for a in answers]) for key in ("timestamp", "position"))
    hovers = (t > 20.0) & (t < 30.0)
    assert np.abs(place[hovers] - [0.0, 0.0, -10.0]).max() < 1.0
    assert [news.split(" at ")[0] for news in craft.news] == ["lifts off", "touches down"]
    for _ in range(rate // 2):
        last = peer.step([1000] * 4)
    assert last["velocity"] == [0.0, 0.0, 0.0] and np.abs(place[-1, :2]).max() < 1.0


@pytest.mark.parametrize(("place", "ends"), [((0.0, 0.0, -51.0), "crashed"), ((200.0, 0.0, -1.0), "ditched")])
def test_ground_ends_a_fall_and_the_sea_a_flight(copter, place, ends):
    """From 1 m above the ground at 5 m/s; beside the ground from 1 m above the sea."""
    copter.begin(400)
    copter.held = False
    copter.bench.state[0, 0, :3] = torch.tensor(place)
    copter.bench.state[0, 0, 9] = 5.0
    copter.bench.fleet.update()
    for _ in range(400):
        copter.advance((1000,) * 4)
    there = copter.sensors()
    assert copter.ended == ends and there.velocity == (0.0, 0.0, 0.0)
    for _ in range(100):
        copter.advance((2000,) * 4)
    assert copter.sensors().position == there.position and copter.ended == ends
    surface = place[2] + 1.0
    assert there.position[2] - 50.0 == pytest.approx(surface, abs=0.4)  # the sea meets its feet, and it stops in 0.1 s
    copter.begin(400)
    assert not copter.ended and copter.held


def test_the_windvane_tells_the_local_wind_gusts_included(copter):
    copter.begin(400)
    copter.bench.wind[0] = torch.tensor([4.0, 0.0, 0.0])  # from the south
    for when, speed, direction in ((0.0, 4.0, -math.pi), (200.0, 5.0, math.atan2(-3.0, -4.0))):
        copter.bench.fleet.reading("time").fill_(when)
        copter.advance((1000,) * 4)
        told = copter.sensors()
        assert told.wind_speed == pytest.approx(speed, rel=1e-5)
        assert told.wind_direction == pytest.approx(direction, abs=1e-5)
    copter.bench.wind.zero_()


def test_a_pitot_reads_flow_from_ahead_only(plane):
    plane.begin(200)
    theta = plane.sensors().attitude[1]
    for wind, read in ((-5.0, 5.0 * math.cos(theta)), (5.0, 0.0)):  # from ahead; from astern
        plane.bench.wind[0] = torch.tensor([wind, 0.0, 0.0])
        plane.advance((1500, 1500, 1000, 1500))
        assert plane.sensors().airspeed == pytest.approx(read, rel=1e-5)
    plane.bench.wind.zero_()


@pytest.mark.parametrize("rate", [pytest.param(250, marks=SLOWLY), 400, pytest.param(1200, marks=SLOWLY)])
def test_an_aircraft_is_launched_within_a_second_that_the_imu_feels(plane, rate):
    plane.news.clear()
    peer = Peer(_wire(Session(plane)), rate)
    held = [peer.step([1500, 1500, 1000, 1500]) for _ in range(50)][-1]
    assert held["velocity"] == [0.0, 0.0, 0.0] and held["airspeed"] < 1e-5
    launch = [peer.step([1500, 1500, 1700, 1500])] + [peer.step([1500, 1500, 1000, 1500]) for _ in range(rate)]
    assert launch[-1]["airspeed"] == pytest.approx(25.0, abs=0.1) and not plane.held
    v = np.array([a["velocity"] for a in launch])
    assert _felt(launch, 1 / rate)[1:] == pytest.approx(np.diff(v, axis=0), abs=1e-5)
    assert v[:, 0] == pytest.approx(v[-1, 0] * np.arange(rate + 1) / rate, abs=1e-3)
    assert launch[-1]["position"][0] == pytest.approx(0.5 * v[-1, 0], rel=1e-3)
    assert plane.news == ["is launched"]


def test_an_aircraft_obeys_its_surfaces_and_the_sea_ends_its_flight(plane):
    for pwm, axis, least in (([1700, 1500, 1700, 1500], 0, 0.1), ([1500, 1700, 1700, 1500], 1, 0.05)):
        peer = Peer(_wire(Session(plane)), 200)
        for _ in range(202):
            peer.step([1500, 1500, 1700, 1500])
        turned = [peer.step(pwm) for _ in range(30)][-1]
        assert turned["imu"]["gyro"][axis] > least  # rolls right; nose up
    while not plane.ended:
        last = peer.step([1500, 1000, 1000, 1500])
        assert last["timestamp"] < 30.0
    assert plane.ended == "ditched" and plane.news[-1].startswith("has ditched")
    assert 49.0 < last["position"][2] < 51.0
    for _ in range(100):
        last = peer.step([1500, 1500, 1700, 1500])
    assert last["velocity"] == [0.0, 0.0, 0.0]
    peer.restart()
    assert peer.step([1500, 1500, 1000, 1500])["position"] == [0.0, 0.0, 0.0] and not plane.ended


COPTER, WING, ROVER, SKID = (1000,) * 4, (1500, 1500, 1000, 1500), (1500, 0, 1500), (1500, 0, 1500)


@pytest.mark.parametrize(("vehicle", "changes", "own", "others"), [
    ("x500", {}, COPTER, {
        WING: "output 1 (rotor_1) is at 1500 us", ROVER: "output 2 (rotor_2) is not driven",
        (0,) * 4: "needs FRAME_CLASS 1 (0 drives no rotor), SERVO1_FUNCTION 33 (rotor_1)",
        (1000,) * 6: "output 5 drives a rotor that is not there"}),
    ("aerosonde", {}, WING, {COPTER: "output 1 (aileron) is at 1000 us", ROVER: "SERVO4_FUNCTION 21 (rudder)"}),
    ("kvlcc2", {}, ROVER, {COPTER: "SERVO1_FUNCTION 26 (helm), SERVO3_FUNCTION 70 (ahead)"}),
    ("otter", {"actions": "left_right"}, SKID, {COPTER: "SERVO1_FUNCTION 73 (left), SERVO3_FUNCTION 74 (right)"}),
])  # fmt: skip
def test_an_autopilot_of_another_frame_is_told_by_its_outputs_at_rest(vehicle, changes, own, others):
    model = Craft(vehicle, changes).first
    mixer = Mixer(model, default_channels(model))

    def filled(pwm):
        return (*pwm, *[0] * (16 - len(pwm)))

    assert mixer.strange(filled(own)) == []
    for pwm, told in others.items():
        assert told in mixer.strange(filled(pwm))[0]


def test_an_autopilot_of_another_frame_is_told_once():
    session = _session("otter_3dof")
    peer = Peer(_wire(session), 50)
    for _ in range(600):
        peer.step([1000] * 4)
    assert len(session.craft.news) == 1 and "SERVO1_FUNCTION" in session.craft.news[0]


def test_channels_are_named_and_turned_round():
    model = load_vehicle("kvlcc2")
    assert read_channels("ahead=-5", model) == {"helm": 1, "ahead": -5}
    for text, told in (
        ("ahead", "expected NAME=CHANNEL"),
        ("ahead=33", "channels 1 to 32"),
        ("wing=1", "has helm, ahead"),
    ):
        with pytest.raises(ConfigError, match=told):
            read_channels(text, model)
    with pytest.raises(ConfigError, match="cannot drive a UnityAircraft"):
        Craft("unity_aircraft")


def test_a_recording_shows_what_was_flown_and_a_restart_begins_another(tmp_path):
    """At two frame rates, in waves: places, times and actions of the file are those that the autopilot was told."""
    session = _session("kvlcc2", sea=SeaConfig(hs=0.1, tp=2.0))
    reel = CraftRecording(tmp_path / "run.rrd", session.craft)
    session.seen.append(reel.see)
    peer = Peer(_wire(session), 200)
    for _ in range(100):
        peer.step([1700, 0, 2000])
    peer.rate = 50
    for _ in range(25):
        peer.step([1700, 0, 2000])
    told = [peer.heard[k] for k in sorted(peer.heard)]
    peer.restart()
    peer.step([1500, 0, 1500])
    assert reel.write() == tmp_path / "run-2.rrd"
    times, _, place = column(tmp_path / "run.rrd", "/world/kvlcc2/vehicle_0", "Transform3D:translation")
    assert len(times) == 10
    for when, (east, north, _) in zip(times, place, strict=True):
        nearest = min(told, key=lambda answer: abs(answer["timestamp"] - when / 1e9))
        assert nearest["timestamp"] == pytest.approx(when / 1e9, abs=1e-6)
        assert (north, east) == pytest.approx(nearest["position"][:2], abs=2e-3)


def test_a_live_view_goes_on_after_a_restart():
    """Every frame is shown once, on one clock."""

    class Screen:
        like, begun = None, 0

        def __init__(self):
            self.times = []

        def show(self, part, *, after_s):
            self.like = self.like or part
            self.times += [after_s + t for t in part.time_s]

        def begin(self):
            self.begun += 1

    session, screen = _session(), Screen()
    session.seen.append(CraftView(screen, session.craft).see)
    peer = Peer(_wire(session), 100)
    for _ in range(400):
        peer.step(_pwm(0))
    assert screen.begun == 0 and screen.times == pytest.approx(0.01 + 0.1 * np.arange(40))
    peer.restart()
    for _ in range(200):
        peer.step(_pwm(0))
    assert screen.begun == 1 and screen.times[40:] == pytest.approx(4.01 + 0.1 * np.arange(20))


# -- PX4 ------------------------------------------------------------------------------------------------------------


class Px4Peer:
    """Plays PX4's side of its simulator interface, by pymavlink: controls in lockstep with HIL_SENSOR.

    Attributes:
        heard: frames by time (us): the last message of each kind. answered: times of the answered frames.
    """

    def __init__(self, send):
        self.dialect = pytest.importorskip("pymavlink.dialects.v20.common")
        self.link = self.dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.send, self.heard, self.kinds, self.new = send, {}, {}, []

    def take(self, data):
        """Bytes from the simulator."""
        for message in self.link.parse_buffer(data) or ():
            self.kinds[message.get_type()] = message
            if message.get_type() == "HIL_SENSOR":
                self.new.append(message.time_usec)
                self.heard[message.time_usec] = message

    def controls(self, when, values, armed=True):
        """HIL_ACTUATOR_CONTROLS, as bytes."""
        full = [*values, *[math.nan] * (16 - len(values))]
        return self.link.hil_actuator_controls_encode(when, full, 128 if armed else 0, 1).pack(self.link)


def _px4(vehicle="cybership2", peer_of=Px4Peer):
    from taichi_sim.applications.sitl.px4 import Px4Session

    pytest.importorskip("pymavlink")
    session = Px4Session(Craft(vehicle, {"actions": "surge_sway_yaw"} if vehicle == "cybership2" else {}))
    peer = peer_of(session.receive)
    session.connect(peer.take)
    return session, peer


def test_px4_drives_in_lockstep_and_what_it_loses_or_repeats_changes_nothing(monkeypatch):
    """Against a peer that answers each frame at once: one that leaves frames unanswered until they come again, repeats
    controls, sends old ones and noise, in pieces.
    """
    from taichi_sim.applications.sitl import px4

    ends = []
    for rough in (False, True):
        session, peer = _px4()
        assert session.counts.waiting == 0 and session.craft.frames == 1
        session.receive(peer.controls(peer.new[-1], [0.3, math.nan, 0.2]))  # the first controls
        old = []
        for frame in range(200):
            when = peer.new[-1]
            data = peer.controls(when, [math.sin(frame / 50), math.nan, 0.5])
            if rough and frame % 7 == 0:  # lost: the frame comes again after a while
                with monkeypatch.context() as m:
                    m.setattr(px4, "RESEND", 0.0)
                    session.tick()
                assert peer.new[-1] == when and len(peer.new) > 2
            if rough and frame % 5 == 0:
                session.receive(b"\xfd\x01noise" + data[:9])
                session.receive(data[9:])  # the rest of a message whose beginning was drowned in noise
            while peer.new[-1] == when:  # noise may swallow a message, which PX4 then sends again
                session.receive(data[:20])
                session.receive(data[20:])
            if rough and frame % 3 == 0:
                session.receive(data)
                session.receive(old[-1] if old else data)
            old.append(data)
        ends.append((session.craft.frames, session.craft.bench.state.numpy().copy()))
        assert session.counts.frames == 201
        if rough:
            assert session.counts.resent > 20 and session.counts.late > 60 and session.counts.refused
    assert ends[0][0] == ends[1][0] == 202 and np.array_equal(ends[0][1], ends[1][1])


@pytest.mark.slow
def test_px4_begins_when_it_is_ready_and_restarts_with_a_new_connection():
    session, peer = _px4("x500")
    time.sleep(0.02)
    for _ in range(3):  # before the first controls frames pass by the clock
        session.tick()
    assert session.counts.waiting >= 1 and session.craft.frames == 1 + session.counts.waiting
    for _ in range(300):  # disarmed, then all rotors at full
        session.receive(peer.controls(peer.new[-1], [1.0] * 4, armed=False))
    assert session.craft.held
    for _ in range(300):
        session.receive(peer.controls(peer.new[-1], [1.0] * 4))
    truth, gps = peer.kinds["HIL_STATE_QUATERNION"], peer.kinds["HIL_GPS"]
    assert truth.vz < -100 and truth.alt > 51_000 and gps.lat == pytest.approx(634_800_000, abs=200)
    last = peer.heard[peer.new[-1]]
    assert np.linalg.norm([last.xmag, last.ymag, last.zmag]) == pytest.approx(0.52, abs=0.01)  # gauss
    assert last.pressure_alt == pytest.approx(truth.alt / 1e3, abs=2.0) and last.zacc < -12.0
    session.disconnect()
    again = Px4Peer(session.receive)
    session.connect(again.take)
    assert session.counts.restarts == 1 and session.craft.frames == 1 and session.craft.held
    assert again.heard[4000].zacc == pytest.approx(-GRAVITY, abs=0.1)


@pytest.mark.slow
def test_the_command_serves_px4_over_tcp(tmp_path):
    pytest.importorskip("pymavlink")
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    log = tmp_path / "run.csv"
    server = _start("cybership2", "--protocol", "px4", "--port", str(port), "--duration", "1", "--log", str(log))
    try:
        assert f"127.0.0.1:{port}" in server.stdout.readline()
        with socket.create_connection(("127.0.0.1", port), timeout=60.0) as mine:
            peer = Px4Peer(mine.sendall)
            with socket.create_connection(("127.0.0.1", port), timeout=60.0) as stranger:
                assert stranger.recv(100) == b""  # another one drives
            answered = None
            with contextlib.suppress(OSError):  # the end of the run may cut the connection at any moment
                while data := mine.recv(65536):
                    peer.take(data)
                    if peer.new and peer.new[-1] != answered:
                        answered = peer.new[-1]
                        peer.send(peer.controls(answered, [0.1, math.nan, 0.6]))
        assert server.wait(timeout=60) == 0 and "refused" in server.stderr.read()
    finally:
        server.kill()
    with log.open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["t"]) == pytest.approx(1.0) and rows[-1]["pwm_3"] == "1800"
    assert float(rows[-1]["v_north"]) > float(rows[20]["v_north"])


def test_without_pymavlink_the_extra_is_named(monkeypatch, capsys):
    from taichi_sim.applications.commands import sitl

    for name in ("pymavlink", "pymavlink.dialects", "pymavlink.dialects.v20"):
        monkeypatch.setitem(sys.modules, name, None)
    assert sitl.main(["cybership2", "--protocol", "px4"]) == 2
    assert 'pip install "taichi-sim[px4]"' in capsys.readouterr().err


def _start(*words):
    command = [sys.executable, "-m", "taichi_sim.applications.commands.sitl", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def test_the_command_answers_over_udp(tmp_path):
    port, log = _free_port(), tmp_path / "run.csv"
    film = tmp_path / "run.rrd"
    server = _start("cybership2", "--port", str(port), "--duration", "1", "--log", str(log), "--record", str(film))
    try:
        assert f"127.0.0.1:{port}" in server.stdout.readline()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mine:
            mine.settimeout(60.0)

            def wire(data):
                mine.sendto(data, ("127.0.0.1", port))
                return mine.recv(65536)

            peer = Peer(wire, channels=32)
            peer.step(_pwm(0))
            for frame in range(1, 400):
                if frame == 200:  # it is stopped, and goes on among copies of this frame
                    server.send_signal(signal.SIGSTOP)
                    for _ in range(8):
                        mine.sendto(peer.packet(_pwm(frame)), ("127.0.0.1", port))
                    server.send_signal(signal.SIGCONT)
                peer.step(_pwm(frame))
                assert peer.heard[frame]["timestamp"] == pytest.approx((frame + 1) / 400)
        assert server.wait(timeout=60) == 0
        assert film.is_file() and str(film) in server.stdout.read()
    finally:
        server.kill()
    with log.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 400 and float(rows[-1]["t"]) == pytest.approx(1.0) and rows[-1]["pwm_3"] == "1850"
    assert float(rows[-1]["north"]) == pytest.approx(peer.heard[399]["position"][0])
    assert json.dumps(peer.heard[0])


@pytest.mark.parametrize(("words", "told"), [
    ("nosuch", "no such vehicle"),
    ("unity_aircraft", "cannot drive a UnityAircraft"),
    ("kvlcc2 --channels wing=2", "has helm, ahead"),
    ("kvlcc2 --port 99999", "allowed are 1 to 65535"),
    ("kvlcc2 --address everywhere", "not an IP address"),
    ("kvlcc2 --pwm 2000 1000", "the first must be less"),
    ("kvlcc2 --record run.mp4", "must end in .rrd"),
    ("kvlcc2 --live --live-port 0", "--live-port: 0: allowed are 1 to"),
    ("kvlcc2 --port {port}", "in use"),
    ("kvlcc2 --air turbulence=dryden", "in TOML (quote strings)"),
    ("x500 --air gust.amplitude=[0,5]", "amplitude"),
    ("kvlcc2 --air turbulence=\"dryden\"", "vessels feel the mean wind alone"),
    ("kvlcc2 --protocol px4 --port 65530 --instances 9", "go beyond 65535"),
])  # fmt: skip
def test_bad_input_is_told(words, told, capsys):
    from taichi_sim.applications.commands import sitl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        try:
            assert sitl.main(words.format(port=taken.getsockname()[1]).split()) == 2
        except SystemExit as ended:
            assert ended.code == 2
    assert told in capsys.readouterr().err
