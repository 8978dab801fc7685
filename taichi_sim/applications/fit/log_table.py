"""What a log is read into, and what its readers share: errors, columns and the clock to which commands are held."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.config.columns import Check, judge

Array = NDArray[np.float64]
CLOCK = 1e-6  # s, to which clocks are compared
GAP = 3.5  # interval over the usual one, from which a gap divides the log into two parts
CHANNELS = ("north", "east", "heading", "yaw_rate")
NORTH, EAST, HEADING, YAW_RATE = range(4)  # columns of a motion


class LogError(ConfigError):
    """A log that cannot be used; the message says where and why."""


class Column(NamedTuple):
    """Source of a column, and the factor that converts its values."""

    source: str  # header of a CSV, topic of a bag
    factor: float = 1.0


@dataclass(frozen=True)
class Source:
    """How logs are to be read."""

    columns: Mapping[str, Column] = field(default_factory=dict)  # name of a column -> where it is
    name: str = ""  # vehicle of a bag; "": the only one
    channels: str = ""  # servo channels of a .bin, NAME=CHANNEL,...; "": by the log's own parameters


class Table(NamedTuple):
    """Content of a log in SI units, not yet checked."""

    columns: dict[str, Array]  # t, CHANNELS, the actions, and WIND if it was measured; all of one length
    place: Callable[[int], str]  # number of a sample -> where it is in the file
    breaks: Array = np.empty(0)  # times at which the source of a column changes: a new part begins, s

    def judge(self, *checks: Check) -> None:
        """Refuse the first sample of which one of the `checks` holds."""
        judge(LogError, self.place, *checks)


def held(t: Array, values: Array, at: Array) -> Array:
    """Values [sample, ..] that hold at the times `at`: each from its own time `t` on."""
    return values[np.clip(np.searchsorted(t, at + CLOCK, side="right") - 1, 0, len(t) - 1)]


def held_means(t: Array, values: Array, begin: Array, end: Array) -> Array:
    """Means from `begin` to `end` of values [sample] that hold from their own times `t` on."""
    inside = np.searchsorted(t, begin + CLOCK, side="right") < np.searchsorted(t, end - CLOCK)
    nodes = np.r_[t, max(t[-1], end.max()) + 1.0]
    sums = np.r_[0.0, np.cumsum(np.diff(nodes) * values)]
    mean = (np.interp(end, nodes, sums) - np.interp(begin, nodes, sums)) / (end - begin)
    return np.where(inside, mean, held(t, values, begin))


def drawn_means(t: Array, values: Array, begin: Array, end: Array) -> Array:
    """Means from `begin` to `end` of a signal that was sampled [sample] at the times `t`, by straight lines."""
    nodes = np.union1d(t, np.r_[begin, end])
    drawn = np.interp(nodes, t, values)
    sums = np.r_[0.0, np.cumsum(0.5 * (drawn[1:] + drawn[:-1]) * np.diff(nodes))]
    return (sums[np.searchsorted(nodes, end)] - sums[np.searchsorted(nodes, begin)]) / (end - begin)
