"""Logs of a vessel's motion, checked for common mistakes: CSV, bags of ROS 2 (bag.py), ArduPilot's .bin (dataflash.py).

Columns: t (s); north, east (m); heading (rad, clockwise from north) or heading_deg; yaw_rate (rad/s, bow to starboard)
or yaw_rate_deg; each action of the vehicle by its name, -1 to 1, as commanded from that time on; and, where the wind
was measured, wind_speed (m/s) with wind_from or wind_from_deg (where the true wind blows from, clockwise from north).
Other columns are ignored. `Source.columns` says where columns of other names are.
"""

import hashlib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from taichi_sim.applications.fit.bag import read_bag
from taichi_sim.applications.fit.dataflash import read_dataflash
from taichi_sim.applications.fit.log_table import (
    CHANNELS,
    GAP,
    HEADING,
    YAW_RATE,
    Array,
    Column,
    LogError,
    Source,
    Table,
)
from taichi_sim.applications.fit.sample_selection import Mask, inspected
from taichi_sim.config.columns import LATEST, NO_DIRECTION, Sheet, no_directions
from taichi_sim.config.series import FASTEST_WIND
from taichi_sim.errors import reading, refuse
from taichi_sim.vehicle import Vehicle

JITTER = 0.5  # of the usual interval, within which an interval is no gap
FASTEST, SLOWEST = 1e-3, 2.0  # s, intervals between samples
SMALL, LARGE = 1 / 40, 40.0  # ratios of two rates that should agree, beyond which one of them is in degrees
OTHER_KINDS = {  # endings of logs that are not read -> the way out
    ".db3": "name the folder of this bag of ROS 2, with its metadata.yaml",
    ".bag": "convert this bag of ROS 1 by rosbags-convert",
    ".ulg": "convert this log of PX4 to CSV by ulog2csv",
    ".log": "take the .bin of this log, or write a CSV",
    ".tlog": "take the .bin that the vehicle logged",
} | dict.fromkeys((".xlsx", ".xls", ".mat", ".npz", ".npy", ".parquet", ".h5", ".hdf5", ".json"), "write a CSV")
COURSE_OVER = 2.0  # s, time over which a course is computed
MOVES = 0.3  # m/s, least speed for comparing a course with a heading
FAR = 2e7  # half the way round the Earth in m; nothing in a log is larger
TURNS = 0.5  # rad, by which a heading turns that is not noise
ENOUGH = 20  # least number of samples for comparing a course with a heading
# Two angles agree if the mean direction of their difference has the length CLEAR, and CLEARER more than another pair.
CLEAR, CLEARER = 0.8, 0.3
STEADY = 0.95  # the same for courses of a vessel that holds one heading
ASIDE = np.radians([50.0, 130.0])  # angles from heading to course that no current or turn keeps up over a whole log
NO_HEADING = "there is no heading (no orientation) in this log: give one that was measured"
WIND = ("wind_speed", "wind_from")
QUANTITIES = {  # of the columns of a CSV, for their units
    "north": "length", "east": "length", "heading": "radians", "heading_deg": "degrees",
    "yaw_rate": "radians per second", "yaw_rate_deg": "degrees per second",
    "wind_speed": "speed", "wind_from": "radians", "wind_from_deg": "degrees",
}  # fmt: skip
ANGLES = ("heading", "yaw_rate", "wind_from")  # columns that may be in degrees, by the ending _deg


class Log(NamedTuple):
    """One log, evenly sampled."""

    name: str
    t: Array  # s
    motion: Array  # [sample, 4]: north, east (m), heading (rad, unwrapped), yaw rate (rad/s)
    actions: Array  # [sample, action], held from each sample on
    parts: tuple[slice, ...]  # ranges without gaps
    digest: str  # sha256 of the file, or of the files of a folder
    new: Mask  # [sample, 4]: which values of the motion count (sample_selection.py)
    notes: tuple[str, ...] = ()  # repeats and jumps that were found
    wind: Array | None = None  # [sample, 2]: velocity of the air to the north and east, m/s; None: not measured

    @property
    def interval(self) -> float:
        """Interval between samples, s: the mean of those that are not gaps, for a clock of large numbers is coarse."""
        steps = np.diff(self.t)
        usual = float(np.median(steps))
        near = steps[np.abs(steps - usual) <= JITTER * usual]
        return float(np.mean(near)) if near.size else usual


def read_columns(file: Path) -> dict[str, Column]:
    """Where columns are, from a TOML file of lines NAME = "SOURCE" or NAME = ["SOURCE", FACTOR]."""
    with reading(file, LogError):
        lines = tomllib.loads(file.read_text(encoding="utf-8"))
    found = {}
    for name, value in lines.items():
        source, factor = value if isinstance(value, list) and len(value) == 2 else (value, 1.0)
        if not isinstance(source, str) or type(factor) not in (int, float) or factor == 0:
            said = f"{file}: {name} = {value!r}"
            raise LogError(f'{said}: expected "COLUMN" or ["COLUMN", FACTOR], a factor that is not 0')
        found[name] = Column(source, float(factor))
    return found


