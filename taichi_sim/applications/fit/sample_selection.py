"""Which samples of a log count: those that a slower sensor repeats do not, nor do those at a jump in value.

A logger that writes rows at 10 Hz beside a GNSS of 1 Hz repeats each position ten times, or draws lines between them.
Such rows say nothing new. A GNSS that changes its solution makes a vessel jump. Neither is noise, and both are found
here, in the position, the heading and the yaw rate, each by itself.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from taichi_sim.applications.fit.log_table import EAST, HEADING, NORTH, YAW_RATE, Array

Mask = NDArray[np.bool_]
SENSORS = {"position": [NORTH, EAST], "heading": [HEADING], "yaw rate": [YAW_RATE]}  # and their columns of a motion
COARSE = 0.3  # changes of one step over all, from which a resolution is coarse
CHANCE = 3.0  # repeats over those that a coarse resolution explains, from which a sensor is slower than the log
QUIET = 0.2  # change after repeats over the usual one, below which the vessel is at rest
FEW = 3  # repeats that are no sign of anything
BENDS, REGULAR = 1e-3, 0.8  # a line: its typical bend over that of knots; share of the knots that are equally far apart
# a jump: robust standard deviations of the change between samples, and the least: of a position (m; assumed), of a
# heading (rad; assumed), and what a vessel's acceleration explains (m/s^2; assumed)
CELLS, NO_STEP = 2.0, 1e-4  # cells of rounded places that a jump exceeds; m, less is no step
DEVIATIONS, LEAST_M, LEAST_RAD, ACCELERATION = 6.0, 0.2, np.radians(5.0), 2.0
TOGETHER = 15  # samples within which jumps are one: there and back
NAMED = 3  # jumps of a log that are named one by one
NORMAL, RAYLEIGH = 1.4826, 1 / 1.1774  # standard deviation over the median size, of one and of two components


class Samples(NamedTuple):
    """The motion of a log, and which of its samples count."""

    motion: Array  # [sample, 4]; heading unwrapped; what does not count is interpolated between what does
    new: Mask  # [sample, 4]
    parts: tuple[slice, ...]
    notes: tuple[str, ...]


def inspected(t: Array, motion: Array, parts: tuple[slice, ...]) -> Samples:
    """Find repeats and jumps in `motion` [sample, 4], whose `parts` have no gaps."""
    motion, notes = motion.copy(), []
    new = np.ones(motion.shape, dtype=bool)
    for name, columns in SENSORS.items():
        old, why = _repeats(motion[:, columns], parts, round_=name == "heading")
        new[:, columns] = ~old[:, None]
        if old.any():
            times = np.concatenate([t[p][~old[p]] for p in parts])
            usual = float(np.median(np.diff(times))) if len(times) > 1 else float("inf")
            notes.append(f"{name} {why} {int(old.sum())} of {len(t)} rows, new ones are {usual:.2g} s apart: only "
                         "these count")  # fmt: skip
    _fill(t, motion, new, parts)
    told = []
    for part in parts:
        told += _heading_jumps(t[part], motion[part], new[part], part.start)
    notes += [jump.told for jump in told[:NAMED]]
    parts = _longest(t, parts, told, notes)
    steps = [jump for part in parts for jump in _position_jumps(t[part], motion[part], new[part], part.start)]
    parts = tuple(piece for part in parts for piece in _split(part, steps))
    notes += [jump.told for jump in steps[:NAMED]]
    if more := sum(max(len(found) - NAMED, 0) for found in (told, steps)):
        notes.append(f"there are {more} more such jumps")
    for jump in told + steps:
        new[jump.first + 1 : jump.last, jump.columns] = False
    _fill(t, motion, new, parts)
    return Samples(motion, new, parts, tuple(notes))


class _Jump(NamedTuple):
    """A jump between two samples, or more of them."""

    columns: list[int]
    first: int  # the last sample before it
    last: int  # the first one after it
    back: bool  # whether the value comes back
    told: str


def _repeats(values: Array, parts: Sequence[slice], round_: bool) -> tuple[Mask, str]:
    """Which samples [sample, column] repeat the one before or lie on a line between others, and a word for it.

    A sensor of coarse resolution repeats a value by chance about as often as it changes by one step.
    """
    old, steps, whole = np.zeros(len(values), dtype=bool), np.diff(values, axis=0), np.zeros(len(values) - 1, bool)
    if round_:
        steps = np.angle(np.exp(1j * steps)) * (steps != 0)
    for part in parts:
        whole[part.start : part.stop - 1] = True
    same, sizes = (steps == 0).all(axis=1) & whole, np.abs(steps)
    if not sizes[whole].any():
        return old, ""
    smallest = np.array([x[x > 0].min(initial=np.inf) for x in sizes[whole].T])
    near = (sizes <= 1.5 * smallest).all(axis=1) & whole & ~same
    moves = whole & ~same
    after = moves & np.r_[False, same[:-1]]
    resting = after.any() and np.median(sizes[after].max(axis=1)) < QUIET * np.median(sizes[moves].max(axis=1))
    often = same.sum() > FEW + CHANCE * near.sum() / (3 ** values.shape[1] - 1)
    coarse = near.sum() > COARSE * moves.sum() and not _regular(np.flatnonzero(moves))
    if often and not resting and not coarse:
        old[1:] = same
        for part in parts:  # the first value of a part may be as old as a repeat
            changed = np.flatnonzero(~old[part][1:])
            old[part.start : part.start + 1 + changed[0] if len(changed) else part.stop] = True
    bend = np.zeros(len(values))
    bend[1:-1] = np.abs(np.angle(np.exp(1j * np.diff(steps, axis=0))) if round_ else np.diff(steps, axis=0)).max(axis=1)
    typical, largest = np.median(bend[1:-1]), np.quantile(bend[1:-1], 0.95)
    knots = np.flatnonzero(bend > max(BENDS * largest, 3 * typical))
    if typical < BENDS * largest and _regular(knots):
        lines = np.ones(len(old), dtype=bool)
        lines[knots] = False
        return old | lines, "is drawn between others in"
    return old, "repeats in"


def _regular(places: NDArray[np.intp]) -> bool:
    """Whether places are mostly equally far apart, and more than one sample."""
    if len(places) <= FEW:
        return False
    apart = np.diff(places)
    usual = int(np.median(apart))
    return usual > 1 and float(np.mean(apart == usual)) > REGULAR


def _fill(t: Array, motion: Array, new: Mask, parts: Sequence[slice]) -> None:
    """Unwrap the heading that counts; interpolate what does not count, part by part."""
    for part in parts:
        for column in range(motion.shape[1]):
            good = new[part, column]
            if good.any():
                values = motion[part, column][good]
                if column == HEADING:
                    values = np.unwrap(values)
                motion[part, column] = np.interp(t[part], t[part][good], values)


def _groups(flagged: NDArray[np.intp]) -> list[tuple[int, int]]:
    """First and last of those flagged intervals that are near each other."""
    ends = np.flatnonzero(np.diff(flagged) > TOGETHER)
    return [(int(flagged[a]), int(flagged[b - 1])) for a, b in pairwise([0, *(ends + 1), len(flagged)]) if b > a]


def _position_jumps(t: Array, motion: Array, new: Mask, begin: int) -> list[_Jump]:
    """Jumps of the position: a velocity unlike those before and after it. `begin` is the number of the first sample."""
    at = np.flatnonzero(new[:, NORTH])
    if len(at) < 4:
        return []
    p, dt = motion[at][:, [NORTH, EAST]], np.diff(t[at])
    v = np.diff(p, axis=0) / dt[:, None]
    change = np.hypot(*np.diff(v, axis=0).T)
    size = dt * np.minimum(np.r_[change[:1], change], np.r_[change, change[-1:]])
    least = np.maximum(DEVIATIONS * RAYLEIGH * np.median(change * dt[1:]), LEAST_M) + ACCELERATION * dt**2
    steps = np.abs(np.diff(p, axis=0))
    cell = [column[column > NO_STEP].min(initial=np.inf) for column in steps.T]  # m, of places that are rounded
    least += CELLS * math.hypot(*(c for c in cell if c < np.inf))
    found = []
    for a, b in _groups(np.flatnonzero(size > least)):
        around = [v[k] for k in (a - 1, b + 1) if 0 <= k < len(v)]
        usual = np.mean(around, axis=0) if around else np.zeros(2)
        off = p[a + 1 : b + 2] - p[a] - usual * (t[at[a + 1 : b + 2]] - t[at[a]])[:, None]
        whole = float(np.hypot(*off[-1]))
        back = bool(b > a and whole < 2 * least[a])
        worst = float(np.hypot(*off.T).max())
        told = (f"position is off by {worst:.2g} m at {t[at[a + 1]]:g} s, and back {t[at[b + 1]] - t[at[a + 1]]:.2g} s "
                "later: left out" if back else
                f"position jumps by {whole:.2g} m at {t[at[b + 1]]:g} s: no window spans it")  # fmt: skip
        found.append(_Jump(SENSORS["position"], begin + int(at[a]), begin + int(at[b + 1]), back, told))
    return found


def _heading_jumps(t: Array, motion: Array, new: Mask, begin: int) -> list[_Jump]:
    """Jumps of the heading: a change that the yaw rate does not explain."""
    at = np.flatnonzero(new[:, HEADING])
    if len(at) < 4:
        return []
    r = motion[:, YAW_RATE]
    r = np.median([np.r_[r[:1], r[:-1]], r, np.r_[r[1:], r[-1:]]], axis=0)  # a spike of the rate is no jump of heading
    turned = np.r_[0.0, np.cumsum(0.5 * (r[1:] + r[:-1]) * np.diff(t))]
    left = motion[at, HEADING] - turned[at]
    step = np.angle(np.exp(1j * np.diff(left)))
    step -= np.median(step)
    least = max(DEVIATIONS * NORMAL * float(np.median(np.abs(step))), LEAST_RAD)
    found = []
    for a, b in _groups(np.flatnonzero(np.abs(step) > least)):
        parts = np.cumsum(step[a : b + 1])
        whole = float(np.angle(np.exp(1j * parts[-1])))
        back, degrees = bool(b > a and abs(whole) < 2 * least), np.degrees
        wrong = back and abs(abs(parts[-1]) - 2 * np.pi) < 2 * least
        when = f"at {t[at[a + 1]]:g} s"
        told = (f"heading goes the wrong way round {when} (interpolated through north?): left out" if wrong else
                f"heading is off by {degrees(np.abs(parts).max()):.0f} deg {when}, and comes back: left out" if back
                else f"heading jumps by {degrees(whole):.0f} deg at {t[at[b + 1]]:g} s")  # fmt: skip
        found.append(_Jump(SENSORS["heading"], begin + int(at[a]), begin + int(at[b + 1]), back, told))
    return found


def _split(part: slice, jumps: Sequence[_Jump]) -> list[slice]:
    """The pieces of a part between the jumps after which the value does not come back."""
    inside = [j for j in jumps if part.start <= j.first < part.stop and not j.back]
    starts, stops = [part.start, *(j.last for j in inside)], [*(j.first + 1 for j in inside), part.stop]
    return [slice(a, b) for a, b in zip(starts, stops, strict=True) if b - a > 1]


def _longest(t: Array, parts: tuple[slice, ...], jumps: Sequence[_Jump], notes: list[str]) -> tuple[slice, ...]:
    """Parts of the longest stretch without a jump of the heading, for the compass has one bias in a log."""
    if all(j.back for j in jumps):
        return parts
    edges = [0, *(j.last for j in jumps if not j.back), len(t)]
    a, b = max(pairwise(edges), key=lambda ab: t[ab[1] - 1] - t[ab[0]])
    pieces = [piece for part in parts for piece in _split(part, jumps)]
    kept = tuple(piece for piece in pieces if a <= piece.start and piece.stop <= b)
    notes.append(f"its compass has another error after a jump: only {t[a]:g} to {t[b - 1]:g} s is used")
    return kept
