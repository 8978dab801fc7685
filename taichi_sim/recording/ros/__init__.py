"""An `Episode` to bags of ROS 2 (docs/ros.md): truth in east-north-up (`map`) and forward-left-up (`base_link`).

geodesy.py    places as latitude, longitude and height; motion.py: a team's motion in ROS's frames (../frames.py)
topics.py     names, types and stamps; build.py: parts of messages; messages.py: what is sent in each frame
bag.py        the writers, and what they refuse
"""

from taichi_sim.recording.ros.bag import BagError, check_bag, write_mcap, write_rosbag2
from taichi_sim.recording.ros.geodesy import FJORD, Origin

__all__ = ["FJORD", "BagError", "Origin", "check_bag", "write_mcap", "write_rosbag2"]
