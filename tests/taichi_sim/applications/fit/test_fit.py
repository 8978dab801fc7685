"""Numbers from logs: known numbers come back, what data do not tell is said, and bad logs are told."""

import csv
import glob
import re
import shlex
import shutil
import struct
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from folders import ROOT
from recorded import make_episode
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from taichi_sim.applications.commands import fit as command
from taichi_sim.applications.fit import estimate
from taichi_sim.applications.fit.estimate import Fit, Start, _directions, _given_the_rest, fit
from taichi_sim.applications.fit.gauss_newton import delayed
from taichi_sim.applications.fit.log import read_columns, read_log
from taichi_sim.applications.fit.log_table import LogError, Source, drawn_means, held_means
from taichi_sim.applications.fit.residual_correlation import spreads
from taichi_sim.applications.fit.sample_selection import inspected
from taichi_sim.applications.fit.synthetic_logs import write_logs
from taichi_sim.applications.fit.windows import WindowSimulator, members, windows_of
from taichi_sim.config import ConfigError, TeamConfig
from taichi_sim.config.io import vehicle_file
from taichi_sim.models.catalogue import load_vehicle
from taichi_sim.visualisation.recording.ros import write_mcap

pytestmark = pytest.mark.usefixtures("f64")
FACTORS = {"X_u": 1.15, "N_r": 0.9, "surge_force_max": 0.92, "yaw_moment_max": 1.1}


@pytest.fixture(scope="module")
def logs(f64, tmp_path_factory):
    return write_logs("otter_3dof", FACTORS, tmp_path_factory.mktemp("logs"), count=3, seconds=40.0, seed=4)


def test_known_numbers_come_back_within_their_intervals(logs):
    model = load_vehicle("otter_3dof")
    found = fit("otter_3dof", [read_log(file, model) for file in logs], dict.fromkeys(FACTORS, 0.4), starts=1)
    true = found.nominal * list(FACTORS.values())
    assert found.values == pytest.approx(true, rel=0.05)
    assert found.told.all()
    half = 0.5 * (found.high - found.low)
    assert (np.abs(found.values - true) < 2.0 * half).all()  # four deviations
    assert found.sigma == pytest.approx([0.1, 0.1, np.radians(0.5), np.radians(0.2)], rel=0.15)
    assert found.after < 1.2 < found.before
    assert not found.odd  # logs of one boat agree
    held = [track for track in found.tracks if track.by_file is not None]
    assert len(held) == len(found.tracks) // 5
    by_fit, by_file = (np.std(np.concatenate([(t.measured - m)[:, 0] for t, m in zip(held, motions, strict=True)]))
                       for motions in ([t.fitted for t in held], [t.by_file for t in held]))  # fmt: skip
    assert by_fit < 0.12 < by_file  # north, m: only the noise is left


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(tmp_path):
    """Numbers drawn about the file's, ten logs of 60 s for each draw. docs/fit.md has more cases, by the same code."""
    cases, model = 16, load_vehicle("otter_3dof")
    keys = command.numbers_of(model, "", "otter_3dof")
    prior = {key: command.PRIORS.get(key, command.PRIOR) for key in keys}
    inside = np.empty((cases, len(keys)), dtype=bool)
    for case in range(cases):
        drawn = np.random.default_rng(1000 + case).normal(size=len(keys)) * np.minimum(list(prior.values()), 0.25)
        factors = dict(zip(keys, np.exp(drawn), strict=True))
        files = write_logs("otter_3dof", factors, tmp_path / str(case), seed=case)
        found = fit("otter_3dof", [read_log(file, model) for file in files], prior)
        true = found.nominal * np.exp(drawn)
        inside[case] = (found.low <= true) & (true <= found.high)
        near = np.abs(found.values / true - 1.0)
        assert (near[[keys.index(k) for k in ("mass", "surge_force_max", "X_u")]] < 0.08).all(), case
        assert not found.odd, case
    assert 0.85 < inside.mean() <= 0.99


def _changed(source, target, change):
    with source.open() as file:
        rows = list(csv.DictReader(file))
    rows = change(rows) or rows
    with target.open("w", newline="") as file:
        table = csv.DictWriter(file, rows[0].keys())
        table.writeheader()
        table.writerows(rows)
    return target


def _each(key, function):
    def change(rows):
        for row in rows:
            row[key] = function(row)

    return change


def _swapped(rows):
    for row in rows:
        row["north"], row["east"] = row["east"], row["north"]


def _all_degrees(rows):
    for row in rows:
        row["heading"] = np.degrees(float(row["heading"])) % 360
        row["yaw_rate"] = np.degrees(float(row["yaw_rate"]))


def _as_degrees(rows):
    for row in rows:
        row["heading_deg"], row["yaw_rate_deg"] = row.pop("heading"), row.pop("yaw_rate")


def _enu(rows):
    """Heading counter-clockwise from east, and so the yaw rate."""
    for row in rows:
        row["heading"], row["yaw_rate"] = 0.5 * np.pi - float(row["heading"]), -float(row["yaw_rate"])


def _straight(rows, heading=0.0):
    for k, row in enumerate(rows):
        row.update(north=0.05 * k, east=0.0, heading=heading, yaw_rate=1e-5 * (k % 3), yaw=0.0)


