"""Dataflash logs of ArduPilot (.bin) as logs, by `pymavlink`.

| taken | message and field | |
|---|---|---|
| lane | XKF4.PI | EKF3's primary core at each time; without XKF4, PARM EK3_PRIMARY, or 0 |
| north, east | XKF1.PN, PE | m, the primary core's estimate, from the EKF's origin |
| heading | XKF1.Yaw | deg, clockwise from north |
| a position at all | XKF4.SS | without a horizontal position, or in constant position mode, XKF1 is left out |
| yaw rate | IMU.GyrZ | rad/s, sensor 0 while it is healthy (GH); mean over each interval |
| commands | RCOU.C1 ... C14 | pulse widths, microseconds; samples of a signal: mean over the interval after a time |
| channels | PARM, SERVOn_FUNCTION | 70 throttle, 26 ground steering; 73 and 74 throttle left and right |
| ends, middle of a width | PARM, SERVOn_MIN, _TRIM, _MAX, _REVERSED | 1000, 1500, 2000, 0 where not logged |

All is resampled to INTERVAL: positions and headings by interpolation, rates and commands by means. A gap in XKF1,
IMU or RCOU is a gap of the log. Lanes differ in their positions: where the primary one changes, a new part begins.
Widths that were changed in a log are refused. Bytes that are no messages are left out, and a warning names them.
"""

import contextlib
import io
import warnings
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.fit.log_table import CLOCK, GAP, Array, LogError, Source, Table, drawn_means, held
from taichi_sim.applications.sitl.channels import FUNCTIONS, default_channels, read_channels
from taichi_sim.config.columns import judge
from taichi_sim.errors import needs, refuse
from taichi_sim.vehicle import Vehicle

INTERVAL = 0.1  # s; assumed, enough for a vessel
LONGEST = 1e6  # s; assumed, no log lasts for twelve days
OUTPUTS = tuple(f"C{n}" for n in range(1, 15))
WIDTHS = {"MIN": 1000.0, "TRIM": 1500.0, "MAX": 2000.0, "REVERSED": 0.0}  # assumed where PARM does not say
MICRO = 1e-6
HAS_POSITION, HOLDS_POSITION = 8 | 16, 128  # bits of XKF4.SS: relative or absolute position; constant position mode


def read_dataflash(file: Path, model: Vehicle, source: Source) -> Table:
    """The table of a dataflash log."""
    with needs("pymavlink", "ardupilot"):
        from pymavlink.DFReader import DFReader_binary
    found: dict[str, list[Any]] = {name: [] for name in ("XKF1", "XKF4", "IMU", "RCOU", "PARM")}
    if file.read_bytes()[:3] != b"\xa3\x95\x80":
        raise LogError("this is no dataflash log of ArduPilot: it begins with no FMT record")
    silent = io.StringIO()  # it prints what it skips
    with contextlib.redirect_stdout(silent), contextlib.redirect_stderr(silent):
        log = DFReader_binary(str(file))
        while (message := log.recv_match(type=list(found))) is not None:
            found[message.get_type()].append(message)
    _warn_of_damage(file, log)
    parameters = {m.Name: float(m.Value) for m in found["PARM"]}
    places, changes = _primary(found["XKF1"], found["XKF4"], int(parameters.get("EK3_PRIMARY", 0)))
    gyros = [m for m in found["IMU"] if getattr(m, "I", 0) == 0 and getattr(m, "GH", 1) != 0]
    counts = {"XKF1": len(places), "IMU": len(gyros), "RCOU": len(found["RCOU"])}
    name = min(counts, key=lambda name: counts[name])
    wanted = "XKF1 (EKF3, the primary core, with a position), IMU (sensor 0, healthy) and RCOU"
    few = f"{counts[name]} messages {name}; wanted are {wanted}: see LOG_BITMASK and EK3_ENABLE"
    refuse(LogError, (counts[name] < 3, few))
    place, t_place = _columns("XKF1", places, ("PN", "PE", "Yaw"))
    gyro, t_gyro = _columns("IMU", gyros, ("GyrZ",))
    widths, t_widths = _columns("RCOU", found["RCOU"], [c for c in OUTPUTS if hasattr(found["RCOU"][0], c)])
    long = t_place[-1] - t_place[0] > LONGEST
    refuse(LogError, (long, f"XKF1 goes from {t_place[0]:g} to {t_place[-1]:g} s: a damaged time, or several logs?"))
    t = t_place[0] + INTERVAL * np.arange(int((t_place[-1] - t_place[0]) / INTERVAL + CLOCK) + 1)
    t = t[np.all([_covered(clock, t) for clock in (t_place, t_gyro, t_widths)], axis=0)]
    for before, after in changes:  # between two lanes there is no position
        t = t[(t <= before + CLOCK) | (t >= after - CLOCK)]
    north, east, yaw = place.T
    channels = _channels(model, source.channels, parameters)
    values: dict[str, dict[float, None]] = {f"SERVO{abs(n)}_{key}": {} for n in channels.values() for key in WIDTHS}
    for message in found["PARM"]:
        values.get(message.Name, {})[float(message.Value)] = None
    changed = next((name for name, given in values.items() if len(given) > 1), "")
    told = ", ".join(f"{value:g}" for value in values.get(changed, ()))
    refuse(
        LogError,
        (len(t) < 3, "XKF1, IMU and RCOU have no time in common"),
        (changed, f"{changed} was changed in this log ({told}): part it there"),
    )
    columns = {
        "t": t,
        "north": np.interp(t, t_place, north),
        "east": np.interp(t, t_place, east),
        "heading": np.interp(t, t_place, np.unwrap(np.radians(yaw))),
        "yaw_rate": _means(t_gyro, gyro.squeeze(1), t, INTERVAL),
        **{
            name: drawn_means(t_widths, values, t, t + INTERVAL)
            for name, values in _actions(model, channels, parameters, widths).items()
        },
    }
    return Table(columns, lambda k: f"at {t[k]:.1f} s", np.array([after - CLOCK for _, after in changes]))


