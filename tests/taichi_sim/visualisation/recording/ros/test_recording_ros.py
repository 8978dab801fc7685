"""Bags of ROS 2, read back by libraries that did not write them: what is in them, and whether it is physics."""

import resource
import sqlite3
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages
from numpy.typing import NDArray
from recorded import make_episode
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from rl.evaluation.episode_recording import output_of
from rl.runs.folder import RunError
from taichi_sim.visualisation.recording import Episode, Force
from taichi_sim.visualisation.recording.east_north_up import ecef, from_geodetic, geodetic
from taichi_sim.visualisation.recording.ros import FJORD, BagError, Origin, write_mcap, write_rosbag2

EPOCH_NS = 10**18
GRAVITY = 9.81
PLACE = (0.4, 0.3, -0.2)  # m, b, where a force attacks
WRITERS = {"run.mcap": write_mcap, "bag": write_rosbag2}

Read = dict[str, list[tuple[int, Any]]]


def an_episode() -> Episode:
    """Boats and aircraft on a circle of 80 m, 4 m/s, to starboard, heeled by 0.1 rad; boats are pushed."""
    episode = make_episode(2, steps=30)
    usv = episode.teams["usv"]
    push = np.random.default_rng(1).normal(size=usv.position_n.shape)
    forces = {"thrust left": Force(PLACE, push)}
    return replace(episode, teams={**episode.teams, "usv": replace(usv, forces=forces)})


def read(path: Path) -> Read:
    """Stamps and messages by topic, as rosbags has them."""
    found: Read = {}
    with AnyReader([path]) as reader:
        for connection, stamp, data in reader.messages():
            found.setdefault(connection.topic, []).append((stamp, reader.deserialize(data, connection.msgtype)))
    return found


def numbers(messages: list[tuple[int, Any]], of: str, axes: str = "xyz") -> NDArray:
    """[T, len(axes)] of a part of messages."""

    def part(message: Any) -> Any:
        for name in of.split("."):
            message = getattr(message, name)
        return message

    return np.array([[getattr(part(message), axis) for axis in axes] for _, message in messages])


def matrices(xyzw: NDArray) -> NDArray:
    """Rotations [T, 3, 3] of quaternions."""
    x, y, z, w = xyzw.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), -1, 0)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Episode, dict[str, Path]]:
    folder, episode = tmp_path_factory.mktemp("bags"), an_episode()
    return episode, {name: write(episode, folder / name) for name, write in WRITERS.items()}


@pytest.fixture(scope="module")
def bag(written) -> Read:
    return read(written[1]["run.mcap"])


@pytest.mark.parametrize("name", WRITERS)
def test_rosbags_reads_the_poses_of_the_recording(written, name) -> None:
    episode, paths = written
    found = read(paths[name])
    swap, flip = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), np.diag([1, -1, -1])
    for team in episode.teams.values():
        for vehicle in range(2):
            odometry = found[f"/{team.name}_{vehicle}/odom"]
            assert [stamp - EPOCH_NS for stamp, _ in odometry] == [100_000_000 * step for step in range(30)]
            times = [(message.header.stamp.sec, message.header.stamp.nanosec) for _, message in odometry]
            assert times == [divmod(stamp, 10**9) for stamp, _ in odometry]
            north, east, down = team.position_n[:, vehicle].T
            place = numbers(odometry, "pose.pose.position")
            np.testing.assert_allclose(place, np.stack([east, north, -down], -1), atol=1e-9)
            turn = numbers(odometry, "pose.pose.orientation", "xyzw")
            expected = swap @ matrices(team.quaternion_nb[:, vehicle][:, [1, 2, 3, 0]]) @ flip
            np.testing.assert_allclose(matrices(turn), expected, atol=1e-9)
            frames = {(message.header.frame_id, message.child_frame_id) for _, message in odometry}
            assert frames == {("map", f"{team.name}_{vehicle}/base_link")}


def test_both_bags_hold_the_same_bytes_and_foxglove_reads_them_alike(written, bag) -> None:
    """What rosbags encodes Foxglove's decoder understands, and what Foxglove's writer files rosbags finds."""
    _, paths = written
    with sqlite3.connect(paths["bag"] / "bag.db3") as storage:
        query = "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY messages.id"
        rows = list(storage.execute(query))
    with paths["run.mcap"].open("rb") as stream:
        every = make_reader(stream).iter_messages()
        filed = [(channel.topic, message.log_time, message.data) for _, channel, message in every]
    assert sorted(filed) == sorted(rows) and len(rows) == sum(map(len, bag.values()))
    seen = dict.fromkeys(bag, 0)
    for message in read_ros2_messages(str(paths["run.mcap"])):
        topic = message.channel.topic
        stamp, ours = bag[topic][seen[topic]]
        seen[topic] += 1
        assert message.log_time_ns == stamp
        if topic.endswith(("odom", "imu", "fix")):
            assert message.ros_msg.header.frame_id == ours.header.frame_id
        if topic.endswith("odom"):
            for a, b in ((message.ros_msg.pose.pose.orientation, ours.pose.pose.orientation),
                         (message.ros_msg.twist.twist.linear, ours.twist.twist.linear)):  # fmt: skip
                assert (a.x, a.y, a.z) == (b.x, b.y, b.z)
        if topic.endswith("fix"):
            assert (message.ros_msg.latitude, message.ros_msg.altitude) == (ours.latitude, ours.altitude)
    assert seen == {topic: len(messages) for topic, messages in bag.items()}


