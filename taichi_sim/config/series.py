"""A horizontal velocity over time, from a CSV file: a measured current or wind.

    time, speed, direction_deg          or          time, north, east
    0, 0.40, 120                                    2020-06-08 03:00, -0.20, 0.35
    600, 0.55, 130                                  2020-06-08 03:10, -0.35, 0.42

`time` is in s of the world's time. Dates and times, and seconds since 1970, begin at the first row, which is then the
world's time 0; dates without an offset are UTC. Rows less than 1 s apart need the unit, time [s]: days look alike.
Speeds are in m/s, or in the unit that the header states: speed [kn]. A direction is clockwise from north: where a
current flows to, and where a wind blows from, as everywhere in a scenario. `north` and `east` are the velocity itself,
for air too: where it goes to. Other columns are ignored. Between rows each component is linear in time; before the
first row and after the last it is constant. Cells and units: columns.py.
"""

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.config.columns import NO_DIRECTION, Column, Sheet, no_directions
from taichi_sim.errors import reading
from taichi_sim.kernels import runtime

WAYS = (("speed", "direction_deg"), ("north", "east"))
LATEST = 3600.0  # s, the first row; missions begin their episodes in the first hour
DAYS = 30_000.0  # from here on lie days since 1900, since the year 0 or of Julius, as spreadsheets and MATLAB count
ALIKE = 0.5, 0.1  # m/s and share of the speed, within which two statements of one velocity agree
FASTEST_WIND, FASTEST_CURRENT = 60.0, 10.0  # m/s; assumed, a series with a higher speed is refused


class Series:
    """A velocity over time.

    Attributes:
        time: increasing times [n], s, float64.
        velocity: velocity [n, 2], north and east, m/s, float64.
    """

    def __init__(self, time: np.ndarray, velocity: np.ndarray):
        """Take times [n] and velocities [n, 2]."""
        run = runtime.current()
        self.time, self.velocity = time, velocity
        self._time = torch.as_tensor(time, dtype=torch.float64, device=run.device)
        self._velocity = torch.as_tensor(velocity, dtype=torch.float64, device=run.device)

    def at(self, time: Tensor) -> Tensor:
        """Velocity [env, 2] (m/s), run precision, at times [env] (s), float64."""
        if self._time.numel() == 1:
            return self._velocity.to(runtime.current().torch_dtype).expand(time.shape[0], 2)
        time = time.clamp(self.time[0], self.time[-1])
        after = torch.searchsorted(self._time, time.contiguous(), right=True).clamp(1, self._time.numel() - 1)
        start, end = self._time[after - 1], self._time[after]
        share = ((time - start) / (end - start)).unsqueeze(1)
        velocity = self._velocity[after - 1] * (1 - share) + self._velocity[after] * share
        return velocity.to(runtime.current().torch_dtype)


def mean_of(file: str, blows_from: bool = False) -> tuple[float, float]:
    """Speed (m/s) and direction (deg, to or from as in the file) of the mean velocity over a file's rows."""
    north, east = read_series(file, blows_from)[1].mean(axis=0)
    turn = 180.0 if blows_from else 0.0
    return math.hypot(north, east), (math.degrees(math.atan2(east, north)) + turn) % 360.0


def read_series(file: str, blows_from: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Times [n] (s) and velocities [n, 2] (north, east, m/s) of a file; a wind's direction is where it `blows_from`."""
    path = Path(file)
    with reading(path, ConfigError):
        stamp = path.stat().st_mtime_ns
    return _read(path, stamp, blows_from)


@lru_cache(maxsize=8)
def _read(path: Path, stamp: int, blows_from: bool) -> tuple[np.ndarray, np.ndarray]:
    sheet = Sheet(path)
    way = next((way for way in WAYS if all(sheet.find(name) for name in ("time", *way))), None)
    if way is None or not sheet.rows:
        wanted = " or with ".join(" and ".join(way) for way in WAYS)
        has = f"{', '.join(sheet.header) or 'none'}{'' if sheet.rows else ', and there is no row'}"
        raise ConfigError(f"{path}: columns are {has}; expected time with {wanted}")
    at, one, other = (place for name in ("time", *way) if (place := sheet.find(name)))
    time, dates = sheet.times(at)
    if not (dates or at.unit) and len(time) > 1:
        step = float(np.median(np.diff(time)))
        days = step < 1.0 or (step == 1.0 and time[0] > DAYS)
        sheet.judge(([days], lambda k: f"{at.title} = {time[k]:g}: days of a spreadsheet? Rows are {step:g} s apart. "
                     f"Give ISO dates, or the unit: {at.title} [s], [h] or [days]"))  # fmt: skip
    time = time - time[0] if dates else time
    why = "later than episodes (0 to 1 h), which would have the first row alone"
    sheet.judge(([time[0] >= LATEST], lambda k: f"{at.title} begins at {time[k]:g} s, {why}: seconds of a day, a week? "
                 "Count from 0, or give ISO dates"))  # fmt: skip
    velocity = _by_components(sheet, one, other) if way == WAYS[1] else _by_angle(sheet, one, other, blows_from)
    also = [place for name in WAYS[1] if (place := sheet.find(name))]
    if way == WAYS[0] and len(also) == 2:
        apart = np.hypot(*(velocity - _by_components(sheet, *also)).T)
        sheet.judge((
            apart > ALIKE[0] + ALIKE[1] * np.hypot(*velocity.T),
            lambda k: f"north and east are {apart[k]:.3g} m/s from speed and direction_deg (where a wind blows from, a "
            "current flows to): leave one pair out",
        ))  # fmt: skip
    return time, _possible(sheet, velocity, blows_from)


def _by_components(sheet: Sheet, north: Column, east: Column) -> np.ndarray:
    """Velocities [n, 2] of two columns."""
    return np.stack([sheet.numbers(place, "speed") for place in (north, east)], axis=1)


def _by_angle(sheet: Sheet, one: Column, other: Column, blows_from: bool) -> np.ndarray:
    """Velocities [n, 2] of a speed and a direction."""
    speed, direction = sheet.numbers(one, "speed"), sheet.numbers(other, "degrees")
    sheet.judge(
        (speed < 0, lambda k: "speed must be 0 or more"),
        (no_directions(direction), lambda k: f"{other.title} = {direction[k]:g}: {NO_DIRECTION}"),
    )
    angle = np.deg2rad(direction + (180.0 if blows_from else 0.0))
    return speed[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)


def _possible(sheet: Sheet, velocity: np.ndarray, blows_from: bool) -> np.ndarray:
    """The velocities [n, 2], refused by their line if no wind or current is so fast."""
    speed, fastest = np.hypot(*velocity.T), FASTEST_WIND if blows_from else FASTEST_CURRENT
    sheet.judge((speed > fastest, lambda k: f"{speed[k]:g} m/s: allowed are 0 to {fastest:g}; a mark of a missing "
                 "value, or other units? Call a column speed [kn]"))  # fmt: skip
    return velocity