BAD = {
    "all in degrees": (_all_degrees, "heading looks like degrees, by the course over ground: name .* heading_deg"),
    "radians": (_as_degrees, "heading_deg looks like radians"),
    "enu": (_enu, "counted from east .ENU."),
    "enu, straight": (lambda rows: _straight(rows, 0.5 * np.pi), "lies 90 degrees to port of the heading, .* .ENU."),
    "milliseconds": (_each("t", lambda r: 1000 * float(r["t"])), "samples are 100 s apart: is t in other units"),
    "empty": (_each("north", lambda r: ""), "line 2: north is not a number"),
    "degrees": (_each("heading", lambda r: np.degrees(float(r["heading"]))), "heading looks like degrees"),
    "rates": (_each("yaw_rate", lambda r: np.degrees(float(r["yaw_rate"]))), "looks like degrees per second"),
    "port": (_each("yaw_rate", lambda r: -float(r["yaw_rate"])), "turns against yaw_rate"),
    "frame": (_swapped, "north and east are exchanged"),
    "nan": (_each("east", lambda r: "nan" if r["t"].startswith("3.") else r["east"]), "line .*: east = nan"),
    "word": (_each("t", lambda r: "noon"), "t is not a number"),
    "back": (_each("t", lambda r: -float(r["t"])), "it must increase"),
    "action": (_each("yaw", lambda r: 3.0), "yaw goes to 3"),
    "lacking": (lambda rows: [{k: v for k, v in row.items() if k != "yaw"} for row in rows], "no column yaw"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_logs_are_told(name, logs, tmp_path):
    change, told = BAD[name]
    with pytest.raises(LogError, match=told):
        read_log(_changed(logs[0], tmp_path / "bad.csv", change), load_vehicle("otter_3dof"))


def _mirrored(rows):
    """ENU as a whole: it agrees with itself."""
    _swapped(rows)
    _enu(rows)


def _exchanged(rows):
    for row in rows:
        row["acceleration"], row["yaw"] = row["yaw"], row["acceleration"]


def _kilometres(rows):
    for row in rows:
        row["north"], row["east"] = 1e-3 * float(row["north"]), 1e-3 * float(row["east"])


@pytest.mark.parametrize(("change", "told"), [
    (_mirrored, "log.csv: the vessel turns against its commands: the log is mirrored .ENU"),
    (_each("acceleration", lambda r: -float(r["acceleration"])), "as if acceleration had the other sign"),
    (_exchanged, "as if acceleration and yaw were exchanged"),
    (_each("heading", lambda r: float(r["heading"]) + np.pi), "as if its heading were counted from the stern"),
    (_kilometres, r"goes 0.00\d+ m in a window where its commands drive it .* are north and east in m"),
])  # fmt: skip
def test_logs_that_agree_with_themselves_alone_are_told(change, told, logs, tmp_path):
    bad = read_log(_changed(logs[0], tmp_path / "log.csv", change), load_vehicle("otter_3dof"))
    with pytest.raises(LogError, match=told):
        fit("otter_3dof", [bad], {"X_u": 0.4}, starts=1)


def test_columns_of_other_names_are_read_where_a_file_says(logs, tmp_path):
    """Other names, other units, a wind, and empty rows at the end."""

    def renamed(rows):
        new = [
            {"time [ms]": 1000 * float(r["t"]), "N": r["north"], "E": r["east"], "psi": np.degrees(float(r["heading"])),
             "r": r["yaw_rate"], "acceleration": r["acceleration"], "rudder [deg]": 35 * float(r["yaw"]), "w": 3.0,
             "from": 90.0} for r in rows
        ]  # fmt: skip
        return [*new, dict.fromkeys(new[0], "")]

    model, file = load_vehicle("otter_3dof"), _changed(logs[0], tmp_path / "other.csv", renamed)
    where = tmp_path / "columns.toml"
    where.write_text('t = ["time [ms]", 1e-3]\nnorth = "N"\neast = "E"\nheading_deg = "psi"\nyaw_rate = "r"\n'
                     f'yaw = ["rudder [deg]", {1 / 35}]\nwind_speed = "w"\nwind_from_deg = "from"\n')  # fmt: skip
    found, plain = read_log(file, model, Source(read_columns(where))), read_log(logs[0], model)
    np.testing.assert_allclose(found.motion, plain.motion, atol=1e-9)
    np.testing.assert_allclose(found.actions, plain.actions, atol=1e-9)
    np.testing.assert_allclose(found.wind, np.tile([0.0, -3.0], (len(plain.t), 1)), atol=1e-12)  # from the east
    where.write_text('t = "x"')
    with pytest.raises(LogError, match="no column x for t; it has time .ms., N"):
        read_log(file, model, Source(read_columns(where)))
    where.write_text('north = ["x", 0]')
    with pytest.raises(LogError, match="north = .'x', 0.: expected"):
        read_columns(where)
    where.write_text('speed = "u"')
    with pytest.raises(LogError, match="speed is no column of a log of this vehicle"):
        read_log(file, model, Source(read_columns(where)))


def test_the_page_s_files_read_the_esso_osaka_s_logs(tmp_path):
    """Columns as FRT-DS-ESSO has them, values made up: a turn to starboard, wind from x0, empty rows at the end."""
    page = (ROOT / "docs" / "fit.md").read_text()
    blocks = re.findall(r"^```toml\n(.*?)^```$", page, re.M | re.S)
    for name, first in (("columns.toml", 't = "t [s]"'), ("esso_osaka.toml", "# Esso Osaka")):
        [block] = [text for text in blocks if text.startswith(first)]
        (tmp_path / name).write_text(block)
    header = ("t [s],x_position_mid [m],u_velo [m/s],y_position_mid [m],vm_velo [m/s],psi_hat [rad],r_angvelo [rad/s],"
              "n_prop [rps],delta_rudder [rad],wind_velo_relative_mid [m/s],wind_dir_relative_mid [rad],"
              "wind_velo_true [m/s],wind_dir_true [rad]")  # fmt: skip
    t = 1176.1 + 0.1 * np.arange(100)
    psi, rate = 0.05 * (t - t[0]), np.full(100, 0.05)
    x, y = 10 * np.sin(psi), 10 * (1 - np.cos(psi))
    rows = np.stack(
        [t, x, 0.5 + 0 * t, y, 0 * t, psi, rate, -10 + 0 * t, np.radians(35) + 0 * t, *4 * [1.5 + 0 * t]], 1
    )
    rows[:, -1] = 0.0
    lines = [header, *(",".join(map(repr, row)) for row in rows.tolist()), "," * 12, "," * 12]
    (tmp_path / "turn.csv").write_text("\n".join(lines))
    model = load_vehicle(tmp_path / "esso_osaka.toml")
    log = read_log(tmp_path / "turn.csv", model, Source(read_columns(tmp_path / "columns.toml")))
    np.testing.assert_allclose(log.motion, np.stack([x, y, psi, rate], 1))
    np.testing.assert_allclose(log.actions, np.tile([-0.5, 35 / 40], (100, 1)), rtol=1e-9)  # n_astern 20, 40 deg
    np.testing.assert_allclose(log.wind, np.tile([-1.5, 0.0], (100, 1)))
    assert model.params.mass == pytest.approx(244.6, abs=0.1) and log.interval == pytest.approx(0.1)


def _bag(folder, log, storage, *, last=None):
    """A bag of the topics of docs/ros.md with the motion and the actions of a log, until `last`."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types

    def make(kind, *values):
        return kinds[kind](*values)

    names, none = load_vehicle("otter_3dof").action_names, np.zeros(36)
    with Writer(folder, version=8, storage_plugin=storage) as bag:
        topics = {"odom": "nav_msgs/msg/Odometry", "actions": "sensor_msgs/msg/JointState"}
        on = {key: bag.add_connection(f"/usv_0/{key}", kind, typestore=store) for key, kind in topics.items()}
        for t, (north, east, heading, rate), action in list(zip(log.t, log.motion, log.actions, strict=True))[:last]:
            ns = 10**18 + round(1e9 * t)
            header = make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", *divmod(ns, 10**9)), "map")
            half = 0.5 * (0.5 * np.pi - heading)
            turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(half), np.cos(half))
            pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", east, north, 0.0), turn)
            still = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
            twist = make("geometry_msgs/msg/Twist", still, make("geometry_msgs/msg/Vector3", 0.0, 0.0, -rate))
            odom = make(topics["odom"], header, "usv_0/base_link",
                        make("geometry_msgs/msg/PoseWithCovariance", pose, none),
                        make("geometry_msgs/msg/TwistWithCovariance", twist, none))  # fmt: skip
            command = make(topics["actions"], header, list(names), action, np.zeros(0), np.zeros(0))
            for key, message in (("odom", odom), ("actions", command)):
                bag.write(on[key], ns, store.serialize_cdr(message, topics[key]))
    return folder


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_bag_holds_the_same_log(storage, logs, tmp_path):
    """ENU to NED, body forward-left-up to forward-right-down, and commands by their stamps."""
    model = load_vehicle("otter_3dof")
    plain = read_log(logs[0], model)
    folder = _bag(tmp_path / "bag", plain, storage)
    for path in [folder, *folder.glob("*.mcap")]:
        found = read_log(path, model)
        np.testing.assert_allclose(found.t, plain.t - plain.t[0], atol=1e-6)
        np.testing.assert_allclose(found.motion[:, [0, 1, 3]], plain.motion[:, [0, 1, 3]], atol=1e-12)
        np.testing.assert_allclose(np.exp(1j * found.motion[:, 2]), np.exp(1j * plain.motion[:, 2]), atol=1e-9)
        np.testing.assert_array_equal(found.actions, plain.actions)
        assert len(found.digest) == 64 and len(found.parts) == 1
    (part,) = (file for file in folder.iterdir() if file.suffix != ".yaml")
    shutil.copyfile(part, folder / f"bag_1{part.suffix}")
    with pytest.warns(UserWarning, match=f"left out: bag_1{part.suffix}, which metadata.yaml does not name"):
        read_log(folder, model)


def test_bags_without_what_a_fit_needs_are_told(logs, tmp_path, monkeypatch):
    model = load_vehicle("otter_3dof")
    episode = make_episode(2, steps=5)
    silent = replace(episode, teams={name: replace(team, action=None) for name, team in episode.teams.items()})
    own, mute = (write_mcap(one, tmp_path / f"{name}.mcap") for name, one in (("own", episode), ("mute", silent)))
    with pytest.raises(LogError, match="it has uav_0, uav_1, usv_0, usv_1: choose by --name"):
        read_log(own, model)
    with pytest.raises(LogError, match="no topic /usv_1/actions; it has .*Actions are read from /usv_1/actions"):
        read_log(mute, model, Source(name="usv_1"))
    with pytest.raises(LogError, match="actions: has no position of acceleration; it has thrust, turn"):
        read_log(own, model, Source(name="usv_1"))
    short = _bag(tmp_path / "short", read_log(logs[0], model), StoragePlugin.SQLITE3, last=2)
    with pytest.raises(LogError, match="2 messages of /usv_0/odom after the first command"):
        read_log(short, model)
    (tmp_path / "empty.mcap").write_bytes(b"nothing")
    for bad in (tmp_path, tmp_path / "empty.mcap"):
        with pytest.raises(LogError, match="no bag of ROS 2 that can be read"):
            read_log(bad, model)
    (killed := tmp_path / "killed.mcap").write_bytes(own.read_bytes()[:-300])
    with pytest.raises(LogError, match=r"killed.mcap has no end.*`mcap recover .*killed.mcap -o NEW.mcap`"):
        read_log(killed, model)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(ImportError, match="taichi-sim.ros."):
        read_log(own, model)


FORMATS = {  # name: number, format, columns, as ArduPilot's logger has them
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (129, "QNff", "TimeUS,Name,Value,Default"),
    "XKF1": (130, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    "IMU": (131, "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    "RCOU": (132, "Q" + 14 * "H", "TimeUS," + ",".join(f"C{n}" for n in range(1, 15))),
}
CODES = {"n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i"}  # where struct has another letter


def _layout(letters):
    return "<" + "".join(CODES.get(letter, letter) for letter in letters)


def _record(name, *values):
    number, letters, _ = FORMATS[name]
    values = [v.encode() if isinstance(v, str) else v for v in values]
    return b"\xa3\x95" + bytes([number]) + struct.pack(_layout(letters), *values)


def _dataflash(file, log, *, leave_out=(), parameters=None, gap=()):
    """A dataflash log of a boat with a throttle on output 3 and a reversed rudder on output 1."""
    parts = []
    for name, (number, letters, columns) in FORMATS.items():
        size = 3 + struct.calcsize(_layout(letters))
        parts.append(_record("FMT", number, size, name, letters, columns))
    given = {"SERVO1_FUNCTION": 26, "SERVO1_REVERSED": 1, "SERVO1_MIN": 1100, "SERVO1_MAX": 1900, "SERVO3_FUNCTION": 70}
    for key, value in (given if parameters is None else parameters).items():
        parts.append(_record("PARM", 1000, key, value, value))
    for k, ((north, east, heading, rate), (acceleration, yaw)) in enumerate(zip(log.motion, log.actions, strict=True)):
        us = 5_000_000 + 100_000 * k
        width = round(1500 + 500 * 0.5 * (acceleration + 1))
        outputs = [round(1500 - 400 * yaw), 0, width, *[0] * 11]
        degrees = round(100 * np.degrees(heading) % 36000)
        records = {
            "XKF1": [_record("XKF1", us, core, 0, 0, degrees, 0, 0, 0, 0, north + 50 * core, east, 0, 0, 0, 0, 0)
                     for core in (0, 1)],
            "IMU": [_record("IMU", us + 20_000 * j, 0, 0, 0, rate, 0, 0, -9.8, 0, 0, 20, 1, 1, 1000, 1000)
                    for j in range(-2, 3)],
            "RCOU": [_record("RCOU", us, *outputs)],
        }  # fmt: skip
        parts += [r for name, made in records.items() if name not in leave_out and k not in gap for r in made]
    file.write_bytes(b"".join(parts))
    return file


def test_a_dataflash_log_holds_the_same_log(logs, tmp_path):
    """Channels and ends of the pulse widths by the log's parameters, or by --channels where it has none."""
    model = load_vehicle("otter_3dof")
    plain = read_log(logs[0], model)
    found = read_log(_dataflash(tmp_path / "run.bin", plain, gap=range(100, 120)), model)
    assert [p.stop - p.start for p in found.parts] == [100, 280]
    kept = np.r_[:100, 120:400]
    np.testing.assert_allclose(found.t, 5.0 + 0.1 * kept, atol=1e-6)
    np.testing.assert_allclose(found.motion[:, [0, 1, 3]], plain.motion[kept][:, [0, 1, 3]], atol=1e-5)  # float32
    turned = np.angle(np.exp(1j * (found.motion[:, 2] - plain.motion[kept, 2])))
    np.testing.assert_allclose(turned, 0.0, atol=np.radians(0.0051))
    middle = 0.5 * (plain.actions[:-1] + plain.actions[1:])  # samples of a signal: means over the intervals after them
    inside = np.flatnonzero(np.diff(kept) == 1)
    np.testing.assert_allclose(found.actions[inside], middle[kept[inside]], atol=0.003)  # whole microseconds
    bare = _dataflash(tmp_path / "bare.BIN", plain, parameters={})
    np.testing.assert_allclose(read_log(bare, model).actions[:-1, 1], -0.8 * middle[:, 1], atol=0.003)
    asked = read_log(bare, model, Source(channels="helm=-1"))
    np.testing.assert_allclose(asked.actions[:-1, 1], 0.8 * middle[:, 1], atol=0.003)


def test_bad_dataflash_logs_are_told(logs, tmp_path, monkeypatch):
    model, plain = load_vehicle("otter_3dof"), read_log(logs[0], load_vehicle("otter_3dof"))
    for name in ("XKF1", "IMU", "RCOU"):
        with pytest.raises(LogError, match=f"0 messages {name}; wanted are"):
            read_log(_dataflash(tmp_path / "less.bin", plain, leave_out=(name,)), model)
    two = {"SERVO1_FUNCTION": 70, "SERVO2_FUNCTION": 70, "SERVO3_FUNCTION": 26}
    with pytest.raises(LogError, match="2 servo outputs have the function 70 of ahead: name its channel"):
        read_log(_dataflash(tmp_path / "two.bin", plain, parameters=two), model)
    skid = {"SERVO1_FUNCTION": 73, "SERVO3_FUNCTION": 74}
    with pytest.raises(LogError, match="it has two throttles, 73 and 74: give --set 'actions=\"left_right\"'"):
        read_log(_dataflash(tmp_path / "skid.bin", plain, parameters=skid), model)
    ends = {"SERVO1_MIN": 1600, "SERVO1_FUNCTION": 26, "SERVO3_FUNCTION": 70}
    with pytest.raises(LogError, match="SERVO1_MIN, _TRIM, _MAX are 1600, 1500, 2000: they must increase"):
        read_log(_dataflash(tmp_path / "ends.bin", plain, parameters=ends), model)
    (tmp_path / "text.bin").write_text("t,north\n")
    with pytest.raises(LogError, match="no dataflash log of ArduPilot"):
        read_log(tmp_path / "text.bin", model)
    monkeypatch.setitem(sys.modules, "pymavlink.DFReader", None)
    with pytest.raises(ImportError, match="taichi-sim.ardupilot."):
        read_log(tmp_path / "text.bin", model)


def test_a_gap_parts_a_log(logs, tmp_path):
    file = _changed(logs[0], tmp_path / "gap.csv", lambda rows: rows[:150] + rows[220:])
    assert [p.stop - p.start for p in read_log(file, load_vehicle("otter_3dof")).parts] == [150, 180]


def test_a_clock_of_large_numbers_changes_nothing(logs, tmp_path):
    """Seconds since 1970 have steps of 0.24 microseconds: no command moves to the step before."""
    model = load_vehicle("otter_3dof")
    late = _changed(logs[0], tmp_path / "late.csv", _each("t", lambda r: f"{1.7e9 + float(r['t']):.3f}"))
    one, other = (windows_of([read_log(file, model)], 6.0) for file in (logs[0], late))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.actions, b.actions)
        np.testing.assert_allclose(a.motion, b.motion, atol=1e-5)


@pytest.mark.slow
def test_what_data_do_not_tell_is_said_and_kept(tmp_path):
    """A boat that never turned says nothing of its yaw damping."""
    files = write_logs("otter_3dof", {"X_u": 1.1}, tmp_path, count=1, seconds=40.0)
    straight = _changed(files[0], tmp_path / "straight.csv", _straight)
    found = fit("otter_3dof", [read_log(straight, load_vehicle("otter_3dof"))], {"X_u": 0.4, "N_rr": 0.4}, starts=1)
    assert list(found.told) == [True, False] and found.values[1] == found.nominal[1]
    assert sorted((found.low[1], found.high[1])) == pytest.approx(  # the prior's
        sorted(found.nominal[1] * np.exp(0.4 * 1.96 * np.array([-1, 1])))
    )


def test_changes_that_data_do_not_tell_are_named():
    """Data that tell a ratio alone leave the product to the priors; a single number is no joint change."""
    ratio, prior = np.array([1.0, -1.0, 0.0]) / 0.01, np.array([0.4, 0.4, 0.02])
    S = np.outer(ratio, ratio) + np.diag(prior**-2.0)
    [change] = _directions(S, prior)
    assert change == pytest.approx([0.4 / np.sqrt(2), 0.4 / np.sqrt(2), 0.0], abs=1e-9)
    assert _directions(S + np.diag([1e4, 0.0, 0.0]), prior) == []


def test_numbers_that_data_tell_follow_those_that_keep_the_file_s_value():
    """The mean of a normal distribution under a condition, by its precision matrix (Schur complement)."""
    rng = np.random.default_rng(3)
    root, phi = rng.normal(size=(4, 6)), rng.normal(size=4)
    precision, told = root @ root.T, np.array([True, False, True, False])
    kept = _given_the_rest(phi, np.linalg.inv(precision), told)
    assert (kept[~told] == 0).all()
    best = np.linalg.solve(precision[np.ix_(told, told)], (precision @ phi)[told])  # least (x - phi) S (x - phi)
    assert kept[told] == pytest.approx(best, rel=1e-9)
    assert (_given_the_rest(phi, precision, np.ones(4, bool)) == phi).all()
    assert (_given_the_rest(phi, precision, np.zeros(4, bool)) == 0).all()


@pytest.mark.slow
def test_starts_that_disagree_are_told(logs):
    """One as likely as the best, one in a local minimum, by the lines of the command."""
    found = fit("otter_3dof", [read_log(logs[0], load_vehicle("otter_3dof"))], {"X_u": 0.4}, starts=2)
    assert found.asked == 2 and len(found.starts) == 1
    [line] = command.of_starts(found)
    assert line.startswith("2 starts end at the same numbers: ")
    best = found.starts[0]
    others = [Start(best.phi + np.log(1.5), 0.5), Start(best.phi - np.log(2.0), 40.0)]
    lines = command.of_starts(found._replace(starts=[best, *others]))
    assert lines[0].startswith("2 starts end at 3 places, the most likely one is kept")
    assert "X_u +50 %: as likely" in lines[1] and "X_u -50 %: a worse local minimum" in lines[2]


@pytest.mark.slow
def test_logs_of_two_boats_are_told_apart(tmp_path, capsys):
    """Two logs of one boat, and one of a boat of half its drag."""
    one, two = (write_logs("otter_3dof", {"X_u": f}, tmp_path / str(f), count=2, seconds=20.0) for f in (1.0, 0.5))
    other = two[0].rename(tmp_path / "other.csv")
    assert command.main(["otter_3dof", *map(str, one), str(other), "--numbers", "X_u", "--starts", "1"]) == 0
    told = capsys.readouterr().out
    assert "would not ask for such different numbers" in told
    assert "log0.csv: X_u +" in told and "log1.csv: X_u +" in told and "other.csv: X_u -" in told


def test_too_few_samples_are_told(tmp_path, capsys):
    file = write_logs("otter_3dof", {"X_u": 1.0}, tmp_path, count=1, seconds=12.0)[0]
    few = _changed(file, tmp_path / "few.csv", lambda rows: rows[::10])
    assert command.main(["otter_3dof", str(few)]) == 2
    assert "measured values for 22 unknowns" in capsys.readouterr().err
    assert command.main(["otter_3dof", str(few), "--window", "60"]) == 2
    assert "few.csv: no log has 60 s without a gap" in capsys.readouterr().err
    assert command.main(["otter_3dof", str(file), "--test", str(file)]) == 2
    assert "log0.csv is given twice" in capsys.readouterr().err
    assert command.main(["otter_3dof", str(file), "--prior", "mas=0.1"]) == 2
    assert "--prior mas: it is not fitted; fitted are mass, I_z" in capsys.readouterr().err
    (tmp_path / "flight.bin").write_bytes(b"\xa3\x95\x80\xff")
    assert command.main(["otter_3dof", str(tmp_path / "flight.bin")]) == 2
    assert "0 messages XKF1" in capsys.readouterr().err


def test_the_command_makes_logs_fits_them_and_writes_a_file(capsys, tmp_path):
    words = ["otter_3dof", "--synthetic", str(tmp_path), "--factor", "X_u=1.2", "--count", "2"]
    assert command.main(words) == 0
    files = capsys.readouterr().out.split()
    out, page = tmp_path / "mine.toml", tmp_path / "fit.html"
    numbers = ["--numbers", "X_u,surge_force_max"]
    asked = ["--test", files[1], "--out", str(out), "--report", str(page)]
    assert command.main(["otter_3dof", files[0], *numbers, *asked]) == 0
    html = page.read_text()
    assert all(Path(file).name in html for file in files) and html.count("<svg") == 2 + len(files)
    told = capsys.readouterr().out
    assert "95 % interval" in told and "current" in told and "1 is the noise" in told
    assert "starts end at the same numbers" in told
    file, by_fit = map(float, re.findall(r"(\S+) m, \S+ deg, \S+ deg/s rms", told))
    assert 0.13 < by_fit < 0.16 < file  # m: both components have 0.1 m of noise
    assert load_vehicle(out).params.X_u == pytest.approx(1.2 * load_vehicle("otter_3dof").params.X_u, rel=0.03)
    assert "sha256" in out.read_text() and "95 %:" in out.read_text()


@pytest.mark.slow
def test_slow_late_and_jumping_positions_keep_the_intervals(logs, tmp_path, capsys):
    """Positions at 1 Hz in rows at 10 Hz, 0.2 s late, and one jump of 5 m: the numbers and the delay come back."""

    def change(jump):
        def slow(rows):
            places = [(float(r["north"]), float(r["east"])) for r in rows]
            for k, row in enumerate(rows):
                north, east = places[max(k - 2, 0) // 10 * 10]
                row["north"], row["east"] = north + (jump if k >= 202 else 0.0), east

        return slow

    model = load_vehicle("otter_3dof")
    files = [_changed(f, tmp_path / f.name, change(5.0 if k == 1 else 0.0)) for k, f in enumerate(logs)]
    read = [read_log(file, model) for file in files]
    assert all("position repeats in 36" in log.notes[0] and "new ones are 1 s apart" in log.notes[0] for log in read)
    assert [len(log.parts) for log in read] == [1, 2, 1]
    assert float(re.fullmatch(r"position jumps by (\S+) m at 20.2 s: .*", read[1].notes[1])[1]) == pytest.approx(
        5, abs=2
    )
    found = fit("otter_3dof", read, dict.fromkeys(FACTORS, 0.4), starts=1)
    true = found.nominal * list(FACTORS.values())
    half = 0.5 * (found.high - found.low)
    assert (np.abs(found.values - true) < 1.5 * half).all()  # three deviations
    assert found.sigma == pytest.approx([0.1, 0.1, np.radians(0.5), np.radians(0.2)], rel=0.25)
    late, deviation = found.delays - [0.2, 0.0, 0.0], found.delay_deviations
    assert (np.abs(late) < 3.5 * deviation).all() and (deviation < 0.1).all()
    assert any("behind the commands are position +0." in line for line in command.of_delays(found, read))


def _walk(rng, samples, constant):
    """Noise of deviation 1 with the autocorrelation exp(-lag / constant) [.., samples]."""
    share = np.exp(-1 / constant)
    noise = rng.normal(size=samples)
    for k in range(1, samples[-1]):
        noise[..., k] = share * noise[..., k - 1] + np.sqrt(1 - share**2) * noise[..., k]
    return noise


def test_dependent_residuals_widen_as_the_variance_of_a_mean_says():
    """The number is a constant: the mean of n samples has the variance (1 + 2 sum (1 - k/n) rho_k) / n."""
    rng, windows, n = np.random.default_rng(1), 150, 60
    left = rng.normal(size=(windows, n, 4))
    left[..., 0] = _walk(rng, (windows, n), 5.0)
    left[..., 1] = 0.8 * left[..., 1] + 0.6 * _walk(rng, (windows, n), 5.0)
    slope = np.zeros((windows, n, 4, 1 + 7 + 6))
    slope[..., 0] = 1.0
    new = np.ones(left.shape, dtype=bool)
    problem = SimpleNamespace(new=new, of=np.zeros(windows, int))
    point = SimpleNamespace(left=left, slope=slope, phi=np.zeros(1))
    m = 7 + 6 * windows
    normal = SimpleNamespace(blocks=[(0, np.arange(windows), np.zeros((1, m)), np.eye(m), np.zeros(m))])
    k = np.arange(1, n)
    more = 2 * np.sum((1 - k / n) * np.exp(-k / 5.0))
    assert spreads(problem, point, normal, np.ones(4)) == pytest.approx(
        np.sqrt([1 + more, 1 + 0.36 * more, 1.0, 1.0]), rel=0.1
    )


def test_a_delayed_motion_is_that_of_an_earlier_time():
    """Cubics through values and central differences reproduce parabolas; beyond the ends, lines."""
    t = np.arange(12.0)
    motion = np.stack([t**2, 3 * t, t**2 - t, 2 - t], 1)[None]
    late = np.array([[0.3, -0.6, 1.2]])
    found = delayed(motion, late)[0]
    at = t[:, None] - late[0][[0, 0, 1, 2]]
    there = np.stack([at[:, 0] ** 2, 3 * at[:, 1], at[:, 2] ** 2 - at[:, 2], 2 - at[:, 3]], 1)
    np.testing.assert_allclose(found[3:9], there[3:9], atol=1e-12)
    np.testing.assert_allclose(found[:, [1, 3]], there[:, [1, 3]], atol=1e-12)


def test_means_of_commands():
    """A step of a held command at 0.25 s; a ramp, whose mean over an interval is its middle."""
    begin, end = np.array([0.0, 0.1, 0.2]), np.array([0.1, 0.2, 0.3])
    t = np.array([0.0, 0.25])
    np.testing.assert_allclose(held_means(t, np.array([1.0, 3.0]), begin, end), [1.0, 1.0, 2.0])
    t = np.array([-0.03, 0.04, 0.13, 0.3])
    np.testing.assert_allclose(drawn_means(t, 2 * t, begin, end), [0.1, 0.3, 0.5], atol=1e-12)


def _held(columns, times):
    def change(motion):
        k = np.arange(len(motion)) // times * times
        motion[:, columns] = motion[k][:, columns]

    return change


def _drawn(columns, times):
    def change(motion):
        k, knots = np.arange(len(motion)), np.arange(0, len(motion), times)
        for c in columns:
            motion[:, c] = np.interp(k, knots, motion[knots, c])

    return change


def _off(column, size, last=None):
    def change(motion):
        motion[100:last, column] += size

    return change


def _rounded(column, step):
    def change(motion):
        motion[:, column] = np.round(motion[:, column] / step) * step

    return change


def _through_north(motion):
    """A heading that passes north between two samples, between which one was drawn as a number."""
    heading = motion[:, 2] % (2 * np.pi)
    k = int(np.flatnonzero(np.abs(np.diff(heading)) > np.pi)[0])
    heading[k] = 0.5 * (heading[k - 1] + heading[k + 1])
    motion[:, 2] = heading


@pytest.mark.parametrize(("change", "new", "parts", "told"), [
    (lambda motion: None, [300] * 4, 1, []),
    (_held([0, 1], 10), [29, 29, 300, 300], 1, ["position repeats in 271 of 300 rows, new ones are 1 s apart"]),
    (_held([2], 5), [300, 300, 59, 300], 1, ["heading repeats in 241"]),
    (_held([0, 1, 2, 3], 2), [149] * 4, 1, ["position repeats", "heading repeats", "yaw rate repeats"]),
    (_drawn([0, 1], 10), [29, 29, 300, 300], 1, ["position is drawn between others in 271 of 300 rows"]),
    (_rounded(2, np.radians(1.0)), [300] * 4, 1, []),  # a coarse compass is no slow one
    (_rounded(3, 0.01), [300] * 4, 1, []),
    (_rounded([0, 1], 1.1), None, 1, None),  # degrees of five decimals: repeats and cells, no jumps
    (_off(0, 5.0), [300] * 4, 2, [r"position jumps by (4|5)\S* m at 10 s: no window spans it"]),
    (_off(1, -40.0, 101), [299, 299, 300, 300], 1, [r"position is off by (39|40)\S* m at 10 s, and back 0.1 s later"]),
    (_off(2, 0.5), [300] * 4, 1, ["heading jumps by 28 deg at 10 s", "only 10 to 29.9 s is used"]),
    (_off(2, 0.5, 103), [300, 300, 297, 300], 1, ["heading is off by .* deg at 10 s, and comes back"]),
    (_off(3, 1.0, 101), [300] * 4, 1, []),  # a spike of the gyro is an outlier of its own
    (_through_north, [300, 300, 299, 300], 1, ["heading goes the wrong way round at .* .interpolated through north"]),
])  # fmt: skip
def test_repeats_and_jumps_are_found(change, new, parts, told):
    """A circle at 1 m/s and 0.3 rad/s in white noise, 30 s at 10 Hz."""
    t, noise = 0.1 * np.arange(300), np.random.default_rng(2).normal(size=(300, 4))
    psi = 0.3 * t + 0.5
    plain = np.stack([np.sin(psi) / 0.3, -np.cos(psi) / 0.3, psi, np.full(300, 0.3)], 1)
    motion = plain + noise * [0.1, 0.1, np.radians(0.5), np.radians(0.2)]
    change(motion)
    found = inspected(t, motion, (slice(0, 300),))
    assert len(found.parts) == parts
    if new is None:
        assert not any("jump" in note or "off by" in note for note in found.notes), found.notes
        return
    assert found.new.sum(axis=0).tolist() == new
    assert len(found.notes) == len(told)
    assert all(re.search(a, b) for a, b in zip(told, found.notes, strict=True)), found.notes
    if "jumps" not in str(told):
        assert np.abs(found.motion[:, 2] - plain[:, 2] - found.motion[0, 2] + plain[0, 2]).max() < 0.4


def test_a_vehicle_file_takes_elements_new_keys_and_changes(tmp_path):
    """Elements of lists, a key that the file lacks, a published M_rb that follows the mass, and what --set changed."""
    changes = {"actions": "left_right"}
    model, file = load_vehicle("otter", **changes), vehicle_file(TeamConfig(vehicle="otter"))
    keys = ("rigid_body.mass", "hydrodynamics.linear.0", "thrusters.gain_left")
    out = tmp_path / "mine.toml"
    command.check_out(out, file, model, keys, changes)
    assert not list(tmp_path.iterdir())
    found = SimpleNamespace(keys=keys, values=[84.0, 70.0, 0.9], low=[1.0] * 3, high=[2.0] * 3, told=[True] * 3)
    command.save(out, file, model, found, [], changes)
    mine = load_vehicle(out)
    assert [mine.nominal[key] for key in keys] == pytest.approx([84.0, 70.0, 0.9])
    assert mine.params.rigid_body.M_rb[2][2] == pytest.approx(84.0)
    assert mine.action_names == ("left", "right")
    assert mine.params.hydrodynamics.linear[1:] == model.params.hydrodynamics.linear[1:]


def _stand_in(file):
    """A log of a tanker as FRT-DS-ESSO has them, of 48 s: a turn to starboard in a calm, with some noise."""
    rng, t = np.random.default_rng(sum(file.name.encode())), 0.1 * np.arange(480)
    psi = 0.05 * t
    columns = {
        "t [s]": t, "x_position_mid [m]": 8 * np.sin(psi), "y_position_mid [m]": 8 * (1 - np.cos(psi)),
        "psi_hat [rad]": psi, "r_angvelo [rad/s]": 0.05 + 0 * t, "n_prop [rps]": 10 + 0 * t,
        "delta_rudder [rad]": 0.3 + 0 * t, "wind_velo_true [m/s]": 0 * t, "wind_dir_true [rad]": 0 * t,
    }  # fmt: skip
    noise = {name: 1e-3 * rng.normal(size=len(t)) for name in list(columns)[1:5]}
    rows = np.stack([values + noise.get(name, 0.0) for name, values in columns.items()], 1)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]))