def test_velocities_and_rates_are_those_of_the_motion(bag) -> None:
    """Turned into the map, the twist is how the place changes; and a turn to starboard is one about minus up."""
    for name in ("usv_0", "uav_1"):
        odometry = bag[f"/{name}/odom"]
        turn = matrices(numbers(odometry, "pose.pose.orientation", "xyzw"))
        place, twist = numbers(odometry, "pose.pose.position"), numbers(odometry, "twist.twist.linear")
        moved = np.gradient(place, 0.1, axis=0)
        np.testing.assert_allclose(np.einsum("tij,tj->ti", turn, twist)[1:-1], moved[1:-1], atol=1e-3)
        np.testing.assert_allclose(twist[1:-1], [[4.0, 0.0, 0.0]] * 28, atol=1e-3)
        rates = numbers(odometry, "twist.twist.angular")
        np.testing.assert_allclose(rates[2:-2], [[0.0, -0.05 * np.sin(0.1), -0.05 * np.cos(0.1)]] * 26, atol=1e-5)


def test_the_imu_feels_weight_and_the_turn(bag) -> None:
    """In the world: 9.81 upwards, and v^2 / r = 0.2 m/s^2 to the middle of the circle."""
    imu = bag["/usv_0/imu"]
    turn = matrices(numbers(imu, "orientation", "xyzw"))
    felt = np.einsum("tij,tj->ti", turn, numbers(imu, "linear_acceleration"))[2:-2]
    np.testing.assert_allclose(felt[:, 2], GRAVITY, atol=1e-6)
    middle = (-0.25, 0.5)  # of the circle, east and north: boats are off their slots by as much
    inward = middle - numbers(bag["/usv_0/odom"], "pose.pose.position")[2:-2, :2]
    np.testing.assert_allclose(felt[:, :2], 0.2 * inward / 80.0, atol=1e-4)


def test_a_level_vehicle_at_rest_that_points_north_is_turned_by_90_degrees_and_feels_weight_alone(tmp_path) -> None:
    episode = make_episode(1, ("usv",), steps=3, dt=1.001)  # s: in ns less than a whole number
    usv, still = episode.teams["usv"], np.zeros((3, 1, 3))
    level = np.zeros((3, 1, 4)) + (1.0, 0.0, 0.0, 0.0)
    rates = still + (0.1, 0.2, 0.3)
    usv = replace(usv, position_n=still, velocity_n=still, quaternion_nb=level, angular_velocity_b=rates)
    found = read(write_mcap(replace(episode, teams={"usv": usv}, events=()), tmp_path / "rest.mcap"))
    half = np.radians(90) / 2
    turn = numbers(found["/usv_0/odom"], "pose.pose.orientation", "xyzw")
    np.testing.assert_allclose(turn, [[0.0, 0.0, np.sin(half), np.cos(half)]] * 3, atol=1e-12)
    np.testing.assert_allclose(numbers(found["/usv_0/imu"], "linear_acceleration"), [[0, 0, GRAVITY]] * 3, atol=1e-12)
    np.testing.assert_allclose(numbers(found["/usv_0/imu"], "angular_velocity"), [[0.1, -0.2, -0.3]] * 3, atol=1e-12)
    assert [message.clock.nanosec for _, message in found["/clock"]] == [0, 1_000_000, 2_000_000]
    for _, message in found["/usv_0/fix"]:
        assert (message.latitude, message.longitude, message.altitude) == pytest.approx((*FJORD, 0.0), abs=1e-9)


