"""An `Episode` as bags of ROS 2 (docs/ros.md): true motion in east-north-up (`map`) and forward-left-up (`base_link`).

messages.py   motion in the frames of ROS (../east_north_up.py); names, types, stamps of topics; messages of each frame
bag.py        the writers, and what they refuse
"""

from taichi_sim.visualisation.recording.east_north_up import FJORD, Origin
from taichi_sim.visualisation.recording.ros.bag import BagError, check_bag, write_mcap, write_rosbag2

__all__ = ["FJORD", "BagError", "Origin", "check_bag", "write_mcap", "write_rosbag2"]
