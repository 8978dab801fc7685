"""The format of a recording, which follows from its file name."""

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rl.runs.folder import RunError
from taichi_sim.recording import Episode, write_recording
from taichi_sim.recording.ros import FJORD, Origin, check_bag, write_mcap, write_rosbag2

RRD, MCAP = ".rrd", ".mcap"


class Output(NamedTuple):
    """Path and format of a recording."""

    place: Path | None  # None: the default
    write: Callable[[Episode, Path], Path]
    reader: str  # the command that opens it


def output_of(out: str | None, origin: Sequence[float] | None = None, *, show_progress: bool = False) -> Output:
    """The output for `out`: FILE.rrd, FILE.mcap, or a rosbag2 folder, whose name has no suffix or ends with a slash.

    `origin` is the latitude and longitude (deg) of the world's origin in a bag.

    Raises:
        RunError: if the suffix is another one, or `origin` is given without a bag.
        BagError: if `check_bag` refuses the bag.
    """
    place = None if out is None else Path(out)
    folder = out is not None and (out.endswith(("/", os.sep)) or not Path(out).suffix)
    if place is None or (place.suffix == RRD and not folder):
        if origin is not None:
            raise RunError(f"--origin: only a bag has an origin: --out FILE{MCAP} or --out FOLDER/")
        return Output(place, write_recording, "rerun")
    if place.suffix != MCAP and not folder:
        raise RunError(f"--out {out}: allowed are FILE{RRD} (rerun), FILE{MCAP} (ROS 2) and FOLDER/ (rosbag2)")
    at = FJORD if origin is None else Origin(*origin)
    check_bag(place, folder=folder, origin=at)
    write = write_rosbag2 if folder else write_mcap
    return Output(place, partial(write, origin=at, show_progress=show_progress), "ros2 bag play")