def read_log(file: Path, model: Vehicle, source: Source | None = None) -> Log:
    """Read a log for `model`; its kind goes by its name: .csv, .bin, or .mcap and folders for bags."""
    source = source or Source()
    way, known = OTHER_KINDS.get(file.suffix.lower()), known_columns(model)
    unknown = min(set(source.columns) - known, default="")
    refuse(
        LogError,
        (not file.exists(), f"{file}: No such file or folder"),
        (way, f"{file}: logs are CSV, .bin of ArduPilot, and bags of ROS 2 (.mcap, folders): {way}"),
        (unknown, f"--columns: {unknown} is no column of a log of this vehicle; it has {', '.join(sorted(known))}"),
    )
    with reading(file, LogError):
        if file.is_dir() or file.suffix.lower() == ".mcap":
            table = read_bag(file, model.action_names, source)
        elif file.suffix.lower() == ".bin":
            table = read_dataflash(file, model, source)
        else:
            table = _read_csv(file, model.action_names, source.columns)
        return _checked(file, table, model.action_names)


def known_columns(model: Vehicle) -> set[str]:
    """Names that columns may have."""
    return {"t", *CHANNELS, *WIND, *(f"{name}_deg" for name in ANGLES), "odom", *model.action_names}


def _checked(file: Path, table: Table, action_names: Sequence[str]) -> Log:
    """The log of a table; LogError as of `read_log`."""
    columns = table.columns
    for name, values in columns.items():
        none = ~(np.abs(values) < (LATEST if name == "t" else FAR))
        table.judge((none, lambda k, name=name: f"{name} = {columns[name][k]:g} is no value: leave out such samples"))
    t = columns["t"]
    steps = np.diff(t)
    back = np.diff(t, prepend=-np.inf) <= 0
    table.judge((back, lambda k: f"time goes from {t[k - 1]:g} to {t[k]:g} s: it must increase"))
    usual, allowed = float(np.median(steps)), f"allowed are {FASTEST:g} to {SLOWEST:g} s"
    far = {name: float(np.abs(columns[name]).max()) for name in action_names if np.abs(columns[name]).max() > 1 + 1e-6}
    action, most = next(iter(far.items()), ("", 0.0))
    refuse(
        LogError,
        (not FASTEST <= usual <= SLOWEST, f"samples are {usual:g} s apart: is t in other units than s? {allowed}"),
        (action, f"{action} goes to {most:g}: actions are from -1 to 1"),
    )
    motion = np.stack([columns[name] for name in CHANNELS], axis=1)
    begin = np.union1d(np.flatnonzero(steps > GAP * usual) + 1, np.searchsorted(t, table.breaks))
    breaks = [0, *begin[(begin > 0) & (begin < len(t))], len(t)]
    parts = tuple(slice(int(a), int(b)) for a, b in zip(breaks[:-1], breaks[1:], strict=True))
    actions = np.stack([columns[name] for name in action_names], axis=1)
    _check_angles(t, motion, parts)
    motion, new, parts, notes = inspected(t, motion, parts)
    _check_rates(t, motion, parts)
    wind = None
    if "wind_speed" in columns:
        speed, origin = columns["wind_speed"], columns["wind_from"]
        table.judge(
            ((speed < 0) | (speed > FASTEST_WIND),
             lambda k: f"wind_speed = {speed[k]:g}: allowed are 0 to {FASTEST_WIND:g} m/s"),
            (no_directions(np.degrees(origin)),
             lambda k: f"wind_from is {np.degrees(origin[k]):g} degrees: {NO_DIRECTION}"),
        )  # fmt: skip
        wind = -speed[:, None] * np.stack((np.cos(origin), np.sin(origin)), axis=1)
    return Log(file.name, t, motion, actions, parts, _digest(file), new, notes, wind)


def _digest(file: Path) -> str:
    """SHA-256 of a file, or of all files of a folder in the order of their names."""
    whole = hashlib.sha256()
    for part in [file] if file.is_file() else sorted(p for p in file.iterdir() if p.is_file()):
        whole.update(part.read_bytes())
    return whole.hexdigest()


