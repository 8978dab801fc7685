"""One rerun stream on two timelines: `sim_time` (s, rounded to whole ns) and `step`."""

from collections.abc import Iterable

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.recording.episode import Array


class Stream:
    """Sends what never changes, and what changes by whole columns."""

    def __init__(self, rec: rr.RecordingStream, time_s: Array) -> None:
        """`time_s` [T] is the clock that the columns' steps refer to."""
        self.rec = rec
        self.ns = np.rint(np.asarray(time_s, dtype=np.float64) * 1e9).astype(np.int64)

    def static(self, path: str, thing: rr.AsComponents) -> None:
        """Log what holds for the whole recording."""
        self.rec.log(path, thing, static=True)

    def columns(self, path: str, columns: Iterable, index: NDArray[np.int64] | None = None) -> None:
        """Send one row for each step in `index`, by default for every step. The arrays must not be reused."""
        index = np.arange(len(self.ns)) if index is None else index
        clock = [
            rr.TimeColumn("sim_time", duration=self.ns[index].astype("timedelta64[ns]")),
            rr.TimeColumn("step", sequence=index),
        ]
        self.rec.send_columns(path, clock, columns)
