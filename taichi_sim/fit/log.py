"""Logs of a vessel's motion: CSV with named columns, checked for common mistakes.

Columns: t (s); north, east (m); heading (rad, clockwise from north) or heading_deg; yaw_rate (rad/s, bow to starboard)
or yaw_rate_deg; each action of the vehicle by its name, -1 to 1, as commanded from that time on. Other columns are
ignored.
"""

import csv
import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.config import ConfigError
from taichi_sim.vehicle import Vehicle

Array = NDArray[np.float64]
GAP = 3.5  # interval over the usual one, from which a gap divides the log into two parts
FASTEST, SLOWEST = 1e-3, 2.0  # s, intervals between samples
SMALL, LARGE = 1 / 40, 40.0  # ratios of two rates that should agree, beyond which one of them is in degrees
COURSE_OVER = 2.0  # s, time over which a course is computed
MOVES = 0.3  # m/s, least speed for comparing a course with a heading
ENOUGH = 20  # least number of samples for comparing a course with a heading
# Two angles agree if the mean direction of their difference has the length CLEAR, and CLEARER more than another pair.
CLEAR, CLEARER = 0.8, 0.3
ASIDE = np.radians([50.0, 130.0])  # angles from heading to course that no current or turn keeps up over a whole log


class LogError(ConfigError):
    """A log that cannot be used; the message says where and why."""


class Log(NamedTuple):
    """One log, evenly sampled."""

    name: str
    t: Array  # s
    motion: Array  # [sample, 4]: north, east (m), heading (rad, unwrapped), yaw rate (rad/s)
    actions: Array  # [sample, action], held from each sample on
    parts: tuple[slice, ...]  # ranges without gaps
    digest: str  # sha256 of the file

    @property
    def interval(self) -> float:
        """Interval between samples, s."""
        return float(np.median(np.diff(self.t)))


CHANNELS = ("north", "east", "heading", "yaw_rate")


def read_log(file: Path, model: Vehicle) -> Log:
    """Read a log for `model`.

    Raises:
        LogError: for a file that is not a log, NaN, decreasing times, angles in degrees, other frames, or actions out
            of range.
    """
    try:
        raw = file.read_bytes()
        rows = list(csv.reader(raw.decode("utf-8").splitlines()))
    except UnicodeDecodeError:
        raise LogError(f"{file}: this is no text; a CSV with named columns is wanted (docs/fit.md)") from None
    if len(rows) < 3:
        raise LogError(f"{file}: a header and at least two rows are wanted, there are {len(rows)} lines")
    header = [name.strip() for name in rows[0]]
    columns: dict[str, Array] = {}
    for name in ("t", *CHANNELS, *model.action_names):
        columns[name] = _column(file, header, rows, name)
    t = columns.pop("t")
    steps = np.diff(t)
    if (steps <= 0).any():
        k = int(np.flatnonzero(steps <= 0)[0])
        raise LogError(f"{file}: line {k + 3}: time goes from {t[k]:g} to {t[k + 1]:g} s: it must increase")
    usual = float(np.median(steps))
    if not FASTEST <= usual <= SLOWEST:
        raise LogError(f"{file}: samples are {usual:g} s apart: is t in other units than s? Allowed are {FASTEST:g} to "
                       f"{SLOWEST:g} s")  # fmt: skip
    motion = np.stack([columns[name] for name in CHANNELS], axis=1)
    breaks = [0, *(np.flatnonzero(steps > GAP * usual) + 1), len(t)]
    parts = tuple(slice(int(a), int(b)) for a, b in zip(breaks[:-1], breaks[1:], strict=True))
    actions = np.stack([columns[name] for name in model.action_names], axis=1)
    for k, name in enumerate(model.action_names):
        worst = float(np.abs(actions[:, k]).max())
        if worst > 1 + 1e-6:
            raise LogError(f"{file}: {name} goes to {worst:g}: actions are from -1 to 1")
    _check_angles(file, t, motion, parts)
    motion[:, 2] = np.unwrap(motion[:, 2])
    _check_rates(file, t, motion, parts)
    return Log(file.name, t, motion, actions, parts, hashlib.sha256(raw).hexdigest())