def _primary(places: list[Any], states: list[Any], usual: int) -> tuple[list[Any], list[tuple[float, float]]]:
    """Messages XKF1 of the lane that is primary at their time, where it has a position; and its changes.

    A change is the times (s) of the last message of one lane and the first one of the next. Without XKF4.PI the lane
    is `usual` all the time.
    """
    states = [m for m in states if hasattr(m, "PI")]
    if not states:
        return [m for m in places if getattr(m, "C", 0) == usual], []
    at = np.array([MICRO * m.TimeUS for m in states])
    primary = held(at, np.array([m.PI for m in states]), np.array([MICRO * m.TimeUS for m in places]))
    kept = [(m, lane) for m, lane in zip(places, primary, strict=True) if getattr(m, "C", 0) == lane]
    for lane in {lane for _, lane in kept}:
        told = [(MICRO * m.TimeUS, int(m.SS)) for m in states if getattr(m, "C", 0) == lane and hasattr(m, "SS")]
        if told:
            since, flags = (np.array(x) for x in zip(*told, strict=True))
            has = (flags & HAS_POSITION != 0) & (flags & HOLDS_POSITION == 0)
            there = held(since, has, np.array([MICRO * m.TimeUS for m, _ in kept]))
            kept = [(m, of) for (m, of), good in zip(kept, there, strict=True) if of != lane or good]
    if not kept:
        lanes = ", ".join(str(x) for x in sorted({int(getattr(m, "C", 0)) for m in places})) or "none"
        raise LogError(f"no position: XKF1 has core {lanes}, primary is {np.unique(primary)} (XKF4.PI); or the "
                       "estimate has no horizontal position (XKF4.SS)")  # fmt: skip
    changes = [(MICRO * m.TimeUS, MICRO * n.TimeUS) for (m, a), (n, b) in pairwise(kept) if a != b]
    return [m for m, _ in kept], changes


def _warn_of_damage(file: Path, log: Any) -> None:
    """Warn of bytes that belong to no message: in the middle, or an end in the middle of a message."""
    found = [(np.asarray(at, dtype=np.int64), log.formats[number].len)
             for number, at in enumerate(log.offsets) if len(at) and number in log.formats]  # fmt: skip
    if not found:
        return
    begin, end = np.concatenate([at for at, _ in found]), np.concatenate([at + size for at, size in found])
    order = np.argsort(begin)
    begin, end = begin[order], end[order]
    begin, end = begin[end <= log.data_len], end[end <= log.data_len]
    lost = begin[1:] - end[:-1]
    if (lost > 0).any():
        warnings.warn(f"{file}: damaged: {lost[lost > 0].sum()} bytes are no messages, the first at byte "
                      f"{end[:-1][lost > 0][0]}: what they held is left out", stacklevel=2)  # fmt: skip
    if (rest := log.data_len - (int(end[-1]) if end.size else 0)) > 0:
        warnings.warn(f"{file}: cut: its last {rest} bytes are no whole message", stacklevel=2)


