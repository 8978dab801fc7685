"""Recordings: an `Episode` in the world frame n (north-east-down) becomes one `.rrd` file of rerun.

episode.py      the data of an episode, with shape, unit and frame of each array
overlays.py     what a mission may draw and plot besides the vehicles; draw_overlays.py draws it
recorder.py     records the frames of a world, with or without a mission; what it asks a vehicle model
bodies.py       the body of a vehicle: its model's own surface, else a boat, an airplane or a flying wing
sea_patch.py    the sea around a team: its grid, waves and colours
static_scene.py        the static scene; team_view.py: the teams, their rings and wakes; arrows.py: loads, current, wind
and air rrd.py          draws all of these, for an episode or its next part, and writes files
rerun_stream.py       the state between parts; live.py: live views; east_north_up.py: the only place where NED becomes
ENU blueprint.py    layout of the viewer
"""

from taichi_sim.visualisation.recording.episode import (
    Airframe,
    Body,
    Episode,
    Event,
    Force,
    Medium,
    Scene,
    Signal,
    TeamTrack,
)
from taichi_sim.visualisation.recording.recorder import Recorder

__all__ = [
    "Airframe", "Body", "Episode", "Event", "Force", "Medium", "Recorder", "Scene", "Signal", "TeamTrack",
]  # fmt: skip