def _read_csv(file: Path, action_names: Sequence[str], where: Mapping[str, Column]) -> Table:
    sheet = Sheet(file, LogError)
    has = f"it has {', '.join(sheet.header)}, and {len(sheet.rows)} rows"

    def column(name: str, needed: bool = True) -> Array | None:
        """Values of a column, in rad if it is in degrees; None if it is neither there nor needed."""
        names = (name, f"{name}_deg") if name in ANGLES else (name,)
        place, found, factor, lacking = None, "", 1.0, f"no column {' or '.join(names)}"
        for found in names:
            source, factor = where.get(found, Column(found))
            if (place := sheet.find(source)) is not None:
                break
            if found in where:
                needed, lacking = True, f"no column {source} for {found}"
                break
        if place is None and not needed:
            return None
        refuse(LogError, (place is None, f"{lacking}; {has}"), (len(sheet.rows) < 2, f"two rows are wanted; {has}"))
        assert place is not None
        if name == "t" and factor == 1.0:
            return sheet.times(place)[0]
        values = factor * sheet.numbers(place, QUANTITIES.get(found, "number") if factor == 1.0 else "")
        return np.radians(values) if found.endswith("_deg") else values

    columns = {name: column(name) for name in ("t", *CHANNELS, *action_names)}
    if (speed := column("wind_speed", needed=False)) is not None:
        columns |= {"wind_speed": speed, "wind_from": column("wind_from")}
    return Table({k: v for k, v in columns.items() if v is not None}, lambda k: f"line {sheet.line(k)}")


def _check_angles(t: Array, motion: Array, parts: tuple[slice, ...]) -> None:
    """Compare heading with course over ground, to find one that is not there, degrees and other frames."""
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
    right, in_degrees, in_radians, enu = (
        complex(np.mean(np.exp(1j * x))) for x in (chi - psi, chi - np.radians(psi), chi - np.degrees(psi), chi + psi)
    )
    frozen = bool(np.ptp(motion[:, HEADING]) == 0)
    course = "by the course over ground: name the column"
    others = {
        f"heading looks like degrees, {course} heading_deg (and yaw_rate yaw_rate_deg, if it is in degrees per second)":
            abs(in_degrees),
        f"heading_deg looks like radians, {course} heading (and yaw_rate_deg yaw_rate, if it is in rad/s)":
            abs(in_radians),
        "the course turns against the heading: north and east are exchanged, or the heading is counted from east "
        "(ENU); wanted is clockwise from north": abs(enu),
    }  # fmt: skip
    likely = max(others, key=lambda told: others[told])  # of a steady course, more than one is clear
    aside = float(np.angle(right))
    side, unmeasured = "starboard" if aside > 0 else "port", f". Or {NO_HEADING}" if frozen else ""
    refuse(
        LogError,
        (frozen and abs(right) < STEADY, f"heading is {np.degrees(psi[0]) % 360:g} degrees all the time, whatever the "
         f"course over ground: {NO_HEADING}"),
        (others[likely] > max(CLEAR, abs(right) + CLEARER), likely),
        (abs(right) > CLEAR and ASIDE[0] < abs(aside) < ASIDE[1],
         f"the course over ground lies {np.degrees(abs(aside)):.0f} degrees to {side} of the heading, all the time: is "
         f"the heading counted from east (ENU)? Wanted is clockwise from north{unmeasured}"),
    )  # fmt: skip


def _check_rates(t: Array, motion: Array, parts: tuple[slice, ...]) -> None:
    """Compare the unwrapped heading with the yaw rate, to find one that is not there, degrees and wrong signs."""
    steps = float(np.median(np.diff(t)))
    whole = [part for part in parts if part.stop - part.start >= 5]
    turning = np.concatenate([np.zeros(0), *(np.gradient(motion[part, HEADING], t[part]) for part in whole)])
    r = np.concatenate([np.zeros(0), *(motion[part, YAW_RATE] for part in whole)])
    if not len(r):
        return
    turned = max(float(np.ptp(motion[part, HEADING])) for part in whole)
    swung = max(float(np.ptp(np.cumsum((motion[part, YAW_RATE] - r.mean()) * steps))) for part in whole)  # no bias
    slope = float(turning @ r / (r @ r)) if np.sqrt(np.mean(r**2)) >= 1e-3 else 1.0
    less = 1 / slope if slope else 0.0
    refuse(
        LogError,
        (np.ptp(r) == 0 and turned > TURNS, f"yaw_rate is {r[0]:g} all the time, while heading turns by "
         f"{np.degrees(turned):.0f} degrees: there is no yaw rate in this log: give one that was measured"),
        (turned == 0 and swung > TURNS, f"heading never changes, while yaw_rate turns it by {np.degrees(swung):.0f} "
         f"degrees: {NO_HEADING}"),
        (abs(slope) > LARGE, f"heading changes {slope:.0f} times as fast as yaw_rate says: heading looks like degrees "
         "(name the column heading_deg), or yaw_rate_deg like radians (yaw_rate)"),
        (0 < abs(slope) < SMALL, f"yaw_rate is {less:.0f} times the change of heading: it looks like degrees per "
         "second (name the column yaw_rate_deg), or heading_deg like radians (heading)"),
        (slope < -0.5, "heading turns against yaw_rate: one of them counts to port (heading is clockwise from north, "
         "yaw_rate is bow to starboard)"),
    )  # fmt: skip