def test_transforms_forces_and_slots_stand_where_the_recording_has_them(written, bag) -> None:
    episode, paths = written
    bodies = {one.child_frame_id: one for one in bag["/tf"][7][1].transforms}
    assert set(bodies) == {f"{team}_{vehicle}/base_link" for team in ("usv", "uav") for vehicle in range(2)}
    moved, pose = bodies["uav_1/base_link"].transform, bag["/uav_1/odom"][7][1].pose.pose
    assert (moved.translation.x, moved.rotation.w) == (pose.position.x, pose.orientation.w)
    fixed = {one.child_frame_id: one for one in bag["/tf_static"][0][1].transforms}
    arrow = fixed["usv_1/wrench/thrust_left"]
    assert arrow.header.frame_id == "usv_1/base_link"
    assert [getattr(arrow.transform.translation, axis) for axis in "xyz"] == [PLACE[0], -PLACE[1], -PLACE[2]]
    pushed = bag["/usv_1/wrench/thrust_left"]
    force = episode.teams["usv"].forces["thrust left"].vector_b[:, 1]
    np.testing.assert_array_equal(numbers(pushed, "wrench.force"), force * (1, -1, -1))
    assert {message.header.frame_id for _, message in pushed} == {"usv_1/wrench/thrust_left"}
    taken = bag["/usv_1/actions"]  # a frame has the action that led to it, a message the one that follows
    np.testing.assert_array_equal([one.position for _, one in taken], episode.teams["usv"].action[1:, 1])
    assert taken[0][1].name == list(episode.teams["usv"].action_names)
    slots = numbers(bag["/usv_1/slot"], "pose.position")
    np.testing.assert_array_equal(slots[:, :2], episode.teams["usv"].slot_n[:, 1, 1::-1])
    ahead = matrices(numbers(bag["/usv/target"], "pose.orientation", "xyzw"))[:, :2, 0]
    course = episode.teams["usv"].target_course
    np.testing.assert_allclose(ahead, np.stack([np.sin(course), np.cos(course)], -1), atol=1e-12)
    assert [message.clock.nanosec for _, message in bag["/clock"]][:3] == [0, 10**8, 2 * 10**8]
    for path in paths.values():
        with AnyReader([path]) as reader:
            kept = {c.topic: c.ext.offered_qos_profiles[0].durability for c in reader.connections}
        assert kept["/tf_static"] is QosDurability.TRANSIENT_LOCAL and kept["/tf"] is QosDurability.VOLATILE


@pytest.mark.parametrize("origin", [FJORD, Origin(-33.8, 151.2), Origin(0.0, -180.0), Origin(89.0, 5.0)])
def test_a_fix_leads_back_to_the_place(origin) -> None:
    """Geodetic to Earth-centred coordinates is a closed form: from the origin it is as far there as in the map."""
    places = np.random.default_rng(2).uniform(-5e3, 5e3, (50, 3))
    latitude, longitude, height = geodetic(places, origin).T
    centre = np.radians(origin)
    back = ecef(np.radians(latitude), np.radians(longitude), height) - ecef(centre[0], centre[1], 0.0)
    (sin, sin_l), (cos, cos_l) = np.sin(centre), np.cos(centre)
    east, up = np.array([-sin_l, cos_l, 0.0]), np.array([cos * cos_l, cos * sin_l, sin])
    np.testing.assert_allclose(back @ np.stack([east, np.cross(up, east), up], -1), places, atol=1e-6)
    np.testing.assert_allclose(from_geodetic(geodetic(places, origin), origin), places, atol=1e-6)


def test_a_degree_is_as_long_as_on_wgs_84() -> None:
    """At 45 degrees north: 111 131.7 m of latitude, 78 846.8 m of longitude (NGA, Standard WGS 84, tables)."""
    (north, _, up), (_, east, _) = geodetic(np.array([[0.0, 100.0, 0.0], [100.0, 0.0, 0.0]]), Origin(45.0, 10.0))
    assert (north - 45.0) * 111_131.7 == pytest.approx(100.0, rel=1e-4)
    assert (east - 10.0) * 78_846.8 == pytest.approx(100.0, rel=1e-4)
    assert up == pytest.approx(100.0**2 / (2 * 6.37e6), rel=0.01)  # the plane leaves the round Earth


def test_what_cannot_be_written_is_refused_before_the_episode(tmp_path, monkeypatch) -> None:
    taken = tmp_path / "taken"
    taken.mkdir()
    assert output_of(f"{taken}/").place == taken  # nothing in it
    (taken / "metadata.yaml").touch()
    for out, error, words in (
        (tmp_path / "run.bag", RunError, "allowed are FILE.rrd"),
        (tmp_path / "no" / "run.mcap", BagError, "there is no folder"),
        (taken, BagError, "exists already"),
        (f"{tmp_path}/run.bag/x.db3", RunError, "allowed are"),
    ):
        with pytest.raises(error, match=words):
            output_of(str(out))
    assert output_of(f"{tmp_path}/run.bag/").reader == "ros2 bag play"  # a folder, by its slash
    assert output_of(str(tmp_path / "run.rrd")).reader == output_of(None).reader == "rerun"
    with pytest.raises(RunError, match="only a bag"):
        output_of(str(tmp_path / "run.rrd"), (60.0, 10.0))
    for origin in ((91.0, 0.0), (0.0, 181.0), (float("nan"), 0.0)):
        with pytest.raises(BagError, match="latitude"):
            output_of(str(tmp_path / "run.mcap"), origin)
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(BagError, match=r"taichi-sim\[ros\]"):
        output_of(str(tmp_path / "run.mcap"))


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_what_was_there(name, tmp_path) -> None:
    (tmp_path / "run.mcap").write_text("old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(OSError, match="bag not written") as raised:
            WRITERS[name](make_episode(1, steps=100), tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert raised.value.filename == str(tmp_path / name)
    assert [file.name for file in tmp_path.iterdir()] == ["run.mcap"]
    assert (tmp_path / "run.mcap").read_text() == "old"
