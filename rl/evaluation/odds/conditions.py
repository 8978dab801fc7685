"""Which conditions the episodes that failed had more often than all episodes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rl.evaluation.odds.estimate import Part
from rl.evaluation.odds.splitting import CONFIDENCE

PARTS = ("low", "middle", "high")  # thirds of all beginnings
RESAMPLES = 1000


class Ratio(NamedTuple):
    """How much more often a condition occurs among failures."""

    condition: str  # with unit
    part: str  # of PARTS
    begins: float  # where the part begins
    ends: float
    ratio: float  # share of the failures' probability in this part, over that of all episodes
    low: float  # of its 95 % interval
    high: float


def ratios(parts: Sequence[Part]) -> list[Ratio]:
    """All conditions that vary, those first that tell most; bootstrap over repeats."""
    found: list[Ratio] = []
    rng = np.random.default_rng(0)
    draws = rng.integers(len(parts), size=(RESAMPLES, len(parts)))
    for name in parts[0].conditions:
        values = np.stack([part.conditions[name] for part in parts])
        edges = np.quantile(values, (0.0, 1 / 3, 2 / 3, 1.0))
        weights = np.stack([part.repeat.weights for part in parts])
        if len(np.unique(edges)) < len(edges) or not weights.any():
            continue
        for k, part in enumerate(PARTS):
            inside = (values >= edges[k]) & ((values < edges[k + 1]) if k < len(PARTS) - 1 else True)
            of_failures, of_all = (weights * inside).sum(1), inside.mean(1)
            drawn = _over(of_failures[draws].sum(1), weights.sum(1)[draws].sum(1), of_all[draws].mean(1))
            low, high = np.quantile(drawn, ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2))
            ratio = float(_over(of_failures.sum(), weights.sum(), of_all.mean()))
            found.append(Ratio(name, part, float(edges[k]), float(edges[k + 1]), ratio, float(low), float(high)))
    return sorted(found, key=_clear, reverse=True)


def _over(failures, total, everywhere):
    return failures / np.maximum(total, 1e-300) / np.maximum(everywhere, 1e-300)


def _clear(one: Ratio) -> float:
    """How far the interval lies from 1, on a logarithmic scale; negative: it contains 1."""
    return max(math.log(max(one.low, 1e-9)), -math.log(max(one.high, 1e-9)))