def _unfitted(vehicle, logs, priors, changes=None, tests=(), **_):
    """A result without a search."""
    keys, n = tuple(priors), len(priors)
    ones, nominal = np.ones(n), np.array([load_vehicle(vehicle, **dict(changes or {})).nominal[key] for key in keys])
    return Fit(
        keys, nominal, nominal, 0.9 * nominal, 1.1 * nominal, ones > 0, 0 * ones, np.eye(n), np.ones(4), np.ones(4),
        np.zeros((len(logs), 2)), np.zeros((len(logs), 3)), np.ones((len(logs), 3)), [], 1.0, 1.0, 1, {}, [], [],
        [Start(0 * ones, 0.0)], 1, 0.0,
        [estimate.Tested(log, np.zeros(2), np.ones(4), np.ones(4), []) for log in tests],
    )  # fmt: skip


@pytest.mark.slow
def test_numbers_of_a_section_share_a_factor():
    model, file = load_vehicle("otter"), vehicle_file(TeamConfig(vehicle="otter"))
    values = command.values_of(model, ("hydrodynamics.linear", "rigid_body.mass"), [0.5, 82.0], ["", ""])
    found = tomllib.loads(command.written(file, values))
    before = tomllib.loads(file.read_text())["hydrodynamics"]["linear"]
    assert found["hydrodynamics"]["linear"] == pytest.approx([0.5 * x for x in before])
    assert found["rigid_body"]["mass"] == 82.0
    one, each = (WindowSimulator("otter", keys, 0.1) for keys in (
        ("hydrodynamics.linear",), tuple(members(model, "hydrodynamics.linear"))
    ))  # fmt: skip
    windows = [SimpleNamespace(actions=np.full((13, 2), 0.5), wind=None)] * 2
    phi, state = np.array([[0.0], [0.5]]), np.tile([0.0, 0.0, 0.0, 1.0, 0.2, 0.1], (2, 1))
    moved = one.run(windows, phi, np.zeros((2, 2)), state)
    assert np.abs(moved[:, 0] - moved[:, 1]).max() > 0.01
    assert np.array_equal(moved, each.run(windows, np.tile(phi, (1, len(each.keys))), np.zeros((2, 2)), state))
    with pytest.raises(ConfigError, match=r"names hydrodynamics.linear.0 twice"):
        WindowSimulator("otter", ("hydrodynamics.linear", "hydrodynamics.linear.0"), 0.1)
    with pytest.raises(ConfigError, match="'hydrodynamics.lift' cannot vary"):
        WindowSimulator("otter", ("hydrodynamics.lift",), 0.1)


