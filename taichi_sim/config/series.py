"""A horizontal velocity over time, from a CSV file: a measured current or wind.

    time, speed, direction_deg          or          time, north, east
    0, 0.40, 120                                    2020-06-08 03:00, -0.20, 0.35
    600, 0.55, 130                                  2020-06-08 03:10, -0.35, 0.42

`time` is in s of the world's time, or a date and time (the first row is then the world's time 0). Speeds are in m/s. A
direction is clockwise from north: where a current flows to, and where a wind blows from, as everywhere in a scenario.
`north` and `east` are the velocity itself, for air too: where it goes to. Other columns are ignored. Between rows each
component is linear in time; before the first row and after the last it is constant.
"""

import csv
import math
from datetime import datetime
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from taichi_sim.config import ConfigError
from taichi_sim.kernels import runtime

WAYS = (("speed", "direction_deg"), ("north", "east"))


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


def read_series(file: str, blows_from: bool = False, fastest: float = math.inf) -> tuple[np.ndarray, np.ndarray]:
    """Times [n] (s) and velocities [n, 2] (north, east, m/s) of a file.

    Raises:
        ConfigError: for a mistake in the file or a speed above `fastest`; the message names file and line.
    """
    path = Path(file)
    try:
        stamp = path.stat().st_mtime_ns
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}") from None
    time, velocity = _read(path, stamp, blows_from)
    speed = np.hypot(*velocity.T)
    if speed.max() > fastest:
        raise ConfigError(f"{file}, line {int(speed.argmax()) + 2}: {speed.max():g} m/s: allowed are 0 to {fastest:g}")
    return time, velocity


@lru_cache(maxsize=8)
def _read(path: Path, stamp: int, blows_from: bool) -> tuple[np.ndarray, np.ndarray]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            header, *rows = [[cell.strip() for cell in row] for row in csv.reader(file) if any(row)] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    way = next((way for way in WAYS if {"time", *way} <= set(header)), None)
    if way is None:
        raise ConfigError(f"{path}: columns are {', '.join(header) or 'none'}; expected time with "
                          f"{' or with '.join(' and '.join(way) for way in WAYS)}")  # fmt: skip
    if not rows:
        raise ConfigError(f"{path}: there is no row under the header")
    columns = [header.index(name) for name in ("time", *way)]
    values = np.array([_row(path, number, row, columns) for number, row in enumerate(rows, 2)])
    time = values[:, 0] - (0.0 if _is_number(rows[0][columns[0]]) else values[0, 0])
    if fault := next((n for n in range(1, len(time)) if time[n] <= time[n - 1]), None):
        raise ConfigError(f"{path}, line {fault + 2}: times must rise from row to row")
    if way == WAYS[0]:
        if (values[:, 1] < 0).any():
            raise ConfigError(f"{path}, line {int((values[:, 1] < 0).argmax()) + 2}: speed must be 0 or more")
        angle = np.deg2rad(values[:, 2] + (180.0 if blows_from else 0.0))
        return time, values[:, 1:2] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    return time, values[:, 1:]


def _row(path: Path, number: int, row: list[str], columns: list[int]) -> list[float]:
    try:
        time, *velocity = (row[column] for column in columns)
        numbers = [float(time) if _is_number(time) else datetime.fromisoformat(time).timestamp(), *map(float, velocity)]
    except IndexError:
        raise ConfigError(f"{path}, line {number}: cut short: {len(row)} cells") from None
    except ValueError as error:
        raise ConfigError(f"{path}, line {number}: {error}") from None
    if not all(map(math.isfinite, numbers)):
        raise ConfigError(f"{path}, line {number}: numbers must be finite")
    return numbers


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
