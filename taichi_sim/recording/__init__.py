"""State to rerun: an `Episode` in the world frame n (north-east-down) becomes one `.rrd` file.

episode.py      what an episode holds, with shape, unit and frame of each array
overlays.py     what a mission may draw and plot beside the vehicles; draw_overlays.py draws it
recorder.py     keeps the frames of a world, with or without a mission
model.py        what a vehicle model may say of itself: its medium, its hull, its loads, its instruments
meshes.py       a boat, in the body frame b (forward-right-down)
aircraft.py     airplanes and flying wings; vessel.py: a body made of a hull's own panels
bodies.py       which of these bodies a team has
sea_grid.py     points of the piece of sea around a team; sea_patch.py: its waves; sea_light.py: its colours
water_lines.py  what lies on it: rings and wakes
space.py        what stands in the world; vehicles.py: the teams in it; arrows.py: loads, current, wind and air
draw.py         all of these, of an episode or of its next part; stream.py: what goes on from part to part
rrd.py          the writer of files; live.py: views of what goes on; frames.py: the only place where NED becomes ENU
blueprint.py    what the viewer shows when it opens the file
"""

from taichi_sim.recording.episode import Airframe, Body, Episode, Event, Force, Medium, Scene, Signal, TeamTrack
from taichi_sim.recording.recorder import Recorder
from taichi_sim.recording.rrd import write_recording

__all__ = [
    "Airframe",
    "Body",
    "Episode",
    "Event",
    "Force",
    "Medium",
    "Recorder",
    "Scene",
    "Signal",
    "TeamTrack",
    "write_recording",
]