def _columns(name: str, messages: list[Any], fields: tuple[str, ...] | list[str]) -> tuple[Array, Array]:
    """Fields [message, field] of messages, and their times, s; LogError for a missing one or a clock that runs back."""
    rows = np.array([[m.TimeUS, *(getattr(m, field) for field in fields)] for m in messages], dtype=np.float64)
    t = MICRO * rows[:, 0]
    judge(
        LogError,
        lambda k: f"message {k + 1} of {name}",
        (np.diff(t, prepend=-np.inf) <= 0,
         lambda k: f"time goes from {t[k - 1]:g} to {t[k]:g} s: it must increase (two flights in one file?)"),
    )  # fmt: skip
    return rows[:, 1:], t


def _channels(model: Vehicle, asked: str, parameters: Mapping[str, float]) -> dict[str, int]:
    """Channels of the vehicle's controls: control -> channel, negative if reversed.

    Where none is asked for, a control of several channels in the log, or of none, is a LogError.
    """
    if asked:
        return read_channels(asked, model)
    found = {}
    for control, usual in default_channels(model).items():
        function = FUNCTIONS.get(control)
        mine = [n for n in range(1, 15) if parameters.get(f"SERVO{n}_FUNCTION") == function]
        if function is None or not any(key.startswith("SERVO") for key in parameters):
            mine = [usual]
        if len(mine) != 1:
            way = f"name its channel by --channels {control}=N"
            if control in ("ahead", "helm") and {73, 74} <= {
                parameters.get(f"SERVO{n}_FUNCTION") for n in range(1, 15)
            }:
                way = "it has two throttles, 73 and 74: give --set 'actions=\"left_right\"', if the vehicle has it"
            raise LogError(f"{len(mine)} servo outputs have the function {function} of {control}: {way}")
        found[control] = mine[0]
    return found


def _actions(
    model: Vehicle, channels: Mapping[str, int], parameters: Mapping[str, float], widths: Array
) -> dict[str, Array]:
    """Actions from pulse widths [sample, output]."""
    shares = {}
    for control, channel in channels.items():
        n = abs(channel)
        low, middle, high, back = (parameters.get(f"SERVO{n}_{key}", usual) for key, usual in WIDTHS.items())
        width = widths[:, n - 1 : n].squeeze()
        refuse(
            LogError,
            (n > widths.shape[1], f"no output {n} for {control}; RCOU has {widths.shape[1]}"),
            (not low < middle < high,
             f"SERVO{n}_MIN, _TRIM, _MAX are {low:g}, {middle:g}, {high:g}: they must increase"),
            (not width.any(), f"RCOU.C{n} is 0 all the time: output {n} of {control} gives no pulses (disarmed, or "
             f"another output?): name it by --channels {control}=N"),
        )  # fmt: skip
        share = np.where(width > middle, (width - middle) / (high - middle), (width - middle) / (middle - low))
        share = np.where(width > 0, share.clip(-1.0, 1.0), 0.0)  # a width of 0 is no output
        shares[control] = -share if (back == 1.0) != (channel < 0) else share
    if "helm" not in shares:
        return {name: shares[name] for name in model.action_names}
    ahead = shares["ahead"] if getattr(model, "backs", False) else shares["ahead"].clip(0.0)
    steered = model.steer(ahead, shares["helm"])  # pyright: ignore[reportAttributeAccessIssue]
    return dict(zip(model.action_names, np.moveaxis(steered, -1, 0), strict=True))


def _covered(clock: Array, at: Array) -> NDArray[np.bool_]:
    """Which of the times `at` are on a sample of `clock`, or between two that no gap parts."""
    gap = GAP * max(float(np.median(np.diff(clock))), INTERVAL)
    after = np.searchsorted(clock, at - CLOCK)
    inside = np.clip(after, 1, len(clock) - 1)
    between = (after > 0) & (after < len(clock)) & (clock[inside] - clock[inside - 1] <= gap)
    return between | (np.abs(clock[np.clip(after, 0, len(clock) - 1)] - at) <= CLOCK)


def _means(t: Array, values: Array, at: Array, interval: float) -> Array:
    """Mean of the samples within half an `interval` of each time `at`; where there are none, interpolated."""
    sums = np.concatenate(([0.0], np.cumsum(values)))
    first, last = (np.searchsorted(t, at + side * 0.5 * interval) for side in (-1, 1))
    count = last - first
    between = np.interp(at, t, values)
    return np.where(count > 0, (sums[last] - sums[first]) / np.maximum(count, 1), between)
