"""What the fields of a log mean: what is there without a value, and what is stated, is not taken for another thing."""

import csv

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from test_fit import FORMATS, _dataflash, _record

from taichi_sim.applications.fit.log import read_log
from taichi_sim.applications.fit.log_table import LogError, Source
from taichi_sim.applications.fit.synthetic_logs import write_logs
from taichi_sim.models.catalogue import load_vehicle

pytestmark = pytest.mark.usefixtures("f64")
EPOCH = 1_700_000_000  # s, stamp of the first message


@pytest.fixture(scope="module")
def model(f64):
    return load_vehicle("otter_3dof")


@pytest.fixture(scope="module")
def log(model, tmp_path_factory):
    [file] = write_logs("otter_3dof", {"X_u": 1.0}, tmp_path_factory.mktemp("log"), count=1, seconds=30.0)
    return read_log(file, model)


@pytest.fixture(scope="module")
def thin(log):
    """Every third sample, for bags, which take long to write."""
    return log._replace(t=log.t[::3], motion=log.motion[::3], actions=log.actions[::3])


def bag(folder, log, *, quaternion=None, stamp=0.0, frame="map", child="boat/base_link", yaw=0.0, rate=None):
    """A bag of the log; `stamp`: of a command less that of the odometry, s, or None for 0; `yaw`: its variance."""
    store = get_typestore(Stores.ROS2_HUMBLE)

    def make(kind, *values):
        return store.types[kind](*values)

    covariance, none, model_names = np.zeros(36), np.zeros(36), ("acceleration", "yaw")
    covariance[35] = yaw
    with Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        kinds = {"odom": "nav_msgs/msg/Odometry", "actions": "sensor_msgs/msg/JointState"}
        on = {key: writer.add_connection(f"/boat/{key}", kind, typestore=store) for key, kind in kinds.items()}
        for t, (north, east, heading, turning), action in zip(log.t, log.motion, log.actions, strict=True):
            ns, half = EPOCH * 10**9 + round(1e9 * t), 0.5 * (0.5 * np.pi - heading)
            told = 0 if stamp is None else ns + round(1e9 * stamp)
            headers = [make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", *divmod(x, 10**9)), frame)
                       for x in (ns, told)]  # fmt: skip
            turn = make("geometry_msgs/msg/Quaternion", *(quaternion or (0.0, 0.0, np.sin(half), np.cos(half))))
            spin = make("geometry_msgs/msg/Vector3", 0.0, 0.0, -turning if rate is None else rate)
            pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", east, north, 0.0), turn)
            twist = make("geometry_msgs/msg/Twist", make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0), spin)
            messages = {
                "odom": make(kinds["odom"], headers[0], child,
                             make("geometry_msgs/msg/PoseWithCovariance", pose, covariance),
                             make("geometry_msgs/msg/TwistWithCovariance", twist, none)),
                "actions": make(kinds["actions"], headers[1], list(model_names), action, np.zeros(0), np.zeros(0)),
            }  # fmt: skip
            for key, message in messages.items():
                writer.write(on[key], ns, store.serialize_cdr(message, kinds[key]))
    return folder


def test_a_stamp_of_0_is_no_time(thin, model, tmp_path):
    """Commands hold from when they were recorded, as where they are stamped."""
    found = read_log(bag(tmp_path / "zero", thin, stamp=None), model)
    np.testing.assert_array_equal(found.actions, thin.actions)
    with pytest.raises(LogError, match="of two clocks"):
        read_log(bag(tmp_path / "clocks", thin, stamp=5.0 - EPOCH), model)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"quaternion": (0.0, 0.0, 0.0, 1.0)}, "no orientation"),
        ({"quaternion": (0.0, 0.0, 0.0, 0.0)}, "no orientation: its quaternion is 0"),
        ({"quaternion": (1.0, 0.0, 0.0, 0.0)}, "no orientation .or w first"),
        ({"quaternion": (0.0, 0.0, 0.7, 0.9)}, "no orientation: its quaternion has the length 1.14"),
        ({"yaw": -1.0}, "no orientation: its yaw has the variance -1"),
        ({"yaw": 1e6}, "no orientation: its yaw has the variance 1e.06"),
        ({"rate": 0.0}, "no yaw rate"),
        ({"frame": "map_ned"}, "frame 'map_ned': wanted are east-north-up"),
        ({"child": "boat/base_link_frd"}, "frame 'boat/base_link_frd'"),
    ],
)
def test_what_odometry_lacks_is_not_made_up(wrong, told, thin, model, tmp_path):
    with pytest.raises(LogError, match=told):
        read_log(bag(tmp_path / "bag", thin, **wrong), model)


