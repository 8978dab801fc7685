"""Multilevel splitting: the probability of a rare event of a Markov process, without bias, with an interval.

Paths run on; the *importance* of a state says how near it is to the event, and is infinite where the event has
happened. A path passes a level when its importance reaches it for the first time; the state there is kept. The next
level starts from the kept states of the last one, each with random numbers of its own from then on. With N paths at
every level, of which a share passes,

    p = share_1 share_2 ... share_n

is unbiased for levels that are fixed beforehand, and for any importance (L'Ecuyer, Demers & Tuffin 2007, Rare events,
splitting, and quasi-Monte Carlo, ACM TOMACS 17(2); fixed effort). A pilot finds the levels, and its paths are then
thrown away. All kept states start equally often, but for a remainder that is drawn: the expected number is that of
draws with replacement, the variance is lower.

The interval comes from independent repeats: Student's t for their mean, on the scale of its logarithm, because repeats
are skewed. Without levels all paths are independent, and the interval is that of Clopper & Pearson (1934). What the
repeats cannot tell is found by ancestors: the beginnings from which the paths with the event stem. Few of them carry
the result where the event is decided when a path begins; then no interval is given (`Odds.decided`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import stats

HAPPENED = math.inf  # importance of the event, and its level
NEW = -1  # state of a path that begins
SHARE = 0.2  # of paths that are to pass a level
MOST_LEVELS = 60  # that a pilot looks for
COMMON = 5e-3  # probability above which paths from beginnings alone cost less than levels; assumed
FEWEST_ANCESTORS = 10.0  # effective number of beginnings below which no interval is given; assumed
CONFIDENCE = 0.95

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


class Run(NamedTuple):
    """Paths that were run towards a level."""

    path: Ints  # [m] those that reached it, by their number among the starts, ascending
    state: Ints  # [m] names of the states there, by which paths start later
    importance: Floats  # [m] there
    highest: Floats  # [n] of each path, from its start to its end or its passage
    cost: float  # steps that were simulated


class Process(Protocol):
    """A Markov process with an importance; it keeps the states at which paths passed a level."""

    def run(self, starts: Ints, level: float) -> Run:
        """Run a path from each state of `starts` [n] (`NEW`: from a beginning of its own) until its importance is
        `level` or more, or the path is over. All draw random numbers of their own.
        """
        ...


class Levels(NamedTuple):
    """Levels that a pilot has found."""

    levels: tuple[float, ...]  # ascending; the last is `HAPPENED`
    cost: float
    stuck: bool = False  # whether importance rose no further before enough paths came to the event


class Stage(NamedTuple):
    """One level of a repeat: how its paths started, and which passed."""

    starts: Ints  # [n] states, NEW at the first level
    parent: Ints  # [n] number of the path of the level before, NEW at the first
    passed: Ints  # [m] numbers of paths
    ran: Ints  # numbers of the paths that were not there already, for which the process ran


@dataclass(frozen=True)
class Repeat:
    """One independent estimate.

    Attributes:
        shares: passed / effort, of each level until one that no path passed.
        weights: [effort] of the beginnings: how much of p each carries.
        stages: of each level. cost: steps that were simulated. states: [m] of the paths that came to the event.
    """

    shares: tuple[float, ...]
    weights: Floats
    stages: tuple[Stage, ...]
    cost: float
    states: Ints

    @property
    def p(self) -> float:
        """The estimate."""
        return float(self.weights.sum())

    def lineage(self, path: int) -> dict[int, int]:
        """Of each run of the process, by its number, the start from which `path` of the last level stems."""
        found, number = {}, sum(len(stage.ran) > 0 for stage in self.stages)
        for stage in self.stages[::-1]:
            number -= len(stage.ran) > 0
            if path in stage.ran:
                found[number] = int(np.searchsorted(stage.ran, path))
            path = int(stage.parent[path])
        return found

    @property
    def likeliest(self) -> int:
        """The first path that came to the event from the beginning that carries most."""
        ancestor, most = np.arange(len(self.weights)), int(self.weights.argmax())
        for stage in self.stages[1:]:
            ancestor = ancestor[stage.parent]
        passed = self.stages[-1].passed
        return int(passed[ancestor[passed] == most][0])


def evenly(count: int, size: int, rng: np.random.Generator) -> Ints:
    """`size` numbers below `count`, each equally often but for a remainder that is drawn, [size]."""
    whole = np.tile(np.arange(count), size // count)
    return np.concatenate((whole, rng.choice(count, size % count, replace=False)))


class _Front(NamedTuple):
    """Paths that have passed a level."""

    path: Ints
    state: Ints
    importance: Floats
    ran: Ints  # of all paths to this level, those for which the process ran
    cost: float


def _advance(process: Process, front: _Front, picks: Ints, level: float) -> _Front:
    """Paths from `front` that reach `level`: those that were there already, and those that run there."""
    there = front.importance[picks] >= level
    went, stay = np.flatnonzero(~there), np.flatnonzero(there)
    path, state, importance, cost = stay, front.state[picks[stay]], front.importance[picks[stay]], 0.0
    if len(went):
        run = process.run(front.state[picks[went]], level)
        path, state = np.concatenate((path, went[run.path])), np.concatenate((state, run.state))
        importance, cost = np.concatenate((importance, run.importance)), run.cost
    return _Front(path, state, importance, went, cost)


def _beginning(effort: int) -> _Front:
    everyone = np.full(effort, NEW)
    return _Front(everyone, everyone, np.full(effort, -math.inf), everyone, 0.0)


def no_levels(process: Process, effort: int) -> Levels:
    """No levels: all paths run from their beginning to their end; `effort` of them tell how long they are."""
    return Levels((HAPPENED,), process.run(np.full(effort, NEW), HAPPENED).cost)


def find_levels(process: Process, effort: int, rng: np.random.Generator, share: float = SHARE) -> Levels:
    """Find levels of which about `share` of `effort` paths pass each; none if the event is `COMMON`.

    All paths run to their end, and the level lies where the share of the highest importances is above it; the paths
    that a second run brings there are the next ones.
    """
    front, picks, levels, cost, p = _beginning(effort), np.arange(effort), [], 0.0, 1.0
    happened, stuck = 0.0, True
    while len(levels) < MOST_LEVELS:
        run = process.run(front.state[picks], HAPPENED)
        highest = np.maximum(front.importance[picks], run.highest)
        cost += run.cost
        happened = float(np.isinf(highest).mean())
        if happened >= share:
            stuck = False
            break
        last = levels[-1] if levels else highest.min()
        above = highest[(highest > last) & np.isfinite(highest)]
        if not len(above):
            break
        wanted = min(float(np.quantile(highest, 1 - share, method="lower")), float(above.max()))
        level = wanted if wanted > last else float(above.min())
        there = _advance(process, front, picks, level)
        cost += there.cost
        if not len(there.path):
            break
        levels.append(level)
        front, picks, p = there, evenly(len(there.path), effort, rng), p * len(there.path) / effort
    return Levels((HAPPENED,) if p * happened >= COMMON else (*levels, HAPPENED), cost, stuck)


def repeat(process: Process, levels: Sequence[float], effort: int, rng: np.random.Generator) -> Repeat:
    """One estimate with `effort` paths at each of `levels`, the last of which is `HAPPENED`."""
    front, picks, shares, stages, cost = _beginning(effort), np.arange(effort), [], [], 0.0
    ancestor = np.arange(effort)
    for number, level in enumerate(levels):
        parent = front.path[picks]
        starts, ancestor = front.state[picks], ancestor[parent] if number else ancestor
        front = _advance(process, front, picks, level)
        cost += front.cost
        shares.append(len(front.path) / effort)
        stages.append(Stage(starts, parent, front.path, front.ran))
        if not len(front.path):
            break
        picks = evenly(len(front.path), effort, rng)
    passed = ancestor[front.path] if len(front.path) else np.zeros(0, dtype=np.int64)
    weights = np.bincount(passed, minlength=effort) / max(1, len(passed)) * math.prod(shares)
    happened = front.state if len(shares) == len(levels) else front.state[:0]
    return Repeat(tuple(shares), weights, tuple(stages), cost, happened)


@dataclass(frozen=True)
class Odds:
    """What repeats tell about the probability of an event.

    Attributes:
        p: mean of the repeats. low, high: of the 95 % interval; None where there is none.
        relative: standard error over p; infinite for p = 0. repeats: their number. beginnings: of all of them.
        ancestors, effective: beginnings that carry the result, and as many as equal ones would be (Kish's 1 / sum of
            squared shares).
        cost: steps that were simulated, with the pilot's. levels: of importance. shares: that passed each.
        paths: of all repeats that came to the event.
    """

    p: float
    low: float | None
    high: float | None
    relative: float
    repeats: int
    beginnings: int
    ancestors: int
    effective: float
    cost: float
    levels: tuple[float, ...]
    shares: tuple[float, ...] = field(default=())

    @property
    def decided(self) -> bool:
        """Whether the event is decided when a path begins, as far as splitting can tell: too few carry the result."""
        return len(self.levels) > 1 and self.p > 0 and self.effective < FEWEST_ANCESTORS

    def direct(self, relative: float) -> float:
        """Beginnings that direct simulation needs for a standard error of `relative` p."""
        return (1 - self.p) / (self.p * relative**2) if self.p > 0 else math.inf


def pooled(repeats: Sequence[Repeat], levels: Sequence[float], pilot: float = 0.0) -> Odds:
    """Pool independent repeats of the same effort at the same levels; `pilot` is the cost of finding these."""
    each = np.array([one.p for one in repeats])
    count, beginnings = len(each), sum(len(one.weights) for one in repeats)
    p, weights = float(each.mean()), np.concatenate([one.weights for one in repeats])
    carried = weights[weights > 0]
    effective = float(carried.sum() ** 2 / (carried**2).sum()) if len(carried) else 0.0
    relative = float(each.std(ddof=1) / math.sqrt(count) / p) if p > 0 and count > 1 else math.inf
    low: float | None = None
    high: float | None = None
    if len(levels) == 1:
        happened, tail = round(p * beginnings), (1 - CONFIDENCE) / 2
        relative = math.sqrt((1 - p) / (p * beginnings)) if p > 0 else math.inf
        low = float(stats.beta.ppf(tail, happened, beginnings - happened + 1)) if happened else 0.0
        high = float(stats.beta.ppf(1 - tail, happened + 1, beginnings - happened)) if happened < beginnings else 1.0
    elif p > 0 and count > 1 and effective >= FEWEST_ANCESTORS:
        reach = math.exp(float(stats.t.ppf((1 + CONFIDENCE) / 2, count - 1)) * relative)
        low, high = p / reach, min(1.0, p * reach)
    depth = max(len(one.shares) for one in repeats)
    shares = np.array([[*one.shares, *[0.0] * (depth - len(one.shares))] for one in repeats])
    reached = np.array([[1.0, *row[:-1]] for row in shares]) > 0
    mean = np.where(reached, shares, 0.0).sum(0) / np.maximum(1, reached.sum(0))
    return Odds(p, low, high, relative, count, beginnings, len(carried), effective,
                pilot + sum(one.cost for one in repeats), tuple(levels), tuple(mean.tolist()))  # fmt: skip
