"""Multilevel splitting (rl/evaluation/odds/splitting.py) against closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from rl.evaluation.odds.splitting import HAPPENED, NEW, Run, find_levels, pooled, repeat


class Walk:
    """Paths of many walkers at once; a state is a tuple of floats, kept in a list of rows."""

    def __init__(self, seed: int):
        self.rng, self.kept = np.random.default_rng(seed), np.zeros((0, self.width))

    width = 1

    def run(self, starts, level):
        n = len(starts)
        x = np.where((starts == NEW)[:, None], self.first(n), self.kept[np.maximum(starts, 0)] if len(self.kept) else 0)
        highest = self.importance(x)
        going, cost = (highest < level) & ~self.over(x), 0
        while going.any():
            x[going] = self.moved(x[going])
            cost += int(going.sum())
            highest = np.where(going, np.maximum(highest, self.importance(x)), highest)
            going &= (highest < level) & ~self.over(x)
        path = np.flatnonzero(highest >= level)
        state = len(self.kept) + np.arange(len(path))
        self.kept = np.concatenate((self.kept, x[path]))
        return Run(path, state, highest[path], highest, cost)


class Gambler(Walk):
    """A gambler with 1 coin who wins each with chance q, until 0 or `goal`: P = (r - 1) / (r^goal - 1), r = (1-q)/q."""

    def __init__(self, goal, seed, chance=0.3):
        self.goal, self.chance = goal, chance
        super().__init__(seed)

    def first(self, n):
        return np.ones((n, 1))

    def moved(self, x):
        return x + np.where(self.rng.random(x.shape) < self.chance, 1.0, -1.0)

    def over(self, x):
        return (x[:, 0] <= 0) | (x[:, 0] >= self.goal)

    def importance(self, x):
        return np.where(x[:, 0] >= self.goal, HAPPENED, x[:, 0])

    @property
    def p(self):
        r = (1 - self.chance) / self.chance
        return (r - 1) / (r**self.goal - 1)


class Barrier(Walk):
    """A random walk of `steps` normal steps whose last place is above `barrier`: P = Phi(-barrier / sqrt(steps))."""

    width, steps = 2, 20

    def __init__(self, barrier, seed):
        self.barrier = barrier
        super().__init__(seed)

    def first(self, n):
        return np.zeros((n, 2))

    def moved(self, x):
        return x + np.column_stack((self.rng.standard_normal(len(x)), np.ones(len(x))))

    def over(self, x):
        return x[:, 1] >= self.steps

    def importance(self, x):
        left = np.maximum(self.steps - x[:, 1], 1.0)
        return np.where(self.over(x) & (x[:, 0] > self.barrier), HAPPENED, (x[:, 0] - self.barrier) / np.sqrt(left))

    @property
    def p(self):
        return float(stats.norm.sf(self.barrier / math.sqrt(self.steps)))


def goal_for(p, chance=0.3):
    r = (1 - chance) / chance
    return round(math.log((r - 1) / p + 1) / math.log(r))


PROCESSES = {
    **{f"gambler {p:g}": (lambda seed, p=p: Gambler(goal_for(p), seed)) for p in (1e-3, 1e-6, 1e-9)},
    **{
        f"barrier {p:g}": (lambda seed, p=p: Barrier(stats.norm.isf(p) * math.sqrt(Barrier.steps), seed))
        for p in (1e-3, 1e-6, 1e-9)
    },
}


def estimate(make, seed, effort, repeats=20):
    levels = find_levels(make(seed), effort, np.random.default_rng(seed))
    own = [(make(seed * 1000 + k + 1), np.random.default_rng((seed, k))) for k in range(repeats)]
    return pooled([repeat(process, levels.levels, effort, rng) for process, rng in own], levels.levels, levels.cost)


def coverage(name, times, effort):
    """Share of intervals that contain the closed form, and the mean of p over it."""
    make = PROCESSES[name]
    found = [estimate(make, seed, effort) for seed in range(1, times + 1)]
    held = [odds.low is not None and odds.low <= make(0).p <= odds.high for odds in found]
    return float(np.mean(held)), float(np.mean([odds.p for odds in found]) / make(0).p), found


@pytest.mark.parametrize("name", ["gambler 0.001", "barrier 1e-06"])
def test_the_interval_holds_the_closed_form(name):
    share, mean, found = coverage(name, 5, 150)
    assert share >= 0.6 and mean == pytest.approx(1, abs=0.35)
    assert all(0.0 < odds.low < odds.p < odds.high for odds in found if not odds.decided)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROCESSES)
def test_the_interval_holds_the_closed_form_in_95_of_100_estimates(name):
    share, mean, found = coverage(name, 200, EFFORT.get(name, 300))
    assert 0.93 <= share <= 0.97 and mean == pytest.approx(1, abs=0.05)
    assert all(odds.direct(odds.relative) > GAIN[name.split()[1]] * odds.cost / PATH for odds in found)


PATH = 20  # steps of a path, at least
EFFORT = {"gambler 1e-09": 500, "barrier 1e-09": 800}  # paths at each level
GAIN = {"0.001": 1, "1e-06": 100, "1e-09": 1e5}


def test_a_path_is_followed_back_to_its_beginning():
    process = Gambler(8, 1)
    levels = find_levels(process, 100, np.random.default_rng(1)).levels
    one = repeat(Gambler(8, 2), levels, 100, np.random.default_rng(2))
    assert len(levels) > 1 and one.p == pytest.approx(math.prod(one.shares))
    line = one.lineage(one.likeliest)
    assert sorted(line) == list(range(len(line))) and one.weights[line[0]] == one.weights.max()


def test_without_levels_the_interval_is_that_of_a_count():
    own = [repeat(Gambler(3, k), (HAPPENED,), 50, np.random.default_rng(k)) for k in range(1, 5)]
    odds, happened = pooled(own, (HAPPENED,)), sum(one.p for one in own) * 50
    count = stats.binomtest(round(happened), 200).proportion_ci(0.95, "exact")
    assert (odds.low, odds.high) == pytest.approx((count.low, count.high)) and not odds.decided
    none = pooled([repeat(Gambler(60, k), (HAPPENED,), 50, np.random.default_rng(k)) for k in (1, 2)], (HAPPENED,))
    assert none.p == 0.0 and none.high == pytest.approx(1 - 0.025**0.01)


def test_an_importance_that_tells_nothing_counts_paths():
    class Blind(Gambler):
        def importance(self, x):
            return np.where(x[:, 0] >= self.goal, HAPPENED, 0.0)

    assert find_levels(Blind(8, 1), 100, np.random.default_rng(1)).levels == (HAPPENED,)