def test_the_primary_lane_is_read_where_it_has_a_position(log, model, tmp_path):
    """Lane 1 lies 50 m north of lane 0 in every log of `_dataflash`. PI names lane 1 from sample 100 on; from 200
    on its position is held (constant position mode).
    """
    number = 140
    FORMATS["XKF4"] = (number, "QBIb", "TimeUS,C,SS,PI")
    try:
        file = _dataflash(tmp_path / "lanes.bin", log)
        states = [_record("XKF4", 5_000_000 + 100_000 * k, lane, 831 + 128 * (k >= 200), int(k >= 100))
                  for k in range(len(log.t)) for lane in (0, 1)]  # fmt: skip
        file.write_bytes(file.read_bytes() + b"".join(states))
        found = read_log(file, model)
        assert [(p.start, p.stop) for p in found.parts] == [(0, 100), (100, 200)]
        np.testing.assert_allclose(found.motion[:, 0], log.motion[:200, 0] + 50.0 * (np.arange(200) >= 100), atol=1e-4)
    finally:
        del FORMATS["XKF4"]
    file = _dataflash(tmp_path / "primary.bin", log, parameters={"EK3_PRIMARY": 1})
    found = read_log(file, model, Source(channels="helm=1,ahead=3"))
    np.testing.assert_allclose(found.motion[:, 0], log.motion[:, 0] + 50.0, atol=1e-4)  # without XKF4
    with pytest.warns(UserWarning, match="cut: its last 15 bytes"):
        file.write_bytes(file.read_bytes()[:-24])  # of a record of 39 bytes
        read_log(file, model, Source(channels="helm=1,ahead=3"))


def test_a_trim_that_was_changed_on_the_way_is_told(log, model, tmp_path):
    file = _dataflash(tmp_path / "log.bin", log)
    file.write_bytes(file.read_bytes() + _record("PARM", 9_000_000, "SERVO1_TRIM", 1500, 1500))
    read_log(file, model)
    file.write_bytes(file.read_bytes() + _record("PARM", 9_100_000, "SERVO1_TRIM", 1480, 1500))
    with pytest.raises(LogError, match=r"SERVO1_TRIM was changed in this log \(1500, 1480\)"):
        read_log(file, model)


@pytest.mark.parametrize(
    ("name", "way"),
    [("a.bag", "rosbags-convert"), ("a.ulg", "ulog2csv"), ("a.LOG", "take the .bin"), ("a.mat", "a CSV")],
)
def test_a_log_of_another_kind_is_told_by_its_name(name, way, model, tmp_path):
    (tmp_path / name).write_bytes(b"\x00\xff")
    with pytest.raises(LogError, match=way):
        read_log(tmp_path / name, model)


def test_of_a_steady_course_the_right_cause_is_told(log, model, tmp_path):
    """A boat that goes south in bends, whose heading is counted from east: no degrees."""
    straight = log._replace(motion=log.motion.copy())
    psi = np.radians(200.0) + 0.7 * np.sin(0.5 * log.t)
    straight.motion[:, 2], straight.motion[:, 3] = 0.5 * np.pi - psi, -0.35 * np.cos(0.5 * log.t)
    for column, way in ((0, np.cos(psi)), (1, np.sin(psi))):
        straight.motion[:, column] = np.cumsum(way) * 0.1 * 1.5
    with pytest.raises(LogError, match="the course turns against the heading"):
        read_log(table(tmp_path / "enu.csv", straight), model)


