"""A node of ROS 2 beside another one, over DDS; without rclpy (of a ROS 2, or the wheel ros-rclpy) nothing runs."""

import sys

import numpy as np
import pytest
import torch
from small_missions import make

from rl.runs.folder import RunError
from rl.runs.ros_node import HOLDS, ros_node
from taichi_sim.visualisation.recording.ros.messages import EPOCH_S


def test_without_ros_the_message_says_where_it_is(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(RunError, match="--ros needs a sourced ROS 2, or pip install ros-rclpy .*rclpy"), ros_node():
        pass


def test_another_node_hears_the_boats_and_commands_one_of_them():
    rclpy = pytest.importorskip("rclpy")
    from nav_msgs.msg import Odometry  # pyright: ignore[reportMissingImports]
    from sensor_msgs.msg import JointState  # pyright: ignore[reportMissingImports]

    mission = make("sea.hs=0.3", "usv.count=2")
    team, heard, said = mission.teams["usv"], [], []
    with ros_node(speed=4.0) as ros:
        peer = rclpy.create_node("peer")
        peer.create_subscription(Odometry, "/usv_1/odom", heard.append, 50)
        peer.create_subscription(JointState, "/usv_1/actions", said.append, 50)
        orders = peer.create_publisher(JointState, "/usv_1/command", 10)
        name = team.fleet.model.action_names[0]
        policies = ros.listening(dict.fromkeys(mission.teams, lambda of: torch.zeros_like(of.action)))
        given, taken, place = {10: 0.25, 12: 9.0}, [], []
        for number in range(60):
            if number in given:
                orders.publish(JointState(name=[name], position=[given[number]]))
            step = mission.step(policies, begin=False)
            ros(mission, 0, step, [])
            rclpy.spin_once(peer, timeout_sec=0.0)
            taken.append(team.action[0].clone())
            place.append(team.fleet.position_exact[0, 1].numpy().copy())
        for _ in range(200):
            rclpy.spin_once(peer, timeout_sec=0.01)
        peer.destroy_node()
    obeyed = [number for number, action in enumerate(taken) if action[1, 0] == 0.25]
    assert obeyed and obeyed[0] > 10 and obeyed == list(range(obeyed[0], obeyed[0] + len(obeyed)))
    assert len(obeyed) == pytest.approx(HOLDS / mission.config.decision_interval, abs=1)
    assert not any(action[0].any() or action[1, 1] for action in taken)
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec - EPOCH_S for m in heard]
    assert len(heard) > 40 and np.diff(stamps) == pytest.approx(mission.config.decision_interval)
    for stamp, message in zip(stamps, heard, strict=True):
        north, east, down = place[round(stamp / mission.config.decision_interval) - 1]
        at = message.pose.pose.position
        assert (at.x, at.y, at.z) == pytest.approx((east, north, -down), abs=1e-6)
    assert said and list(said[0].name) == list(team.fleet.model.action_names)
    assert {0.0, 0.25} == {round(m.position[0], 6) for m in said}