def _column(file: Path, header: list[str], rows: list[list[str]], name: str) -> Array:
    degrees = f"{name}_deg" if name in ("heading", "yaw_rate") else None
    found = name if name in header else degrees
    if found not in header:
        also = f" or {degrees}" if degrees else ""
        raise LogError(f"{file}: no column {name}{also}; it has {', '.join(header)}")
    place = header.index(found)
    values = np.empty(len(rows) - 1)
    for k, row in enumerate(rows[1:]):
        try:
            values[k] = float(row[place])
        except (ValueError, IndexError):
            raise LogError(f"{file}: line {k + 2}: {found} is not a number") from None
        if not np.isfinite(values[k]):
            raise LogError(f"{file}: line {k + 2}: {found} = {values[k]}: leave out such rows")
    return np.radians(values) if found == degrees else values


def _check_angles(file: Path, t: Array, motion: Array, parts: tuple[slice, ...]) -> None:
    """Compare heading with course over ground, to find degrees and other frames."""
    headings, courses = [np.zeros(0)], [np.zeros(0)]
    for part in parts:
        n, e, psi, _ = motion[part].T
        lag = max(round(COURSE_OVER / float(np.median(np.diff(t)))), 2)
        north, east = n[lag:] - n[:-lag], e[lag:] - e[:-lag]
        fast = np.hypot(north, east) > MOVES * COURSE_OVER
        headings.append(psi[lag // 2 : len(psi) - lag + lag // 2][fast])
        courses.append(np.arctan2(east, north)[fast])
    psi, chi = np.concatenate(headings), np.concatenate(courses)
    if len(psi) < ENOUGH:
        return
    right, in_degrees, enu = (complex(np.mean(np.exp(1j * x))) for x in (chi - psi, chi - np.radians(psi), chi + psi))
    if abs(in_degrees) > max(CLEAR, abs(right) + CLEARER):
        raise LogError(
            f"{file}: heading looks like degrees, by the course over ground: name the column heading_deg (and yaw_rate "
            "yaw_rate_deg, if it is in degrees per second)"
        )
    if abs(enu) > max(CLEAR, abs(right) + CLEARER):
        raise LogError(f"{file}: the course turns against the heading: north and east are exchanged, or the heading is "
                       "counted from east (ENU); wanted is clockwise from north")  # fmt: skip
    aside = float(np.angle(right))
    if abs(right) > CLEAR and ASIDE[0] < abs(aside) < ASIDE[1]:
        side = "starboard" if aside > 0 else "port"
        raise LogError(
            f"{file}: the course over ground lies {np.degrees(abs(aside)):.0f} degrees to {side} of the heading, all "
            "the time: is the heading counted from east (ENU)? Wanted is clockwise from north"
        )


def _check_rates(file: Path, t: Array, motion: Array, parts: tuple[slice, ...]) -> None:
    """Compare the unwrapped heading with the yaw rate, to find degrees and wrong signs."""
    whole = [part for part in parts if part.stop - part.start >= 5]
    turning = np.concatenate([np.zeros(0), *(np.gradient(motion[part, 2], t[part]) for part in whole)])
    r = np.concatenate([np.zeros(0), *(motion[part, 3] for part in whole)])
    if not len(r) or np.sqrt(np.mean(r**2)) < 1e-3:
        return
    slope = float(turning @ r / (r @ r))
    if abs(slope) > LARGE:
        raise LogError(f"{file}: heading changes {slope:.0f} times as fast as yaw_rate says: it looks like degrees "
                       "(name the column heading_deg)")  # fmt: skip
    if 0 < abs(slope) < SMALL:
        raise LogError(f"{file}: yaw_rate is {1 / slope:.0f} times the change of heading: it looks like degrees "
                       "per second (name the column yaw_rate_deg)")  # fmt: skip
    if slope < -0.5:
        raise LogError(f"{file}: heading turns against yaw_rate: one of them counts to port (heading is clockwise "
                       "from north, yaw_rate is bow to starboard)")  # fmt: skip
