"""One rerun stream on two timelines: `sim_time` (s, rounded to whole ns) and `step`.

An episode may come in parts, each with its own clock; drawing continues from part to part with the state in `memory`. A
file has one part, a live view many.
"""

from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from taichi_sim.visualisation.recording.episode import Array


class RecordingStream(Protocol):
    """The methods of rr.RecordingStream that draw an episode."""

    def log(self, path: str, thing: rr.AsComponents, /, *, static: bool = False) -> None:
        """Log `thing` at `path`."""

    def send_columns(self, path: str, clock: Iterable[rr.TimeColumn], columns: Iterable, /) -> None:
        """Send one row of `columns` for each time of `clock` to `path`."""


def root_of(caption: str) -> str:
    """The beginning of the paths of an episode with a caption; a single episode has none."""
    return f"{caption}/" if caption else ""


class Stream:
    """Sends static data, and data that change as whole columns."""

    def __init__(self, rec: RecordingStream, *, first: int = 0, caption: str = "", faint: bool = False) -> None:
        """Begin an episode on `rec`, an rr.RecordingStream or a replacement for it.

        Its steps count from `first`. Of several episodes, each has a `caption`, the root of its paths; the plots of one
        beside the main one are `faint`.
        """
        self.rec, self.first, self.after_s = rec, first, 0.0  # first: number of the part's first step
        self.caption, self.root, self.faint = caption, root_of(caption), faint
        self.ns = np.zeros(0, dtype=np.int64)  # [T] clock of the part, ns
        self.memory: dict[str, Any] = {}  # state of drawing between parts
        self.begins = True  # this is the first part
        self._said: set[str] = set()

    def part(self, time_s: Array) -> None:
        """Begin the next part, whose steps are at `time_s` [T] (s since the start of the episode)."""
        self.begins = not len(self.ns)
        self.first += len(self.ns)
        self.ns = np.rint((np.asarray(time_s, dtype=np.float64) + self.after_s) * 1e9).astype(np.int64)

    def has(self, path: str) -> bool:
        """Whether static data were sent to `path`."""
        return path in self._said

    def static(self, path: str, thing: rr.AsComponents) -> None:
        """Log static data for the whole recording; further calls for the same path do nothing."""
        if path not in self._said:
            self._said.add(path)
            self.rec.log(self.root + path, thing, static=True)

    def columns(self, path: str, columns: Iterable, index: NDArray[np.int64] | None = None) -> None:
        """Send one row for each step of the part in `index` (default: all). The caller must not reuse the arrays."""
        index = np.arange(len(self.ns)) if index is None else index
        if not len(index):
            return
        clock = [
            rr.TimeColumn("sim_time", duration=self.ns[index].astype("timedelta64[ns]")),
            rr.TimeColumn("step", sequence=self.first + index),
        ]
        self.rec.send_columns(self.root + path, clock, columns)

    def before(self, key: str, rows: Array) -> Array:
        """The last row of the previous part, or the first of `rows` [T, ...] without one; store the last of `rows`."""
        last = self.memory.get(key, rows[0])
        self.memory[key] = rows[-1]
        return last
