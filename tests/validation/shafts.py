"""What turns the propellers in a trajectory: the commands that its columns of shaft speeds n1, n2 show.

Shafts follow a command c by a first-order lag T: over a time h in which it is held

    n(t + h) = c + (n(t) - c) exp(-h / T),    so that    c = (n(t + h) - n(t) exp(-h / T)) / (1 - exp(-h / T)).

Where the columns follow a constant command, that of the table's name or else of its last row, it is held all the time.
Otherwise columns n1c, n2c are commands held from their row to the next. Without them each shaft's own column tells:

- two intervals on end with the same c: it was held; one between two held ones: it was changed on the way;
- others: n runs smoothly through the rows (a cubic through four of them), or, where c leaps about, c changes at rows.
"""

import numpy as np
from numpy.typing import NDArray

from tests.validation.tables import Table

Array = NDArray[np.float64]
SHAFTS = ("n1", "n2")  # left, right, rad/s
COMMANDS = ("n1c", "n2c")
AS_TOLD = 1e-5  # of the largest speed, by which shafts may differ from those of a held command
ROUGH = 1.0  # second over first differences of commands that leap about
SHARP = 2.0  # times


def shaft_commands(table: Table, named: tuple[float, float] | None, lag: float, steps: int) -> Array:
    """Commands (rad/s) [row - 1, steps, 2] of each of `steps` equal parts of the time from each row to the next; or
    [row - 1, 1, 2] where all are held from row to row.

    `named` is the constant command of the table's name; `lag` (s, not 0) that of the shafts. Rows are evenly spaced.
    """
    n = np.stack([table[name] for name in SHAFTS], axis=1)
    for constant in (named, tuple(n[-1])):
        if constant is not None and _follows(table, n, np.array(constant), lag):
            return np.broadcast_to(np.array(constant), (len(table) - 1, 1, 2)).copy()
    if COMMANDS[0] in table:
        return np.stack([table[name] for name in COMMANDS], axis=1)[:-1, None]
    h = float(np.mean(np.diff(table["t"])))
    found = np.stack([_commands(column, h, lag, steps) for column in n.T], axis=2)
    return found[:, :1] if (found == found[:, :1]).all() else found


def _follows(table: Table, n: Array, command: Array, lag: float) -> bool:
    """Whether shaft speeds n [row, 2] (rad/s) are those of a command that is held from the first row on."""
    decay = np.exp(-(table["t"] - table["t"][0]) / lag)[:, None]
    resolution = np.stack([table.resolution(name) for name in SHAFTS], axis=1)
    away = np.abs(command + (n[0] - command) * decay - n)
    return bool((away <= AS_TOLD * max(np.abs(n).max(), np.abs(command).max()) + resolution).all())


def _commands(n: Array, h: float, lag: float, steps: int) -> Array:
    """Commands [row - 1, steps] of one shaft of speeds n [row] (rad/s) every h (s)."""
    held = _held(n[:-1], n[1:], h, lag)
    found = np.repeat(held[:, None], steps, axis=1)
    same = np.abs(np.diff(held)) < AS_TOLD * np.abs(n).max()
    is_held = np.append(same, False) | np.insert(same, 0, False)
    for first, end in _runs(~is_held):
        if end - first == 1 and 0 < first < len(held) - 1:
            change = _changed(n[first : first + 2], held[first - 1], held[first + 1], h, lag, steps)
            found[first] = found[first] if change is None else change
        elif end - first > 2 and not _rough(held[first:end]):
            begin = first
            while end - begin > 4 and _sharper(n[begin : end + 1], held[begin:end]):
                begin += 1  # the shaft is still on its way to where the commands began
            found[begin:end] = _smooth(n[begin : end + 1], h, lag, steps)
            for row in reversed(range(first, begin)):
                found[row] = _earlier(found[row + 1 : row + 4], n[row : row + 2], h, lag)
    return found


def _held(before: Array, after: Array, h: float, lag: float) -> Array:
    """The command that takes shafts from one speed to another in h (s)."""
    keep = np.exp(-h / lag)
    return (after - before * keep) / (1 - keep)


def _runs(wanted: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and end of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], wanted, [False])).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _rough(commands: Array) -> bool:
    return bool(np.abs(np.diff(commands, 2)).mean() > ROUGH * np.abs(np.diff(commands)).mean())


def _sharper(n: Array, commands: Array) -> bool:
    """Whether speeds bend more than the commands."""
    return bool(np.abs(np.diff(n, 2)).max() > SHARP * np.abs(np.diff(commands, 2)).max())


def _changed(n: Array, before: float, after: float, h: float, lag: float, steps: int) -> Array | None:
    """Commands [steps] that change once from `before` to `after` while n [2] goes; None if no time would do."""
    left = (n[1] - after - (n[0] - before) * np.exp(-h / lag)) / (before - after)
    if not np.exp(-h / lag) <= left <= 1:
        return None
    change = h + lag * np.log(left)
    t = np.arange(steps + 1) * h / steps
    early = before + (n[0] - before) * np.exp(-t / lag)
    late = after + (before + (n[0] - before) * np.exp(-change / lag) - after) * np.exp(-(t - change) / lag)
    speed = np.where(t < change, early, late)
    return _held(speed[:-1], speed[1:], h / steps, lag)


def _earlier(after: Array, n: Array, h: float, lag: float) -> Array:
    """Commands [steps] before those of the next intervals, `after` [interval, steps], as these go on backwards; and so
    much more that the shaft goes from n[0] to n[1] (rad/s) in h (s).
    """
    steps = after.shape[1]
    way = np.polynomial.Polynomial.fit(np.arange(after.size), after.ravel(), 3)
    commands = way(np.arange(-steps, 0))
    keep = np.exp(-h / steps / lag)
    reached = n[0] * keep**steps + (1 - keep) * (commands @ keep ** np.arange(steps)[::-1])
    return commands + (n[1] - reached) / (1 - keep**steps)


def _smooth(n: Array, h: float, lag: float, steps: int) -> Array:
    """Commands [row - 1, steps] that keep the shaft on cubics through its speeds n [row] every h (s)."""
    rows, parts = len(n), (len(n) - 1) * steps
    place = np.arange(parts + 1) / steps  # in intervals
    points = min(4, rows)
    start = np.clip(place.astype(int) - 1, 0, rows - points)
    speed = np.zeros(parts + 1)
    for i in range(points):
        others = [j for j in range(points) if j != i]
        speed += n[start + i] * np.prod([(place - start - j) / (i - j) for j in others], axis=0)  # Lagrange
    return _held(speed[:-1], speed[1:], h / steps, lag).reshape(rows - 1, steps)
