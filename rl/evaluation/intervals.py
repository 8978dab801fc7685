"""95 % intervals of figures: of shares of episodes by Wilson's method, of others by the bootstrap over episodes.

Episodes are independent of each other; moments within an episode are not. The bootstrap therefore draws whole episodes
with replacement and computes the figures of each draw. An interval reaches from the 2.5th to the 97.5th percentile of
the draws (percentile method, Efron & Tibshirani 1993, ch. 13). Two controllers on the same episodes get the same draws,
so that the difficulty of an episode cancels in their difference.

The bootstrap of a share of all or none has no width, however few the episodes. A figure in `Judge.shares` that is 0 or
1 in each episode therefore has Wilson's score interval (`wilson`), and a difference of two such figures Newcombe's,
which is made of theirs (`difference_of_shares`). Whatever else is computed from a share of all or none has no interval.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rl.judge import Episodes, Judge, finite

RESAMPLES = 2000
LEVEL = 0.95
Z = NormalDist().inv_cdf((1 + LEVEL) / 2)  # standard deviations from the middle to either end
AT_ONCE = 1_000_000  # numbers drawn at once


class Interval(NamedTuple):
    """A figure over all episodes with its interval; None where it was not measured."""

    value: float | None
    low: float | None
    high: float | None


def intervals(kind: type[Judge], episodes: Episodes) -> dict[str, Interval]:
    """The interval of each figure that `kind.pooled` computes from one team's `episodes` (Judge.episodes)."""
    found = _percentiles(kind.pooled(episodes), [kind.pooled(drawn) for (drawn,) in _draws(episodes)])
    return found | {key: Interval(*wilson(hits)) for key, (hits,) in _shares(kind, episodes).items()}


def wilson(hits: NDArray[np.float64]) -> tuple[float, float, float]:
    """A share of episodes, whose `hits` [episode] are 0 or 1, and the ends of its score interval (Wilson 1927)."""
    p, z2 = float(hits.mean()), Z**2 / len(hits)
    half = math.sqrt(p * (1 - p) * z2 + z2**2 / 4)
    low, high = ((p + z2 / 2 + end) / (1 + z2) for end in (-half, half))
    return p, min(max(low, 0.0), p), max(min(high, 1.0), p)  # rounding: the ends may be 0 and 1


def difference_of_shares(one: NDArray[np.float64], other: NDArray[np.float64]) -> Interval:
    """Difference of two shares of the same episodes, `one` minus `other`, with its interval (Newcombe 1998, method 10,
    without the correction of phi).
    """
    (p, p_low, p_high), (q, q_low, q_high) = wilson(one), wilson(other)
    spread = float(one.std() * other.std())
    phi = float(((one - p) * (other - q)).mean()) / spread if spread > 0 else 0.0

    def reach(a: float, b: float) -> float:
        return math.sqrt(max(a * a - 2 * phi * a * b + b * b, 0.0))

    return Interval(p - q, p - q - reach(p - p_low, q_high - q), p - q + reach(p_high - p, q - q_low))


def _shares(kind: type[Judge], *controllers: Episodes, times: int = 1) -> dict[str, list[NDArray[np.float64]]]:
    """Figures in `kind.shares` that are 0 or 1 in each episode: of each controller, [episode]."""
    with np.errstate(divide="ignore", invalid="ignore"):  # a figure that is not finite counts as not measured
        single = [kind.pooled({name: values[:, None] for name, values in of.items()}) for of in controllers]
    each = {
        key: [of[key].reshape(times, -1).mean(0) for of in single]
        for key in kind.shares
        if all(key in of for of in single)
    }
    return {key: of for key, of in each.items() if np.isin(of, (0.0, 1.0)).all()}


def differences(kind: type[Judge], one: Episodes, other: Episodes, times: int = 1) -> dict[str, Interval]:
    """The interval of each figure's difference, `one` minus `other`, on the same episodes.

    With `times` > 1, each argument holds the same episodes that many times, one policy after the other; all copies of
    an episode are drawn together.
    """
    found = paired(np.subtract, kind, one, other, times=times)
    return found | {key: difference_of_shares(*of) for key, of in _shares(kind, one, other, times=times).items()}


def ratios(kind: type[Judge], one: Episodes, other: Episodes, times: int = 1) -> dict[str, Interval]:
    """The interval of each figure's ratio, `one` over `other`; arguments as for `differences`."""
    with np.errstate(divide="ignore", invalid="ignore"):  # a figure that is not finite counts as not measured
        return paired(np.divide, kind, one, other, times=times)


def paired(
    combine: Callable[..., NDArray[np.float64]], kind: type[Judge], *controllers: Episodes, times: int = 1
) -> dict[str, Interval]:
    """The interval of `combine(figure, figure, ...)` over several controllers on the same episodes, for each figure.

    Args:
        combine: takes one figure of each controller.
        kind: the mission's judge.
        controllers: the episodes of each controller.
        times: as for `differences`.
    """
    counts = [_count(episodes) for episodes in controllers]
    if len(set(counts)) > 1:
        raise ValueError(f"{' and '.join(map(str, counts))} episodes: the controllers must have the same episodes")

    def together(parts: Sequence[Episodes]) -> dict[str, NDArray[np.float64]]:
        pooled = [kind.pooled(part) for part in parts]
        return {key: np.asarray(combine(*(figures[key] for figures in pooled))) for key in pooled[0]}

    found = _percentiles(together(controllers), [together(drawn) for drawn in _draws(*controllers, times=times)])
    for key, of in _shares(kind, *controllers, times=times).items():
        if any(hits.std() == 0 for hits in of):
            found[key] = Interval(found[key].value, None, None)
    return found


def _count(episodes: Episodes) -> int:
    return len(next(iter(episodes.values())))


def _draws(*controllers: Episodes, times: int = 1) -> Iterator[list[dict[str, NDArray[np.float64]]]]:
    """Draws of the same episodes for every controller, each [draw, episode]; `times` as for `differences`."""
    count, generator = _count(controllers[0]) // times, np.random.default_rng(0)
    rows = max(1, min(RESAMPLES, AT_ONCE // count))
    for begin in range(0, RESAMPLES, rows):
        drawn = generator.integers(count, size=(min(rows, RESAMPLES - begin), count))
        picks = np.concatenate([drawn + k * count for k in range(times)], axis=1)
        yield [{name: values[picks] for name, values in episodes.items()} for episodes in controllers]


def _percentiles(value: Mapping[str, NDArray], draws: list[dict[str, NDArray[np.float64]]]) -> dict[str, Interval]:
    found = {}
    for key in value:
        drawn = np.concatenate([np.atleast_1d(draw[key]) for draw in draws])
        drawn = drawn[np.isfinite(drawn)]
        edge = 50 * (1 - LEVEL)
        low, high = np.percentile(drawn, [edge, 100 - edge]) if len(drawn) else (np.nan, np.nan)
        found[key] = Interval(finite(value[key]), finite(low), finite(high))
    return found