def test_numbers_far_from_the_file_are_told():
    """Positions in feet made the moment of inertia 30 times the file's: 8.5 deviations of its prior."""
    found = _unfitted("otter_3dof", [], {"X_u": 0.4, "I_z": 0.4})
    assert not any("FAR" in line for line in command.lines(found, []))
    told = "\n".join(command.lines(found._replace(surprise=np.array([1.0, 8.5])), []))
    assert "FAR FROM THE FILE" in told and "I_z (+8.5)" in told and "X_u (" not in told


@pytest.mark.parametrize("searches", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_commands_of_the_page_run(searches, tmp_path, monkeypatch, capsys):
    """docs/fit.md: every `taichi-sim fit` as it is written, with small stand-ins for data; slow: with searches."""
    page = (ROOT / "docs" / "fit.md").read_text()
    monkeypatch.chdir(tmp_path)
    if not searches:
        monkeypatch.setattr(command, "fit", _unfitted)
    for name, first in (("columns.toml", 't = "t [s]"'), ("esso_osaka.toml", "# Esso Osaka")):
        [block] = [x for x in re.findall(r"^```toml\n(.*?)^```$", page, re.M | re.S) if x.startswith(first)]
        Path(name).write_text(block)
    lines = re.sub(r"\\\n\s*", "", "\n".join(re.findall(r"^```sh\n(.*?)^```$", page, re.M | re.S))).splitlines()
    fits = [shlex.split(x, comments=True)[2:] for x in lines if x.startswith("taichi-sim fit")]
    assert len(fits) == 4
    for word in (word for words in fits for word in words if word.startswith("$d")):
        _stand_in(Path(re.sub(r"\[(.).*\]", r"\1", word.replace("$d", "data"))))
    rest = np.random.default_rng(0).normal(size=(200, 4)) * 1e-4
    still = SimpleNamespace(motion=rest, actions=np.tile([-1.0, 0.0], (200, 1)))
    _dataflash(Path("00000012.bin"), still, parameters={"SERVO1_FUNCTION": 73, "SERVO3_FUNCTION": 74})
    for words in fits:
        given = [word.replace("$d", "data") for word in words]
        given = [name for word in given for name in (sorted(glob.glob(word)) or [word])]
        assert command.main(given + ["--count", "2"] * ("--synthetic" in words)) == 0, (given, capsys.readouterr().err)
    assert all(Path(name).is_file() for name in ("mine.toml", "fit.html", "fitted.toml", "esso.html"))


@pytest.mark.parametrize(("words", "told"), [
    ("otter_3dof", "no logs"),
    ("x500 nolog.bin --numbers mass", "only vessels can be fitted"),
    ("otter_3dof nolog.csv", "No such file"),
    ("otter_3dof --synthetic x --factor X_u", "expected KEY=NUMBER"),
    ("otter", "no logs"),
    ("kvlcc2 --synthetic x", "name what to fit by --numbers"),
    ("otter_3dof nolog.csv --columns nofile.toml", "nofile.toml"),
])  # fmt: skip
def test_bad_input_is_told(words, told, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        assert command.main(words.split()) == 2
    except SystemExit as ended:
        assert ended.code == 2
    assert told in capsys.readouterr().err
