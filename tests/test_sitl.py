"""ArduPilot's JSON interface, held to its documented packets by a peer of our own: no autopilot is at hand."""

import csv
import json
import math
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from sitl_peer import Peer
from test_recording import column

from taichi_sim.config import AirConfig, ConfigError, SeaConfig
from taichi_sim.conventions import GRAVITY
from taichi_sim.sitl.channels import read_channels
from taichi_sim.sitl.craft import Craft
from taichi_sim.sitl.packets import PacketError, Servos, pack, parse
from taichi_sim.sitl.record import CraftRecording, CraftView
from taichi_sim.sitl.session import Session
from taichi_sim.vehicles import load_vehicle

ME, OTHER_PORT, STRANGER = ("127.0.0.1", 5501), ("127.0.0.1", 5777), ("10.0.0.9", 5501)


def _pwm(frame):
    """A helm that swings, and thrust that grows."""
    return [round(1500 + 300 * math.sin(frame / 150)), 0, min(1500 + frame, 1850)]


def _session(vehicle="cybership2", **more):
    return Session(Craft(vehicle, {"actions": "surge_sway_yaw"} if vehicle == "cybership2" else {}, **more))


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


def test_frames_lost_repeated_late_and_restarted_change_nothing():
    """1,000 frames at 400 Hz over a wire that loses a quarter of the packets each way, against one that loses none."""
    sea = SeaConfig(hs=0.05, tp=1.5)
    clean, rough = Peer(_wire(_session(sea=sea))), _session(sea=sea)
    peer = Peer(_wire(rough), loss=0.25, seed=3)
    for frame in range(300):
        peer.step(_pwm(2 * frame))  # of a life before the restart
    peer.restart()
    for frame in range(1000):
        assert peer.step(_pwm(frame)) == clean.step(_pwm(frame))
    assert [peer.heard[k]["timestamp"] for k in (0, 999)] == pytest.approx([1 / 400, 1000 / 400])
    counts = rough.counts
    assert counts.frames == 1300 and counts.restarts == 1 and counts.lost == 0 and not counts.refused
    assert counts.repeated > 200 and counts.late > 100


def test_frames_that_never_come_pass_under_the_last_outputs():
    jumping, whole = Peer(_wire(_session())), Peer(_wire(_session()))
    for frame in range(100):
        pwm = _pwm(40 * (frame // 10))
        whole.step(pwm)
        jumping.frame = frame
        if frame % 10 in (0, 1, 9):
            assert jumping.step(pwm) == whole.heard[frame]


def test_who_drives_and_who_does_not():
    session = _session()
    peer = Peer(_wire(session))
    for frame in range(5):
        peer.step(_pwm(frame))
    answer = session.answer
    stranger = Peer(_wire(session, STRANGER))
    assert session.receive(stranger.packet(_pwm(0)), STRANGER) is None
    stranger.frame = 6
    assert session.receive(stranger.packet(_pwm(0)), OTHER_PORT) is None
    assert session.receive(b"\x1aH" + b"\0" * 20, ME) is None and session.receive(b"GET / HTTP/1.1", ME) is None
    assert session.answer == answer and len(session.counts.refused) == 4
    again = Peer(_wire(session, OTHER_PORT))
    assert again.step(_pwm(0))["timestamp"] == pytest.approx(1 / 400)
    assert session.counts.restarts == 1 and session.peer == OTHER_PORT


def test_another_frame_rate_goes_on_from_the_same_motion():
    session = _session()
    peer = Peer(_wire(session), rate=400)
    before = [peer.step([1500, 0, 1900]) for _ in range(800)][-1]
    peer.rate = 50
    after = peer.step([1500, 0, 1900])
    assert after["timestamp"] == pytest.approx(before["timestamp"] + 1 / 50)
    way = np.subtract(after["position"], before["position"])
    assert way == pytest.approx(np.array(before["velocity"]) / 50, rel=0.02, abs=1e-5)


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


def test_a_multirotor_stands_until_its_rotors_lift_it():
    peer = Peer(_wire(_session("x500")))
    for _ in range(200):
        still = peer.step([1000] * 4)
    assert still["position"] == [0.0, 0.0, 0.0] and still["velocity"] == [0.0, 0.0, 0.0]
    assert still["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -GRAVITY], abs=1e-4)
    for _ in range(200):
        up = peer.step([1900] * 4)
    assert up["position"][2] < -0.2 and up["velocity"][2] < -1.0 and up["imu"]["accel_body"][2] < -GRAVITY
    rolled = [peer.step([1850, 1850, 1900, 1850]) for _ in range(20)][-1]  # more of front left: rolls right, nose up
    assert rolled["imu"]["gyro"][0] > 0.1 and rolled["imu"]["gyro"][1] > 0.1


def test_an_aircraft_waits_for_its_throttle_and_obeys_its_surfaces():
    peer = Peer(_wire(_session("aerosonde", air=AirConfig(speed=4.0))), 200)
    held = [peer.step([1500, 1500, 1000, 1500]) for _ in range(50)][-1]
    assert held["velocity"] == [0.0, 0.0, 0.0] and held["airspeed"] == pytest.approx(4.0, rel=0.5)
    flying = peer.step([1500, 1500, 1700, 1500])
    assert flying["airspeed"] == pytest.approx(25.0, abs=2.0)
    assert [peer.step([1700, 1500, 1700, 1500]) for _ in range(30)][-1]["imu"]["gyro"][0] > 0.1  # rolls right
    peer.restart()
    for pwm in [[1500, 1500, 1000, 1500]] * 5 + [[1500, 1700, 1700, 1500]] * 40:
        up = peer.step(pwm)
    assert up["imu"]["gyro"][1] > 0.05  # nose up


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


def _start(*words):
    command = [sys.executable, "-m", "taichi_sim.commands.sitl", *words]
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
            began = time.perf_counter()
            for frame in range(1, 400):
                peer.step(_pwm(frame))
            print(f"{399 / (time.perf_counter() - began):.0f} frames/s")
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
    ("kvlcc2 --live --live-port 0", "--live-port 0: allowed are 1 to"),
    ("kvlcc2 --port {port}", "in use"),
])  # fmt: skip
def test_bad_input_is_told(words, told, capsys):
    from taichi_sim.commands import sitl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        try:
            assert sitl.main(words.format(port=taken.getsockname()[1]).split()) == 2
        except SystemExit as ended:
            assert ended.code == 2
    assert told in capsys.readouterr().err
