"""State to rerun: an `Episode` in the world frame n (north-east-down) becomes one `.rrd` file.

episode.py    what an episode holds, with shape, unit and frame of each array
meshes.py     boat and airplane bodies, in the body frame b (forward-right-down)
sea_patch.py  the piece of sea around the formation, with its light
rrd.py        the writer; the only place where NED becomes ENU
blueprint.py  what the viewer shows when it opens the file
"""

from taichi_sim.recording.episode import Episode, Event, Scene, TeamTrack
from taichi_sim.recording.rrd import write_recording

__all__ = ["Episode", "Event", "Scene", "TeamTrack", "write_recording"]