def table(file, log, *, separator=",", change=None, times=None, names=None):
    """A CSV of the log; `change` turns a row's dictionary of texts into another."""
    header = names or ["t", "north", "east", "heading", "yaw_rate", "acceleration", "yaw"]
    lines = []
    for k, (t, motion, actions) in enumerate(zip(log.t, log.motion, log.actions, strict=True)):
        row = dict(zip(header, [times(k, t) if times else repr(float(t)), *map(repr, map(float, [*motion, *actions]))],
                       strict=True))  # fmt: skip
        lines.append((change or (lambda k, row: row))(k, row))
    with file.open("w", newline="") as out:
        csv.writer(out, delimiter=separator).writerows([header, *(row.values() for row in lines)])
    return file


def test_a_table_of_other_habits_is_the_same_log(log, model, tmp_path):
    """Semicolons and decimal commas, a byte order mark, dates with and without an offset, units in the header."""

    def with_commas(k, row):
        return {name: text.replace(".", ",") for name, text in row.items()}

    comma = table(tmp_path / "comma.csv", log, separator=";", change=with_commas)
    comma.write_bytes(b"\xef\xbb\xbf" + comma.read_bytes())
    dates = table(tmp_path / "dates.csv", log, times=lambda k, t: f"2024-10-27T0{k % 2}:59:{t:06.3f}+0{k % 2}:00")
    names = ["t [min]", "north [km]", "east (m)", "heading [deg]", "yaw_rate (deg/s)", "acceleration", "yaw"]
    factors = dict(zip(names, (1 / 60, 1e-3, 1.0, 180 / np.pi, 180 / np.pi, 1.0, 1.0), strict=True))
    units = table(tmp_path / "units.csv", log, names=names, times=lambda k, t: repr(float(t)),
                  change=lambda k, r: {n: repr(float(x) * factors[n]) for n, x in r.items()})  # fmt: skip
    for file in (comma, dates, units):
        found = read_log(file, model)
        np.testing.assert_allclose(found.t - found.t[0], log.t, atol=1e-6)
        np.testing.assert_allclose(found.motion, log.motion, atol=1e-9)
        np.testing.assert_array_equal(found.actions, log.actions)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("north", "-9999", "line 12: north = -9999 marks a missing value"),
        ("heading", "999", "line 12: heading = 999 marks a missing value"),
        ("yaw_rate", "9.96921e36", "yaw_rate = 9.96921e.36 is no value"),
        ("east", "1_0", "line 12: east is not a number: '1_0'"),
        ("yaw", "0.1,0.2", "line 12: yaw is not a number"),
        ("t", "1.1e13", "line 12: t = 1.1e13: no time in s"),
    ],
)
def test_marks_of_missing_values_are_refused_by_their_line(name, value, told, log, model, tmp_path):
    def change(k, row):
        return row | {name: value} if k == 10 else row

    with pytest.raises(LogError, match=told):
        read_log(table(tmp_path / "bad.csv", log, change=change), model)


def test_a_heading_that_nobody_measured_is_told(log, model, tmp_path):
    for name, told in (("heading", "no heading"), ("yaw_rate", "no yaw rate")):
        with pytest.raises(LogError, match=told):
            read_log(table(tmp_path / "bad.csv", log, change=lambda k, row, name=name: row | {name: "0.0"}), model)


def test_a_wind_that_none_has_is_told(log, model, tmp_path):
    for wind, told in (
        ("99,120", "wind_speed = 99 marks"),
        ("61,120", "allowed are 0 to 60"),
        ("5,400", "line 2: wind_from is 400 degrees"),
    ):
        file = table(tmp_path / "wind.csv", log)
        lines = file.read_text().splitlines()
        file.write_text("\n".join([f"{lines[0]},wind_speed,wind_from_deg", f"{lines[1]},{wind}",
                                   *(f"{line},5,120" for line in lines[2:])]) + "\n")  # fmt: skip
        with pytest.raises(LogError, match=told):
            read_log(file, model)


def test_an_output_without_pulses_is_no_command(log, model, tmp_path):
    """Output 2 of `_dataflash` has a width of 0 all the time."""
    file = _dataflash(tmp_path / "log.bin", log, parameters={"SERVO2_FUNCTION": 26, "SERVO3_FUNCTION": 70})
    with pytest.raises(LogError, match="RCOU.C2 is 0 all the time: output 2 of helm gives no pulses"):
        read_log(file, model)
